/* Tracking: firmware_model/tracking.py, for Sarvi et al. 2014, "Tracking sequence", steps 1, 2 and 5.
 *
 * Directions, angles and predicted places are software double precision, as a window's place must not depend
 * on the unit's fixed point. Windows are whole pixels, magnitudes are ordered by their bits as integers. The
 * spots' table is by window, so that a star's spots are found by its window's first one. */
#include "tracking.h"

#include "aberration.h"
#include "attitude.h"

#include <math.h>
#include <string.h>

#define DEGREES_PER_RAD 57.29577951308232
#define BEYOND_FIELD_RAD 1e-3 /* neighbours are read a little beyond the field's corners */

static int32_t floor_int(double value)
{
    int32_t whole = (int32_t)value;
    return value < (double)whole ? whole - 1 : whole;
}

static int32_t ceil_int(double value)
{
    int32_t whole = (int32_t)value;
    return value > (double)whole ? whole + 1 : whole;
}

static int32_t smaller(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

static int32_t larger(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

/* (1)-(2) of the paper as the Python stage reads them. */
static int32_t half_width_px(const st_tracking_parameters *parameters, double interval_s, double exposure_s)
{
    double speed_px_s = parameters->rate_rad_s * DEGREES_PER_RAD * parameters->pixels_per_degree;
    return ceil_int(speed_px_s * interval_s) +
           ceil_int(parameters->star_radius_px + 0.5 * speed_px_s * exposure_s);
}

/* A whole number that orders as the magnitude does. */
static int32_t order_key(float magnitude)
{
    int32_t bits;
    memcpy(&bits, &magnitude, sizeof bits);
    return bits < 0 ? INT32_MIN - bits : bits;
}

/* Put entry `place` into the `count` brightest so far, behind those as bright; returns how many there are. */
static int32_t insert_brightest(st_plan_room *room, int32_t count, int32_t most, int32_t place, int32_t key)
{
    int32_t at = count;
    while (at > 0 && room->key[at - 1] > key)
        at--;
    if (at == most)
        return count;
    for (int32_t later = count; later > at; later--) {
        room->key[later] = room->key[later - 1];
        room->place[later] = room->place[later - 1];
    }
    room->key[at] = key;
    room->place[at] = place;
    return count < most ? count + 1 : most;
}

void st_plan_windows(const double *q_icrs_to_sensor, int32_t pivot_star, const st_catalogue *catalogue,
                     const st_camera *camera, const st_tracking_parameters *parameters, double interval_s,
                     double exposure_s, const double *velocity_over_c, st_tracking_plan *plan,
                     st_plan_room *room)
{
    const double *unit_vectors = catalogue->cells.unit_vectors;
    double a[9];
    const double *centre = a + 6; /* the boresight */
    double radius_rad = parameters->half_diagonal_rad + BEYOND_FIELD_RAD;
    st_matrix(q_icrs_to_sensor, a);
    if (pivot_star >= 0) {
        centre = unit_vectors + 3 * pivot_star;
        radius_rad = 2.0 * parameters->half_diagonal_rad + BEYOND_FIELD_RAD;
    }
    int32_t neighbours = st_stars_in_cone(&catalogue->cells, centre[0], centre[1], centre[2], radius_rad,
                                          room->neighbour, room->capacity);
    neighbours = smaller(neighbours, room->capacity);
    st_apparent(unit_vectors, room->neighbour, neighbours, velocity_over_c, room->reference);
    const double *r = room->reference;
    double *s = room->sensor;
    for (int32_t i = 0; i < neighbours; i++, r += 3, s += 3) {
        s[0] = r[0] * a[0] + r[1] * a[1] + r[2] * a[2];
        s[1] = r[0] * a[3] + r[1] * a[4] + r[2] * a[5];
        s[2] = r[0] * a[6] + r[1] * a[7] + r[2] * a[8];
    }
    /* The stars inside of the four planes move up; the neighbours with their directions follow. */
    st_in_field(room->sensor, neighbours, camera->normals, room->flag);
    int32_t inside = 0;
    for (int32_t i = 0; i < neighbours; i++) {
        if (!room->flag[i])
            continue;
        if (inside < i) {
            room->neighbour[inside] = room->neighbour[i];
            memcpy(room->reference + 3 * inside, room->reference + 3 * i, 3 * sizeof(double));
            memcpy(room->sensor + 3 * inside, room->sensor + 3 * i, 3 * sizeof(double));
        }
        inside++;
    }
    /* A star that cannot be projected is at no place in the image. */
    for (int32_t i = 0; i < inside; i++)
        room->x_px[i] = -1e9;
    st_project(room->sensor, inside, camera, room->x_px, room->y_px, room->flag);
    st_in_image(room->x_px, room->y_px, inside, camera, 0.0, room->flag);
    int32_t stars = 0;
    for (int32_t i = 0; i < inside; i++) {
        if (room->flag[i])
            stars = insert_brightest(room, stars, parameters->max_windows, i,
                                     order_key(catalogue->hp_mag[room->neighbour[i]]));
    }
    for (int32_t i = 0; i < stars; i++) {
        int32_t place = room->place[i];
        plan->star[i] = room->neighbour[place];
        plan->x_px[i] = room->x_px[place];
        plan->y_px[i] = room->y_px[place];
        memcpy(plan->reference + 3 * i, room->reference + 3 * place, 3 * sizeof(double));
    }
    plan->stars = stars;
    plan->half_width_px = half_width_px(parameters, interval_s, exposure_s);
    plan->windows = st_merge_windows(plan->x_px, plan->y_px, stars, plan->half_width_px, camera->width_px,
                                     camera->height_px, plan->rects, plan->window);
}

int32_t st_merge_windows(const double *x_px, const double *y_px, int32_t stars, int32_t half, int32_t width,
                         int32_t height, st_rect *rects, int32_t *window)
{
    int32_t windows = 0;
    for (int32_t star = 0; star < stars; star++) {
        int32_t column = floor_int(x_px[star] + 0.5);
        int32_t row = floor_int(y_px[star] + 0.5);
        st_rect grown = {
            larger(column - half, 0),
            larger(row - half, 0),
            smaller(column + half + 1, width),
            smaller(row + half + 1, height),
        };
        window[star] = windows;
        int32_t other = 0;
        while (other < windows) {
            st_rect *met = rects + other;
            if (grown.x0 > met->x1 || met->x0 > grown.x1 || grown.y0 > met->y1 || met->y0 > grown.y1) {
                other++;
                continue;
            }
            grown.x0 = smaller(grown.x0, met->x0);
            grown.y0 = smaller(grown.y0, met->y0);
            grown.x1 = larger(grown.x1, met->x1);
            grown.y1 = larger(grown.y1, met->y1);
            /* The other window is taken up: the last one fills its place, the growing one stays the newest
             * and may now meet any of the others. */
            int32_t last = windows - 1;
            *met = rects[last];
            for (int32_t earlier = 0; earlier <= star; earlier++) {
                if (window[earlier] == other || window[earlier] == windows)
                    window[earlier] = last;
                else if (window[earlier] == last)
                    window[earlier] = other;
            }
            windows = last;
            other = 0;
        }
        rects[windows++] = grown;
    }
    return windows;
}

/* Square of the chord between two directions: 4 sin^2 of half their angle. */
static double chord_square(const double *u, const double *v)
{
    double dx = u[0] - v[0];
    double dy = u[1] - v[1];
    double dz = u[2] - v[2];
    return dx * dx + dy * dy + dz * dz;
}

/* Squares of the chords between which an angle is within the tolerance of that of two catalogue stars. */
static void chord_bounds(const double *u, const double *v, const st_tracking_parameters *parameters,
                         double *low, double *high)
{
    double square = chord_square(u, v);
    double middle = sqrt(square) * parameters->cos_half_tolerance;
    double reach = sqrt(4.0 - square) * parameters->sin_half_tolerance;
    double least = middle - reach;
    *low = least > 0.0 ? least * least : 0.0;
    *high = (middle + reach) * (middle + reach);
}

/* Everything that a trial of one pivot looks at. */
typedef struct {
    const st_tracking_plan *plan;
    const float *hp_mag;
    const st_tracking_parameters *parameters;
    const double *b_vectors;
    const st_spot *spots;
    int32_t count;
    st_verify_room *room;
} verification;

/* Forget the squares of chords of `count` stars or spots: none is below zero. */
static void forget(double *square, int32_t count)
{
    for (int32_t i = 0; i < count; i++)
        square[i] = -1.0;
}

/* Spots of the other stars when pivot_spot is the spot of pivot, to room->trial; how many verify with it. */
static int32_t try_pivot(const verification *v, int32_t pivot, int32_t pivot_spot)
{
    const st_tracking_plan *plan = v->plan;
    st_verify_room *room = v->room;
    double shift_x = v->spots[pivot_spot].x_px - plan->x_px[pivot];
    double shift_y = v->spots[pivot_spot].y_px - plan->y_px[pivot];
    int32_t verified = 1;
    for (int32_t star = 0; star < plan->stars; star++)
        room->trial[star] = -1;
    for (int32_t spot = 0; spot < v->count; spot++)
        room->owner[spot] = -1;
    forget(room->chord, v->count);
    room->trial[pivot] = pivot_spot;
    room->owner[pivot_spot] = pivot;
    for (int32_t star = 0; star < plan->stars; star++) {
        const int32_t *from = room->spot_from + plan->window[star];
        double *low = room->low + star;
        double *high = room->high + star;
        double nearest = 1e300;
        int32_t best = -1;
        if (star == pivot)
            continue;
        for (int32_t spot = from[0]; spot < from[1]; spot++) {
            if (spot == pivot_spot)
                continue;
            if (*high < 0.0)
                chord_bounds(plan->reference + 3 * pivot, plan->reference + 3 * star, v->parameters, low,
                             high);
            double *square = room->chord + spot;
            if (*square < 0.0)
                *square = chord_square(v->b_vectors + 3 * pivot_spot, v->b_vectors + 3 * spot);
            if (!(*low <= *square && *square <= *high))
                continue;
            double difference = (v->spots[spot].magnitude - v->spots[pivot_spot].magnitude) -
                                (double)(v->hp_mag[plan->star[star]] - v->hp_mag[plan->star[pivot]]);
            if (!(fabs(difference) <= v->parameters->magnitude_tolerance))
                continue;
            double dx = v->spots[spot].x_px - plan->x_px[star] - shift_x;
            double dy = v->spots[spot].y_px - plan->y_px[star] - shift_y;
            double distance = dx * dx + dy * dy;
            if (distance < nearest) {
                nearest = distance;
                best = spot;
            }
        }
        if (best < 0)
            continue;
        room->trial[star] = best;
        room->distance[star] = nearest;
        int32_t rival = room->owner[best];
        if (rival < 0) {
            room->owner[best] = star;
            verified++;
        } else if (room->distance[rival] <= nearest) {
            /* One spot for two stars: the nearer keeps it. */
            room->trial[star] = -1;
        } else {
            room->trial[rival] = -1;
            room->owner[best] = star;
        }
    }
    return verified;
}

int32_t st_verify_by_pivot(const st_tracking_plan *plan, const st_catalogue *catalogue,
                           const st_tracking_parameters *parameters, const double *b_vectors,
                           const st_spot *spots, const int32_t *window_of, int32_t count, int32_t *chosen,
                           int32_t *verified, int32_t *found, st_verify_room *room)
{
    const verification v = {plan, catalogue->hp_mag, parameters, b_vectors, spots, count, room};
    int32_t spot = 0;
    for (int32_t window = 0; window < plan->windows; window++) {
        room->spot_from[window] = spot;
        room->in_window[window] = 0;
        while (spot < count && window_of[spot] == window)
            spot++;
    }
    room->spot_from[plan->windows] = spot;
    *verified = 0;
    *found = 0;
    /* Of the stars of one window as many could have a spot as it has spots. */
    for (int32_t star = 0; star < plan->stars; star++) {
        int32_t window = plan->window[star];
        chosen[star] = -1;
        if (room->in_window[window]++ < room->spot_from[window + 1] - room->spot_from[window])
            ++*found;
    }
    if (*found < parameters->min_stars)
        return -1;
    int32_t enough = larger(parameters->min_stars, (*found + 1) >> 1);
    for (int32_t pivot = 0; pivot < plan->stars; pivot++) {
        const int32_t *from = room->spot_from + plan->window[pivot];
        forget(room->high, plan->stars);
        for (int32_t pivot_spot = from[0]; pivot_spot < from[1]; pivot_spot++) {
            int32_t number = try_pivot(&v, pivot, pivot_spot);
            if (number < enough)
                continue;
            memcpy(chosen, room->trial, (size_t)plan->stars * sizeof(int32_t));
            *verified = number;
            return pivot;
        }
    }
    return -1;
}
