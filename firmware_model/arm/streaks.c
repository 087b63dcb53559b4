/* Clusters with their pixels: the kernels of firmware_model/image/streaks.py and join_pieces of
 * image/clustering.py, after Schiattarella et al. 2020, section 2.3. Whole numbers but for the magnitudes that
 * decide between partners as near; the same in all. */
#include "streaks.h"

#include <math.h>
#include <string.h>

#define STREAK_EXTENT_PX 7
#define JUDGED_CLUSTERS 5

static int32_t least_of(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

static int32_t most_of(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

int32_t st_streaks_seen(const st_cluster *clusters, int32_t number)
{
    int64_t sums[JUDGED_CLUSTERS];
    int32_t extents[JUDGED_CLUSTERS];
    int32_t judged = 0;
    int32_t streaks = 0;
    for (int32_t i = 0; i < number; i++) {
        const st_cluster *cluster = &clusters[i];
        int32_t place = judged;
        while (place > 0 && sums[place - 1] < cluster->sum)
            place--;
        if (place == JUDGED_CLUSTERS)
            continue;
        judged = least_of(judged + 1, JUDGED_CLUSTERS);
        for (int32_t later = judged - 1; later > place; later--) {
            sums[later] = sums[later - 1];
            extents[later] = extents[later - 1];
        }
        sums[place] = cluster->sum;
        extents[place] = most_of(cluster->last_x - cluster->first_x, cluster->last_y - cluster->first_y) + 1;
    }
    for (int32_t i = 0; i < judged; i++)
        streaks += extents[i] >= STREAK_EXTENT_PX;
    return 2 * streaks > judged;
}

static int32_t root_of(int32_t *parent, int32_t cluster)
{
    while (parent[cluster] != cluster) {
        parent[cluster] = parent[parent[cluster]];
        cluster = parent[cluster];
    }
    return cluster;
}

int32_t st_join_pieces(const st_run *runs, int32_t count, const int32_t *row_start, int32_t rows,
                       int32_t *label, int32_t clusters, int32_t gap_px, int32_t *number)
{
    int32_t *parent = number + clusters;
    int32_t left = 0;
    for (int32_t cluster = 0; cluster < clusters; cluster++)
        parent[cluster] = cluster;
    for (int32_t row = 0; row < rows; row++) {
        int32_t above = row_start[most_of(row - gap_px - 1, 0)];
        for (int32_t run = row_start[row]; run < row_start[row + 1]; run++) {
            int32_t first = runs[run].first - gap_px;
            int32_t end = runs[run].end + gap_px;
            for (int32_t other = above; other < run; other++) {
                if (runs[other].first > end || first > runs[other].end)
                    continue;
                int32_t a = root_of(parent, label[other]);
                int32_t b = root_of(parent, label[run]);
                if (a < b)
                    parent[b] = a;
                else
                    parent[a] = b;
            }
        }
    }
    for (int32_t cluster = 0; cluster < clusters; cluster++)
        number[cluster] = parent[cluster] == cluster ? left++ : number[root_of(parent, cluster)];
    for (int32_t run = 0; run < count; run++)
        label[run] = number[label[run]];
    return left;
}

int32_t st_keep_runs(const st_run *runs, const int32_t *label, int32_t count, const int32_t *cluster_extent,
                     int32_t clusters, const int32_t *spot_cluster, int32_t spots, int32_t *spot_of,
                     st_run *kept, int32_t *run_start, int32_t *extent)
{
    memset(spot_of, 0xFF, (size_t)clusters * sizeof *spot_of);
    memset(run_start, 0, (size_t)(spots + 1) * sizeof *run_start);
    for (int32_t spot = 0; spot < spots; spot++) {
        spot_of[spot_cluster[spot]] = spot;
        memcpy(&extent[4 * spot], &cluster_extent[4 * spot_cluster[spot]], 4 * sizeof *extent);
    }
    /* How many runs each spot has, counted one place on; then where the spot begins. */
    for (int32_t run = 0; run < count; run++) {
        int32_t spot = spot_of[label[run]];
        if (spot >= 0)
            run_start[spot + 1]++;
    }
    for (int32_t spot = 0; spot < spots; spot++)
        run_start[spot + 1] += run_start[spot];
    int32_t total = run_start[spots];
    for (int32_t run = 0; run < count; run++) {
        int32_t spot = spot_of[label[run]];
        if (spot >= 0)
            kept[run_start[spot]++] = runs[run];
    }
    /* Each now stands where the next begins. */
    for (int32_t spot = spots; spot > 0; spot--)
        run_start[spot] = run_start[spot - 1];
    run_start[0] = 0;
    return total;
}

/* Square of the distance of the nearest pixels of two spots; over limit where none is within. */
static int32_t run_distance(const st_run *a, const st_run *a_end, const st_run *b, const st_run *b_end,
                            int32_t limit)
{
    int32_t best = limit + 1;
    for (; a < a_end; a++) {
        for (const st_run *other = b; other < b_end; other++) {
            int32_t down = a->row - other->row;
            int32_t across = most_of(most_of(a->first - other->end, other->first - a->end) + 1, 0);
            best = least_of(best, across * across + down * down);
        }
        if (best == 0)
            break;
    }
    return best;
}

static void offer(st_partner *partner, int32_t distance, double unlike, int32_t other)
{
    if (distance > partner->distance || (distance == partner->distance && !(unlike < partner->unlike)))
        return;
    partner->distance = distance;
    partner->unlike = unlike;
    partner->best = other;
}

int32_t st_fuse(const st_streak_table *before, const st_streak_table *now, double distance_px,
                st_partner *partners, int32_t *pair_before, int32_t *pair_now)
{
    int32_t reach = (int32_t)distance_px;
    int32_t limit = (int32_t)(distance_px * distance_px);
    st_partner *of_now = partners + before->count;
    int32_t pairs = 0;
    for (int32_t i = 0; i < before->count + now->count; i++)
        partners[i] = (st_partner){.unlike = HUGE_VAL, .distance = limit + 1, .best = -1};
    for (int32_t i = 0; i < before->count; i++) {
        const int32_t *box = &before->extent[4 * i];
        int32_t left = box[0] - reach;
        int32_t right = box[1] + reach;
        int32_t top = box[2] - reach;
        int32_t bottom = box[3] + reach;
        const int32_t *other = now->extent;
        for (int32_t j = 0; j < now->count; j++, other += 4) {
            if (other[0] > right || other[1] < left || other[2] > bottom || other[3] < top)
                continue;
            int32_t distance = run_distance(
                before->runs + before->run_start[i], before->runs + before->run_start[i + 1],
                now->runs + now->run_start[j], now->runs + now->run_start[j + 1], limit);
            if (distance > limit)
                continue;
            double unlike = fabs(before->magnitude[i] - now->magnitude[j]);
            offer(&partners[i], distance, unlike, j);
            offer(&of_now[j], distance, unlike, i);
        }
    }
    for (int32_t j = 0; j < now->count; j++) {
        int32_t i = of_now[j].best;
        if (i < 0 || partners[i].best != j)
            continue;
        pair_before[pairs] = i;
        pair_now[pairs++] = j;
    }
    return pairs;
}
