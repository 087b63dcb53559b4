/* Angular rate from two attitudes; see rate.c. */
#ifndef ST_RATE_H
#define ST_RATE_H

#include <stdint.h>

/* p (x) q, canonical and of unit length; [x, y, z, w]. */
void st_quaternion_product(const double *p, const double *q, double *product);

/* Mean rate of the sensor, rad/s, in sensor axes. */
void st_angular_rate(const double *q_before, const double *q_after, double interval_s, double *rate_rad_s);

/* Covariance[3][3] of that rate from the two attitudes'. */
void st_rate_covariance(const double *before_rad2, const double *now_rad2, double interval_s,
                        double *covariance);

/* Whether a rate is over limit_rad_s by more than three sigma of the two attitudes' covariances[3][3]. */
int32_t st_rate_too_high(const double *rate_rad_s, double interval_s, const double *before_rad2,
                         const double *now_rad2, double limit_rad_s);

#endif
