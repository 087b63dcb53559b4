/* Stellar aberration; see aberration.c. */
#ifndef ST_ABERRATION_H
#define ST_ABERRATION_H

#include <stdint.h>

/* Velocity of the Earth plus that about it, over the speed of light, ICRS: tai_ns since 1958-01-01. */
void st_velocity_over_c(int64_t tai_ns, const double *velocity_km_s, double *velocity_over_c);

/* Velocity of the Earth in ICRS, km/s. */
void st_earth_velocity_km_s(int64_t tai_ns, double *velocity_km_s);

/* Apparent directions[count][3] of the given rows of unit_vectors[][3]; beta[3]: velocity / c. */
void st_apparent(const double *unit_vectors, const int32_t *rows, int32_t count, const double *beta,
                 double *apparent);

#endif
