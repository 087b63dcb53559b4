/* Background and noise of a detection window; see window_statistics.c. */
#ifndef ST_WINDOW_STATISTICS_H
#define ST_WINDOW_STATISTICS_H

#include <stdint.h>

/* What a window's pixels say of its sky, DN. */
typedef struct {
    double background_dn;
    double noise_dn; /* one pixel, 1 sigma */
} st_sky_level;

/* Background and noise of `size` pixels, `columns` in a row. size is at least 1, and size times the difference
 * of the largest pixel and the smallest below 2^32: a whole frame of 1024 x 1024 px with 12 bits. */
void st_window_statistics(const uint16_t *pixels, int32_t size, int32_t columns, st_sky_level *level);

#endif
