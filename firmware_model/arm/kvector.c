/* Range search in the pair catalogue by its k-vector, and the angles that go into it:
 * firmware_model/catalogue/kvector.py (range_kernel), Zhang et al. 2014, (13)-(14), Mortari 1996.
 *
 * Cosines are software double precision: a tolerance of arc seconds on a cosine near 1 takes 1e-10, which
 * 32 bits of fixed point would not hold. st_dot_q30 is there to measure what fixed point would save; no other
 * kernel uses it. */
#include "kvector.h"

#include <math.h>

#define PI 3.141592653589793

/* The step of the line at or below a place on it, within 0..steps. */
static int32_t step_at(double place, int32_t steps)
{
    if (!(place > 0.0))
        return 0;
    if (place >= (double)steps)
        return steps;
    return (int32_t)place;
}

void st_range(const st_pair_table *pairs, double lowest, double highest, int32_t *first, int32_t *end)
{
    const double *ascending = pairs->cos_angle;
    int32_t steps = pairs->pairs;
    *first = 0;
    *end = 0;
    if (steps == 0 || lowest > highest)
        return;
    /* Multiplied by the slope's reciprocal, where Python divides: rounding may put a bound on the next step,
     * so both go outwards by one. The comparisons below leave the same range. */
    int32_t bottom = step_at((lowest - pairs->offset) * pairs->steps_per_unit, steps) - 1;
    int32_t top = step_at((highest - pairs->offset) * pairs->steps_per_unit, steps) + 2;
    const double *from = ascending + pairs->count_below[bottom < 0 ? 0 : bottom];
    const double *to = ascending + pairs->count_below[top > steps ? steps : top];
    while (from < to && *from < lowest)
        from++;
    while (to > from && to[-1] > highest)
        to--;
    *first = from - ascending;
    *end = to - ascending;
}

double st_angle(const double *one, const double *other)
{
    double dx = one[0] - other[0];
    double dy = one[1] - other[1];
    double dz = one[2] - other[2];
    double half_chord = 0.5 * sqrt(dx * dx + dy * dy + dz * dz);
    return 2.0 * asin(half_chord < 1.0 ? half_chord : 1.0);
}

void st_cosine_range(double angle_rad, double tolerance_rad, double *lowest, double *highest)
{
    double wide = angle_rad + tolerance_rad;
    double narrow = angle_rad - tolerance_rad;
    *lowest = cos(wide < PI ? wide : PI);
    *highest = cos(narrow > 0.0 ? narrow : 0.0);
}

double st_dot(const double *one, const double *other)
{
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2];
}

int32_t st_dot_q30(const int32_t *one, const int32_t *other)
{
    int64_t sum = (int64_t)one[0] * other[0];
    sum += (int64_t)one[1] * other[1];
    sum += (int64_t)one[2] * other[2];
    return (int32_t)(sum >> 30);
}
