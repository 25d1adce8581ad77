/* Bounds on a stop that begins now. */
#include <math.h>

#include "stopset_core.h"

void stopset_stop_bounds(StopsetState *s) {
    for (int i = 0; i < NJ; i++) s->r[VR_STOP_TIME + i] = s->r[VR_STOP_ANGLE + i] = (double)NAN;
    s->r[VR_TCP_STOP_DISTANCE] = (double)NAN;
    s->b[IX_STOP_CERTIFIED] = 0;
}
