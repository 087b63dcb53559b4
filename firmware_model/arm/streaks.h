/* Clusters kept for the next frame and the fusion of two frames; see streaks.c. */
#ifndef ST_STREAKS_H
#define ST_STREAKS_H

#include "clustering.h"

/* Spots of a frame with their pixels: streaks.py's StreakTable, same names. */
typedef struct {
    const st_run *runs;
    const int32_t *run_start; /* [count + 1] */
    const int32_t *extent;    /* [count][4]: first and last column, first and last row */
    const double *magnitude;
    int32_t count;
} st_streak_table;

/* What st_fuse works in, for each spot of either frame. */
typedef struct {
    double unlike;
    int32_t distance; /* square, px^2 */
    int32_t best;
} st_partner;

/* Whether the brightest clusters are longer than stars at rest. */
int32_t st_streaks_seen(const st_cluster *clusters, int32_t number);

/* Join clusters with at most gap_px pixels between them; label as st_join_runs left it, renumbered.
 * number[2 * clusters]: room. Returns how many clusters there are now. */
int32_t st_join_pieces(const st_run *runs, int32_t count, const int32_t *row_start, int32_t rows,
                       int32_t *label, int32_t clusters, int32_t gap_px, int32_t *number);

/* The runs of the spots, those of one spot together: kept, run_start[spots + 1], extent[spots][4].
 * spot_cluster[spots]: the cluster of each spot; spot_of[clusters]: room. Returns how many runs were kept. */
int32_t st_keep_runs(const st_run *runs, const int32_t *label, int32_t count, const int32_t *cluster_extent,
                     int32_t clusters, const int32_t *spot_cluster, int32_t spots, int32_t *spot_of,
                     st_run *kept, int32_t *run_start, int32_t *extent);

/* Pairs of spots that are each other's nearest within distance_px, in the order of now's spots.
 * partners[before->count + now->count]: room; pair_before, pair_now[now->count]. Returns how many. */
int32_t st_fuse(const st_streak_table *before, const st_streak_table *now, double distance_px,
                st_partner *partners, int32_t *pair_before, int32_t *pair_now);

#endif
