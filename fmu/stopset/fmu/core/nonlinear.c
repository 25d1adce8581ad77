/* Predictions of a nonlinear model: the unit's own, and those from past samples that the monitor holds every sample against.
 *
 * The arithmetic is the core's (core/along.c); which predictions there are, and when each is looked at, is as in stopset.monitor.along and
 * stopset.monitor.predictions.
 */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

#if CORNERS || PATHS
#if PATHS
#include "core/stops/laws.h"
#endif

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

/* Both corners of one prediction on under u, known to within du. */
static void spread(const StopsetWork *w, const double u[NJ], const double du[NJ], double h, int64_t parts, double most, double *low, double *high) {
    double torque[2][NJ];
    for (int i = 0; i < NJ; i++) {
        torque[0][i] = u[i] - du[i] + stopset_model.U_lo[i];
        torque[1][i] = u[i] + du[i] + stopset_model.U_hi[i];
    }
    stopset_corners(&w->dynamics, 1, torque[0], h, parts, most, low);
    stopset_corners(&w->dynamics, 1, torque[1], h, parts, most, high);
}
#endif

void stopset_own_step(StopsetState *s, StopsetWork *w, const double u[NJ], double h) {
    const double dt = stopset_model.dt, step = on_grid(h) ? dt : h;
    const int64_t pieces = step <= dt ? 1 : (int64_t)(step / dt) + 1;
    double x[NX], path[2][NX];
    memcpy(x, &s->r[VR_Q], NJ * sizeof *x);
    memcpy(x + NJ, &s->r[VR_DQ], NJ * sizeof *x);
    for (int64_t k = 0; k < pieces; k++) {
        stopset_nominal(&w->dynamics, 1, 1, x, u, step / (double)pieces, w->room, path[0]);
        memcpy(x, path[1], sizeof x);
    }
    memcpy(&s->r[VR_Q], x, NJ * sizeof *x);
    memcpy(&s->r[VR_DQ], x + NJ, NJ * sizeof *x);
#if CORNERS
    static const double sure[NJ] = {0};
    const double parts = s->parts * (step / dt);
    if (s->along >= 0) spread(w, u, sure, step, step == dt ? s->parts : (int64_t)parts + 1, HUGE_VAL, s->corner[0], s->corner[1]);
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
    stopset_ahead(&w->dynamics, &w->sets, s->along, s->path[0], s->torque[0], stopset_model.dt, w->room, lo, hi);
#endif
}

void stopset_forget(StopsetState *s) {
    StopsetPast *c = &s->past;
    for (int k = 0; k < N_MEMORY; k++) memcpy(c->ends[k], stopset_model.memory[k].whole, sizeof c->ends[k]);
#if CORNERS
    for (int k = 0; k < AGES; k++) c->age[k] = -1;
    c->next = 0;
#endif
    c->steps = 0;
    c->samples = 0;
    c->known = 0;
}

/* The worst passed bound of one prediction, over its width; the joint goes with it. */
static void hold(const double x[NX], const double lo[NX], const double hi[NX], double *worst, int32_t *joint) {
    for (int i = 0; i < NX; i++) {
        const double width = fmax(hi[i] - lo[i], 1e-300), over = (x[i] - hi[i]) / width, under = (lo[i] - x[i]) / width;
        /* written so that what is not a number is outside */
        if (x[i] <= hi[i] && x[i] >= lo[i]) continue;
        const double out = x[i] <= hi[i] ? under : over;
        if (*worst < 0.0 || out > *worst) {
            *worst = out > 0.0 ? out : 0.0;
            *joint = i % NJ + 1;
        }
    }
}

#if CORNERS
/* One step of all predictions under the mean input. */
static void carry(StopsetPast *c, const StopsetWork *w, const double u[NJ]) {
    for (int k = 0; k < AGES; k++) {
        if (c->age[k] < 0) continue;
        spread(w, u, c->du, stopset_model.dt, PARTS, stopset_model.fastest, c->z[0][k], c->z[1][k]);
        if (++c->age[k] > OLDEST) c->age[k] = -1;
    }
}

static int compare(StopsetPast *c, StopsetWork *w, const double x[NX], double *worst, int32_t *joint) {
    int live = 0;
    for (int k = 0; k < AGES; k++) {
        double lo[NX], hi[NX];
        if (c->age[k] <= 0) continue;
        live++;
        for (int i = 0; i < NX; i++) {
            const double low = c->z[0][k][i], high = c->z[1][k][i], slack = (ROUND + stopset_model.rough) * fmax(fabs(low), fabs(high));
            lo[i] = stopset_model.position_only && i >= NJ ? -HUGE_VAL : low + w->sets.V_lo[i] - slack;
            hi[i] = stopset_model.position_only && i >= NJ ? HUGE_VAL : high + w->sets.V_hi[i] + slack;
        }
        hold(x, lo, hi, worst, joint);
    }
    return live;
}

static void launch(StopsetPast *c, const double x[NX], int good) {
    if (!good || (!stopset_model.sliding && c->next)) return;
    const int64_t row = (uint64_t)c->next++ % AGES;
    for (int i = 0; i < NX; i++) {
        c->z[0][row][i] = x[i] + stopset_model.X0_lo[i];
        c->z[1][row][i] = x[i] + stopset_model.X0_hi[i];
    }
    c->age[row] = 0;
}
#else
static int64_t place(int64_t step) { return (int64_t)((uint64_t)step % AGES); }

static void carry(StopsetPast *c, const StopsetWork *w, const double u[NJ]) {
    (void)w;
    memcpy(c->u[place(c->steps)], u, NJ * sizeof *u);
    memcpy(c->unsure[place(c->steps)], c->du, sizeof c->du);
    c->steps++;
}

/* Where a reading may be now, by the prediction of `age` steps ago. */
static void bounds(const StopsetPast *c, StopsetWork *w, int64_t age, double lo[NX], double hi[NX]) {
    const StopsetModel *m = &stopset_model;
    double path[AGES][NX], u[AGES][NJ], du[NJ] = {0}, set[6][NX];
    for (int64_t k = 0; k < age; k++) {
        const int64_t at = place(c->steps - age + k);
        memcpy(u[k], c->u[at], sizeof u[k]);
        for (int i = 0; i < NJ; i++) du[i] = fmax(du[i], c->unsure[at][i]);
    }
    /* sets are added with their ends rounded outward */
    for (int i = 0; i < NX; i++) {
        const Ends X0 = ends_out(m->X0_lo[i], m->X0_hi[i], 1), V = ends_out(m->V_lo[i], m->V_hi[i], 1);
        const Ends U = i < NJ ? ends_out(m->U_lo[i] - du[i], m->U_hi[i] + du[i], 1) : X0;
        const double ends[6] = {X0.lo, X0.hi, U.lo, U.hi, V.lo, V.hi};
        for (int k = 0; k < 6; k++) set[k][i] = ends[k];
    }
    const StopsetSets sets = {set[0], set[1], set[2], set[3], set[4], set[5], m->position_only};
    stopset_nominal(&w->dynamics, 1, age, c->x[place(c->steps - age)], u[0], m->dt, w->room, path[0]);
    stopset_ahead(&w->dynamics, &sets, age, path[0], u[0], m->dt, w->room, lo, hi);
}

/* Near ages at every step, of the old ones one in turn. */
static int compare(StopsetPast *c, StopsetWork *w, const double x[NX], double *worst, int32_t *joint) {
    const int64_t passed = c->steps < OLDEST ? c->steps : OLDEST;
    int64_t due[N_LOOKS], old[N_LOOKS];
    int near = 0, far = 0;
    for (int k = 0; k < (stopset_model.sliding ? N_LOOKS : 1); k++) {
        const int64_t age = stopset_model.sliding ? stopset_looks[k] : passed;
        if (age < 1 || age > passed || !c->starts[place(c->steps - age)]) continue;
        if (age > NEAR)
            old[far++] = age;
        else
            due[near++] = age;
    }
    c->turn++;
    if (far) due[near++] = old[(uint64_t)c->turn % (uint64_t)far];
    for (int k = 0; k < near; k++) {
        double lo[NX], hi[NX];
        bounds(c, w, due[k], lo, hi);
        hold(x, lo, hi, worst, joint);
    }
    return near;
}

static void launch(StopsetPast *c, const double x[NX], int good) {
    memcpy(c->x[place(c->steps)], x, NX * sizeof *x);
    c->starts[place(c->steps)] = (uint8_t)(good && (stopset_model.sliding || c->steps == 0));
}
#endif

/* A sample at a step of the grid: held against predictions of earlier steps, and kept for later ones. */
static int at_step(StopsetPast *c, StopsetWork *w, const double x[NX], int foreign, int32_t *joint) {
    double mean[NJ], worst = -1.0;
    if (c->samples) {
        for (int i = 0; i < NJ; i++) mean[i] = c->sum[i] / c->samples;
        carry(c, w, mean);
        c->samples = 0;
    }
    const int live = compare(c, w, x, &worst, joint), passed = worst >= 0.0;
    launch(c, x, !passed);
    return !live ? (c->known ? VERDICT_NONE : NOTHING_BEFORE) : passed ? VERDICT_VIOLATED : foreign ? VERDICT_NONE : VERDICT_CONFORMANT;
}

int stopset_sample_along(StopsetState *s, StopsetWork *w, int32_t every, int32_t *joint) {
    StopsetPast *c = &s->past;
    double x[NX], u[NJ], du[NJ];
    int verdict, foreign;
    if (c->every != every) stopset_forget(s);
    c->every = every;
    if (!stopset_take_sample(s, w, x, u, du, &foreign)) return VERDICT_NONE;
    if (c->known && c->samples < every) /* between two steps: that of the last one */
        verdict = c->said == VERDICT_CONFORMANT && !foreign ? VERDICT_CONFORMANT : VERDICT_NONE;
    else
        c->said = verdict = at_step(c, w, x, foreign, joint);
    for (int i = 0; i < NJ; i++) {
        c->sum[i] = c->samples ? c->sum[i] + u[i] : u[i];
        c->du[i] = c->samples ? fmax(c->du[i], du[i]) : du[i];
    }
    c->samples++;
    c->known = 1;
    return verdict;
}
#else
void stopset_own_start(StopsetState *s, const StopsetWork *w) { (void)s, (void)w; }
#endif
