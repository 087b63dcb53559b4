/* Camera geometry; see geometry.c. */
#ifndef ST_GEOMETRY_H
#define ST_GEOMETRY_H

#include <stdint.h>

/* A camera. */
typedef struct {
    double focal_px, cx_px, cy_px;
    double k1, k2, p1, p2;
    double r2_limit;    /* largest (X/Z)^2 + (Y/Z)^2 before the distortion folds back */
    double normals[12]; /* of the field's four planes, inwards, [4][3] */
    int32_t width_px, height_px;
} st_camera;

/* Directions vectors[count][3] of points of the image. */
void st_unit_vectors(const double *x_px, const double *y_px, int32_t count, const st_camera *camera,
                     double *vectors);

/* Image points of directions vectors[count][3]; ahead[i] 0 (and the point untouched) behind the camera. */
void st_project(const double *vectors, int32_t count, const st_camera *camera, double *x_px, double *y_px,
                int32_t *ahead);

/* Four-plane test of vectors[count][3] against normals[4][3]; inside[i] is 1 or 0. */
void st_in_field(const double *vectors, int32_t count, const double *normals, int32_t *inside);

/* Whether points lie on the detector; inside[i] is 1 or 0. */
void st_in_image(const double *x_px, const double *y_px, int32_t count, const st_camera *camera,
                 double border_px, int32_t *inside);

#endif
