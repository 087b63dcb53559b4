/* Types that several kernels share. Where an array comes from the Python model it has that model's layout:
 * C order, double for float64, int32_t, uint16_t pixels; a flag is an int32_t. */
#ifndef ST_STAR_TRACKER_H
#define ST_STAR_TRACKER_H

#include <stddef.h>
#include <stdint.h>

/* Pixels of a sensor's frame in memory, row by row without gaps; DN. The first is word-aligned. */
typedef struct {
    const uint16_t *pixels; /* [rows][columns] */
    int32_t rows;
    int32_t columns;
} st_image;

#endif
