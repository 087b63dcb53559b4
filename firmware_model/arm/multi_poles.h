/* Identification by improved multi-poles; see multi_poles.c. */
#ifndef ST_MULTI_POLES_H
#define ST_MULTI_POLES_H

#include "identification.h"

/* A catalogue pair that fits one neighbour, by the star that would be the pole. */
typedef struct {
    int32_t next; /* entry of the same star that was made before, -1: none */
    int32_t partner;
    int32_t place;     /* of the pair in the pair catalogue */
    int32_t neighbour; /* spike */
} st_poles_entry;

/* What a catalogue star has as the pole. */
typedef struct {
    int32_t last_voter; /* number of the pole's first neighbour (base) plus the one that voted last */
    int32_t head;       /* its last entry; this and votes are of this pole where last_voter >= base */
    int32_t votes;
} st_poles_mark;

/* Mark table and room to work in, kept from image to image; nothing in it is cleared in between. */
typedef struct {
    st_poles_mark *mark; /* [stars], all 0 at start-up */
    st_poles_entry *entry;
    int32_t entries;     /* of `entry`: twice as many as the ranges of one pole have pairs together */
    int32_t base;        /* number of the next pole's first neighbour, 1 at start-up */
    int32_t *sets;       /* [spikes][spikes], the stars accepted by one pole after the other */
} st_poles_marks;

/* interface.MultiPolesParameters. */
typedef struct {
    double magnitude_tolerance;
    int32_t least_recognised;
} st_poles_parameters;

/* The single precision magnitudes m with |m - magnitude| < tolerance in double precision: all whose key is in
 * brightest..dimmest, none where the former is the larger. Keys are words that order as the magnitudes do:
 * their bits, all but the sign turned where it is set. */
void st_magnitude_keys(double magnitude, double tolerance, int32_t *brightest, int32_t *dimmest);

/* multi_poles.identify without limits of work. star_index[spikes->count] is written, -1 where there is no
 * star. 0: the ranges of a pole had no room in `marks`, nothing is found; else 1. */
int32_t st_identify_multi_poles(const st_spikes *spikes, const st_star_table *stars,
                                const st_pair_table *pairs, const st_limits *limits,
                                const st_poles_parameters *parameters, st_poles_marks *marks,
                                st_identification *found, int32_t *star_index);

#endif
