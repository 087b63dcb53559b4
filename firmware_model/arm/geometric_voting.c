/* Identification by geometric voting: firmware_model/identification/geometric_voting.py, after Kolomenkin,
 * Pollak, Shimshoni & Lindenbaum 2008 as Zhang et al. 2014, 2.2, retell it.
 *
 * Directions and cosines are software double precision in the Python stage's order of operations, so that
 * the same angles fit. Votes are halfwords, read two by two, and which identities fit each other is a bit
 * each, so that both tables stay small. A star cannot get 65536 votes: one of each pair of stars it is in
 * (some thousands at most) and each other spike, whose narrow ranges have few of these pairs. */
#include "geometric_voting.h"

#include <math.h>
#include <string.h>

#include "attitude.h"
#include "kvector.h"
#include "solutions.h"
#include "verification.h"

#define FEWEST_SPIKES 3
#define MOST_IDENTITIES_IN_ALL 768 /* with runners-up */
#define MOST_VOTES 65536

enum { NO_ROOM = -1, END_REACHED, SOLVED, AMBIGUOUS };

/* Of two spikes, [one][other] in rows of search.voters: bounds of the cosine of their angle. */
static double lowest_of[ST_MOST_VOTING_SPIKES * ST_MOST_VOTING_SPIKES];
static double highest_of[ST_MOST_VOTING_SPIKES * ST_MOST_VOTING_SPIKES];
static int32_t identity_spike[ST_MOST_VOTING_SPIKES * ST_MOST_IDENTITIES];
static int32_t identity_star[ST_MOST_VOTING_SPIKES * ST_MOST_IDENTITIES];
static int32_t support_of[ST_MOST_VOTING_SPIKES * ST_MOST_IDENTITIES];
static int32_t order[ST_MOST_VOTING_SPIKES * ST_MOST_IDENTITIES];
static uint8_t clustered[ST_MOST_VOTING_SPIKES * ST_MOST_IDENTITIES];
/* How many have so many votes, or so much support; all 0 between uses. */
static int32_t number_with[MOST_VOTES];
static int32_t cluster[ST_MOST_VOTING_SPIKES];
static int32_t places[ST_MOST_SPIKES];
static int32_t trial_index[ST_MOST_SPIKES];
static int32_t best_index[ST_MOST_SPIKES];

typedef struct {
    const st_spikes *spikes;
    const st_star_table *stars;
    const st_pair_table *pairs;
    const st_limits *limits;
    const st_voting_room *room;
    double spread_rad;
    double best_q[4];
    double best_chance;
    st_verified best; /* matched 0: no solution yet */
    int32_t rivals;   /* among solutions of fewer than min_stars */
    int32_t voters;   /* spikes whose votes may be counted */
    int32_t identities;
    int32_t row_stars; /* of a row of the room's `votes`: even */
    int32_t row_words; /* of a row of the room's `fits` */
} search;

/* The first vote of all pairs of the first `spikes` spikes but those of the first `voted`. */
static void cast_votes(const search *s, int32_t voted, int32_t spikes)
{
    const double *b = s->spikes->b;
    const int32_t *brighter = s->pairs->brighter;
    const int32_t *dimmer = s->pairs->dimmer;
    int32_t row = s->row_stars;
    memset(s->room->votes + voted * row, 0, (size_t)((spikes - voted) * row) * sizeof(uint16_t));
    for (int32_t j = voted; j < spikes; j++) {
        uint16_t *of_j = s->room->votes + j * row;
        for (int32_t i = 0; i < j; i++) {
            uint16_t *of_i = s->room->votes + i * row;
            double *lowest = &lowest_of[i * s->voters + j];
            double *highest = &highest_of[i * s->voters + j];
            int32_t place;
            int32_t end;
            st_cosine_range(st_angle(b + 3 * i, b + 3 * j), s->limits->tolerance_rad, lowest, highest);
            lowest_of[j * s->voters + i] = *lowest;
            highest_of[j * s->voters + i] = *highest;
            st_range(s->pairs, *lowest, *highest, &place, &end);
            for (; place < end; place++) {
                int32_t one = brighter[place];
                int32_t other = dimmer[place];
                of_i[one]++;
                of_i[other]++;
                of_j[one]++;
                of_j[other]++;
            }
        }
    }
}

/* Votes of two stars that follow each other, the first in the lower half. */
static inline uint32_t two_votes(const uint16_t *votes)
{
    uint32_t word;
    memcpy(&word, __builtin_assume_aligned(votes, 4), sizeof word);
    return word;
}

/* Stars with the most votes of a spike, 0 where the vote says nothing: no star has two votes, or more than
 * ST_MOST_IDENTITIES tie. Votes are compared where they are in a word, in its upper half. */
static int32_t first_identities(const uint16_t *votes, int32_t stars, int32_t *identity)
{
    const uint16_t *end = votes + ST_VOTES_OF_A_SPIKE(stars);
    uint32_t most = 2 << 16;
    int32_t found = 0;
    for (const uint16_t *two = votes; two < end; two += 2) {
        uint32_t word = two_votes(two);
        if (word < most && word << 16 < most)
            continue;
        for (int32_t half = 0; half < 2; half++) {
            uint32_t number = (uint32_t)two[half] << 16;
            if (number < most)
                continue;
            if (number > most) {
                most = number;
                found = 0;
            }
            if (found < ST_MOST_IDENTITIES)
                identity[found] = two - votes + half;
            found++;
        }
    }
    return found <= ST_MOST_IDENTITIES ? found : 0;
}

/* The same with runners-up: all with so few votes, but two, that at most most_identities have as many. */
static int32_t runners_up(const uint16_t *votes, int32_t stars, int32_t most_identities, int32_t *identity)
{
    const uint16_t *end = votes + ST_VOTES_OF_A_SPIKE(stars);
    uint32_t most = 1;
    int32_t found = 0;
    for (const uint16_t *two = votes; two < end; two += 2) {
        uint32_t word = two_votes(two);
        if (word < 2 << 16 && word << 16 < 2 << 16)
            continue; /* as most words of a large sky are */
        for (int32_t half = 0; half < 2; half++) {
            uint32_t number = two[half];
            number_with[number]++;
            if (number > most)
                most = number;
        }
    }
    uint32_t fewest = most + 1;
    while (fewest > 2 && found + number_with[fewest - 1] <= most_identities) {
        fewest--;
        found += number_with[fewest];
    }
    memset(number_with, 0, (size_t)(most + 1) * sizeof *number_with);
    found = 0;
    for (const uint16_t *two = votes; two < end; two += 2) {
        uint32_t word = two_votes(two);
        if (word < fewest << 16 && word << 16 < fewest << 16)
            continue;
        if (two[0] >= fewest)
            identity[found++] = two - votes;
        if (two[1] >= fewest)
            identity[found++] = two - votes + 1;
    }
    return found;
}

/* Who each spike may be after the first vote, by spike. */
static void list_identities(search *s, int32_t spikes, int32_t with_runners_up)
{
    int32_t stars = s->stars->stars;
    int32_t most_identities = MOST_IDENTITIES_IN_ALL / spikes;
    if (most_identities > ST_MOST_IDENTITIES)
        most_identities = ST_MOST_IDENTITIES;
    s->identities = 0;
    for (int32_t spike = 0; spike < spikes; spike++) {
        const uint16_t *votes = s->room->votes + spike * s->row_stars;
        int32_t *identity = identity_star + s->identities;
        int32_t found = with_runners_up ? runners_up(votes, stars, most_identities, identity)
                                        : first_identities(votes, stars, identity);
        for (int32_t place = 0; place < found; place++)
            identity_spike[s->identities++] = spike;
    }
    s->row_words = (s->identities + 31) / 32;
}

static int32_t fits(const search *s, int32_t h, int32_t g)
{
    return s->room->fits[h * s->row_words + g / 32] >> (g % 32) & 1;
}

static void set_fits(const search *s, int32_t h, int32_t g)
{
    s->room->fits[h * s->row_words + g / 32] |= (uint32_t)1 << (g % 32);
}

/* The second vote: which identities fit each other, and how many fit each. */
static void second_votes(const search *s)
{
    const double *unit_vectors = s->stars->cells.unit_vectors;
    memset(s->room->fits, 0, (size_t)(s->identities * s->row_words) * sizeof(uint32_t));
    memset(support_of, 0, (size_t)s->identities * sizeof *support_of);
    for (int32_t h = 0; h < s->identities; h++) {
        int32_t i = identity_spike[h];
        int32_t one = identity_star[h];
        for (int32_t g = h + 1; g < s->identities; g++) {
            int32_t j = identity_spike[g];
            int32_t other = identity_star[g];
            if (i == j || one == other)
                continue;
            double cosine = st_dot(unit_vectors + 3 * one, unit_vectors + 3 * other);
            if (!(lowest_of[i * s->voters + j] <= cosine && cosine <= highest_of[i * s->voters + j]))
                continue;
            set_fits(s, h, g);
            set_fits(s, g, h);
            support_of[h]++;
            support_of[g]++;
        }
    }
}

/* Identities with the most support first, of equal ones the first; none is in a cluster yet. */
static void order_identities(const search *s)
{
    int32_t before = 0;
    int32_t most = 0;
    for (int32_t h = 0; h < s->identities; h++) {
        clustered[h] = 0;
        number_with[support_of[h]]++;
        if (support_of[h] > most)
            most = support_of[h];
    }
    for (int32_t support = most; support >= 0; support--) {
        int32_t number = number_with[support];
        number_with[support] = before;
        before += number;
    }
    for (int32_t h = 0; h < s->identities; h++)
        order[number_with[support_of[h]]++] = h;
    memset(number_with, 0, (size_t)(most + 1) * sizeof *number_with);
}

/* The cluster about an identity: those that fit all its members, in their order; its size. */
static int32_t grow_cluster(const search *s, int32_t seed)
{
    int32_t members = 1;
    cluster[0] = seed;
    for (int32_t place = 0; place < s->identities; place++) {
        int32_t identity = order[place];
        int32_t member = 0;
        while (member < members && fits(s, identity, cluster[member]))
            member++;
        if (member == members && members < s->voters)
            cluster[members++] = identity;
    }
    return members;
}

/* Whether the judged trial is the solution found: its stars, and its attitude within the tolerance; a roll
 * may differ by it over the spread. */
static int32_t is_same(const search *s, const double *q)
{
    double turn = 0.0;
    double spread_rad = s->spread_rad > 0.01 ? s->spread_rad : 0.01;
    for (int32_t spike = 0; spike < s->spikes->count; spike++)
        if (trial_index[spike] >= 0 && best_index[spike] >= 0 && trial_index[spike] != best_index[spike])
            return 0;
    for (int32_t m = 0; m < 4; m++)
        turn += s->best_q[m] * q[m];
    /* 1 - |turn| = (angle / 2)^2 / 2 */
    double rest = 2.0 * (1.0 - fabs(turn));
    double angle_rad = 2.0 * sqrt(rest > 0.0 ? rest : 0.0);
    return angle_rad < 4.0 * s->limits->tolerance_rad / (spread_rad < 1.0 ? spread_rad : 1.0);
}

/* The final judgement of a cluster; END_REACHED: the search goes on. */
static int32_t judge(search *s, int32_t members)
{
    const st_limits *limits = s->limits;
    int32_t spikes = s->spikes->count;
    double q[4];
    for (int32_t spike = 0; spike < spikes; spike++)
        trial_index[spike] = -1;
    for (int32_t member = 0; member < members; member++) {
        int32_t identity = cluster[member];
        clustered[identity] = 1;
        trial_index[identity_spike[identity]] = identity_star[identity];
    }
    st_refine(s->spikes, s->stars, trial_index, q);
    st_verified trial = st_verify(s->spikes, q, s->stars, limits, 3, trial_index);
    int32_t enough = trial.matched >= limits->min_stars;
    int32_t best_enough = s->best.matched >= limits->min_stars;
    if (trial.matched == 0 || (!enough && best_enough))
        return END_REACHED;
    double chance = st_false_solutions(s->stars->stars, spikes, trial.matched, s->spread_rad,
                                       limits->tolerance_rad);
    if (chance > (enough ? limits->most_false_solutions : limits->most_false_triangles))
        return END_REACHED;
    if (s->best.matched > 0 && enough == best_enough) {
        /* A rival stands unless one of the two is certain; of those of too few stars none is. */
        if (!is_same(s, q)) {
            if (!enough)
                s->rivals = 1;
            else if (chance > limits->certain_false_solutions &&
                     s->best_chance > limits->certain_false_solutions)
                return AMBIGUOUS;
        }
        if (chance >= s->best_chance)
            return END_REACHED;
    }
    s->best = trial;
    s->best_chance = chance;
    memcpy(best_index, trial_index, (size_t)spikes * sizeof *best_index);
    memcpy(s->best_q, q, sizeof s->best_q);
    return enough && chance <= limits->certain_false_solutions ? SOLVED : END_REACHED;
}

/* Clusters of the identities, from the best supported on. */
static int32_t try_clusters(search *s)
{
    order_identities(s);
    for (int32_t place = 0; place < s->identities; place++) {
        int32_t seed = order[place];
        if (support_of[seed] < 2)
            break;
        if (clustered[seed])
            continue;
        int32_t members = grow_cluster(s, seed);
        if (members < 3)
            continue;
        int32_t outcome = judge(s, members);
        if (outcome != END_REACHED)
            return outcome;
    }
    return END_REACHED;
}

/* The votes of ever more spikes, at last with runners-up. */
static int32_t search_all(search *s, int32_t max_spots)
{
    int32_t voted = 0;
    int32_t with_runners_up = 0;
    while (!with_runners_up) {
        with_runners_up = voted == s->voters;
        if (!with_runners_up) {
            int32_t spikes = voted == 0 ? max_spots : 2 * voted;
            if (spikes > s->voters)
                spikes = s->voters;
            cast_votes(s, voted, spikes);
            voted = spikes;
        }
        list_identities(s, voted, with_runners_up);
        if (s->identities * s->row_words > s->room->words)
            return NO_ROOM;
        second_votes(s);
        int32_t outcome = try_clusters(s);
        if (outcome != END_REACHED)
            return outcome;
    }
    return END_REACHED;
}

int32_t st_identify_geometric_voting(const st_spikes *spikes, const st_star_table *stars,
                                     const st_pair_table *pairs, const st_limits *limits, int32_t max_spots,
                                     const st_voting_room *room, st_identification *found,
                                     int32_t *star_index)
{
    st_spikes usable;
    int32_t count = st_usable_spikes(spikes, places, &usable);
    if (count < FEWEST_SPIKES) {
        st_no_identification(ST_REASON_TOO_FEW_STARS, spikes->count, found, star_index);
        return 1;
    }
    search s = {
        .spikes = &usable,
        .stars = stars,
        .pairs = pairs,
        .limits = limits,
        .room = room,
        .best_chance = INFINITY,
        .spread_rad = st_spread(usable.b, count),
        .row_stars = ST_VOTES_OF_A_SPIKE(stars->stars),
        .voters = count < ST_MOST_VOTING_SPIKES ? count : ST_MOST_VOTING_SPIKES,
    };
    int32_t outcome = search_all(&s, max_spots);
    int32_t enough = s.best.matched >= limits->min_stars;
    int32_t reason = enough ? ST_REASON_NONE : ST_REASON_UNCONFIRMED;
    if (outcome == AMBIGUOUS || (outcome == END_REACHED && s.best.matched > 0 && !enough && s.rivals))
        reason = ST_REASON_AMBIGUOUS;
    else if (outcome == NO_ROOM || s.best.matched == 0)
        reason = ST_REASON_NO_MATCH;
    st_no_identification(reason, spikes->count, found, star_index);
    if (reason != ST_REASON_NONE && reason != ST_REASON_UNCONFIRMED)
        return outcome != NO_ROOM;
    found->verified = s.best.matched;
    found->expected = s.best.expected;
    found->seen = s.best.seen;
    found->false_solutions = s.best_chance;
    memcpy(found->q, s.best_q, sizeof found->q);
    for (int32_t spike = 0; spike < count; spike++)
        star_index[places[spike]] = best_index[spike];
    return 1;
}
