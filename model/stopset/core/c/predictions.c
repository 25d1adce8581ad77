/* Predictions from past samples: all of them one step on, and a new sample against each at its age.
 *
 * Most rows are well inside. Which are not is seen from few operations that compilers make into vectors, and only those are
 * looked at with all roundings in place; so what is told has the same bits as if every row had been.
 *
 * Source: Liu & Althoff (2018), Def. 2 and eq. (17)-(21).
 */
#include <string.h>

#include "stopset.h"
#include "wide.h"

enum { J = STOPSET_JOINTS, X = 2 * STOPSET_JOINTS };

static const double inf = 1.0 / 0.0, least = 1e-300;

static double absolute(double x) { return x < 0.0 ? -x : x; }

/* One step for every row: residual and growth of what is unknown (2n,), and the matrices of the states' own step: where a joint's
 * position and speed depend on nothing but these two, rows (4, n) of position by position and speed, speed by position and
 * speed, and their sizes; else columns of Ad (2n, 2n) and their sizes. `look` (2n,): part of `reach` beyond which a row is looked
 * at closely. `final`: what is outside is counted, else only the distance to the bounds is taken. */
typedef struct {
    int decoupled, widen, outside, final;
    double residual[X], growth[X], look[X], worst[2][X], own[X * X], size[X * X];
} Step;

static int on_their_own(const StopsetPredictions *s, double *own) {
    const int n = s->states / 2, n2 = 2 * n;
    for (int i = 0; i < n2; i++)
        for (int j = 0; j < n2; j++)
            if (s->Ad[i * n2 + j] != 0.0 && j % n != i % n) return 0;
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 4; k++) own[k * n + i] = s->Ad[(k / 2 * n + i) * n2 + k % 2 * n + i];
    return 1;
}

void stopset_centre(const StopsetPredictions *s) {
    for (int64_t k = 0; k < s->ages * s->states; k++) {
        const double lo = s->lo[k], hi = s->hi[k], size = absolute(lo) > absolute(hi) ? absolute(lo) : absolute(hi);
        const int bounded = size < inf;
        s->middle[k] = bounded ? 0.5 * lo + 0.5 * hi : 0.0;
        /* less by what rounding of these, and of a difference to them, may amount to */
        s->reach[k] = bounded ? 0.5 * hi - 0.5 * lo - 0x1p-49 * size : lo == -inf && hi == inf ? inf : -inf;
    }
}

/* Two states at once: what compilers do not see in loops as short as these. */
typedef double Pair __attribute__((vector_size(16)));
typedef int64_t Pair_of_flags __attribute__((vector_size(16)));

UNROLLED Pair two(const double *x) {
    Pair out;
    memcpy(&out, x, sizeof out);
    return out;
}

/* e <- own e + r. */
UNROLLED void step_decoupled(const int n, const double *own, const double *r, double *e) {
    int i = 0;
    for (; i + 1 < n; i += 2) {
        const Pair q = two(e + i), v = two(e + n + i);
        const Pair next_q = two(r + i) + two(own + i) * q + two(own + n + i) * v;
        const Pair next_v = two(r + n + i) + two(own + 2 * n + i) * q + two(own + 3 * n + i) * v;
        memcpy(e + i, &next_q, sizeof next_q);
        memcpy(e + n + i, &next_v, sizeof next_v);
    }
    for (; i < n; i++) {
        const double q = e[i], v = e[n + i];
        e[i] = r[i] + own[i] * q + own[n + i] * v;
        e[n + i] = r[n + i] + own[2 * n + i] * q + own[3 * n + i] * v;
    }
}

UNROLLED void step_coupled(const int n2, const double *columns, const double *r, double *restrict e) {
    double new[X];
    for (int i = 0; i < n2; i++) new[i] = r[i];
    for (int j = 0; j < n2; j++)
        for (int i = 0; i < n2; i++) new[i] += columns[j * n2 + i] * e[j];
    for (int i = 0; i < n2; i++) e[i] = new[i];
}

UNROLLED void step_row(const Step *step, const int n, const int decoupled, double *e, double *w) {
    if (decoupled) {
        step_decoupled(n, step->own, step->residual, e);
        if (step->widen) step_decoupled(n, step->size, step->growth, w);
    } else {
        step_coupled(2 * n, step->own, step->residual, e);
        if (step->widen) step_coupled(2 * n, step->size, step->growth, w);
    }
}

/* What of row p is outside its bounds low, high (2n,), held against the worst so far. */
static void contradict(const StopsetPredictions *s, int64_t p, const double *e, const double *low, const double *high, Step *step) {
    const int n2 = s->states;
    for (int i = 0; i < n2; i++) {
        const double width = high[i] - low[i], over = e[i] - high[i], under = low[i] - e[i];
        /* written so that what is not a number is outside */
        if (!(over <= 0.0 || high[i] == inf) && !(over / width <= step->worst[0][i])) {
            step->worst[0][i] = over / width;
            s->row[i] = p;
        }
        if (!(under <= 0.0 || low[i] == -inf) && !(under / width <= step->worst[1][i])) {
            step->worst[1][i] = under / width;
            s->row[n2 + i] = p;
        }
    }
}

/* Row p against the tube at its age. */
UNROLLED void look_closely(const StopsetPredictions *s, const int n2, int64_t p, int64_t age, const double *e, const double *w, Step *step) {
    const double *lo = s->lo + age * n2, *hi = s->hi + age * n2;
    double low[X], high[X], room[X];
    int inside = 1, nearer = 0;
    for (int i = 0; i < n2; i++) { /* without a branch, so that divisions are made two at a time */
        low[i] = lo[i] - w[i];
        high[i] = hi[i] + w[i];
        const double over = e[i] - high[i], under = low[i] - e[i];
        room[i] = -2.0 * (over > under ? over : under) / (high[i] - low[i]);
        inside &= (over <= 0.0) & (under <= 0.0);
    }
    if (step->final && !inside) contradict(s, p, e, low, high, step);
    for (int i = 0; i < n2; i++) nearer |= room[i] < s->room[i];
    if (!nearer) return;
    for (int i = 0; i < n2; i++) {
        const double width = high[i] - low[i];
        if (!(width > 0.0 && width < inf && room[i] < s->room[i])) continue;
        s->room[i] = room[i];
        s->nearest[i] = p;
        /* less by more than the divisions round; what is outside is looked at in any case */
        const double part = (1.0 - room[i]) * (1.0 - 1e-9) - 1e-12;
        step->look[i] = part > 1.0 - 1e-9 ? 1.0 - 1e-9 : part > least ? part : least;
    }
}

/* Whether a row asks for a closer look. What is not a number does. */
UNROLLED int remarkable(const double *look, const int n2, const double *e, const double *w, const double *middle, const double *reach) {
    const Pair_of_flags all = {-1, -1}, size = {INT64_MAX, INT64_MAX};
    Pair_of_flags inside = all;
    for (int i = 0; i < n2; i += 2) {
        const Pair off = two(e + i) - two(middle + i), limit = two(look + i) * (two(reach + i) + two(w + i));
        inside &= (Pair)((Pair_of_flags)off & size) < limit;
    }
    return (inside[0] & inside[1]) == 0;
}

UNROLLED int64_t step_all(const StopsetPredictions *s, const int n, const int decoupled, Step *step, int64_t seen[2]) {
    const int n2 = 2 * n;
    int64_t live = 0;
    for (int64_t p = 0; p < s->rows; p++) {
        if (s->age[p] < 0) continue;
        const int64_t age = ++s->age[p];
        if (age >= s->ages) {
            s->age[p] = -1;
            continue;
        }
        live++;
        if (age > seen[0]) seen[0] = age;
        if (step->outside) s->foreign[p] = 1;
        double *e = s->e + p * n2, *w = s->w + p * n2;
        step_row(step, n, decoupled, e, w);
        if (remarkable(step->look, n2, e, w, s->middle + age * n2, s->reach + age * n2)) look_closely(s, n2, p, age, e, w, step);
    }
    return live;
}

/* The rows that were nearest to a bound at the last sample tell where to look now. */
UNROLLED void look_ahead(const StopsetPredictions *s, const int n, const int decoupled, Step *step) {
    const int n2 = 2 * n;
    int64_t last[X];
    memcpy(last, s->nearest, (size_t)n2 * sizeof *last);
    for (int i = 0; i < n2; i++) {
        const int64_t p = last[i];
        int known = p < 0 || p >= s->rows || s->age[p] < 0 || s->age[p] + 1 >= s->ages;
        for (int k = 0; k < i && !known; k++) known = last[k] == p;
        if (known) continue;
        double e[X], w[X];
        memcpy(e, s->e + p * n2, (size_t)n2 * sizeof *e);
        memcpy(w, s->w + p * n2, (size_t)n2 * sizeof *w);
        step_row(step, n, decoupled, e, w);
        look_closely(s, n2, p, s->age[p] + 1, e, w, step);
    }
}

UNROLLED int64_t look_and_step(const StopsetPredictions *s, const int n, const int decoupled, Step *step, int64_t seen[2]) {
    step->final = 0;
    look_ahead(s, n, decoupled, step);
    step->final = 1;
    return step_all(s, n, decoupled, step, seen);
}

int64_t stopset_advance(const StopsetPredictions *s, const StopsetReading *reading, int outside, int widen, int64_t seen[2]) {
    const double *x = reading->x, *before = reading->before, *u = reading->u, *du = reading->du;
    const int n2 = s->states, n = n2 / 2;
    Step step; /* filled as far as this arm needs: it has room for 32 joints, and zeros in all of that take as long as 90 rows */
    if (n < 1 || n > J) return -1;
    step.widen = widen;
    step.outside = outside;
    seen[0] = seen[1] = 0;
    for (int i = 0; i < n2; i++) {
        double sum = 0.0, push = 0.0, more = 0.0;
        for (int j = 0; j < n2; j++) sum += s->Ad[i * n2 + j] * before[j];
        for (int j = 0; j < n; j++) {
            push += s->Bd[i * n + j] * u[j];
            more += absolute(s->Bd[i * n + j]) * du[j];
        }
        step.residual[i] = x[i] - sum - push;
        step.growth[i] = more;
        step.look[i] = least;
        step.worst[0][i] = step.worst[1][i] = 0.0;
        s->room[i] = inf;
        s->row[i] = s->row[n2 + i] = -1;
    }
    step.decoupled = on_their_own(s, step.own);
    for (int k = 0; !step.decoupled && k < n2 * n2; k++) step.own[k] = s->Ad[k % n2 * n2 + k / n2];
    for (int k = 0; k < (step.decoupled ? 4 * n : n2 * n2); k++) step.size[k] = absolute(step.own[k]);
    const int64_t live = step.decoupled && n == 6   ? look_and_step(s, 6, 1, &step, seen)
                         : step.decoupled && n == 7 ? look_and_step(s, 7, 1, &step, seen)
                         : step.decoupled           ? look_and_step(s, n, 1, &step, seen)
                                                : look_and_step(s, n, 0, &step, seen);
    for (int i = 0; i < 2 * n2; i++) seen[1] += s->row[i] >= 0;
    for (int i = 0; i < n2; i++)
        if (s->room[i] == inf) s->room[i] = 1.0; /* no bound: as far from one as can be */
    return live;
}
