/* Identification by pyramids: firmware_model/identification/pyramid.py (Mortari et al. 2004 as Sarvi et al.
 * 2014, "Lost in space algorithm", use it). Triads of spikes in the smart order, k-vector range searches for
 * their sides, the handedness, a fourth spike whose three angles fit too, then the judgement of the whole
 * image.
 *
 * Angles, cosines and volumes are software double precision in the order of the Python stage's operations, so
 * that the same triangles pass; the join of two ranges is integers alone. What is computed once for a pair of
 * spikes is kept in one table of sides. The mark table is never cleared, not even between images: entries are
 * numbered on and on, and a number below the triad's first one is an old mark. */
#include "pyramid.h"

#include <math.h>

#include "attitude.h"
#include "kvector.h"
#include "solutions.h"

#define FEWEST 3
#define MOST_ENTRIES (1 << 30) /* here the numbers start again */

/* The pair of two spikes: the range of catalogue pairs that fit their angle. */
typedef struct {
    double lowest;
    double highest;
    int32_t first;
    int32_t end;
    int32_t angle_known;
    int32_t range_known;
} side;

/* What the search passes on to its parts. */
typedef struct {
    const st_spikes *spikes;
    const st_star_table *stars;
    const st_pair_table *pairs;
    const st_limits *limits;
    st_solutions *solutions;
    double spread_rad;
    int32_t spots; /* patterns are built from so many of the spikes */
} search;

static side sides[ST_MOST_PATTERN_SPIKES * ST_MOST_PATTERN_SPIKES];
static int32_t kept_index[2][ST_MOST_SPIKES];
static int32_t trial_index[ST_MOST_SPIKES];
static int32_t usable_place[ST_MOST_SPIKES];

/* The side of two spikes with the cosines of its angle; i == j is not asked for. */
static side *side_bounds(const search *s, int32_t i, int32_t j)
{
    side *found = i < j ? sides + s->spots * i + j : sides + s->spots * j + i;

    if (!found->angle_known) {
        double angle = st_angle(s->spikes->b + 3 * i, s->spikes->b + 3 * j);
        st_cosine_range(angle, s->limits->tolerance_rad, &found->lowest, &found->highest);
        found->angle_known = 1;
    }
    return found;
}

/* The same with the range of catalogue pairs. */
static side *side_range(const search *s, int32_t i, int32_t j)
{
    side *found = side_bounds(s, i, j);

    if (!found->range_known) {
        st_range(s->pairs, found->lowest, found->highest, &found->first, &found->end);
        found->range_known = 1;
    }
    return found;
}

/* Whether spike `spot` and `star` make a pyramid: the angles to the triangle's second and third corner. */
static int32_t fits_corners(const search *s, int32_t spot, int32_t star, const int32_t tried[3],
                            const int32_t named[3])
{
    const double *unit_vectors = s->stars->cells.unit_vectors;

    for (int32_t corner = 1; corner < 3; corner++) {
        const side *edge = side_bounds(s, tried[corner], spot);
        double cosine = st_dot(unit_vectors + 3 * star, unit_vectors + 3 * named[corner]);
        if (cosine < edge->lowest || cosine > edge->highest)
            return 0;
    }
    return 1;
}

/* The first spike (and its star, to *star_fourth) that makes the triangle a pyramid, or -1. The stars as far
 * from the triangle's first one as any spike may be are taken from the sky grid, once for all spikes. */
static int32_t fourth_spike(const search *s, const int32_t tried[3], const int32_t named[3],
                            int32_t *star_fourth)
{
    const double *unit_vectors = s->stars->cells.unit_vectors;
    const double *corner = unit_vectors + 3 * named[0];
    const side *edges[ST_MOST_PATTERN_SPIKES];
    double least = 1.0;
    int32_t fourth = s->spots;

    for (int32_t spot = 0; spot < s->spots; spot++) {
        edges[spot] = 0;
        if (spot == tried[0])
            continue;
        const side *edge = side_bounds(s, tried[0], spot);
        if (edge->lowest < least)
            least = edge->lowest;
        if (spot != tried[1] && spot != tried[2])
            edges[spot] = edge;
    }
    int32_t near = st_stars_in_cone(&s->stars->cells, corner[0], corner[1], corner[2],
                                    acos(least > -1.0 ? least : -1.0), s->stars->near, s->stars->stars);
    *star_fourth = -1;
    for (int32_t place = 0; place < near; place++) {
        int32_t star = s->stars->near[place];
        if (star == named[0] || star == named[1] || star == named[2])
            continue;
        double cosine = st_dot(unit_vectors + 3 * star, corner);
        for (int32_t spot = 0; spot < fourth; spot++) {
            const side *edge = edges[spot];
            if (edge == 0 || cosine < edge->lowest || cosine > edge->highest)
                continue;
            if (fits_corners(s, spot, star, tried, named)) {
                fourth = spot;
                *star_fourth = star;
            }
        }
    }
    return *star_fourth < 0 ? -1 : fourth;
}

/* Judge the triangle of spikes tried[3] with stars named[3], with a fourth spike where there are enough. */
static int32_t judge_triangle(const search *s, const int32_t tried[3], const int32_t named[3])
{
    int32_t fourth = -1;
    int32_t star_fourth = -1;

    if (st_known(s->solutions, tried, named))
        return ST_NOTHING;
    if (s->spikes->count > ST_MOST_TRIANGLE_SPIKES) {
        fourth = fourth_spike(s, tried, named, &star_fourth);
        if (fourth < 0)
            return ST_NOTHING;
    }
    for (int32_t spike = 0; spike < s->spikes->count; spike++)
        trial_index[spike] = -1;
    for (int32_t corner = 0; corner < 3; corner++)
        trial_index[tried[corner]] = named[corner];
    if (fourth >= 0)
        trial_index[fourth] = star_fourth;
    return st_judge(s->spikes, s->spread_rad, s->stars, s->limits, trial_index, s->solutions);
}

/* Marks both stars of every pair of a side: partner[] and chain[] from marks->base on. */
static void mark_side(const side *edge, const st_pair_table *pairs, st_pyramid_marks *marks)
{
    int32_t number = marks->base;
    int32_t *partner = marks->partner;
    int32_t *chain = marks->chain;

    for (int32_t place = edge->first; place < edge->end; place++) {
        int32_t one = pairs->brighter[place];
        int32_t other = pairs->dimmer[place];
        *partner++ = other;
        *chain++ = marks->head[one];
        marks->head[one] = number++;
        *partner++ = one;
        *chain++ = marks->head[other];
        marks->head[other] = number++;
    }
}

/* One triad of spikes: ST_NOTHING to go on with the next. */
static int32_t try_triad(const search *s, int32_t i, int32_t j, int32_t k, st_pyramid_marks *marks)
{
    const double *unit_vectors = s->stars->cells.unit_vectors;
    const side *ij = side_range(s, i, j);
    const side *ik = side_range(s, i, k);
    const side *jk = side_range(s, j, k);
    int32_t n_ij = ij->end - ij->first;
    int32_t n_ik = ik->end - ik->first;
    int32_t n_jk = jk->end - jk->first;

    if (n_ij == 0 || n_ik == 0 || n_jk == 0)
        return ST_NOTHING;
    /* The two sides with the fewest pairs are joined at their common spike, the apex. */
    int32_t tried[3] = {i, j, k}; /* apex, left, right */
    const side *marked = ij;
    const side *joined = ik;
    const side *third = jk;
    if (n_ij >= n_ik && n_ij >= n_jk) {
        tried[0] = k, tried[1] = i, tried[2] = j;
        marked = ik, joined = jk, third = ij;
    } else if (n_ik >= n_ij && n_ik >= n_jk) {
        tried[0] = j, tried[1] = i, tried[2] = k;
        marked = ij, joined = jk, third = ik;
    }
    if (marks->base > MOST_ENTRIES) {
        for (int32_t star = 0; star < s->stars->stars; star++)
            marks->head[star] = 0;
        marks->base = 1;
    }
    mark_side(marked, s->pairs, marks);
    int32_t base = marks->base;
    marks->base += 2 * (marked->end - marked->first);

    double volume = st_volume(s->spikes->b, tried[0], tried[1], tried[2]);
    double least = ik->lowest < jk->lowest ? ik->lowest : jk->lowest;
    least = ij->lowest < least ? ij->lowest : least;
    /* A triangle so flat that the tolerance can turn it over has no handedness. */
    double flat = 2.0 * s->limits->tolerance_rad * acos(least < 1.0 ? least : 1.0);
    for (int32_t place = joined->first; place < joined->end; place++)
        for (int32_t turned = 0; turned < 2; turned++) {
            int32_t named[3];
            named[0] = turned ? s->pairs->dimmer[place] : s->pairs->brighter[place];
            named[2] = turned ? s->pairs->brighter[place] : s->pairs->dimmer[place];
            int32_t following = marks->head[named[0]];
            while (following >= base) {
                int32_t entry = following - base;
                following = marks->chain[entry];
                named[1] = marks->partner[entry];
                if (named[1] == named[2])
                    continue;
                double cosine = st_dot(unit_vectors + 3 * named[1], unit_vectors + 3 * named[2]);
                if (cosine < third->lowest || cosine > third->highest)
                    continue;
                double mirror = st_volume(unit_vectors, named[0], named[1], named[2]);
                if (volume * mirror < 0.0 && fabs(volume) > flat && fabs(mirror) > flat)
                    continue;
                int32_t judged = judge_triangle(s, tried, named);
                if (judged != ST_NOTHING)
                    return judged;
            }
        }
    return ST_NOTHING;
}

/* All triads in the smart order, until one ends the search. */
static int32_t search_triads(const search *s, st_pyramid_marks *marks)
{
    for (int32_t place = 0; place < s->spots * s->spots; place++) {
        sides[place].angle_known = 0;
        sides[place].range_known = 0;
    }
    for (int32_t dj = 1; dj < s->spots - 1; dj++)
        for (int32_t dk = 1; dk < s->spots - dj; dk++)
            for (int32_t i = 0; i < s->spots - dj - dk; i++) {
                int32_t judged = try_triad(s, i, i + dj, i + dj + dk, marks);
                if (judged != ST_NOTHING)
                    return judged;
            }
    return ST_NOTHING;
}

void st_identify_pyramid(const st_spikes *spikes, const st_star_table *stars, const st_pair_table *pairs,
                         const st_limits *limits, int32_t max_spots, st_pyramid_marks *marks,
                         st_identification *found, int32_t *star_index)
{
    st_spikes usable;
    int32_t count = st_usable_spikes(spikes, usable_place, &usable);
    st_solutions solutions;
    search s = {&usable, stars, pairs, limits, &solutions, 0.0, count < max_spots ? count : max_spots};

    if (count < FEWEST) {
        st_no_identification(ST_REASON_TOO_FEW_STARS, spikes->count, found, star_index);
        return;
    }
    solutions.kept[ST_CONFIRMED].star_index = kept_index[ST_CONFIRMED];
    solutions.kept[ST_TRIANGLE].star_index = kept_index[ST_TRIANGLE];
    st_no_solutions(&solutions, count);
    s.spread_rad = st_spread(usable.b, count);
    int32_t outcome = search_triads(&s, marks);
    st_best_identification(outcome, &solutions, usable_place, count, spikes->count, found, star_index);
}
