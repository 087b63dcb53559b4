/* Identification by brightness-referenced pairs: firmware_model/identification/brightness_referenced.py,
 * after Zhang et al. 2014, section 4, equations (9) to (14).
 *
 * Directions, cosines and magnitudes are software double precision in the Python stage's order of operations,
 * so that the same candidates pass the same tests. Marks and entries are records, so that each costs one
 * cache line. */
#include "brightness_referenced.h"

#include <math.h>
#include <string.h>

#include "attitude.h"
#include "kvector.h"
#include "pyramid.h"
#include "solutions.h"

#define GROUP 3 /* partners of a pivot that are tried together */
#define MOST_PIVOTS 0x40000000 /* pivots are numbered on and on; here the numbers start again */
#define NO_ROOM (-1) /* how a search may end, beside ST_NOTHING, ST_CERTAIN and ST_RIVAL */

enum { WINDOW_KNOWN = 1, RANGE_KNOWN = 2 };

/* A range of the pair list, of the pivot with `spot`. */
typedef struct {
    int32_t first;
    int32_t end;
    int32_t spot;
    int32_t ends; /* 1: the pivot is the brighter star of a pair; 2: it may be either */
} pair_range;

/* Of two pattern spikes, [first][second] in rows of search.spots: cosines that fit their angle, and, the
 * pivot first, the range of the whole pair list. */
static double lowest_of[ST_MOST_PATTERN_SPIKES * ST_MOST_PATTERN_SPIKES];
static double highest_of[ST_MOST_PATTERN_SPIKES * ST_MOST_PATTERN_SPIKES];
static int32_t first_of[ST_MOST_PATTERN_SPIKES * ST_MOST_PATTERN_SPIKES];
static int32_t end_of[ST_MOST_PATTERN_SPIKES * ST_MOST_PATTERN_SPIKES];
static uint8_t known_of[ST_MOST_PATTERN_SPIKES * ST_MOST_PATTERN_SPIKES];
/* Triple product of the pivot, a partner and the partner whose range is read. */
static double volume_of[ST_MOST_PATTERN_SPIKES];
static uint8_t volume_known[ST_MOST_PATTERN_SPIKES];
static int32_t trial_index[ST_MOST_SPIKES];
static int32_t solution_index[2][ST_MOST_SPIKES];
static int32_t places[ST_MOST_SPIKES];

typedef struct {
    const st_spikes *spikes;
    const st_star_table *stars;
    const st_pair_table *pairs;
    const st_limits *limits;
    const st_brightness_parameters *parameters;
    st_brightness_marks *marks;
    st_solutions solutions;
    double spread_rad;
    int32_t spots;
    int32_t round; /* 0: reference mode; 1: four-star mode; 2: without the order of brightness */
    int32_t pivot;
    int32_t used; /* entries of this pivot */
    int32_t ordered;
} search;

/* Cosines that fit the angle of spikes i and j, (14); computed once and kept. */
static void window(const search *s, int32_t i, int32_t j)
{
    int32_t place = i * s->spots + j;
    int32_t mirrored = j * s->spots + i;
    if (known_of[place] & WINDOW_KNOWN)
        return;
    double angle_rad = st_angle(s->spikes->b + 3 * i, s->spikes->b + 3 * j);
    st_cosine_range(angle_rad, s->limits->tolerance_rad, &lowest_of[place], &highest_of[place]);
    lowest_of[mirrored] = lowest_of[place];
    highest_of[mirrored] = highest_of[place];
    known_of[place] |= WINDOW_KNOWN;
    known_of[mirrored] |= WINDOW_KNOWN;
}

/* Mark the pivot's candidates of one pair with partner `spot`. */
static void mark(search *s, int32_t place, int32_t ends, int32_t spot)
{
    st_brightness_marks *marks = s->marks;
    int32_t star = s->pairs->brighter[place];
    int32_t other = s->pairs->dimmer[place];
    for (;;) {
        st_brightness_mark *marked = &marks->mark[star];
        st_brightness_entry *entry = &marks->entry[s->used];
        entry->next = marked->pivot == marks->pivots ? marked->head : -1;
        entry->star = other;
        entry->spot = spot;
        marked->head = s->used++;
        marked->pivot = marks->pivots;
        if (--ends == 0)
            return;
        other = star;
        star = s->pairs->dimmer[place];
        if (s->round == 0 && !((double)s->stars->hp_mag[star] < s->parameters->bright_limit_mag))
            return;
    }
}

/* A candidate of two ranges: the third side, the handedness, then the final judgement. */
static int32_t triangle(search *s, int32_t star, int32_t earlier_spot, int32_t earlier, int32_t spot,
                        int32_t other)
{
    const double *unit_vectors = s->stars->cells.unit_vectors;
    int32_t side = earlier_spot * s->spots + spot;
    window(s, earlier_spot, spot);
    double cosine = st_dot(unit_vectors + 3 * earlier, unit_vectors + 3 * other);
    if (!(lowest_of[side] <= cosine && cosine <= highest_of[side]))
        return ST_NOTHING;
    if (!volume_known[earlier_spot]) {
        volume_of[earlier_spot] = st_volume(s->spikes->b, s->pivot, earlier_spot, spot);
        volume_known[earlier_spot] = 1;
    }
    double volume = volume_of[earlier_spot];
    double mirror = st_volume(unit_vectors, star, earlier, other);
    /* A triangle so flat that the tolerance can turn it over has no handedness. */
    double longest = lowest_of[s->pivot * s->spots + spot];
    if (lowest_of[s->pivot * s->spots + earlier_spot] < longest)
        longest = lowest_of[s->pivot * s->spots + earlier_spot];
    if (lowest_of[side] < longest)
        longest = lowest_of[side];
    if (longest > 1.0)
        longest = 1.0;
    if (longest < -1.0)
        longest = -1.0;
    double flat = 2.0 * s->limits->tolerance_rad * acos(longest);
    if (volume * mirror < 0.0 && fabs(volume) > flat && fabs(mirror) > flat)
        return ST_NOTHING;
    int32_t trial_spot[3] = {s->pivot, earlier_spot, spot};
    int32_t trial_star[3] = {star, earlier, other};
    if (st_known(&s->solutions, trial_spot, trial_star))
        return ST_NOTHING; /* a solution already found, once more */
    for (int32_t i = 0; i < s->spikes->count; i++)
        trial_index[i] = -1;
    for (int32_t corner = 0; corner < 3; corner++)
        trial_index[trial_spot[corner]] = trial_star[corner];
    return st_judge(s->spikes, s->spread_rad, s->stars, s->limits, trial_index, &s->solutions);
}

/* Candidates of one pair that earlier ranges of the pivot have too, and what becomes of them. */
static int32_t meet(search *s, int32_t place, int32_t ends, int32_t spot)
{
    const st_brightness_marks *marks = s->marks;
    int32_t star = s->pairs->brighter[place];
    int32_t other = s->pairs->dimmer[place];
    for (;;) {
        const st_brightness_mark *marked = &marks->mark[star];
        int32_t following = marked->pivot == marks->pivots ? marked->head : -1;
        while (following >= 0) {
            const st_brightness_entry *entry = &marks->entry[following];
            following = entry->next;
            if (entry->star == other || entry->spot == spot) /* the latter marked while this range is read */
                continue;
            int32_t outcome = triangle(s, star, entry->spot, entry->star, spot, other);
            if (outcome != ST_NOTHING)
                return outcome;
        }
        if (--ends == 0)
            return ST_NOTHING;
        other = star;
        star = s->pairs->dimmer[place];
    }
}

/* The pivot's next partners, the dimmest of those left, nearest first; how many there are. */
static int32_t next_group(const search *s, int32_t left, int32_t *group_spot)
{
    const double *lowest = lowest_of + s->pivot * s->spots;
    int32_t size = left < GROUP ? left : GROUP;
    for (int32_t member = 0; member < size; member++) {
        int32_t spot = left - member + s->pivot;
        window(s, s->pivot, spot);
        int32_t slot = member;
        while (slot > 0 && lowest[group_spot[slot - 1]] < lowest[spot]) {
            group_spot[slot] = group_spot[slot - 1];
            slot--;
        }
        group_spot[slot] = spot;
    }
    return size;
}

/* The range of the pivot's angle to `spot`, (13); one of the whole pair list is kept for the last round. */
static pair_range range_of(const search *s, int32_t spot)
{
    pair_range range = {.spot = spot, .ends = 2};
    int32_t place = s->pivot * s->spots + spot;
    if (s->round > 0 && (known_of[place] & RANGE_KNOWN)) {
        range.first = first_of[place];
        range.end = end_of[place];
        return range;
    }
    st_range(s->pairs, lowest_of[place], highest_of[place], &range.first, &range.end);
    if (s->round > 0) {
        first_of[place] = range.first;
        end_of[place] = range.end;
        known_of[place] |= RANGE_KNOWN;
    }
    return range;
}

/* Read a range against the pivot's marks, from the middle outwards: the true pair is the likeliest there, and
 * may end it. */
static int32_t read_range(search *s, const pair_range *range, int32_t marking)
{
    int32_t middle = (range->first + range->end) / 2;
    int32_t length = range->end - range->first;
    memset(volume_known, 0, (size_t)s->spots);
    for (int32_t step = 0; step < length; step++) {
        int32_t aside = (step + 1) / 2;
        int32_t place = step % 2 == 0 ? middle + aside : middle - aside;
        int32_t outcome = meet(s, place, range->ends, range->spot);
        if (outcome != ST_NOTHING)
            return outcome;
        if (marking)
            mark(s, place, range->ends, range->spot);
    }
    return ST_NOTHING;
}

/* All partners of the pivot, from the dimmest on; in reference mode one group alone. */
static int32_t try_pivot(search *s)
{
    const double *magnitudes = s->spikes->magnitudes;
    double pivot_mag = magnitudes[s->pivot];
    double distinct_mag = s->parameters->distinct_mag;
    pair_range waiting = {.spot = -1}; /* not marked yet */
    int32_t joined = 0;
    int32_t left = s->spots - 1 - s->pivot;
    s->used = 0;
    while (left > 0) {
        int32_t group_spot[GROUP];
        int32_t brightest = s->pivot + 1 + (left > GROUP ? left - GROUP : 0);
        /* Spikes come brightest first: what holds for the group's brightest holds for all of it. */
        int32_t distinct = s->round < 2 && magnitudes[brightest] - pivot_mag > distinct_mag;
        int32_t size = next_group(s, left, group_spot);
        left = s->round > 0 ? left - size : 0;
        for (int32_t member = 0; member < size; member++) {
            pair_range range = range_of(s, group_spot[member]);
            if (range.end <= range.first)
                continue;
            if (s->round < 2 && (distinct || magnitudes[range.spot] - pivot_mag > distinct_mag)) {
                range.ends = 1;
                s->ordered = 1;
            }
            if (s->used + 2 * (waiting.end - waiting.first + range.end - range.first) > s->marks->entries)
                return NO_ROOM;
            for (int32_t place = waiting.first; place < waiting.end; place++)
                mark(s, place, waiting.ends, waiting.spot);
            waiting = (pair_range){.spot = -1};
            if (s->used > 0) {
                int32_t outcome = read_range(s, &range, joined > 0 && (member < size - 1 || left > 0));
                if (outcome != ST_NOTHING)
                    return outcome;
                joined++;
            }
            /* The first two ranges are marked when a third one needs them, later ones at once. */
            if (joined < 2)
                waiting = range;
        }
    }
    return ST_NOTHING;
}

/* All rounds, and in each the pivots from the brightest on. */
static int32_t search_all(search *s, const st_pair_table *pairs, const st_pair_table *reference_pairs)
{
    for (s->round = 0; s->round < 3; s->round++) {
        if (s->round == 0 && s->spikes->count < 4)
            continue;
        if (s->round == 2 && (!s->ordered || s->solutions.kept[ST_CONFIRMED].matched > 0))
            break;
        s->pairs = s->round == 0 ? reference_pairs : pairs;
        for (s->pivot = 0; s->pivot < s->spots - 2; s->pivot++) {
            if (s->round == 0 && !(s->spikes->magnitudes[s->pivot] < s->parameters->bright_limit_mag))
                break;
            s->marks->pivots++;
            int32_t outcome = try_pivot(s);
            if (outcome != ST_NOTHING)
                return outcome;
        }
    }
    return ST_NOTHING;
}

int32_t st_identify_brightness_referenced(const st_spikes *spikes, const st_star_table *stars,
                                          const st_pair_table *pairs, const st_pair_table *reference_pairs,
                                          const st_limits *limits, const st_brightness_parameters *parameters,
                                          st_brightness_marks *marks, st_identification *found,
                                          int32_t *star_index)
{
    st_spikes usable;
    int32_t count = st_usable_spikes(spikes, places, &usable);
    if (count < 3) {
        st_no_identification(ST_REASON_TOO_FEW_STARS, spikes->count, found, star_index);
        return 1;
    }
    search s = {
        .spikes = &usable,
        .stars = stars,
        .limits = limits,
        .parameters = parameters,
        .marks = marks,
        .spots = count < parameters->max_spots ? count : parameters->max_spots,
        .spread_rad = st_spread(usable.b, count),
    };
    s.solutions.kept[ST_CONFIRMED].star_index = solution_index[ST_CONFIRMED];
    s.solutions.kept[ST_TRIANGLE].star_index = solution_index[ST_TRIANGLE];
    st_no_solutions(&s.solutions, count);
    memset(known_of, 0, (size_t)(s.spots * s.spots));
    if (marks->pivots > MOST_PIVOTS) {
        memset(marks->mark, 0, (size_t)stars->stars * sizeof *marks->mark);
        marks->pivots = 0;
    }
    int32_t outcome = search_all(&s, pairs, reference_pairs);
    if (outcome == NO_ROOM) {
        st_no_identification(ST_REASON_NO_MATCH, spikes->count, found, star_index);
        return 0;
    }
    st_best_identification(outcome, &s.solutions, places, count, spikes->count, found, star_index);
    return 1;
}
