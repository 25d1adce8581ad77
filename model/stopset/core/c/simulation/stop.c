/* Stops of the simulated arm, the truth that bounds are tested on: power off, brakes close, joints slide, then stick.
 *
 *     M(q) dv/dt + c(q, v) + g(q) + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i),   M with rotor inertia
 *
 * B_i(t) is zero until the brake's delay is over, then a ramp to its torque. Time stepping after Moreau, of second order in
 * smooth phases; a step in which a joint comes to rest or turns round is split at that moment.
 *
 * Four stops go on side by side, each at its own time; one that is over makes room for the next. A stop's bits do not depend on
 * what stands beside it.
 *
 * Source: Moreau (1988); Acary & Brogliato (2008), ch. 10.
 */
#include <math.h>
#include <string.h>

#include "../maths.h"
#include "../wide.h"
#include "simulation.h"

#define NUMBER Four
#define ALL(x) FOUR_OF(x)
#define OF(name) four_##name
#define four_sincos(angle, s, c) stopset_sincos_of_four((const double *)&(angle), (double *)(s), (double *)(c))
#include "dynamics_of.h"

enum { LANES = 4 };
static const double ROUNDING = 1e-12; /* as in inclusion.c */

/* Where in its stop each lane is. */
typedef struct {
    int64_t stop, step; /* stop < 0: none is left */
    int event, splits;
    double left, closed; /* [s] of the step; when all its brakes have closed */
} Lane;

typedef struct {
    const StopsetSimStops *stops;
    const StopsetSimTime *time;
    const double *q0, *v0;
    double *qs, *vs;
    int64_t next; /* stop that has not begun */
    Lane lane[LANES];
    Four pi[10 * SIM_JOINTS], rotor[SIM_JOINTS], dry[SIM_JOINTS], viscous[SIM_JOINTS], brake[SIM_JOINTS], delay[SIM_JOINTS], rise[SIM_JOINTS];
    Four q[SIM_JOINTS], v[SIM_JOINTS], rate[SIM_JOINTS], u[SIM_JOINTS], t, h;
    /* A w + p = b as in inclusion.c: friction impulse at most p, who is guessed to move which way (-1, 0, 1) */
    Four A[SIM_JOINTS * SIM_JOINTS], L[SIM_JOINTS * SIM_JOINTS], b[SIM_JOINTS], p[SIM_JOINTS], mode[SIM_JOINTS], w[SIM_JOINTS];
    Choice solved;
} Stops;

static double *of(Four *x, int lane) { return (double *)x + lane; }

/* Integral [s] of a brake's share of its torque until e [s] after its delay. */
#define RAMPED(e, rise) CHOSEN((e) > zero, CHOSEN((e) >= (rise), (e)-0.5 * (rise), 0.5 * (e) * (e) / (rise)), zero)

UNROLLED void set_up(int n, Stops *x) {
    Four middle[SIM_JOINTS], speed[SIM_JOINTS], bias[SIM_JOINTS];
    const Four h = x->h, zero = FOUR_OF(0.0);
    for (int i = 0; i < n; i++) {
        middle[i] = x->q[i] + 0.5 * h * x->v[i];
        speed[i] = x->v[i] + 0.5 * h * x->rate[i];
    }
    four_mass_and_bias(n, &x->stops->arm, x->pi, middle, speed, x->A, bias);
    for (int i = 0; i < n; i++) {
        x->A[i * n + i] += x->rotor[i];
        Four b = h * (x->u[i] - bias[i] - 0.5 * x->viscous[i] * x->v[i]);
        for (int j = 0; j < n; j++) b += x->A[i * n + j] * x->v[j];
        x->b[i] = b;
        const Four since = x->t - x->delay[i], until = x->t + h - x->delay[i], rise = x->rise[i];
        x->p[i] = h * x->dry[i] + x->brake[i] * (RAMPED(until, rise) - RAMPED(since, rise));
        x->mode[i] = CHOSEN(x->v[i] != zero, CHOSEN(x->v[i] > zero, FOUR_OF(1.0), FOUR_OF(-1.0)), x->mode[i]);
    }
    for (int i = 0; i < n; i++) x->A[i * n + i] += 0.5 * h * x->viscous[i];
}

/* The moving joints with all others at rest, by Cholesky; lanes whose answer satisfies the inclusion are `solved`. */
UNROLLED void solve_moving(int n, Stops *x) {
    const Four *A = x->A, zero = FOUR_OF(0.0);
    Four *L = x->L, *w = x->w, scale = zero;
    Choice moves[SIM_JOINTS], wrong = {0, 0, 0, 0};
    for (int i = 0; i < n; i++) {
        moves[i] = x->mode[i] != zero;
        scale = ABOVE(ABOVE(scale, SIZES_OF(x->b[i])), x->p[i]);
    }
    for (int i = 0; i < n; i++) {
        Four r = x->b[i] - x->mode[i] * x->p[i], d = A[i * n + i];
        for (int j = 0; j < i; j++) {
            Four s = A[i * n + j];
            for (int k = 0; k < j; k++) s -= L[i * n + k] * L[j * n + k];
            L[i * n + j] = (Four)((Choice)(s / L[j * n + j]) & moves[i] & moves[j]);
            r -= L[i * n + j] * w[j];
        }
        for (int k = 0; k < i; k++) d -= L[i * n + k] * L[i * n + k];
        for (int lane = 0; lane < LANES; lane++) L[i * n + i][lane] = sqrt(d[lane]);
        w[i] = (Four)((Choice)(r / L[i * n + i]) & moves[i]);
    }
    for (int i = n - 1; i >= 0; i--) {
        Four s = w[i];
        for (int k = i + 1; k < n; k++) s -= L[k * n + i] * w[k];
        w[i] = (Four)((Choice)(s / L[i * n + i]) & moves[i]);
    }
    for (int i = 0; i < n; i++) {
        Four r = x->b[i];
        for (int j = 0; j < n; j++) r -= A[i * n + j] * w[j];
        const Four most = x->p[i] + ROUNDING * scale;
        const Choice turns = (w[i] * x->mode[i] < zero) & (x->p[i] + x->p[i] > zero), slips = (r > most) | (r < -most);
        wrong |= (moves[i] & turns) | (~moves[i] & slips);
    }
    x->solved = ~wrong;
}

UNROLLED void solve(int n, Stops *x) {
    set_up(n, x);
    solve_moving(n, x);
}
STOPSET_WIDE static void try_step(Stops *x) { SIZED(solve, x->stops->arm.n, x); }

static void friction_of(Stops *x, int lane, SimFriction *f) {
    const int n = f->n = x->stops->arm.n;
    for (int i = 0; i < n * n; i++) f->A[i] = *of(x->A + i, lane);
    for (int i = 0; i < n; i++) {
        f->b[i] = *of(x->b + i, lane);
        f->plus[i] = f->minus[i] = *of(x->p + i, lane);
        f->w[i] = *of(x->w + i, lane);
        f->mode[i] = (int)*of(x->mode + i, lane);
    }
}

static void answer_to(Stops *x, int lane, const SimFriction *f) {
    for (int i = 0; i < f->n; i++) {
        *of(x->w + i, lane) = f->w[i];
        *of(x->mode + i, lane) = f->mode[i];
    }
}

/* A lane's knot into its stop's rows. */
static void keep(Stops *x, int l) {
    const int n = x->stops->arm.n;
    const int64_t row = (x->lane[l].stop * (x->time->steps + 1) + x->lane[l].step) * n;
    for (int i = 0; i < n; i++) {
        x->qs[row + i] = *of(x->q + i, l);
        x->vs[row + i] = *of(x->v + i, l);
    }
}

static void begin_step(Stops *x, int l) {
    const StopsetSimTime *time = x->time;
    const int n = x->stops->arm.n;
    Lane *lane = x->lane + l;
    const double *u = time->disturbance + (lane->stop * time->pieces + lane->step * time->pieces / time->steps) * n;
    for (int i = 0; i < n; i++) *of(x->u + i, l) = u[i];
    *of(&x->t, l) = (double)lane->step * time->dt;
    *of(&x->h, l) = lane->left = time->dt;
    lane->event = -1;
    lane->splits = 0;
}

/* The next stop, if there is one, into a lane. */
static void begin(Stops *x, int l) {
    const StopsetSimStops *s = x->stops;
    const int n = s->arm.n;
    Lane *lane = x->lane + l;
    if (x->next >= s->count) {
        lane->stop = -1;
        return;
    }
    lane->stop = x->next++;
    lane->step = 0;
    lane->closed = 0.0;
    const int64_t row = lane->stop * n;
    for (int i = 0; i < 10 * n; i++) *of(x->pi + i, l) = s->arm.pi[10 * row + i];
    for (int i = 0; i < n; i++) {
        const double closed = s->delay[row + i] + s->rise[row + i];
        if (!(closed <= lane->closed)) lane->closed = closed;
        *of(x->rotor + i, l) = s->rotor[row + i];
        *of(x->dry + i, l) = s->dry[row + i];
        *of(x->viscous + i, l) = s->viscous[row + i];
        *of(x->brake + i, l) = s->brake[row + i];
        *of(x->delay + i, l) = s->delay[row + i];
        *of(x->rise + i, l) = s->rise[row + i];
        *of(x->q + i, l) = x->q0[row + i];
        *of(x->v + i, l) = x->v0[row + i];
        *of(x->rate + i, l) = *of(x->mode + i, l) = *of(x->w + i, l) = 0.0;
    }
    keep(x, l);
    if (x->time->steps > 0) begin_step(x, l);
}

/* Has a step from rest, all brakes closed, led to rest? Then every step does, until the disturbance changes. */
static int rests(Stops *x, int l) {
    int still = *of(&x->h, l) == x->time->dt && (double)(x->lane[l].step - 1) * x->time->dt >= x->lane[l].closed;
    for (int i = 0; i < x->stops->arm.n; i++) still &= *of(x->v + i, l) == 0.0 && *of(x->rate + i, l) == 0.0;
    return still;
}

/* After a step, or a piece of one: what comes next in this lane. */
static void go_on(Stops *x, int l) {
    Lane *lane = x->lane + l;
    const StopsetSimTime *time = x->time;
    const double h = *of(&x->h, l);
    *of(&x->t, l) += h;
    lane->left = lane->left - h < SIM_SMALLEST * time->dt ? 0.0 : lane->left - h;
    lane->event = -1;
    if (lane->left > 0.0) {
        *of(&x->h, l) = lane->left;
        return;
    }
    const int64_t piece = lane->step++ * time->pieces / time->steps;
    keep(x, l);
    if (rests(x, l))
        while (lane->step < time->steps && lane->step * time->pieces / time->steps == piece) {
            lane->step++;
            keep(x, l);
        }
    if (lane->step < time->steps)
        begin_step(x, l);
    else
        begin(x, l);
}

/* Whether the step that was tried is taken; else it is tried again, up to the moment at which its first joint comes to rest. */
static int accepted(Stops *x, int l, SimFriction *f) {
    Lane *lane = x->lane + l;
    const int n = x->stops->arm.n;
    double v[SIM_JOINTS];
    int crosses = 0;
    if (!x->solved[l]) {
        friction_of(x, l, f);
        sim_solve(f);
        answer_to(x, l, f);
    }
    if (lane->event < 0 && lane->splits < SIM_SPLITS * n)
        for (int i = 0; i < n; i++) {
            v[i] = *of(x->v + i, l);
            crosses |= v[i] != 0.0 && *of(x->w + i, l) * v[i] <= 0.0 && 2.0 * *of(x->p + i, l) > 0.0;
        }
    if (crosses) {
        friction_of(x, l, f);
        const double share = sim_first_crossing(f, v, &lane->event);
        answer_to(x, l, f);
        lane->splits = lane->event >= 0 ? lane->splits + 1 : SIM_SPLITS * n;
        *of(&x->h, l) = (share > SIM_SMALLEST ? share : SIM_SMALLEST) * lane->left;
        return 0;
    }
    if (lane->event >= 0) { /* this joint is at rest at the end of the piece, exactly */
        *of(x->w + lane->event, l) = 0.0;
        *of(x->mode + lane->event, l) = 0.0;
    }
    return 1;
}

/* Positions and velocities at the end of the step, in the lanes that take it. */
UNROLLED void move(int n, Stops *x, int lanes) {
    const Choice taken = IN_LANES(lanes);
    for (int i = 0; i < n; i++) {
        const Four q = x->q[i] + 0.5 * x->h * (x->v[i] + x->w[i]), rate = (x->w[i] - x->v[i]) / x->h;
        x->q[i] = CHOSEN(taken, q, x->q[i]);
        x->rate[i] = CHOSEN(taken, rate, x->rate[i]);
        x->v[i] = CHOSEN(taken, x->w[i], x->v[i]);
    }
}
STOPSET_WIDE static void take_step(Stops *x, int lanes) { move(x->stops->arm.n, x, lanes); }

int stopset_sim_stops(const StopsetSimStops *s, const double *q0, const double *v0, const StopsetSimTime *time, double *qs, double *vs) {
    const int n = s->arm.n;
    if (n < 1 || n > SIM_JOINTS) return STOPSET_TOO_MANY_JOINTS;
    Stops x;
    SimFriction f;
    memset(&x, 0, sizeof x);
    memset(&f, 0, sizeof f);
    x.stops = s, x.time = time, x.q0 = q0, x.v0 = v0, x.qs = qs, x.vs = vs;
    x.h = FOUR_OF(time->dt);
    for (int l = 0; l < LANES; l++) begin(&x, l);
    for (;;) {
        int taken = 0, active = 0;
        try_step(&x);
        for (int l = 0; l < LANES; l++) {
            if (x.lane[l].stop < 0) continue;
            active = 1;
            if (accepted(&x, l, &f)) taken |= 1 << l;
        }
        if (!active) break;
        take_step(&x, taken);
        for (int l = 0; l < LANES; l++)
            if (taken >> l & 1) go_on(&x, l);
    }
    return STOPSET_OK;
}
