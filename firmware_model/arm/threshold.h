/* Background, noise and threshold of a whole frame; see threshold.c. */
#ifndef ST_THRESHOLD_H
#define ST_THRESHOLD_H

#include "clustering.h"
#include "star_tracker.h"

#define ST_NOISE_SAMPLES 4096
#define ST_BLOCK_PX 32

typedef struct {
    double background_dn;
    double noise_dn; /* 1 sigma of a pixel */
} st_statistics;

/* Background and noise of a frame from at most ST_NOISE_SAMPLES pairs of its pixels. */
void st_frame_statistics(const st_image *image, st_statistics *statistics);

typedef struct {
    double background_dn; /* where the moving average starts */
    double over_dn;       /* what a pixel must have over it */
    int32_t average_pixels;
    int32_t capacity; /* of the run table */
    int32_t bits;     /* of the converter: no pixel has more */
    int32_t reserved;
} st_threshold;

/* Runs of pixels over (moving average + over_dn), row by row, left to right, with the average where each
 * begins, scaled by 2^ST_BACKGROUND_BITS. run_background[capacity], row_start[rows + 1]; room[2 blocks]: a
 * block is ST_BLOCK_PX pixels of a row or its rest. Returns their number, or -1 - number where the table was
 * full: rows below hold none. */
int32_t st_threshold_scan(const st_image *image, const st_threshold *threshold, st_run *runs,
                          int32_t *run_background, int32_t *row_start, int32_t *room);

#endif
