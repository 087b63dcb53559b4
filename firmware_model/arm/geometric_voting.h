/* Identification by geometric voting; see geometric_voting.c. */
#ifndef ST_GEOMETRIC_VOTING_H
#define ST_GEOMETRIC_VOTING_H

#include "identification.h"

#define ST_MOST_VOTING_SPIKES 128 /* the votes of no more spikes are counted */
#define ST_MOST_IDENTITIES 32     /* of one spike */
#define ST_VOTES_OF_A_SPIKE(stars) (((stars) + 1) & ~1) /* they are read two by two */

/* Room to work in, kept from image to image or not; it is cleared here. */
typedef struct {
    uint16_t *votes; /* [spikes][ST_VOTES_OF_A_SPIKE(stars)], spikes at most ST_MOST_VOTING_SPIKES */
    uint32_t *fits;  /* a bit for each two identities */
    int32_t words;   /* of `fits`: identities times their number over 32, rounded up */
} st_voting_room;

/* geometric_voting.identify without limits of work. star_index[spikes->count] is written, -1 where there is
 * no star. 0: `room` holds too few identities, nothing is found; else 1. */
int32_t st_identify_geometric_voting(const st_spikes *spikes, const st_star_table *stars,
                                     const st_pair_table *pairs, const st_limits *limits, int32_t max_spots,
                                     const st_voting_room *room, st_identification *found,
                                     int32_t *star_index);

#endif
