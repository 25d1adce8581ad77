/* Nominal predictions and their sets along a motion: the linear model's march, the two corner simulations of a joint with a
 * friction curve, and the responses of the deviation along a nominal solution.
 *
 * Source: Liu & Althoff (2018), Sec. IV-C; Smith (1995), ch. 3.
 */
#include <string.h>

#include "stopset.h"
#include "wide.h"

static double absolute(double x) { return x < 0.0 ? -x : x; }

void stopset_march(int m, const double *Ad, int64_t N, double *x) {
    for (int64_t k = 0; k + 1 < N; k++, x += m)
        for (int i = 0; i < m; i++)
            for (int j = 0; j < m; j++)
                if (Ad[i * m + j] != 0.0) x[m + i] += Ad[i * m + j] * x[j];
}

/* w - sum_k c_k v^(k+1) */
static inline double accelerate(double v, double w, int orders, const double *c) {
    double drag = 0.0;
    for (int k = orders - 1; k >= 0; k--) drag = (drag + c[k]) * v;
    return w - drag;
}

/* One step of q' = v, v' = w - sum c_k v^(k+1), w held: classical Runge-Kutta in `parts` parts. */
static inline void corner_step(double *q, double *v, double w, int orders, const double *c, double h, int64_t parts) {
    const double d = h / (double)parts;
    for (int64_t part = 0; part < parts; part++) {
        const double k1 = accelerate(*v, w, orders, c), k2 = accelerate(*v + 0.5 * d * k1, w, orders, c),
                     k3 = accelerate(*v + 0.5 * d * k2, w, orders, c), k4 = accelerate(*v + d * k3, w, orders, c);
        *q += d * *v + d * d / 6.0 * (k1 + k2 + k3);
        *v += d / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
    }
}

void stopset_corner(const StopsetJoint *s, double q, double v, int64_t N, const double *w, double *out) {
    out[0] = q;
    out[1] = v;
    for (int64_t k = 0; k < N; k++) {
        corner_step(&q, &v, w[k], s->orders, s->c, s->dt, s->parts);
        out[2 * k + 2] = q;
        out[2 * k + 3] = v;
    }
}

void stopset_corner_excess(const StopsetCorner *s, const StopsetTrial *trial, const StopsetExcess *found) {
    const StopsetJoint *joint = &s->joint;
    const double *x = trial->x, *w = trial->w;
    const int64_t N = trial->N;
    double *best = found->best;
    int64_t *at = found->at;
    uint8_t *outside = found->outside;
    for (int64_t i = 0; i < trial->starts; i++) {
        const int64_t from = trial->start[i], last = s->horizon < N - 1 - from ? s->horizon : N - 1 - from;
        double z[2] = {x[2 * from] + s->dq0, x[2 * from + 1] + s->dv0};
        for (int64_t h = 1; h <= last; h++) {
            corner_step(z, z + 1, w[from + h - 1], joint->orders, joint->c, joint->dt, joint->parts);
            if (!(absolute(z[1]) < s->runaway)) {
                if (s->sign * z[1] < 0.0) { /* gone the wrong way: nothing is enclosed */
                    best[2 * h] = best[2 * h + 1] = 1.0 / 0.0;
                    outside[i] = 1;
                }
                break;
            }
            for (int k = 0; k < 2; k++) {
                const double e = s->sign * (x[2 * (from + h) + k] - z[k]);
                if (e > best[2 * h + k]) {
                    best[2 * h + k] = e;
                    at[2 * (2 * h + k)] = trial->trial;
                    at[2 * (2 * h + k) + 1] = from;
                }
                if (e > s->limit[k]) outside[i] = 1;
            }
        }
    }
}

void stopset_corner_sensitivity(const StopsetJoint *s, double *q, double *v, int64_t N, const double *w, double *S) {
    const double *c = s->c, d = s->dt / (double)s->parts;
    const int orders = s->orders;
    memset(S, 0, 6 * sizeof *S);
    S[0] = S[4] = 1.0;
    for (int64_t k = 0; k < N; k++)
        for (int64_t part = 0; part < s->parts; part++) {
            const double before = *v;
            corner_step(q, v, w[k], orders, c, d, 1);
            const double middle = 0.5 * (before + *v);
            double a = 0.0, power = 1.0;
            for (int i = 0; i < orders; i++, power *= middle) a += (i + 1) * c[i] * power;
            const double z = a * d, decay = stopset_exp(-z);
            /* integrals over the step of e^-at, and of that again; series where the difference would cancel */
            const double one = absolute(z) < 1e-4 ? d * (1.0 - z / 2.0 + z * z / 6.0) : (1.0 - decay) / a;
            const double two = absolute(z) < 1e-4 ? d * d * (0.5 - z / 6.0) : (d - one) / a;
            S[1] += S[4] * one;
            S[4] *= decay;
            S[2] += S[5] * one + two;
            S[5] = S[5] * decay + one;
        }
}

/* C (n, m) = A (n, k) B (k, m), apart from both. */
static inline void multiply(int n, int k, int m, const double *A, const double *B, double *C) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            double total = 0.0;
            for (int l = 0; l < k; l++) total += A[i * k + l] * B[l * m + j];
            C[i * m + j] = total;
        }
}

enum { TERMS = STOPSET_TERMS, M = 2 * STOPSET_JOINTS };

/* e^{A dt} and its integral. */
static void one_step(int m, const double *A, double dt, double *step, double *integral) {
    double term[M * M], moved[M * M];
    memset(step, 0, (size_t)(m * m) * sizeof *step);
    memset(integral, 0, (size_t)(m * m) * sizeof *integral);
    for (int i = 0; i < m; i++) {
        step[i * m + i] = 1.0;
        integral[i * m + i] = dt;
    }
    memcpy(term, step, (size_t)(m * m) * sizeof *term);
    for (int k = 1; k < TERMS; k++) {
        multiply(m, m, m, term, A, moved);
        for (int i = 0; i < m * m; i++) {
            term[i] = moved[i] * (dt / k);
            step[i] += term[i];
            integral[i] += term[i] * (dt / (k + 1));
        }
    }
}

enum { STRIPE = 128 };

/* X (m, N) of N columns, rows `stride` apart, times `step` (m, m) from the left, in place; sums run as in `multiply`. */
STOPSET_WIDE static void advance(int m, const double *step, int64_t N, int64_t stride, double *X) {
    double moved[M * STRIPE];
    for (int64_t from = 0; from < N; from += STRIPE) {
        const int width = (int)(N - from < STRIPE ? N - from : STRIPE);
        memset(moved, 0, (size_t)(m * STRIPE) * sizeof *moved);
        for (int i = 0; i < m; i++)
            for (int l = 0; l < m; l++) {
                const double factor = step[i * m + l], *x = X + l * stride + from;
                double *y = moved + i * STRIPE;
                for (int c = 0; c < width; c++) y[c] += factor * x[c];
            }
        for (int i = 0; i < m; i++) memcpy(X + i * stride + from, moved + i * STRIPE, (size_t)width * sizeof *moved);
    }
}

/* Adds the responses of one step, (s, n) at its start, its end and over it, to their positive and negative parts. */
STOPSET_WIDE static void add_signed(int64_t steps, int n, double dt, const double *const of[3], double *p, double *q) {
    const double *start = of[0], *end = of[1], *whole = of[2];
    for (int64_t s = 0; s < steps; s++, start += n, end += n, whole += n)
        for (int j = 0; j < n; j++) {
            const double a = start[j], b = end[j], total = whole[j], larger = absolute(a) > absolute(b) ? absolute(a) : absolute(b);
            const double size = absolute(total), turned = dt * larger > size ? dt * larger : size;
            const double most = a * b >= 0.0 ? size : turned;
            p[j] += 0.5 * (most + total);
            q[j] -= 0.5 * (most - total);
        }
}

int stopset_along(int n, int64_t H, const double *J_x, const double *J_u, double dt, const StopsetResponses *out, double *work) {
    if (n < 1 || n > STOPSET_JOINTS) return STOPSET_TOO_MANY_JOINTS;
    const int m = 2 * n, mn = m * n, mm = m * m;
    double A[M * M], B[M * STOPSET_JOINTS], step[M * M], integral[M * M], column[M * STOPSET_JOINTS];
    const int64_t stride = H * n; /* rows of one state: a step's n torques, step after step */
    double *start = work, *end = work + H * mn, *whole = work + 2 * H * mn, *E1 = out->E1, *plus = out->plus, *minus = out->minus;
    memset(A, 0, sizeof A);
    memset(B, 0, sizeof B);
    memset(E1, 0, (size_t)mm * sizeof *E1);
    memset(plus, 0, (size_t)((H + 1) * mn) * sizeof *plus);
    memset(minus, 0, (size_t)((H + 1) * mn) * sizeof *minus);
    for (int i = 0; i < m; i++) E1[i * m + i] = 1.0;
    for (int i = 0; i < n; i++) A[i * m + n + i] = 1.0;
    for (int64_t k = 0; k < H; k++) {
        for (int i = 0; i < n * m; i++) A[n * m + i] = 0.5 * (J_x[k * n * m + i] + J_x[(k + 1) * n * m + i]);
        for (int i = 0; i < n * n; i++) B[n * n + i] = 0.5 * (J_u[k * n * n + i] + J_u[(k + 1) * n * n + i]);
        one_step(m, A, dt, step, integral);
        multiply(m, m, m, step, E1 + k * mm, E1 + (k + 1) * mm);
        advance(m, step, k * n, stride, start);
        advance(m, step, k * n, stride, end);
        advance(m, step, k * n, stride, whole);
        multiply(m, m, n, step, B, column);
        for (int i = 0; i < m; i++) memcpy(start + i * stride + k * n, column + i * n, (size_t)n * sizeof *column);
        for (int i = 0; i < m; i++) memcpy(end + i * stride + k * n, B + i * n, (size_t)n * sizeof *column);
        multiply(m, m, n, integral, B, column);
        for (int i = 0; i < m; i++) memcpy(whole + i * stride + k * n, column + i * n, (size_t)n * sizeof *column);
        double *p = plus + (k + 1) * mn, *q = minus + (k + 1) * mn;
        for (int i = 0; i < m; i++) {
            const double *const of[3] = {start + i * stride, end + i * stride, whole + i * stride};
            add_signed(k + 1, n, dt, of, p + i * n, q + i * n);
        }
    }
    return STOPSET_OK;
}

void stopset_remember(int64_t N, const double *b, const double *a, const double *dt, const uint8_t *first, double start, double *z) {
    for (int64_t k = 0; k < N; k++) {
        if (k == 0 || first[k]) {
            z[k] = start;
            continue;
        }
        const double x = a[k - 1] * dt[k - 1], grown = absolute(x) >= 1e-12 ? stopset_expm1(x) / x : 1.0;
        z[k] = z[k - 1] + (b[k - 1] + a[k - 1] * z[k - 1]) * dt[k - 1] * grown;
    }
}
