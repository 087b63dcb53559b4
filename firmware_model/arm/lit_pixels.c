/* Lit pixels and stars of a whole frame: firmware_model/image/lit_pixels.py, after Fasano et al. 2013, section
 * 2.1: pixels over mean + 3 sigma of the whole frame are kept.
 *
 * Sums of pixels and of their squares are whole numbers of 64 bits, gathered in 32 over a block; mean, root and
 * threshold are double, once a frame. Values are 1/16 DN over the mean rounded down to that. So all is the Python
 * stage's to the last bit. Pixels are read two in a word; where the converter has at most 12 bits they are added
 * so and squared by the multiplier for halves of words. As in threshold.c, one addition tells whether one of two
 * pixels is over the threshold, and only blocks with such a pixel are looked at again. */
#include "optical_flow.h"

#include <math.h>

#define NOINLINE __attribute__((noinline))
#define TOP_BITS 0x80008000u
#define NARROW_BITS 12
#define BLOCK_WORDS (ST_FLOW_BLOCK_PX / 2)

typedef struct {
    uint64_t sum, squares;
} pixel_sums;

#define ADD_SQUARES(pair)                                                                                    \
    both += pair;                                                                                            \
    square += (int16_t)(pair) * (int16_t)(pair);                                                             \
    square += ((int32_t)(pair) >> 16) * ((int32_t)(pair) >> 16);
#define FOUR_SQUARES(at)                                                                                     \
    ADD_SQUARES(word[at])                                                                                    \
    ADD_SQUARES(word[at + 1])                                                                                \
    ADD_SQUARES(word[at + 2])                                                                                \
    ADD_SQUARES(word[at + 3])

/* Blocks of pixels of at most NARROW_BITS: their sum fits into half a word, that of their squares into one. */
static NOINLINE void add_narrow(const uint32_t *word, int32_t blocks, pixel_sums *sums)
{
    uint64_t sum = 0, squares = 0;
    for (; blocks > 0; blocks--, word += BLOCK_WORDS) {
        uint32_t both = 0;
        int32_t square = 0;
        FOUR_SQUARES(0)
        FOUR_SQUARES(4) FOUR_SQUARES(8) FOUR_SQUARES(12) sum += (both & 0xffff) + (both >> 16);
        squares += (uint32_t)square;
    }
    sums->sum += sum;
    sums->squares += squares;
}

static NOINLINE void add_wide(const uint16_t *pixel, int32_t pixels, pixel_sums *sums)
{
    uint64_t sum = 0, squares = 0;
    for (; pixels > 0; pixels--) {
        uint32_t value = *pixel++;
        sum += value;
        squares += (uint64_t)value * value;
    }
    sums->sum += sum;
    sums->squares += squares;
}

/* Pixels over the limit, one by one: 0 where the table of runs is full. */
static NOINLINE int32_t look_at(const uint16_t *pixel, int32_t row, int32_t column, int32_t end,
                                uint32_t limit, st_lit *lit)
{
    for (; column < end; column++) {
        uint32_t value = *pixel++;
        if (value <= limit)
            continue;
        st_run *run = lit->runs + lit->run_count;
        if (lit->run_count > 0 && run[-1].row == row && run[-1].end == column) {
            run[-1].end = column + 1;
        } else {
            if (lit->run_count == lit->capacity)
                return 0;
            run->row = row;
            run->first = column;
            run->end = column + 1;
            lit->offsets[lit->run_count] = lit->lit;
            lit->run_background[lit->run_count++] = lit->level << (ST_BACKGROUND_BITS - ST_VALUE_BITS);
        }
        lit->values[lit->lit++] = (int32_t)(value << ST_VALUE_BITS) - lit->level;
    }
    return 1;
}

#define SEE_NARROW(pair) seen |= pair + lift;
#define SEE_WIDE(pair) seen |= pair | (pair + lift);
#define FOUR_WORDS(SEE, at) SEE(word[at]) SEE(word[at + 1]) SEE(word[at + 2]) SEE(word[at + 3])
#define SIXTEEN_WORDS(SEE) FOUR_WORDS(SEE, 0) FOUR_WORDS(SEE, 4) FOUR_WORDS(SEE, 8) FOUR_WORDS(SEE, 12)

/* The next of blocks that may have a pixel over the limit, or their number. */
static NOINLINE int32_t next_narrow(const uint32_t *words, int32_t block, int32_t blocks, uint32_t lift)
{
    const uint32_t *word = words + block * BLOCK_WORDS;
    for (; block < blocks; block++, word += BLOCK_WORDS) {
        uint32_t seen = 0;
        SIXTEEN_WORDS(SEE_NARROW)
        if (seen & TOP_BITS)
            break;
    }
    return block;
}

static NOINLINE int32_t next_wide(const uint32_t *words, int32_t block, int32_t blocks, uint32_t lift)
{
    const uint32_t *word = words + block * BLOCK_WORDS;
    for (; block < blocks; block++, word += BLOCK_WORDS) {
        uint32_t seen = 0;
        SIXTEEN_WORDS(SEE_WIDE)
        if (seen & TOP_BITS)
            break;
    }
    return block;
}

/* One row: whole blocks where it begins at a whole word, all else pixel by pixel; 0 where the table is full. */
static int32_t scan_row(const uint16_t *line, int32_t row, int32_t columns, uint32_t limit, int32_t wide,
                        st_lit *lit)
{
    uint32_t lift = limit < 0x7fff ? 0x7fff - limit : 0;
    int32_t blocks = (uintptr_t)line & 2 ? 0 : columns / ST_FLOW_BLOCK_PX;
    const uint32_t *words = (const uint32_t *)(const void *)line;
    int32_t column = 0;
    lift |= lift << 16;
    for (int32_t block = 0; block < blocks; block++) {
        block = wide ? next_wide(words, block, blocks, lift) : next_narrow(words, block, blocks, lift);
        column = block * ST_FLOW_BLOCK_PX;
        if (block < blocks && !look_at(line + column, row, column, column + ST_FLOW_BLOCK_PX, limit, lit))
            return 0;
    }
    column = blocks * ST_FLOW_BLOCK_PX;
    return look_at(line + column, row, column, columns, limit, lit);
}

void st_light_up(const st_image *image, double sigma_factor, int32_t bits, st_lit *lit)
{
    int32_t pixels = image->rows * image->columns;
    int32_t wide = bits > NARROW_BITS;
    int32_t blocks = wide ? 0 : pixels / ST_FLOW_BLOCK_PX;
    int32_t in_blocks = blocks * ST_FLOW_BLOCK_PX;
    pixel_sums sums = {0, 0};
    add_narrow((const uint32_t *)(const void *)image->pixels, blocks, &sums);
    add_wide(image->pixels + in_blocks, pixels - in_blocks, &sums);
    double count = pixels;
    double mean = (double)sums.sum / count;
    double variance = (double)sums.squares / count - mean * mean;
    lit->mean_dn = mean;
    lit->sigma_dn = variance > 0.0 ? sqrt(variance) : 0.0;
    double limit = floor(mean + sigma_factor * lit->sigma_dn);
    lit->level = (int32_t)(mean * (1 << ST_VALUE_BITS)); /* not negative */
    lit->run_count = 0;
    lit->lit = 0;
    lit->overflowed = 0;
    uint32_t whole = limit < 65535.0 ? (uint32_t)limit : 65535;
    const uint16_t *line = image->pixels;
    for (int32_t row = 0; row < image->rows; row++, line += image->columns) {
        lit->row_start[row] = lit->run_count;
        if (!scan_row(line, row, image->columns, whole, wide, lit)) {
            lit->overflowed = 1;
            while (++row < image->rows)
                lit->row_start[row] = lit->run_count;
        }
    }
    lit->row_start[image->rows] = lit->run_count;
}

/* Whether a cluster may be a star: whole, of a size, not at the edge, where a part of it may be outside. */
static int32_t is_star(const st_image *image, const st_cluster *cluster, const st_flow_limits *limits)
{
    return cluster->pixels >= limits->min_pixels && cluster->pixels <= limits->max_pixels &&
           cluster->first_x > 0 && cluster->last_x < image->columns - 1 && cluster->first_y > 0 &&
           cluster->last_y < image->rows - 1 && cluster->last_x - cluster->first_x < limits->max_extent &&
           cluster->last_y - cluster->first_y < limits->max_extent;
}

/* Order by brightness, merging pairs of ordered pieces: equal ones stay as they were. Returns which half of the
 * room has the result. */
static int32_t *ordered(const st_cluster *clusters, int32_t *from, int32_t *to, int32_t count)
{
    for (int32_t piece = 1; piece < count; piece *= 2) {
        for (int32_t begin = 0; begin < count; begin += 2 * piece) {
            int32_t middle = begin + piece < count ? begin + piece : count;
            int32_t end = begin + 2 * piece < count ? begin + 2 * piece : count;
            int32_t a = begin;
            int32_t b = middle;
            for (int32_t i = begin; i < end; i++) {
                int32_t first = b == end || (a < middle && clusters[from[a]].sum >= clusters[from[b]].sum);
                to[i] = first ? from[a++] : from[b++];
            }
        }
        int32_t *swapped = from;
        from = to;
        to = swapped;
    }
    return from;
}

int32_t st_flow_stars(const st_image *image, const st_cluster *clusters, int32_t number,
                      const st_flow_limits *limits, int32_t *order, st_flow_star *stars)
{
    const double one_dn = 1 << ST_BACKGROUND_BITS;
    int32_t count = 0;
    for (int32_t i = 0; i < number; i++)
        if (is_star(image, &clusters[i], limits))
            order[count++] = i;
    const int32_t *brightest = ordered(clusters, order, order + count, count);
    if (count > limits->max_stars)
        count = limits->max_stars;
    for (int32_t i = 0; i < count; i++) {
        const st_cluster *cluster = &clusters[brightest[i]];
        st_flow_star *star = &stars[i];
        double sum = (double)cluster->sum;
        int64_t brightest_dn = (int64_t)cluster->brightest_dn << ST_BACKGROUND_BITS;
        star->x_px = (double)(cluster->sum_x + cluster->sum * cluster->origin_x) / sum;
        star->y_px = (double)(cluster->sum_y + cluster->sum * cluster->origin_y) / sum;
        star->flux_dn = sum / one_dn;
        star->peak_dn = (double)(brightest_dn - cluster->background) / one_dn;
        star->pixels = cluster->pixels;
        star->first_x = cluster->first_x;
        star->last_x = cluster->last_x;
        star->first_y = cluster->first_y;
        star->last_y = cluster->last_y;
    }
    return count;
}
