/* Background, noise and threshold of a whole frame: firmware_model/image/background.py (frame_statistics)
 * and clustering.py (threshold_scan), after Marciniak et al., section 2.1: pixels over a moving average along
 * a zigzag scan are kept, coded as runs.
 *
 * Statistics are whole numbers: samples of 16 bits, their squares in 64 bits; the few square roots and
 * quotients between two passes are double. So they are the Python stage's to the last bit.
 * The moving average has 15 bits behind the point, as much as 16-bit pixels leave of a word: rounding once a
 * block it strays by some 2e-5 DN, and a pixel is judged otherwise only where it equals the threshold and
 * that lies so near to a whole number.
 * Pixels are read two in a word. One word's test for a pixel over the threshold is an addition that carries
 * into the pixels' highest bits; only blocks where it did are looked at again. */
#include "threshold.h"

#include <math.h>

#define ONE (1 << ST_BACKGROUND_BITS)
#define GAIN_BITS 30
#define INVERSE_BITS 31
#define TOP_BITS 0x80008000u
#define MOST_DN 65535.0
#define BLOCK_BITS 5   /* 2^5 pixels */
#define NARROW_BITS 12 /* sums of 16 pixels so wide stay within 16 bits */

/* Loops that are to have the registers for themselves. */
#define NOINLINE __attribute__((noinline))

/* 2^64 times the golden ratio less one: the samples' columns are spread evenly by it. */
#define GOLDEN_STEP 0x9e3779b97f4a7c16ull

enum { PAIR_DISTANCE_PX = 4, MOST_PASSES = 12, DIGIT_BITS = 8, DIGITS = 1 << DIGIT_BITS };

static int32_t least_of(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

/* Pixels and their differences (absolute) from pixels a few columns on, evenly over the frame. */
static int32_t take_samples(const st_image *image, uint16_t *values, uint16_t *differences)
{
    int32_t distance = least_of(PAIR_DISTANCE_PX, image->columns - 1);
    uint32_t usable = (uint32_t)(image->columns - distance);
    uint64_t total = (uint64_t)usable * (uint32_t)image->rows;
    int32_t count = total < ST_NOISE_SAMPLES ? (int32_t)total : ST_NOISE_SAMPLES;
    const uint16_t *line = image->pixels;
    int32_t rest = 0;
    uint64_t phase = 0;
    for (int32_t i = 0; i < count; i++) {
        /* phase * usable / 2^64: that many columns of it */
        uint64_t low = (uint64_t)(uint32_t)phase * usable;
        uint32_t column = (uint32_t)(((phase >> 32) * usable + (low >> 32)) >> 32);
        int32_t value = line[column];
        int32_t difference = value - line[column + (uint32_t)distance];
        values[i] = (uint16_t)value;
        differences[i] = (uint16_t)(difference < 0 ? -difference : difference);
        phase += GOLDEN_STEP;
        rest += image->rows; /* sample i lies in row i rows / count */
        while (rest >= count) {
            rest -= count;
            line += image->columns;
        }
    }
    return count;
}

/* R.m.s. of the differences up to limit. */
static double deviation(const uint16_t *differences, int32_t count, uint32_t limit)
{
    uint64_t squares = 0;
    int32_t kept = 0;
    for (int32_t i = 0; i < count; i++) {
        uint32_t difference = differences[i];
        if (difference <= limit) {
            squares += (uint64_t)difference * difference;
            kept++;
        }
    }
    return kept ? sqrt((double)squares / kept) : 0.0;
}

/* Which digit the sample of this rank has, the rank within it in *rank. */
static int32_t digit_of_rank(const int32_t *histogram, int32_t *rank)
{
    int32_t digit = 0;
    while (*rank >= histogram[digit])
        *rank -= histogram[digit++];
    return digit;
}

/* The value of a rank (0: the least), found digit by digit. high[DIGITS]: how many have each high digit. */
static int32_t value_of_rank(const uint16_t *values, int32_t count, const int32_t *high, int32_t rank)
{
    int32_t low[DIGITS] = {0};
    int32_t first = digit_of_rank(high, &rank);
    for (int32_t i = 0; i < count; i++)
        if (values[i] >> DIGIT_BITS == first)
            low[values[i] & (DIGITS - 1)]++;
    return first << DIGIT_BITS | digit_of_rank(low, &rank);
}

/* Twice the median, a whole number also for an even number of values. */
static int32_t twice_median(const uint16_t *values, int32_t count)
{
    int32_t high[DIGITS] = {0};
    for (int32_t i = 0; i < count; i++)
        high[values[i] >> DIGIT_BITS]++;
    return value_of_rank(values, count, high, (count - 1) / 2) +
           value_of_rank(values, count, high, count / 2);
}

void st_frame_statistics(const st_image *image, st_statistics *statistics)
{
    static uint16_t values[ST_NOISE_SAMPLES];
    static uint16_t differences[ST_NOISE_SAMPLES];
    int32_t count = take_samples(image, values, differences);
    uint32_t sum = 0;
    for (int32_t i = 0; i < count; i++)
        sum += differences[i];
    double sigma = 1.2533 * ((double)sum / count);
    if (sigma < 1.0)
        sigma = 1.0;
    for (int32_t pass = 0; pass < MOST_PASSES; pass++) {
        double before = sigma;
        sigma = deviation(differences, count, (uint32_t)(4.0 * sigma));
        if (fabs(sigma - before) <= 0.01 * before || sigma == 0.0)
            break;
    }
    double noise = sigma / sqrt(2.0);
    int32_t median = twice_median(values, count);
    int32_t limit = (int32_t)(6.0 * (noise > 0.5 ? noise : 0.5)); /* twice 3 sigma */
    int32_t kept = 0;
    sum = 0;
    for (int32_t i = 0; i < count; i++) {
        int32_t off = 2 * values[i] - median;
        if ((off < 0 ? -off : off) <= limit) {
            sum += values[i];
            kept++;
        }
    }
    statistics->background_dn = kept ? (double)sum / kept : 0.5 * median;
    statistics->noise_dn = noise;
}

/* One block of a row: the average when it was reached and its pixels over the threshold, the first one the
 * highest bit. */
typedef struct {
    int32_t average;
    uint32_t over;
} block;

/* What the blocks of a frame have to go by. */
typedef struct {
    uint32_t over;     /* DN over the average, ST_BACKGROUND_BITS behind the point */
    int32_t gain;      /* how far a whole block moves the average, 2^GAIN_BITS: all the way */
    int32_t rest_gain; /* and a row's last one of rest pixels */
    int32_t whole;     /* whole blocks in a row */
    int32_t rest;
    uint32_t inverse;   /* of rest, 2^INVERSE_BITS: 1 */
    int32_t wide;       /* pixels may have more than NARROW_BITS */
    block *first_found; /* the first of a row's blocks with a pixel over the threshold, so far */
    block *last_found;
} scan_terms;

static inline uint32_t limit_of(int32_t average, const scan_terms *terms)
{
    return ((uint32_t)average + terms->over) >> ST_BACKGROUND_BITS;
}

/* Average moved towards the mean of some pixels. */
static inline int32_t moved(int32_t average, int32_t mean, int32_t gain)
{
    return average + (int32_t)(((int64_t)(mean - average) * gain + (1 << (GAIN_BITS - 1))) >> GAIN_BITS);
}

/* Pixels over limit; what they have over it is taken from *sum. */
static NOINLINE uint32_t pixels_over(const uint16_t *pixel, int32_t pixels, uint32_t limit, uint32_t *sum)
{
    uint32_t over = 0;
    uint32_t excess = 0;
    for (int32_t i = 0; i < pixels; i++) {
        uint32_t value = pixel[i];
        over <<= 1;
        if (value > limit) {
            excess += value - limit;
            over |= 1;
        }
    }
    *sum -= excess;
    return over << (ST_BLOCK_PX - pixels);
}

/* Note the pixels of a block that are over the threshold. */
static inline void keep_over(block *here, scan_terms *terms, const uint16_t *pixel, int32_t pixels,
                             uint32_t limit, uint32_t *sum)
{
    here->over = pixels_over(pixel, pixels, limit, sum);
    if (here < terms->first_found)
        terms->first_found = here;
    if (here > terms->last_found)
        terms->last_found = here;
}

/* Added to a pixel it sets the highest bit of one over limit. A pixel of 32768 DN or more has that set
 * already: whether it is over a limit as high, pixels_over tells. */
static inline uint32_t lift_of(uint32_t limit)
{
    uint32_t lift = limit < 0x7fff ? 0x7fff - limit : 0;
    return lift | lift << 16;
}

#define ADD_NARROW(pair)                                                                                     \
    both += pair;                                                                                            \
    seen |= pair + lift;
#define ADD_WIDE(pair)                                                                                       \
    both += pair;                                                                                            \
    upper += pair >> 16;                                                                                     \
    seen |= pair | (pair + lift);
#define FOUR_WORDS(ADD, at) ADD(word[at]) ADD(word[at + 1]) ADD(word[at + 2]) ADD(word[at + 3])
#define SIXTEEN_WORDS(ADD) FOUR_WORDS(ADD, 0) FOUR_WORDS(ADD, 4) FOUR_WORDS(ADD, 8) FOUR_WORDS(ADD, 12)

/* The sum of a block's pixels; in *over the highest bit of each pixel's place is set if one of them is over
 * what lift was made from. */
static inline uint32_t sum_narrow(const uint32_t *word, uint32_t lift, uint32_t *over)
{
    uint32_t both = 0, seen = 0;
    SIXTEEN_WORDS(ADD_NARROW)
    *over = seen;
    return (both & 0xffff) + (both >> 16);
}

/* Sums of pixels too wide for two of them in a word: both is that of the lower ones + 2^16 that of the upper
 * ones, modulo 2^32. */
static inline uint32_t sum_wide(const uint32_t *word, uint32_t lift, uint32_t *over)
{
    uint32_t both = 0, upper = 0, seen = 0;
    SIXTEEN_WORDS(ADD_WIDE)
    *over = seen;
    return both - (upper << 16) + upper;
}

/* The same of any number of pixels: two in a word, or one by one where they do not make whole words. */
static uint32_t sum_pixels(const uint16_t *pixel, int32_t pixels, uint32_t lift, uint32_t *over)
{
    uint32_t both = 0, upper = 0, seen = 0;
    if (((uintptr_t)pixel & 2) || (pixels & 1)) {
        for (; pixels > 0; pixels--) {
            uint32_t one = *pixel++;
            ADD_NARROW(one)
            seen |= one;
        }
        *over = seen;
        return both;
    }
    const uint32_t *word = (const uint32_t *)(const void *)pixel;
    for (; pixels > 0; pixels -= 2) {
        uint32_t two = *word++;
        ADD_WIDE(two)
    }
    *over = seen;
    return both - (upper << 16) + upper;
}

/* A row's last pixels, or a block that does not begin at a whole word. */
static NOINLINE int32_t scan_pixels(const uint16_t *pixel, int32_t pixels, scan_terms *terms, int32_t average,
                                    block *here)
{
    uint32_t limit = limit_of(average, terms);
    uint32_t seen;
    uint32_t sum = sum_pixels(pixel, pixels, lift_of(limit), &seen);
    here->average = average;
    here->over = 0;
    if (seen & TOP_BITS)
        keep_over(here, terms, pixel, pixels, limit, &sum);
    if (pixels == ST_BLOCK_PX)
        return moved(average, (int32_t)(sum << (ST_BACKGROUND_BITS - BLOCK_BITS)), terms->gain);
    uint64_t mean = ((uint64_t)sum * terms->inverse) >> (INVERSE_BITS - ST_BACKGROUND_BITS);
    return moved(average, (int32_t)mean, terms->rest_gain);
}

/* The whole blocks of a row, step 1 from the first, or -1 from the last; returns the average after them. */
static inline int32_t scan_blocks(const uint16_t *pixel, int32_t step, int32_t wide, scan_terms *terms,
                                  int32_t average, block *here)
{
    for (int32_t left = terms->whole; left > 0; left--) {
        const uint32_t *word = (const uint32_t *)(const void *)pixel;
        uint32_t limit = limit_of(average, terms);
        uint32_t lift = lift_of(limit);
        uint32_t seen;
        uint32_t sum = wide ? sum_wide(word, lift, &seen) : sum_narrow(word, lift, &seen);
        here->average = average;
        here->over = 0;
        if (seen & TOP_BITS)
            keep_over(here, terms, pixel, ST_BLOCK_PX, limit, &sum);
        average = moved(average, (int32_t)(sum << (ST_BACKGROUND_BITS - BLOCK_BITS)), terms->gain);
        pixel += step * ST_BLOCK_PX;
        here += step;
    }
    return average;
}

static NOINLINE int32_t scan_narrow(const uint16_t *pixel, int32_t step, scan_terms *terms, int32_t average,
                                    block *here)
{
    return scan_blocks(pixel, step, 0, terms, average, here);
}

static NOINLINE int32_t scan_wide(const uint16_t *pixel, int32_t step, scan_terms *terms, int32_t average,
                                  block *here)
{
    return scan_blocks(pixel, step, 1, terms, average, here);
}

/* A row in its direction; returns the average after it. */
static int32_t scan_row(const uint16_t *line, int32_t backwards, scan_terms *terms, int32_t average,
                        block *blocks)
{
    int32_t whole = terms->whole;
    int32_t step = backwards ? -1 : 1;
    int32_t first = backwards ? whole - 1 : 0;
    const uint16_t *last = line + whole * ST_BLOCK_PX;
    if (terms->rest && backwards)
        average = scan_pixels(last, terms->rest, terms, average, &blocks[whole]);
    if ((uintptr_t)line & 2)
        for (int32_t at = first; at >= 0 && at < whole; at += step)
            average = scan_pixels(line + at * ST_BLOCK_PX, ST_BLOCK_PX, terms, average, &blocks[at]);
    else if (terms->wide)
        average = scan_wide(line + first * ST_BLOCK_PX, step, terms, average, &blocks[first]);
    else
        average = scan_narrow(line + first * ST_BLOCK_PX, step, terms, average, &blocks[first]);
    if (terms->rest && !backwards)
        average = scan_pixels(last, terms->rest, terms, average, &blocks[whole]);
    return average;
}

typedef struct {
    st_run *runs;
    int32_t *background;
    int32_t count, capacity;
} run_table;

/* The runs of a row from its blocks between the first and the last that were found to have pixels over the
 * threshold; 0 where the table is full. */
static NOINLINE int32_t runs_of_row(const scan_terms *terms, const block *blocks, int32_t row,
                                    int32_t columns, run_table *table)
{
    st_run *run = table->runs + table->count;
    const block *here = terms->first_found;
    int32_t first = (here - blocks) * ST_BLOCK_PX;
    int32_t inside = 0;
    for (; here <= terms->last_found; first += ST_BLOCK_PX, here++) {
        uint32_t over = here->over;
        int32_t column = first;
        if (over == 0 && !inside)
            continue;
        for (;;) {
            if (inside) {
                int32_t length = over == 0xffffffffu ? ST_BLOCK_PX : __builtin_clz(~over);
                column += length;
                if (column == first + ST_BLOCK_PX)
                    break; /* it goes on in the next block */
                run++->end = column;
                inside = 0;
                over <<= length;
            }
            if (over == 0)
                break;
            int32_t gap = __builtin_clz(over);
            column += gap;
            over <<= gap;
            if (table->count == table->capacity)
                return 0;
            run->row = row;
            run->first = column;
            table->background[table->count++] = here->average;
            inside = 1;
        }
    }
    if (inside)
        run->end = least_of(first, columns);
    return 1;
}

int32_t st_threshold_scan(const st_image *image, const st_threshold *threshold, st_run *runs,
                          int32_t *run_background, int32_t *row_start, int32_t *room)
{
    int32_t columns = image->columns;
    block *blocks = (block *)room;
    run_table table = {runs, run_background, 0, threshold->capacity};
    /* More than any pixel can have is as good as the most, and keeps the sum within 32 bits. */
    double over_dn = threshold->over_dn < MOST_DN ? threshold->over_dn : MOST_DN;
    int32_t average = (int32_t)(threshold->background_dn * ONE + 0.5);
    uint32_t length = (uint32_t)threshold->average_pixels;
    scan_terms terms;
    if (length < ST_BLOCK_PX)
        length = ST_BLOCK_PX;
    terms.over = (uint32_t)(over_dn * ONE + 0.5);
    terms.whole = columns / ST_BLOCK_PX;
    terms.rest = columns - terms.whole * ST_BLOCK_PX;
    terms.gain = (int32_t)(((uint64_t)ST_BLOCK_PX << GAIN_BITS) / length);
    terms.rest_gain = (int32_t)(((uint64_t)(uint32_t)terms.rest << GAIN_BITS) / length);
    terms.inverse = terms.rest ? ((1u << INVERSE_BITS) + (uint32_t)terms.rest / 2) / (uint32_t)terms.rest : 0;
    terms.wide = threshold->bits > NARROW_BITS;
    const uint16_t *line = image->pixels;
    for (int32_t row = 0; row < image->rows; row++, line += columns) {
        terms.first_found = blocks + terms.whole + 1;
        terms.last_found = blocks;
        row_start[row] = table.count;
        average = scan_row(line, row & 1, &terms, average, blocks);
        if (terms.first_found <= terms.last_found && !runs_of_row(&terms, blocks, row, columns, &table)) {
            while (row < image->rows)
                row_start[++row] = table.count;
            return -1 - table.count;
        }
    }
    row_start[image->rows] = table.count;
    return table.count;
}
