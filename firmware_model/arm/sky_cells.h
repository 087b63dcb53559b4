/* Which catalogue stars are near a direction; see sky_cells.c. */
#ifndef ST_SKY_CELLS_H
#define ST_SKY_CELLS_H

#include <stdint.h>

/* The grid of one star catalogue with the catalogue's directions: firmware_model/catalogue/sky_cells.py.
 * band_first_cell has bands + 1 entries, cell_start one more than there are cells. */
typedef struct {
    double band_height_rad;
    int32_t bands;
    const int32_t *band_first_cell;
    const int32_t *cell_start;
    const int32_t *cell_star;
    const double *unit_vectors; /* [stars][3] */
} st_sky_cells;

/* Rows of the stars within radius_rad of the unit vector (x, y, z) to found, in the grid's order; returns
 * their number. No more than room rows are written; the count goes on. */
int32_t st_stars_in_cone(const st_sky_cells *cells, double x, double y, double z, double radius_rad,
                         int32_t *found, int32_t room);

/* Row of the star nearest to the unit vector (x, y, z) within radius_rad, or -1; its angle (pi where there
 * is none) to angle_rad. found[room] is room to work in. */
int32_t st_nearest_star(const st_sky_cells *cells, double x, double y, double z, double radius_rad,
                        int32_t *found, int32_t room, double *angle_rad);

#endif
