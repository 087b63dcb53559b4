/* Clusters to spots: firmware_model/image/centroid.py (measure_spots), centre of mass of the light in a
 * window, x = sum x I / sum I (paper Z, (1)-(3)), and the order of spots by their flux.
 *
 * Places and the windows' sides have 16 bits behind the point (1.5e-5 px), backgrounds 15: pixels less
 * background times the share of a pixel inside the window are summed in 64 bits. Quotients, flux, magnitude
 * and the verdicts on them are double, once a pass or a spot. The centroid is the Python stage's to 1e-3 px,
 * the flux to 1e-4 of it and 1e-3 DN. */
#include "centroid.h"

#include "interpolation.h"

#include <math.h>
#include <string.h>

#define PLACE_BITS 16
#define ONE_PX (1 << PLACE_BITS)
#define HALF_PX (ONE_PX / 2)
#define MOST_DN 65535.0
/* What is kept behind the point of a row's sums before they are multiplied by the row's share. */
#define FLUX_BITS 15
#define MOMENT_BITS 13

/* 0.01 DN: what rounding leaves of no light at all. */
#define LEAST_FLUX (((int64_t)1 << (FLUX_BITS + PLACE_BITS)) / 100)

enum { RECENTRINGS = 2, RING_GAP_PX = 1, RING_WIDTH_PX = 3, LEAST_RING_PX = 8 };

/* One axis of one cluster. */
typedef struct {
    int32_t size;        /* of the image, px */
    int32_t first, last; /* of the cluster, px */
    int32_t centre;      /* PLACE_BITS, as all that follows but the pixels */
    int32_t wide;        /* half-width of the window */
} axis;

/* A column's share of the window and that times its distance from the centre, both PLACE_BITS. */
typedef struct {
    int32_t share;
    int32_t moment;
} weight;

/* Sums over a window: flux has FLUX_BITS + PLACE_BITS behind the point, moments MOMENT_BITS + PLACE_BITS. */
typedef struct {
    int64_t flux, moment_x, moment_y;
} window_sums;

/* What holds for all clusters of a call. */
typedef struct {
    const st_image *image;
    const st_run *runs;
    const int32_t *row_start;
    const int32_t *label;
    const st_spot_limits *limits;
    uint8_t *mask;
    weight *weights;
    double noise_dn;
    double spread;     /* flux times the error of a centre of mass by noise, DN px; 0: not yet computed */
    int32_t most_mask; /* bytes */
    int32_t nominal;   /* half-width of a window, PLACE_BITS */
    int32_t least;     /* and the least that it may be narrowed to */
    int32_t grow;      /* how far a window reaches beyond a cluster's last pixels */
    int32_t need;      /* and how far it has to */
    int32_t reach;     /* px about a cluster that are its own */
    int32_t local_background;
    uint32_t off; /* a pixel of the ring may be off the mean by, ST_BACKGROUND_BITS; 0: any */
} terms;

static int32_t least_of(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

static int32_t most_of(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

static int32_t side_of(const st_spot_limits *limits)
{
    return limits->max_extent + 2 * (limits->half_window + RING_GAP_PX + RING_WIDTH_PX + 2) + 2;
}

int32_t st_centroid_room_bytes(const st_spot_limits *limits)
{
    int32_t side = side_of(limits);
    return ((side * side + 3) & ~3) + 2 * side * (int32_t)sizeof(weight);
}

/* Half-width of a window about the centre that holds the cluster and grow beyond it. */
static int32_t half_width(const axis *along, int32_t grow)
{
    int32_t before = along->centre - (along->first * ONE_PX - HALF_PX);
    int32_t after = along->last * ONE_PX + HALF_PX - along->centre;
    return most_of(before, after) + grow;
}

/* Widen a window to its cluster, narrow it to the image: 1 if it had to be, -1 if the cluster does not fit. */
static int32_t set_width(axis *along, const terms *by)
{
    int32_t room = least_of(along->centre + HALF_PX, along->size * ONE_PX - HALF_PX - along->centre);
    along->wide = most_of(by->nominal, half_width(along, by->grow));
    if (room >= along->wide)
        return 0;
    int32_t need = most_of(by->least, half_width(along, by->need));
    if (room < least_of(need, along->wide))
        return -1;
    along->wide = room;
    return 1;
}

/* Mark the pixels within reach of a cluster's runs and of others'. */
static void paint(const terms *by, const st_surroundings *about, int32_t cluster)
{
    int32_t reach = by->reach;
    int32_t width = about->width;
    int32_t below = least_of(about->top + about->height + reach, by->image->rows);
    memset(by->mask, 0, (size_t)(width * about->height));
    for (int32_t row = most_of(about->top - reach, 0); row < below; row++) {
        int32_t first_y = most_of(row - reach - about->top, 0);
        int32_t end_y = least_of(row + reach + 1 - about->top, about->height);
        int32_t end_run = by->row_start[row + 1];
        for (int32_t run = by->row_start[row]; run < end_run; run++) {
            int32_t first = most_of(by->runs[run].first - reach - about->left, 0);
            int32_t length = least_of(by->runs[run].end + reach - about->left, width) - first;
            if (length <= 0)
                continue;
            uint8_t mark = by->label[run] == cluster ? ST_OWN : ST_OTHER;
            uint8_t *line = by->mask + first_y * width + first;
            for (int32_t y = first_y; y < end_y; y++, line += width)
                for (int32_t x = 0; x < length; x++)
                    line[x] |= mark;
        }
    }
}

/* Unmarked pixels of a part of a row, those from least to most: their sum and number are added. */
static inline void add_ring(const uint16_t *pixel, const uint8_t *mask, int32_t length, uint32_t least,
                            uint32_t most, uint32_t *sum, uint32_t *kept)
{
    for (; length > 0; length--) {
        uint32_t value = *pixel++;
        if (*mask++ == 0 && value - least <= most - least) {
            *sum += value;
            ++*kept;
        }
    }
}

/* Mean of the unmarked pixels outside (x0, y0) to (x1, y1); again of those that are off that by no more than
 * by->off. fallback where they are too few. */
static int32_t ring_background(const st_image *image, const st_surroundings *about, const axis *x,
                               const axis *y, const terms *by, int32_t fallback)
{
    int32_t left = most_of(about->left, 0);
    int32_t right = least_of(about->left + about->width, image->columns);
    int32_t bottom = least_of(about->top + about->height, image->rows);
    int32_t inner_left = most_of(x->first, left);
    int32_t inner_right = least_of(x->last + 1, right);
    int32_t level = fallback;
    uint32_t least = 0;
    uint32_t most = 0xffff;
    for (int32_t passes = by->off ? 2 : 1; passes > 0; passes--) {
        uint32_t sum = 0;
        uint32_t kept = 0;
        for (int32_t row = most_of(about->top, 0); row < bottom; row++) {
            const uint16_t *line = image->pixels + row * image->columns;
            const uint8_t *mask = about->mask + (row - about->top) * about->width - about->left;
            if (row < y->first || row > y->last) {
                add_ring(line + left, mask + left, right - left, least, most, &sum, &kept);
            } else {
                add_ring(line + left, mask + left, inner_left - left, least, most, &sum, &kept);
                add_ring(line + inner_right, mask + inner_right, right - inner_right, least, most, &sum,
                         &kept);
            }
        }
        if (kept < LEAST_RING_PX)
            break;
        uint32_t mean = (uint32_t)((((uint64_t)sum << ST_BACKGROUND_BITS) + kept / 2) / kept);
        level = (int32_t)mean;
        least = mean > by->off ? (mean - by->off + (1 << ST_BACKGROUND_BITS) - 1) >> ST_BACKGROUND_BITS : 0;
        most = (mean + by->off) >> ST_BACKGROUND_BITS;
    }
    return level;
}

/* How much of pixel at, which reaches from at - 0.5 to at + 0.5, lies inside the window. */
static inline int32_t share_of(const axis *along, int32_t at)
{
    int32_t from = most_of(at * ONE_PX - HALF_PX, along->centre - along->wide);
    int32_t to = least_of(at * ONE_PX + HALF_PX, along->centre + along->wide);
    return most_of(to - from, 0);
}

/* The pixels of an axis that its window touches, from first to last. */
static void touched(const axis *along, int32_t start, int32_t length, int32_t *first, int32_t *last)
{
    int32_t from = (along->centre - along->wide + HALF_PX) >> PLACE_BITS;
    int32_t to = (along->centre + along->wide - HALF_PX + ONE_PX - 1) >> PLACE_BITS;
    *first = most_of(most_of(from, start), 0);
    *last = least_of(least_of(to, start + length - 1), along->size - 1);
}

/* A number so many bits shorter. */
static inline int64_t rounded(int64_t value, int32_t bits)
{
    return (value + (1 << (bits - 1))) >> bits;
}

/* A window's sums. hug: pixels that are not the cluster's own count for nothing, as those of other clusters
 * always do. weights: room for a row. */
static void sum_window(const st_image *image, const st_surroundings *about, const axis *x, const axis *y,
                       int32_t background, int32_t hug, weight *weights, window_sums *sums)
{
    int32_t first_x, last_x, first_y, last_y;
    touched(x, about->left, about->width, &first_x, &last_x);
    touched(y, about->top, about->height, &first_y, &last_y);
    int32_t left_out = hug ? 0 : ST_OTHER;
    weight *end = weights;
    for (int32_t column = first_x; column <= last_x; column++, end++) {
        end->share = share_of(x, column);
        end->moment = (int32_t)(((int64_t)end->share * (column * ONE_PX - x->centre)) >> PLACE_BITS);
    }
    memset(sums, 0, sizeof *sums);
    for (int32_t row = first_y; row <= last_y; row++) {
        const uint16_t *pixel = image->pixels + row * image->columns + first_x;
        const uint8_t *mask = about->mask + (row - about->top) * about->width + first_x - about->left;
        int32_t share = share_of(y, row);
        int64_t line = 0;
        int64_t line_x = 0;
        if (share == 0)
            continue;
        for (const weight *of = weights; of != end; of++, pixel++) {
            int32_t mark = *mask++;
            if (mark == ST_OTHER || mark == left_out)
                continue;
            int32_t value = (*pixel << ST_BACKGROUND_BITS) - background;
            line += (int64_t)value * of->share;
            line_x += (int64_t)value * of->moment;
        }
        int32_t moment = (int32_t)(((int64_t)share * (row * ONE_PX - y->centre)) >> PLACE_BITS);
        sums->flux += rounded(line, ST_BACKGROUND_BITS + PLACE_BITS - FLUX_BITS) * share;
        sums->moment_x += rounded(line_x, ST_BACKGROUND_BITS + PLACE_BITS - MOMENT_BITS) * share;
        sums->moment_y += rounded(line, ST_BACKGROUND_BITS + PLACE_BITS - MOMENT_BITS) * moment;
    }
}

/* A place some pixels on from a pixel. */
static int32_t place_of(int32_t origin, double pixels)
{
    return (int32_t)((origin + pixels) * ONE_PX + 0.5);
}

/* A place moved by some pixels, rounded to PLACE_BITS. However far off, it stays within 32 bits. */
static int32_t moved_by(int32_t place, double pixels)
{
    const int32_t most = 16000;
    if (pixels > most || pixels < -most)
        pixels = pixels > 0.0 ? most : -most;
    return place + (int32_t)(pixels * ONE_PX + (most * (double)ONE_PX + 0.5)) - most * ONE_PX;
}

/* Why a cluster need not be measured, or -1. */
static int32_t refused(const st_image *image, const st_cluster *cluster, const st_spot_limits *limits)
{
    int32_t extent = most_of(cluster->last_x - cluster->first_x, cluster->last_y - cluster->first_y);
    if (cluster->pixels < limits->min_pixels)
        return ST_SMALL;
    if (cluster->pixels > limits->max_pixels || extent >= limits->max_extent)
        return ST_LARGE;
    if (cluster->first_x == 0 || cluster->first_y == 0 || cluster->last_x == image->columns - 1 ||
        cluster->last_y == image->rows - 1)
        return ST_EDGE;
    return cluster->sum <= 0 ? ST_FAINT : -1;
}

/* A centroid may lie a pixel off its cluster. */
static int32_t within_cluster(const axis *along, double px)
{
    return px >= along->first - 1 && px <= along->last + 1;
}

/* The square around a cluster that its window may touch in any pass, with the ring outside it; inner_x and
 * inner_y: without the ring. */
static void surround(const axis *x, const axis *y, axis *inner_x, axis *inner_y, st_surroundings *about,
                     const uint8_t *mask)
{
    const axis *along[2] = {x, y};
    axis *inner[2] = {inner_x, inner_y};
    for (int32_t i = 0; i < 2; i++) {
        int32_t from = (along[i]->centre - along[i]->wide) >> PLACE_BITS;
        int32_t to = (along[i]->centre + along[i]->wide + ONE_PX - 1) >> PLACE_BITS;
        inner[i]->first = least_of(from - RING_GAP_PX, along[i]->first - 1);
        inner[i]->last = most_of(to + RING_GAP_PX, along[i]->last + 1);
    }
    about->mask = mask;
    about->left = inner_x->first - RING_WIDTH_PX;
    about->top = inner_y->first - RING_WIDTH_PX;
    about->width = inner_x->last + RING_WIDTH_PX + 1 - about->left;
    about->height = inner_y->last + RING_WIDTH_PX + 1 - about->top;
}

/* The passes of the centre of mass: its place to x_px and y_px, the last window's sums; narrowed: by the
 * image's edge. Returns why the cluster is no spot, or -1. */
static int32_t centre_of_mass(const terms *by, const st_surroundings *about, axis *x, axis *y,
                              int32_t background, window_sums *sums, int32_t *narrowed, double *x_px,
                              double *y_px)
{
    int32_t hug = x->wide > by->nominal + ONE_PX || y->wide > by->nominal + ONE_PX;
    for (int32_t pass = 0; pass < RECENTRINGS; pass++) {
        int32_t narrow_x = set_width(x, by);
        int32_t narrow_y = set_width(y, by);
        if (narrow_x < 0 || narrow_y < 0)
            return ST_EDGE;
        *narrowed = narrow_x || narrow_y;
        sum_window(by->image, about, x, y, background, hug, by->weights, sums);
        if (sums->flux <= LEAST_FLUX)
            return ST_FAINT;
        double flux = (double)sums->flux * (1.0 / (1 << (FLUX_BITS - MOMENT_BITS)));
        double right = (double)sums->moment_x / flux;
        double down = (double)sums->moment_y / flux;
        *x_px = x->centre * (1.0 / ONE_PX) + right;
        *y_px = y->centre * (1.0 / ONE_PX) + down;
        x->centre = moved_by(x->centre, right);
        y->centre = moved_by(y->centre, down);
    }
    return within_cluster(x, *x_px) && within_cluster(y, *y_px) ? -1 : ST_FAINT;
}

/* A cluster measured; returns why it is no spot, or -1. */
static int32_t measure(terms *by, const st_cluster *cluster, int32_t index, st_spot *spot)
{
    const st_spot_limits *limits = by->limits;
    st_surroundings about;
    window_sums sums;
    axis x = {.size = by->image->columns, .first = cluster->first_x, .last = cluster->last_x};
    axis y = {.size = by->image->rows, .first = cluster->first_y, .last = cluster->last_y};
    axis inner_x, inner_y;
    double sum = (double)cluster->sum;
    double x_px, y_px;
    int32_t narrowed;
    x.centre = place_of(cluster->origin_x, (double)cluster->sum_x / sum);
    y.centre = place_of(cluster->origin_y, (double)cluster->sum_y / sum);
    x.wide = most_of(by->nominal, half_width(&x, by->grow));
    y.wide = most_of(by->nominal, half_width(&y, by->grow));
    surround(&x, &y, &inner_x, &inner_y, &about, by->mask);
    if (about.width * about.height > by->most_mask)
        return ST_LARGE;
    paint(by, &about, index);
    int32_t background = cluster->background;
    if (by->local_background)
        background = ring_background(by->image, &about, &inner_x, &inner_y, by, background);
    int32_t reason = centre_of_mass(by, &about, &x, &y, background, &sums, &narrowed, &x_px, &y_px);
    if (reason >= 0)
        return reason;

    uint32_t peak = (uint32_t)cluster->brightest_dn << ST_BACKGROUND_BITS;
    if (peak < (uint32_t)cluster->background)
        peak = (uint32_t)cluster->background;
    spot->flux_dn = (double)sums.flux * (1.0 / ((int64_t)1 << (FLUX_BITS + PLACE_BITS)));
    spot->peak_dn = (double)((int64_t)peak - background) * (1.0 / (1 << ST_BACKGROUND_BITS));
    spot->magnitude = -2.5 * log10(spot->flux_dn / limits->zero_point_dn);
    if (!(spot->magnitude <= limits->magnitude_limit))
        return ST_FAINT;
    if (spot->peak_dn > limits->max_peak_fraction * spot->flux_dn)
        return ST_SHARP;
    int32_t saturated = cluster->brightest_dn >= limits->saturation_dn;
    if (limits->interpolation.wanted && !saturated) {
        double half = limits->half_window;
        /* The window's width times the root of the mean of x^2 over it: what noise does to a moment. */
        if (by->spread == 0.0)
            by->spread = (2.0 * half + 1.0) * sqrt(half * (half + 1.0) / 3.0) * by->noise_dn;
        st_interpolate(by->image, &about, background, by->spread / spot->flux_dn, &limits->interpolation,
                       &x_px, &y_px);
    }
    spot->x_px = x_px;
    spot->y_px = y_px;
    spot->pixels = cluster->pixels;
    spot->flags = (saturated ? ST_SATURATED : 0) | (narrowed ? ST_AT_EDGE : 0);
    return -1;
}

int32_t st_measure_spots(const st_image *image, const st_run *runs, const int32_t *row_start,
                         const int32_t *label, const st_cluster *clusters, int32_t number, double noise_dn,
                         int32_t local_background, int32_t reach, const st_spot_limits *limits,
                         st_spot *spots, int8_t *outcome, int32_t *rejected, void *room)
{
    int32_t half = limits->half_window;
    int32_t side = side_of(limits);
    double off = 3.0 * noise_dn < MOST_DN ? 3.0 * noise_dn : MOST_DN;
    terms by = {
        .image = image,
        .runs = runs,
        .row_start = row_start,
        .label = label,
        .limits = limits,
        .noise_dn = noise_dn,
        .mask = room,
        .weights = (weight *)(void *)((uint8_t *)room + ((side * side + 3) & ~3)),
        .most_mask = side * side,
        .nominal = half * ONE_PX + HALF_PX,
        .least = least_of(2 * ONE_PX, half * ONE_PX + HALF_PX),
        .grow = reach > 0 ? HALF_PX : -HALF_PX,
        .need = reach > 0 ? HALF_PX : 0,
        .reach = reach,
        .local_background = local_background,
        .off = (uint32_t)(off * (1 << ST_BACKGROUND_BITS)),
    };
    int32_t found = 0;
    for (int32_t i = 0; i < number; i++) {
        int32_t reason = refused(image, &clusters[i], limits);
        if (reason < 0)
            reason = measure(&by, &clusters[i], i, &spots[found]);
        outcome[i] = (int8_t)reason;
        if (reason < 0)
            found++;
        else
            rejected[reason]++;
    }
    return found;
}

/* The centroid of a cluster as it is; returns why it is no spot, or -1. */
static int32_t mean_of(const st_cluster *cluster, const st_spot_limits *limits, st_spot *spot)
{
    double sum = (double)cluster->sum;
    uint32_t peak = (uint32_t)cluster->brightest_dn << ST_BACKGROUND_BITS;
    if (peak < (uint32_t)cluster->background)
        peak = (uint32_t)cluster->background;
    spot->flux_dn = sum * (1.0 / (1 << ST_BACKGROUND_BITS));
    spot->peak_dn = (double)((int64_t)peak - cluster->background) * (1.0 / (1 << ST_BACKGROUND_BITS));
    spot->magnitude = -2.5 * log10(spot->flux_dn / limits->zero_point_dn);
    if (!(spot->magnitude <= limits->magnitude_limit))
        return ST_FAINT;
    if (spot->peak_dn > limits->max_peak_fraction * spot->flux_dn)
        return ST_SHARP;
    spot->x_px = cluster->origin_x + (double)cluster->sum_x / sum;
    spot->y_px = cluster->origin_y + (double)cluster->sum_y / sum;
    spot->pixels = cluster->pixels;
    spot->flags = cluster->brightest_dn >= limits->saturation_dn ? ST_SATURATED : 0;
    return -1;
}

int32_t st_measure_clusters(const st_image *image, const st_cluster *clusters, int32_t number,
                            const st_spot_limits *limits, st_spot *spots, int8_t *outcome, int32_t *rejected)
{
    int32_t found = 0;
    for (int32_t i = 0; i < number; i++) {
        int32_t reason = refused(image, &clusters[i], limits);
        if (reason < 0)
            reason = mean_of(&clusters[i], limits, &spots[found]);
        outcome[i] = (int8_t)reason;
        if (reason < 0)
            found++;
        else
            rejected[reason]++;
    }
    return found;
}

/* The bits of a positive double are in its order. */
static uint64_t key_of(const st_spot *spot)
{
    uint64_t bits;
    memcpy(&bits, &spot->flux_dn, sizeof bits);
    return bits;
}

int32_t st_order_spots(const st_spot *spots, int32_t count, int32_t most, int32_t *order, st_spot *ordered)
{
    int32_t *from = order;
    int32_t *to = order + count;
    for (int32_t i = 0; i < count; i++)
        from[i] = i;
    /* Merging pairs of ordered pieces leaves equal ones as they were. */
    for (int32_t piece = 1; piece < count; piece *= 2) {
        for (int32_t begin = 0; begin < count; begin += 2 * piece) {
            int32_t middle = least_of(begin + piece, count);
            int32_t end = least_of(begin + 2 * piece, count);
            int32_t a = begin;
            int32_t b = middle;
            for (int32_t i = begin; i < end; i++) {
                int32_t first = b == end ||
                                (a < middle && key_of(&spots[from[a]]) >= key_of(&spots[from[b]]));
                to[i] = first ? from[a++] : from[b++];
            }
        }
        int32_t *swapped = from;
        from = to;
        to = swapped;
    }
    int32_t kept = least_of(count, most);
    for (int32_t i = 0; i < kept; i++)
        ordered[i] = spots[from[i]];
    return kept;
}
