/* Attitude from vector pairs; see attitude.c. Quaternions are [x, y, z, w], matrices row by row. */
#ifndef ST_ATTITUDE_H
#define ST_ATTITUDE_H

#include <stdint.h>

#define ST_ATTITUDE_SCRATCH_DOUBLES 9 /* of st_robust_attitude, for each star */

/* Rotation of the plane (p, q) that takes k[4][4]'s element pq to zero, eigenvectors carried in v[4][4]. */
void st_jacobi_rotation(double *k, double *v, int32_t p, int32_t q);

/* Unit eigenvector of the largest eigenvalue of symmetric k[4][4] (destroyed); returns the rotations done. */
int32_t st_largest_eigenvector(double *k, double *vector);

/* A(q) to a[3][3]: v_sensor = A v_ICRS. */
void st_matrix(const double *q, double *a);

/* q-method: `count` pairs b[i][3], r[i][3] with their weights to the quaternion q[4]. */
void st_quaternion(const double *b, const double *r, const double *weights, int32_t count, double *q);

/* Angles between b[i] and A(q) r[i], rad. */
void st_residuals(const double *b, const double *r, int32_t count, const double *q, double *residuals);

/* [sum weights (I - b b^T)]^-1 to covariance[3][3]; 0 and zeros where degenerate, else 1. */
int32_t st_covariance(const double *b, const double *weights, int32_t count, double *covariance);

/* q-method, residuals and scaled covariance; 0 where degenerate, else 1. */
int32_t st_solve_attitude(const double *b, const double *r, const double *weights, int32_t count, double *q,
                          double *residuals, double *covariance, double *chi_square);

/* What st_robust_attitude finds; residuals, kept and scratch are the caller's. */
typedef struct {
    double q[4];
    double covariance[9];
    double chi_square;
    int32_t left;   /* stars kept */
    int32_t solved; /* 1: all fields are valid */
} st_attitude_result;

/* The q-method without stars whose residual is over tolerance_rad, re-weighted three times.
   kept[count]: 1 for a star that belongs; residuals[left] of those kept;
   scratch[ST_ATTITUDE_SCRATCH_DOUBLES * count]. Returns `solved`. */
int32_t st_robust_attitude(const double *measured, const double *reference, const double *sigma_rad,
                           int32_t count, double tolerance_rad, int32_t least, int32_t *kept,
                           double *residuals, double *scratch, st_attitude_result *result);

/* Expected error of centroids. */
typedef struct {
    double floor_px;
    double photon_px; /* error of a star of one electron */
    double electrons_per_dn;
    double window_factor;
} st_centroid_error;

/* Error of each centroid in each axis, 1 sigma, as an angle: sigma_px / focal_px. */
void st_centroid_sigma_rad(const double *flux_dn, int32_t count, double noise_dn,
                           const st_centroid_error *error, double focal_px, double *sigma_rad);

/* How many solutions with so many matched spots chance gives per image. */
double st_false_solutions(int32_t stars, int32_t spots, int32_t matched, double spread_rad,
                          double tolerance_rad);

/* Largest angle of the first `count` directions b[i][3] from their mean, rad. */
double st_spread(const double *b, int32_t count);

#endif
