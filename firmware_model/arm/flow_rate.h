/* Angular rate from the directions of stars in two frames; see flow_rate.c. */
#ifndef ST_FLOW_RATE_H
#define ST_FLOW_RATE_H

#include "star_tracker.h"

/* Doubles and words of the room that st_flow_rate takes for each star. */
#define ST_FLOW_RATE_DOUBLES 16
#define ST_FLOW_RATE_WORDS 2

typedef struct {
    double rate_rad_s[3];
    double covariance_rad2_s2[9];
} st_flow_rate_result;

/* Expected errors of shifts, px, along and across, where streaks are so long. length_px, noise: of the stars. */
void st_shift_errors(const double *streak_px, const double *length_px, const double *noise, int32_t count,
                     double least_px, double *along_px, double *across_px);

/* How long the streaks of stars in these directions are at a rate: its factor times the length of the arc. */
void st_streaks(const double *vectors, int32_t count, const double *rate_rad_s, double factor,
                double *streak_px);

/* The rate from unit vectors [count][3] of the same stars before and after an interval. along_rad, across_rad:
 * expected errors of their shifts; foreseen: double[3], a rate, or none: 0. room:
 * ST_FLOW_RATE_DOUBLES count, order: ST_FLOW_RATE_WORDS count. residual[count]: in expected errors; kept[count].
 * Returns 0 where there is no rate: too few stars, or all in one direction. */
int32_t st_flow_rate(const double *before, const double *after, int32_t count, double interval_s,
                     const double *along_rad, const double *across_rad, const double *foreseen, double *room,
                     int32_t *order, double *residual, int32_t *kept, st_flow_rate_result *result);

#endif
