/* Runs of pixels over the threshold and their clusters; see clustering.c. */
#ifndef ST_CLUSTERING_H
#define ST_CLUSTERING_H

#include "star_tracker.h"

/* Backgrounds are DN in 32 bits with 15 of them behind the point: 0 to 65535.99997 DN. */
#define ST_BACKGROUND_BITS 15

/* Pixels first to end - 1 of a row; int32[runs][3] of the Python stage. */
typedef struct {
    int32_t row;
    int32_t first;
    int32_t end;
} st_run;

/* A cluster's sums, whole numbers all. Places are counted from (origin_x, origin_y), the first pixel of the
 * cluster's first run; the sums are of DN over the background, scaled by 2^ST_BACKGROUND_BITS. */
typedef struct {
    int64_t sum;
    int64_t sum_x;
    int64_t sum_y;
    int32_t background; /* of the first run */
    int32_t pixels;
    int32_t brightest_dn; /* largest pixel as it was read */
    int32_t origin_x, origin_y;
    int32_t first_x, last_x, first_y, last_y;
    int32_t reserved;
} st_cluster;

/* Label the first count runs by 8-connected cluster, 0 to clusters - 1 in the order of their first runs.
 * runs: row by row, left to right; row_start[rows + 1]; label[count]. Returns the number of clusters. */
int32_t st_join_runs(const st_run *runs, int32_t count, const int32_t *row_start, int32_t rows,
                     int32_t *label);

/* Sum the runs' pixels into clusters[number], which need not be cleared before.
 * run_background[count]: DN, scaled by 2^ST_BACKGROUND_BITS. */
void st_sum_clusters(const st_image *image, const st_run *runs, int32_t count, const int32_t *run_background,
                     const int32_t *label, st_cluster *clusters, int32_t number);

#endif
