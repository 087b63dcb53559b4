/* Lit pixels and stars of whole frames, and the flow from one frame to the next; see optical_flow.c. */
#ifndef ST_OPTICAL_FLOW_H
#define ST_OPTICAL_FLOW_H

#include "clustering.h"

/* Values are whole numbers of 1/16 DN. */
#define ST_VALUE_BITS 4
#define ST_FLOW_BLOCK_PX 32

/* The lit pixels of a frame. Room from the caller: runs, run_background and offsets for capacity, values for
 * rows columns / (1 + sigma_factor^2) + 1 pixels: no more can be over such a threshold (Cantelli). */
typedef struct {
    st_run *runs;            /* row by row, left to right */
    int32_t *run_background; /* the level once a run, as st_sum_clusters takes it */
    int32_t *offsets;        /* where a run's values begin */
    int32_t *values;         /* over the level */
    int32_t *row_start;      /* [rows + 1] */
    int32_t capacity;
    int32_t run_count;
    int32_t lit;
    int32_t level;      /* the mean, rounded down */
    int32_t overflowed; /* more runs than capacity */
    int32_t reserved;
    double mean_dn, sigma_dn; /* of the whole frame */
} st_lit;

typedef struct {
    int32_t min_pixels, max_pixels, max_extent, max_stars;
} st_flow_limits;

typedef struct {
    double x_px, y_px, flux_dn, peak_dn;
    int32_t pixels;
    int32_t first_x, last_x, first_y, last_y;
    int32_t reserved;
} st_flow_star;

/* A star in the next frame; mismatch: SSD over the star's own energy. */
typedef struct {
    double x_px, y_px, mismatch;
    double length_px; /* of the lit streak in the frame before */
    double noise;     /* of the star's lit pixels, over their sum */
    int32_t star;     /* of the frame before */
    int32_t reserved;
} st_flow_match;

/* reach: of the search on either side, px; margin: of the centroid's window about the star's own. */
typedef struct {
    int32_t reach, margin, centrings;
} st_flow_search;

/* Part of a run in a window: columns from the window's first, and where the values begin. */
typedef struct {
    int32_t first, end;
    int32_t values;
} st_piece;

/* Room for a search: as many pieces as either frame has runs; tallest and widest star with 2 reach + 1. */
typedef struct {
    st_piece *own, *second;
    int32_t *own_start, *second_start; /* [height + 1], [height + 2 reach + 1] */
    int64_t *column_energy;            /* [width + 2 reach] */
    int64_t *product;                  /* [2 reach + 1] */
} st_flow_room;

/* Fill lit from an image whose pixels have at most so many bits. */
void st_light_up(const st_image *image, double sigma_factor, int32_t bits, st_lit *lit);

/* Stars among a frame's clusters, brightest first; order: room, [2 number]. Returns how many. */
int32_t st_flow_stars(const st_image *image, const st_cluster *clusters, int32_t number,
                      const st_flow_limits *limits, int32_t *order, st_flow_star *stars);

/* Where count stars of the frame before are in the one after, both of the image's size. foreseen:
 * double[count][2], shifts (x, y) that are expected, px, or none: 0. found[count]. Returns how many. */
int32_t st_flow_between(const st_image *image, const st_lit *before, const st_flow_star *stars, int32_t count,
                        const st_lit *after, const st_flow_search *search, const double *foreseen,
                        const st_flow_room *room, st_flow_match *found);

#endif
