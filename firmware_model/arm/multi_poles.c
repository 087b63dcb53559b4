/* Identification by improved multi-poles: firmware_model/identification/multi_poles.py, after Schiattarella,
 * Spiller & Curti 2020, section 5, equations (34) to (45).
 *
 * Directions and cosines are software double precision in the Python stage's order of operations, so that
 * the same pairs pass the same tests. That of magnitudes (38) is of each pair that fits an angle, so it is
 * done in integers: from each spike's magnitude comes, once, the range of single precision values that pass
 * it in double precision, and their words order as they do. What a star has as the pole is one record, as is
 * an entry, so that each costs one cache line. */
#include "multi_poles.h"

#include <math.h>
#include <string.h>

#include "attitude.h"
#include "kvector.h"
#include "solutions.h"
#include "verification.h"

#define FEWEST 3 /* two neighbours beside the pole: of two spikes both would get one vote */
#define LAST_KEY 0x7f800000 /* of infinity */
#define FIRST_KEY (~LAST_KEY)
#define MOST_NUMBERS 0x40000000 /* neighbours are numbered on and on; here the numbers start again */

enum { NO_ROOM = -1, END_REACHED, SOLVED, AMBIGUOUS };

static double sorted_b[3 * ST_MOST_SPIKES];
static double sorted_mag[ST_MOST_SPIKES];
static int32_t ascending[ST_MOST_SPIKES]; /* (34): places of the sorted spikes among the usable ones */
static int32_t places[ST_MOST_SPIKES];
static int32_t first_of[ST_MOST_SPIKES];
static int32_t end_of[ST_MOST_SPIKES];
static int32_t brightest_of[ST_MOST_SPIKES]; /* keys of the magnitudes that pass (38) with a spike */
static int32_t dimmest_of[ST_MOST_SPIKES];
static double cosine_of[ST_MOST_SPIKES];
static double best_of[ST_MOST_SPIKES];
static uint8_t tried[ST_MOST_SPIKES];
static int32_t recognised[ST_MOST_SPIKES];
static int32_t best_index[ST_MOST_SPIKES];

typedef struct {
    st_spikes spikes; /* sorted */
    const st_star_table *stars;
    const st_pair_table *pairs;
    const st_limits *limits;
    const st_poles_parameters *parameters;
    st_poles_marks *marks;
    double spread_rad;
    double best_q[4];
    double best_chance;
    st_verified best; /* matched 0: no solution yet */
    int32_t least_recognised;
} search;

/* Spikes in ascending order of magnitude, equal ones as they were: they come nearly sorted. */
static void sort_spikes(const st_spikes *spikes)
{
    for (int32_t spike = 0; spike < spikes->count; spike++) {
        double magnitude = spikes->magnitudes[spike];
        int32_t slot = spike;
        while (slot > 0 && sorted_mag[slot - 1] > magnitude) {
            sorted_mag[slot] = sorted_mag[slot - 1];
            ascending[slot] = ascending[slot - 1];
            slot--;
        }
        sorted_mag[slot] = magnitude;
        ascending[slot] = spike;
    }
    for (int32_t spike = 0; spike < spikes->count; spike++)
        memcpy(sorted_b + 3 * spike, spikes->b + 3 * ascending[spike], 3 * sizeof(double));
}

/* A word that orders as single precision values do; of 0 and -0 the latter is the lower. */
static inline int32_t key_of(float value)
{
    int32_t word;
    memcpy(&word, &value, sizeof word);
    return word ^ (word >> 31 & 0x7fffffff);
}

static int32_t passes(int32_t key, double magnitude, double tolerance)
{
    int32_t word = key ^ (key >> 31 & 0x7fffffff);
    float value;
    memcpy(&value, &word, sizeof value);
    return (double)value - magnitude < tolerance;
}

/* The largest key that passes. The difference is rounded but never falls as the key grows; from the key that
 * it should be, steps double until they have gone too far. */
static int32_t last_key(double magnitude, double tolerance)
{
    int32_t key = key_of((float)(magnitude + tolerance));
    int32_t up = passes(key, magnitude, tolerance);
    uint32_t room = up ? (uint32_t)LAST_KEY - (uint32_t)key : (uint32_t)key - (uint32_t)FIRST_KEY;
    uint32_t step = 1;
    int32_t doubling = 1;
    while (step > 0) {
        int32_t next = (int32_t)(up ? (uint32_t)key + step : (uint32_t)key - step);
        if (step <= room && passes(next, magnitude, tolerance) == up) {
            key = next;
            room -= step;
        } else {
            doubling = 0;
        }
        step = doubling ? step * 2 : step / 2;
    }
    return up ? key : key - 1;
}

void st_magnitude_keys(double magnitude, double tolerance, int32_t *brightest, int32_t *dimmest)
{
    *dimmest = last_key(magnitude, tolerance);
    *brightest = ~last_key(-magnitude, tolerance); /* a value's key is the inverse of its negative's */
}

/* Ranges of the pair list that fit the angles from the pole to all others, (36)-(37); pairs in all. */
static int32_t look_up(const search *s, int32_t pole)
{
    const double *b = s->spikes.b;
    int32_t hits = 0;
    for (int32_t j = 0; j < s->spikes.count; j++) {
        double lowest;
        double highest;
        first_of[j] = end_of[j] = 0;
        if (j == pole)
            continue;
        st_cosine_range(st_angle(b + 3 * pole, b + 3 * j), s->limits->tolerance_rad, &lowest, &highest);
        st_range(s->pairs, lowest, highest, &first_of[j], &end_of[j]);
        cosine_of[j] = st_dot(b + 3 * pole, b + 3 * j);
        hits += end_of[j] - first_of[j];
    }
    return hits;
}

/* The votes for one pole so far. */
typedef struct {
    int32_t entries;
    int32_t most;
    int32_t star; /* with the most, -1: more than one has */
} poll;

/* A pair that fits neighbour j, `star` as the pole. A star gets one vote of each neighbour at most. */
static void vote(st_poles_marks *marks, int32_t star, int32_t partner, int32_t place, int32_t j, poll *votes)
{
    st_poles_mark *mark = &marks->mark[star];
    st_poles_entry *entry = &marks->entry[votes->entries];
    if (mark->last_voter < marks->base) {
        mark->votes = 0;
        mark->head = -1;
    }
    entry->next = mark->head;
    entry->partner = partner;
    entry->place = place;
    entry->neighbour = j;
    mark->head = votes->entries++;
    if (mark->last_voter == marks->base + j)
        return;
    mark->last_voter = marks->base + j;
    mark->votes++;
    if (mark->votes > votes->most) {
        votes->most = mark->votes;
        votes->star = star;
    } else if (mark->votes == votes->most) {
        votes->star = -1;
    }
}

/* Acceptance phase for one pole: accepted[n], and how many of it are stars; 0: not accepted. */
static int32_t accept(search *s, int32_t pole, int32_t *accepted)
{
    const int32_t *brighter = s->pairs->brighter;
    const int32_t *dimmer = s->pairs->dimmer;
    const float *hp_mag = s->stars->hp_mag;
    int32_t pole_low = brightest_of[pole];
    int32_t pole_high = dimmest_of[pole];
    poll votes = {0, 0, -1};
    if (2 * look_up(s, pole) > s->marks->entries)
        return NO_ROOM;
    for (int32_t j = 0; j < s->spikes.count; j++) {
        int32_t low = brightest_of[j];
        int32_t high = dimmest_of[j];
        accepted[j] = -1;
        for (int32_t place = first_of[j]; place < end_of[j]; place++) {
            int32_t one = brighter[place];
            int32_t other = dimmer[place];
            int32_t one_mag = key_of(hp_mag[one]);
            int32_t other_mag = key_of(hp_mag[other]);
            /* (38), either way round */
            if (one_mag >= pole_low && one_mag <= pole_high && other_mag >= low && other_mag <= high)
                vote(s->marks, one, other, place, j, &votes);
            if (other_mag >= pole_low && other_mag <= pole_high && one_mag >= low && one_mag <= high)
                vote(s->marks, other, one, place, j, &votes);
        }
    }
    s->marks->base += s->spikes.count;
    if (votes.star < 0)
        return 0;
    accepted[pole] = votes.star;
    for (int32_t j = 0; j < s->spikes.count; j++)
        best_of[j] = INFINITY;
    for (int32_t place = s->marks->mark[votes.star].head; place >= 0;) {
        const st_poles_entry *entry = &s->marks->entry[place];
        int32_t j = entry->neighbour;
        double off = fabs(s->pairs->cos_angle[entry->place] - cosine_of[j]);
        if (off < best_of[j]) {
            best_of[j] = off;
            accepted[j] = entry->partner; /* (42) */
        }
        place = entry->next;
    }
    return votes.most + 1;
}

/* Check phase (44)-(45): stars that two sets give to the same spikes to recognised[n]; how many. */
static int32_t recognise(const int32_t *one, const int32_t *other, int32_t spikes)
{
    int32_t number = 0;
    for (int32_t spike = 0; spike < spikes; spike++) {
        int32_t star = one[spike];
        if (star != other[spike])
            star = -1;
        recognised[spike] = star;
        number += star >= 0;
    }
    return number;
}

/* The brightest spike not tried yet: of the accepted ones (NULL: none), else of all; -1: none is left. */
static int32_t next_pole(const int32_t *accepted, int32_t spikes)
{
    int32_t brightest = -1;
    for (int32_t spike = 0; spike < spikes; spike++) {
        if (tried[spike])
            continue;
        if (accepted && accepted[spike] >= 0)
            return spike;
        if (brightest < 0)
            brightest = spike;
    }
    return brightest;
}

/* Whether what is recognised is in the solution already found. */
static int32_t is_known(const search *s)
{
    if (s->best.matched == 0)
        return 0;
    for (int32_t spike = 0; spike < s->spikes.count; spike++)
        if (recognised[spike] >= 0 && recognised[spike] != best_index[spike])
            return 0;
    return 1;
}

/* Whether the judged trial is the solution found: its stars, and its attitude within the tolerance; roll may
 * differ by it over the spots' spread. */
static int32_t is_same(const search *s, const double *q)
{
    double turn = 0.0;
    double spread_rad = s->spread_rad > 0.01 ? s->spread_rad : 0.01;
    for (int32_t spike = 0; spike < s->spikes.count; spike++)
        if (recognised[spike] >= 0 && best_index[spike] >= 0 && recognised[spike] != best_index[spike])
            return 0;
    for (int32_t m = 0; m < 4; m++)
        turn += s->best_q[m] * q[m];
    /* 1 - |turn| = (angle / 2)^2 / 2 */
    double rest = 2.0 * (1.0 - fabs(turn));
    double angle_rad = 2.0 * sqrt(rest > 0.0 ? rest : 0.0);
    return angle_rad < 4.0 * s->limits->tolerance_rad / (spread_rad < 1.0 ? spread_rad : 1.0);
}

/* The final judgement of what two poles recognise, `number` stars: END_REACHED: the search goes on. */
static int32_t judge(search *s, int32_t number)
{
    const st_limits *limits = s->limits;
    double q[4];
    st_refine(&s->spikes, s->stars, recognised, q);
    st_verified trial = st_verify(&s->spikes, q, s->stars, limits,
                                  number >= limits->min_stars ? limits->min_stars : number, recognised);
    if (trial.matched == 0)
        return END_REACHED;
    double chance = st_false_solutions(s->stars->stars, s->spikes.count, trial.matched, s->spread_rad,
                                       limits->tolerance_rad);
    if (chance >
        (trial.matched >= limits->min_stars ? limits->most_false_solutions : limits->most_false_triangles))
        return END_REACHED;
    if (s->best.matched > 0) {
        /* A rival stands unless one of the two is certain. */
        if (!is_same(s, q) && chance > limits->certain_false_solutions &&
            s->best_chance > limits->certain_false_solutions)
            return AMBIGUOUS;
        if (chance >= s->best_chance)
            return END_REACHED;
    }
    s->best = trial;
    s->best_chance = chance;
    memcpy(best_index, recognised, (size_t)s->spikes.count * sizeof *best_index);
    memcpy(s->best_q, q, sizeof s->best_q);
    return chance <= limits->certain_false_solutions ? SOLVED : END_REACHED;
}

/* One pole after the other until two of them agree on what stands. */
static int32_t search_all(search *s)
{
    int32_t spikes = s->spikes.count;
    int32_t kept = 0;
    const int32_t *from_set = NULL; /* whose neighbours the next pole is taken from */
    memset(tried, 0, (size_t)spikes);
    for (;;) {
        int32_t pole = next_pole(from_set, spikes);
        if (pole < 0)
            return END_REACHED;
        tried[pole] = 1;
        int32_t *accepted = s->marks->sets + kept * spikes;
        int32_t found = accept(s, pole, accepted);
        if (found == NO_ROOM)
            return NO_ROOM;
        from_set = NULL;
        /* A set smaller than t* cannot pass the check with any other. */
        if (found < s->least_recognised)
            continue;
        from_set = accepted;
        for (int32_t earlier = 0; earlier < kept; earlier++) {
            int32_t number = recognise(s->marks->sets + earlier * spikes, accepted, spikes);
            if (number < s->least_recognised || is_known(s))
                continue;
            int32_t outcome = judge(s, number);
            if (outcome != END_REACHED)
                return outcome;
        }
        kept++;
    }
}

int32_t st_identify_multi_poles(const st_spikes *spikes, const st_star_table *stars,
                                const st_pair_table *pairs, const st_limits *limits,
                                const st_poles_parameters *parameters, st_poles_marks *marks,
                                st_identification *found, int32_t *star_index)
{
    st_spikes usable;
    int32_t count = st_usable_spikes(spikes, places, &usable);
    if (count < FEWEST) {
        st_no_identification(ST_REASON_TOO_FEW_STARS, spikes->count, found, star_index);
        return 1;
    }
    search s = {
        .spikes = {sorted_b, sorted_mag, count},
        .stars = stars,
        .pairs = pairs,
        .limits = limits,
        .parameters = parameters,
        .marks = marks,
        .best_chance = INFINITY,
        .least_recognised = parameters->least_recognised,
    };
    if (s.least_recognised > count)
        s.least_recognised = count;
    if (s.least_recognised < FEWEST)
        s.least_recognised = FEWEST;
    sort_spikes(&usable);
    for (int32_t spike = 0; spike < count; spike++)
        st_magnitude_keys(sorted_mag[spike], parameters->magnitude_tolerance, &brightest_of[spike],
                          &dimmest_of[spike]);
    s.spread_rad = st_spread(sorted_b, count);
    if (marks->base > MOST_NUMBERS) {
        memset(marks->mark, 0, (size_t)stars->stars * sizeof *marks->mark);
        marks->base = 1;
    }
    int32_t outcome = search_all(&s);
    if (outcome == AMBIGUOUS || outcome == NO_ROOM || s.best.matched == 0) {
        st_no_identification(outcome == AMBIGUOUS ? ST_REASON_AMBIGUOUS : ST_REASON_NO_MATCH, spikes->count,
                             found, star_index);
        return outcome != NO_ROOM;
    }
    found->reason = s.best.matched >= limits->min_stars ? ST_REASON_NONE : ST_REASON_UNCONFIRMED;
    found->verified = s.best.matched;
    found->expected = s.best.expected;
    found->seen = s.best.seen;
    found->false_solutions = s.best_chance;
    memcpy(found->q, s.best_q, sizeof found->q);
    for (int32_t spike = 0; spike < spikes->count; spike++)
        star_index[spike] = -1;
    for (int32_t spike = 0; spike < count; spike++)
        star_index[places[ascending[spike]]] = best_index[spike];
    return 1;
}
