/* Rate of stars that nobody has identified, and places at a frame's time; see star_rate.c. */
#ifndef ST_STAR_RATE_H
#define ST_STAR_RATE_H

#include <stdint.h>

/* When the rows of a frame are exposed: rolling_shutter.py's RowTiming. */
typedef struct {
    double row_time_s, exposure_s, period_s, middle_row;
} st_row_timing;

/* What the expected error of a streak's centroid depends on. */
typedef struct {
    double floor_px, psf_sigma_px, electrons_per_dn, width_px; /* of the window: 2 half_window + 1 */
    double noise_before_dn, noise_now_dn;
} st_streak_error;

/* Pairs of places: where stars were and are, in the pixels of two frames. */
typedef struct {
    const double *x_before, *y_before, *x_now, *y_now;
    const double *flux_before, *flux_now;
    int32_t count;
} st_star_pairs;

#define ST_RATE_SCRATCH_DOUBLES 7 /* of st_star_rate, for each pair */

typedef struct {
    double rate_rad_s[3];
    double covariance[9];
    double change_rad_s2[3];
    double chi_square;
    int32_t left;
    int32_t solved;
} st_rate_result;

/* Time between the two of each pair, how much later than the middle between the frames its middle is, and the
 * errors of their difference along and across the motion, rad. */
void st_pair_errors(const st_star_pairs *pairs, const st_row_timing *timing, const st_streak_error *error,
                    double focal_px, double *interval_s, double *later_s, double *along_rad,
                    double *across_rad);

/* Rate of pairs of directions before[count][3], now[count][3], common_rad_s being what is wrong with all of
 * them alike; kept[count]: 1 for those it is made of.
 * residuals[count]; scratch[ST_RATE_SCRATCH_DOUBLES * count]. Returns result->solved. */
int32_t st_star_rate(const double *before, const double *now, const double *interval_s, const double *later_s,
                     const double *along_rad, const double *across_rad, int32_t count, double common_rad_s,
                     double tolerance_rad, int32_t least, int32_t *kept, double *residuals, double *scratch,
                     st_rate_result *result);

/* What is wrong with the rates of all pairs alike, rad/s: of frames that are exposed so long. */
double st_common_error(double exposure_s);

/* Directions vectors[count][3] at the frame's time, from those of their rows y_px[count]; the rate was that of
 * half a period before and changes. */
void st_turn_stars(const double *vectors, const double *y_px, int32_t count, const double *rate_rad_s,
                   const double *change_rad_s2, const st_row_timing *timing, double *turned);

/* Whether a rate is over limit_rad_s by more than three sigma of its covariance[3][3]. */
int32_t st_too_fast(const double *rate_rad_s, const double *covariance, double limit_rad_s);

/* Places x[], y[] of the paired spots brought to the frame's time by their own velocities. */
int32_t st_compensate(const double *x_before, const double *y_before, const int32_t *pair_before,
                      const int32_t *pair_now, int32_t pairs, const int32_t *extent,
                      const st_row_timing *timing, int32_t by_streak, double least_speed_px_s, double *x,
                      double *y);

/* Pairs of the spots of stars in the frame before and the one spot of their windows: star_row[stars] of the
 * catalogue, row_before[before]; star_window[stars]; spot_window[spots], by window, brightest first;
 * first_spot[windows] and stars_of[windows]: room. Returns how many. */
int32_t st_pair_windows(const int32_t *star_row, const int32_t *star_window, int32_t stars,
                        const int32_t *row_before, int32_t before, const int32_t *spot_window, int32_t spots,
                        int32_t windows, int32_t *first_spot, int32_t *stars_of, int32_t *place_before,
                        int32_t *spot);

#endif
