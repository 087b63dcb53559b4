/* Which catalogue stars are near a direction: firmware_model/catalogue/sky_cells.py (stars_in_cone_kernel,
 * nearest_star_kernel), for the neighbours of Sarvi et al. 2014, tracking step 1.
 *
 * Directions are software double precision throughout: a catalogue direction is good to 1e-9 rad, which 32
 * bits of fixed point would not hold. The sequence of operations is the Python stage's, so that the same
 * stars come out. */
#include "sky_cells.h"

#include <math.h>

#define PI 3.141592653589793

/* math.floor of what fits an int: no call of floor, whose result would have to be converted anyway. */
static int32_t floor_int(double value)
{
    int32_t whole = (int32_t)value;
    return value < (double)whole ? whole - 1 : whole;
}

int32_t st_stars_in_cone(const st_sky_cells *cells, double x, double y, double z, double radius_rad,
                         int32_t *found, int32_t room)
{
    const double *unit_vectors = cells->unit_vectors;
    double height = cells->band_height_rad;
    double cos_radius = radius_rad < PI ? cos(radius_rad) : -1.0;
    double dec = asin(z > 1.0 ? 1.0 : z < -1.0 ? -1.0 : z);
    /* The rounding of asin and of the bands' edges must never lose a star at the rim. */
    const double margin = 1e-9;
    int32_t first_band = floor_int((dec - radius_rad - margin + 0.5 * PI) / height);
    int32_t last_band = floor_int((dec + radius_rad + margin + 0.5 * PI) / height);
    int over_pole = fabs(dec) + radius_rad >= 0.5 * PI - 1e-6;
    double ra = 0.0;
    double half_width = PI;
    if (first_band < 0)
        first_band = 0;
    if (last_band > cells->bands - 1)
        last_band = cells->bands - 1;
    if (!over_pole) {
        double ratio = sin(radius_rad) / cos(dec);
        ra = atan2(y, x);
        if (ra < 0.0)
            ra += 2.0 * PI;
        /* The widest half-angle in right ascension of a cone that does not hold a pole. */
        half_width = asin(ratio < 1.0 ? ratio : 1.0) + margin;
    }
    int32_t count = 0;
    for (int32_t band = first_band; band <= last_band; band++) {
        int32_t first_cell = cells->band_first_cell[band];
        int32_t cells_of_band = cells->band_first_cell[band + 1] - first_cell;
        int32_t low = 0;
        int32_t high = cells_of_band - 1;
        if (!over_pole) {
            double scale = (double)cells_of_band / (2.0 * PI);
            low = floor_int((ra - half_width) * scale);
            high = floor_int((ra + half_width) * scale);
            if (high - low >= cells_of_band) {
                low = 0;
                high = cells_of_band - 1;
            }
        }
        for (int32_t column = low; column <= high; column++) {
            /* ra is in 0..2 pi and half_width at most pi / 2: one turn too far at most. */
            int32_t turned = column < 0 ? column + cells_of_band : column;
            if (turned >= cells_of_band)
                turned -= cells_of_band;
            const int32_t *place = cells->cell_star + cells->cell_start[first_cell + turned];
            const int32_t *end = cells->cell_star + cells->cell_start[first_cell + turned + 1];
            for (; place < end; place++) {
                const double *v = unit_vectors + 3 * *place;
                if (v[0] * x + v[1] * y + v[2] * z >= cos_radius) {
                    if (count < room)
                        found[count] = *place;
                    count++;
                }
            }
        }
    }
    return count;
}

int32_t st_nearest_star(const st_sky_cells *cells, double x, double y, double z, double radius_rad,
                        int32_t *found, int32_t room, double *angle_rad)
{
    int32_t count = st_stars_in_cone(cells, x, y, z, radius_rad, found, room);
    int32_t nearest = -1;
    double smallest = 1e300;
    if (count > room)
        count = room;
    for (int32_t place = 0; place < count; place++) {
        const double *v = cells->unit_vectors + 3 * found[place];
        double dx = v[0] - x;
        double dy = v[1] - y;
        double dz = v[2] - z;
        double square = dx * dx + dy * dy + dz * dz;
        if (square < smallest) {
            smallest = square;
            nearest = found[place];
        }
    }
    *angle_rad = PI;
    if (nearest >= 0) {
        /* From the chord, which keeps its precision where the cosine loses it. */
        double half_chord = 0.5 * sqrt(smallest);
        *angle_rad = 2.0 * asin(half_chord < 1.0 ? half_chord : 1.0);
    }
    return nearest;
}
