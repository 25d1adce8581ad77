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
    return s->r[VR_PAYLOAD_MASS] >= m->payload_lo && s->r[VR_PAYLOAD_MASS] <= m->payload_hi;
}

static const char *inertia(StopsetState *s) {
    const StopsetModel *m = &stopset_model;
    memcpy(s->Minv, m->Minv, sizeof s->Minv);
    double mass = s->r[VR_PAYLOAD_MASS];
    if (!(mass >= 0.0) || !stopset_finite(mass)) return "payload_mass is not a mass; set a finite number >= 0 [kg]";
    int changed = mass != 0.0;
#if N_INERTIA
    for (int i = 0; i < NJ; i++) {
        double J = s->r[VR_INERTIA + i];
        if (!(J > 0.0) || !stopset_finite(J)) return "an inertia parameter is not positive; set a finite number > 0 [kg m^2]";
        if (J != m->start_real[VR_INERTIA + i]) s->Minv[i][i] = 1.0 / J;
    }
#endif
    if (!stopset_invert(s->Minv, s->M)) return "the inertia matrix is singular; set inertia parameters > 0";
    if (changed) {
        double load[NJ][NJ];
        stopset_point_mass(mass, &s->r[VR_PAYLOAD_COM], m->q_a, load);
        for (int r = 0; r < NJ; r++)
            for (int c = 0; c < NJ; c++)
                if (r == c || !m->decoupled) s->M[r][c] += load[r][c];
        if (!stopset_invert(s->M, s->Minv)) return "the inertia with the payload is singular; set a finite centre of mass [m]";
    }
    return 0;
}

const char *stopset_setup(StopsetState *s, double t0) {
    const StopsetModel *m = &stopset_model;
    for (int v = 0; v < N_REAL; v++) {
        int kind = m->kind[v];
        if ((kind == KIND_FIXED || kind == KIND_TUNABLE) && !stopset_finite(s->r[v]))
            return "a parameter is not a finite number; set all parameters to numbers";
    }
    const char *wrong = inertia(s);
    if (wrong) return wrong;
    double magnitude[NJ][NJ];
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            s->Av[r][c] = -s->Minv[r][c] * s->r[VR_VISCOUS + c];
            magnitude[r][c] = fabs(s->Av[r][c]);
        }
    StopsetStep envelope;
    stopset_phi(magnitude, m->dt, &envelope);
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            s->growth_q[r][c] = envelope.F[r][c];
            s->growth_v[r][c] = 0.0;
            for (int k = 0; k < NJ; k++) s->growth_v[r][c] += magnitude[r][k] * envelope.F[k][c];
        }
    stopset_phi(s->Av, m->dt, &s->grid);
    s->step.h = 0.0;
    s->h_try = 0.0;
    stopset_tube_reset(s);
    s->r[VR_TIME] = s->start_time = s->tube_start = t0;
    for (int i = 0; i < NJ; i++) {
        s->r[VR_Q + i] = s->r[VR_Q_START + i];
        s->r[VR_DQ + i] = s->r[VR_DQ_START + i];
    }
    for (int k = 0; k < N_MEMORY; k++) s->r[VR_MEMORY + k] = s->r[VR_MEMORY_START + k];
    s->as_identified = (uint8_t)as_identified(s);
    s->violated = 0;
    s->stopping = 0;
    s->length = m->dt;
    memset(&s->certificate, 0, sizeof s->certificate);
    s->outputs_ready = 0;
    s->i[IX_VERDICT] = VERDICT_NONE;
    s->i[IX_VIOLATED_JOINT] = 0;
    stopset_motion_reset(s);
    return 0;
}

int stopset_restart(StopsetState *s, double ahead) {
    double left = s->tube_start + stopset_model.horizon - s->r[VR_TIME];
    if (!s->b[IX_RESTART] || !s->b[IX_MEASURED] || s->violated || left >= ahead + 1e-9 * stopset_model.dt) return 0;
    for (int i = 0; i < NJ; i++) {
        if (!stopset_finite(s->r[VR_Q_MEASURED + i]) || !stopset_finite(s->r[VR_DQ_MEASURED + i])) return 0;
    }
    for (int i = 0; i < NJ; i++) {
        s->r[VR_Q + i] = s->r[VR_Q_MEASURED + i];
        s->r[VR_DQ + i] = s->r[VR_DQ_MEASURED + i];
    }
    s->tube_start = s->r[VR_TIME];
    stopset_tube_reset(s);
    stopset_motion_reset(s);
    s->outputs_ready = 0;
    return 1;
}

const char *stopset_trigger(StopsetState *s, double *work) {
    if (!s->i[IX_STOP] || s->stopping) return 0;
    if (s->i[IX_STOP] == 1 && !stopset_model.has_brakes) return stopset_refusal;
    if (s->i[IX_STOP] == 2 && !(s->r[VR_STOP1_TIME] > 0.0)) return "stop1_time is not positive; set the ramp's length [s]";
    s->outputs_ready = 0;
    stopset_outputs(s);
    stopset_stop_request(s, work);
    memcpy(s->stop_q, &s->r[VR_Q], sizeof s->stop_q);
    memcpy(s->stop_dq, &s->r[VR_DQ], sizeof s->stop_dq);
    s->stop_start = s->r[VR_TIME];
    s->stopping = (uint8_t)s->i[IX_STOP];
    s->h_try = 0.0;
    s->outputs_ready = 0;
    return 0;
}

/* STOP 1: every joint ramps to rest in the same time, then holds. */
static void ramp(StopsetState *s, double t) {
    double T = s->r[VR_STOP1_TIME], x = fmin(fmax(t - s->stop_start, 0.0), T);
    for (int i = 0; i < NJ; i++) {
        s->r[VR_Q + i] = s->stop_q[i] + s->stop_dq[i] * (x - 0.5 * x * x / T);
        s->r[VR_DQ + i] = s->stop_dq[i] * (1.0 - x / T);
    }
}

const char *stopset_step(StopsetState *s, double h, double *work) {
    for (int i = 0; i < NJ; i++)
        if (!stopset_finite(s->r[VR_TAU + i])) return "a torque input is not a finite number; connect all tau inputs [N m]";
    stopset_check(s);
    if (!s->stopping) stopset_restart(s, h);
    const char *wrong = stopset_trigger(s, work);
    if (wrong) return wrong;
    s->outputs_ready = 0;
    s->length = h;
    if (s->certificate.steps < INT32_MAX) s->certificate.steps++;
    if (s->stopping == 2) {
        ramp(s, s->r[VR_TIME] + h);
        return 0;
    }
    if (!stopset_exact(s)) return stopset_integrate(s, h);
    if (s->step.h != h) stopset_phi(s->Av, h, &s->step);
    double u[NJ], push[NJ], q[NJ], dq[NJ];
    stopset_input(s, u);
    for (int r = 0; r < NJ; r++) {
        push[r] = 0.0;
        for (int c = 0; c < NJ; c++) push[r] += s->Minv[r][c] * u[c];
    }
    for (int r = 0; r < NJ; r++) {
        q[r] = s->r[VR_Q + r];
        dq[r] = 0.0;
        for (int c = 0; c < NJ; c++) {
            q[r] += s->step.G[r][c] * s->r[VR_DQ + c] + s->step.H[r][c] * push[c];
            dq[r] += s->step.F[r][c] * s->r[VR_DQ + c] + s->step.G[r][c] * push[c];
        }
    }
    memcpy(&s->r[VR_Q], q, sizeof q);
    memcpy(&s->r[VR_DQ], dq, sizeof dq);
    stopset_memory_step(s, h);
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
        if (!(q >= m->q_lo[i] && q <= m->q_hi[i] && dq >= m->dq_lo[i] && dq <= m->dq_hi[i])) return 0;
        if (m->has_domain_temp && !(temp >= m->temp_lo[i] && temp <= m->temp_hi[i])) return 0;
    }
    return 1;
}

/* Whether the prediction is older than its sets were tested for. */
static int too_old(const StopsetState *s) { return !(age_of(s) <= stopset_model.horizon + 1e-9 * stopset_model.dt); }

static void bounds(StopsetState *s, double lo[NX], double hi[NX]) {
    double age = age_of(s);
    if (too_old(s)) {
        for (int i = 0; i < NX; i++) lo[i] = hi[i] = (double)NAN;
        return;
    }
    if (NV > 1)
        stopset_corner_tube(s, lo, hi);
    else
        stopset_tube(s, age, lo, hi);
    for (int i = 0; i < NX; i++) {
        double x = s->r[(i < NJ ? VR_Q : VR_DQ - NJ) + i];
        lo[i] += x;
        hi[i] += x;
    }
}

static int covered(const StopsetState *s) {
    if (NV > 1 && s->modes_by_events) return 0; /* corner trajectories are integrated in co-simulation only */
    return s->as_identified && !s->stopping && !too_old(s) && inside_domain(s) &&
           (!stopset_model.motor_torque || s->b[IX_MEASURED]);
}

void stopset_outputs(StopsetState *s) {
    if (s->outputs_ready) return;
    double lo[NX], hi[NX];
    if (s->stopping) {
        memcpy(lo, s->stop_lo, sizeof lo);
        memcpy(hi, s->stop_hi, sizeof hi);
    } else
        bounds(s, lo, hi);
    for (int i = 0; i < NJ; i++) {
        s->r[VR_Q_LO + i] = lo[i];
        s->r[VR_Q_HI + i] = hi[i];
        s->r[VR_DQ_LO + i] = lo[NJ + i];
        s->r[VR_DQ_HI + i] = hi[NJ + i];
    }
    s->r[VR_AGE] = age_of(s);
    s->b[IX_COVERED] = (uint8_t)covered(s);
    stopset_accelerations(s, &s->r[VR_DDQ], &s->r[VR_MEMORY_RATE]);
#if N_INDICATOR
    stopset_indicators(s, &s->r[VR_INDICATOR]);
#endif
    s->i[IX_VERDICT] = s->violated ? VERDICT_VIOLATED : s->i[IX_VERDICT];
    s->b[IX_CONFORMANT] = s->i[IX_VERDICT] == VERDICT_CONFORMANT;
    s->outputs_ready = 1;
}

void stopset_check(StopsetState *s) {
    if (s->violated) return; /* latched until reset: one sample outside is a refutation */
    int seen = s->b[IX_MEASURED] && covered(s);
    for (int i = 0; i < NJ; i++) seen = seen && stopset_finite(s->r[VR_Q_MEASURED + i]) && stopset_finite(s->r[VR_DQ_MEASURED + i]);
    s->i[IX_VERDICT] = seen ? VERDICT_CONFORMANT : VERDICT_NONE;
    s->outputs_ready = 0;
    if (!seen) return;
    double lo[NX], hi[NX];
    bounds(s, lo, hi);
    for (int i = 0; i < NX; i++) {
        double x = s->r[(i < NJ ? VR_Q_MEASURED : VR_DQ_MEASURED - NJ) + i];
        if (x >= lo[i] && x <= hi[i]) continue;
        s->violated = 1;
        s->i[IX_VERDICT] = VERDICT_VIOLATED;
        s->i[IX_VIOLATED_JOINT] = (i < NJ ? i : i - NJ) + 1;
        return;
    }
}
