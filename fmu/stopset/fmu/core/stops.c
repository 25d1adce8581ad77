/* When a stop is bounded, for which states that serves, and what the outputs say. The proofs are the core's: core/stops.
 *
 * The stop begins at the measured state where one is connected, else at the unit's own: it then is the arm. Asked for exactly
 * (by `evaluate_stop`, a stop request, or with `stop_every` 1) a bound holds for this state; else, every so many steps, for a box
 * of states around where the motion leads until the next one, and serves as long as the state lies in it.
 */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

/* Noise of a measured speed and of accelerations [rad/s], of an angle [rad]: the monitor's, see stopset.monitor.stopdesk. */
static const double SPARE_SPEED = 0.04, SPARE_ANGLE = 5e-4;

static const double *state_of(const StopsetState *s, int speeds) {
    if (s->b[IX_MEASURED]) return &s->r[speeds ? VR_DQ_MEASURED : VR_Q_MEASURED];
    return &s->r[speeds ? VR_DQ : VR_Q];
}

/* Whether the model speaks of this state at all: domain, load, parameters, and nothing has refuted it. */
static int believed(const StopsetState *s) {
    const StopsetModel *m = &stopset_model;
    const double *q = state_of(s, 0), *dq = state_of(s, 1);
    if (!m->has_brakes || !s->as_identified || s->violated || stopset_no_range(s)) return 0;
    for (int i = 0; i < NJ; i++) {
        const double temp = s->r[VR_TEMP + i];
        if (!(q[i] >= m->stop_q_lo[i] && q[i] <= m->stop_q_hi[i] && dq[i] >= m->stop_dq_lo[i] && dq[i] <= m->stop_dq_hi[i])) return 0;
        if (m->has_domain_temp && !(temp >= s->r[VR_TEMP_LO + i] && temp <= s->r[VR_TEMP_HI + i])) return 0;
    }
    return 1;
}

static int inside(const StopsetState *s, int category) {
    const StopsetCertificate *c = &s->certificate[category];
    const double *q = state_of(s, 0), *dq = state_of(s, 1);
    if (!c->made) return 0;
#if HAS_PATH
    if (category == STOP_PATH && !(c->row == s->r[VR_PATH_ROW] && c->rate == s->r[VR_PATH_RATE])) return 0;
#endif
    for (int i = 0; i < NJ; i++)
        if (!(fabs(q[i] - c->q[i]) <= c->q_radius[i] && fabs(dq[i] - c->dq[i]) <= c->dq_radius[i])) return 0;
    return 1;
}

static int due(const StopsetState *s, int category, int exact) {
    const StopsetCertificate *c = &s->certificate[category];
    if (exact) return !(c->exact && inside(s, category));
    return s->i[IX_STOP_EVERY] > 0 && (!c->made || c->steps >= s->i[IX_STOP_EVERY]);
}

/* The states of the next certificate: this one, or all that the motion of the next steps leads through. */
static void box(const StopsetState *s, int exact, StopsetCertificate *c) {
    const double ahead = exact ? 0.0 : s->i[IX_STOP_EVERY] * s->length;
    const double *q = state_of(s, 0), *dq = state_of(s, 1);
    for (int i = 0; i < NJ; i++) {
        const double a = s->r[VR_DDQ + i];
        c->q[i] = q[i];
        c->dq[i] = dq[i];
        c->q_radius[i] = c->dq_radius[i] = 0.0;
        if (exact) continue;
        c->dq[i] = dq[i] + 0.5 * ahead * a;
        c->q[i] = q[i] + 0.5 * ahead * c->dq[i];
        c->dq_radius[i] = 0.65 * ahead * fabs(a) + SPARE_SPEED;
        c->q_radius[i] = 0.55 * ahead * fabs(c->dq[i]) + 0.5 * ahead * c->dq_radius[i] + SPARE_ANGLE;
    }
}

#if HAS_PATH
/* A path stop begins where the path is, no farther from this state than a reading of an arm on it can be. */
static int on_the_path(const StopsetState *s, const StopsetPassed *p) {
    const double *q = state_of(s, 0), *dq = state_of(s, 1);
    for (int i = 0; i < NJ; i++) {
        const double near = stopset_ramp.q_error[i] + stopset_path.noise[i], close = stopset_ramp.dq_error[i] + stopset_path.noise[NJ + i];
        const double true_q = q[i] + stopset_model.truth_centre[i];
        if (!(fabs(true_q - p->q[i]) <= near && fabs(dq[i] - p->dq[i]) <= close)) return 0;
    }
    return 1;
}

/* Its ways count from where the path is, not from this state. */
static int bounded_on_path(const StopsetState *s, StopsetWork *w, const StopsetStops *stops, const StopsetBound *out, double *begin) {
    StopsetPassed passed;
    const StopsetRequest request = {s->r[VR_PATH_ROW], s->r[VR_PATH_RATE]};
    if (stopset_path_stop(stops, &stopset_ramp, &stopset_path, &request, w->proof, &passed, out) != STOPSET_OK) return 0;
    for (int i = 0; i < NJ; i++) begin[i] = passed.q[i] - stopset_model.truth_centre[i];
    return on_the_path(s, &passed);
}
#endif

#if N_STOPS > 1
/* The model's ramp, with what the parameters say happens if it fails. */
static StopsetRamp ramp_of(const StopsetState *s) {
    StopsetRamp out = stopset_ramp;
    out.off_after = s->r[VR_SS1_OFF_AFTER];
    out.monitored = s->b[IX_SS1_MONITORED];
    return out;
}
#endif

/* What bounds a stop with any payload of the range that is given: of the arm's own links only the last one carries it. */
static StopsetStops carrying(const StopsetState *s, double pi[NJ][10], double half[NJ][10]) {
    const StopsetModel *m = &stopset_model;
    const double lo = s->r[VR_PAYLOAD_LO], hi = s->r[VR_PAYLOAD_HI], middle = 0.5 * (lo + hi), off = 0.5 * (hi - lo) + m->stop_weighed;
    StopsetStops out = stopset_stops;
    memcpy(pi, m->pi, sizeof m->pi);
    memset(half, 0, sizeof m->pi);
    for (int k = 0; k < 10; k++) {
        pi[NJ - 1][k] = m->pi[NJ - 1][k] + middle * m->stop_per_kg[k];
        half[NJ - 1][k] = off * m->stop_per_kg[k];
    }
    out.plant.arm.pi = pi[0];
    out.plant.pi_half = half[0];
    out.ranged = stopset_payloads(lo, hi);
    return out;
}

static int bounded(const StopsetState *s, StopsetWork *w, int category, const StopsetStates *from, const StopsetBound *out, double *begin) {
    double pi[NJ][10], half[NJ][10];
    const StopsetStops stops = carrying(s, pi, half);
#if HAS_PATH
    if (category == STOP_PATH) return bounded_on_path(s, w, &stops, out, begin);
#else
    (void)begin;
#endif
    if (category == STOP_0) return stopset_power_off(&stops, from, w->proof, out) == STOPSET_OK;
#if N_STOPS > 1
    const StopsetRamp ramp = ramp_of(s);
    if (category == STOP_1_FAILED) return stopset_failed_ramp(&stops, &ramp, from, w->proof, out) == STOPSET_OK;
    return stopset_working_ramp(&stops, &ramp, category == STOP_2, from, w->proof, out) == STOPSET_OK;
#else
    return 0;
#endif
}

/* From a measured state to what the stop starts from: centre, then radius, (NX,) each. */
static const double *start_of(int category, int radius) {
    const StopsetModel *m = &stopset_model;
    if (category == STOP_0) return radius ? m->stop_radius : m->stop_centre;
    return radius ? m->truth_radius : m->truth_centre;
}

static void certify(StopsetState *s, StopsetWork *w, int category, int exact) {
    StopsetCertificate *c = &s->certificate[category];
    const StopsetBound out = {c->time, c->forward, c->back, c->speed, c->tool};
    const double *centre = start_of(category, 0), *radius = start_of(category, 1);
    double q[NJ], dq[NJ], rq[NJ], rdq[NJ];
    const StopsetStates from = {q, dq, rq, rdq};
    box(s, exact || category == STOP_PATH, c); /* on a path there is no box: the bound is that of its row */
    for (int i = 0; i < NJ; i++) {
        q[i] = c->q[i] + centre[i];
        dq[i] = c->dq[i] + centre[NJ + i];
        c->begin[i] = c->q[i];
        rq[i] = radius[i] + c->q_radius[i];
        rdq[i] = radius[NJ + i] + c->dq_radius[i];
    }
#if HAS_PATH
    c->row = s->r[VR_PATH_ROW];
    c->rate = s->r[VR_PATH_RATE];
#endif
    c->proved = (uint8_t)bounded(s, w, category, &from, &out, c->begin);
    c->made = 1;
    c->exact = (uint8_t)exact;
    c->at = s->r[VR_TIME];
    c->steps = 0;
}

/* Where the outputs of a category begin: per joint time, angle, forward, back, then of the tool distance and speed, then the age. */
static const unsigned first_of[] = {VR_STOP_TIME, VR_STOP1_NOMINAL_TIME, VR_STOP1_GUARANTEED_TIME, VR_STOP2_TIME, VR_PATH_STOP_TIME};
static const unsigned flag_of[] = {IX_STOP_CERTIFIED, IX_STOP1_NOMINAL_CERTIFIED, IX_STOP1_GUARANTEED_CERTIFIED, IX_STOP2_CERTIFIED,
                                   IX_PATH_STOP_CERTIFIED};
static const unsigned struck_of[] = {IX_STOP_END_STOP, IX_STOP1_NOMINAL_END_STOP, IX_STOP1_GUARANTEED_END_STOP, IX_STOP2_END_STOP,
                                     IX_PATH_STOP_END_STOP};

int stopset_stop_output(unsigned real) {
    for (int k = 0; k < N_STOPS; k++)
        if (real >= first_of[k] && real < first_of[k] + 4 * NJ + 3) return k;
    return -1;
}

int stopset_stop_flag(unsigned boolean) {
    for (int k = 0; k < N_STOPS; k++)
        if (boolean == flag_of[k] || boolean == struck_of[k]) return k;
    return -1;
}

/* Whether the bound leads a joint to the end of its range, from any state of the box: as StopBounds of stopset.reach.stops.bounds says. */
static int strikes(const StopsetCertificate *c) {
    const StopsetModel *m = &stopset_model;
    int out = 0;
    for (int i = 0; i < NJ; i++) {
        const double off = c->q_radius[i] + fmax(fabs(m->noise_lo[i]), fabs(m->noise_hi[i]));
        out |= (c->begin[i] + off + c->forward[i] > m->range_hi[i]) | (c->begin[i] - off - c->back[i] < m->range_lo[i]);
    }
    return out;
}

/* The outputs of a category, from its certificate where that proves the present state's stop. */
static void publish(StopsetState *s, int category, int proved) {
    const StopsetCertificate *c = &s->certificate[category];
    double *out = &s->r[first_of[category]];
    for (int i = 0; i < NJ; i++) {
        out[i] = proved ? c->time[i] : (double)NAN;
        out[NJ + i] = proved ? fmax(c->forward[i], c->back[i]) : (double)NAN;
        out[2 * NJ + i] = proved ? c->forward[i] : (double)NAN;
        out[3 * NJ + i] = proved ? c->back[i] : (double)NAN;
    }
    out[4 * NJ] = proved ? c->tool[0] : (double)NAN;
    out[4 * NJ + 1] = proved ? c->tool[1] : (double)NAN;
    out[4 * NJ + 2] = proved ? s->r[VR_TIME] - c->at : (double)NAN;
    s->b[flag_of[category]] = (uint8_t)proved;
    s->b[struck_of[category]] = (uint8_t)(proved && strikes(c));
}

/* Which categories speak of the stop that is asked for: 1 STOP 0, 2 STOP 1, working and failing, 3 STOP 2. */
static int of_request(int category, int request) {
    return request == 1 ? category == STOP_0 : request == 2 ? category == STOP_1 || category == STOP_1_FAILED : category == STOP_2; /* a path is not what a request follows */
}

void stopset_stop_bounds(StopsetState *s, StopsetWork *w, int category, int exact) {
    if (s->stopping) { /* the bounds are those of the request */
        publish(s, category, of_request(category, s->stopping) && s->b[flag_of[category]] && s->certificate[category].proved);
        return;
    }
    /* another ramp than the identified one is another controller */
    const int speaks = believed(s) && (category == STOP_0 || category == STOP_PATH || s->r[VR_STOP1_TIME] == stopset_model.start_real[VR_STOP1_TIME]);
    exact = exact || s->b[IX_EVALUATE_STOP] || s->i[IX_STOP_EVERY] == 1;
    if (speaks && due(s, category, exact)) certify(s, w, category, exact);
    publish(s, category, speaks && inside(s, category) && s->certificate[category].proved);
}

void stopset_stop_request(StopsetState *s, StopsetWork *w, int request) {
    const StopsetModel *m = &stopset_model;
    const int category = request == 1 ? STOP_0 : request == 2 ? STOP_1 : STOP_2;
    const double *q = state_of(s, 0);
    int known = 0;
    for (int k = 0; k < N_STOPS; k++) {
        if (of_request(k, request))
            stopset_stop_bounds(s, w, k, 1);
        else
            publish(s, k, 0);
        if (k == category) known = s->b[flag_of[k]];
    }
    const double *centre = start_of(category, 0), *radius = start_of(category, 1);
    const StopsetCertificate *c = &s->certificate[known ? category : STOP_0];
    for (int i = 0; i < NJ; i++) { /* where readings can be from now on: the true state, moved, and read again */
        const double lo = centre[i] - radius[i] + m->noise_lo[i], hi = centre[i] + radius[i] + m->noise_hi[i];
        s->stop_lo[i] = known ? q[i] + lo - c->back[i] : (double)NAN;
        s->stop_hi[i] = known ? q[i] + hi + c->forward[i] : (double)NAN;
        s->stop_lo[NJ + i] = known ? m->noise_lo[NJ + i] - c->speed[i] : (double)NAN;
        s->stop_hi[NJ + i] = known ? m->noise_hi[NJ + i] + c->speed[i] : (double)NAN;
    }
}
