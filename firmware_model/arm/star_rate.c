/* Rate without identification and rolling shutter: the kernels of firmware_model/star_rate.py, star_motion.py
 * and image/rolling_shutter.py, after Schiattarella et al. 2020, section 3.2. Software double precision, as
 * there are few stars; operations in the order of the Python kernels, so the same bits but for atan and hypot
 * of the C library. */
#include "star_rate.h"

#include <math.h>

#define DEGENERATE_INFORMATION 1.25e-9 /* an eighth of the ratio of smallest to largest, 1e-8 */
#define EXPECTED_CHANGE 0.017453292519943295 /* rad/s^2: 1 deg/s^2 */
#define EXPECTED_JERK 0.01308996938995747 /* rad/s^3: 0.75 deg/s^3 */
#define SIGNIFICANT_CHANGE 14.156
#define WORST_OF_TWO 9.0
#define WORST_OF_THREE 14.156
#define ROWS 6 /* of a star's two equations, before what was seen */

static double floored(double flux)
{
    return flux > 1.0 ? flux : 1.0;
}

/* Variances of a streak's centroid along it and across. */
static void streak_variances(const st_streak_error *error, double flux, double noise, double length,
                             double *along, double *across)
{
    double photons = 1.0 / (flux * error->electrons_per_dn);
    double share = noise / flux;
    double dark = share * share;
    double width = error->width_px;
    double longer = width + length;
    double fixed = error->floor_px * error->floor_px + error->psf_sigma_px * error->psf_sigma_px * photons;
    double strip = width * longer;

    *along = fixed + length * length / 12.0 * photons + strip * (longer * longer - 1.0) / 12.0 * dark;
    *across = fixed + strip * (width * width - 1.0) / 12.0 * dark;
}

void st_pair_errors(const st_star_pairs *pairs, const st_row_timing *timing, const st_streak_error *error,
                    double focal_px, double *interval_s, double *later_s, double *along_rad,
                    double *across_rad)
{
    for (int32_t i = 0; i < pairs->count; i++) {
        double interval = timing->period_s + timing->row_time_s * (pairs->y_now[i] - pairs->y_before[i]);
        double later = timing->row_time_s *
                       (0.5 * (pairs->y_before[i] + pairs->y_now[i]) - timing->middle_row);
        double bend = EXPECTED_JERK * (0.5 * later * later + timing->exposure_s * timing->exposure_s / 24.0) *
                      interval;
        double across = pairs->x_now[i] - pairs->x_before[i];
        double down = pairs->y_now[i] - pairs->y_before[i];
        double least = 0.5 * timing->period_s;
        double length = sqrt(across * across + down * down) * timing->exposure_s /
                        (interval > least ? interval : least);
        double along_1, along_2, across_1, across_2;
        streak_variances(error, floored(pairs->flux_before[i]), error->noise_before_dn, length, &along_1,
                         &across_1);
        streak_variances(error, floored(pairs->flux_now[i]), error->noise_now_dn, length, &along_2,
                         &across_2);
        interval_s[i] = interval;
        later_s[i] = later;
        along_rad[i] = sqrt((along_1 + along_2) / (focal_px * focal_px) + bend * bend);
        across_rad[i] = sqrt((across_1 + across_2) / (focal_px * focal_px) + bend * bend);
    }
}

double st_common_error(double exposure_s)
{
    return EXPECTED_JERK * exposure_s * exposure_s / 24.0;
}

/* Inverse of a symmetric matrix that is positive definite; 0 where it is degenerate. */
static int32_t invert(const double *matrix, double *inverse)
{
    double xx = matrix[0], yy = matrix[4], zz = matrix[8];
    double xy = matrix[1], xz = matrix[2], yz = matrix[5];
    double c00 = yy * zz - yz * yz;
    double c01 = xz * yz - xy * zz;
    double c02 = xy * yz - xz * yy;
    double determinant = xx * c00 + xy * c01 + xz * c02;
    double trace = xx + yy + zz;
    if (!(determinant > DEGENERATE_INFORMATION * trace * trace * trace))
        return 0;
    double scale = 1.0 / determinant;
    inverse[0] = scale * c00;
    inverse[1] = inverse[3] = scale * c01;
    inverse[2] = inverse[6] = scale * c02;
    inverse[4] = scale * (xx * zz - xz * xz);
    inverse[5] = inverse[7] = scale * (xy * xz - xx * yz);
    inverse[8] = scale * (xx * yy - xy * xy);
    return 1;
}

/* The kept stars' normal equations of p, of its growth, and of both; upper triangles. */
typedef struct {
    double of_p[9], of_both[9], of_growth[9];
    double right[3], right_growth[3];
} normal_equations;

static void sum_stars(const double *rows, const double *seen, const double *later_s, const int32_t *kept,
                      int32_t count, double expected, normal_equations *sum)
{
    *sum = (normal_equations){{0.0}, {0.0}, {0.0}, {0.0}, {0.0}};
    for (int32_t i = 0; i < count; i++) {
        const double *row = rows + ROWS * i;
        double later = later_s[i];
        if (!kept[i])
            continue;
        for (int32_t m = 0; m < 3; m++) {
            double along = row[m] * seen[i];
            sum->right[m] += along;
            sum->right_growth[m] += later * along;
            for (int32_t n = m; n < 3; n++) {
                double product = row[m] * row[n] + row[3 + m] * row[3 + n];
                sum->of_p[3 * m + n] += product;
                product *= later;
                sum->of_both[3 * m + n] += product;
                sum->of_growth[3 * m + n] += later * product;
            }
        }
    }
    for (int32_t m = 0; m < 3; m++) {
        sum->of_growth[4 * m] += expected;
        for (int32_t n = 0; n < m; n++)
            sum->of_both[3 * m + n] = sum->of_both[3 * n + m];
    }
}

/* Least squares of the kept stars: p, its growth and the covariance of p; 0 where degenerate. */
static int32_t solve(normal_equations *sum, double *p, double *growth, double *covariance,
                     double *significance)
{
    double alone[9], share[9], rest[9], inverse[9];
    const double *both = sum->of_both;
    if (!invert(sum->of_p, alone))
        return 0;
    for (int32_t m = 0; m < 3; m++)
        for (int32_t n = 0; n < 3; n++)
            share[3 * m + n] = alone[3 * m] * both[n] + alone[3 * m + 1] * both[3 + n] +
                               alone[3 * m + 2] * both[6 + n];
    for (int32_t m = 0; m < 3; m++) {
        sum->right_growth[m] -= share[m] * sum->right[0] + share[3 + m] * sum->right[1] +
                                share[6 + m] * sum->right[2];
        for (int32_t n = m; n < 3; n++) {
            double taken = both[m] * share[n] + both[3 + m] * share[3 + n] + both[6 + m] * share[6 + n];
            rest[3 * m + n] = rest[3 * n + m] = sum->of_growth[3 * m + n] - taken;
        }
    }
    if (!invert(rest, inverse))
        return 0;
    *significance = 0.0;
    for (int32_t m = 0; m < 3; m++) {
        growth[m] = inverse[3 * m] * sum->right_growth[0] + inverse[3 * m + 1] * sum->right_growth[1] +
                    inverse[3 * m + 2] * sum->right_growth[2];
        *significance += growth[m] * sum->right_growth[m];
    }
    for (int32_t m = 0; m < 3; m++) {
        p[m] = alone[3 * m] * sum->right[0] + alone[3 * m + 1] * sum->right[1] +
               alone[3 * m + 2] * sum->right[2];
        p[m] -= share[3 * m] * growth[0] + share[3 * m + 1] * growth[1] + share[3 * m + 2] * growth[2];
        for (int32_t n = 0; n < 3; n++) {
            covariance[3 * m + n] = alone[3 * m + n];
            for (int32_t k = 0; k < 3; k++)
                covariance[3 * m + n] += (inverse[3 * k] * share[3 * n] +
                                          inverse[3 * k + 1] * share[3 * n + 1] +
                                          inverse[3 * k + 2] * share[3 * n + 2]) *
                                         share[3 * m + k];
        }
    }
    return 1;
}

/* The two equations of a star, in sigmas. Returns what was seen along the motion. */
static double equations(const double *before, const double *now, double share, double along, double across,
                        double *rows)
{
    double ax = now[0] - before[0], ay = now[1] - before[1], az = now[2] - before[2];
    double mx = now[0] + before[0], my = now[1] + before[1], mz = now[2] + before[2];
    double moved = sqrt(ax * ax + ay * ay + az * az);
    if (moved < 1e-12) {
        double length = sqrt(mz * mz + mx * mx);
        ax = length == 0.0 ? 1.0 : mz / length;
        ay = 0.0;
        az = length == 0.0 ? 0.0 : -mx / length;
    } else {
        ax /= moved;
        ay /= moved;
        az /= moved;
    }
    double bx = ay * mz - az * my, by = az * mx - ax * mz, bz = ax * my - ay * mx;
    double size = sqrt(mx * mx + my * my + mz * mz);
    double scale = share / along;
    rows[0] = bx * scale;
    rows[1] = by * scale;
    rows[2] = bz * scale;
    scale = share / (across * size);
    rows[3] = (by * mz - bz * my) * scale;
    rows[4] = (bz * mx - bx * mz) * scale;
    rows[5] = (bx * my - by * mx) * scale;
    return moved / along;
}

int32_t st_star_rate(const double *before, const double *now, const double *interval_s, const double *later_s,
                     const double *along_rad, const double *across_rad, int32_t count, double common_rad_s,
                     double tolerance_rad, int32_t least, int32_t *kept, double *residuals, double *scratch,
                     st_rate_result *result)
{
    double *rows = scratch;
    double *seen = scratch + ROWS * count;
    double mean_s = 0.0;
    double chi_square, significance, expected;
    double p[3], growth[3];
    normal_equations sum;
    int32_t left = count;
    result->solved = 0;
    result->left = left;
    if (left < least)
        return 0;
    for (int32_t i = 0; i < count; i++)
        mean_s += interval_s[i];
    mean_s /= count;
    expected = 2.0 / (EXPECTED_CHANGE * mean_s);
    expected *= expected;
    for (int32_t i = 0; i < count; i++) {
        kept[i] = 1;
        seen[i] = equations(before + 3 * i, now + 3 * i, interval_s[i] / mean_s, along_rad[i], across_rad[i],
                            rows + ROWS * i);
    }
    for (;;) {
        int32_t worst = -1;
        double worst_off = 0.0;
        sum_stars(rows, seen, later_s, kept, count, expected, &sum);
        if (!solve(&sum, p, growth, result->covariance, &significance))
            return 0;
        chi_square = expected * (growth[0] * growth[0] + growth[1] * growth[1] + growth[2] * growth[2]);
        for (int32_t i = 0; i < count; i++) {
            const double *row = rows + ROWS * i;
            double x = p[0] + later_s[i] * growth[0];
            double y = p[1] + later_s[i] * growth[1];
            double z = p[2] + later_s[i] * growth[2];
            double off_along = seen[i] - (row[0] * x + row[1] * y + row[2] * z);
            double off_across = row[3] * x + row[4] * y + row[5] * z;
            double off = off_along * off_along + off_across * off_across;
            double along = off_along * along_rad[i], across = off_across * across_rad[i];
            residuals[i] = sqrt(along * along + across * across);
            if (!kept[i])
                continue;
            chi_square += off;
            if (off > worst_off && residuals[i] > tolerance_rad && off > 9.0) {
                worst = i;
                worst_off = off;
            }
        }
        if (worst < 0)
            break;
        kept[worst] = 0;
        left--;
        result->left = left;
        if (left < least)
            return 0;
    }
    if ((left == 2 && chi_square > WORST_OF_TWO) || (left == 3 && chi_square > WORST_OF_THREE))
        return 0;
    double size = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    double factor = (size > 1e-12 ? 2.0 * atan(size) / size : 2.0) / mean_s;
    double scale = 4.0 / (mean_s * mean_s);
    int32_t freedom = 2 * left - 3;
    double spread = 1.0;
    if (chi_square > freedom) {
        spread = chi_square / freedom;
        scale *= spread;
    }
    for (int32_t m = 0; m < 3; m++) {
        result->rate_rad_s[m] = p[m] * factor;
        result->change_rad_s2[m] = significance > SIGNIFICANT_CHANGE * spread ? 2.0 * growth[m] / mean_s
                                                                              : 0.0;
    }
    for (int32_t m = 0; m < 9; m++)
        result->covariance[m] *= scale;
    for (int32_t m = 0; m < 3; m++)
        result->covariance[4 * m] += common_rad_s * common_rad_s;
    result->chi_square = chi_square;
    result->solved = 1;
    return 1;
}

void st_turn_stars(const double *vectors, const double *y_px, int32_t count, const double *rate_rad_s,
                   const double *change_rad_s2, const st_row_timing *timing, double *turned)
{
    double beside = timing->exposure_s * timing->exposure_s / 48.0;
    for (int32_t i = 0; i < count; i++) {
        const double *u = vectors + 3 * i;
        double half = 0.5 * (timing->row_time_s * (timing->middle_row - y_px[i]));
        double later = 0.5 * timing->period_s - half;
        double rate_x = rate_rad_s[0] + later * change_rad_s2[0];
        double rate_y = rate_rad_s[1] + later * change_rad_s2[1];
        double rate_z = rate_rad_s[2] + later * change_rad_s2[2];
        half *= 1.0 + half * half * (rate_x * rate_x + rate_y * rate_y + rate_z * rate_z) / 3.0;
        double px = rate_x * half - beside * change_rad_s2[0];
        double py = rate_y * half - beside * change_rad_s2[1];
        double pz = rate_z * half - beside * change_rad_s2[2];
        double pp = px * px + py * py + pz * pz;
        double pu = 2.0 * (px * u[0] + py * u[1] + pz * u[2]);
        double rest = 1.0 - pp;
        double scale = 1.0 / (1.0 + pp);
        turned[3 * i] = (rest * u[0] - 2.0 * (py * u[2] - pz * u[1]) + pu * px) * scale;
        turned[3 * i + 1] = (rest * u[1] - 2.0 * (pz * u[0] - px * u[2]) + pu * py) * scale;
        turned[3 * i + 2] = (rest * u[2] - 2.0 * (px * u[1] - py * u[0]) + pu * pz) * scale;
    }
}

int32_t st_too_fast(const double *rate_rad_s, const double *covariance, double limit_rad_s)
{
    double rate = sqrt(rate_rad_s[0] * rate_rad_s[0] + rate_rad_s[1] * rate_rad_s[1] +
                       rate_rad_s[2] * rate_rad_s[2]);
    double variance = 0.0;
    if (rate <= limit_rad_s)
        return 0;
    for (int32_t m = 0; m < 3; m++)
        for (int32_t n = 0; n < 3; n++)
            variance += rate_rad_s[m] / rate * covariance[3 * m + n] * (rate_rad_s[n] / rate);
    return rate > limit_rad_s + 3.0 * sqrt(variance);
}

int32_t st_compensate(const double *x_before, const double *y_before, const int32_t *pair_before,
                      const int32_t *pair_now, int32_t pairs, const int32_t *extent,
                      const st_row_timing *timing, int32_t by_streak, double least_speed_px_s, double *x,
                      double *y)
{
    int32_t moved = 0;
    for (int32_t pair = 0; pair < pairs; pair++) {
        int32_t i = pair_before[pair];
        int32_t j = pair_now[pair];
        double across = x[j] - x_before[i];
        double down = y[j] - y_before[i];
        double lit_s, speed_x, speed_y;
        if (by_streak) {
            const int32_t *box = &extent[4 * j];
            double length_x = box[1] - box[0];
            double length_y = box[3] - box[2];
            double late_s = timing->row_time_s * length_y;
            lit_s = down >= 0.0 ? timing->exposure_s + late_s : timing->exposure_s - late_s;
            speed_x = (across >= 0.0 ? length_x : -length_x) / lit_s;
            speed_y = (down >= 0.0 ? length_y : -length_y) / lit_s;
        } else {
            lit_s = timing->period_s + timing->row_time_s * down;
            speed_x = across / lit_s;
            speed_y = down / lit_s;
        }
        if (lit_s <= 0.0 || speed_x * speed_x + speed_y * speed_y < least_speed_px_s * least_speed_px_s)
            continue;
        double until_s = timing->row_time_s * (timing->middle_row - y[j]);
        x[j] += speed_x * until_s;
        y[j] += speed_y * until_s;
        moved++;
    }
    return moved;
}

int32_t st_pair_windows(const int32_t *star_row, const int32_t *star_window, int32_t stars,
                        const int32_t *row_before, int32_t before, const int32_t *spot_window, int32_t spots,
                        int32_t windows, int32_t *first_spot, int32_t *stars_of, int32_t *place_before,
                        int32_t *spot)
{
    int32_t pairs = 0;
    for (int32_t window = 0; window < windows; window++) {
        first_spot[window] = -1;
        stars_of[window] = 0;
    }
    for (int32_t i = spots - 1; i >= 0; i--)
        first_spot[spot_window[i]] = i;
    for (int32_t i = 0; i < stars; i++)
        stars_of[star_window[i]]++;
    for (int32_t i = 0; i < stars; i++) {
        int32_t window = star_window[i];
        int32_t place = 0;
        if (stars_of[window] != 1 || first_spot[window] < 0)
            continue;
        while (place < before && row_before[place] != star_row[i])
            place++;
        if (place == before)
            continue;
        place_before[pairs] = place;
        spot[pairs++] = first_spot[window];
    }
    return pairs;
}
