/* Angular rate without identification: firmware_model/rate_from_flow.py, after Fasano et al. 2013, section 2.2:
 * two equations a star, weighted least squares by QR decomposition, here with Householder's reflections, which
 * take a root for each of the three unknowns and none for a star.
 *
 * Software double precision: stars are few. Same operations in the same order as in Python, the same bits; but
 * for the one arc tangent, which is the C library's. */
#include "flow_rate.h"

#include <math.h>

enum { LEAST_STARS = 2, PASSES = 8 };

#define PRIOR_DEGREES 8.0
#define OUTLIER_SIGMA 3.5
#define RAYLEIGH_MEDIAN 1.3862943611198906 /* 2 ln 2 */
#define LEAST_VARIANCE (1.0 / 9.0)
#define LEAST_SHIFT 1e-9
#define LEAST_DIAGONAL 1e-3

static double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double *a, const double *b, double *product)
{
    product[0] = a[1] * b[2] - a[2] * b[1];
    product[1] = a[2] * b[0] - a[0] * b[2];
    product[2] = a[0] * b[1] - a[1] * b[0];
}

void st_shift_errors(const double *streak_px, const double *length_px, const double *noise, int32_t count,
                     double least_px, double *along_px, double *across_px)
{
    double floor = 2.0 * least_px * least_px;

    for (int32_t i = 0; i < count; i++) {
        double missing = streak_px[i] - length_px[i];
        double wide = noise[i] * (streak_px[i] > 1.0 ? streak_px[i] : 1.0);
        if (missing < 0.0)
            missing = 0.0;
        along_px[i] = sqrt(floor + missing * missing / 6.0 + wide * wide / 6.0);
        across_px[i] = sqrt(floor + 2.0 * (noise[i] * noise[i]));
    }
}

void st_streaks(const double *vectors, int32_t count, const double *rate_rad_s, double factor,
                double *streak_px)
{
    for (int32_t i = 0; i < count; i++, vectors += 3) {
        double moved[3];
        cross(vectors, rate_rad_s, moved);
        streak_px[i] = sqrt(dot(moved, moved)) * factor;
    }
}

/* The two equations of a star, [2][4]: along its shift and across. */
static void set_up(const double *before, const double *after, double along_rad, double across_rad,
                   const double *foreseen, double *rows)
{
    double middle[3], change[3], along[3], across[3];
    double radial, length, shorter, first, scale;

    for (int32_t i = 0; i < 3; i++) {
        middle[i] = 0.5 * (before[i] + after[i]);
        change[i] = after[i] - before[i];
        along[i] = change[i];
    }
    if (foreseen)
        cross(middle, foreseen, along);
    radial = dot(along, middle);
    for (int32_t i = 0; i < 3; i++)
        along[i] -= middle[i] * radial;
    length = sqrt(dot(along, along));
    if (length < LEAST_SHIFT) {
        along[0] = -middle[2];
        along[1] = 0.0;
        along[2] = middle[0];
        length = sqrt(middle[2] * middle[2] + middle[0] * middle[0]);
    }
    shorter = 1.0 / length;
    for (int32_t i = 0; i < 3; i++)
        along[i] *= shorter;
    first = 1.0 / along_rad;
    cross(middle, along, across);
    scale = dot(middle, middle) * (1.0 / across_rad);
    for (int32_t i = 0; i < 3; i++) {
        rows[i] = -across[i] * first;
        rows[4 + i] = along[i] * scale;
    }
    rows[3] = dot(along, change) * first;
    rows[7] = dot(across, change) * (1.0 / across_rad);
}

/* The upper triangle of the kept stars' equations, in the first three rows of turned. */
static void triangularise(const double *rows, int32_t count, const int32_t *kept, double *turned)
{
    double *end = turned;

    for (int32_t star = 0; star < count; star++, rows += 8)
        if (kept[star])
            for (int32_t i = 0; i < 8; i++)
                *end++ = rows[i];
    for (int32_t column = 0; column < 3; column++) {
        double *diagonal = turned + 5 * column;
        double *below = diagonal + 4;
        double square = 0.0;
        for (const double *row = diagonal; row < end; row += 4)
            square += *row * *row;
        double length = sqrt(square);
        double top = *diagonal;
        if (top > 0.0)
            length = -length;
        if (length == 0.0)
            continue;
        top -= length;
        double factor = 1.0 / (length * top);
        for (int32_t k = 1; k < 4 - column; k++) {
            double product = top * diagonal[k];
            for (const double *row = below; row < end; row += 4)
                product += *row * row[k];
            product *= factor;
            diagonal[k] += product * top;
            for (double *row = below; row < end; row += 4)
                row[k] += product * *row;
        }
        *diagonal = length;
    }
}

/* turn[3] from the triangle; 0 where a diagonal element vanishes. */
static int32_t solve_triangle(const double *r, double *turn)
{
    double first = fabs(r[0]);
    double least = first < fabs(r[5]) ? first : fabs(r[5]);

    if (fabs(r[10]) < least)
        least = fabs(r[10]);
    if (least <= LEAST_DIAGONAL * first)
        return 0;
    turn[2] = r[11] / r[10];
    turn[1] = (r[7] - r[6] * turn[2]) / r[5];
    turn[0] = (r[3] - r[1] * turn[1] - r[2] * turn[2]) / r[0];
    return 1;
}

/* Residuals of all stars and their order, the least first; returns the sum of the kept stars' squares. */
static double residuals(const double *rows, int32_t count, const double *turn, const int32_t *kept,
                        double *residual, int32_t *order)
{
    double squares = 0.0;

    for (int32_t star = 0; star < count; star++, rows += 8) {
        double along = rows[3] - dot(rows, turn);
        double across = rows[7] - dot(rows + 4, turn);
        double square = 0.0 + along * along;
        int32_t place = star;
        square += across * across;
        residual[star] = sqrt(square);
        if (kept[star])
            squares += square;
        for (; place > 0 && residual[order[place - 1]] > residual[star]; place--)
            order[place] = order[place - 1];
        order[place] = star;
    }
    return squares;
}

/* Keep the stars below the limit, and the first least of the order; returns whether one came or went. */
static int32_t choose(const double *residual, const int32_t *order, int32_t count, int32_t least,
                      int32_t *kept, int32_t *wanted)
{
    double median = 0.5 * (residual[order[(count - 1) / 2]] + residual[order[count / 2]]);
    double variance = median * median / RAYLEIGH_MEDIAN;
    int32_t changed = 0;

    if (variance < LEAST_VARIANCE)
        variance = LEAST_VARIANCE;
    double limit = OUTLIER_SIGMA * sqrt(2.0 * variance);
    for (int32_t rank = 0; rank < count; rank++) {
        int32_t star = order[rank];
        wanted[star] = rank < least || residual[star] <= limit;
        changed |= wanted[star] != kept[star];
    }
    if (changed)
        for (int32_t star = 0; star < count; star++)
            kept[star] = wanted[star];
    return changed;
}

/* The inverse of the triangle times its transpose, scaled. */
static void covariance_of(const double *r, double scale, double interval_s, double *covariance)
{
    double inverse[9] = {0.0};
    double a = 1.0 / r[0], b = 1.0 / r[5], c = 1.0 / r[10];

    inverse[0] = a;
    inverse[4] = b;
    inverse[8] = c;
    inverse[1] = -r[1] * a * b;
    inverse[5] = -r[6] * b * c;
    inverse[2] = -(r[1] * inverse[5] + r[2] * c) * a;
    for (int32_t i = 0; i < 3; i++)
        for (int32_t j = 0; j <= i; j++) {
            double product = 0.0;
            for (int32_t k = i; k < 3; k++)
                product += inverse[3 * i + k] * inverse[3 * j + k];
            covariance[3 * i + j] = scale * product / (interval_s * interval_s);
            covariance[3 * j + i] = covariance[3 * i + j];
        }
}

int32_t st_flow_rate(const double *before, const double *after, int32_t count, double interval_s,
                     const double *along_rad, const double *across_rad, const double *foreseen, double *room,
                     int32_t *order, double *residual, int32_t *kept, st_flow_rate_result *result)
{
    double *rows = room;
    double *turned = room + 8 * count;
    int32_t least = (2 * count + 2) / 3;
    double turn[3];
    double spread = 1.0;

    if (count < LEAST_STARS || interval_s <= 0.0)
        return 0;
    if (least < LEAST_STARS)
        least = LEAST_STARS;
    for (int32_t star = 0; star < count; star++) {
        set_up(before + 3 * star, after + 3 * star, along_rad[star], across_rad[star], foreseen,
               rows + 8 * star);
        kept[star] = 1;
    }
    for (int32_t pass = 0; pass < PASSES; pass++) {
        int32_t degrees = -3;
        triangularise(rows, count, kept, turned);
        if (!solve_triangle(turned, turn))
            return 0;
        for (int32_t star = 0; star < count; star++)
            degrees += 2 * kept[star];
        if (degrees < 0)
            degrees = 0;
        spread = (PRIOR_DEGREES + residuals(rows, count, turn, kept, residual, order)) /
                 (PRIOR_DEGREES + degrees);
        if (spread < 1.0)
            spread = 1.0;
        if (!choose(residual, order, count, least, kept, order + count))
            break;
    }
    covariance_of(turned, spread, interval_s, result->covariance_rad2_s2);
    double size = sqrt(dot(turn, turn)); /* 2 tan(a / 2) of the angle a */
    double angle = 2.0 * atan(0.5 * size);
    double scale = (size > 0.0 ? angle / size : 1.0) / interval_s;
    for (int32_t i = 0; i < 3; i++)
        result->rate_rad_s[i] = turn[i] * scale;
    return 1;
}
