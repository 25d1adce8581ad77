/* Inside the core: a law's steps played for up to ROWS samples side by side. */
#ifndef STOPSET_LAW_H
#define STOPSET_LAW_H
#include "stopset.h"

enum { ROWS = 16, STEPS = STOPSET_LAW_STEPS };

/* signals[k]: what the law reads as signal k, `rows` of ROWS numbers used; out: the law's value for each. */
void stopset_play(const StopsetProgram *law, const double (*signals)[ROWS], int rows, double *out);
#endif
