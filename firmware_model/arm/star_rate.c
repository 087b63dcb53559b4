/* Rate without identification and rolling shutter: the kernels of firmware_model/star_rate.py, star_motion.py
 * and image/rolling_shutter.py, after Schiattarella et al. 2020, section 3.2. Software double precision, as
 * there are few stars; operations in the order of the Python kernels, so the same bits but for atan and hypot
 * of the C library. */
#include "star_rate.h"

#include <math.h>

#define DEGENERATE_INFORMATION 1.25e-9 /* an eighth of the ratio of smallest to largest, 1e-8 */
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
                    double focal_px, double *interval_s, double *along_rad, double *across_rad)
{
    for (int32_t i = 0; i < pairs->count; i++) {
        double since = pairs->before_is_of_the_frame ? timing->middle_row : pairs->y_before[i];
        double interval = timing->period_s + timing->row_time_s * (pairs->y_now[i] - since);
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
        along_rad[i] = sqrt(along_1 + along_2) / focal_px;
        across_rad[i] = sqrt(across_1 + across_2) / focal_px;
    }
}

/* Least squares of the kept stars; 0 where degenerate. */
static int32_t solve(const double *rows, const double *seen, const int32_t *kept, int32_t count, double *p,
                     double *inverse)
{
    double xx = 0.0, yy = 0.0, zz = 0.0, xy = 0.0, xz = 0.0, yz = 0.0;
    double rx = 0.0, ry = 0.0, rz = 0.0;
    for (int32_t i = 0; i < count; i++) {
        const double *row = rows + ROWS * i;
        if (!kept[i])
            continue;
        for (int32_t half = 0; half < 2; half++) {
            double x = row[3 * half], y = row[3 * half + 1], z = row[3 * half + 2];
            xx += x * x;
            yy += y * y;
            zz += z * z;
            xy += x * y;
            xz += x * z;
            yz += y * z;
        }
        rx += row[0] * seen[i];
        ry += row[1] * seen[i];
        rz += row[2] * seen[i];
    }
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
    for (int32_t m = 0; m < 3; m++)
        p[m] = inverse[3 * m] * rx + inverse[3 * m + 1] * ry + inverse[3 * m + 2] * rz;
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

int32_t st_star_rate(const double *before, const double *now, const double *interval_s,
                     const double *along_rad, const double *across_rad, int32_t count, double tolerance_rad,
                     int32_t least, int32_t *kept, double *residuals, double *scratch, st_rate_result *result)
{
    double *rows = scratch;
    double *seen = scratch + ROWS * count;
    double mean_s = 0.0;
    double chi_square;
    double p[3];
    int32_t left = count;
    result->solved = 0;
    result->left = left;
    if (left < least)
        return 0;
    for (int32_t i = 0; i < count; i++)
        mean_s += interval_s[i];
    mean_s /= count;
    for (int32_t i = 0; i < count; i++) {
        kept[i] = 1;
        seen[i] = equations(before + 3 * i, now + 3 * i, interval_s[i] / mean_s, along_rad[i], across_rad[i],
                            rows + ROWS * i);
    }
    for (;;) {
        int32_t worst = -1;
        double worst_off = 0.0;
        if (!solve(rows, seen, kept, count, p, result->covariance))
            return 0;
        chi_square = 0.0;
        for (int32_t i = 0; i < count; i++) {
            const double *row = rows + ROWS * i;
            double off_along = seen[i] - (row[0] * p[0] + row[1] * p[1] + row[2] * p[2]);
            double off_across = row[3] * p[0] + row[4] * p[1] + row[5] * p[2];
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
    double size = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    double factor = (size > 1e-12 ? 2.0 * atan(size) / size : 2.0) / mean_s;
    double scale = 4.0 / (mean_s * mean_s);
    int32_t freedom = 2 * left - 3;
    if (chi_square > freedom)
        scale *= chi_square / freedom;
    for (int32_t m = 0; m < 3; m++)
        result->rate_rad_s[m] = p[m] * factor;
    for (int32_t m = 0; m < 9; m++)
        result->covariance[m] *= scale;
    result->chi_square = chi_square;
    result->solved = 1;
    return 1;
}

void st_turn_stars(const double *vectors, const double *y_px, int32_t count, const double *rate_rad_s,
                   const st_row_timing *timing, double *turned)
{
    double square_rate = rate_rad_s[0] * rate_rad_s[0] + rate_rad_s[1] * rate_rad_s[1] +
                         rate_rad_s[2] * rate_rad_s[2];
    for (int32_t i = 0; i < count; i++) {
        const double *u = vectors + 3 * i;
        double half = 0.5 * (timing->row_time_s * (timing->middle_row - y_px[i]));
        half *= 1.0 + half * half * square_rate / 3.0;
        double px = rate_rad_s[0] * half, py = rate_rad_s[1] * half, pz = rate_rad_s[2] * half;
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
                      const int32_t *pair_now, int32_t pairs, const int32_t *extent, const st_row_timing *timing,
                      int32_t by_streak, double least_speed_px_s, double *x, double *y)
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

int32_t st_pair_windows(const int32_t *star_window, int32_t stars, const int32_t *spot_window, int32_t spots,
                        int32_t windows, int32_t *first_spot, int32_t *stars_of, int32_t *star, int32_t *spot)
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
        if (stars_of[window] != 1 || first_spot[window] < 0)
            continue;
        star[pairs] = i;
        spot[pairs++] = first_spot[window];
    }
    return pairs;
}
