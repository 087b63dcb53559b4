/* Identification by brightness-referenced pairs; see brightness_referenced.c. */
#ifndef ST_BRIGHTNESS_REFERENCED_H
#define ST_BRIGHTNESS_REFERENCED_H

#include "identification.h"

/* A candidate of the pivot: the star its partner spike would be, and which spike that is. */
typedef struct {
    int32_t next; /* entry of the same pivot star that was marked before, -1: none */
    int32_t star;
    int32_t spot;
} st_brightness_entry;

/* The mark of a catalogue star: its last entry, of this pivot where `pivot` is its number. */
typedef struct {
    int32_t head;
    int32_t pivot;
} st_brightness_mark;

/* Mark table and room to work in, kept from image to image; nothing in it is cleared in between. */
typedef struct {
    st_brightness_mark *mark; /* [stars], all 0 at start-up */
    st_brightness_entry *entry;
    int32_t entries;          /* of `entry`: twice as many as the ranges of one pivot have pairs together */
    int32_t pivots;           /* number of the last pivot, 0 at start-up */
} st_brightness_marks;

/* interface.BrightnessParameters, with the spikes that patterns are built from. */
typedef struct {
    double distinct_mag;
    double bright_limit_mag;
    int32_t max_spots; /* at most ST_MOST_PATTERN_SPIKES */
} st_brightness_parameters;

/* brightness_referenced.identify without limits of work. reference_pairs: those whose brighter star is
 * brighter than bright_limit_mag. star_index[spikes->count] is written, -1 where there is no star.
 * 0: the ranges of a pivot had no room in `marks`, nothing is found; else 1. */
int32_t st_identify_brightness_referenced(const st_spikes *spikes, const st_star_table *stars,
                                          const st_pair_table *pairs, const st_pair_table *reference_pairs,
                                          const st_limits *limits, const st_brightness_parameters *parameters,
                                          st_brightness_marks *marks, st_identification *found,
                                          int32_t *star_index);

#endif
