/* Optical flow: firmware_model/image/optical_flow.py, after Fasano et al. 2013, section 2.1: each star of a frame
 * is looked for in the next by the least sum of squared differences (SSD) over whole-pixel shifts, then refined by
 * a centroid.
 *
 * Only lit pixels are touched. SSD = sum own^2 + sum second^2 - 2 sum own second: the last is multiplied out
 * between the runs of the two frames for one row of shifts at a time, the second kept by columns, so that what is
 * worked on is a row of sums and not a table of all shifts. Values are whole numbers of 1/16 DN, products and sums
 * of 64 bits; double are the quotients, once a star and once a centroid. All is the Python stage's to the last
 * bit. */
#include "optical_flow.h"

#include <math.h>
#include <string.h>

static inline int32_t least_of(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

static inline int32_t most_of(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

/* Columns x0 to x1 - 1 of rows y0 to y1 - 1. */
typedef struct {
    int32_t x0, x1, y0, y1;
} window;

/* The parts of a frame's runs in a window, which may reach out of the image. */
static void gather(const st_lit *lit, int32_t rows, const window *in, st_piece *pieces, int32_t *piece_start)
{
    st_piece *piece = pieces;
    for (int32_t row = in->y0; row < in->y1; row++) {
        *piece_start++ = piece - pieces;
        if (row < 0 || row >= rows)
            continue;
        const st_run *run = lit->runs + lit->row_start[row];
        const st_run *end = lit->runs + lit->row_start[row + 1];
        for (; run < end && run->first < in->x1; run++) {
            if (run->end <= in->x0)
                continue;
            int32_t first = most_of(run->first, in->x0);
            piece->first = first - in->x0;
            piece->end = least_of(run->end, in->x1) - in->x0;
            piece->values = lit->offsets[run - lit->runs] + first - run->first;
            piece++;
        }
    }
    *piece_start = piece - pieces;
}

/* A row's squares into the columns' sums (sign 0), or out of them (-1). Returns how many. */
static int32_t add_squares(const st_piece *piece, const st_piece *end, const int32_t *values, int32_t sign,
                           int64_t *column_energy)
{
    int32_t pixels = 0;
    for (; piece < end; piece++) {
        const int32_t *value = values + piece->values;
        int64_t *energy = column_energy + piece->first;
        int32_t length = piece->end - piece->first;
        pixels += length;
        for (; length > 0; length--) {
            int32_t own = *value++;
            *energy++ += (int64_t)((own ^ sign) - sign) * own;
        }
    }
    return (pixels ^ sign) - sign;
}

/* A row of shifts: their products, and the least and the last of them at which two lit pixels meet. */
typedef struct {
    int64_t *product;
    int32_t shifts;
    int32_t least, most;
} shift_row;

/* Multiply a part of a star's run with one of the other frame's, at all shifts at which they meet. */
static inline void multiply(const st_piece *own, const int32_t *own_values, const st_piece *second,
                            const int32_t *second_values, shift_row *row)
{
    int32_t low = most_of(own->first, second->first - row->shifts + 1);
    int32_t high = least_of(own->end, second->end);
    if (low >= high)
        return;
    row->least = least_of(row->least, most_of(second->first - high + 1, 0));
    row->most = most_of(row->most, least_of(second->end - 1 - low, row->shifts - 1));
    const int32_t *own_value = own_values + own->values + low - own->first;
    for (int32_t column = low; column < high; column++) {
        int32_t value = *own_value++;
        int32_t left = most_of(second->first, column);
        int32_t length = least_of(second->end, column + row->shifts) - left;
        const int32_t *other = second_values + second->values + left - second->first;
        int64_t *product = row->product + left - column;
        for (; length > 0; length--)
            *product++ += (int64_t)value * *other++;
    }
}

/* What is best so far: its SSD, row and column of the shifts (-1: none yet). */
typedef struct {
    int64_t ssd;
    int32_t i, j;
} best_shift;

/* The shift that is wanted where two are as good. */
typedef struct {
    double x, y;
} wanted_shift;

static int32_t is_nearer(const wanted_shift *to, int32_t i, int32_t j, const best_shift *best)
{
    double y = i - to->y, x = j - to->x;
    double best_y = best->i - to->y, best_x = best->j - to->x;
    return y * y + x * x < best_y * best_y + best_x * best_x;
}

/* Compare the shifts of row i that have products, which are cleared. */
static void compare(const shift_row *row, int32_t i, int32_t width, const int64_t *column_energy,
                    int64_t total, const wanted_shift *wanted, best_shift *best)
{
    int64_t energy = 0;
    const int64_t *leaving = column_energy + row->least;
    const int64_t *entering = leaving;
    for (int32_t column = 1; column < width; column++)
        energy += *entering++;
    for (int32_t j = row->least; j <= row->most; j++) {
        int64_t product = row->product[j];
        energy += *entering++;
        if (product > 0) {
            int64_t ssd = total + energy - 2 * product;
            row->product[j] = 0;
            if (ssd < best->ssd || (ssd == best->ssd && best->i >= 0 && is_nearer(wanted, i, j, best))) {
                best->ssd = ssd;
                best->i = i;
                best->j = j;
            }
        }
        energy -= *leaving++;
    }
}

/* The whole-pixel shift of the least SSD; its mismatch, 1 where there is none. */
static double coarse_shift(int32_t height, int32_t width, const int32_t *own_values,
                           const int32_t *second_values, int32_t shifts, const wanted_shift *wanted,
                           const st_flow_room *room, best_shift *best)
{
    const int32_t *start = room->second_start;
    int64_t total = 0;
    for (const st_piece *piece = room->own; piece < room->own + room->own_start[height]; piece++) {
        const int32_t *value = own_values + piece->values;
        for (int32_t length = piece->end - piece->first; length > 0; length--, value++)
            total += (int64_t)*value * *value;
    }
    memset(room->column_energy, 0, (size_t)(shifts + width - 1) * sizeof *room->column_energy);
    memset(room->product, 0, (size_t)shifts * sizeof *room->product);
    best->ssd = total;
    best->i = -1;
    best->j = -1;
    int32_t lit = add_squares(room->second, room->second + start[height - 1], second_values, 0,
                              room->column_energy);
    for (int32_t i = 0; i < shifts; i++) {
        lit += add_squares(room->second + start[i + height - 1], room->second + start[i + height],
                           second_values, 0, room->column_energy);
        if (lit > 0) {
            shift_row row = {room->product, shifts, shifts, -1};
            for (int32_t r = 0; r < height; r++) {
                const st_piece *second = room->second + start[i + r];
                const st_piece *second_end = room->second + start[i + r + 1];
                const st_piece *own_end = room->own + room->own_start[r + 1];
                for (; second < second_end; second++)
                    for (const st_piece *own = room->own + room->own_start[r]; own < own_end; own++)
                        multiply(own, own_values, second, second_values, &row);
            }
            if (row.most >= 0)
                compare(&row, i, width, room->column_energy, total, wanted, best);
        }
        lit += add_squares(room->second + start[i], room->second + start[i + 1], second_values, -1,
                           room->column_energy);
    }
    return best->i < 0 ? 1.0 : (double)best->ssd / (double)total;
}

typedef struct {
    int64_t total, x, y;
} light;

/* The light in a window inside the image, and that times column and row in the window. */
static light light_in(const st_lit *lit, const window *in)
{
    light sums = {0, 0, 0};
    for (int32_t row = in->y0; row < in->y1; row++) {
        const st_run *run = lit->runs + lit->row_start[row];
        const st_run *end = lit->runs + lit->row_start[row + 1];
        int64_t line = 0;
        for (; run < end && run->first < in->x1; run++) {
            int32_t first = most_of(run->first, in->x0);
            int32_t past = least_of(run->end, in->x1);
            const int32_t *value = lit->values + lit->offsets[run - lit->runs] + first - run->first;
            for (int32_t column = first - in->x0; column < past - in->x0; column++) {
                line += *value;
                sums.x += (int64_t)*value++ * column;
            }
        }
        sums.total += line;
        sums.y += line * (row - in->y0);
    }
    return sums;
}

/* Centre of mass in a window that goes after its light, by whole pixels; 0 where it leaves the image or there is
 * none. place: where the star stands in its own window. */
static int32_t refine(const st_image *image, const st_lit *after, window *in, int32_t centrings,
                      double place_x, double place_y, st_flow_match *found)
{
    int32_t centred = 0;
    for (; centrings > 0; centrings--) {
        if (in->x0 < 0 || in->y0 < 0 || in->x1 > image->columns || in->y1 > image->rows)
            return 0;
        light sums = light_in(after, in);
        if (sums.total <= 0)
            break;
        double x = (double)sums.x / (double)sums.total;
        double y = (double)sums.y / (double)sums.total;
        found->x_px = in->x0 + x;
        found->y_px = in->y0 + y;
        centred = 1;
        int32_t step_x = (int32_t)rint(x - place_x);
        int32_t step_y = (int32_t)rint(y - place_y);
        if (step_x == 0 && step_y == 0)
            break;
        in->x0 += step_x;
        in->x1 += step_x;
        in->y0 += step_y;
        in->y1 += step_y;
    }
    return centred;
}

/* One star; 0 where it is not found. */
static int32_t follow(const st_image *image, const st_lit *before, const st_flow_star *star,
                      const st_lit *after, const st_flow_search *search, double shift_x, double shift_y,
                      const st_flow_room *room, st_flow_match *found)
{
    int32_t reach = search->reach, margin = search->margin;
    int32_t shifts = 2 * reach + 1;
    int32_t low_x = (int32_t)rint(shift_x) - reach;
    int32_t low_y = (int32_t)rint(shift_y) - reach;
    wanted_shift wanted = {shift_x - low_x, shift_y - low_y};
    window own = {star->first_x, star->last_x + 1, star->first_y, star->last_y + 1};
    window second = {own.x0 + low_x, own.x1 + low_x + shifts - 1, own.y0 + low_y,
                     own.y1 + low_y + shifts - 1};
    best_shift best;
    gather(before, image->rows, &own, room->own, room->own_start);
    gather(after, image->rows, &second, room->second, room->second_start);
    found->mismatch = coarse_shift(own.y1 - own.y0, own.x1 - own.x0, before->values, after->values, shifts,
                                   &wanted, room, &best);
    if (best.i < 0)
        return 0;
    window in = {own.x0 + low_x + best.j - margin, own.x1 + low_x + best.j + margin,
                 own.y0 + low_y + best.i - margin, own.y1 + low_y + best.i + margin};
    return refine(image, after, &in, search->centrings, star->x_px - own.x0 + margin,
                  star->y_px - own.y0 + margin, found);
}

int32_t st_flow_between(const st_image *image, const st_lit *before, const st_flow_star *stars, int32_t count,
                        const st_lit *after, const st_flow_search *search, const double *foreseen,
                        const st_flow_room *room, st_flow_match *found)
{
    st_flow_match *match = found;
    for (int32_t i = 0; i < count; i++) {
        const st_flow_star *star = &stars[i];
        double shift_x = foreseen ? foreseen[2 * i] : 0.0;
        double shift_y = foreseen ? foreseen[2 * i + 1] : 0.0;
        if (!follow(image, before, star, after, search, shift_x, shift_y, room, match))
            continue;
        double wide = star->last_x - star->first_x;
        double high = star->last_y - star->first_y;
        match->star = i;
        match->length_px = sqrt(wide * wide + high * high);
        match->noise = before->sigma_dn * sqrt((double)star->pixels) / star->flux_dn;
        match++;
    }
    return match - found;
}
