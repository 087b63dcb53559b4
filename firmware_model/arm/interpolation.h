/* Centroid by Gaussian interpolation; see interpolation.c. */
#ifndef ST_INTERPOLATION_H
#define ST_INTERPOLATION_H

#include "centroid.h"

/* The part of an image about a spot and who owns its pixels: mask[y * width + x] is that of pixel
 * (left + x, top + y). */
typedef struct {
    const uint8_t *mask;
    int32_t left, top, width, height;
} st_surroundings;

enum { ST_OWN = 1, ST_OTHER = 2 }; /* bits of a mask */

/* The spot's place to x_px, y_px (in: its centre of mass), and 1; or 0 where that has to stay.
 * background: DN, scaled by 2^ST_BACKGROUND_BITS; com_sigma_px: error of the centre of mass, 1 sigma. */
int32_t st_interpolate(const st_image *image, const st_surroundings *about, int32_t background,
                       double com_sigma_px, const st_interpolation_terms *terms, double *x_px, double *y_px);

#endif
