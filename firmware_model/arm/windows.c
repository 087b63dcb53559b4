/* Detection in windows: firmware_model/image/windows.py, for Sarvi et al. 2014, tracking step 4.
 *
 * Smoothing and threshold are whole numbers: a pixel's 3 x 3 sum against floor(9 background + 3 threshold).
 * The search of a window is in three parts, so that the cost of each stage can be told apart: threshold
 * (st_window_runs), clustering (st_window_clusters), centroid (st_window_spots). */
#include "windows.h"

#include "window_statistics.h"

#include <math.h>

#define BACKGROUND_SCALE ((double)(1 << ST_BACKGROUND_BITS))
#define CUT_WITHIN_PX 3 /* a cluster so near to the window's side is cut by it */

int32_t st_smoothed_runs(const st_image *window, int32_t limit, st_run *runs, int32_t capacity,
                         int32_t *row_start)
{
    const uint16_t *line = window->pixels;
    int32_t rows = window->rows;
    int32_t columns = window->columns;
    st_run *run = runs;
    for (int32_t row = 0; row < rows; row++) {
        /* The rim's missing neighbours are mirror images. */
        const uint16_t *above = row > 0 ? line - columns : rows > 1 ? line + columns : line;
        const uint16_t *below = row < rows - 1 ? line + columns : rows > 1 ? line - columns : line;
        const uint16_t *next = line;
        int32_t centre = above[0] + line[0] + below[0];
        int32_t before = columns > 1 ? above[1] + line[1] + below[1] : centre;
        int32_t after = before;
        int32_t inside = 0; /* -1 in a run */
        int32_t left = columns;
        row_start[row] = run - runs;
        do {
            /* Sums of three columns, the one ahead read now; beyond the last one it is the one before. */
            after = before;
            if (--left > 0)
                after = *++above + *++next + *++below;
            /* Below zero where the pixel is over the limit outside of a run, or not over it inside. */
            if (((limit - before - centre - after) ^ inside) < 0) {
                int32_t column = columns - 1 - left;
                if (inside) {
                    run->end = column;
                    run++;
                } else if (run == runs + capacity) {
                    while (row++ < rows)
                        row_start[row] = capacity;
                    return capacity;
                } else {
                    run->row = row;
                    run->first = column;
                }
                inside = ~inside;
            }
            before = centre;
            centre = after;
        } while (left > 0);
        if (inside) {
            run->end = columns;
            run++;
        }
        line += columns;
    }
    row_start[rows] = run - runs;
    return run - runs;
}

void st_window_runs(const st_image *window, const st_window_parameters *parameters, st_window_room *room,
                    st_statistics *statistics)
{
    st_window_statistics(window, statistics);
    /* A 3 x 3 sum has 9 times the background and 3 times the noise of a pixel. */
    double over = parameters->sigma_factor * statistics->noise_dn;
    if (over < parameters->tau_min_dn)
        over = parameters->tau_min_dn;
    int32_t limit = (int32_t)floor(9.0 * statistics->background_dn + 3.0 * over);
    room->run_count = st_smoothed_runs(window, limit, room->runs, parameters->max_runs, room->row_start);
}

void st_window_clusters(const st_image *window, const st_statistics *statistics, st_window_room *room)
{
    int32_t background = (int32_t)(statistics->background_dn * BACKGROUND_SCALE + 0.5);
    int32_t count = room->run_count;
    for (int32_t run = 0; run < count; run++)
        room->run_background[run] = background;
    room->cluster_count = st_join_runs(room->runs, count, room->row_start, window->rows, room->label);
    st_sum_clusters(window, room->runs, count, room->run_background, room->label, room->clusters,
                    room->cluster_count);
}

/* Why a window with clusters gave no spot: what became of its brightest cluster. */
static int32_t worst_status(const st_window_room *room, const st_rect *rect,
                            const st_window_parameters *parameters)
{
    int32_t brightest = 0;
    for (int32_t cluster = 1; cluster < room->cluster_count; cluster++) {
        if (room->clusters[cluster].sum > room->clusters[brightest].sum)
            brightest = cluster;
    }
    if (room->outcome[brightest] == ST_FAINT)
        return ST_WINDOW_FAINT;
    if (room->outcome[brightest] == ST_EDGE) {
        /* A side that lies on the image's edge cannot be helped by a larger window. */
        const st_cluster *entry = &room->clusters[brightest];
        if ((rect->x0 > 0 && entry->first_x < CUT_WITHIN_PX) ||
            (rect->y0 > 0 && entry->first_y < CUT_WITHIN_PX) ||
            (rect->x1 < parameters->image_width && entry->last_x >= rect->x1 - rect->x0 - CUT_WITHIN_PX) ||
            (rect->y1 < parameters->image_height && entry->last_y >= rect->y1 - rect->y0 - CUT_WITHIN_PX))
            return ST_WINDOW_CLIPPED;
    }
    return ST_WINDOW_REJECTED;
}

int32_t st_window_spots(const st_image *window, const st_rect *rect, const st_window_parameters *parameters,
                        const st_statistics *statistics, int32_t keep, double expected_magnitude,
                        st_window_room *room, st_spot *chosen, int32_t *kept)
{
    const st_spot *best = room->ordered;
    int32_t found = st_measure_spots(window, room->runs, room->row_start, room->label, room->clusters,
                                     room->cluster_count, statistics->noise_dn, 0, 0, parameters->limits,
                                     room->spots, room->outcome, room->rejected, room->centroid_room);
    room->spot_count = found;
    *kept = 0;
    if (found == 0)
        return worst_status(room, rect, parameters);
    if (keep == 1 && expected_magnitude == expected_magnitude) {
        double nearest = fabs(room->spots[0].magnitude - expected_magnitude);
        best = room->spots;
        for (int32_t spot = 1; spot < found; spot++) {
            double difference = fabs(room->spots[spot].magnitude - expected_magnitude);
            if (difference < nearest) {
                nearest = difference;
                best = room->spots + spot;
            }
        }
        *kept = 1;
    } else {
        *kept = st_order_spots(room->spots, found, keep, room->order, room->ordered);
    }
    for (int32_t place = 0; place < *kept; place++) {
        chosen[place] = best[place];
        chosen[place].x_px += rect->x0;
        chosen[place].y_px += rect->y0;
    }
    return ST_WINDOW_FOUND;
}

/* Insertion sort: windows are few. */
static double median(double *values, int32_t count)
{
    for (int32_t i = 1; i < count; i++) {
        double value = values[i];
        int32_t place = i;
        for (; place > 0 && values[place - 1] > value; place--)
            values[place] = values[place - 1];
        values[place] = value;
    }
    int32_t upper = count >> 1;
    return count & 1 ? values[upper] : 0.5 * (values[upper - 1] + values[upper]);
}

void st_median_statistics(const st_statistics *windows, int32_t count, double *sorted, st_statistics *medians)
{
    medians->background_dn = 0.0;
    medians->noise_dn = 0.0;
    if (count == 0)
        return;
    for (int32_t i = 0; i < count; i++)
        sorted[i] = windows[i].background_dn;
    medians->background_dn = median(sorted, count);
    for (int32_t i = 0; i < count; i++)
        sorted[i] = windows[i].noise_dn;
    medians->noise_dn = median(sorted, count);
}

int32_t st_detect_in_windows(const uint16_t *pixels, const int32_t *offsets, const st_rect *rects,
                             int32_t windows, const int32_t *keep, const double *expected_flux_dn,
                             const st_window_parameters *parameters, st_window_room *room, st_spot *spots,
                             int32_t *window_of, uint8_t *status, st_statistics *statistics,
                             int32_t *overflowed)
{
    int32_t total = 0;
    *overflowed = 0;
    for (int32_t i = 0; i < ST_REASONS; i++)
        room->rejected[i] = 0;
    for (int32_t i = 0; i < windows; i++) {
        const st_rect *rect = rects + i;
        st_image window = {pixels + offsets[i], rect->y1 - rect->y0, rect->x1 - rect->x0};
        double expected = NAN;
        int32_t kept;
        st_window_runs(&window, parameters, room, statistics + i);
        status[i] = ST_WINDOW_EMPTY;
        if (room->run_count == 0)
            continue;
        if (room->run_count == parameters->max_runs)
            ++*overflowed;
        st_window_clusters(&window, statistics + i, room);
        if (expected_flux_dn)
            expected = -2.5 * log10(expected_flux_dn[i] / parameters->limits->zero_point_dn);
        status[i] = st_window_spots(&window, rect, parameters, statistics + i, keep[i], expected, room,
                                    spots + total, &kept);
        for (; kept > 0; kept--)
            window_of[total++] = i;
    }
    return total;
}
