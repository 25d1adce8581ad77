/* What follows from the parameters: the arm with its load, the laws on tape, the model's step, its tube at every age. */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

/* Gauss-Jordan with row pivots; returns 0 if singular. */
int stopset_invert(double X[NJ][NJ], double out[NJ][NJ]) {
    double A[NJ][2 * NJ];
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            A[r][c] = X[r][c];
            A[r][NJ + c] = r == c ? 1.0 : 0.0;
        }
    for (int c = 0; c < NJ; c++) {
        int best = c;
        for (int r = c + 1; r < NJ; r++)
            if (fabs(A[r][c]) > fabs(A[best][c])) best = r;
        if (!(fabs(A[best][c]) > 0.0)) return 0;
        for (int k = 0; k < 2 * NJ; k++) {
            double swap = A[c][k];
            A[c][k] = A[best][k];
            A[best][k] = swap;
        }
        double pivot = A[c][c];
        for (int k = 0; k < 2 * NJ; k++) A[c][k] /= pivot;
        for (int r = 0; r < NJ; r++) {
            if (r == c) continue;
            double f = A[r][c];
            if (f == 0.0) continue;
            for (int k = 0; k < 2 * NJ; k++) A[r][k] -= f * A[c][k];
        }
    }
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) out[r][c] = A[r][NJ + c];
    return 1;
}

/* The links with a point mass in the last one's frame. */
static void load(const StopsetState *s, StopsetWork *w) {
    const StopsetModel *m = &stopset_model;
    const double mass = s->r[VR_PAYLOAD_MASS], *c = &s->r[VR_PAYLOAD_COM];
    const StopsetArm arm = {NJ, &m->R[0][0][0], &m->p[0][0], &m->axis[0][0], m->gravity, w->pi[0]};
    double *P = w->pi[NJ - 1];
    memcpy(w->pi, m->pi, sizeof w->pi);
    P[0] += mass;
    for (int r = 0; r < 3; r++) P[1 + r] += mass * c[r];
    P[4] += mass * (c[1] * c[1] + c[2] * c[2]);
    P[5] -= mass * c[0] * c[1];
    P[6] += mass * (c[0] * c[0] + c[2] * c[2]);
    P[7] -= mass * c[0] * c[2];
    P[8] -= mass * c[1] * c[2];
    P[9] += mass * (c[0] * c[0] + c[1] * c[1]);
    w->map.arm = arm;
}

/* Inverse inertia with the parameters and the load, whose mass matrix at the posture of Minv is mass J'J. */
static const char *inertia(const StopsetState *s, StopsetWork *w) {
    const StopsetModel *m = &stopset_model;
    const double mass = s->r[VR_PAYLOAD_MASS];
    memcpy(w->Minv, m->Minv, sizeof w->Minv);
    if (!(mass >= 0.0) || !stopset_finite(mass)) return "payload_mass is not a mass; set a finite number >= 0 [kg]";
#if N_INERTIA
    for (int i = 0; i < NJ; i++) {
        double J = s->r[VR_INERTIA + i];
        if (!(J > 0.0) || !stopset_finite(J)) return "an inertia parameter is not positive; set a finite number > 0 [kg m^2]";
        if (J != m->start_real[VR_INERTIA + i]) w->Minv[i][i] = 1.0 / J;
    }
#endif
    if (!stopset_invert(w->Minv, w->M)) return "the inertia matrix is singular; set inertia parameters > 0";
    memset(w->carried_load, 0, sizeof w->carried_load);
    if (mass == 0.0) return 0;
    double at[3], J[3][NJ];
    stopset_point(&w->map.arm, m->q_a, NJ - 1, &s->r[VR_PAYLOAD_COM], at, J[0]);
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++)
            if (r == c || !m->decoupled) {
                w->carried_load[r][c] = mass * (J[0][r] * J[0][c] + J[1][r] * J[1][c] + J[2][r] * J[2][c]);
                w->M[r][c] += w->carried_load[r][c];
            }
    return stopset_invert(w->M, w->Minv) ? 0 : "the inertia with the payload is singular; set a finite centre of mass [m]";
}

static StopsetProgram program(const StopsetState *s, StopsetWork *w, int tape) {
    const StopsetTape *t = stopset_tapes + tape;
    const StopsetProgram out = {t->length, t->steps, w->numbers + t->numbers};
    (void)s;
#if N_EFFECT
    for (int k = 0; k < t->parameters; k++) w->numbers[t->numbers + k] = s->r[VR_EFFECT + t->parameter + k];
#endif
    return out;
}

/* The core's view of laws, compensation and the monitor's sample. */
static void laws(const StopsetState *s, StopsetWork *w) {
    static const double none[NJ] = {0};
    const StopsetModel *m = &stopset_model;
    memset(w->signals, 0, sizeof w->signals);
    memcpy(w->numbers, m->numbers, sizeof w->numbers);
    memcpy(w->offset, &s->r[VR_OFFSET], sizeof w->offset);
    for (int k = 0; k < N_LAWS; k++) {
        const StopsetPlace *p = m->place + k;
        const StopsetLaw law = {p->joint, p->other, p->memory, p->memories, program(s, w, p->tape)};
        w->law[k] = law;
    }
    for (int k = 0; k < N_MEMORY; k++) {
        w->carried[k].law = m->memory[k].law;
        w->carried[k].rate = program(s, w, m->memory[k].tape);
    }
    w->map.motor_torque = m->motor_torque;
    w->map.swift = m->swift;
    w->map.needs = m->needs;
    w->map.memories = N_MEMORY;
    w->map.laws = N_LAWS;
    w->map.law = w->law;
    w->map.gain = m->gain;
    w->map.offset = w->offset;
    w->map.standstill = m->standstill;
    w->map.reference_temperature = m->reference_temperature;
    const StopsetMonitor monitor = {&w->map, none, none, none, {s->r[VR_WARM], s->r[VR_WARM]}, 1, m->plain, m->dt, N_MEMORY, w->carried};
    w->monitor = monitor;
}

void stopset_grow(StopsetWork *w, int64_t k) {
    if (w->age < 0 || k < w->age) {
        memset(w->E, 0, sizeof w->E);
        memset(w->plus, 0, sizeof w->plus);
        memset(w->minus, 0, sizeof w->minus);
        for (int i = 0; i < NX; i++) w->E[i * NX + i] = 1.0;
        w->age = 0;
    }
    for (; w->age < k; w->age++) stopset_respond(&w->linear, stopset_model.dt, w->grid, w->E, w->plus, w->minus, w->response);
}

/* The step of the model's grid and the tube at every age, as identification and monitor have them. */
static void tube(const StopsetState *s, StopsetWork *w) {
    const StopsetModel *m = &stopset_model;
    const StopsetSets sets = {m->X0_lo, m->X0_hi, m->U_lo, m->U_hi, m->V_lo, m->V_hi, m->position_only};
    int keeps = m->decoupled && !m->generators;
    for (int i = 0; i < NJ; i++)
        for (int k = 0; k < NV; k++) w->viscous[i][k] = s->r[VR_VISCOUS + k * NJ + i];
    const StopsetDynamics dynamics = {NJ, KIND, NV, w->Minv[0], w->viscous[0], stopset_polynomials_of};
    w->dynamics = dynamics;
    w->sets = sets;
    if (NONLINEAR) return;
    for (int r = 0; r < NJ; r++) {
        for (int c = 0; c < NJ; c++) w->Av[r][c] = -w->Minv[r][c] * s->r[VR_VISCOUS + c];
        keeps = keeps && s->r[VR_VISCOUS + r] >= 0.0 && w->Minv[r][r] > 0.0;
    }
    const StopsetLinear linear = {NJ, NX, N_TORQUES, w->Av[0], w->Minv[0], m->generators ? m->across[0] : 0, 0, keeps};
    w->linear = linear;
    w->h = 0.0;
    stopset_linear_step(&w->linear, m->dt, w->grid);
    w->age = -1;
    /* H products of 2n + n terms each round by 2^-53 relative to states within a few turns, see stopset.monitor.watch */
    const double rounding = AGES * 3.0 * NJ * 0x1p-53 * 32.0;
    for (int k = 0; k < AGES; k++) {
        stopset_grow(w, k);
        const StopsetResponses grown = {1, NX, NX, N_TORQUES, w->E, w->plus, w->minus};
        stopset_tubes(&grown, 0, &w->sets, w->lo[k], w->hi[k]);
        for (int i = 0; i < NX; i++) {
            w->watch_lo[k][i] = w->lo[k][i] - rounding;
            w->watch_hi[k][i] = w->hi[k][i] + rounding;
        }
    }
    const StopsetPredictions tube = {.states = NX, .ages = AGES, .lo = w->watch_lo[0], .hi = w->watch_hi[0],
                                     .middle = w->watch_middle[0], .reach = w->watch_reach[0]};
    stopset_centre(&tube);
}

/* The joints' own torques are the first of the directions in which U acts. */
void stopset_torque_part(const double step[STEP_ROOM], double Bd[NX * NJ]) {
    for (int r = 0; r < NX; r++) memcpy(Bd + r * NJ, step + NX * NX + r * N_TORQUES, NJ * sizeof *Bd);
}

const char *stopset_prepare(const StopsetState *s, StopsetWork *w) {
    double key[N_KEY];
    memcpy(key, &s->r[VR_PAYLOAD_MASS], sizeof(double));
    memcpy(key + 1, &s->r[VR_PAYLOAD_COM], 3 * sizeof(double));
    memcpy(key + 4, &s->r[VR_WARM], sizeof(double));
    memcpy(key + 5, &s->r[VR_FIRST_PHYSICAL], N_PHYSICAL * sizeof(double));
    if (w->made && memcmp(key, w->key, sizeof key) == 0) return 0;
    w->made = w->sliding_made = 0;
    load(s, w);
    const char *wrong = inertia(s, w);
    if (wrong) return wrong;
    laws(s, w);
    tube(s, w);
    memcpy(w->key, key, sizeof key);
    w->made = 1;
    return 0;
}
