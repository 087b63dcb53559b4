/* Clusters to spots: centre of mass, flux, verdict, order; see centroid.c. */
#ifndef ST_CENTROID_H
#define ST_CENTROID_H

#include "clustering.h"
#include "star_tracker.h"

/* Gaussian interpolation of one point spread: interpolation.py's InterpolationTerms, same order. */
typedef struct {
    int32_t wanted;
    int32_t half_height_px;
    double first[3];
    double second[3];
    double least_square_ratio;
} st_interpolation_terms;

/* What makes a cluster a spot: centroid.py's SpotLimits, same names. */
typedef struct {
    int32_t half_window;
    int32_t min_pixels;
    int32_t max_pixels;
    int32_t max_extent;
    double max_peak_fraction;
    double zero_point_dn;
    double magnitude_limit;
    int32_t saturation_dn;
    int32_t reserved;
    st_interpolation_terms interpolation;
} st_spot_limits;

typedef struct {
    double x_px, y_px;
    double flux_dn;
    double magnitude;
    double peak_dn;
    int32_t pixels;
    int32_t flags;
} st_spot;

enum { ST_SATURATED = 1, ST_AT_EDGE = 2 }; /* bits of st_spot.flags */

/* Why a cluster is no spot, as in centroid.py; -1: it is one. */
enum { ST_SMALL, ST_LARGE, ST_SHARP, ST_EDGE, ST_FAINT, ST_REASONS };

/* Bytes of the room that st_measure_spots works in, word-aligned: side^2, up to a whole word, + 16 side,
 * side = max_extent + 2 (half_window + 6) + 2. */
int32_t st_centroid_room_bytes(const st_spot_limits *limits);

/* Centroid, flux and verdict of each cluster; returns the number of spots put into spots[number].
 * runs, row_start[image->rows + 1] and label as st_join_runs left them. noise_dn: 1 sigma of a pixel.
 * local_background: from a ring round the spot, else the cluster's own. reach: 1 for clusters of raw pixels,
 * 0 for those of a smoothed image. outcome[number]: -1 or the reason. rejected[ST_REASONS]: added to. */
int32_t st_measure_spots(const st_image *image, const st_run *runs, const int32_t *row_start,
                         const int32_t *label, const st_cluster *clusters, int32_t number, double noise_dn,
                         int32_t local_background, int32_t reach, const st_spot_limits *limits,
                         st_spot *spots, int8_t *outcome, int32_t *rejected, void *room);

/* The same by the clusters alone: energy-weighted mean and energy of each, cluster_centroid.py. */
int32_t st_measure_clusters(const st_image *image, const st_cluster *clusters, int32_t number,
                            const st_spot_limits *limits, st_spot *spots, int8_t *outcome, int32_t *rejected);

/* Order spots by flux, brightest first, equal ones as they were; the first most of them go to ordered.
 * order[2 * count]: room. Returns how many went there. */
int32_t st_order_spots(const st_spot *spots, int32_t count, int32_t most, int32_t *order, st_spot *ordered);

#endif
