/* When a stop is bounded, for which states that serves, and what the outputs say. The proof is the core's: core/stops.
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
    if (!m->has_brakes || !s->as_identified || s->violated) return 0;
    if (!(s->r[VR_WARM] >= 0.0 && s->r[VR_WARM] <= 1.0)) return 0;
    for (int i = 0; i < NJ; i++) {
        const double temp = s->r[VR_TEMP + i];
        if (!(q[i] >= m->stop_q_lo[i] && q[i] <= m->stop_q_hi[i] && dq[i] >= m->stop_dq_lo[i] && dq[i] <= m->stop_dq_hi[i])) return 0;
        if (m->has_domain_temp && !(temp >= m->lo[3 * NJ + i] && temp <= m->hi[3 * NJ + i])) return 0;
    }
    return 1;
}

static int inside(const StopsetState *s) {
    const StopsetCertificate *c = &s->certificate;
    const double *q = state_of(s, 0), *dq = state_of(s, 1);
    if (!c->made) return 0;
    for (int i = 0; i < NJ; i++)
        if (!(fabs(q[i] - c->q[i]) <= c->q_radius[i] && fabs(dq[i] - c->dq[i]) <= c->dq_radius[i])) return 0;
    return 1;
}

static int due(const StopsetState *s, int exact) {
    const StopsetCertificate *c = &s->certificate;
    if (exact) return !(c->exact && inside(s));
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

static void certify(StopsetState *s, StopsetWork *w, int exact) {
    const StopsetModel *m = &stopset_model;
    StopsetCertificate *c = &s->certificate;
    const StopsetBound out = {c->time, c->forward, c->back, c->speed, c->tool};
    double q[NJ], dq[NJ], rq[NJ], rdq[NJ];
    box(s, exact, c);
    for (int i = 0; i < NJ; i++) { /* from the measured state to what the stop starts from */
        q[i] = c->q[i] + m->stop_centre[i];
        dq[i] = c->dq[i] + m->stop_centre[NJ + i];
        rq[i] = m->stop_radius[i] + c->q_radius[i];
        rdq[i] = m->stop_radius[NJ + i] + c->dq_radius[i];
    }
    c->proved = (uint8_t)(stopset_power_off(&stopset_stops, q, dq, rq, rdq, w->proof, &out) == STOPSET_OK);
    c->made = 1;
    c->exact = (uint8_t)exact;
    c->at = s->r[VR_TIME];
    c->steps = 0;
}

/* The stop outputs, from the certificate where that proves the present state's stop. */
static void tell(StopsetState *s, int proved) {
    const StopsetCertificate *c = &s->certificate;
    for (int i = 0; i < NJ; i++) {
        s->r[VR_STOP_TIME + i] = proved ? c->time[i] : (double)NAN;
        s->r[VR_STOP_FORWARD + i] = proved ? c->forward[i] : (double)NAN;
        s->r[VR_STOP_BACK + i] = proved ? c->back[i] : (double)NAN;
        s->r[VR_STOP_ANGLE + i] = proved ? fmax(c->forward[i], c->back[i]) : (double)NAN;
    }
    s->r[VR_TCP_STOP_DISTANCE] = proved ? c->tool[0] : (double)NAN;
    s->r[VR_TCP_STOP_SPEED] = proved ? c->tool[1] : (double)NAN;
    s->r[VR_STOP_AGE] = proved ? s->r[VR_TIME] - c->at : (double)NAN;
    s->b[IX_STOP_CERTIFIED] = (uint8_t)proved;
}

void stopset_stop_bounds(StopsetState *s, StopsetWork *w, int exact) {
    if (s->stopping) { /* the bounds are those of the request */
        tell(s, s->b[IX_STOP_CERTIFIED]);
        return;
    }
    const int speaks = believed(s);
    exact = exact || s->b[IX_EVALUATE_STOP] || s->i[IX_STOP_EVERY] == 1;
    if (speaks && due(s, exact)) certify(s, w, exact);
    tell(s, speaks && inside(s) && s->certificate.proved);
}

void stopset_stop_request(StopsetState *s, StopsetWork *w) {
    const StopsetModel *m = &stopset_model;
    const StopsetCertificate *c = &s->certificate;
    const double *q = state_of(s, 0);
    if (s->i[IX_STOP] == 1)
        stopset_stop_bounds(s, w, 1);
    else
        tell(s, 0); /* nothing is proved of a ramp */
    const int known = s->b[IX_STOP_CERTIFIED];
    for (int i = 0; i < NJ; i++) { /* where readings can be from now on: the true state, moved, and read again */
        const double lo = m->stop_centre[i] - m->stop_radius[i] + m->noise_lo[i], hi = m->stop_centre[i] + m->stop_radius[i] + m->noise_hi[i];
        s->stop_lo[i] = known ? q[i] + lo - c->back[i] : (double)NAN;
        s->stop_hi[i] = known ? q[i] + hi + c->forward[i] : (double)NAN;
        s->stop_lo[NJ + i] = known ? m->noise_lo[NJ + i] - c->speed[i] : (double)NAN;
        s->stop_hi[NJ + i] = known ? m->noise_hi[NJ + i] + c->speed[i] : (double)NAN;
    }
}
