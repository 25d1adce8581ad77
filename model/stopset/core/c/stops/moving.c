/* Accelerations of an arm whose joints slide or stick, whoever does which.
 *
 * At almost every time the joints split into moving ones f and resting ones, with acceleration exactly zero for these, and
 * M_ff a_f = r_f. Every subset of the joints whose state is uncertain is visited in Gray-code order, each one pivot from the
 * last.
 *
 * Source: Goodnight (1979) for the sweep operator.
 */
#include <string.h>

#include "stops.h"

const double stopset_rate_rounding = 1e-9; /* relative outward widening */

/* Torque of each joint, any sign that is possible (r), and for each row of accelerations; which joints go forward and backward, and
 * which are visited only where they move. */
typedef struct {
    _Alignas(32) double r_lo[SN], r_hi[SN], of[RATES][SN], own[SN];
    unsigned go[2], move; /* a bit a joint */
} Torque;

UNROLLED void torques(int n, const Local *at, const Step *s, Torque *t) {
    memset(t, 0, sizeof *t);
    for (int i = 0; i < n; i++) {
        double push = 0.0;
        for (int j = 0; j < n; j++)
            if (j != i) push += at->dM[i * n + j] * s->a_far[j];
        const double f_lo = s->s_lo[i] - push - s->B_hi[i], f_hi = s->s_hi[i] + push - (s->direction[i] >= 0.0 ? s->B_lo[i] : s->B_later[i]);
        const double b_lo = s->s_lo[i] - push + (s->direction[i] <= 0.0 ? s->B_lo[i] : s->B_later[i]), b_hi = s->s_hi[i] + push + s->B_hi[i];
        const double later = s->B_later[i] - s->B_lo[i], own = at->dM[i * n + i] * s->a_far[i]; /* dry friction beyond the least */
        const double of[RATES] = {f_lo, f_hi, b_lo, b_hi, f_hi - s->own_up[i], f_lo + s->own_down[i], b_hi - s->own_up[i], b_lo + s->own_down[i],
                                  f_hi - (s->direction[i] >= 0.0 ? later : 0.0), b_lo + (s->direction[i] <= 0.0 ? later : 0.0)};
        for (int row = 0; row < RATES; row++) t->of[row][i] = of[row];
        t->r_lo[i] = (s->plus[i] || !s->minus[i] ? f_lo : b_lo) - own;
        t->r_hi[i] = (s->minus[i] ? b_hi : f_hi) + own;
        t->own[i] = at->dM[i * n + i];
        t->go[0] |= (unsigned)(s->zero[i] | s->plus[i]) << i;
        t->go[1] |= (unsigned)(s->zero[i] | s->minus[i]) << i;
        t->move |= (unsigned)(s->plus[i] | s->minus[i]) << i;
    }
}

/* Answers of the joints from i on, others' part of them apart: w per torque; +-Inf where a joint does not answer. Their own inertia scales them
 * by 1 / (1 + e), |e| <= d < 1, so by `few` to `many`; many is Inf where d is not below 1. What rounding of these two makes is in the slack. */
typedef struct {
    int i;
    Four lo, hi, w, few, many;
} Answers;

UNROLLED void lowers(const Torque *t, const Answers *a, int row, double out[RATES][SN]) {
    const Four x = a->lo + a->w * *(const Four *)(t->of[row] + a->i), small = x * a->few, large = x * a->many, found = BELOW(small, large);
    Four *hull = (Four *)(out[row] + a->i);
    *hull = BELOW(*hull, found);
}

UNROLLED void raises(const Torque *t, const Answers *a, int row, double out[RATES][SN]) {
    const Four x = a->hi + a->w * *(const Four *)(t->of[row] + a->i), small = x * a->few, large = x * a->many, found = ABOVE(small, large);
    Four *hull = (Four *)(out[row] + a->i);
    *hull = ABOVE(*hull, found);
}

/* The hull grows by the accelerations when exactly the joints `inside`, a bit each, move. A: transposed, stride SN. */
UNROLLED void visit(int n, const Torque *t, const double *A, unsigned inside, double out[RATES][SN]) {
    const unsigned answering = inside | ~t->move;
    for (int i = 0; i < n; i += LANES) {
        const unsigned go[2] = {(answering & t->go[0]) >> i & LANE_BITS, (answering & t->go[1]) >> i & LANE_BITS};
        if (!(go[0] | go[1])) continue;
        const Choice place = LANES_FROM(i), here = IN_LANES(inside >> i), used = IN_LANES(answering >> i);
        const Four own = {A[i * (SN + 1)], A[(i + 1) * (SN + 1)], A[(i + 2) * (SN + 1)], A[(i + 3) * (SN + 1)]};
        Four lo = {0}, hi = {0};
        for (int j = 0; j < n; j++) {
            if (!(inside >> j & 1u)) continue;
            const Four w = -*(const Four *)(A + j * SN + i), a = w * t->r_lo[j], b = w * t->r_hi[j], least_of = CHOSEN(w > 0.0, a, b), most_of = CHOSEN(w > 0.0, b, a);
            const Choice other = place != j;
            lo += (Four)((Choice)least_of & other);
            hi += (Four)((Choice)most_of & other);
        }
        /* a resting joint would start with this acceleration, were it to start; else it is visited with i moving instead: the same equation */
        const Four share = CHOSEN(here, -own, 1.0 / own), w = (Four)((Choice)share & used), d = SIZES_OF(w) * *(const Four *)(t->own + i);
        lo = CHOSEN(here, lo, lo * w);
        hi = CHOSEN(here, hi, hi * w);
        /* the joint's own inertia M_ii +- dM_ii scales its answer: a_i (1 + w e) = the rest, |e| <= dM_ii */
        const Answers a = {i, CHOSEN(used, lo, FOUR_OF(STOPS_INF)), CHOSEN(used, hi, FOUR_OF(-STOPS_INF)), w, 1.0 / (1.0 + d),
                           CHOSEN(d < 1.0, 1.0 / (1.0 - d), FOUR_OF(STOPS_INF))};
        if (go[0]) {
            lowers(t, &a, 0, out);
            raises(t, &a, 1, out);
            raises(t, &a, 4, out);
            lowers(t, &a, 5, out);
            raises(t, &a, 8, out);
        }
        if (go[1]) {
            lowers(t, &a, 2, out);
            raises(t, &a, 3, out);
            raises(t, &a, 6, out);
            lowers(t, &a, 7, out);
            lowers(t, &a, 9, out);
        }
    }
}

/* What is written in fours is read in fours: a number written alone would have to reach memory before four could be read there. */
UNROLLED void turn_over(int n, double *A, int k, int into) {
    const double d = 1.0 / A[k * SN + k], s = into ? d : -d;
    Four share[GROUPS], column[GROUPS];
    for (int g = 0; g * LANES < n; g++) {
        column[g] = *(const Four *)(A + k * SN + g * LANES);
        share[g] = column[g] * d;
    }
    for (int j = 0; j < n; j++) {
        const double row = A[j * SN + k];
        for (int g = 0; g * LANES < n; g++) {
            const Choice own = LANES_FROM(g * LANES) == k;
            Four *x = (Four *)(A + j * SN + g * LANES), new = *x - share[g] * row, at = FOUR_OF(row * s);
            *x = CHOSEN(own, at, new);
        }
    }
    for (int g = 0; g * LANES < n; g++) {
        const Choice own = LANES_FROM(g * LANES) == k;
        const Four at = FOUR_OF(-d), new = column[g] * s;
        *(Four *)(A + k * SN + g * LANES) = CHOSEN(own, at, new);
    }
}

UNROLLED void accelerations(int n, const Local *at, const Step *s, double out[RATES][SN]) {
    _Alignas(32) double A[SN * SN] = {0};
    unsigned inside = 0;
    int open[SN], count = 0;
    _Alignas(32) Torque t;
    torques(n, at, s, &t);
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < SN; i++) out[row][i] = is_lower(row) ? STOPS_INF : -STOPS_INF;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[j * SN + i] = at->M[i * n + j];
    for (int i = 0; i < n; i++) {
        if (!s->zero[i]) {
            turn_over(n, A, i, 1);
            inside |= 1u << i;
        } else if (s->plus[i] || s->minus[i])
            open[count++] = i;
    }
    for (int64_t subset = 0;;) {
        visit(n, &t, A, inside, out);
        if (++subset >= (int64_t)1 << count) break;
        int bit = 0;
        while (!((subset >> bit) & 1)) bit++;
        turn_over(n, A, open[bit], !(inside >> open[bit] & 1u));
        inside ^= 1u << open[bit];
    }
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < n; i++) {
            const int goes = t.go[is_backward(row)] >> i & 1u; /* else it was carried along with others */
            const double found = goes ? out[row][i] : is_lower(row) ? STOPS_INF : -STOPS_INF, slack = stopset_rate_rounding * (size_of(found) + 1.0);
            out[row][i] = is_lower(row) ? found - slack : found + slack;
        }
}

STOPSET_WIDE void stops_accelerations(const Local *at, const Step *s, double out[RATES][SN]) { SIZED(accelerations, at->n, at, s, out); }

STOPSET_WIDE void stops_turn_over(int n, double *A, int k, int into) { SIZED(turn_over, n, A, k, into); }
