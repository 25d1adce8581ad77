/* One instance of an identified arm: start values, the step, outputs, the verdict. */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

void stopset_defaults(StopsetState *s) {
    memset(s, 0, sizeof *s);
    memcpy(s->r, stopset_model.start_real, sizeof s->r);
    memcpy(s->i, stopset_model.start_int, sizeof s->i);
    memcpy(s->b, stopset_model.start_bool, sizeof s->b);
}

/* Whether bounds identified for the model still speak of the arm with these parameters. */
static int as_identified(const StopsetState *s) {
    const StopsetModel *m = &stopset_model;
    for (int v = VR_FIRST_PHYSICAL; v < VR_FIRST_PHYSICAL + N_PHYSICAL; v++)
        if (s->r[v] != m->start_real[v]) return 0;
    for (int r = 0; r < 3; r++) /* a load counts where the proofs have it */
        if (s->r[VR_PAYLOAD_MASS] != 0.0 && s->r[VR_PAYLOAD_COM + r] != m->start_real[VR_PAYLOAD_COM + r]) return 0;
    for (int i = 0; i < NJ && m->has_domain_temp; i++)
        if (!(s->r[VR_TEMP_LO + i] >= m->lo[3 * NJ + i] && s->r[VR_TEMP_HI + i] <= m->hi[3 * NJ + i])) return 0;
    if (!(s->r[VR_WARM] >= 0.0 && s->r[VR_WARM] <= 1.0)) return 0;
    if (!(s->r[VR_PAYLOAD_LO] >= m->payload_lo && s->r[VR_PAYLOAD_HI] <= m->payload_hi)) return 0;
    return s->r[VR_PAYLOAD_MASS] >= s->r[VR_PAYLOAD_LO] && s->r[VR_PAYLOAD_MASS] <= s->r[VR_PAYLOAD_HI];
}

const char *stopset_no_range(const StopsetState *s) {
    if (!(s->r[VR_PAYLOAD_LO] <= s->r[VR_PAYLOAD_HI])) return "payload_lo is above payload_hi; set payload_lo <= payload_hi [kg]";
    for (int i = 0; i < NJ && stopset_model.has_domain_temp; i++)
        if (!(s->r[VR_TEMP_LO + i] <= s->r[VR_TEMP_HI + i])) return "a temp_lo is above its temp_hi; set temp_lo <= temp_hi of every joint [degC]";
    return 0;
}

void stopset_retune(StopsetState *s) {
    s->as_identified = (uint8_t)as_identified(s);
    memset(s->certificate, 0, sizeof s->certificate);
    for (int i = 0; i < NX; i++) s->stop_lo[i] = s->stop_hi[i] = (double)NAN; /* nor of a stop that runs */
}

const char *stopset_setup(StopsetState *s, StopsetWork *w, double t0) {
    const StopsetModel *m = &stopset_model;
    for (int v = 0; v < N_REAL; v++) {
        int kind = m->kind[v];
        if ((kind == KIND_FIXED || kind == KIND_TUNABLE) && !stopset_finite(s->r[v]))
            return "a parameter is not a finite number; set all parameters to numbers";
    }
    const char *wrong = stopset_no_range(s);
    if (!wrong) wrong = stopset_prepare(s, w);
    if (wrong) return wrong;
    s->h_try = 0.0;
    s->r[VR_TIME] = s->start_time = s->tube_start = t0;
    for (int i = 0; i < NJ; i++) {
        s->r[VR_Q + i] = s->r[VR_Q_START + i];
        s->r[VR_DQ + i] = s->r[VR_DQ_START + i];
    }
    for (int k = 0; k < N_MEMORY; k++) s->r[VR_MEMORY + k] = s->r[VR_MEMORY_START + k];
    s->as_identified = (uint8_t)as_identified(s);
    s->violated = s->reloaded = s->ticked = 0;
    s->unsampled = 1;
    s->stopping = 0;
    s->length = m->dt;
    memset(s->certificate, 0, sizeof s->certificate);
    s->outputs_ready = 0;
    s->i[IX_VERDICT] = VERDICT_NONE;
    s->i[IX_VIOLATED_JOINT] = 0;
    stopset_own_start(s, w);
    stopset_forget(s);
    return 0;
}

void stopset_reload(StopsetState *s) {
    s->reloaded = 1;
    s->h_try = 0.0;
    stopset_forget(s);
}

/* Whether a state is measured: NaN is none, and exact zeros throughout are what an importer gives before anything is connected. */
static int sampled(const StopsetState *s) {
    int sound = s->b[IX_MEASURED], said = 0;
    for (int i = 0; i < NJ; i++) {
        const double q = s->r[VR_Q_MEASURED + i], dq = s->r[VR_DQ_MEASURED + i];
        sound = sound && stopset_finite(q) && stopset_finite(dq);
        said = said || q != 0.0 || dq != 0.0 || s->r[VR_TAU + i] != 0.0;
    }
    return sound && said;
}

static void begin_at_sample(StopsetState *s, StopsetWork *w) {
    if (!sampled(s) || stopset_prepare(s, w)) return;
    for (int i = 0; i < NJ; i++) {
        s->r[VR_Q + i] = s->r[VR_Q_MEASURED + i];
        s->r[VR_DQ + i] = s->r[VR_DQ_MEASURED + i];
    }
    s->tube_start = s->r[VR_TIME];
    s->reloaded = s->unsampled = 0;
    stopset_own_start(s, w);
    s->outputs_ready = 0;
}

void stopset_begin(StopsetState *s, StopsetWork *w) {
    if (s->unsampled && !s->stopping) begin_at_sample(s, w);
}

/* [s] that a prediction has bounds for at most: along a nominal motion no longer than that is kept. */
static double lasting(void) { return PATHS ? fmin(stopset_model.horizon, (AGES - 1) * stopset_model.dt) : stopset_model.horizon; }

void stopset_restart(StopsetState *s, StopsetWork *w, double ahead) {
    const double left = s->tube_start + lasting() - s->r[VR_TIME];
    const int over = s->b[IX_RESTART] && left < ahead - 1e-9 * stopset_model.dt;
    if ((over || s->reloaded) && !s->violated) begin_at_sample(s, w);
}

const char *stopset_trigger(StopsetState *s, StopsetWork *w) {
    const int request = s->i[IX_STOP] ? s->i[IX_STOP] : s->ticked;
    s->ticked = 0;
    if (!request || s->stopping) return 0;
    if (request == 1 && !stopset_model.has_brakes) return stopset_refusal;
    if (request >= 2 && stopset_model.ramp_timed && !(s->r[VR_STOP1_TIME] > 0.0)) return "stop1_time is not positive; set the ramp's length [s]";
    s->outputs_ready = 0;
    stopset_outputs(s, w);
    stopset_stop_request(s, w, request);
    memcpy(s->stop_q, &s->r[VR_Q], sizeof s->stop_q);
    memcpy(s->stop_dq, &s->r[VR_DQ], sizeof s->stop_dq);
    s->stop_start = s->r[VR_TIME];
    s->stopping = (uint8_t)request;
    s->h_try = 0.0;
    s->outputs_ready = 0;
    return 0;
}

#if !(CORNERS || PATHS)
/* The matrices of a step of h. */
static const double *step_of(StopsetWork *w, double h) {
    if (h == stopset_model.dt) return w->grid;
    if (w->h != h) stopset_linear_step(&w->linear, h, w->piece);
    w->h = h;
    return w->piece;
}
#endif

/* What a measured sample says: the monitor's cycle where samples come at the model's own step, and the unit's own prediction. */
static void look(StopsetState *s, StopsetWork *w, double h) {
    int32_t joint = 0;
    const StopsetModel *m = &stopset_model;
    const int32_t every = NONLINEAR && h > 1e-3 * m->dt && h < m->dt ? (int32_t)(m->dt / h + 0.5) : 1;
    const int watched = !m->timed && s->b[IX_MEASURED] && s->as_identified && !s->stopping && fabs(every * h - m->dt) <= 1e-9 * m->dt;
    /* between two steps of a nonlinear model's grid nothing was tested: its inputs are means over them */
    if (watched && every > 1 && !s->violated)
        s->i[IX_VERDICT] = VERDICT_NONE;
    else
        stopset_check(s, w);
    if (!watched) {
        stopset_forget(s);
        return;
    }
#if CORNERS || PATHS
    const int said = stopset_sample_along(s, w, every, &joint);
#else
    const int said = stopset_sample(s, w, &joint);
#endif
    if (s->violated || said == NOTHING_BEFORE) return;
    s->i[IX_VERDICT] = said;
    s->violated = said == VERDICT_VIOLATED;
    if (s->violated) s->i[IX_VIOLATED_JOINT] = joint;
}

void stopset_count(StopsetState *s) {
    for (int k = 0; k < N_STOPS; k++)
        if (s->certificate[k].steps < INT32_MAX) s->certificate[k].steps++;
}

const char *stopset_step(StopsetState *s, StopsetWork *w, double h, double *done) {
    *done = h;
    for (int i = 0; i < NJ; i++)
        if (!stopset_finite(s->r[VR_TAU + i])) return "a torque input is not a finite number; connect all tau inputs [N m]";
    const char *wrong = stopset_no_range(s);
    if (!wrong) wrong = stopset_prepare(s, w);
    if (wrong) return wrong;
    stopset_begin(s, w);
    look(s, w, h);
    if (!s->stopping) stopset_restart(s, w, h);
    wrong = stopset_trigger(s, w);
    if (wrong) return wrong;
    s->outputs_ready = 0;
    s->length = h;
    stopset_count(s);
    if (s->stopping >= 2) {
        const double rests = s->stop_start + stopset_ramp_length(s) - s->r[VR_TIME];
        double rest[NJ];
        if (w->ends_at_rest && rests > 1e-9 * h && rests < h) *done = rests;
        stopset_ramp_motion(s, s->r[VR_TIME] + *done - s->stop_start, &s->r[VR_Q], &s->r[VR_DQ], rest);
        return 0;
    }
    if (!stopset_exact(s)) {
        s->along = -1;
        return stopset_integrate(s, w, h, done);
    }
    double u[NJ];
    stopset_input(s, w, u);
#if CORNERS || PATHS
    stopset_own_step(s, w, u, h);
#else
    const double *step = step_of(w, h);
    double x[NX], after[NX], Bd[NX * NJ];
    memcpy(x, &s->r[VR_Q], NJ * sizeof *x);
    memcpy(x + NJ, &s->r[VR_DQ], NJ * sizeof *x);
    stopset_torque_part(step, Bd);
    stopset_stride(NJ, step, Bd, x, u, after);
    memcpy(&s->r[VR_Q], after, NJ * sizeof *x);
    memcpy(&s->r[VR_DQ], after + NJ, NJ * sizeof *x);
#endif
    stopset_memory_step(s, w, h);
    return 0;
}

/* Age of the prediction; the tube was tested up to the horizon (with half a grid step for rounding). */
static double age_of(const StopsetState *s) {
    double age = s->r[VR_TIME] - s->tube_start;
    return age > 0.0 ? age : 0.0;
}

/* The measured state where there is one: a prediction that runs away is what a verdict is for. */
static int inside_domain(const StopsetState *s) {
    const StopsetModel *m = &stopset_model;
    const double *qs = &s->r[s->b[IX_MEASURED] ? VR_Q_MEASURED : VR_Q], *dqs = &s->r[s->b[IX_MEASURED] ? VR_DQ_MEASURED : VR_DQ];
    for (int i = 0; i < NJ; i++) {
        double q = qs[i], dq = dqs[i], temp = s->r[VR_TEMP + i];
        if (!stopset_finite(s->r[VR_Q + i]) || !stopset_finite(s->r[VR_DQ + i])) return 0; /* no prediction, no bound */
        if (!(q >= m->lo[i] && q <= m->hi[i] && dq >= m->lo[NJ + i] && dq <= m->hi[NJ + i])) return 0;
        if (m->has_domain_temp && !(temp >= s->r[VR_TEMP_LO + i] && temp <= s->r[VR_TEMP_HI + i])) return 0;
    }
    return 1;
}

/* Whether the prediction is older than its sets were tested for. */
static int too_old(const StopsetState *s) { return !(age_of(s) <= stopset_model.horizon + 1e-9 * stopset_model.dt); }

#if !(CORNERS || PATHS)
/* The deviation tube at an age, exact between the steps of its grid too. */
static void tube(StopsetWork *w, double age, double lo[NX], double hi[NX]) {
    const double dt = stopset_model.dt;
    const int64_t k = (int64_t)floor(age / dt + 1e-9);
    const double rest = age - (double)k * dt;
    if (rest <= 1e-9 * dt) {
        memcpy(lo, w->lo[k], sizeof w->lo[k]);
        memcpy(hi, w->hi[k], sizeof w->hi[k]);
        return;
    }
    double step[STEP_ROOM], E[NX * NX], plus[NX * N_TORQUES], minus[NX * N_TORQUES];
    stopset_grow(w, k);
    memcpy(E, w->E, sizeof E);
    memcpy(plus, w->plus, sizeof plus);
    memcpy(minus, w->minus, sizeof minus);
    stopset_linear_step(&w->linear, rest, step);
    stopset_respond(&w->linear, rest, step, E, plus, minus, w->response);
    const StopsetResponses grown = {1, NX, NX, N_TORQUES, E, plus, minus};
    stopset_tubes(&grown, 0, &w->sets, lo, hi);
}
#endif

static void bounds(StopsetState *s, StopsetWork *w, double lo[NX], double hi[NX]) {
    if (too_old(s)) {
        for (int i = 0; i < NX; i++) lo[i] = hi[i] = (double)NAN;
        return;
    }
#if CORNERS || PATHS
    stopset_own_bounds(s, w, lo, hi);
#else
    tube(w, age_of(s), lo, hi);
    for (int i = 0; i < NX; i++) {
        double x = s->r[(i < NJ ? VR_Q : VR_DQ - NJ) + i];
        lo[i] += x;
        hi[i] += x;
    }
#endif
}

static int covered(const StopsetState *s) {
    if (NONLINEAR && (s->modes_by_events || s->along < 0)) return 0; /* such a set is stepped along the model's grid */
    return s->as_identified && !s->reloaded && !s->stopping && !too_old(s) && inside_domain(s) &&
           (!stopset_model.motor_torque || s->b[IX_MEASURED]);
}

void stopset_outputs(StopsetState *s, StopsetWork *w) {
    if (s->outputs_ready || stopset_prepare(s, w)) return;
    double lo[NX], hi[NX];
    if (s->stopping) {
        memcpy(lo, s->stop_lo, sizeof lo);
        memcpy(hi, s->stop_hi, sizeof hi);
    } else
        bounds(s, w, lo, hi);
    for (int i = 0; i < NJ; i++) {
        s->r[VR_Q_LO + i] = lo[i];
        s->r[VR_Q_HI + i] = hi[i];
        s->r[VR_DQ_LO + i] = lo[NJ + i];
        s->r[VR_DQ_HI + i] = hi[NJ + i];
    }
    s->r[VR_AGE] = age_of(s);
    s->b[IX_COVERED] = (uint8_t)covered(s);
    for (int i = 0; NONLINEAR && i < NX; i++) /* a motion beyond all numbers has no bounds along it */
        if (!(lo[i] <= hi[i])) s->b[IX_COVERED] = 0;
    stopset_accelerations(s, w, &s->r[VR_DDQ], &s->r[VR_MEMORY_RATE]);
#if N_INDICATOR
    stopset_indicators(s, w, &s->r[VR_INDICATOR]);
#endif
    s->i[IX_VERDICT] = s->violated ? VERDICT_VIOLATED : s->i[IX_VERDICT];
    s->b[IX_CONFORMANT] = s->i[IX_VERDICT] == VERDICT_CONFORMANT;
    s->outputs_ready = 1;
}

void stopset_check(StopsetState *s, StopsetWork *w) {
    if (s->violated) return; /* latched until reset: one sample outside is a refutation */
    const int seen = sampled(s) && covered(s);
    s->i[IX_VERDICT] = seen ? VERDICT_CONFORMANT : VERDICT_NONE;
    s->outputs_ready = 0;
    if (!seen || stopset_prepare(s, w)) return;
    double lo[NX], hi[NX];
    bounds(s, w, lo, hi);
    for (int i = 0; i < NX; i++) {
        double x = s->r[(i < NJ ? VR_Q_MEASURED : VR_DQ_MEASURED - NJ) + i];
        if (x >= lo[i] && x <= hi[i]) continue;
        s->violated = 1;
        s->i[IX_VERDICT] = VERDICT_VIOLATED;
        s->i[IX_VIOLATED_JOINT] = (i < NJ ? i : i - NJ) + 1;
        return;
    }
}
