/* Angular rate from two attitudes: rotation_between and angular_rate of firmware_model/attitude.py, and the
 * test of firmware_model/firmware.py whether the rate is too high to track. Once a frame, so in software
 * double precision; same operations as in Python, atan2 is the C library's. */
#include "rate.h"

#include <math.h>

void st_quaternion_product(const double *p, const double *q, double *product)
{
    double norm;
    int32_t i;

    product[0] = p[3] * q[0] + q[3] * p[0] - (p[1] * q[2] - p[2] * q[1]);
    product[1] = p[3] * q[1] + q[3] * p[1] - (p[2] * q[0] - p[0] * q[2]);
    product[2] = p[3] * q[2] + q[3] * p[2] - (p[0] * q[1] - p[1] * q[0]);
    product[3] = p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2];
    norm = sqrt(product[0] * product[0] + product[1] * product[1] + product[2] * product[2] +
                product[3] * product[3]);
    norm = copysign(norm, product[3]);
    for (i = 0; i < 4; i++)
        product[i] /= norm;
}

void st_angular_rate(const double *q_before, const double *q_after, double interval_s, double *rate_rad_s)
{
    double inverse[4], turn[4];
    double sine, angle;
    int32_t axis;

    for (axis = 0; axis < 3; axis++)
        inverse[axis] = -q_before[axis];
    inverse[3] = q_before[3];
    st_quaternion_product(q_after, inverse, turn);
    sine = sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]);
    angle = sine < 1e-15 ? 0.0 : 2.0 * atan2(sine, turn[3]) / sine;
    for (axis = 0; axis < 3; axis++)
        rate_rad_s[axis] = turn[axis] * angle / interval_s;
}

void st_rate_covariance(const double *before_rad2, const double *now_rad2, double interval_s,
                        double *covariance)
{
    double square = interval_s * interval_s;
    int32_t m;

    for (m = 0; m < 9; m++)
        covariance[m] = (before_rad2[m] + now_rad2[m]) / square;
}

/* axis^T matrix axis of a [3][3] matrix. */
static double variance_along(const double *axis, const double *matrix)
{
    double sum = 0.0;
    int32_t m;

    for (m = 0; m < 3; m++)
        sum += axis[m] *
               (matrix[3 * m] * axis[0] + matrix[3 * m + 1] * axis[1] + matrix[3 * m + 2] * axis[2]);
    return sum;
}

int32_t st_rate_too_high(const double *rate_rad_s, double interval_s, const double *before_rad2,
                         const double *now_rad2, double limit_rad_s)
{
    double rate = sqrt(rate_rad_s[0] * rate_rad_s[0] + rate_rad_s[1] * rate_rad_s[1] +
                       rate_rad_s[2] * rate_rad_s[2]);
    double axis[3];
    double variance;
    int32_t m;

    if (rate <= limit_rad_s)
        return 0;
    for (m = 0; m < 3; m++)
        axis[m] = rate_rad_s[m] / rate;
    variance = variance_along(axis, now_rad2) + variance_along(axis, before_rad2);
    return rate > limit_rad_s + 3.0 * sqrt(variance) / interval_s;
}
