/* Solutions found so far, and what a further one means: firmware_model/identification/solutions.py
 * (volume_kernel, rival_kernel, judge_kernel, best_identification) and interface.py (usable_spikes,
 * for_all_spikes).
 *
 * Software double precision in the order of the Python stage's operations. */
#include "solutions.h"

#include <math.h>

#include "attitude.h"
#include "verification.h"

static double usable_b[3 * ST_MOST_SPIKES];
static double usable_magnitude[ST_MOST_SPIKES];

double st_volume(const double *u, int32_t i, int32_t j, int32_t k)
{
    const double *a = u + 3 * i;
    const double *b = u + 3 * j;
    const double *c = u + 3 * k;

    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
           a[2] * (b[0] * c[1] - b[1] * c[0]);
}

int32_t st_rival(const st_solution *kept, const int32_t *trial_index, int32_t spikes, const double *trial_q,
                 double turn_rad)
{
    double turn = 0.0;

    for (int32_t spike = 0; spike < spikes; spike++) {
        int32_t star = kept->star_index[spike];
        if (trial_index[spike] >= 0 && star >= 0 && trial_index[spike] != star)
            return 1;
    }
    for (int32_t m = 0; m < 4; m++)
        turn += kept->q[m] * trial_q[m];
    /* 1 - |turn| = (angle / 2)^2 / 2 */
    double square = 2.0 * (1.0 - fabs(turn));
    return 2.0 * sqrt(square > 0.0 ? square : 0.0) >= turn_rad;
}

int32_t st_known(const st_solutions *solutions, const int32_t spot[3], const int32_t star[3])
{
    for (int32_t kept = 0; kept < 2; kept++) {
        const st_solution *solution = solutions->kept + kept;
        if (solution->matched > 0 && solution->star_index[spot[0]] == star[0] &&
            solution->star_index[spot[1]] == star[1] && solution->star_index[spot[2]] == star[2])
            return 1;
    }
    return 0;
}

void st_no_solutions(st_solutions *solutions, int32_t spikes)
{
    for (int32_t kept = 0; kept < 2; kept++) {
        st_solution *solution = solutions->kept + kept;
        solution->chance = INFINITY;
        solution->matched = 0;
        solution->expected = 0;
        solution->seen = 0;
        solution->rivals = 0;
        for (int32_t m = 0; m < 4; m++)
            solution->q[m] = 0.0;
        for (int32_t spike = 0; spike < spikes; spike++)
            solution->star_index[spike] = -1;
    }
}

int32_t st_judge(const st_spikes *spikes, double spread_rad, const st_star_table *stars,
                 const st_limits *limits, int32_t *trial_index, st_solutions *solutions)
{
    int32_t min_stars = spikes->count <= ST_MOST_TRIANGLE_SPIKES ? 3 : limits->min_stars;
    double trial_q[4];

    st_refine(spikes, stars, trial_index, trial_q);
    st_verified verified = st_verify(spikes, trial_q, stars, limits, min_stars, trial_index);
    if (verified.matched == 0)
        return ST_NOTHING;
    int32_t confirmed = verified.matched >= limits->min_stars;
    st_solution *kept = solutions->kept + (confirmed ? ST_CONFIRMED : ST_TRIANGLE);
    double chance = st_false_solutions(stars->stars, spikes->count, verified.matched, spread_rad,
                                       limits->tolerance_rad);
    if (chance > (confirmed ? limits->most_false_solutions : limits->most_false_triangles))
        return ST_NOTHING;
    if (kept->matched > 0) {
        /* A roll may differ by the tolerance over the spread. */
        double spread = spread_rad > 0.01 ? spread_rad : 0.01;
        double turn_rad = 4.0 * limits->tolerance_rad / (spread < 1.0 ? spread : 1.0);
        if (st_rival(kept, trial_index, spikes->count, trial_q, turn_rad)) {
            /* A rival stands unless one of the two is certain. */
            double surer = chance < kept->chance ? chance : kept->chance;
            if (confirmed && surer > limits->certain_false_solutions)
                return ST_RIVAL;
            kept->rivals++;
        }
        if (chance >= kept->chance)
            return ST_NOTHING;
    }
    for (int32_t spike = 0; spike < spikes->count; spike++)
        kept->star_index[spike] = trial_index[spike];
    for (int32_t m = 0; m < 4; m++)
        kept->q[m] = trial_q[m];
    kept->matched = verified.matched;
    kept->expected = verified.expected;
    kept->seen = verified.seen;
    kept->chance = chance;
    return confirmed && chance <= limits->certain_false_solutions ? ST_CERTAIN : ST_NOTHING;
}

int32_t st_usable_spikes(const st_spikes *given, int32_t *places, st_spikes *usable)
{
    int32_t count = 0;

    for (int32_t spike = 0; spike < given->count; spike++) {
        const double *b = given->b + 3 * spike;
        double square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
        /* NaN and infinity fail the comparison of the length as well. */
        if (fabs(square - 1.0) <= 2e-6 && isfinite(given->magnitudes[spike]))
            places[count++] = spike;
    }
    *usable = *given;
    if (count == given->count)
        return count;
    for (int32_t spike = 0; spike < count; spike++) {
        for (int32_t m = 0; m < 3; m++)
            usable_b[3 * spike + m] = given->b[3 * places[spike] + m];
        usable_magnitude[spike] = given->magnitudes[places[spike]];
    }
    usable->b = usable_b;
    usable->magnitudes = usable_magnitude;
    usable->count = count;
    return count;
}

void st_no_identification(int32_t reason, int32_t given, st_identification *found, int32_t *star_index)
{
    for (int32_t spike = 0; spike < given; spike++)
        star_index[spike] = -1;
    found->false_solutions = INFINITY;
    found->reason = reason;
    found->verified = 0;
    found->expected = 0;
    found->seen = 0;
}

void st_best_identification(int32_t outcome, const st_solutions *solutions, const int32_t *places,
                            int32_t usable, int32_t given, st_identification *found, int32_t *star_index)
{
    const st_solution *best = solutions->kept + ST_CONFIRMED;
    int32_t reason = ST_REASON_NONE;

    if (outcome == ST_RIVAL) {
        reason = ST_REASON_AMBIGUOUS;
        best = 0;
    } else if (best->matched == 0) {
        best = solutions->kept + ST_TRIANGLE;
        reason = ST_REASON_UNCONFIRMED;
        if (best->rivals > 0) {
            reason = ST_REASON_AMBIGUOUS;
            best = 0;
        } else if (best->matched == 0) {
            reason = ST_REASON_NO_MATCH;
            best = 0;
        }
    }
    st_no_identification(reason, given, found, star_index);
    if (best == 0)
        return;
    for (int32_t spike = 0; spike < usable; spike++)
        star_index[places[spike]] = best->star_index[spike];
    for (int32_t m = 0; m < 4; m++)
        found->q[m] = best->q[m];
    found->false_solutions = best->chance;
    found->verified = best->matched;
    found->expected = best->expected;
    found->seen = best->seen;
}
