/* Inside the stop proofs: intervals that round outward, and what the effects of a model give in a region. */
#ifndef STOPSET_LAWS_H
#define STOPSET_LAWS_H
#include "stops.h"

typedef struct {
    double lo, hi;
} Ends;

Ends ends_out(double lo, double hi, int ulps);
Ends ends_add(Ends a, Ends b);
Ends ends_mul(Ends a, Ends b);
#endif
