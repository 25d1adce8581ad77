/* Motion that has no closed form: friction polynomials, effects at the simulated state, sticking joints.
 *
 * Dormand and Prince's method of order 8(5,3), local error (root mean square) below TOLERANCE per step: a communication step of some
 * milliseconds mostly is one step. Friction that depends on the direction of motion is set-valued: each joint slides up, slides down or
 * sticks, and every change is located in time by bisection, so the order of the method survives it. Source: Hairer, Norsett & Wanner,
 * Solving Ordinary Differential Equations I, II.5 and II.10; Filippov (1988) for the sticking.
 */
#include <math.h>
#include <string.h>

#include "runge_kutta.h"
#include "stopset_core.h"

enum { YM = NX, NY = YM + N_MEMORY }; /* what the effects remember comes last */

static const double TOLERANCE = 1e-12; /* rad and rad/s, per step */
static const double REST = 1e-15;      /* rad/s: below, a joint has come to rest */
static const int EVENTS = 2000;        /* sticking and sliding changes within one communication step */
static const int MOST_STEPS = 20000;       /* of the integrator within one communication step */

/* Whether friction depends on the direction of motion now. */
static int directional(const StopsetState *s) { return HAS_DIRECTION || s->stopping == 1; }

int stopset_exact(const StopsetState *s) {
    if (s->stopping) return 0;
    return (!stopset_model.motor_torque && !N_LAWS) || s->b[IX_MEASURED];
}

/* A state at time t as the core takes it: q, dq (NJ,), what is remembered (N_MEMORY,). The unit begins where a recording begins. */
static StopsetSamples sample_of(const StopsetState *s, StopsetWork *w, double t, const double *q, const double *dq, const double *memory) {
    const StopsetSamples out = {q, dq, &s->r[VR_TAU], &s->r[VR_TEMP], 0, &w->since, memory, s->r[VR_WARM]};
    w->since = t - s->start_time;
    return out;
}

/* Gravity torque, and Coriolis and centrifugal torque where the model takes that off too; what laws look at is there already. */
static void rigid_at(const StopsetWork *w, const double *q, const double *dq, double out[NJ]) {
    static const double rest[NJ] = {0};
    const int needs = w->map.needs;
    if (stopset_model.swift && !(needs & STOPSET_NEEDS_LINK))
        stopset_torques(&w->map.arm, 1, q, dq, rest, out);
    else if (!stopset_model.swift && !(needs & STOPSET_NEEDS_LOAD))
        stopset_gravity_torques(&w->map.arm, 1, q, out);
    else
        for (int i = 0; i < NJ; i++) out[i] = stopset_model.swift ? w->rigid.link[i][0] : w->rigid.load[i][0];
}

/* What the laws give at one state with the friction directions `mode`, on top of tau; rigid signals are there. */
static void effects(StopsetWork *w, const StopsetSamples *at, const int32_t mode[NJ], double tau[NJ]) {
    double out[ROWS];
    for (int k = 0; k < N_LAWS; k++) {
        const StopsetLaw *law = w->law + k;
        stopset_law_signals(&w->map, law, &(StopsetLook){1, 1, mode[law->joint]}, at, &w->rigid, w->signals);
        stopset_play(&law->torque, (const double(*)[ROWS])w->signals, 1, out);
        tau[law->joint] += out[0];
    }
}

/* Flow of what the effects remember, mode 0: the direction of the speed. */
static void rates(StopsetWork *w, const StopsetSamples *at, const int32_t mode[NJ], double *rate) {
    double out[ROWS];
    for (int k = 0; k < N_MEMORY; k++) {
        const StopsetLaw *law = w->law + w->carried[k].law;
        stopset_law_signals(&w->map, law, &(StopsetLook){1, 1, mode[law->joint]}, at, &w->rigid, w->signals);
        stopset_play(&w->carried[k].rate, (const double(*)[ROWS])w->signals, 1, out);
        rate[k] = out[0];
    }
}

/* u of eq. (11) at the state (q, dq): torque without gravity and without the effects that the model compensates. */
static void input_at(const StopsetState *s, StopsetWork *w, double t, const double *y, const int32_t mode[NJ], double u[NJ]) {
    const int off = s->stopping == 1; /* drives without power: gravity and brakes are left */
    const StopsetSamples at = sample_of(s, w, t, y, y + NJ, y + YM);
    double rigid[NJ], effect[NJ] = {0};
    if (w->map.needs) stopset_rigid_signals(&w->map, 1, at.q, at.dq, 0, &w->rigid);
    if (stopset_model.motor_torque || off) rigid_at(w, at.q, at.dq, rigid);
    effects(w, &at, mode, effect);
    for (int i = 0; i < NJ; i++) {
        u[i] = (off ? 0.0 : s->r[VR_TAU + i] / stopset_model.gain[i]) - s->r[VR_OFFSET + i];
        if (stopset_model.motor_torque || off) u[i] -= rigid[i];
        u[i] -= effect[i];
        if (off) {
            double since = t - s->stop_start - stopset_model.brake_delay[i], rise = stopset_model.brake_rise[i];
            double share = since <= 0.0 ? 0.0 : since >= rise ? 1.0 : since / rise;
            u[i] -= stopset_model.brake_mid[i] * share * mode[i];
        }
    }
}

double stopset_brakes_change(double since) {
    double next = HUGE_VAL;
    for (int i = 0; i < NJ; i++) {
        const double at[2] = {stopset_model.brake_delay[i], stopset_model.brake_delay[i] + stopset_model.brake_rise[i]};
        for (int k = 0; k < 2; k++)
            if (at[k] > since + 1e-12 && at[k] < next) next = at[k];
    }
    return next;
}

/* u at the measured state, as identification and monitor have it. */
void stopset_input(const StopsetState *s, StopsetWork *w, double u[NJ]) {
    const StopsetSamples at = sample_of(s, w, s->r[VR_TIME], &s->r[VR_Q_MEASURED], &s->r[VR_DQ_MEASURED], &s->r[VR_MEMORY]);
    stopset_inputs(&w->map, 1, &at, u);
}

/* Flow at the measured state. */
static void measured_rates(const StopsetState *s, StopsetWork *w, const double *memory, double *rate) {
    static const int32_t as_it_moves[NJ] = {0};
    const StopsetSamples at = sample_of(s, w, s->r[VR_TIME], &s->r[VR_Q_MEASURED], &s->r[VR_DQ_MEASURED], memory);
    if (N_MEMORY && w->map.needs) stopset_rigid_signals(&w->map, 1, at.q, at.dq, 0, &w->rigid);
    rates(w, &at, as_it_moves, rate);
}

/* dz/dt = b + a z with the measured state held: exact, as identification and monitor step it. */
void stopset_memory_step(StopsetState *s, StopsetWork *w, double h) {
    static const uint8_t first[2] = {1, 0};
    double at[NM], b[NM], whole[NM];
    for (int k = 0; k < NM; k++) at[k] = 0.0;
    measured_rates(s, w, at, b);
    for (int k = 0; k < NM; k++) at[k] = 1.0;
    measured_rates(s, w, at, whole);
    for (int k = 0; k < N_MEMORY; k++) {
        const double slope = whole[k] - b[k];
        double z[2];
        stopset_remember(2, &b[k], &slope, &h, first, s->r[VR_MEMORY + k], z);
        s->r[VR_MEMORY + k] = z[1];
    }
}

/* Torque left for acceleration, Minv net: model 3's Minv is that of the state, and the rest of it a torque. */
static void take_off(StopsetWork *w, const double *q, const double *dq, double net[NJ]) {
#if KIND == 3
    static const double none[NJ] = {0};
    double x[NX], J_x[NJ * NX], gain[NJ][NJ], rest[NJ];
    memcpy(x, q, NJ * sizeof *x);
    memcpy(x + NJ, dq, NJ * sizeof *x);
    stopset_linearised(&w->dynamics, 1, x, none, w->room, J_x, gain[0]);
    stopset_acceleration(&w->dynamics, q, dq, none, w->room, rest);
    stopset_invert(gain, w->M);
    for (int i = 0; i < NJ; i++)
        for (int j = 0; j < NJ; j++) net[i] += w->M[i][j] * rest[j];
    for (int i = 0; i < NJ; i++)
        for (int j = 0; j < NJ; j++) w->M[i][j] += w->carried_load[i][j];
    stopset_invert(w->M, w->Minv);
#else
    double drag[NJ];
    stopset_drag(&w->dynamics, q, dq, w->room, drag);
    for (int i = 0; i < NJ; i++) net[i] -= drag[i];
#endif
}

/* Torque left for acceleration on each joint, friction directions as given. */
static void net_torque(const StopsetState *s, StopsetWork *w, double t, const double y[NY], const int32_t mode[NJ], double net[NJ]) {
    input_at(s, w, t, y, mode, net);
    take_off(w, y, y + NJ, net);
}

/* Flow of what the effects remember, after net_torque of the same state. */
static void own_rates(const StopsetState *s, StopsetWork *w, double t, const double y[NY], const int32_t mode[NJ], double *rate) {
    const StopsetSamples at = sample_of(s, w, t, y, y + NJ, y + YM);
    rates(w, &at, mode, rate);
}

/* Accelerations with the sticking joints held: M_ff ddq_f = net_f. */
static void accelerate(const StopsetState *s, StopsetWork *w, const int32_t mode[NJ], const double net[NJ], double ddq[NJ]) {
    int held = 0;
    if (directional(s))
        for (int i = 0; i < NJ; i++) held += mode[i] == 0;
    if (!held || stopset_model.decoupled) {
        for (int r = 0; r < NJ; r++) {
            ddq[r] = 0.0;
            if (held && mode[r] == 0) continue;
            for (int c = 0; c < NJ; c++) ddq[r] += w->Minv[r][c] * net[c];
        }
        return;
    }
    int same = w->sliding_made;
    for (int i = 0; i < NJ; i++) same = same && w->sliding_of[i] == (mode[i] != 0);
    if (!same || KIND == 3) { /* model 3 has another M at every state */
        double A[NJ][NJ];
        for (int r = 0; r < NJ; r++)
            for (int c = 0; c < NJ; c++) A[r][c] = (mode[r] && mode[c]) ? w->M[r][c] : (r == c ? 1.0 : 0.0);
        memset(w->sliding, 0, sizeof w->sliding);
        stopset_invert(A, w->sliding); /* a principal block of a positive definite matrix */
        for (int i = 0; i < NJ; i++) w->sliding_of[i] = (uint8_t)(mode[i] != 0);
        w->sliding_made = 1;
    }
    for (int r = 0; r < NJ; r++) {
        ddq[r] = 0.0;
        if (!mode[r]) continue;
        for (int c = 0; c < NJ; c++)
            if (mode[c]) ddq[r] += w->sliding[r][c] * net[c];
    }
}

static void derivative(const StopsetState *s, StopsetWork *w, double t, const double y[NY], const int32_t mode[NJ], double dy[NY]) {
    double net[NJ];
    const double *dq = y + NJ;
    net_torque(s, w, t, y, mode, net);
    own_rates(s, w, t, y, mode, dy + YM);
    accelerate(s, w, mode, net, dy + NJ);
    memcpy(dy, dq, NJ * sizeof *dy);
}

/* A step's begin: state, its derivative, friction directions. */
typedef struct {
    double t, y[NY], first[NY];
    int32_t mode[NJ];
} Begin;

/* One step of length h; returns the error over the tolerance, `last`: the derivative at the end. */
static double runge_kutta(const StopsetState *s, StopsetWork *w, const Begin *begin, double h, double out[NY], double last[NY]) {
    const double t = begin->t, *y = begin->y;
    const int32_t *mode = begin->mode;
    double k[STAGES][NY], fine = 0.0, coarse = 0.0;
    memcpy(k[0], begin->first, sizeof k[0]);
    for (int stage = 1; stage <= STAGES; stage++) {
        const double *share = stage < STAGES ? RK_A[stage] : RK_B;
        for (int i = 0; i < NY; i++) {
            double sum = 0.0;
            for (int j = 0; j < stage; j++) sum += share[j] * k[j][i];
            out[i] = y[i] + h * sum;
        }
        derivative(s, w, stage < STAGES ? t + RK_C[stage] * h : t + h, out, mode, stage < STAGES ? k[stage] : last);
    }
    for (int i = 0; i < NY; i++) {
        const double scale = TOLERANCE * (1.0 + fabs(y[i]));
        double e5 = 0.0, e3 = 0.0;
        for (int j = 0; j < STAGES; j++) {
            e5 += RK_E5[j] * k[j][i];
            e3 += RK_E3[j] * k[j][i];
        }
        fine += e5 * e5 / (scale * scale);
        coarse += e3 * e3 / (scale * scale);
    }
    if (fine == 0.0 && coarse == 0.0) return 0.0;
    return fabs(h) * fine / sqrt((fine + 0.01 * coarse) * NY);
}

/* Torque on every joint with the friction of either direction where it rests [N m]: up, down. */
typedef struct {
    double up[NJ], down[NJ];
} Pushes;

static void push_at(const StopsetState *s, StopsetWork *w, double t, const double y[NY], const int32_t mode[NJ], Pushes *out) {
    int32_t trial[NJ];
    for (int i = 0; i < NJ; i++) trial[i] = mode[i] ? mode[i] : 1;
    net_torque(s, w, t, y, trial, out->up);
    for (int i = 0; i < NJ; i++) trial[i] = mode[i] ? mode[i] : -1;
    net_torque(s, w, t, y, trial, out->down);
}

/* What is left of it for a joint at rest once those that slide, `mode`, have had what they take: up it slides above zero, down below. */
static void push_left(const StopsetState *s, StopsetWork *w, const Pushes *push, const int32_t mode[NJ], Pushes *left) {
    double net[NJ], ddq[NJ];
    for (int i = 0; i < NJ; i++) net[i] = mode[i] >= 0 ? push->up[i] : push->down[i];
    accelerate(s, w, mode, net, ddq);
    for (int i = 0; i < NJ; i++) {
        double coupling = 0.0;
        for (int j = 0; j < NJ; j++)
            if (j != i) coupling += w->M[i][j] * ddq[j];
        left->up[i] = push->up[i] - coupling;
        left->down[i] = push->down[i] - coupling;
    }
}

/* Who of the joints at rest begins to slide, and in which direction: one after the other, until none changes. */
static void settle(const StopsetState *s, StopsetWork *w, double t, double y[NY], int32_t mode[NJ]) {
    Pushes push, left;
    int resting = 0;
    for (int i = 0; i < NJ; i++) {
        double dq = y[NJ + i];
        mode[i] = fabs(dq) <= REST ? 0 : dq > 0.0 ? 1 : -1;
        if (mode[i] == 0) y[NJ + i] = 0.0;
        resting += mode[i] == 0;
    }
    if (!resting) return;
    push_at(s, w, t, y, mode, &push);
    for (int sweep = 0; sweep < 2 * NJ; sweep++) {
        int changed = 0;
        push_left(s, w, &push, mode, &left);
        for (int i = 0; i < NJ && !changed; i++) {
            if (y[NJ + i] != 0.0) continue;
            const int32_t next = left.up[i] > 0.0 ? 1 : left.down[i] < 0.0 ? -1 : 0;
            changed = next != mode[i];
            mode[i] = next;
        }
        if (!changed) break;
    }
}

/* Whether the state asks for other friction directions than `mode`. */
static int event(const StopsetState *s, StopsetWork *w, double t, const double y[NY], const int32_t mode[NJ]) {
    double copy[NY];
    int32_t next[NJ];
    int resting = 0;
    for (int i = 0; i < NJ; i++) {
        if (mode[i] * y[NJ + i] < -REST) return 1;
        resting += mode[i] == 0;
    }
    if (!resting) return 0;
    memcpy(copy, y, sizeof copy);
    settle(s, w, t, copy, next);
    for (int i = 0; i < NJ; i++)
        if (mode[i] == 0 && next[i] != 0) return 1;
    return 0;
}

/* Positive while the friction directions hold: speed of a sliding joint [rad/s], margin of a sticking one [N m]. */
static void margins(const StopsetState *s, StopsetWork *w, double t, const double y[NY], const int32_t mode[NJ], double z[NJ]) {
    Pushes push, left;
    int resting = 0;
    for (int i = 0; i < NJ; i++) {
        z[i] = mode[i] * y[NJ + i];
        resting += mode[i] == 0;
    }
    if (!resting) return;
    push_at(s, w, t, y, mode, &push);
    push_left(s, w, &push, mode, &left);
    for (int i = 0; i < NJ; i++)
        if (!mode[i]) z[i] = fmin(0.0 - left.up[i], left.down[i]); /* of zeros the one without a sign */
}

static void take(const StopsetState *s, double y[NY]) {
    memcpy(y, &s->r[VR_Q], NJ * sizeof *y);
    memcpy(y + NJ, &s->r[VR_DQ], NJ * sizeof *y);
    for (int k = 0; k < N_MEMORY; k++) y[YM + k] = s->r[VR_MEMORY + k];
}

static void put(StopsetState *s, const double y[NY], const int32_t mode[NJ]) {
    memcpy(&s->r[VR_Q], y, NJ * sizeof *y);
    memcpy(&s->r[VR_DQ], y + NJ, NJ * sizeof *y);
    memcpy(s->mode, mode, sizeof s->mode);
    for (int k = 0; k < N_MEMORY; k++) s->r[VR_MEMORY + k] = y[YM + k];
}

static int moving(const int32_t mode[NJ]) {
    for (int i = 0; i < NJ; i++)
        if (mode[i]) return 1;
    return 0;
}

/* How much of a step that has come to t, `left` before its end, is still to go: nothing where a stopping arm has come to rest, and
 * less where whoever is told of the way wants less. */
static double still_to_go(StopsetState *s, StopsetWork *w, double t, double left, const double y[NY], const int32_t mode[NJ], int moved) {
    if (w->ends_at_rest && s->stopping == 1 && moved && !moving(mode)) return 0.0;
    if (!w->between) return left;
    put(s, y, mode);
    s->r[VR_TIME] = t;
    s->outputs_ready = 0;
    const double end = w->between(w->who, t + left);
    return end < t + left ? fmax(end - t, 0.0) : left;
}

/* So long after it, with the friction directions of the begin: state, its derivative, every joint's margin. */
typedef struct {
    double after, y[NY], rate[NY], z[NJ];
} Probe;

static const double SOON = 1e-15; /* s: so near together are the last state without and the first one with an event */

/* Where in (0, 1) the cubic from z[0] > 0 to z[1] < 0 with these slopes passes zero. */
static double cubic_crossing(const double z[2], const double slope[2]) {
    const double rise = z[1] - z[0], square = 3.0 * rise - 2.0 * slope[0] - slope[1], cube = slope[0] + slope[1] - 2.0 * rise;
    double lo = 0.0, hi = 1.0;
    for (int k = 0; k < 50; k++) {
        const double x = 0.5 * (lo + hi);
        if (z[0] + x * (slope[0] + x * (square + x * cube)) > 0.0)
            lo = x;
        else
            hi = x;
    }
    return 0.5 * (lo + hi);
}

/* Where between two probes the joint of the least margin at the later one may ask for another direction, as a share of the time between
 * them. Of a joint that slides the margin is its speed, whose slope is known at both; of one that sticks a torque (Illinois rule). */
static double crossing(const Begin *b, const Probe *early, const Probe *late, const double weight[2]) {
    int least = 0;
    for (int i = 1; i < NJ; i++)
        if (late->z[i] < late->z[least]) least = i;
    const double rest = b->mode[least] ? REST : 0.0, z[2] = {early->z[least] + rest, late->z[least] + rest};
    const double width = (late->after - early->after) * b->mode[least];
    if (!(z[1] < 0.0) || (early->after == 0.0 && !(z[0] > -1e-6 * z[1]))) return 0.5; /* who has just begun to slide has no margin yet */
    if (b->mode[least]) return cubic_crossing(z, (const double[2]){width * early->rate[NJ + least], width * late->rate[NJ + least]});
    return weight[0] * z[0] / (weight[0] * z[0] - weight[1] * z[1]);
}

/* The first state of a step with an event, from its end, `late`, which has one: half a dozen steps where bisection takes forty. */
static void locate(const StopsetState *s, StopsetWork *w, const Begin *b, Probe *late) {
    Probe early = {.after = 0.0}, at;
    double weight[2] = {1.0, 1.0}, away = 0.4 * SOON;
    int side = -1;
    memcpy(early.y, b->y, sizeof early.y);
    memcpy(early.rate, b->first, sizeof early.rate);
    margins(s, w, b->t, early.y, b->mode, early.z);
    margins(s, w, b->t + late->after, late->y, b->mode, late->z);
    for (int k = 0; k < 60 && late->after - early.after > SOON; k++) {
        const double width = late->after - early.after, share = k < 24 ? crossing(b, &early, late, weight) : 0.5;
        /* a little from both ends, and the farther the longer one of them stays: so both close in */
        at.after = early.after + fmin(fmax(share * width, fmin(away, 0.5 * width)), fmax(width - away, 0.5 * width));
        runge_kutta(s, w, b, at.after, at.y, at.rate);
        margins(s, w, b->t + at.after, at.y, b->mode, at.z);
        const int is = event(s, w, b->t + at.after, at.y, b->mode);
        weight[is] = 1.0;
        if (is == side) weight[!is] *= 0.5;
        away = is == side ? 8.0 * away : 0.4 * SOON;
        side = is;
        *(is ? late : &early) = at;
    }
}

const char *stopset_integrate(StopsetState *s, StopsetWork *w, double h, double *done) {
    Begin at = {.t = s->r[VR_TIME]};
    double next[NY], last[NY];
    int events = 0;
    double left = h, step = s->h_try > 0.0 ? s->h_try : h;
    take(s, at.y);
    for (int i = 0; i < NJ; i++) at.mode[i] = 1;
    if (directional(s)) settle(s, w, at.t, at.y, at.mode);
    const int moved = moving(at.mode);
    derivative(s, w, at.t, at.y, at.mode, at.first);
    for (int count = 0; left > 0.0; count++) {
        if (count == MOST_STEPS) return "the communication step takes too many steps of the integrator; give a shorter one or smaller inputs";
        double now = step >= left ? left : 2.0 * step > left ? 0.5 * left : step; /* no short one at the end */
        double error = runge_kutta(s, w, &at, now, next, last);
        if (!stopset_finite(error)) return "the motion is no longer finite; check the torque inputs and parameters";
        double factor = error > 0.0 ? 0.9 * stopset_exp(-0.125 * stopset_log(error)) : 4.0;
        if (error > 1.0 && now > 1e-12) {
            step = now * fmax(factor, 0.1);
            continue;
        }
        if (now == step || factor < 1.0) step = now * fmin(fmax(factor, 0.2), 4.0);
        if (directional(s) && events < EVENTS && event(s, w, at.t + now, next, at.mode)) {
            Probe late = {.after = now};
            memcpy(late.y, next, sizeof next);
            memcpy(late.rate, last, sizeof last);
            locate(s, w, &at, &late);
            now = late.after;
            memcpy(next, late.y, sizeof next);
            for (int i = 0; i < NJ; i++)
                if (at.mode[i] * next[NJ + i] < 0.0) next[NJ + i] = 0.0;
            settle(s, w, at.t + now, next, at.mode);
            derivative(s, w, at.t + now, next, at.mode, last);
            events++;
        }
        memcpy(at.y, next, sizeof at.y);
        memcpy(at.first, last, sizeof at.first);
        at.t += now;
        left = left - now > 1e-14 * h ? left - now : 0.0;
        if (left > 0.0) {
            const double to_go = still_to_go(s, w, at.t, left, at.y, at.mode, moved);
            h -= left - to_go;
            left = to_go;
        }
    }
    *done = h - left;
    s->h_try = step;
    put(s, at.y, at.mode);
    return 0;
}

void stopset_accelerations(const StopsetState *s, StopsetWork *w, double ddq[NJ], double *rate) {
    const double t = s->r[VR_TIME];
    double y[NY], net[NJ];
    int32_t mode[NJ];
    if (s->stopping >= 2) { /* the ramp is given: no effect acts on it */
        double q[NJ], dq[NJ];
        for (int k = 0; k < N_MEMORY; k++) rate[k] = 0.0;
        stopset_ramp_motion(s, t - s->stop_start, q, dq, ddq);
        return;
    }
    take(s, y);
    for (int i = 0; i < NJ; i++) mode[i] = 1;
    if (stopset_exact(s)) {
        stopset_input(s, w, net);
        measured_rates(s, w, &s->r[VR_MEMORY], rate);
        take_off(w, y, y + NJ, net);
    } else {
        if (s->modes_by_events || s->modes_held)
            memcpy(mode, s->mode, sizeof mode);
        else if (directional(s))
            settle(s, w, t, y, mode);
        net_torque(s, w, t, y, mode, net);
        own_rates(s, w, t, y, mode, rate);
    }
    accelerate(s, w, mode, net, ddq);
}

void stopset_update_modes(StopsetState *s, StopsetWork *w, double slack) {
    const double t = s->r[VR_TIME];
    double y[NY];
    for (int i = 0; i < NJ; i++) s->mode[i] = 1;
    if (!directional(s) || stopset_exact(s)) return;
    take(s, y);
    for (int i = 0; i < NJ; i++)
        if (fabs(y[NJ + i]) <= slack) y[NJ + i] = s->r[VR_DQ + i] = 0.0;
    settle(s, w, t, y, s->mode);
}

void stopset_indicators(const StopsetState *s, StopsetWork *w, double z[NJ]) {
    double y[NY];
    for (int i = 0; i < NJ; i++) z[i] = 1.0;
    if (!directional(s) || stopset_exact(s) || s->stopping >= 2) return;
    take(s, y);
    margins(s, w, s->r[VR_TIME], y, s->mode, z);
}
