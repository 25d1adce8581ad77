/* What the momenta p = M v of all joints together know of all speeds, whoever slides, rests or turns round.
 *
 * p_i' = 1/2 v' dM/dq_i v - g_i - D_i v_i + u_i - f_i holds only the joint's own friction. While joint i moves forward it takes from p_i; a
 * joint that comes to rest, or goes backward, has no more momentum than the others pull at it, sup of p_i over v_i <= 0. So every p_i lies
 * between two lines, and M v = p between boxes of v and p is linear: solved for the speeds of every subset of joints.
 *
 * Lemmas 6 and 9 of docs/stops.md. Source: Goodnight (1979) for the sweep operator.
 */
#include <math.h>
#include <string.h>

#include "stops.h"

enum { CLAIMS = STOPSET_PULL_CLAIMS };

/* Of joint j, what meets its column: momenta and how loose they are of a joint inside, speeds of the others. */
typedef struct {
    double lo[SN], hi[SN], mid[SN], rad[SN], size[SN], loose[SN], beyond[SN];
} Met;

/* M with joints in the moving set; `from`, without `joint`, as long as its slopes have not followed: most rows need none. */
typedef struct Pivoted {
    Along A;
    struct Pivoted *from;
    int joint;
} Pivoted;

typedef struct {
    const Span *v, *p, *enough; /* enough: where no more is asked of rest */
    Span *out, *rest;
    Pivoted start; /* M */
    Met met;
    double loose[SN], beyond[SN], shared; /* how far M v can be from M_c v, all of it and beyond slopes */
    int n, inside[SN], open[SN], count;
} Exchange;

static double largest(double lo, double hi) { return most(size_of(lo), size_of(hi)); }

/* w [lo, hi], added; `scale` grows by its size. */
UNROLLED void add(double w, double lo, double hi, double *out_lo, double *out_hi, double *scale) {
    *out_lo += w > 0.0 ? w * lo : w * hi;
    *out_hi += w > 0.0 ? w * hi : w * lo;
    *scale += size_of(w) * largest(lo, hi);
}

/* Sums of entries times numbers in boxes, a row each: at the entries' middle, its scale for rounding, how far the rest is from that by the boxes
 * alone (loose), and what is beyond slopes; entries on the diagonal apart. */
typedef struct {
    double lo[SN], hi[SN], scale[SN], loose[SN], beyond[SN];
} Rows;

UNROLLED void sum_rows(int n, const Along *A, const Met *x, Rows *out) {
    for (int i = 0; i < n; i += LANES) {
        Four lo = {0}, hi = {0}, scale = {0}, loose = {0}, beyond = {0};
        for (int j = 0; j < n; j++) {
            const Four w = *(const Four *)(A->value + j * SN + i), a = w * x->lo[j], b = w * x->hi[j], size = SIZES_OF(w);
            const Choice up = w > 0.0;
            lo += CHOSEN(up, a, b);
            hi += CHOSEN(up, b, a);
            scale += size * x->size[j];
            loose += size * x->loose[j];
            beyond += size * x->beyond[j];
        }
        *(Four *)(out->lo + i) = lo;
        *(Four *)(out->hi + i) = hi;
        *(Four *)(out->scale + i) = scale;
        *(Four *)(out->loose + i) = loose;
        *(Four *)(out->beyond + i) = beyond;
    }
}

/* A row's own number in one box or either of two; by slopes, what angles and the payload do to the middle of all of the row, and what is beyond. */
typedef struct {
    int boxes;
    double mid[2], rad[2];
    Four sum[2];
} Loose;

/* The slopes of group g of row i, added. */
UNROLLED void add_slopes(int n, const Along *A, const Met *x, int i, int g, Loose *out) {
    const Four *slope = A->slope[g], own = slope[pair(i, i)], size = SIZES_OF(own);
    Four turn = {0}, spread = {0};
    for (int j = 0; j < i; j++) {
        const Four e = slope[pair(j, i)];
        turn += e * x->mid[j];
        spread += SIZES_OF(e) * x->rad[j];
    }
    for (int j = i + 1; j < n; j++) {
        const Four e = slope[pair(i, j)];
        turn += e * x->mid[j];
        spread += SIZES_OF(e) * x->rad[j];
    }
    for (int k = 0; k < out->boxes; k++) out->sum[k] += SIZES_OF(turn + own * out->mid[k]) + (spread + size * out->rad[k]);
}

static void follow_slopes(int n, Pivoted *x) {
    if (!x->from) return;
    follow_slopes(n, x->from);
    stops_pivot_slopes(n, &x->from->A, x->joint, &x->A);
    x->from = 0;
}

/* How far a row is from that at the entries' middle. */
static inline double away(double loose, double spread, double scale, double shared) {
    return least(loose, shared * spread) + stopset_rate_rounding * (scale + loose);
}

/* Row i of a joint inside: its speed. Its own entry is below zero: a pivot makes it so, others lower it. Sizes only add up: what another set of
 * joints has said better already is not asked how loose all of it is. */
UNROLLED void read_speed(int n, Pivoted *at, const Rows *rows, int i, Exchange *x) {
    const Along *A = &at->A;
    const Met *met = &x->met;
    const double own = A->own[i], size = size_of(own), lo = -(rows->hi[i] + own * met->lo[i]), hi = -(rows->lo[i] + own * met->hi[i]);
    const double loose = rows->loose[i] + size * met->loose[i], beyond = rows->beyond[i] + size * met->beyond[i], scale = rows->scale[i] + size * met->size[i];
    double off = away(loose, beyond, scale, x->shared);
    Loose all = {1, {met->mid[i]}, {met->rad[i]}, {{0}, {0}}};
    for (int g = 0; g < groups_of(n); g++) {
        if (lo - off <= x->out->lo[i] && hi + off >= x->out->hi[i]) return;
        follow_slopes(n, at);
        add_slopes(n, A, met, i, g, &all);
        off = away(loose, sum_of(all.sum) + beyond, scale, x->shared);
    }
    x->out->lo[i] = most(x->out->lo[i], lo - off);
    x->out->hi[i] = least(x->out->hi[i], hi + off);
}

/* Row i of another: how much momentum the others pull at it where it does not move forward, and where it does not move backward. */
UNROLLED void read_pulls(int n, Pivoted *at, const Rows *rows, int i, Exchange *x) {
    const Along *A = &at->A;
    Span *rest = x->rest;
    const double own = A->own[i], v_lo = x->v->lo[i], v_hi = x->v->hi[i], loose = rows->loose[i] + x->loose[i], beyond = rows->beyond[i] + x->beyond[i];
    const double lo[2] = {v_lo, most(v_lo, 0.0)}, hi[2] = {least(v_hi, 0.0), v_hi};
    const double up = rows->hi[i] + own * (own > 0.0 ? hi[0] : lo[0]), down = rows->lo[i] + own * (own > 0.0 ? lo[1] : hi[1]);
    const int asks_up = v_lo <= 0.0 && rest->hi[i] > x->enough->hi[i], asks_down = v_hi >= 0.0 && rest->lo[i] < x->enough->lo[i];
    double scale[2], off[2];
    Loose all = {2, {0.0, 0.0}, {0.0, 0.0}, {{0}, {0}}};
    for (int k = 0; k < 2; k++) {
        all.mid[k] = 0.5 * (lo[k] + hi[k]);
        all.rad[k] = 0.5 * (hi[k] - lo[k]);
        scale[k] = rows->scale[i] + size_of(own) * largest(lo[k], hi[k]);
        off[k] = away(loose, beyond, scale[k], x->shared);
    }
    for (int g = 0; g < groups_of(n); g++) {
        if (!(asks_up && up + off[0] < rest->hi[i]) && !(asks_down && down - off[1] > rest->lo[i])) return;
        follow_slopes(n, at);
        add_slopes(n, A, &x->met, i, g, &all);
        for (int k = 0; k < 2; k++) off[k] = away(loose, sum_of(all.sum + k) + beyond, scale[k], x->shared);
    }
    if (asks_up) rest->hi[i] = least(rest->hi[i], up + off[0]);
    if (asks_down) rest->lo[i] = most(rest->lo[i], down - off[1]);
}

UNROLLED void rows_read(int n, Pivoted *at, Exchange *x) {
    Rows rows;
    sum_rows(n, &at->A, &x->met, &rows);
    for (int i = 0; i < n; i++) {
        if (x->inside[i] && x->out) read_speed(n, at, &rows, i, x);
        if (!x->inside[i] && x->rest) read_pulls(n, at, &rows, i, x);
    }
}

/* Speeds of the joints inside and pulls at the others, from the momenta inside and the speeds of the others. */
STOPSET_WIDE static void read_rows(Pivoted *at, Exchange *x) { SIZED(rows_read, x->n, at, x); }

/* What meets the column of joint j, inside or not. */
static void meet(Exchange *x, int j, int inside) {
    const double lo = inside ? x->p->lo[j] : x->v->lo[j], hi = inside ? x->p->hi[j] : x->v->hi[j];
    Met *met = &x->met;
    x->inside[j] = inside;
    met->lo[j] = lo;
    met->hi[j] = hi;
    met->loose[j] = inside ? x->loose[j] : 0.0;
    met->beyond[j] = inside ? x->beyond[j] : 0.0;
    met->mid[j] = 0.5 * (lo + hi);
    met->rad[j] = 0.5 * (hi - lo) + met->loose[j];
    met->size[j] = largest(lo, hi);
}

/* Every subset of the open joints from the k-th on; each is a few pivots away from the inertia itself. */
static void visit(Pivoted *at, int k, Exchange *x) {
    Pivoted next;
    if (k == x->count) {
        read_rows(at, x);
        return;
    }
    const int joint = x->open[k];
    if (at->A.own[joint] > 1e-6 * x->start.A.own[joint]) { /* first, as all momenta together mostly say the most */
        next.from = at;
        next.joint = joint;
        stops_pivot_values(x->n, &at->A, joint, &next.A);
        meet(x, joint, 1);
        visit(&next, k + 1, x);
        meet(x, joint, 0);
    }
    visit(at, k + 1, x);
}

/* Joint k into the moving set: A_ff = -M_ff^-1, A_sf = M_sf M_ff^-1, A_ss = Schur complement. */
UNROLLED void pivot(int n, double *A, int k) {
    const double d = 1.0 / A[k * n + k];
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
        A[i * n + k] = column[i] * d;
        A[k * n + i] = row[i] * d;
    }
    A[k * n + k] = -d;
}

/* Inverse W of M_c and dM/dq_k W at the expansion's pose; 0 where M_c is not surely positive definite. */
typedef struct {
    double W[SN * SN], dMW[SN * SN * SN];
} Inverse;

UNROLLED int inverted(int n, const Near *near, Inverse *out) {
    const Expansion *E = &near->E;
    const Local *at = &near->at;
    memcpy(out->W, at->M, (size_t)(n * n) * sizeof *out->W);
    for (int k = 0; k < n; k++) {
        if (!(out->W[k * n + k] > 1e-6 * at->M[k * n + k])) return 0;
        pivot(n, out->W, k);
    }
    for (int k = 0; k < n * n; k++) out->W[k] = -out->W[k];
    for (int k = 0; k < n; k++)
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j += LANES) { /* what is written beyond the row is the next one's, and comes anew */
                Four s = {0};
                for (int o = 0; o < n; o++) s += E->dM[(i * n + o) * n + k] * *(const Four *)(out->W + o * n + j);
                *(Four *)(out->dMW + (k * n + i) * n + j) = s;
            }
    return 1;
}

STOPSET_WIDE static int invert(const Near *near, Inverse *out) { return SIZED(inverted, near->E.n, near, out); }

/* How far M v can be from M_c v, speeds in v and momenta in p: the box of v alone, or along the angles dM/dq_k W of M_c v = p +- loose. */
UNROLLED void loosen(int n, const Near *near, const Inverse *inverse, const Span *v, const Span *p, double *loose) {
    const Expansion *E = &near->E;
    const Local *at = &near->at;
    double fast[SN], rest[SN], far[SN];
    for (int j = 0; j < n; j++) fast[j] = largest(v->lo[j], v->hi[j]);
    for (int i = 0; i < n; i++) {
        loose[i] = rest[i] = 0.0;
        for (int j = 0; j < n; j++) {
            double linear = 0.0;
            for (int k = 0; k < n; k++) linear += size_of(E->dM[(i * n + j) * n + k]) * at->rad[k];
            loose[i] += at->dM[i * n + j] * fast[j];
            rest[i] += most(at->dM[i * n + j] - linear, 1e-12 * linear) * fast[j];
        }
    }
    if (!inverse) return;
    for (int pass = 0; pass < 2; pass++) {
        for (int i = 0; i < n; i++) {
            far[i] = rest[i];
            for (int k = 0; k < n; k++) {
                const double *row = inverse->dMW + (k * n + i) * n;
                double lo = 0.0, hi = 0.0, scale = 0.0;
                for (int j = 0; j < n; j++) add(row[j], p->lo[j] - loose[j], p->hi[j] + loose[j], &lo, &hi, &scale);
                far[i] += at->rad[k] * (largest(lo, hi) + stopset_rate_rounding * scale);
            }
        }
        for (int i = 0; i < n; i++) loose[i] = least(loose[i], far[i]);
    }
}

STOPSET_WIDE static void looseness(const Near *near, const Inverse *inverse, const Span *v, const Span *p, double *loose) {
    SIZED(loosen, near->E.n, near, inverse, v, p, loose);
}

/* For speeds in v and momenta in p, where asked, what was known before cut by what is now: speeds (out), and momenta of joints that do not move
 * forward (rest.hi) or backward (rest.lo), infinite where no such motion is possible (rest.hi -inf, rest.lo inf). Pulls that are `enough` are not
 * cut any more. */
static void exchange(const Near *near, const Inverse *inverse, const Span *v, const Span *p, Span *out, Span *rest, const Span *enough) {
    const int n = near->E.n;
    double fast[SN] = {0.0}, push[SN];
    Exchange x;
    x.n = n;
    x.count = 0;
    x.v = v;
    x.p = p;
    x.out = out;
    x.rest = rest;
    x.enough = enough;
    x.shared = near->parts->shared;
    for (int i = 0; i < n; i++) fast[i] = largest(v->lo[i], v->hi[i]);
    x.start.from = 0;
    stops_slopes(near, fast, &x.start.A, push, x.beyond);
    looseness(near, inverse, v, p, x.loose);
    for (int i = 0; i < n; i++) {
        if (rest && v->lo[i] > 0.0) rest->hi[i] = -STOPS_INF;
        if (rest && v->hi[i] < 0.0) rest->lo[i] = STOPS_INF;
        if (v->hi[i] > v->lo[i]) x.open[x.count++] = i;
        meet(&x, i, 0);
    }
    visit(&x.start, 0, &x);
}

typedef struct {
    double lo, hi;
} Bow;

/* 1/2 v' dM/dq_i v over speeds in w and momenta in p: with v = W (p +- loose) and dM/dq_i at the expansion's pose, and what is beyond. */
UNROLLED Bow bow_of(int n, const Near *near, const Inverse *inverse, const Span *w, const Span *p, const double *loose, int i) {
    const Expansion *E = &near->E;
    const Local *at = &near->at;
    double value = 0.0, spread = 0.0, scale = 0.0, c[SN], r[SN];
    for (int j = 0; j < n; j++) {
        c[j] = 0.5 * (p->lo[j] + p->hi[j]);
        r[j] = 0.5 * (p->hi[j] - p->lo[j]) + loose[j] + 1e-12 * largest(p->lo[j], p->hi[j]);
    }
    for (int j = 0; j < n; j++) {
        double turned = 0.0;
        for (int k = 0; k < n; k++) {
            double Q = 0.0;
            for (int o = 0; o < n; o++) {
                const double part = inverse->W[j * n + o] * inverse->dMW[(i * n + o) * n + k];
                Q += part;
                scale += size_of(part) * (size_of(c[j]) + r[j]) * (size_of(c[k]) + r[k]);
            }
            turned += Q * c[k];
            spread += 0.5 * size_of(Q) * r[j] * r[k];
            const int at_jk = (j * n + k) * n + i;
            spread += 0.5 * (size_of(E->dMp[at_jk]) + at->turn[at_jk]) * largest(w->lo[j], w->hi[j]) * largest(w->lo[k], w->hi[k]);
        }
        value += 0.5 * c[j] * turned;
        spread += size_of(turned) * r[j];
    }
    spread += stopset_rate_rounding * scale;
    return (Bow){value - spread, value + spread};
}

STOPSET_WIDE static Bow bow(const Near *near, const Inverse *inverse, const Span *w, const Span *p, const double *loose, int i) {
    return SIZED(bow_of, near->E.n, near, inverse, w, p, loose, i);
}

/* What is so on a step: how fast momenta can grow at any time of it (fastest), in its mean (any) and in its mean while the joint moves forward (on), and
 * the same downward; the momenta, and the inverse inertia, if there is one. */
typedef struct {
    Span fastest, any, on, momenta;
    const Inverse *inverse;
    Inverse room;
} Pulls;

/* Rates with speeds in w and momenta as they are told. */
static void rates(const Near *near, const Inverse *inverse, const Step *s, const Span *w, Pulls *out) {
    const StopsetPlant *p = near->plant;
    const Local *at = &near->at;
    const double share = near->parts->christoffel;
    const Span *momenta = &out->momenta;
    Span *fastest = &out->fastest, *any = &out->any, *on = &out->on;
    double loose[SN];
    if (inverse) looseness(near, inverse, w, momenta, loose);
    for (int i = 0; i < at->n; i++) {
        double up = at->e_hi[i] + p->u_hi[i], down = at->e_lo[i] + p->u_lo[i];
        if (inverse) {
            const Bow bent = bow(near, inverse, w, momenta, loose, i);
            up = least(up, share * bent.hi - at->g_lo[i] + p->u_hi[i]);
            down = most(down, share * bent.lo - at->g_hi[i] + p->u_lo[i]);
        }
        const double slow = p->viscous_lo[i] * most(w->lo[i], 0.0), slow_back = p->viscous_lo[i] * most(-w->hi[i], 0.0);
        const double fast = p->viscous_hi[i] * most(w->hi[i], 0.0), fast_back = p->viscous_hi[i] * most(-w->lo[i], 0.0);
        on->hi[i] = up - s->less[i] - slow;
        on->lo[i] = down + s->less[i] + slow_back;
        any->hi[i] = w->lo[i] > 0.0 ? on->hi[i] : up + s->more[i] + fast_back;
        any->lo[i] = w->hi[i] < 0.0 ? on->lo[i] : down - s->more[i] - fast;
        fastest->hi[i] = w->lo[i] > 0.0 ? up - s->B_lo[i] - slow : up + s->B_hi[i] + fast_back;
        fastest->lo[i] = w->hi[i] < 0.0 ? down + s->B_lo[i] + slow_back : down - s->B_hi[i] - fast;
    }
}

/* Momenta on a step of h seconds, from p. */
static void during(int n, const Span *p, double h, Pulls *out) {
    for (int i = 0; i < n; i++) {
        out->momenta.lo[i] = p->lo[i] + h * least(out->fastest.lo[i], 0.0) * stopset_energy_rounding;
        out->momenta.hi[i] = p->hi[i] + h * most(out->fastest.hi[i], 0.0) * stopset_energy_rounding;
    }
}

/* On a step with speeds in w, from momenta p. */
static void pulls_on(const Near *near, const Step *s, const Span *w, const Span *p, Pulls *out) {
    const int n = near->E.n;
    const Inverse *inverse = out->inverse = invert(near, &out->room) ? &out->room : 0;
    rates(near, 0, s, w, out);
    during(n, p, s->h, out);
    if (inverse) {
        rates(near, inverse, s, w, out);
        during(n, p, s->h, out);
    }
}

void stops_start_pulls(const Local *at, const Span *v, Span *p) {
    const double *v_lo = v->lo, *v_hi = v->hi;
    const int n = at->n;
    for (int i = 0; i < n; i++) {
        double scale = 0.0, loose = 0.0;
        p->lo[i] = p->hi[i] = 0.0;
        for (int j = 0; j < n; j++) {
            add(at->M[i * n + j], v_lo[j], v_hi[j], &p->lo[i], &p->hi[i], &scale);
            loose += at->dM[i * n + j] * largest(v_lo[j], v_hi[j]);
        }
        loose += stopset_rate_rounding * scale;
        p->lo[i] -= loose;
        p->hi[i] += loose;
    }
}

/* Speeds on a step from angles in E.q + x, speeds v and momenta p, no faster than `fastest`: claimed, and claimed again while too small; in the
 * end no more is claimed than `fastest`. `room`: how much farther than v is claimed first, and then for the next step. */
void stops_pull_caps(Near *near, const Span *x, const Span *v, const Span *p, const Step *s, Span *room, Span *cap) {
    const int n = near->E.n;
    const double h = s->h;
    const Span fastest = *cap;
    Span claim, raw, there = {{0}, {0}};
    Pulls found;
    for (int i = 0; i < n; i++) {
        claim.lo[i] = most(fastest.lo[i], v->lo[i] - room->lo[i]);
        claim.hi[i] = least(fastest.hi[i], v->hi[i] + room->hi[i]);
    }
    for (int attempt = 0;; attempt++) { /* what is claimed last is enough */
        int enough = 1;
        if (attempt == CLAIMS - 1) claim = fastest;
        for (int i = 0; i < n; i++) {
            there.lo[i] = x->lo[i] + h * least(claim.lo[i], 0.0);
            there.hi[i] = x->hi[i] + h * most(claim.hi[i], 0.0);
        }
        stops_box_terms(near, &there, &claim, &near->at);
        pulls_on(near, s, &claim, p, &found);
        raw = fastest; /* beyond it nothing is asked */
        exchange(near, found.inverse, &claim, &found.momenta, &raw, 0, 0);
        for (int i = 0; i < n; i++) {
            if (!(raw.lo[i] > claim.lo[i]) && claim.lo[i] > fastest.lo[i]) {
                enough = 0;
                claim.lo[i] = most(fastest.lo[i], raw.lo[i] - 0.1 * (claim.lo[i] - raw.lo[i]) - 0.01);
            }
            if (!(raw.hi[i] < claim.hi[i]) && claim.hi[i] < fastest.hi[i]) {
                enough = 0;
                claim.hi[i] = least(fastest.hi[i], raw.hi[i] + 0.1 * (raw.hi[i] - claim.hi[i]) + 0.01);
            }
        }
        if (enough) break;
    }
    for (int i = 0; i < n; i++) {
        cap->lo[i] = most(claim.lo[i], raw.lo[i]);
        cap->hi[i] = least(claim.hi[i], raw.hi[i]);
        room->lo[i] = most(1.1 * (v->lo[i] - cap->lo[i]), 0.0) + 0.01;
        room->hi[i] = most(1.1 * (cap->hi[i] - v->hi[i]), 0.0) + 0.01;
    }
}

/* From where on (from) a pull at a joint changes its momentum after a step, and below which (enough) it changes it no more. */
static void asked_of_pulls(int n, double h, const Span *w, const Span *p, const Pulls *on_step, Span *from, Span *enough) {
    const Span *any = &on_step->any, *on = &on_step->on;
    for (int i = 0; i < n; i++) {
        const double hi = p->hi[i] + h * any->hi[i], lo = p->lo[i] + h * any->lo[i], forward = p->hi[i] + h * on->hi[i], backward = p->lo[i] + h * on->lo[i];
        const double push = most(0.0, h * on->hi[i]), back = least(0.0, h * on->lo[i]);
        from->hi[i] = w->hi[i] < 0.0 ? hi : hi - push + 1e-9 * (size_of(hi) + push); /* more than rounding can make of it */
        from->lo[i] = w->lo[i] > 0.0 ? lo : lo - back - 1e-9 * (size_of(lo) - back);
        enough->hi[i] = w->hi[i] < 0.0 ? -STOPS_INF : forward - push - 1e-9 * (size_of(forward) + push);
        enough->lo[i] = w->lo[i] > 0.0 ? STOPS_INF : backward - back + 1e-9 * (size_of(backward) - back);
    }
}

/* Momenta after a step whose box was looked at and on which speeds lie in w; `step`: cut to what they are on it. */
void stops_pull_on(const Near *near, const Step *s, const Span *w, Span *p, Span *step) {
    const int n = near->E.n, pulled = near->parts->pull > 0.0;
    const double h = s->h;
    Pulls found;
    Span pull, enough;
    const Span *any = &found.any, *on = &found.on, *rest = &pull;
    pulls_on(near, s, w, p, &found);
    asked_of_pulls(n, h, w, p, &found, &pull, &enough);
    exchange(near, found.inverse, w, &found.momenta, 0, &pull, &enough);
    for (int i = 0; i < n; i++) {
        const double hi = p->hi[i] + h * any->hi[i], lo = p->lo[i] + h * any->lo[i], push = most(0.0, h * on->hi[i]), back = least(0.0, h * on->lo[i]);
        const double pull_hi = pulled ? rest->hi[i] + push : -STOPS_INF, pull_lo = pulled ? rest->lo[i] + back : STOPS_INF;
        const double forward = w->hi[i] < 0.0 ? rest->hi[i] : most(p->hi[i] + h * on->hi[i], pull_hi);
        const double backward = w->lo[i] > 0.0 ? rest->lo[i] : least(p->lo[i] + h * on->lo[i], pull_lo);
        const double slack = 1e-12 * (largest(p->lo[i], p->hi[i]) + h * largest(found.fastest.lo[i], found.fastest.hi[i]));
        step->lo[i] = most(step->lo[i], found.momenta.lo[i] - slack);
        step->hi[i] = least(step->hi[i], found.momenta.hi[i] + slack);
        p->hi[i] = least(hi, w->lo[i] > 0.0 ? hi : forward) + slack;
        p->lo[i] = most(lo, w->hi[i] < 0.0 ? lo : backward) - slack;
    }
}

/* At a moment: speeds in v cut by momenta in p, and these by the speeds. Returns a bound of sqrt(v' M v). */
double stops_pull_cut(const Near *near, Span *p, Span *v) {
    const int n = near->E.n;
    double power = 0.0;
    Span known;
    Inverse inverse;
    stops_start_pulls(&near->at, v, &known);
    for (int i = 0; i < n; i++) {
        p->lo[i] = most(p->lo[i], known.lo[i]);
        p->hi[i] = least(p->hi[i], known.hi[i]);
    }
    Span cut = *v;
    exchange(near, invert(near, &inverse) ? &inverse : 0, v, p, &cut, 0, 0);
    *v = cut;
    for (int i = 0; i < n; i++) {
        power += most(most(v->lo[i] * p->lo[i], v->lo[i] * p->hi[i]), most(v->hi[i] * p->lo[i], v->hi[i] * p->hi[i]));
    }
    return sqrt(most(power, 0.0)) * stopset_energy_rounding;
}

int stopset_speed_bounds(const StopsetPlant *plant, const StopsetBox *box, const StopsetRange *p, const StopsetParts *parts, double *out) {
    const int n = plant->arm.n;
    const size_t row = (size_t)n * sizeof *out;
    Near near;
    Inverse inverse;
    Span v, momenta, speeds, rest, enough;
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    stops_look_at(plant, box, parts, 1, &near);
    stops_span(n, box->v_lo, box->v_hi, &v);
    stops_span(n, p->lo, p->hi, &momenta);
    for (int i = 0; i < n; i++) {
        speeds.lo[i] = rest.lo[i] = enough.hi[i] = -STOPS_INF;
        speeds.hi[i] = rest.hi[i] = enough.lo[i] = STOPS_INF;
    }
    exchange(&near, invert(&near, &inverse) ? &inverse : 0, &v, &momenta, &speeds, &rest, &enough);
    memcpy(out, speeds.lo, row);
    memcpy(out + n, speeds.hi, row);
    memcpy(out + 2 * n, rest.lo, row);
    memcpy(out + 3 * n, rest.hi, row);
    return STOPSET_OK;
}
