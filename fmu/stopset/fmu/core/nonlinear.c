/* Predictions of a nonlinear model: the unit's own, and those from past samples that the monitor holds every sample against.
 *
 * All of it is the core's (core/along.c, core/predictions_along.c), as in the monitor.
 */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

#if CORNERS || PATHS
enum { OLDEST = AGES - 1 };

static int on_grid(double h) { return fabs(h - stopset_model.dt) <= 1e-9 * stopset_model.dt; }

void stopset_own_start(StopsetState *s, const StopsetWork *w) {
    double fastest = 0.0, x[NX];
    for (int i = 0; i < NX; i++) {
        x[i] = s->r[(i < NJ ? VR_Q : VR_DQ - NJ) + i];
        s->corner[0][i] = x[i] + stopset_model.X0_lo[i];
        s->corner[1][i] = x[i] + stopset_model.X0_hi[i];
        if (i >= NJ) fastest = fmax(fastest, fabs(x[i]));
    }
#if PATHS
    memcpy(s->path[0], x, sizeof x);
#endif
    s->along = 0;
    s->parts = (int32_t)stopset_parts(&w->dynamics, stopset_model.dt, fastest + 2.0);
}

#if CORNERS
static const double ROUND = 0x1p-42; /* of a bound, relative, as stopset.reach.nonlinear.predicted_tube */

/* Both corners on under u. */
static void spread(const StopsetWork *w, const double u[NJ], double h, int64_t parts, double *low, double *high) {
    double torque[2][NJ];
    for (int i = 0; i < NJ; i++) {
        torque[0][i] = u[i] + stopset_model.U_lo[i];
        torque[1][i] = u[i] + stopset_model.U_hi[i];
    }
    stopset_corners(&w->dynamics, 1, torque[0], h, parts, HUGE_VAL, low);
    stopset_corners(&w->dynamics, 1, torque[1], h, parts, HUGE_VAL, high);
}
#endif

void stopset_own_step(StopsetState *s, StopsetWork *w, const double u[NJ], double h) {
    const double dt = stopset_model.dt, step = on_grid(h) ? dt : h;
    const int64_t pieces = step <= dt ? 1 : (int64_t)(step / dt) + 1;
    double x[NX], path[2][NX];
    memcpy(x, &s->r[VR_Q], NJ * sizeof *x);
    memcpy(x + NJ, &s->r[VR_DQ], NJ * sizeof *x);
    for (int64_t k = 0; k < pieces; k++) {
        const StopsetStarts start = {1, 1, x, u, step / (double)pieces};
        stopset_nominal(&w->dynamics, &start, w->room, path[0]);
        memcpy(x, path[1], sizeof x);
    }
    memcpy(&s->r[VR_Q], x, NJ * sizeof *x);
    memcpy(&s->r[VR_DQ], x + NJ, NJ * sizeof *x);
#if CORNERS
    const double parts = s->parts * (step / dt);
    if (s->along >= 0) spread(w, u, step, step == dt ? s->parts : (int64_t)parts + 1, s->corner[0], s->corner[1]);
#else
    if (step != dt || s->along < 0 || s->along >= OLDEST) {
        s->along = -1;
        return;
    }
    memcpy(s->torque[s->along++], u, NJ * sizeof *u);
    memcpy(s->path[s->along], x, sizeof x);
#endif
}

void stopset_own_bounds(const StopsetState *s, StopsetWork *w, double lo[NX], double hi[NX]) {
    if (s->along < 0 || s->along > OLDEST || s->modes_by_events) { /* in model exchange nobody steps it */
        for (int i = 0; i < NX; i++) lo[i] = hi[i] = (double)NAN;
        return;
    }
#if CORNERS
    memcpy(lo, s->corner[0], sizeof s->corner[0]);
    memcpy(hi, s->corner[1], sizeof s->corner[1]);
    stopset_read(NX, &w->sets, ROUND, lo, hi);
#else
    const StopsetNominal nominal = {s->along, s->path[0], s->torque[0], stopset_model.dt};
    stopset_ahead(&w->dynamics, &w->sets, &nominal, w->room, lo, hi);
#endif
}

/* What the core keeps of past samples is in the unit's state. */
static StopsetAlong past_of(StopsetState *s, StopsetWork *w) {
    static const double rounding[NX] = {0};
    StopsetPast *c = &s->past;
    double fastest = 0.0;
    for (int i = NJ; i < NX; i++) fastest = fmax(fastest, fmax(fabs(stopset_model.lo[i]), fabs(stopset_model.hi[i])));
    const StopsetAlong out = {
        .dynamics = &w->dynamics, .sets = &w->sets, .rounding = rounding, .dt = stopset_model.dt, .fastest = fastest, .oldest = OLDEST,
        .corners = CORNERS, .sliding = stopset_model.sliding, .x = c->x[0][0], .starts = c->starts, .outside = c->outside, .sum = c->sum[0],
        .count = c->count, .work = w->room,
#if PATHS
        .u = c->u[0][0],
#endif
    };
    return out;
}

void stopset_forget(StopsetState *s) {
    StopsetPast *c = &s->past;
    for (int k = 0; k < N_MEMORY; k++) memcpy(c->ends[k], stopset_model.memory[k].whole, sizeof c->ends[k]);
    memset(c->starts, 0, sizeof c->starts);
    memset(c->count, 0, sizeof c->count);
}

/* The joint whose bound is passed worst, over its width. */
static int32_t worst_joint(const double *worst, const int64_t *age) {
    int at = -1;
    for (int k = 0; k < 2 * NX; k++)
        if (age[k] > 0 && (at < 0 || worst[k] > worst[at])) at = k;
    return at % NJ + 1;
}

int stopset_sample_along(StopsetState *s, StopsetWork *w, int32_t every, int32_t *joint) {
    StopsetPast *c = &s->past;
    double x[NX], u[NJ], du[NJ], room[NX], lo[NX], hi[NX], worst[2 * NX], ends[4 * NX];
    int64_t age[2 * NX], oldest;
    uint8_t foreign[2 * NX];
    int outside;
    if (c->every != every) stopset_forget(s);
    c->every = every;
    if (!stopset_take_sample(s, w, x, u, du, &outside)) return VERDICT_NONE;
    const int known = c->count[STOPSET_ALONG_SAMPLES] > 0;
    const StopsetAlong along = past_of(s, w);
    const StopsetHeld held = {room, lo, hi, worst, ends, age, foreign, &oldest};
    const int64_t live = stopset_along_sample(&along, every, x, u, du, outside, &held);
    if (live < 0) /* between two steps: that of the last one */
        return c->said == VERDICT_CONFORMANT && !outside ? VERDICT_CONFORMANT : VERDICT_NONE;
    c->said = !live ? (known ? VERDICT_NONE : NOTHING_BEFORE) : outside ? VERDICT_NONE : VERDICT_CONFORMANT;
    for (int k = 0; live && k < 2 * NX; k++)
        if (age[k] > 0) c->said = VERDICT_VIOLATED;
    if (c->said == VERDICT_VIOLATED) *joint = worst_joint(worst, age);
    return c->said;
}
#else
void stopset_own_start(StopsetState *s, const StopsetWork *w) { (void)s, (void)w; }
#endif
