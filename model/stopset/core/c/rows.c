/* The diagnosis' rows: smoothing, whitening, ripples, and the swing of an elastic link.
 *
 * Source: Ljung (1999) for the whitening; Spong (1987) for the link on a spring.
 */
#include <string.h>

#include "maths.h"
#include "stopset.h"
#include "wide.h"

void stopset_calm(int64_t N, const double *x, const uint8_t *first, double *out) {
    static const double weights[5] = {0.2, 0.18, 0.13, 0.07, 0.02};
    int64_t lo = 0;
    for (int64_t k = 0; k < N; k++) {
        if (first[k]) lo = k;
        double total = weights[0] * x[k], norm = weights[0];
        for (int s = 1; s < 5; s++) {
            if (k - s < lo || k + s >= N || first[k + s]) break;
            total += weights[s] * (x[k - s] + x[k + s]);
            norm += 2 * weights[s];
        }
        out[k] = total / norm;
    }
}

int stopset_weighted(int64_t N, int64_t columns, const double *x, int64_t rows, const int64_t *centre, const StopsetKernel *kernel,
                     double *out) {
    const int64_t width = kernel->width;
    const double *h = kernel->h;
    memset(out, 0, (size_t)(rows * columns) * sizeof *out);
    for (int64_t r = 0; r < rows; r++, out += columns) {
        const int64_t from = centre[r] - width / 2;
        if (from < 0 || from + width > N) return STOPSET_OUT_OF_RANGE;
        for (int64_t k = 0; k < width; k++)
            for (int64_t c = 0; c < columns; c++) out[c] += h[k] * x[(from + k) * columns + c];
    }
    return STOPSET_OK;
}

void stopset_whiten(const StopsetPredictor *p, int64_t N, int64_t columns, const double *X, const uint8_t *start, double *out) {
    const int64_t order = p->order;
    int64_t run = 0;
    for (int64_t k = 0; k < N; k++) {
        run = start[k] ? 0 : run + 1;
        const int64_t m = run < order ? run : order, at = p->kind[k] * (order + 1) + m;
        for (int64_t c = 0; c < columns; c++) {
            double e = X[k * columns + c];
            for (int64_t i = 0; i < m; i++) e -= p->a[at * order + i] * X[(k - 1 - i) * columns + c];
            out[k * columns + c] = e / p->sd[at];
        }
    }
}

void stopset_coloured(const StopsetPredictor *p, int64_t N, const double *e, const uint8_t *start, double *out) {
    const int64_t order = p->order;
    int64_t run = 0;
    for (int64_t k = 0; k < N; k++) {
        run = start[k] ? 0 : run + 1;
        const int64_t m = run < order ? run : order, at = p->kind[k] * (order + 1) + m;
        double x = e[k] * p->sd[at];
        for (int64_t i = 0; i < m; i++) x += p->a[at * order + i] * out[k - 1 - i];
        out[k] = x;
    }
}

void stopset_whiten_adjoint(const StopsetPredictor *p, int64_t N, const double *r, const uint8_t *start, double *out) {
    const int64_t order = p->order;
    int64_t run = 0;
    memset(out, 0, (size_t)N * sizeof *out);
    for (int64_t k = 0; k < N; k++) {
        run = start[k] ? 0 : run + 1;
        const int64_t m = run < order ? run : order, at = p->kind[k] * (order + 1) + m;
        const double e = r[k] / p->sd[at];
        out[k] += e;
        for (int64_t i = 0; i < m; i++) out[k - 1 - i] -= p->a[at * order + i] * e;
    }
}

/* exp(-fade n^2) times sine and cosine of n q for evenly spaced n: each from the one before it. */
static void waves(double q, double fade, int64_t R, double n, double step, double *s, double *c) {
    double turn_s, turn_c, now_s, now_c;
    stopset_sincos(step * q, &turn_s, &turn_c);
    stopset_sincos(n * q, &now_s, &now_c);
    double size = stopset_exp(-fade * n * n), ratio = stopset_exp(-fade * step * (2 * n + step));
    const double fall = stopset_exp(-2 * fade * step * step);
    for (int64_t m = 0; m < R; m++) {
        s[m] = size * now_s;
        c[m] = size * now_c;
        const double next = now_s * turn_c + now_c * turn_s;
        now_c = now_c * turn_c - now_s * turn_s;
        now_s = next;
        size *= ratio;
        ratio *= fall;
    }
}

STOPSET_WIDE void stopset_ripple_products(const StopsetRipples *ripples, const double *r, double *work, double *restrict a, double *restrict b) {
    const int64_t N = ripples->N, R = ripples->R;
    double *s = work, *c = work + R;
    memset(a, 0, (size_t)R * sizeof *a);
    memset(b, 0, (size_t)R * sizeof *b);
    for (int64_t k = 0; k < N; k++) {
        waves(ripples->q[k], ripples->fade[k], R, ripples->n, ripples->step, s, c);
        for (int64_t m = 0; m < R; m++) {
            a[m] += r[k] * s[m];
            b[m] += r[k] * c[m];
        }
    }
}

STOPSET_WIDE void stopset_ripple_power(const StopsetPredictor *p, const StopsetRipples *ripples, const uint8_t *start, double *work,
                                       double *restrict ss, double *restrict cc, double *restrict sc) {
    const int64_t N = ripples->N, R = ripples->R;
    const int64_t order = p->order, ring = order + 1; /* the last rows stand in a ring */
    double *s = work, *c = s + ring * R, *restrict x = c + ring * R, *restrict y = x + R;
    const size_t row = (size_t)R * sizeof *x;
    int64_t run = 0;
    memset(ss, 0, row);
    memset(cc, 0, row);
    memset(sc, 0, row);
    for (int64_t k = 0; k < N; k++) {
        run = start[k] ? 0 : run + 1;
        const int64_t m = run < order ? run : order, at = p->kind[k] * (order + 1) + m, here = k % ring;
        waves(ripples->q[k], ripples->fade[k], R, ripples->n, ripples->step, s + here * R, c + here * R);
        memcpy(x, s + here * R, row);
        memcpy(y, c + here * R, row);
        for (int64_t i = 0; i < m; i++) {
            const double weight = p->a[at * order + i], *before = s + (k - 1 - i) % ring * R, *beside = c + (k - 1 - i) % ring * R;
            for (int64_t j = 0; j < R; j++) {
                x[j] -= weight * before[j];
                y[j] -= weight * beside[j];
            }
        }
        const double scale = 1.0 / (p->sd[at] * p->sd[at]);
        for (int64_t j = 0; j < R; j++) {
            ss[j] += scale * x[j] * x[j];
            cc[j] += scale * y[j] * y[j];
            sc[j] += scale * x[j] * y[j];
        }
    }
}

/* One step of Newmark's rule, h [s] long, of four links. */
UNROLLED void newmark(const Four *force, const Four *m, const Four *stiff, double D, double h, Four *x, Four *dx) {
    const Four ddx = (*force - D * *dx - *stiff * (*x + 0.5 * h * *dx)) / (*m + 0.5 * h * D + 0.25 * h * h * *stiff);
    *x = *x + h * *dx + 0.5 * h * h * ddx;
    *dx = *dx + h * ddx;
}

/* Four runs of rows: a run is a trial, or what is before the first one. */
typedef struct {
    int64_t from[4], to[4];
} Runs;

/* The first row of the run after that of row k. */
static int64_t run_end(const StopsetSwing *s, int64_t N, int64_t k) {
    for (k++; k < N && !s->first[k];) k++;
    return k;
}

/* As `stopset_swung`, of four runs side by side: a step waits for the one before it, not for another run's. A lane beyond its end stays there. */
STOPSET_WIDE static void swung_four(const StopsetSwing *s, int64_t N, const Runs *runs, const double *link, const double *x0,
                                    const double *dx0, double *out) {
    const int parts = s->parts;
    const double h = s->dt / parts;
    int64_t longest = 0;
    for (int i = 0; i < 4; i++) longest = runs->to[i] - runs->from[i] > longest ? runs->to[i] - runs->from[i] : longest;
    Four x = {0}, dx = {0}, M = {0}, force = {0};
    for (int64_t r = 0; r < longest; r++) {
        Four M_now, force_now, stiff;
        for (int i = 0; i < 4; i++) {
            const int64_t last = runs->to[i] - 1, k = runs->from[i] + r < last ? runs->from[i] + r : last;
            M_now[i] = s->M[k], force_now[i] = link[k], stiff[i] = s->K + s->g[k];
            if (r == 0 && s->first[k]) x[i] = x0[k], dx[i] = dx0[k];
        }
        for (int part = 0; r > 0 && part < parts; part++) {
            const double w = (part + 0.5) / parts;
            const Four pull = -(force + w * (force_now - force)), m = M + w * (M_now - M);
            newmark(&pull, &m, &stiff, s->D, h, &x, &dx);
        }
        const Four ddx = (-force_now - s->D * dx - stiff * x) / M_now;
        for (int i = 0; i < 4; i++) {
            const int64_t k = runs->from[i] + r;
            if (k < runs->to[i]) out[k] = x[i], out[N + k] = dx[i], out[2 * N + k] = ddx[i];
        }
        M = M_now, force = force_now;
    }
}

void stopset_swung(const StopsetSwing *s, int64_t N, const double *link, const double *x0, const double *dx0, double *out) {
    for (int64_t k = 0; k < N;) {
        Runs runs;
        for (int i = 0; i < 4; i++) {
            const int64_t from = k < N ? k : runs.from[0]; /* fewer are left: the first of them more than once */
            runs.from[i] = from, runs.to[i] = run_end(s, N, from);
            if (k < N) k = runs.to[i];
        }
        swung_four(s, N, &runs, link, x0, dx0, out);
    }
}

void stopset_led(const StopsetSwing *s, int64_t N, const double *link, const double *rest, int64_t steps, double *x0, double *dx0) {
    const double h = s->dt / s->parts;
    for (int64_t k = 0; k < N; k++) {
        const double stiff = s->K + s->g[k];
        x0[k] = dx0[k] = 0.0;
        if (!s->first[k]) continue;
        if (rest[k] != rest[k]) {
            x0[k] = -link[k] / stiff;
            continue;
        }
        const Four pull = FOUR_OF(-link[k]), m = FOUR_OF(s->M[k]), stiffness = FOUR_OF(stiff);
        Four x = FOUR_OF(-rest[k] / stiff), dx = {0};
        for (int64_t i = 0; i < steps; i++) newmark(&pull, &m, &stiffness, s->D, h, &x, &dx);
        x0[k] = x[0], dx0[k] = dx[0];
    }
}
