/* Stellar aberration: firmware_model/aberration.py. The velocity of the Earth once a frame by its Keplerian
 * orbit (elements of Standish, JPL), then the apparent direction of each catalogue star, relativistic.
 *
 * Software double precision: the aberration is 20 arcsec and known to 0.03, the directions it is added to are
 * those of the attitude. Same operations as in Python; sin, cos and fmod are the C library's. */
#include "aberration.h"

#include <math.h>

#define RADIANS 0.017453292519943295
#define SPEED_OF_LIGHT_KM_S 299792.458
#define MEAN_SPEED_KM_S 29.784692
#define COS_OBLIQUITY 0.917482062146321 /* of 23.4392911 deg, J2000 */
#define SIN_OBLIQUITY 0.39777715575399053
#define J2000_TAI_S 1325419167.816 /* 2000-01-01 12:00 TT since 1958-01-01 TAI */
#define CENTURY_S 3155760000.0

void st_earth_velocity_km_s(int64_t tai_ns, double *velocity_km_s)
{
    double centuries = ((double)tai_ns * 1e-9 - J2000_TAI_S) / CENTURY_S;
    double degrees = fmod(100.46457166 + 35999.37244981 * centuries, 360.0);
    double longitude, perihelion, eccentricity, anomaly, true_longitude, speed, along, across;

    if (degrees < 0.0)
        degrees += 360.0;
    longitude = degrees * RADIANS;
    perihelion = (102.93768193 + 0.32327364 * centuries) * RADIANS;
    eccentricity = 0.01671123 - 0.00004392 * centuries;
    anomaly = longitude - perihelion;
    true_longitude = longitude + 2.0 * eccentricity * sin(anomaly) +
                     1.25 * eccentricity * eccentricity * sin(2.0 * anomaly);
    speed = MEAN_SPEED_KM_S / sqrt(1.0 - eccentricity * eccentricity);
    along = -speed * (sin(true_longitude) + eccentricity * sin(perihelion));
    across = speed * (cos(true_longitude) + eccentricity * cos(perihelion));
    velocity_km_s[0] = along;
    velocity_km_s[1] = across * COS_OBLIQUITY;
    velocity_km_s[2] = across * SIN_OBLIQUITY;
}

void st_velocity_over_c(int64_t tai_ns, const double *velocity_km_s, double *velocity_over_c)
{
    int32_t axis;

    st_earth_velocity_km_s(tai_ns, velocity_over_c);
    for (axis = 0; axis < 3; axis++)
        velocity_over_c[axis] = (velocity_over_c[axis] + velocity_km_s[axis]) / SPEED_OF_LIGHT_KM_S;
}

void st_apparent(const double *unit_vectors, const int32_t *rows, int32_t count, const double *beta,
                 double *apparent)
{
    double square = beta[0] * beta[0] + beta[1] * beta[1] + beta[2] * beta[2];
    double inverse_gamma = sqrt(1.0 - square);
    int32_t place;

    for (place = 0; place < count; place++, apparent += 3) {
        const double *star = unit_vectors + 3 * rows[place];
        double x = star[0], y = star[1], z = star[2];
        if (square > 0.0) {
            double along = x * beta[0] + y * beta[1] + z * beta[2];
            double share = 1.0 + along / (1.0 + inverse_gamma);
            double norm;
            x = inverse_gamma * x + share * beta[0];
            y = inverse_gamma * y + share * beta[1];
            z = inverse_gamma * z + share * beta[2];
            norm = sqrt(x * x + y * y + z * z);
            x /= norm;
            y /= norm;
            z /= norm;
        }
        apparent[0] = x;
        apparent[1] = y;
        apparent[2] = z;
    }
}
