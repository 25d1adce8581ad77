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

/* Joint k into (or out of) the moving set: A_ff = -M_ff^-1, A_sf = M_sf M_ff^-1, A_ss = Schur complement. */
void stops_pivot(int n, double *A, int k, int into) {
    const double d = 1.0 / A[k * n + k], s = into ? d : -d;
    double row[SN], column[SN];
    for (int i = 0; i < n; i++) {
        row[i] = A[k * n + i];
        column[i] = A[i * n + k];
    }
    for (int i = 0; i < n; i++) { /* row and column k too, which come anew below: no branch in the loops */
        const double c = column[i] * d;
        for (int j = 0; j < n; j++) A[i * n + j] -= c * row[j];
    }
    for (int i = 0; i < n; i++) {
        A[i * n + k] = column[i] * s;
        A[k * n + i] = row[i] * s;
    }
    A[k * n + k] = -d;
}

/* Least of x / (1 + e) over |e| <= d. */
static double least_over(double x, double d) {
    const int up = x >= 0.0;
    if (!up && !(d < 1.0)) return -STOPS_INF;
    return x / (up ? 1.0 + d : 1.0 - d);
}

/* Torque of each joint: any sign that is possible (r), forward (f), backward (b); `later`: dry friction beyond the least. */
typedef struct {
    double r_lo[SN], r_hi[SN], f_lo[SN], f_hi[SN], b_lo[SN], b_hi[SN], later[SN];
} Torque;

static void torques(const Local *at, const Step *s, Torque *t) {
    const int n = at->n;
    for (int i = 0; i < n; i++) {
        double push = 0.0;
        for (int j = 0; j < n; j++)
            if (j != i) push += at->dM[i * n + j] * s->a_far[j];
        t->f_lo[i] = s->s_lo[i] - push - s->B_hi[i];
        t->f_hi[i] = s->s_hi[i] + push - (s->direction[i] >= 0.0 ? s->B_lo[i] : s->B_later[i]);
        t->b_lo[i] = s->s_lo[i] - push + (s->direction[i] <= 0.0 ? s->B_lo[i] : s->B_later[i]);
        t->b_hi[i] = s->s_hi[i] + push + s->B_hi[i];
        t->later[i] = s->B_later[i] - s->B_lo[i];
        const double own = at->dM[i * n + i] * s->a_far[i];
        t->r_lo[i] = (s->plus[i] || !s->minus[i] ? t->f_lo[i] : t->b_lo[i]) - own;
        t->r_hi[i] = (s->minus[i] ? t->b_hi[i] : t->f_hi[i]) + own;
    }
}

/* The hull grows by the accelerations when exactly the joints `inside` move. */
static void visit(const Local *at, const Step *s, const Torque *t, const double *A, const int *inside, double out[RATES][SN]) {
    const int n = at->n;
    for (int i = 0; i < n; i++) {
        double lo = 0.0, hi = 0.0, rested;
        if (!inside[i] && (s->plus[i] || s->minus[i])) continue; /* visited with i moving instead: the same equation */
        for (int j = 0; j < n; j++) {
            if (j == i || !inside[j]) continue;
            const double w = -A[i * n + j], least_of = w * t->r_lo[j], most_of = w * t->r_hi[j];
            lo += w > 0.0 ? least_of : most_of;
            hi += w > 0.0 ? most_of : least_of;
        }
        /* a resting joint would start with this acceleration, were it to start */
        const double w = inside[i] ? -A[i * n + i] : 1.0 / A[i * n + i];
        if (!inside[i]) {
            lo *= w;
            hi *= w;
        }
        /* the joint's own inertia M_ii +- dM_ii scales its answer: a_i (1 + w d) = the rest, |d| <= dM_ii */
        const double d = w * at->dM[i * n + i];
        if (s->zero[i] || s->plus[i]) {
            out[0][i] = least(out[0][i], least_over(lo + w * t->f_lo[i], d));
            out[1][i] = most(out[1][i], -least_over(-hi - w * t->f_hi[i], d));
            out[4][i] = most(out[4][i], -least_over(-hi - w * (t->f_hi[i] - s->own_up[i]), d));
            out[5][i] = least(out[5][i], least_over(lo + w * (t->f_lo[i] + s->own_down[i]), d));
            rested = s->direction[i] >= 0.0 ? t->later[i] : 0.0;
            out[8][i] = most(out[8][i], -least_over(-hi - w * (t->f_hi[i] - rested), d));
        }
        if (s->zero[i] || s->minus[i]) {
            out[2][i] = least(out[2][i], least_over(lo + w * t->b_lo[i], d));
            out[3][i] = most(out[3][i], -least_over(-hi - w * t->b_hi[i], d));
            out[6][i] = most(out[6][i], -least_over(-hi - w * (t->b_hi[i] - s->own_up[i]), d));
            out[7][i] = least(out[7][i], least_over(lo + w * (t->b_lo[i] + s->own_down[i]), d));
            rested = s->direction[i] <= 0.0 ? t->later[i] : 0.0;
            out[9][i] = least(out[9][i], least_over(lo + w * (t->b_lo[i] + rested), d));
        }
    }
}

void stops_accelerations(const Local *at, const Step *s, double out[RATES][SN]) {
    const int n = at->n;
    double A[SN * SN];
    int inside[SN] = {0}, open[SN], count = 0;
    Torque t;
    torques(at, s, &t);
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < n; i++) out[row][i] = is_lower(row) ? STOPS_INF : -STOPS_INF;
    memcpy(A, at->M, (size_t)(n * n) * sizeof *A);
    for (int i = 0; i < n; i++) {
        if (!s->zero[i]) {
            stops_pivot(n, A, i, 1);
            inside[i] = 1;
        } else if (s->plus[i] || s->minus[i])
            open[count++] = i;
    }
    for (int64_t subset = 0;;) {
        visit(at, s, &t, A, inside, out);
        if (++subset >= (int64_t)1 << count) break;
        int bit = 0;
        while (!((subset >> bit) & 1)) bit++;
        stops_pivot(n, A, open[bit], !inside[open[bit]]);
        inside[open[bit]] = !inside[open[bit]];
    }
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < n; i++) {
            const double slack = stopset_rate_rounding * (size_of(out[row][i]) + 1.0);
            out[row][i] += is_lower(row) ? -slack : slack;
        }
}
