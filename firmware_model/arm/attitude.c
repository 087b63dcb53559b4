/* Attitude from vector pairs: the kernels of firmware_model/attitude.py (Davenport's q-method by cyclic
 * Jacobi, residuals, covariance), the expected error of centroids of firmware_model/configuration.py and the
 * chance of a false solution of firmware_model/identification/judgement.py.
 *
 * All is software double precision: the eigenvalues of a narrow field differ by the square of its radius,
 * about 1e-4 of the largest, and an attitude to 1e-9 rad needs their gap to 1e-13. There are few stars, so
 * that fixed point would save little of a frame. Operations are in the order of the Python kernels: the same
 * bits but for asin, acos, sin, log, lgamma and exp of the C library. */
#include "attitude.h"

#include <math.h>

#define MOST_SWEEPS 30
#define OFF_DIAGONAL_SHARE 1e-34      /* a sum of squares over the diagonal's: converged */
#define DEGENERATE_INFORMATION 1.25e-9 /* an eighth of the ratio of smallest to largest, 1e-8 */

void st_jacobi_rotation(double *k, double *v, int32_t p, int32_t q)
{
    double theta = (k[5 * q] - k[5 * p]) / (2.0 * k[4 * p + q]);
    double t = 1.0 / (fabs(theta) + sqrt(theta * theta + 1.0));
    double c, s;
    int32_t i;

    if (theta < 0.0)
        t = -t;
    c = 1.0 / sqrt(t * t + 1.0);
    s = t * c;
    for (i = 0; i < 4; i++) {
        double left = k[4 * i + p];
        double right = k[4 * i + q];
        k[4 * i + p] = c * left - s * right;
        k[4 * i + q] = s * left + c * right;
    }
    for (i = 0; i < 4; i++) {
        double left = k[4 * p + i];
        double right = k[4 * q + i];
        k[4 * p + i] = c * left - s * right;
        k[4 * q + i] = s * left + c * right;
    }
    for (i = 0; i < 4; i++) {
        double left = v[4 * i + p];
        double right = v[4 * i + q];
        v[4 * i + p] = c * left - s * right;
        v[4 * i + q] = s * left + c * right;
    }
}

/* Whether what is off the diagonal no longer matters. */
static int32_t converged(const double *k)
{
    double off = 0.0;
    double diagonal = 0.0;
    int32_t p, q;

    for (p = 0; p < 3; p++)
        for (q = p + 1; q < 4; q++)
            off += k[4 * p + q] * k[4 * p + q];
    for (p = 0; p < 4; p++)
        diagonal += k[5 * p] * k[5 * p];
    return off <= OFF_DIAGONAL_SHARE * diagonal;
}

int32_t st_largest_eigenvector(double *k, double *vector)
{
    double v[16];
    double norm = 0.0;
    int32_t rotations = 0;
    int32_t largest = 0;
    int32_t sweep, p, q, i;

    for (i = 0; i < 16; i++)
        v[i] = i % 5 == 0 ? 1.0 : 0.0;
    for (sweep = 0; sweep < MOST_SWEEPS && !converged(k); sweep++)
        for (p = 0; p < 3; p++)
            for (q = p + 1; q < 4; q++)
                if (k[4 * p + q] != 0.0) {
                    st_jacobi_rotation(k, v, p, q);
                    rotations++;
                }
    for (i = 1; i < 4; i++)
        if (k[5 * i] > k[5 * largest])
            largest = i;
    for (i = 0; i < 4; i++)
        norm += v[4 * i + largest] * v[4 * i + largest];
    norm = sqrt(norm);
    if (v[12 + largest] < 0.0)
        norm = -norm;
    for (i = 0; i < 4; i++)
        vector[i] = v[4 * i + largest] / norm;
    return rotations;
}

void st_matrix(const double *q, double *a)
{
    double x = q[0], y = q[1], z = q[2], w = q[3];

    a[0] = w * w + x * x - y * y - z * z;
    a[1] = 2.0 * (x * y + w * z);
    a[2] = 2.0 * (x * z - w * y);
    a[3] = 2.0 * (x * y - w * z);
    a[4] = w * w - x * x + y * y - z * z;
    a[5] = 2.0 * (y * z + w * x);
    a[6] = 2.0 * (x * z + w * y);
    a[7] = 2.0 * (y * z - w * x);
    a[8] = w * w - x * x - y * y + z * z;
}

void st_quaternion(const double *b, const double *r, const double *weights, int32_t count, double *q)
{
    double profile[9] = {0.0};
    double k[16];
    double trace;
    int32_t i, m, n;

    for (i = 0; i < count; i++)
        for (m = 0; m < 3; m++) {
            double weighted = weights[i] * b[3 * i + m];
            for (n = 0; n < 3; n++)
                profile[3 * m + n] += weighted * r[3 * i + n];
        }
    trace = profile[0] + profile[4] + profile[8];
    for (m = 0; m < 3; m++) {
        for (n = 0; n < 3; n++)
            k[4 * m + n] = profile[3 * m + n] + profile[3 * n + m];
        k[5 * m] -= trace;
    }
    k[3] = k[12] = profile[5] - profile[7];
    k[7] = k[13] = profile[6] - profile[2];
    k[11] = k[14] = profile[1] - profile[3];
    k[15] = trace;
    st_largest_eigenvector(k, q);
}

void st_residuals(const double *b, const double *r, int32_t count, const double *q, double *residuals)
{
    double a[9];
    int32_t i, m;

    st_matrix(q, a);
    for (i = 0; i < count; i++, b += 3, r += 3) {
        double square = 0.0;
        double half;
        for (m = 0; m < 3; m++) {
            double difference = b[m] - (a[3 * m] * r[0] + a[3 * m + 1] * r[1] + a[3 * m + 2] * r[2]);
            square += difference * difference;
        }
        half = 0.5 * sqrt(square);
        residuals[i] = 2.0 * asin(half < 1.0 ? half : 1.0);
    }
}

int32_t st_covariance(const double *b, const double *weights, int32_t count, double *covariance)
{
    double xx = 0.0, yy = 0.0, zz = 0.0, xy = 0.0, xz = 0.0, yz = 0.0;
    double c00, c01, c02, determinant, trace, scale;
    int32_t i;

    for (i = 0; i < count; i++, b += 3) {
        double w = weights[i];
        xx += w * (1.0 - b[0] * b[0]);
        yy += w * (1.0 - b[1] * b[1]);
        zz += w * (1.0 - b[2] * b[2]);
        xy -= w * b[0] * b[1];
        xz -= w * b[0] * b[2];
        yz -= w * b[1] * b[2];
    }
    c00 = yy * zz - yz * yz;
    c01 = xz * yz - xy * zz;
    c02 = xy * yz - xz * yy;
    determinant = xx * c00 + xy * c01 + xz * c02;
    trace = xx + yy + zz;
    for (i = 0; i < 9; i++)
        covariance[i] = 0.0;
    if (!(determinant > DEGENERATE_INFORMATION * (trace * (trace * trace))))
        return 0;
    scale = 1.0 / determinant;
    covariance[0] = scale * c00;
    covariance[1] = covariance[3] = scale * c01;
    covariance[2] = covariance[6] = scale * c02;
    covariance[4] = scale * (xx * zz - xz * xz);
    covariance[5] = covariance[7] = scale * (xy * xz - xx * yz);
    covariance[8] = scale * (xx * yy - xy * xy);
    return 1;
}

/* chi^2, with which the covariance grows where it is more than its degrees of freedom. */
static double fit_of(const double *weights, const double *residuals, int32_t count, double *covariance)
{
    double chi_square = 0.0;
    double freedom = 2 * count - 3;
    int32_t i;

    for (i = 0; i < count; i++)
        chi_square += weights[i] * residuals[i] * residuals[i];
    if (chi_square > freedom)
        for (i = 0; i < 9; i++)
            covariance[i] *= chi_square / freedom;
    return chi_square;
}

int32_t st_solve_attitude(const double *b, const double *r, const double *weights, int32_t count, double *q,
                          double *residuals, double *covariance, double *chi_square)
{
    *chi_square = 0.0;
    if (!st_covariance(b, weights, count, covariance))
        return 0;
    st_quaternion(b, r, weights, count, q);
    st_residuals(b, r, count, q, residuals);
    *chi_square = fit_of(weights, residuals, count, covariance);
    return 1;
}

/* Closes the gap that star `gone` leaves in arrays of `left` stars. */
static void take_out(double *b, double *r, double *s, int32_t *place, int32_t gone, int32_t left)
{
    int32_t i, m;

    for (i = gone; i < left - 1; i++) {
        for (m = 0; m < 3; m++) {
            b[3 * i + m] = b[3 * i + 3 + m];
            r[3 * i + m] = r[3 * i + 3 + m];
        }
        s[i] = s[i + 1];
        place[i] = place[i + 1];
    }
}

int32_t st_robust_attitude(const double *measured, const double *reference, const double *sigma_rad,
                           int32_t count, double tolerance_rad, int32_t least, int32_t *kept,
                           double *residuals, double *scratch, st_attitude_result *result)
{
    double *b = scratch;
    double *r = b + 3 * count;
    double *s = r + 3 * count;
    double *weights = s + count;
    int32_t *place = (int32_t *)(weights + count);
    int32_t left = count;
    int32_t i, pass, worst;

    for (i = 0; i < 3 * count; i++) {
        b[i] = measured[i];
        r[i] = reference[i];
    }
    for (i = 0; i < count; i++) {
        s[i] = sigma_rad[i];
        weights[i] = 1.0;
        place[i] = i;
        kept[i] = 1;
    }
    if (least < 2)
        least = 2;
    result->chi_square = 0.0;
    result->solved = 0;
    result->left = left;
    if (left < least || !st_covariance(b, weights, left, result->covariance))
        return 0;
    for (;;) {
        st_quaternion(b, r, weights, left, result->q);
        st_residuals(b, r, left, result->q, residuals);
        worst = 0;
        for (i = 1; i < left; i++)
            if (residuals[i] > residuals[worst])
                worst = i;
        if (residuals[worst] <= tolerance_rad)
            break;
        kept[place[worst]] = 0;
        take_out(b, r, s, place, worst, left);
        result->left = --left;
        if (left < least)
            return 0;
    }
    for (pass = 0; pass < 3; pass++) {
        for (i = 0; i < left; i++) {
            double third = residuals[i] / 3.0;
            double spread = s[i] > third ? s[i] : third;
            weights[i] = 1.0 / (spread * spread);
        }
        st_quaternion(b, r, weights, left, result->q);
        st_residuals(b, r, left, result->q, residuals);
    }
    if (!st_covariance(b, weights, left, result->covariance))
        return 0;
    result->chi_square = fit_of(weights, residuals, left, result->covariance);
    result->solved = 1;
    return 1;
}

void st_centroid_sigma_rad(const double *flux_dn, int32_t count, double noise_dn,
                           const st_centroid_error *error, double focal_px, double *sigma_rad)
{
    double floor_square = error->floor_px * error->floor_px;
    double photon_square = error->photon_px * error->photon_px;
    double window_noise = error->window_factor * noise_dn;
    int32_t i;

    for (i = 0; i < count; i++) {
        double flux = flux_dn[i] > 1.0 ? flux_dn[i] : 1.0;
        double background = window_noise / flux;
        double variance = floor_square + photon_square / (flux * error->electrons_per_dn);
        sigma_rad[i] = sqrt(variance + background * background) / focal_px;
    }
}

double st_false_solutions(int32_t stars, int32_t spots, int32_t matched, double spread_rad,
                          double tolerance_rad)
{
    const double pi = 3.14159265358979323846;
    double density, ways, ring, circle, logarithm;

    if (matched < 3 || matched > spots || stars < 1)
        return HUGE_VAL;
    density = stars / (4.0 * pi);
    ways = lgamma(spots + 1.0) - lgamma(matched + 1.0) - lgamma((double)(spots - matched) + 1.0);
    ring = density * 4.0 * pi * sin(spread_rad > tolerance_rad ? spread_rad : tolerance_rad) * tolerance_rad;
    circle = density * pi * tolerance_rad * tolerance_rad;
    logarithm = ways + log(stars * ring) + (matched - 2) * log(circle);
    return exp(logarithm < 700.0 ? logarithm : 700.0);
}

double st_spread(const double *b, int32_t count)
{
    double x = 0.0, y = 0.0, z = 0.0;
    double smallest = 1.0;
    double norm;
    int32_t i;

    for (i = 0; i < count; i++) {
        x += b[3 * i];
        y += b[3 * i + 1];
        z += b[3 * i + 2];
    }
    norm = sqrt(x * x + y * y + z * z);
    if (norm == 0.0)
        return 3.14159265358979323846;
    for (i = 0; i < count; i++, b += 3) {
        double cosine = (b[0] * x + b[1] * y + b[2] * z) / norm;
        if (cosine < smallest)
            smallest = cosine;
    }
    return acos(smallest > -1.0 ? smallest : -1.0);
}
