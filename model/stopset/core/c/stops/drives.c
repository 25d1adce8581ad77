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
            if (E->solid[b]) root[a][b] = least(root[a][b], sqrt(near->plant->curvature.size[a]) * (1.0 + HAIR)); /* of all that is behind joint a, in any pose */
        }
}

static Range both(Range a, double size) { return (Range){most(a.lo, -size), least(a.hi, size)}; }

/* The links' and rotors' torque at joint i with what one angle does to M a, g and c at once: Lemma 7's columns, here of one row. `beyond`: of M a. */
static Range shared(const Range a[SN], int n, int i, const Along *M, const Columns *h, double beyond) {
    Range out = {h->middle[i], h->middle[i]};
    double off = h->rest[i] + beyond, scale = size_of(h->middle[i]);
    for (int l = 0; l < n; l++) {
        double column = h->turns[i * SLOPES + l];
        for (int j = 0; j < n; j++) {
            const double slope = M->slope[l / LANES][j < i ? pair(j, i) : pair(i, j)][l % LANES];
            column += slope * 0.5 * (a[j].lo + a[j].hi);
            off += size_of(slope) * 0.5 * (a[j].hi - a[j].lo);
        }
        off += size_of(column) + size_of(h->speeds[i * SLOPES + l]);
    }
    for (int j = 0; j < n; j++) {
        const double own = i == j ? M->own[i] : M->value[i * SN + j];
        out = sum(out, product((Range){own, own}, a[j]));
        scale += size_of(own) * most(-a[j].lo, a[j].hi);
    }
    off += HAIR * (scale + off);
    return (Range){out.lo - off, out.hi + off};
}

/* The links' and rotors' torques at once: M a + g + c over all angles, speeds, payloads, rotors and accelerations of a stretch (Lemma 11); `closely`: by
 * what they share, too. */
static void ask(const Near *near, const double far[SN], const Range a[SN], int closely, double *asked) {
    const Local *at = &near->at;
    const int n = at->n;
    double root[SN][SN], pairs[SN], fast[SN], push[SN], beyond[SN], before = 0.0;
    Along M;
    Columns h;
    roots(near, far, root);
    for (int i = 0; i < n; i++) fast[i] = most(-a[i].lo, a[i].hi);
    if (closely) {
        stops_slopes(near, fast, &M, push, beyond);
        stops_columns(near, &h);
    }
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
            const double middle = at->M[i * n + j], off = at->dM[i * n + j], rotor = i == j ? near->plant->rotor[i] + near->plant->rotor_half[i] : 0.0;
            tau = sum(tau, product(both((Range){middle - off, middle + off}, root[first][last] * root[last][last] + rotor), a[j]));
        }
        if (closely) {
            const Range other = shared(a, n, i, &M, &h, beyond[i]);
            tau = (Range){most(tau.lo, other.lo), least(tau.hi, other.hi)};
        }
        asked[i] = most(asked[i], most(-tau.lo, tau.hi));
    }
}

/* The arm with the least (side -1) or the most (1) of its payload, near the same pose; rotors keep their ranges, roots of inertia those of any payload. */
static void carry(const Expansion *any, double side, const double *rotor_half, Expansion *E) {
    const int n = any->n, nn = n * n;
    E->loaded = 0;
    for (int k = 0; k < nn * n; k++) {
        E->dM[k] = any->dM[k] + side * any->dMp[k];
        E->Gamma[k] = any->Gamma[k] + side * any->Gammap[k];
        E->dMp[k] = E->Gammap[k] = 0.0;
    }
    for (int k = 0; k < nn; k++) {
        const double rotor = k % (n + 1) ? 0.0 : rotor_half[k / (n + 1)];
        E->M[k] = any->M[k] + side * (any->Mp[k] - rotor);
        E->dg[k] = any->dg[k] + side * any->dgp[k];
        E->Mp[k] = rotor;
        E->dgp[k] = 0.0;
    }
    for (int k = 0; k < bends_up_to(n - 1); k++) E->ddM[k] = any->ddM[k] + side * any->ddMp[k];
    for (int i = 0; i < n; i++) {
        E->g[i] = any->g[i] + side * any->gp[i];
        E->gp[i] = 0.0;
    }
}

/* The same for each end of the payload's range: torque is linear in it, so nothing between asks more. */
static void ask_ends(Near *near, const Span *x, const Span *v, const Range a[SN], double *asked) {
    const Expansion any = near->E;
    if (!any.loaded) ask(near, x->hi, a, 1, asked);
    for (int side = -1; any.loaded && side <= 1; side += 2) {
        carry(&any, side, near->plant->rotor_half, &near->E);
        stops_box_terms(near, x, v, &near->at);
        ask(near, x->hi, a, 1, asked);
    }
}

int stopset_ramp_torque(const StopsetPlant *plant, const StopsetRamp *ramp, const StopsetStates *from, const StopsetTube *tube, int64_t steps,
                        const double *have, double *asked) {
    const int n = plant->arm.n;
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    Near near;
    Range a[SN];
    Span x, v;
    double q[SN];
    for (int i = 0; i < n; i++) asked[i] = 0.0;
    for (int64_t k = 0; k < steps; k++) {
        const double *d_lo = tube->d_lo + k * n, *d_hi = tube->d_hi + k * n;
        double here[SN] = {0}, ends[SN] = {0};
        int enough = 1;
        for (int i = 0; i < n; i++) {
            const double lo = least(d_lo[i], d_lo[n + i]), hi = most(d_hi[i], d_hi[n + i]);
            const Range first = {from->dq[i] - from->dq_radius[i], from->dq[i] + from->dq_radius[i]};
            q[i] = from->q[i] + 0.5 * (lo + hi);
            x.hi[i] = 0.5 * (hi - lo) + from->q_radius[i];
            x.lo[i] = -x.hi[i];
            a[i] = acceleration(ramp, i, first, tube->t[k], tube->t[k + 1]);
        }
        stops_span(n, tube->e_lo + k * n, tube->e_hi + k * n, &v);
        const StopsetBox box = {q, x.lo, x.hi, v.lo, v.hi};
        stops_look_at(plant, &box, &stops_whole, 1, &near);
        ask(&near, x.hi, a, 0, here);
        for (int i = 0; i < n; i++) enough &= here[i] <= have[i];
        if (!enough) ask_ends(&near, &x, &v, a, ends);
        for (int i = 0; i < n; i++) asked[i] = most(asked[i], enough ? here[i] : least(here[i], ends[i]));
    }
    return STOPSET_OK;
}
