/* Dry friction: a joint either slides against full friction, or it sticks and does not move.
 *
 *     A w + p = b,    p_i in [-minus_i, plus_i],   p_i = plus_i if w_i > 0,   p_i = -minus_i if w_i < 0
 *
 * A is symmetric positive definite, w the velocity at the end of the step, p the friction impulses: the optimality condition
 * of a strictly convex problem, so there is exactly one solution; sticking joints get w_i = 0 to the bit.
 *
 * Source: Moreau (1988); Tseng (2001) for the convergence of coordinate descent on such a problem.
 */
#include <math.h>
#include <string.h>

#include "simulation.h"

enum { SWEEPS = 400, CHECK_EVERY = 3 }; /* coordinate descent gains a digit in a few sweeps: the end is never reached */
static const double ROUNDING = 1e-12;   /* complementarity is accepted within this fraction of the impulses' scale */

static double absolute(double x) { return x < 0.0 ? -x : x; }
static double larger(double a, double b) { return a > b ? a : b; }

/* The moving joints with all others at rest, by Cholesky; whether the answer satisfies the inclusion. */
static int solve_moving(SimFriction *f) {
    const int n = f->n, *mode = f->mode;
    const double *A = f->A, *b = f->b, *plus = f->plus, *minus = f->minus;
    double *L = f->L, *w = f->w, scale = 0.0;
    for (int i = 0; i < n; i++) scale = larger(larger(scale, absolute(b[i])), larger(plus[i], minus[i]));
    for (int i = 0; i < n; i++) {
        if (mode[i] == 0) {
            w[i] = 0.0;
            continue;
        }
        double r = b[i] - (mode[i] > 0 ? plus[i] : -minus[i]), d = A[i * n + i];
        for (int j = 0; j < i; j++) {
            if (mode[j] == 0) continue;
            double s = A[i * n + j];
            for (int k = 0; k < j; k++)
                if (mode[k] != 0) s -= L[i * n + k] * L[j * n + k];
            L[i * n + j] = s / L[j * n + j];
            r -= L[i * n + j] * w[j];
        }
        for (int k = 0; k < i; k++)
            if (mode[k] != 0) d -= L[i * n + k] * L[i * n + k];
        L[i * n + i] = sqrt(d);
        w[i] = r / L[i * n + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        if (mode[i] == 0) continue;
        double s = w[i];
        for (int k = i + 1; k < n; k++)
            if (mode[k] != 0) s -= L[k * n + i] * w[k];
        w[i] = s / L[i * n + i];
    }
    for (int i = 0; i < n; i++) {
        if (mode[i] != 0) {
            if (w[i] * mode[i] < 0.0 && plus[i] + minus[i] > 0.0) return 0;
            continue;
        }
        double r = b[i];
        for (int j = 0; j < n; j++) r -= A[i * n + j] * w[j];
        if (r > plus[i] + ROUNDING * scale || r < -minus[i] - ROUNDING * scale) return 0;
    }
    return 1;
}

/* `mode` holds the guess who moves which way (-1, 0, 1) and afterwards the answer; 1 when solved to rounding. */
int sim_solve(SimFriction *f) {
    const int n = f->n;
    double x[SIM_STATES]; /* the descent's own iterate: a wrong guess of who moves must not throw it back */
    if (solve_moving(f)) return 1;
    memcpy(x, f->w, sizeof x);
    for (int sweep = 1; sweep <= SWEEPS; sweep++) {
        for (int i = 0; i < n; i++) {
            double r = f->b[i];
            for (int j = 0; j < n; j++)
                if (j != i) r -= f->A[i * n + j] * x[j];
            f->mode[i] = r > f->plus[i] ? 1 : r < -f->minus[i] ? -1 : 0;
            x[i] = f->mode[i] > 0 ? (r - f->plus[i]) / f->A[i * n + i] : f->mode[i] < 0 ? (r + f->minus[i]) / f->A[i * n + i] : 0.0;
        }
        if (sweep % CHECK_EVERY == 0 && solve_moving(f)) return 1;
    }
    memcpy(f->w, x, sizeof x);
    return 0;
}

/* The share of a step after which the first sliding joint comes to zero speed; 1 and joint -1 for none. Friction of the
 * sliding joints keeps its direction here, also beyond zero. Overwrites b, plus, minus, w, mode. */
double sim_first_crossing(SimFriction *f, const double *v, int *joint) {
    double share = 1.0;
    *joint = -1;
    for (int i = 0; i < f->n; i++) {
        if (v[i] == 0.0 || v[i] != v[i]) continue;
        f->b[i] -= v[i] > 0.0 ? f->plus[i] : -f->minus[i];
        f->plus[i] = f->minus[i] = 0.0;
        f->mode[i] = v[i] > 0.0 ? 1 : -1;
    }
    sim_solve(f);
    for (int i = 0; i < f->n; i++)
        if (v[i] != 0.0 && f->w[i] * v[i] <= 0.0) {
            const double here = v[i] / (v[i] - f->w[i]);
            if (here < share) {
                share = here;
                *joint = i;
            }
        }
    return share;
}

/* Does a coordinate with dry friction that moves at v end the step at rest or the other way round? */
int sim_crosses(const SimFriction *f, const double *v) {
    int found = 0;
    for (int i = 0; i < f->n; i++) found |= v[i] != 0.0 && f->w[i] * v[i] <= 0.0 && f->plus[i] + f->minus[i] > 0.0;
    return found;
}

int stopset_sim_inclusion(int n, const double *A, const double *b, const double *plus, const double *minus, int64_t *mode, double *w) {
    SimFriction f;
    if (n < 1 || n > SIM_STATES) return -STOPSET_TOO_MANY_JOINTS;
    f.n = n;
    memcpy(f.A, A, (size_t)(n * n) * sizeof *A);
    memcpy(f.b, b, (size_t)n * sizeof *b);
    memcpy(f.plus, plus, (size_t)n * sizeof *plus);
    memcpy(f.minus, minus, (size_t)n * sizeof *minus);
    for (int i = 0; i < n; i++) f.mode[i] = (int)mode[i];
    memset(f.w, 0, sizeof f.w);
    const int solved = sim_solve(&f);
    for (int i = 0; i < n; i++) mode[i] = f.mode[i];
    memcpy(w, f.w, (size_t)n * sizeof *w);
    return solved;
}
