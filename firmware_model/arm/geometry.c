/* Camera geometry: firmware_model/geometry.py. Pixels to unit vectors (with Newton's method where the lens
 * distorts) and back, and the four planes of the field of view, Sarvi et al. 2014 (3)-(4).
 *
 * Software double precision: a pixel's hundredth is 1e-6 rad, and the vectors go on to the attitude. Same
 * operations in the same order as the Python kernels: the same bits. */
#include "geometry.h"

#include <math.h>

#define MOST_NEWTON_STEPS 20
#define NEWTON_TOLERANCE 1e-14

/* The undistorted place (x, y) of the distorted one (xd, yd), both on the plane Z = 1. */
static void undistort(const st_camera *camera, double xd, double yd, double *x_out, double *y_out)
{
    double k1 = camera->k1, k2 = camera->k2, p1 = camera->p1, p2 = camera->p2;
    double x = xd, y = yd;
    int32_t step;

    for (step = 0; step < MOST_NEWTON_STEPS; step++) {
        double r2 = x * x + y * y;
        double radial = 1.0 + (k1 + k2 * r2) * r2;
        double slope = 2.0 * (k1 + 2.0 * k2 * r2);
        double ex = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - xd;
        double ey = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - yd;
        double jxx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x;
        double jxy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        double jyy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
        double determinant = jxx * jyy - jxy * jxy;
        double dx, dy;
        if (determinant == 0.0)
            break;
        dx = (jyy * ex - jxy * ey) / determinant;
        dy = (jxx * ey - jxy * ex) / determinant;
        x -= dx;
        y -= dy;
        if (fabs(dx) + fabs(dy) < NEWTON_TOLERANCE)
            break;
    }
    *x_out = x;
    *y_out = y;
}

void st_unit_vectors(const double *x_px, const double *y_px, int32_t count, const st_camera *camera,
                     double *vectors)
{
    int32_t distorted = camera->k1 != 0.0 || camera->k2 != 0.0 || camera->p1 != 0.0 || camera->p2 != 0.0;
    int32_t i;

    for (i = 0; i < count; i++, vectors += 3) {
        double x = (x_px[i] - camera->cx_px) / camera->focal_px;
        double y = (y_px[i] - camera->cy_px) / camera->focal_px;
        double scale;
        if (distorted)
            undistort(camera, x, y, &x, &y);
        scale = 1.0 / sqrt(1.0 + x * x + y * y);
        vectors[0] = x * scale;
        vectors[1] = y * scale;
        vectors[2] = scale;
    }
}

void st_project(const double *vectors, int32_t count, const st_camera *camera, double *x_px, double *y_px,
                int32_t *ahead)
{
    double k1 = camera->k1, k2 = camera->k2, p1 = camera->p1, p2 = camera->p2;
    int32_t i;

    for (i = 0; i < count; i++, vectors += 3) {
        double x, y, r2, radial;
        ahead[i] = 0;
        if (vectors[2] <= 0.0)
            continue;
        x = vectors[0] / vectors[2];
        y = vectors[1] / vectors[2];
        r2 = x * x + y * y;
        if (r2 > camera->r2_limit)
            continue;
        radial = 1.0 + (k1 + k2 * r2) * r2;
        x_px[i] = camera->cx_px +
                  camera->focal_px * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x));
        y_px[i] = camera->cy_px +
                  camera->focal_px * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
        ahead[i] = 1;
    }
}

void st_in_field(const double *vectors, int32_t count, const double *normals, int32_t *inside)
{
    int32_t i, j;

    for (i = 0; i < count; i++, vectors += 3) {
        inside[i] = 1;
        for (j = 0; j < 12; j += 3)
            if (vectors[0] * normals[j] + vectors[1] * normals[j + 1] + vectors[2] * normals[j + 2] <= 0.0) {
                inside[i] = 0;
                break;
            }
    }
}

void st_in_image(const double *x_px, const double *y_px, int32_t count, const st_camera *camera,
                 double border_px, int32_t *inside)
{
    double low = border_px - 0.5;
    double right = camera->width_px - 0.5 - border_px;
    double bottom = camera->height_px - 0.5 - border_px;
    int32_t i;

    for (i = 0; i < count; i++)
        inside[i] = x_px[i] >= low && x_px[i] <= right && y_px[i] >= low && y_px[i] <= bottom;
}
