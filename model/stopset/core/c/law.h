/* Inside the core: a law's steps played for up to ROWS samples side by side. */
#ifndef STOPSET_LAW_H
#define STOPSET_LAW_H
#include "stopset.h"

enum { ROWS = 16, STEPS = STOPSET_LAW_STEPS };

/* What a step does, in the order of stopset.ring.tape. */
enum {
    LAW_CONSTANT, LAW_SIGNAL, LAW_ADD, LAW_SUB, LAW_MUL, LAW_DIV, LAW_NEG, LAW_ABSOLUTE, LAW_SIGN, LAW_SQUARE, LAW_SQRT, LAW_SIN, LAW_COS,
    LAW_EXP, LAW_TANH, LAW_MINIMUM, LAW_MAXIMUM, LAW_POWER
};

/* signals[k]: what the law reads as signal k, `rows` of ROWS numbers used; out: the law's value for each. */
void stopset_play(const StopsetProgram *law, const double (*signals)[ROWS], int rows, double *out);
#endif
