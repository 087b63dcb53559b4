/* Detection windows to spots; see windows.c. */
#ifndef ST_WINDOWS_H
#define ST_WINDOWS_H

#include "centroid.h"
#include "clustering.h"
#include "star_tracker.h"
#include "threshold.h"

/* What came of a window: WindowStatus of the Python stage. */
enum { ST_WINDOW_EMPTY, ST_WINDOW_FOUND, ST_WINDOW_CLIPPED, ST_WINDOW_FAINT, ST_WINDOW_REJECTED };

typedef struct {
    double sigma_factor; /* threshold in units of the window's noise */
    double tau_min_dn;   /* and never less than this */
    int32_t max_runs;
    int32_t image_width, image_height;
    int32_t reserved;
    const st_spot_limits *limits;
} st_window_parameters;

/* Part of the image: x0 <= x < x1, y0 <= y < y1. */
typedef struct {
    int32_t x0, y0, x1, y1;
} st_rect;

/* Room for one window's runs, clusters and spots, max_runs of each, and what the last window left there. */
typedef struct {
    st_run *runs;
    int32_t *run_background;
    int32_t *label;
    int32_t *row_start; /* rows of the tallest window + 1 */
    st_cluster *clusters;
    st_spot *spots;
    st_spot *ordered;
    int8_t *outcome;
    int32_t *order;      /* 2 max_runs */
    void *centroid_room; /* st_centroid_room_bytes */
    int32_t run_count, cluster_count, spot_count;
    int32_t rejected[ST_REASONS]; /* over all windows */
} st_window_room;

/* Runs of pixels whose 3 x 3 sum of DN is over limit; row_start[rows + 1]. The rim is mirrored. Returns their
 * number; the scan stops where capacity is reached. */
int32_t st_smoothed_runs(const st_image *window, int32_t limit, st_run *runs, int32_t capacity,
                         int32_t *row_start);

/* First third of a window's search: its statistics, and its runs to the room. */
void st_window_runs(const st_image *window, const st_window_parameters *parameters, st_window_room *room,
                    st_statistics *statistics);

/* Second third: the room's runs to clusters. */
void st_window_clusters(const st_image *window, const st_statistics *statistics, st_window_room *room);

/* Last third: the room's clusters to spots, of which at most keep go to chosen, in the image's pixels, and
 * their number to kept; the brightest, or the nearest to expected_magnitude where keep is 1 and that is a
 * number. Returns the window's status. */
int32_t st_window_spots(const st_image *window, const st_rect *rect, const st_window_parameters *parameters,
                        const st_statistics *statistics, int32_t keep, double expected_magnitude,
                        st_window_room *room, st_spot *chosen, int32_t *kept);

/* Median background and median noise of count (0: zeros) windows; sorted[count] is room. */
void st_median_statistics(const st_statistics *windows, int32_t count, double *sorted,
                          st_statistics *medians);

/* Spots of each window, by window: spots and the window of each; status and statistics of each window.
 * Window i is pixels[offsets[i]], row by row; offsets are even. keep[i]: spots it may give at most.
 * expected_flux_dn[i] (or a null pointer): not a number where unknown. Returns the number of spots;
 * overflowed: windows with more runs than max_runs. */
int32_t st_detect_in_windows(const uint16_t *pixels, const int32_t *offsets, const st_rect *rects,
                             int32_t windows, const int32_t *keep, const double *expected_flux_dn,
                             const st_window_parameters *parameters, st_window_room *room, st_spot *spots,
                             int32_t *window_of, uint8_t *status, st_statistics *statistics,
                             int32_t *overflowed);

#endif
