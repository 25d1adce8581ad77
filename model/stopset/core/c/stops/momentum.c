/* What the momenta p = M v know of the speeds: Lemma 6 of docs/stops.md.
 *
 *     p_i' = 1/2 v' dM/dq_i v - g_i - D_i v_i + u_i - f_i
 *
 * holds no accelerations, so what joint j can do to joint i is limited by how much its speed changes. A joint that started
 * moving at the cut is in its first excursion until it comes to rest: meanwhile friction points one way and its momentum is
 * known within an interval. After that it is later: usually at rest. For every subset g of the joints that may still be in
 * their first excursion, M_gg (v - v0)_g = Q_g - M_gl (v - v0)_l, l: the others, in their later bands.
 */
#include <stddef.h>
#include <string.h>

#include "stops.h"

void stops_start_bands(int n, const Span *v, Bands *b) {
    const double *v_lo = v->lo, *v_hi = v->hi;
    memset(b, 0, sizeof *b);
    for (int i = 0; i < n; i++) {
        if (v_lo[i] > 0.0 || v_hi[i] < 0.0) {
            b->sign[i] = v_lo[i] > 0.0 ? 1.0 : -1.0;
            b->alive[i] = 1;
            b->first_lo[i] = v_lo[i];
            b->first_hi[i] = v_hi[i];
        } else {
            b->rested[i] = 1;
            b->later_lo[i] = v_lo[i];
            b->later_hi[i] = v_hi[i];
        }
    }
}

/* Hull of the two bands of every joint. */
void stops_total(int n, const Bands *b, double *lo, double *hi) {
    for (int i = 0; i < n; i++) {
        lo[i] = STOPS_INF;
        hi[i] = -STOPS_INF;
        if (b->alive[i]) {
            lo[i] = b->first_lo[i];
            hi[i] = b->first_hi[i];
        }
        if (b->rested[i]) {
            lo[i] = least(lo[i], b->later_lo[i]);
            hi[i] = most(hi[i], b->later_hi[i]);
        }
    }
}

/* Whether both hold the same numbers, where they hold any. */
int stops_same_bands(int n, const Bands *a, const Bands *b) {
    int same = 1;
    for (int i = 0; i < n; i++) {
        same &= (a->alive[i] == b->alive[i]) & (a->rested[i] == b->rested[i]);
        same &= (a->alive[i] == 0) | ((a->first_lo[i] == b->first_lo[i]) & (a->first_hi[i] == b->first_hi[i]));
        same &= (a->rested[i] == 0) | ((a->later_lo[i] == b->later_lo[i]) & (a->later_hi[i] == b->later_hi[i]));
    }
    return same;
}

/* Interval of (m +- r) [lo, hi], added. */
static void add_product(double m, double r, double lo, double hi, double *out_lo, double *out_hi) {
    const double a = (m - r) * lo, b = (m + r) * lo, c = (m - r) * hi, d = (m + r) * hi;
    *out_lo += least(least(a, b), least(c, d));
    *out_hi += most(most(a, b), most(c, d));
}

/* Interval of sum_{j != i} M_ij v_j. */
static void pull_on(int i, const Local *at, const double *lo, const double *hi, double *least_, double *most_) {
    *least_ = *most_ = 0.0;
    for (int j = 0; j < at->n; j++)
        if (j != i) add_product(at->M[i * at->n + j], at->dM[i * at->n + j], lo[j], hi[j], least_, most_);
}

void stops_start_momentum(const Near *near, const Span *x, const Span *v, const Bands *b, Momentum *m) {
    const Local *at = &m->start;
    const int n = near->E.n;
    memset(m, 0, offsetof(Momentum, start));
    stops_start_local(n, &m->start);
    stops_box_terms(near, x, v, &m->start);
    m->v0 = *v;
    for (int i = 0; i < n; i++) {
        m->needed[i] = STOPS_INF;
        m->restart_up[i] = -STOPS_INF;
        m->restart_down[i] = STOPS_INF;
        if (b->sign[i] != 0.0) continue;
        double lo, hi, own = at->M[i * n + i] + at->dM[i * n + i];
        pull_on(i, at, v->lo, v->hi, &lo, &hi);
        m->restart_up[i] = hi + own * v->hi[i];
        m->restart_down[i] = lo + own * v->lo[i];
    }
}

static double fastest(int i, const Bands *before, const Bands *after) {
    return most(most(size_of(before->first_lo[i]), size_of(before->first_hi[i])),
                most(size_of(after->first_lo[i]), size_of(after->first_hi[i])));
}

/* Least torque along a first excursion, brake apart. */
static double driven(const StopsetPlant *p, int i, const Local *at, const Bands *before, const Bands *after) {
    const double push = after->sign[i] > 0.0 ? at->e_lo[i] + p->u_lo[i] : -at->e_hi[i] - p->u_hi[i];
    return push - p->coulomb_hi[i] - p->viscous_hi[i] * fastest(i, before, after);
}

/* How far M_io can have changed since the start, about `change`. */
static double change_of(const Local *at, const Local *start, int k, double *rad) {
    *rad = at->M_rad[k] + start->M_rad[k];
    *rad += size_of(at->Mp[k] - start->Mp[k]) + at->Mp_rad[k] + start->Mp_rad[k];
    return at->M[k] - start->M[k];
}

/* Least of sign (M_ii v0_i - sum_{l != i} M_il (v - v0)_l - (M - M0) v0): what friction must take for joint i to rest. */
static double left(int i, double sign, const Local *at, const Momentum *now, const Span *v) {
    const double *v0_lo = now->v0.lo, *v0_hi = now->v0.hi;
    const int n = at->n;
    double lo = 0.0, hi = 0.0, rad;
    for (int o = 0; o < n; o++) {
        const double change = change_of(at, &now->start, i * n + o, &rad), a = rad * most(size_of(v0_lo[o]), size_of(v0_hi[o]));
        lo += least(-change * v0_lo[o], -change * v0_hi[o]) - a;
        hi += most(-change * v0_lo[o], -change * v0_hi[o]) + a;
        const double y_lo = o == i ? -v0_hi[o] : v->lo[o] - v0_hi[o], y_hi = o == i ? -v0_lo[o] : v->hi[o] - v0_lo[o];
        const double m = at->M[i * n + o], r = at->dM[i * n + o];
        const double p = -(m - r) * y_lo, q = -(m + r) * y_lo, s = -(m - r) * y_hi, t = -(m + r) * y_hi;
        lo += least(least(p, q), least(s, t));
        hi += most(most(p, q), most(s, t));
    }
    return sign > 0.0 ? lo : -hi;
}

/* retained (n,): least brake impulse that can end a first excursion during this step; inf where none can end. */
void stops_retained_impulse(const Near *near, const Momentum *m, const Step *s, const Bands *before, const Bands *after, const Span *v,
                            double *retained) {
    const Local *at = &near->at;
    for (int i = 0; i < at->n; i++) {
        retained[i] = STOPS_INF;
        if (!before->alive[i] || !after->rested[i]) continue;
        const double less = least(0.0, s->h * driven(near->plant, i, at, before, after));
        retained[i] = m->drive[i] + less + left(i, after->sign[i], at, m, v);
    }
}

/* A step on which speeds lie in v, bands going from before to after. */
void stops_carry_on(const Near *near, Momentum *m, const Step *s, const Bands *before, const Bands *after, const Span *v,
                    const double *retained) {
    const StopsetPlant *p = near->plant;
    const Local *at = &near->at;
    const double h = s->h;
    for (int i = 0; i < at->n; i++) {
        const double up = m->up[i], down = m->down[i];
        m->up[i] += h * (at->e_hi[i] + p->u_hi[i] - s->B_later[i]);
        m->down[i] += h * (at->e_lo[i] + p->u_lo[i] + s->B_later[i]);
        if (after->rested[i]) { /* it may rest, and start, at any time of this step */
            double lo, hi;
            pull_on(i, at, v->lo, v->hi, &lo, &hi);
            m->restart_up[i] = most(m->restart_up[i], hi - least(up, m->up[i]));
            m->restart_down[i] = least(m->restart_down[i], lo - most(down, m->down[i]));
        }
        if (!before->alive[i]) continue;
        const double slow = least(least(size_of(before->first_lo[i]), size_of(before->first_hi[i])),
                                  least(size_of(after->first_lo[i]), size_of(after->first_hi[i])));
        const double few = s->less[i] + p->viscous_lo[i] * slow, many = s->more[i] + p->viscous_hi[i] * fastest(i, before, after);
        m->drive[i] += h * driven(p, i, at, before, after);
        m->needed[i] = least(m->needed[i], retained[i]);
        m->P_lo[i] += h * (after->sign[i] > 0.0 ? at->e_lo[i] + p->u_lo[i] - many : at->e_lo[i] + p->u_lo[i] + few);
        m->P_hi[i] += h * (after->sign[i] > 0.0 ? at->e_hi[i] + p->u_hi[i] - few : at->e_hi[i] + p->u_hi[i] + many);
    }
}

/* What the subsets share while they are visited. M has stride SN. */
typedef struct {
    int n;
    _Alignas(32) double Q_lo[SN], Q_hi[SN], l_lo[SN], l_hi[SN], best_lo[SN], best_hi[SN], v0_lo[SN], v0_hi[SN], first_lo[SN], first_hi[SN], M[SN * SN];
    unsigned inside, seen_in, seen_out; /* a bit a joint */
} Search;

static inline Four *four(double *x) { return (Four *)x; }

/* Speeds when exactly the joints `inside` are in their first excursion, into the hulls if that is possible. A: transposed, stride SN. */
STOPSET_WIDE static void visit(const double *A, Search *x) {
    const int n = x->n;
    double r_lo[SN], r_hi[SN], y_lo[SN], y_hi[SN];
    for (int j = 0; j < n; j += LANES) {
        Four lo = *four(x->Q_lo + j), hi = *four(x->Q_hi + j);
        for (int o = 0; o < n; o++) {
            if (x->inside >> o & 1u) continue;
            const Four c = -*four(x->M + o * SN + j), a = c * x->l_lo[o], b = c * x->l_hi[o];
            lo += BELOW(a, b);
            hi += ABOVE(a, b);
        }
        *four(r_lo + j) = lo;
        *four(r_hi + j) = hi;
    }
    for (int i = 0; i < n; i += LANES) {
        const Choice here = IN_LANES(x->inside >> i);
        Four lo = *four(x->v0_lo + i), hi = *four(x->v0_hi + i);
        for (int j = 0; j < n; j++) {
            if (!(x->inside >> j & 1u)) continue;
            const Four w = -*(const Four *)(A + j * SN + i), a = w * r_lo[j], b = w * r_hi[j];
            lo += BELOW(a, b);
            hi += ABOVE(a, b);
        }
        const Choice cannot = here & ((hi < *four(x->first_lo + i)) | (lo > *four(x->first_hi + i)));
        if (cannot[0] | cannot[1] | cannot[2] | cannot[3]) return;
        *four(y_lo + i) = lo;
        *four(y_hi + i) = hi;
    }
    for (int i = 0; i < n; i += LANES) {
        const Choice here = IN_LANES(x->inside >> i);
        const Four lo = *four(x->best_lo + i), hi = *four(x->best_hi + i);
        *four(x->best_lo + i) = CHOSEN(here & (*four(y_lo + i) < lo), *four(y_lo + i), lo);
        *four(x->best_hi + i) = CHOSEN(here & (*four(y_hi + i) > hi), *four(y_hi + i), hi);
    }
    x->seen_in |= x->inside;
    x->seen_out |= ~x->inside;
}

static void begin_search(const Bands *b, const Momentum *m, const Local *at, const double *lo, const double *hi, Search *x) {
    const double *v0_lo = m->v0.lo, *v0_hi = m->v0.hi;
    const int n = at->n;
    const size_t row = (size_t)n * sizeof(double);
    double rad;
    memset(x, 0, sizeof *x);
    x->n = n;
    memcpy(x->v0_lo, v0_lo, row);
    memcpy(x->v0_hi, v0_hi, row);
    memcpy(x->first_lo, b->first_lo, row);
    memcpy(x->first_hi, b->first_hi, row);
    for (int i = 0; i < n; i++) {
        memcpy(x->M + i * SN, at->M + i * n, row);
        x->best_lo[i] = STOPS_INF;
        x->best_hi[i] = -STOPS_INF;
        x->l_lo[i] = b->later_lo[i] - v0_hi[i];
        x->l_hi[i] = b->later_hi[i] - v0_lo[i];
        if (!b->alive[i]) continue;
        x->Q_lo[i] = m->P_lo[i];
        x->Q_hi[i] = m->P_hi[i];
        for (int o = 0; o < n; o++) {
            const double change = change_of(at, &m->start, i * n + o, &rad);
            double a = rad * most(size_of(v0_lo[o]), size_of(v0_hi[o]));
            a += at->dM[i * n + o] * most(size_of(lo[o] - v0_hi[o]), size_of(hi[o] - v0_lo[o]));
            x->Q_lo[i] += least(-change * v0_lo[o], -change * v0_hi[o]) - a;
            x->Q_hi[i] += most(-change * v0_lo[o], -change * v0_hi[o]) + a;
        }
    }
}

/* Bands cut at a knot by the momenta; lo, hi: their hull before, and after. */
void stops_tighten(Bands *b, const Momentum *m, const Local *at, double *lo, double *hi) {
    const int n = at->n;
    _Alignas(32) double A[SN * SN];
    int open[SN], count = 0, members = 0;
    Search x;
    begin_search(b, m, at, lo, hi, &x);
    memcpy(A, x.M, sizeof A); /* symmetric */
    for (int i = 0; i < n; i++) {
        if (!b->alive[i]) continue;
        if (b->rested[i])
            open[count++] = i;
        else {
            stops_turn_over(n, A, i, 1);
            x.inside |= 1u << i;
            members++;
        }
    }
    for (int64_t subset = 0; count + members > 0;) {
        visit(A, &x);
        if (++subset >= (int64_t)1 << count) break;
        int bit = 0;
        while (!((subset >> bit) & 1)) bit++;
        stops_turn_over(n, A, open[bit], !(x.inside >> open[bit] & 1u));
        x.inside ^= 1u << open[bit];
    }
    for (int i = 0; i < n; i++) {
        if (!b->alive[i]) continue;
        if (!(x.seen_in >> i & 1u) && b->rested[i])
            b->alive[i] = 0; /* no momentum fits a first excursion that still lasts */
        else if (x.seen_in >> i & 1u) {
            b->first_lo[i] = most(b->first_lo[i], x.best_lo[i]);
            b->first_hi[i] = least(b->first_hi[i], x.best_hi[i]);
            if (!(x.seen_out >> i & 1u)) b->rested[i] = 0; /* nor one that is over */
        }
    }
    stops_total(n, b, lo, hi);
    for (int i = 0; i < n; i++) {
        if (!b->rested[i]) continue;
        const double small = at->M[i * n + i] - at->dM[i * n + i], large = at->M[i * n + i] + at->dM[i * n + i];
        double pull_lo, pull_hi;
        pull_on(i, at, lo, hi, &pull_lo, &pull_hi);
        if (!(small > 0.0)) continue;
        double impulse = m->restart_up[i] + m->up[i] - pull_lo;
        b->later_hi[i] = least(b->later_hi[i], most(0.0, impulse / (impulse > 0.0 ? small : large)));
        impulse = m->restart_down[i] + m->down[i] - pull_hi;
        b->later_lo[i] = most(b->later_lo[i], least(0.0, impulse / (impulse < 0.0 ? small : large)));
    }
}
