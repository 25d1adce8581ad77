/* What a ramp that works asks of the drives: the largest torques of links and rotors over all states that it can begin at, all
 * payloads, rotors, starts, values and paces that are known as ranges. Lemma 11 of docs/stops.md. */
#include <math.h>

#include "bound.h"

static const double HAIR = 1e-12; /* of rounding, relative */

/* All values between two numbers. */
typedef struct {
    double lo, hi;
} Range;

static Range product(Range a, Range b) {
    const double p[4] = {a.lo * b.lo, a.lo * b.hi, a.hi * b.lo, a.hi * b.hi};
    const Range out = {least(least(p[0], p[1]), least(p[2], p[3])), most(most(p[0], p[1]), most(p[2], p[3]))};
    return out;
}

static Range sum(Range a, Range b) { return (Range){a.lo + b.lo, a.hi + b.hi}; }

static double sign_of(double x) { return (double)((x > 0.0) - (x < 0.0)); }

/* Accelerations of joint i, from speeds v at the request, on a stretch of time: of its motion, which gets faster or slower by its pace, and
 * of the ramp, between its earliest start and its latest end. */
static Range acceleration(const StopsetRamp *r, int i, Range v, double from, double to) {
    const double fast = most(size_of(v.lo), size_of(v.hi)), slow = v.lo <= 0.0 && v.hi >= 0.0 ? 0.0 : least(size_of(v.lo), size_of(v.hi));
    const double shortest = r->timed ? r->value_lo[i] : slow / r->value_hi[i], longest = r->timed ? r->value_hi[i] : fast / r->value_lo[i];
    const double run = r->control_hi[i] + 0.5 * longest; /* [s] of the programmed motion, at most */
    const Range pace = {least(0.0, r->pace[0]), most(0.0, r->pace[1])}, none = {0.0, 0.0};
    const Range share = {most(0.0, 1.0 + pace.lo * run), 1.0 + pace.hi * run}, own = product(v, pace);
    const int may = to >= r->control_lo[i] && from <= r->control_hi[i] + longest; /* slow down */
    const int must = from >= r->control_hi[i] && to <= r->control_lo[i] + shortest;
    Range ramp = none, at = {r->timed ? 1.0 / r->value_hi[i] : r->value_lo[i], r->timed ? 1.0 / r->value_lo[i] : r->value_hi[i]};
    if (may) {
        const Range back = {sign_of(v.lo), sign_of(v.hi)};
        const Range down = product(product(r->timed ? v : back, at), share);
        ramp = (Range){-down.hi, -down.lo};
        if (!must) ramp = (Range){least(ramp.lo, 0.0), most(ramp.hi, 0.0)};
    }
    return sum(ramp, from <= r->control_hi[i] + longest ? own : none);
}

/* L_ab over the box of angles, as in Lemma 4; infinite behind a link that is no body. */
static void roots(const Near *near, const double far[SN], double root[SN][SN]) {
    const Expansion *E = &near->E;
    for (int a = E->n - 1; a >= 0; a--)
        for (int b = a; b < E->n; b++) {
            root[a][b] = E->solid[b] ? E->root[a * E->n + b] : STOPS_INF;
            for (int c = a + 1; c < E->n; c++) root[a][b] += far[c] > 0.0 ? far[c] * root[c][b > c ? b : c] : 0.0;
        }
}

static Range both(Range a, double size) { return (Range){most(a.lo, -size), least(a.hi, size)}; }

/* The links' and rotors' torques at once: M a + g + c over all angles, speeds, payloads, rotors and accelerations of a stretch (Lemma 11). */
static void ask(const Near *near, const double far[SN], const Range a[SN], double *asked) {
    const Local *at = &near->at;
    const int n = at->n;
    double root[SN][SN], pairs[SN], before = 0.0;
    roots(near, far, root);
    for (int m = 0; m < n; m++) { /* |v_k v_l| of all pairs of which m is the last */
        const double v = size_of(at->v[m]) + at->v_rad[m];
        pairs[m] = v * (2.0 * before + v);
        before += v;
    }
    for (int i = 0; i < n; i++) {
        double turning = 0.0;
        for (int m = 0; m < n; m++) turning += pairs[m] > 0.0 ? pairs[m] * root[i][m > i ? m : i] * root[m][m > i ? m : i] : 0.0;
        const Range c = {at->h_lo[i] - at->g_lo[i], at->h_hi[i] - at->g_hi[i]}, g = {at->g_lo[i], at->g_hi[i]};
        Range tau = sum(both(g, near->plant->curvature.load[i] * (1.0 + HAIR)), both(c, turning));
        for (int j = 0; j < n; j++) {
            const int first = j < i ? j : i, last = j < i ? i : j;
            const double M = at->M[i * n + j], off = at->dM[i * n + j], rotor = i == j ? near->plant->rotor[i] + near->plant->rotor_half[i] : 0.0;
            tau = sum(tau, product(both((Range){M - off, M + off}, root[first][last] * root[last][last] + rotor), a[j]));
        }
        asked[i] = most(asked[i], most(-tau.lo, tau.hi));
    }
}

int stopset_ramp_torque(const StopsetPlant *plant, const StopsetRamp *ramp, const StopsetStates *from, const StopsetTube *tube, int64_t steps,
                        double *asked) {
    const int n = plant->arm.n;
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    Near near;
    Range a[SN];
    double q[SN], x_lo[SN], x_hi[SN];
    for (int i = 0; i < n; i++) asked[i] = 0.0;
    for (int64_t k = 0; k < steps; k++) {
        const double *d_lo = tube->d_lo + k * n, *d_hi = tube->d_hi + k * n;
        for (int i = 0; i < n; i++) {
            const double lo = least(d_lo[i], d_lo[n + i]), hi = most(d_hi[i], d_hi[n + i]);
            const Range v = {from->dq[i] - from->dq_radius[i], from->dq[i] + from->dq_radius[i]};
            q[i] = from->q[i] + 0.5 * (lo + hi);
            x_hi[i] = 0.5 * (hi - lo) + from->q_radius[i];
            x_lo[i] = -x_hi[i];
            a[i] = acceleration(ramp, i, v, tube->t[k], tube->t[k + 1]);
        }
        const StopsetBox box = {q, x_lo, x_hi, tube->e_lo + k * n, tube->e_hi + k * n};
        stops_look_at(plant, &box, &stops_whole, 1, &near);
        ask(&near, x_hi, a, asked);
    }
    return STOPSET_OK;
}
