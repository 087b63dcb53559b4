/* Tracking: windows where the last attitude puts the stars, verification by a pivot; see tracking.c. */
#ifndef ST_TRACKING_H
#define ST_TRACKING_H

#include "geometry.h"
#include "sky_cells.h"
#include "windows.h"

/* The on-board catalogue: its grid, with the directions, and the Hipparcos magnitudes of its stars. */
typedef struct {
    st_sky_cells cells;
    const float *hp_mag;
    int32_t stars;
} st_catalogue;

typedef struct {
    double rate_rad_s; /* omega, the largest rate that windows allow for */
    double cos_half_tolerance; /* of half the largest error of the angle between the pivot and a star */
    double sin_half_tolerance;
    double star_radius_px;
    double magnitude_tolerance;
    double pixels_per_degree; /* eps, of the camera */
    double half_diagonal_rad; /* of the camera's field */
    int32_t min_stars;
    int32_t max_windows;
} st_tracking_parameters;

/* The stars that the next image should show, brightest first, and their windows; at most max_windows. */
typedef struct {
    int32_t *star;     /* rows of the catalogue */
    double *reference; /* [stars][3] apparent directions, ICRS */
    double *x_px;
    double *y_px;
    int32_t *window; /* of each star */
    st_rect *rects;
    int32_t stars;
    int32_t windows;
    int32_t half_width_px;
} st_tracking_plan;

/* Room for the neighbours; capacity is the catalogue's number of stars unless fewer are known to do. */
typedef struct {
    int32_t *neighbour;
    double *reference; /* [capacity][3] */
    double *sensor;    /* [capacity][3] */
    double *x_px;
    double *y_px;
    int32_t *flag;
    int32_t *place; /* max_windows + 1 */
    int32_t *key;   /* max_windows + 1 */
    int32_t capacity;
} st_plan_room;

/* Windows of the next image from the last attitude q[4]. pivot_star: row of its pivot, or -1 for the
 * neighbours of the boresight instead. interval_s: since that attitude. velocity_over_c[3]: zeros without
 * aberration. */
void st_plan_windows(const double *q_icrs_to_sensor, int32_t pivot_star, const st_catalogue *catalogue,
                     const st_camera *camera, const st_tracking_parameters *parameters, double interval_s,
                     double exposure_s, const double *velocity_over_c, st_tracking_plan *plan,
                     st_plan_room *room);

/* Write the merged windows of squares of half-width half about the points, clipped at the image's edges, to
 * rects, and each point's window; returns the number of windows. */
int32_t st_merge_windows(const double *x_px, const double *y_px, int32_t stars, int32_t half, int32_t width,
                         int32_t height, st_rect *rects, int32_t *window);

/* Room for the verification of `stars` predicted stars and `spots` spots in `windows` windows. */
typedef struct {
    int32_t *trial;     /* stars */
    double *distance;   /* stars */
    double *low; /* stars: squares of chords that are within the tolerance of the pivot's and the star's */
    double *high; /* stars; below zero: not computed */
    double *chord; /* spots: square of the chord to the pivot's spot; below zero: not computed */
    int32_t *owner; /* spots */
    int32_t *spot_from; /* windows + 1 */
    int32_t *in_window; /* windows */
} st_verify_room;

/* The spot of each star of the plan, -1 where none is verified, to chosen[plan->stars]; returns the pivot's
 * place in the plan, -1 where no star works as pivot. spots: by window, as window_of[count] says;
 * b_vectors[count][3]: their directions. verified: stars with a spot; found: stars that could have one. */
int32_t st_verify_by_pivot(const st_tracking_plan *plan, const st_catalogue *catalogue,
                           const st_tracking_parameters *parameters, const double *b_vectors,
                           const st_spot *spots, const int32_t *window_of, int32_t count, int32_t *chosen,
                           int32_t *verified, int32_t *found, st_verify_room *room);

#endif
