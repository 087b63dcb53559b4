/* Background and noise of a detection window: firmware_model/image/background.py (window_statistics).
 *
 * Pixels are counted and summed as integers. Medians come from counting samples by value; the mean is a sum
 * and a number until the very end; the pixels within 4 sigma are those between two whole DN, found exactly:
 * n |v - mean| <= 4 n sigma = 4 sqrt(n S2 - S1^2), whose root is an integer root. Sigma itself is fixed point
 * with 32 bits after the point, as it decides whether another pass is needed. Only the results are doubles:
 * the background is the Python stage's to the last bit, the noise to 1e-9 of it. */
#include "window_statistics.h"

#define SAMPLES 256
#define BINS 128
#define MOST_PASSES 12
#define POINT 32 /* bits of sigma after the point */

/* 1.4826 / 4 and 0.7 with POINT bits after the point. */
#define SIGMA_OF_QUARTER_DEVIATION 1591929628u
#define LEAST_SIGMA 3006477107u

/* Two pixels as the processor loads them. */
typedef uint32_t __attribute__((may_alias)) pixel_pair;

/* Twice the median of count (1 .. SAMPLES) values: the sum of the two in the middle; no value is below
 * least. They are counted in bins one wide, which are laid out again further up where the middle lies beyond
 * them. */
static int32_t twice_median(const int32_t *values, int32_t count, int32_t least)
{
    uint32_t store[BINS / 2];
    uint16_t *bin = (uint16_t *)store;
    int32_t lower = (count - 1) >> 1;
    int32_t upper = count >> 1;
    int32_t below = 0; /* values in the bins so far */
    int32_t sum = 0;
    for (;; least += BINS) {
        for (int32_t i = 0; i < BINS / 2; i += 4) {
            store[i] = 0;
            store[i + 1] = 0;
            store[i + 2] = 0;
            store[i + 3] = 0;
        }
        for (int32_t i = 0; i < count; i++) {
            uint32_t place = (uint32_t)(values[i] - least);
            if (place < BINS)
                bin[place]++;
        }
        for (int32_t i = 0; i < BINS; i++) {
            int32_t before = below;
            below += bin[i];
            if (before <= lower && lower < below)
                sum = least + i;
            if (upper < below)
                return sum + least + i;
        }
    }
}

/* floor(sqrt(value)), two bits of the value at a time. */
static uint32_t integer_root(uint64_t value)
{
    uint64_t root = 0;
    for (uint64_t bit = (uint64_t)1 << 62; bit; bit >>= 2) {
        uint64_t trial = root + bit;
        root >>= 1;
        if (value >= trial) {
            value -= trial;
            root += bit;
        }
    }
    return (uint32_t)root;
}

/* floor(dividend / divisor), divisor positive. */
static int32_t floor_quotient(int64_t dividend, int32_t divisor)
{
    if (dividend == (int32_t)dividend) {
        int32_t quotient = (int32_t)dividend / divisor;
        return quotient * divisor > (int32_t)dividend ? quotient - 1 : quotient;
    }
    int32_t quotient = (int32_t)(dividend / divisor);
    return (int64_t)quotient * divisor > dividend ? quotient - 1 : quotient;
}

/* Number, sum and sum of squares of the pixels from low to low + span, of their offsets from low. */
typedef struct {
    uint32_t kept;
    uint32_t total;
    uint64_t squares;
} sums;

static inline void add_pixel(sums *sum, uint32_t offset, uint32_t span)
{
    if (offset <= span) {
        sum->kept++;
        sum->total += offset;
        sum->squares += (uint64_t)offset * offset;
    }
}

static sums sum_between(const uint16_t *pixels, int32_t size, int32_t low, uint32_t span)
{
    sums sum = {0, 0, 0};
    const pixel_pair *pair = (const pixel_pair *)pixels;
    const pixel_pair *end = pair + (size >> 1);
    while (pair < end) {
        uint32_t pixel = *pair++;
        add_pixel(&sum, (pixel & 0xffff) - (uint32_t)low, span);
        add_pixel(&sum, (pixel >> 16) - (uint32_t)low, span);
    }
    if (size & 1)
        add_pixel(&sum, (uint32_t)(pixels[size - 1] - low), span);
    return sum;
}

/* Largest shift, even, that keeps a value within 64 bits; at most 62. */
static int32_t even_room(uint64_t value)
{
    uint32_t top = (uint32_t)(value >> 32);
    int32_t zeros = top ? __builtin_clz(top) : 32 + __builtin_clz((uint32_t)value | 1);
    return zeros & ~1;
}

void st_window_statistics(const st_image *window, st_statistics *statistics)
{
    const uint16_t *pixels = window->pixels;
    int32_t size = window->rows * window->columns;
    int32_t samples[SAMPLES];
    int32_t step = (size + SAMPLES - 1) / SAMPLES;
    int32_t count = 0;
    int32_t least = 65535;
    int32_t place = 0;
    if (step > 1 && window->columns % step == 0)
        step++; /* or the samples would all stand in the same columns */
    do {
        int32_t value = pixels[place];
        if (value < least)
            least = value;
        samples[count++] = value;
        place += step;
    } while (place < size);
    int32_t twice = twice_median(samples, count, least);
    for (int32_t i = 0; i < count; i++) {
        int32_t deviation = 2 * samples[i] - twice;
        samples[i] = deviation < 0 ? -deviation : deviation;
    }
    /* Twice the median deviation in halves of a DN: quarters. */
    uint32_t quarters = (uint32_t)twice_median(samples, count, 0);
    uint64_t sigma = (uint64_t)quarters * SIGMA_OF_QUARTER_DEVIATION;
    if (sigma < LEAST_SIGMA)
        sigma = LEAST_SIGMA;
    /* 4 sigma in halves of a DN: 2.9652 of the quarters, at least 5.6. */
    int32_t reach = (int32_t)(2 * quarters + quarters * 9652u / 10000u);
    if (reach < 5)
        reach = 5;
    int32_t low = (twice - reach + 1) >> 1;
    int32_t high = (twice + reach) >> 1;
    int64_t level_total = twice;
    int32_t level_count = 2;
    for (int32_t pass = 0; pass < MOST_PASSES; pass++) {
        if (low < 0)
            low = 0; /* no pixel is below, and offsets stay small */
        sums sum = sum_between(pixels, size, low, (uint32_t)(high - low));
        int32_t kept = (int32_t)sum.kept;
        if (kept < 2)
            break;
        level_total = sum.total + (int64_t)low * kept;
        level_count = kept;
        /* The square of n sigma. */
        uint64_t spread = sum.squares * sum.kept - (uint64_t)sum.total * sum.total;
        if (spread == 0) {
            sigma = 0;
            break;
        }
        int32_t half_shift = even_room(spread) >> 1;
        uint32_t root = integer_root(spread << (2 * half_shift));
        uint64_t before = sigma;
        sigma = ((uint64_t)root << (POINT - half_shift)) / sum.kept;
        uint64_t change = sigma > before ? sigma - before : before - sigma;
        if (50 * change <= before)
            break;
        /* 4 n sigma, its whole part */
        int64_t width = half_shift >= 2 ? root >> (half_shift - 2) : (int64_t)root << (2 - half_shift);
        high = low + floor_quotient(sum.total + width, kept);
        low -= floor_quotient(width - sum.total, kept);
    }
    statistics->background_dn = (double)level_total / (double)level_count;
    statistics->noise_dn = (double)sigma * (1.0 / 4294967296.0);
}
