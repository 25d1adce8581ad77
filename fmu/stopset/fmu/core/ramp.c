/* The nominal motion of a STOP 1 or 2: every joint goes on for the control's delay, then slows down to rest, then holds. */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

/* [s] from the ramp's begin until joint i rests. */
static double lasts(const StopsetState *s, int i) {
    const StopsetModel *m = &stopset_model;
    return m->ramp_timed ? m->ramp_value[i] * s->r[VR_STOP1_TIME] : fmax(fabs(s->stop_dq[i]) / m->ramp_value[i], 1e-12);
}

void stopset_ramp_motion(const StopsetState *s, double since, double q[NJ], double dq[NJ], double ddq[NJ]) {
    const double pace = stopset_model.ramp_pace; /* by which the programmed motion itself changes its speed */
    for (int i = 0; i < NJ; i++) {
        const double begin = stopset_model.ramp_delay[i], T = lasts(s, i), v = s->stop_dq[i], x = fmin(fmax(since - begin, 0.0), T);
        const double path_time = fmin(since, begin) + x - 0.5 * x * x / T, rest = 1.0 - x / T, share = 1.0 + pace * path_time;
        q[i] = s->stop_q[i] + v * (path_time + 0.5 * pace * path_time * path_time);
        dq[i] = v * rest * share;
        ddq[i] = since >= begin + T ? 0.0 : v * (pace * rest * rest - (since >= begin ? share / T : 0.0));
    }
}

double stopset_ramp_length(const StopsetState *s) {
    double end = 0.0;
    for (int i = 0; i < NJ; i++) end = fmax(end, stopset_model.ramp_delay[i] + lasts(s, i));
    return end;
}

double stopset_ramp_changes(const StopsetState *s, double since) {
    double next = HUGE_VAL;
    for (int i = 0; i < NJ; i++) {
        const double at[2] = {stopset_model.ramp_delay[i], stopset_model.ramp_delay[i] + lasts(s, i)};
        for (int k = 0; k < 2; k++)
            if (at[k] > since + 1e-12 && at[k] < next) next = at[k];
    }
    return next;
}
