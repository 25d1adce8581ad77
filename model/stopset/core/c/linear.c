/* The linear model: its exact step, and its reachable set as a box hull, age by age.
 *
 *     sup x(t) = E1+ X0.hi + E1- X0.lo + (int K+) U.hi + (int K-) U.lo,    K(t) = e^{At} B,  E1 = e^{At}
 *
 * Identification, monitor and FMU all come through here.
 *
 * Source: Liu & Althoff (2018), eq. (17)-(20), inputs that vary in time, signs of the response respected.
 */
#include <string.h>

#include "stopset.h"

enum { J = STOPSET_JOINTS };

static double absolute(double x) { return x < 0.0 ? -x : x; }
static double smaller(double a, double b) { return a < b ? a : b; }
static double larger(double a, double b) { return a > b ? a : b; }

/* C (n, m) = A (n, k) B (k, m), apart from both. */
static void multiply(int n, int k, int m, const double *A, const double *B, double *restrict C) {
    memset(C, 0, (size_t)(n * m) * sizeof *C);
    for (int r = 0; r < n; r++)
        for (int i = 0; i < k; i++) {
            const double a = A[r * k + i];
            const double *b = B + i * m;
            if (a == 0.0) continue;
            for (int c = 0; c < m; c++) C[r * m + c] += a * b[c];
        }
}

/* F = e^{Ah}, G = int_0^h e^{As} ds, H = int_0^h G ds, (n, n) each: Taylor on a step scaled to norm <= 1/4, then doubling.
 * phi2(2X) = (phi1(X)^2 + 2 phi2(X))/4, phi1(2X) = (phi0 phi1 + phi1)/2, phi0(2X) = phi0^2. */
static void phi(int n, const double *A, double h, double *F, double *G, double *H) {
    double norm = 0.0, factorial = 0.5, scale = h, X[J * J], term[J * J], f0[J * J], f1[J * J], f2[J * J], work[J * J];
    const size_t size = (size_t)(n * n) * sizeof(double);
    int doublings = 0;
    for (int r = 0; r < n; r++) {
        double row = 0.0;
        for (int c = 0; c < n; c++) row += absolute(A[r * n + c]) * absolute(h);
        norm = larger(norm, row);
    }
    for (; norm > 0.25 && doublings < 60; doublings++) {
        norm *= 0.5;
        scale *= 0.5;
    }
    memset(term, 0, size);
    memset(f2, 0, size);
    for (int k = 0; k < n * n; k++) X[k] = A[k] * scale;
    for (int r = 0; r < n; r++) {
        term[r * n + r] = 1.0;
        f2[r * n + r] = 0.5;
    }
    for (int k = 1; k < 18; k++) { /* 0.25^18 / 20! is below 1e-29 */
        multiply(n, n, n, term, X, work);
        memcpy(term, work, size);
        factorial /= k + 2;
        for (int i = 0; i < n * n; i++) f2[i] += factorial * term[i];
    }
    multiply(n, n, n, X, f2, f1);
    for (int r = 0; r < n; r++) f1[r * n + r] += 1.0;
    multiply(n, n, n, X, f1, f0);
    for (int r = 0; r < n; r++) f0[r * n + r] += 1.0;
    for (int d = 0; d < doublings; d++) {
        multiply(n, n, n, f1, f1, work);
        for (int i = 0; i < n * n; i++) f2[i] = 0.25 * (work[i] + 2.0 * f2[i]);
        multiply(n, n, n, f0, f1, work);
        for (int i = 0; i < n * n; i++) f1[i] = 0.5 * (work[i] + f1[i]);
        multiply(n, n, n, f0, f0, work);
        memcpy(f0, work, size);
    }
    for (int i = 0; i < n * n; i++) {
        F[i] = f0[i];
        G[i] = h * f1[i];
        H[i] = h * h * f2[i];
    }
}

int stopset_discretise(int n, const double *Av, const double *Minv, double h, double *Ad, double *Bd) {
    if (n < 1 || n > J) return STOPSET_TOO_MANY_JOINTS;
    const int m = 2 * n;
    double F[J * J], G[J * J], H[J * J], move[J * J], speed[J * J];
    phi(n, Av, h, F, G, H);
    multiply(n, n, n, H, Minv, move);
    multiply(n, n, n, G, Minv, speed);
    memset(Ad, 0, (size_t)(m * m) * sizeof *Ad);
    for (int r = 0; r < n; r++) {
        Ad[r * m + r] = 1.0;
        for (int c = 0; c < n; c++) {
            Ad[r * m + n + c] = G[r * n + c];
            Ad[(n + r) * m + n + c] = F[r * n + c];
            Bd[r * n + c] = move[r * n + c];
            Bd[(n + r) * n + c] = speed[r * n + c];
        }
    }
    return STOPSET_OK;
}

/* One row of the step's matrices at a time: first what the input gives, then the state. */
void stopset_stride(int n, const double *Ad, const double *Bd, const double *x, const double *u, double *out) {
    const int m = 2 * n;
    for (int r = 0; r < m; r++) {
        double sum = 0.0;
        for (int c = 0; c < n; c++) sum += Bd[r * n + c] * u[c];
        for (int c = 0; c < m; c++) sum += Ad[r * m + c] * x[c];
        out[r] = sum;
    }
}

void stopset_predict(int n, const double *Ad, const double *Bd, int64_t N, const double *u, double *x) {
    for (int64_t k = 0; k + 1 < N; k++) stopset_stride(n, Ad, Bd, x + k * 2 * n, u + k * n, x + (k + 1) * 2 * n);
}

/* Parts of a step's numbers, (2n, 2n), (2n, m), (2n, m), (2n, 2n). */
typedef struct {
    double *Ad, *Bd, *B, *growth;
} Parts;

static Parts parts_of(const StopsetLinear *s, double *step) {
    const int n2 = 2 * s->n, nm = n2 * s->inputs;
    const Parts p = {step, step + n2 * n2, step + n2 * n2 + nm, step + n2 * n2 + 2 * nm};
    return p;
}

int64_t stopset_step_room(const StopsetLinear *s) { return 8 * (int64_t)s->n * s->n + 4 * (int64_t)s->n * s->inputs; }

int64_t stopset_response_room(const StopsetLinear *s) {
    return (int64_t)s->inputs * (6 * s->n + 4 * (int64_t)s->rows) + 4 * (int64_t)s->n * s->n;
}

int stopset_linear_step(const StopsetLinear *s, double h, double *step) {
    const int n = s->n, n2 = 2 * n, m = s->inputs;
    const Parts p = parts_of(s, step);
    double size[J * J], F[J * J], G[J * J], H[J * J], own[2 * J * J], turned[J * J];
    if (n < 1 || n > J) return STOPSET_TOO_MANY_JOINTS;
    stopset_discretise(n, s->Av, s->Minv, h, p.Ad, own);
    memset(p.B, 0, (size_t)(n2 * m) * sizeof *p.B);
    if (s->across) {
        multiply(n2, n, m, own, s->across, p.Bd);
        multiply(n, n, m, s->Minv, s->across, p.B + n * m);
    } else {
        memcpy(p.Bd, own, (size_t)(n2 * n) * sizeof *own);
        memcpy(p.B + n * n, s->Minv, (size_t)(n * n) * sizeof *own);
    }
    /* |K'| of the states on the step is below |A| e^{|A| h} |K| of its start */
    for (int k = 0; k < n * n; k++) size[k] = absolute(s->Av[k]);
    phi(n, size, h, F, G, H);
    multiply(n, n, n, size, F, turned);
    memset(p.growth, 0, (size_t)(n2 * n2) * sizeof *p.growth);
    for (int r = 0; r < n; r++)
        for (int c = 0; c < n; c++) {
            p.growth[r * n2 + n + c] = F[r * n + c];
            p.growth[(n + r) * n2 + n + c] = turned[r * n + c];
        }
    return STOPSET_OK;
}

/* L X, (rows, m), of X (2n, m); every state where there is no L. */
static void seen(const StopsetLinear *s, int m, const double *X, double *out) {
    if (s->look)
        multiply(s->rows, 2 * s->n, m, s->look, X, out);
    else
        memcpy(out, X, (size_t)(s->rows * m) * sizeof *out);
}

void stopset_respond(const StopsetLinear *s, double h, const double *step, double *E, double *plus, double *minus, double *work) {
    const int n2 = 2 * s->n, m = s->inputs, rm = s->rows * m;
    const Parts p = parts_of(s, (double *)step);
    double *K = work, *next = K + n2 * m, *push = next + n2 * m, *Ka = push + n2 * m, *Kb = Ka + rm, *whole = Kb + rm, *slope = whole + rm;
    double *moved = slope + rm;
    multiply(n2, n2, m, E, p.B, K);
    multiply(n2, n2, m, E, p.Bd, push);
    multiply(n2, n2, n2, E, p.Ad, moved);
    memcpy(E, moved, (size_t)(n2 * n2) * sizeof *E);
    multiply(n2, n2, m, E, p.B, next);
    seen(s, m, K, Ka);
    seen(s, m, next, Kb);
    seen(s, m, push, whole);
    if (!s->keeps_sign) {
        for (int k = 0; k < n2 * m; k++) K[k] = absolute(K[k]);
        multiply(n2, n2, m, p.growth, K, next);
        memset(slope, 0, (size_t)rm * sizeof *slope);
        for (int r = 0; r < s->rows; r++)
            for (int i = 0; i < n2; i++) {
                const double a = s->look ? absolute(s->look[r * n2 + i]) : r == i ? 1.0 : 0.0;
                for (int c = 0; a != 0.0 && c < m; c++) slope[r * m + c] += a * next[i * m + c];
            }
    }
    for (int k = 0; k < rm; k++) {
        const double a = Ka[k], b = Kb[k];
        double size = absolute(whole[k]);
        if (!s->keeps_sign) {
            /* with both ends on one side, K would need this much slope to reach zero and come back within the step */
            const double most = slope[k] * h;
            if (!(a * b >= 0.0 && absolute(a) + absolute(b) >= most)) size = h * (smaller(absolute(a), absolute(b)) + most);
        }
        plus[k] += 0.5 * (size + whole[k]);
        minus[k] -= 0.5 * (size - whole[k]);
    }
}

int stopset_responses(const StopsetLinear *s, double dt, double *step, double *work, const StopsetResponses *out) {
    double *E1 = out->E1, *plus = out->plus, *minus = out->minus;
    const int n2 = 2 * s->n;
    const int64_t rm = (int64_t)s->rows * s->inputs, rn = (int64_t)s->rows * n2;
    double E[4 * J * J] = {0};
    const int code = stopset_linear_step(s, dt, step);
    if (code) return code;
    for (int i = 0; i < n2; i++) E[i * n2 + i] = 1.0;
    memset(plus, 0, (size_t)rm * sizeof *plus);
    memset(minus, 0, (size_t)rm * sizeof *minus);
    seen(s, n2, E, E1);
    for (int64_t k = 1; k < out->ages; k++) {
        memcpy(plus + k * rm, plus + (k - 1) * rm, (size_t)rm * sizeof *plus);
        memcpy(minus + k * rm, minus + (k - 1) * rm, (size_t)rm * sizeof *minus);
        stopset_respond(s, dt, step, E, plus + k * rm, minus + k * rm, work);
        seen(s, n2, E, E1 + k * rn);
    }
    return STOPSET_OK;
}

/* Least and most of a x, a (m,), over x in [lo, hi]. */
static void range(int m, const double *a, const double *lo, const double *hi, double *least, double *most) {
    *least = *most = 0.0;
    for (int c = 0; c < m; c++) {
        if (a[c] == 0.0) continue;
        *least += a[c] * (a[c] > 0.0 ? lo[c] : hi[c]);
        *most += a[c] * (a[c] > 0.0 ? hi[c] : lo[c]);
    }
}

void stopset_hulls(const StopsetResponses *s, const StopsetSets *sets, double *lo, double *hi) {
    const int states = s->states, inputs = s->inputs;
    const double *E1 = s->E1, *plus = s->plus, *minus = s->minus;
    for (int64_t r = 0; r < s->ages * s->rows; r++, E1 += states, plus += inputs, minus += inputs) {
        range(states, E1, sets->X0_lo, sets->X0_hi, lo + r, hi + r);
        for (int c = 0; c < inputs; c++) {
            lo[r] += plus[c] * sets->U_lo[c] + minus[c] * sets->U_hi[c];
            hi[r] += plus[c] * sets->U_hi[c] + minus[c] * sets->U_lo[c];
        }
    }
}

void stopset_tubes(const StopsetResponses *s, const double *look, const StopsetSets *sets, double *lo, double *hi) {
    const int rows = s->rows, states = s->states;
    const double inf = 1.0 / 0.0;
    stopset_hulls(s, sets, lo, hi);
    for (int r = 0; r < rows; r++) {
        const int free = sets->position_only && r >= rows / 2; /* nothing was promised about speeds */
        double low = sets->V_lo[r % states], high = sets->V_hi[r % states];
        if (look) range(states, look + r * states, sets->V_lo, sets->V_hi, &low, &high);
        for (int64_t k = r; k < s->ages * rows; k += rows) {
            lo[k] += low;
            hi[k] += high;
            /* sums of products and of two numbers per input in double precision, rounded outward */
            const double slack = 0x1p-50 * s->inputs * larger(absolute(lo[k]), absolute(hi[k]));
            lo[k] = free ? -inf : lo[k] - slack;
            hi[k] = free ? inf : hi[k] + slack;
        }
    }
}
