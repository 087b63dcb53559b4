/* Is a trial attitude the right one? See verification.c. */
#ifndef ST_VERIFICATION_H
#define ST_VERIFICATION_H

#include "identification.h"

/* matched: 0 where the trial fails. */
typedef struct {
    int32_t matched;
    int32_t expected;
    int32_t seen;
} st_verified;

/* Every spike to the nearest star within radius_rad under q, a star only to its nearest spike; returns how
 * many. only_star[n], only_angle[n]: verification.match_spots_kernel. */
int32_t st_match_spots(const st_spikes *spikes, const double *q, const st_star_table *stars,
                       double separation_rad, double radius_rad, double searched_rad, int32_t *only_star,
                       double *only_angle, int32_t *star_index);

/* Attitude q of the matched spikes at equal weights; returns how many (q untouched below 3). */
int32_t st_refine(const st_spikes *spikes, const st_star_table *stars, const int32_t *star_index, double *q);

/* Catalogue stars in the field not dimmer than the median of the matched, and how many are matched. */
void st_expected(const double *q, const double *normals, const st_star_table *stars,
                 const int32_t *star_index, int32_t spikes, int32_t *expected, int32_t *seen);

/* Matched spikes whose brightness is off by more than tolerance_mag from the median offset. */
int32_t st_odd_brightness(const double *magnitudes, const float *hp_mag, const int32_t *star_index,
                          int32_t spikes, double tolerance_mag);

/* The final judgement of the trial attitude q, which is refined; star_index[n]: the stars that it is made
 * of, -1 elsewhere; the matches are written there. min_stars is that of the trial, not that of the limits. */
st_verified st_verify(const st_spikes *spikes, double *q, const st_star_table *stars, const st_limits *limits,
                      int32_t min_stars, int32_t *star_index);

#endif
