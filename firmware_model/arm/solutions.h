/* Solutions found so far, and what a further one means; see solutions.c. */
#ifndef ST_SOLUTIONS_H
#define ST_SOLUTIONS_H

#include "identification.h"

#define ST_MOST_TRIANGLE_SPIKES 4 /* images of more spikes need a confirmed solution */

/* Triple product u_i . (u_j x u_k) of rows of u[][3]: its sign is the triangle's handedness. */
double st_volume(const double *u, int32_t i, int32_t j, int32_t k);

/* Whether a trial is not the solution kept: another star, or turned by turn_rad or more. */
int32_t st_rival(const st_solution *kept, const int32_t *trial_index, int32_t spikes, const double *trial_q,
                 double turn_rad);

/* Whether three spikes have these stars in a solution already kept. */
int32_t st_known(const st_solutions *solutions, const int32_t spot[3], const int32_t star[3]);

/* Empties both solutions, star_index included, for so many spikes. */
void st_no_solutions(st_solutions *solutions, int32_t spikes);

/* Judge a trial (star_index in trial_index[n], overwritten by its matches): kept if it stands and is the
 * best. ST_NOTHING: go on; ST_CERTAIN and ST_RIVAL end the search. spread_rad: st_spread of all spikes. */
int32_t st_judge(const st_spikes *spikes, double spread_rad, const st_star_table *stars,
                 const st_limits *limits, int32_t *trial_index, st_solutions *solutions);

/* Leaves out what is no unit vector or no finite magnitude: the places of the others to places[n], their
 * number is returned. *usable is `given` itself if all are usable, else points to copies in static memory. */
int32_t st_usable_spikes(const st_spikes *given, int32_t *places, st_spikes *usable);

/* The better of the two solutions, or why there is none; star_index[given] is of all the spikes given. */
void st_best_identification(int32_t outcome, const st_solutions *solutions, const int32_t *places,
                            int32_t usable, int32_t given, st_identification *found, int32_t *star_index);

/* No identification, for a reason: star_index[given] all -1. */
void st_no_identification(int32_t reason, int32_t given, st_identification *found, int32_t *star_index);

#endif
