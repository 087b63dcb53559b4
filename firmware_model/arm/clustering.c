/* Runs to clusters: firmware_model/image/clustering.py (join_runs, sum_clusters), after Marciniak et al.,
 * section 2.1: runs that touch make a cluster.
 *
 * The same labels; whole numbers all. Within a run pixels are summed as they were read, and the background is
 * taken off when the run is complete; sums are of 64 bits, so nothing is rounded. */
#include "clustering.h"

#include <string.h>

static inline int32_t root_of(int32_t *parent, int32_t run)
{
    while (parent[run] != run) {
        int32_t above = parent[parent[run]]; /* path halving */
        parent[run] = above;
        run = above;
    }
    return run;
}

int32_t st_join_runs(const st_run *runs, int32_t count, const int32_t *row_start, int32_t rows,
                     int32_t *label)
{
    for (int32_t run = 0; run < count; run++)
        label[run] = run;
    for (int32_t row = 1; row < rows; row++) {
        int32_t above = row_start[row - 1];
        int32_t above_end = row_start[row];
        int32_t run = above_end;
        int32_t run_end = row_start[row + 1];
        while (above < above_end && run < run_end) {
            const st_run *upper = &runs[above];
            const st_run *lower = &runs[run];
            /* Ends are beyond the last pixel: where they are equal the runs touch at a corner. */
            if (upper->first <= lower->end && lower->first <= upper->end) {
                int32_t a = root_of(label, above);
                int32_t b = root_of(label, run);
                /* The smaller index becomes the root. */
                if (a < b)
                    label[b] = a;
                else
                    label[a] = b;
            }
            if (upper->end < lower->end)
                above++;
            else
                run++;
        }
    }
    int32_t clusters = 0;
    for (int32_t run = 0; run < count; run++) {
        /* Roots have the smallest index: a run's root has its number when the run is reached. */
        if (label[run] == run)
            label[run] = clusters++;
        else
            label[run] = label[label[run]];
    }
    return clusters;
}

static void begin(st_cluster *cluster, const st_run *run, int32_t background)
{
    cluster->background = background;
    cluster->origin_x = run->first;
    cluster->origin_y = run->row;
    cluster->first_x = run->first;
    cluster->last_x = run->first;
    cluster->first_y = run->row;
}

void st_sum_clusters(const st_image *image, const st_run *runs, int32_t count, const int32_t *run_background,
                     const int32_t *label, st_cluster *clusters, int32_t number)
{
    memset(clusters, 0, (size_t)number * sizeof *clusters);
    for (int32_t i = 0; i < count; i++) {
        const st_run *run = &runs[i];
        st_cluster *cluster = &clusters[label[i]];
        const uint16_t *pixel = image->pixels + run->row * image->columns + run->first;
        int32_t length = run->end - run->first;
        uint32_t sum = 0;
        uint64_t sums = 0; /* of all the sums on the way: each pixel times its distance from the end */
        uint32_t brightest = (uint32_t)cluster->brightest_dn;
        if (cluster->pixels == 0)
            begin(cluster, run, run_background[i]);
        for (int32_t left = length; left > 0; left--) {
            uint32_t value = *pixel++;
            sum += value;
            sums += sum;
            if (value > brightest)
                brightest = value;
        }
        cluster->brightest_dn = (int32_t)brightest;
        cluster->pixels += length;
        int32_t right = run->first - cluster->origin_x;
        int32_t down = run->row - cluster->origin_y;
        /* The same of the background, which is the cluster's for all of its pixels. */
        int64_t weight = ((int64_t)sum << ST_BACKGROUND_BITS) - (int64_t)cluster->background * length;
        int64_t weight_right = (int64_t)(((uint64_t)sum * (uint32_t)length - sums) << ST_BACKGROUND_BITS) -
                               (int64_t)cluster->background *
                                   (int32_t)((uint32_t)(length * (length - 1)) >> 1);
        cluster->sum += weight;
        cluster->sum_x += weight_right + weight * right;
        cluster->sum_y += weight * down;
        if (run->first < cluster->first_x)
            cluster->first_x = run->first;
        if (run->end - 1 > cluster->last_x)
            cluster->last_x = run->end - 1;
        cluster->last_y = run->row; /* runs come row by row */
    }
}
