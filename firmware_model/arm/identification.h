/* What the identification algorithms share: star tables, limits and solutions as the Python stages have them
 * (catalogue/tables.py, identification/interface.py, identification/solutions.py). */
#ifndef ST_IDENTIFICATION_H
#define ST_IDENTIFICATION_H

#include <stdint.h>

#include "sky_cells.h"

#define ST_MOST_SPIKES 1024 /* of one image: as many as detection hands on */

/* How a search ends, or that it goes on; a work limit (solutions.LIMIT, 3) is not part of the kernels. */
enum { ST_NOTHING, ST_CERTAIN, ST_RIVAL };

/* Places of the two solutions kept. */
enum { ST_CONFIRMED, ST_TRIANGLE };

/* Bits of firmware_model/reasons.py. */
enum {
    ST_REASON_NONE = 0,
    ST_REASON_TOO_FEW_STARS = 1,
    ST_REASON_NO_MATCH = 2,
    ST_REASON_AMBIGUOUS = 512,
    ST_REASON_UNCONFIRMED = 8192
};

/* Spikes, brightest first. */
typedef struct {
    const double *b;          /* [count][3], unit vectors in the sensor frame */
    const double *magnitudes; /* [count] */
    int32_t count;
} st_spikes;

/* The star catalogue. */
typedef struct {
    st_sky_cells cells; /* with the stars' unit vectors */
    const float *hp_mag; /* [stars] */
    int32_t stars;
    int32_t *near; /* [stars], room for the rows that a search of the grid gives */
} st_star_table;

/* The pair catalogue with its k-vector.
 * pairs is 0 where there are none; count_below has one entry more than there are pairs. */
typedef struct {
    double slope;
    double offset;
    double steps_per_unit; /* 1 / slope: a soft division costs seven multiplications */
    const double *cos_angle; /* [pairs], ascending */
    const int32_t *brighter; /* [pairs], rows of the star catalogue */
    const int32_t *dimmer;   /* [pairs] */
    const int32_t *count_below;
    int32_t pairs;
} st_pair_table;

/* Limits of a search, solutions.Limits without that of the work. */
typedef struct {
    double tolerance_rad;
    double separation_rad; /* no two stars of the catalogue are closer */
    double least_seen_share;
    double magnitude_tolerance;
    double most_false_solutions;
    double most_false_triangles;
    double certain_false_solutions;
    double normals[12]; /* [4][3], of the field's planes, inwards; where field_given */
    int32_t min_stars;
    int32_t field_given;
} st_limits;

/* A solution. */
typedef struct {
    double q[4];
    double chance;   /* how many solutions as good as this one chance gives per image */
    int32_t matched; /* 0: there is none */
    int32_t expected;
    int32_t seen;
    int32_t rivals;
    int32_t *star_index; /* [spikes], -1 where there is no star; the caller's */
} st_solution;

/* The best of each worth: kept[ST_CONFIRMED] and kept[ST_TRIANGLE]. */
typedef struct {
    st_solution kept[2];
} st_solutions;

/* An identification of all spikes given. star_index[spikes] is the caller's, -1 where there is no
 * star. q is untouched and false_solutions infinite without a solution. */
typedef struct {
    double q[4];
    double false_solutions;
    int32_t reason;
    int32_t verified;
    int32_t expected;
    int32_t seen;
} st_identification;

#endif
