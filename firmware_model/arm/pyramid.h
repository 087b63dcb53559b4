/* Identification by pyramids; see pyramid.c. */
#ifndef ST_PYRAMID_H
#define ST_PYRAMID_H

#include "identification.h"

#define ST_MOST_PATTERN_SPIKES 64  /* patterns are built from no more spikes */

/* Mark table and room to work in, kept from image to image; nothing in it is cleared in between. */
typedef struct {
    int32_t *head;    /* [stars], all 0 at start-up */
    int32_t *partner; /* [entries] */
    int32_t *chain;   /* [entries] */
    int32_t entries;  /* twice as many as the longest range has pairs; twice all pairs always suffice */
    int32_t base;     /* number of the next entry, 1 at start-up */
} st_pyramid_marks;

/* pyramid.identify without limits of work. star_index[spikes->count] is written, -1 where there is no
 * star. */
void st_identify_pyramid(const st_spikes *spikes, const st_star_table *stars, const st_pair_table *pairs,
                         const st_limits *limits, int32_t max_spots, st_pyramid_marks *marks,
                         st_identification *found, int32_t *star_index);

#endif
