/* Envelopes of deviations: all windows of a trial side by side, age by age, and their extremes.
 *
 * Source: Liu & Althoff (2018), Def. 2, with predictions that start at every sample.
 */
#include "stopset.h"
#include "wide.h"

/* Four numbers at a time; eight keep the machine's arithmetic busy. */
enum { WIDE = 4, UNITS = 2, BLOCK = WIDE * UNITS };

static inline void load(Four *to, const double *x) { memcpy(to, x, sizeof *to); }

static inline void raise(Four *top, const Four *x) {
    const Choice c = *x > *top;
    *top = (Four)((c & (Choice)*x) | (~c & (Choice)*top));
}

static inline void lower(Four *bottom, const Four *x) {
    const Choice c = *x < *bottom;
    *bottom = (Four)((c & (Choice)*x) | (~c & (Choice)*bottom));
}

/* Running extremes. */
typedef struct {
    Four high[UNITS], low[UNITS];
} Lanes;

static inline void begin(Lanes *l, double x) {
    const Four all = {x, x, x, x};
    for (int j = 0; j < UNITS; j++) {
        l->high[j] = all;
        l->low[j] = all;
    }
}

static inline void finish(Lanes *l, double *top, double *bottom) {
    double high[WIDE], low[WIDE];
    for (int j = 1; j < UNITS; j++) {
        raise(&l->high[0], &l->high[j]);
        lower(&l->low[0], &l->low[j]);
    }
    memcpy(high, &l->high[0], sizeof high);
    memcpy(low, &l->low[0], sizeof low);
    for (int j = 1; j < WIDE; j++) {
        high[0] = high[j] > high[0] ? high[j] : high[0];
        low[0] = low[j] < low[0] ? low[j] : low[0];
    }
    *top = high[0] + 0.0; /* a zero's sign is not a difference */
    *bottom = low[0] + 0.0;
}

/* Largest and smallest of x (N > 0). */
static inline void extremes(int64_t N, const double *x, double *top, double *bottom) {
    Lanes l;
    int64_t k = 0;
    Four now;
    begin(&l, x[0]);
    for (; k + BLOCK <= N; k += BLOCK)
        for (int j = 0; j < UNITS; j++) {
            load(&now, x + k + WIDE * j);
            raise(&l.high[j], &now);
            lower(&l.low[j], &now);
        }
    for (; k < N; k++) {
        const Four all = {x[k], x[k], x[k], x[k]};
        raise(&l.high[0], &all);
        lower(&l.low[0], &all);
    }
    finish(&l, top, bottom);
}

STOPSET_WIDE void stopset_extremes(int64_t N, const double *x, double *top, double *bottom) { extremes(N, x, top, bottom); }

/* Windows of one joint a step on, e <- a e + r of position and speed, and the extremes of both. */
static inline void advance(int64_t N, const double *a, const double *const r[2], double *const e[2], Lanes lanes[2]) {
    const double *rq = r[0], *rd = r[1];
    double *eq = e[0], *ed = e[1];
    Lanes *lq = lanes, *ld = lanes + 1;
    const Four a11 = {a[0], a[0], a[0], a[0]}, a12 = {a[1], a[1], a[1], a[1]}, a21 = {a[2], a[2], a[2], a[2]}, a22 = {a[3], a[3], a[3], a[3]};
    int64_t k = 0;
    begin(lq, rq[0] + a[0] * eq[0] + a[1] * ed[0]);
    begin(ld, rd[0] + a[2] * eq[0] + a[3] * ed[0]);
    for (; k + 2 * WIDE <= N; k += 2 * WIDE)
        for (int j = 0; j < 2; j++) {
            const int64_t at = k + WIDE * j;
            Four q, d, fq, fd;
            load(&q, eq + at);
            load(&d, ed + at);
            load(&fq, rq + at);
            load(&fd, rd + at);
            fq = fq + a11 * q + a12 * d;
            fd = fd + a21 * q + a22 * d;
            memcpy(eq + at, &fq, sizeof fq);
            memcpy(ed + at, &fd, sizeof fd);
            raise(&lq->high[j], &fq);
            lower(&lq->low[j], &fq);
            raise(&ld->high[j], &fd);
            lower(&ld->low[j], &fd);
        }
    for (; k < N; k++) {
        const double x = rq[k] + a[0] * eq[k] + a[1] * ed[k], v = rd[k] + a[2] * eq[k] + a[3] * ed[k];
        const Four xs = {x, x, x, x}, vs = {v, v, v, v};
        eq[k] = x;
        ed[k] = v;
        raise(&lq->high[0], &xs);
        lower(&lq->low[0], &xs);
        raise(&ld->high[0], &vs);
        lower(&ld->low[0], &vs);
    }
}

/* `value` is one of x: the last one if it is none before. */
static int64_t first_of(int64_t N, const double *x, double value) {
    int64_t k = 0;
    while (k + 1 < N && x[k] != value) k++;
    return k;
}

/* Column i of the envelope at age h, by the deviations x of all windows of that age. */
static inline void widen(const StopsetEnvelope *env, int64_t h, int64_t i, int64_t N, const double *x, double top, double bottom) {
    const int64_t at = h * env->columns + i;
    if (top > env->hi[at]) {
        env->hi[at] = top;
        env->hi_at[2 * at] = env->trial;
        env->hi_at[2 * at + 1] = first_of(N, x, top);
    }
    if (bottom < env->lo[at]) {
        env->lo[at] = bottom;
        env->lo_at[2 * at] = env->trial;
        env->lo_at[2 * at + 1] = first_of(N, x, bottom);
    }
}

static int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }

STOPSET_WIDE int stopset_widen_decoupled(const StopsetEnvelope *env, int n, const double *a, int64_t N, const double *residual,
                                         int64_t starts, double *work) {
    double *q = work, *d = work + starts, top, bottom;
    for (int j = 0; j < n; j++) {
        memset(work, 0, 2 * (size_t)starts * sizeof *work);
        for (int64_t h = 1; h <= smaller(env->ages - 1, N); h++) {
            const int64_t live = smaller(starts, N - h + 1);
            const double *const r[2] = {residual + j * N + h - 1, residual + (n + j) * N + h - 1};
            Lanes lanes[2];
            advance(live, a + 4 * j, r, (double *const[2]){q, d}, lanes);
            finish(lanes, &top, &bottom);
            widen(env, h, j, live, q, top, bottom);
            finish(lanes + 1, &top, &bottom);
            widen(env, h, n + j, live, d, top, bottom);
        }
    }
    return STOPSET_OK;
}

static inline void add(int64_t N, double *restrict x, double weight, const double *restrict y) {
    if (weight == 0.0) return;
    for (int64_t s = 0; s < N; s++) x[s] += weight * y[s];
}

STOPSET_WIDE int stopset_widen_coupled(const StopsetEnvelope *env, const StopsetLooked *step, int64_t N, const double *residual,
                                       int64_t starts, double *work) {
    const double *Ad = step->Ad, *across = step->across;
    const int n = step->n, k = step->k, m = 2 * n;
    double *e = work, *ahead = work + m * starts, *y = ahead + m * starts, top, bottom;
    memset(e, 0, (size_t)(m * starts) * sizeof *e);
    for (int64_t h = 1; h <= smaller(env->ages - 1, N); h++) {
        const int64_t live = smaller(starts, N - h + 1);
        for (int i = 0; i < m; i++) {
            memcpy(ahead + i * starts, residual + i * N + h - 1, (size_t)live * sizeof *ahead);
            for (int j = 0; j < m; j++) add(live, ahead + i * starts, Ad[i * m + j], e + j * starts);
        }
        double *const old = e;
        e = ahead;
        ahead = old;
        for (int i = 0; i < 2 * k; i++) {
            const double *along = across + i % k * n, *states = i < k ? e : e + n * starts, *x = y;
            int entries = 0, own = 0;
            for (int j = 0; j < n; j++)
                if (along[j] != 0.0) {
                    entries++;
                    own = j;
                }
            if (entries == 1 && along[own] == 1.0)
                x = states + own * starts; /* the direction is a joint */
            else {
                memset(y, 0, (size_t)live * sizeof *y);
                for (int j = 0; j < n; j++) add(live, y, along[j], states + j * starts);
            }
            extremes(live, x, &top, &bottom);
            widen(env, h, i, live, x, top, bottom);
        }
    }
    return STOPSET_OK;
}
