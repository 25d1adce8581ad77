/* The simulated arm at work: controller, drives, gears that give, friction with all its moods, brakes, heat.
 *
 * The laws here are deliberately not those of the effects that a model is identified with.
 *
 * Source: Moreau (1988); Spong (1987); Al-Bender et al. (2005) for the Maxwell slip elements.
 */
#include <math.h>
#include <string.h>

#include "../maths.h"
#include "simulation.h"

/* Columns of the plant's table, in the order of stopset.simulation.plant. */
enum {
    ROTOR, FC, FV, LIMIT, BRAKE_TORQUE, BRAKE_DELAY, BRAKE_RISE, FV_SLOPE, FC_SLOPE, BREAKAWAY, STRIBECK_SPEED, TOOTH, SKEW, THINNING_SPEED,
    RIPPLE, RIPPLE_ORDER, RIPPLE_PHASE, STIFFNESS, TWIST_DAMPING, PRESLIDING, GAIN, SPRING, SPRING_CENTRE, DRAG, PARTNER, ENCODER_OFFSET,
    ECCENTRICITY, ECCENTRICITY_PHASE, BUMP, BUMP_CENTRE, BUMP_WIDTH, RESONANCE, RESONANCE_SPEED, WEAVE, FILM_HEAT, FILM_TIME,
    TOOTH_SQUARE, COUNTER, COUNTER_RATIO, COUNTER_CENTRE, CABLE, CABLE_CENTRE, GAP, LAG, COLUMNS
};
enum { ELEMENTS = 4 };
static const double SHARES[ELEMENTS] = {0.4, 0.3, 0.2, 0.1}, REACH[ELEMENTS] = {0.4, 1.0, 2.0, 4.0};
static const double REFERENCE = 30.0, VOGEL = 95.0, RESONANCE_WIDTH = 0.08, COULOMB_FLOOR = 0.4, BRAKES_OPEN = -1e9, REACH_OF_CABLE = 0.6, YIELDS = 0.15, PI = 3.14159265358979312;

static double absolute(double x) { return x < 0.0 ? -x : x; }
static double limited(double x, double most) { return x > most ? most : x < -most ? -most : x; }

/* asinh of x > 0. */
static double area_sine(double x) {
    const double y = x + x * x / (1.0 + sqrt(1.0 + x * x)), u = 1.0 + y;
    return u == 1.0 ? y : stopset_log(u) * y / (u - 1.0);
}

/* Viscous coefficient [N m s/rad] at temp [degC]: torque over speed at `speed`. */
static double viscous(const double *T, double temp, double speed) {
    double d = T[FV];
    if (T[FV_SLOPE] != 0.0) {
        const double at = REFERENCE + VOGEL;
        d *= stopset_exp(T[FV_SLOPE] * at * at * (1.0 / (temp + VOGEL) - 1.0 / at));
    }
    if (T[THINNING_SPEED] > 0.0 && speed != 0.0) {
        const double s = absolute(speed) / T[THINNING_SPEED];
        d *= area_sine(s) / s;
    }
    return d;
}

/* Dry friction [N m] before its direction; `load`: transmitted torque, `walk`: wander [N m]. */
static double coulomb(const double *T, double temp, double speed, double load, double walk) {
    double f = T[FC];
    if (T[FC_SLOPE] != 0.0) {
        const double rest = 1.0 - COULOMB_FLOOR;
        f *= COULOMB_FLOOR + rest * stopset_exp(-T[FC_SLOPE] * (temp - REFERENCE) / rest);
    }
    if (T[BREAKAWAY] != 0.0) {
        const double x = speed / T[STRIBECK_SPEED];
        f += T[BREAKAWAY] / (1.0 + x * x);
    }
    if (T[RESONANCE] != 0.0) {
        const double x = (absolute(speed) - T[RESONANCE_SPEED]) / RESONANCE_WIDTH;
        f += T[RESONANCE] / (1.0 + x * x);
    }
    f += (T[TOOTH] + T[TOOTH_SQUARE] * absolute(load)) * absolute(load) + walk;
    return f > 0.0 ? f : 0.0;
}

/* Torque [N m] that depends on the joint's place: dress pack (stiffer when stretched), cable at its end, gas spring, bump. */
static double position_torque(const double *T, double q) {
    const double x = q - T[SPRING_CENTRE];
    double total = T[SPRING] * x * (1.0 + 0.05 * x * x);
    if (T[CABLE] != 0.0) {
        const double e = stopset_exp((q - T[CABLE_CENTRE]) / REACH_OF_CABLE);
        total += 0.5 * T[CABLE] * (e - 1.0 / e);
    }
    if (T[COUNTER] != 0.0) { /* its force falls as it extends; `length` in units of its longer lever */
        const double r = T[COUNTER_RATIO], turn = q - T[COUNTER_CENTRE], length = sqrt(1.0 + r * r + 2.0 * r * stopset_cos(turn));
        total += T[COUNTER] * (1.0 + YIELDS * (1.0 - length)) * stopset_sin(turn) / length;
    }
    if (T[BUMP] != 0.0) {
        const double y = (q - T[BUMP_CENTRE]) / T[BUMP_WIDTH];
        if (absolute(y) < 2.0) {
            const double c = stopset_cos(0.25 * PI * y);
            total += T[BUMP] * (c * c);
        }
    }
    return total;
}

/* Force [N m] of a spring-slider element after a displacement [rad]; it slides at `limit`, after `reach`. */
static double slipped(double force, double displacement, double limit, double reach) {
    return limited(force + displacement * limit / reach, limit);
}

/* Impulse a brake can give from t to t + h [N m s]: the exact integral of its torque ramp. */
static double brake_impulse(double t, double h, double delay, double rise, double level) {
    const double s = t - delay, e = t + h - delay;
    double total = 0.0;
    if (e > 0.0) total = e >= rise ? e - 0.5 * rise : 0.5 * e * e / rise;
    if (s > 0.0) total -= s >= rise ? s - 0.5 * rise : 0.5 * s * s / rise;
    return level * total;
}

typedef struct {
    SimFriction f;
    double M[SIM_JOINTS * SIM_JOINTS], bias[SIM_JOINTS];
} Work;

/* One piece of length h under motor torque tau (n,); `since`: when the brakes were told to close. */
static void assemble(const StopsetSimArm *a, Work *c, const double *tau, const double *walk, double since, double h) {
    const int n = a->arm.n, N = a->states;
    SimFriction *f = &c->f;
    double middle[SIM_STATES], speed[SIM_STATES], *A = f->A, *b = f->b;
    for (int i = 0; i < N; i++) {
        middle[i] = a->x[i] + 0.5 * h * a->v[i];
        speed[i] = a->v[i] + 0.5 * h * a->rate[i];
        f->plus[i] = f->minus[i] = 0.0;
    }
    sim_mass_and_bias(&a->arm, middle, speed, c->M, c->bias);
    memset(A, 0, (size_t)(N * N) * sizeof *A);
    for (int i = 0; i < n; i++) memcpy(A + i * N, c->M + i * n, (size_t)n * sizeof *A);
    for (int i = 0; i < n; i++) A[a->motor[i] * N + a->motor[i]] += a->table[i * COLUMNS + ROTOR];
    for (int i = 0; i < N; i++) {
        b[i] = 0.0;
        for (int j = 0; j < N; j++) b[i] += A[i * N + j] * a->v[j];
    }
    for (int i = 0; i < n; i++) {
        const double *T = a->table + i * COLUMNS;
        const int64_t m = a->motor[i], p = a->motor[(int)T[PARTNER]];
        double ripple = 0.0;
        b[i] -= h * (c->bias[i] + position_torque(T, middle[i]));
        if (T[RIPPLE] != 0.0) {
            const double angle = T[RIPPLE_ORDER] * middle[m] + T[RIPPLE_PHASE];
            ripple = T[RIPPLE] * (stopset_sin(angle) + 0.15 * stopset_sin(2.0 * angle));
        }
        if (T[WEAVE] != 0.0) ripple += T[WEAVE] * stopset_sin(3.0 * middle[m]) * speed[p];
        b[m] += h * (tau[i] - ripple);
        double d = 0.5 * h * viscous(T, a->temp[i], speed[m]);
        A[m * N + m] += d;
        b[m] -= d * a->v[m];
        if (T[DRAG] != 0.0) {
            d = 0.5 * h * T[DRAG];
            A[m * N + p] += d;
            A[p * N + m] += d;
            b[m] -= d * a->v[p];
            b[p] -= d * a->v[m];
        }
        if (m != i) { /* gear spring, implicit midpoint */
            const double bend = a->x[m] - a->x[i], wound = bend - limited(bend, 0.5 * T[GAP]); /* within the gap no tooth touches */
            const double touches = T[GAP] > 0.0 && wound == 0.0 ? 0.0 : 1.0;
            const double k = touches * (0.25 * h * h * T[STIFFNESS] + 0.5 * h * T[TWIST_DAMPING]);
            const double twist = h * T[STIFFNESS] * wound + k * (a->v[m] - a->v[i]);
            A[m * N + m] += k;
            A[i * N + i] += k;
            A[m * N + i] -= k;
            A[i * N + m] -= k;
            b[m] -= twist;
            b[i] += twist;
        }
        double force = coulomb(T, a->temp[i], speed[m], a->load[i], walk[i]);
        if (T[PRESLIDING] > 0.0) {
            for (int e = 0; e < ELEMENTS; e++)
                b[m] -= h * slipped(a->slip[i * ELEMENTS + e], middle[m] - a->x[m], force * SHARES[e], T[PRESLIDING] * REACH[e]);
            force = 0.0;
        }
        const double grip = brake_impulse(since, h, T[BRAKE_DELAY], T[BRAKE_RISE], T[BRAKE_TORQUE]);
        f->plus[m] = h * force * (1.0 + T[SKEW]) + grip;
        f->minus[m] = h * force * (1.0 - T[SKEW]) + grip;
    }
}

/* The arm on by h [s] under constant motor torque. */
static void advance(const StopsetSimArm *a, Work *c, const double *tau, const double *walk, double since, double h) {
    const int n = a->arm.n, N = a->states;
    SimFriction *f = &c->f;
    double left = h;
    int splits = 0;
    while (left > 0.0) {
        double piece = left;
        int event = -1;
        for (;;) {
            assemble(a, c, tau, walk, since, piece);
            for (int i = 0; i < N; i++)
                if (a->v[i] != 0.0) f->mode[i] = a->v[i] > 0.0 ? 1 : -1;
            sim_solve(f);
            if (event >= 0 || splits >= SIM_SPLITS * N || !sim_crosses(f, a->v)) break;
            const double share = sim_first_crossing(f, a->v, &event);
            splits = event >= 0 ? splits + 1 : SIM_SPLITS * N;
            piece = (share > SIM_SMALLEST ? share : SIM_SMALLEST) * left;
        }
        if (event >= 0) {
            f->w[event] = 0.0;
            f->mode[event] = 0;
        }
        for (int i = 0; i < n; i++) {
            const double *T = a->table + i * COLUMNS;
            const int64_t m = a->motor[i];
            if (!(T[PRESLIDING] > 0.0)) continue;
            const double force = coulomb(T, a->temp[i], f->w[m], a->load[i], walk[i]), moved = 0.5 * piece * (a->v[m] + f->w[m]);
            for (int e = 0; e < ELEMENTS; e++) {
                double *slip = a->slip + i * ELEMENTS + e;
                *slip = slipped(*slip, moved, force * SHARES[e], T[PRESLIDING] * REACH[e]);
            }
        }
        for (int i = 0; i < N; i++) {
            a->x[i] += 0.5 * piece * (a->v[i] + f->w[i]);
            a->rate[i] = (f->w[i] - a->v[i]) / piece;
            a->v[i] = f->w[i];
        }
        for (int i = 0; i < n; i++) {
            a->load[i] = c->bias[i];
            for (int j = 0; j < n; j++) a->load[i] += c->M[i * n + j] * a->rate[j];
        }
        since += piece;
        left = left - piece < SIM_SMALLEST * h ? 0.0 : left - piece;
    }
}

static double nearest(double x) { return absolute(x) < 2251799813685248.0 ? (x + 6755399441055744.0) - 6755399441055744.0 : x; }

/* One tick's readings and command, logged; tau (n,) is the true motor torque. */
static void control(const StopsetSimArm *a, const StopsetSimScript *s, int64_t k, const double *cold, double *tau, double *const log[6]) {
    const int n = a->arm.n;
    for (int i = 0; i < n; i++) {
        double *T = a->table + i * COLUMNS;
        const int64_t m = a->motor[i], at = k * n + i;
        for (int c = 0; c < 2; c++) T[FC + c] = cold[2 * i + c] / (1.0 + a->film[i]);
        double reading = a->x[m] + T[ENCODER_OFFSET], scale = 1.0;
        if (T[ECCENTRICITY] != 0.0) {
            reading += T[ECCENTRICITY] * stopset_sin(a->x[m] + T[ECCENTRICITY_PHASE]);
            scale += T[ECCENTRICITY] * stopset_cos(a->x[m] + T[ECCENTRICITY_PHASE]);
        }
        reading += s->q_noise[at];
        if (s->resolution > 0.0) reading = nearest(reading / s->resolution) * s->resolution;
        const double speed = a->v[m] * scale + s->dq_noise[at];
        double command = s->feedforward[at];
        command += s->kp[i] * (s->q[at] - reading) + s->kd[i] * (s->dq[at] - speed);
        command = k >= s->cut_at ? 0.0 : limited(command, T[LIMIT]);
        tau[i] = command * T[GAIN];
        const double values[6] = {reading, speed, command, a->temp[i], a->x[i], a->v[i]};
        for (int c = 0; c < 6; c++) log[c][at] = values[c];
    }
}

/* The torque (n,) that acts in a step of length h under the command `tau`: its mean where a drive follows as 1 / (LAG s + 1).
 *
 * `state` (n,): what each drive gives at the step's beginning, afterwards at its end. */
static void followed(const StopsetSimArm *a, const double *tau, double h, double *state, double *acting) {
    for (int i = 0; i < a->arm.n; i++) {
        const double lag = a->table[i * COLUMNS + LAG];
        acting[i] = tau[i];
        if (lag > 0.0) {
            const double left = stopset_exp(-h / lag), off = state[i] - tau[i];
            acting[i] += off * (1.0 - left) * lag / h;
            state[i] = tau[i] + off * left;
        }
    }
}

int stopset_sim_run(const StopsetSimArm *a, const StopsetSimScript *s, const StopsetSimHeat *heat, double *logs) {
    const int n = a->arm.n;
    const int64_t size = s->ticks * n;
    double *const log[6] = {logs, logs + size, logs + 2 * size, logs + 3 * size, logs + 4 * size, logs + 5 * size};
    double cold[2 * SIM_JOINTS], torque[SIM_JOINTS] = {0}, given[SIM_JOINTS], acting[SIM_JOINTS];
    Work c;
    if (n < 1 || n > SIM_JOINTS || a->states < n || a->states > 2 * n) return STOPSET_TOO_MANY_JOINTS;
    memset(&c, 0, sizeof c);
    c.f.n = a->states;
    for (int i = 0; i < n; i++) memcpy(cold + 2 * i, a->table + i * COLUMNS + FC, 2 * sizeof *cold);
    const double h = s->period / (double)s->steps_per_tick;
    for (int64_t k = 0; k < s->ticks; k++) {
        control(a, s, k, cold, torque, log);
        const double since = k >= s->brake_at ? (double)(k - s->brake_at) * s->period : BRAKES_OPEN;
        if (k == 0 || k == s->cut_at) memcpy(given, torque, (size_t)n * sizeof *given); /* no power, no torque */
        for (int64_t step = 0; step < s->steps_per_tick; step++) {
            followed(a, torque, h, given, acting);
            advance(a, &c, acting, s->walk + k * n, since + (double)step * h, h);
        }
        for (int i = 0; i < n; i++) {
            const double *T = a->table + i * COLUMNS, v = absolute(a->v[a->motor[i]]), power = v * (T[FC] + T[FV] * v);
            a->temp[i] += s->period * (heat->heating[i] * power - heat->cooling * (a->temp[i] - heat->ambient));
            a->film[i] += s->period / T[FILM_TIME] * (T[FILM_HEAT] * power - a->film[i]);
        }
    }
    return STOPSET_OK;
}
