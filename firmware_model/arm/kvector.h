/* Range search in a sorted list without comparisons; see kvector.c. */
#ifndef ST_KVECTOR_H
#define ST_KVECTOR_H

#include "identification.h"

/* Places [first, end) of the pairs whose cosine is in lowest..highest. */
void st_range(const st_pair_table *pairs, double lowest, double highest, int32_t *first, int32_t *end);

/* Angle of two unit vectors, rad, from the chord. */
double st_angle(const double *one, const double *other);

/* Cosines of an angle with the tolerance added (lowest) and taken off (highest), within 0..pi. */
void st_cosine_range(double angle_rad, double tolerance_rad, double *lowest, double *highest);

/* Scalar product of two vectors. */
double st_dot(const double *one, const double *other);

/* The same of unit vectors in Q30 (1 is 2^30), truncated downwards: good to 3e-9. */
int32_t st_dot_q30(const int32_t *one, const int32_t *other);

#endif
