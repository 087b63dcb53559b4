/* Background and noise of a detection window; see window_statistics.c. */
#ifndef ST_WINDOW_STATISTICS_H
#define ST_WINDOW_STATISTICS_H

#include "star_tracker.h"
#include "threshold.h"

/* Background and noise of a window. The number of its pixels times the largest of them is below 2^32: a whole
 * frame of 1024 x 1024 px with 12 bits. */
void st_window_statistics(const st_image *window, st_statistics *statistics);

#endif
