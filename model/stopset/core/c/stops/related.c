/* Accelerations of an arm whose joints slide or stick, with what one angle or one speed does to all of them at once.
 *
 *     M(q) a = r - h(q, v),   q = q_c + delta, v = v_c + nu, payload in its middle and s times half its range
 *
 * A box of h and one of M forget that the same delta_l, nu_k and s enter every row. Here each subset of moving joints carries the slopes of its
 * inverse along, so that columns of h and slopes of M meet the inverse before their sizes are added: most of what they say then cancels.
 *
 * The proof is that of Lemma 7 in docs/stops.md. Source: Goodnight (1979) for the sweep operator.
 */
#include <string.h>

#include "stops.h"

/* Where rates stand side by side: upper ones, then lower ones turned over, so that all are the largest of what is possible. */
enum { HULLS = (RATES + LANES - 1) / LANES, UPPER = RATES / 2 };
static const int place_of[RATES] = {5, 0, 6, 1, 2, 7, 3, 8, 4, 9};

typedef struct {
    int n, inside[SN], open[SN], count, fits, members, member[SN]; /* member: those inside, in order */
    Along start;                                    /* M */
    double push[SN], beyond[SN];                    /* torques of its change, and of what is beyond slopes, at claimed accelerations */
    Columns h;
    double r_lo[SN], r_hi[SN], r_mid[SN]; /* r less the middle of h */
    double sized[SN], unsure[SN], all[SN]; /* sizes of columns and push; with half the range of r; with the largest of r */
    Four torque[SN][HULLS], far[SN][HULLS], hull[SN][HULLS]; /* of each joint itself, by place_of its rates: r, how far from its middle, what was found */
    const Step *s;
    double shared;
} Relation;

UNROLLED void pivot_values(int n, const Along *restrict A, int k, Along *restrict B) {
    const double d = 1.0 / A->own[k], *row = A->value + k * SN;
    double share[SN];
    for (int j = 0; j < SN; j++) share[j] = row[j] * d; /* zero for k itself: no branch in the loops */
    for (int i = 0; i < n; i++) {
        const double b = share[i];
        B->own[i] = A->own[i] - b * row[i];
        for (int j = 0; j < n; j += LANES)
            *(Four *)(B->value + i * SN + j) = *(const Four *)(A->value + i * SN + j) - b * *(const Four *)(row + j);
        B->value[i * SN + i] = 0.0;
        B->value[i * SN + k] = b;
    }
    memcpy(B->value + k * SN, share, sizeof share);
    B->own[k] = -d;
}

UNROLLED void pivot_slopes(int n, const Along *restrict A, int k, Along *restrict B) {
    const double d = -B->own[k], *share = B->value + k * SN;
    Four bent[SN], old[SN];
    for (int g = 0; g < groups_of(n); g++) {
        const Four *a = A->slope[g], p = a[pair(k, k)];
        Four *x = B->slope[g];
        for (int j = 0; j < n; j++) {
            old[j] = a[j < k ? pair(j, k) : pair(k, j)];
            bent[j] = old[j] - share[j] * p;
        }
        for (int i = 0; i < n; i++) {
            const Four of_i = bent[i];
            const double b = share[i];
            for (int j = 0; j <= i; j++) x[pair(j, i)] = a[pair(j, i)] - (share[j] * of_i + b * old[j]);
        }
        for (int j = 0; j < n; j++) x[j < k ? pair(j, k) : pair(k, j)] = d * bent[j];
        x[pair(k, k)] = d * d * p;
    }
}

STOPSET_WIDE void stops_pivot_values(int n, const Along *restrict A, int k, Along *restrict B) {
    SIZED(pivot_values, n, A, k, B);
}

STOPSET_WIDE void stops_pivot_slopes(int n, const Along *restrict A, int k, Along *restrict B) {
    SIZED(pivot_slopes, n, A, k, B);
}

/* What slopes do to row i: sums of their sizes times what torques are uncertain by, of columns, times all that scales rounding, and of its own. */
typedef struct {
    double spread, columns, scale, own;
} Turned;

UNROLLED Turned turned(int n, const Along *A, int i, const Relation *x) {
    Turned out = {0.0, 0.0, 0.0, 0.0};
    for (int g = 0; g < groups_of(n); g++) {
        const Four *slope = A->slope[g], *column = (const Four *)(x->h.turns + g * LANES), self = slope[pair(i, i)], own = SIZES_OF(self);
        Four turn = column[i * GROUPS] * -A->own[i] + self * x->r_mid[i], spread = own * x->sized[i], scale = own * x->all[i];
        for (int k = 0; k < x->members; k++) {
            const int j = x->member[k];
            if (j == i) continue;
            const Four e = slope[j < i ? pair(j, i) : pair(i, j)], size = SIZES_OF(e);
            turn += column[j * GROUPS] * -A->value[i * SN + j] + e * x->r_mid[j];
            spread += size * x->unsure[j];
            scale += size * x->all[j];
        }
        turn = SIZES_OF(turn);
        out.spread += sum_of(&spread);
        out.columns += sum_of(&turn);
        out.scale += sum_of(&scale);
        out.own += sum_of(&own);
    }
    return out;
}

/* The hull grows by the accelerations of joint i when it moves and so do those inside. */
UNROLLED void row_of(int n, const Along *A, int i, Relation *x) {
    const double w = -A->own[i];
    const Turned slopes = turned(n, A, i, x);
    double lo = 0.0, hi = 0.0, spread = slopes.spread + slopes.columns, scale = 1.0 + slopes.scale;
    for (int g = 0; g < groups_of(n); g++) {
        const Four *column = (const Four *)(x->h.speeds + g * LANES);
        Four speed = column[i * GROUPS] * w;
        for (int k = 0; k < x->members; k++)
            if (x->member[k] != i) speed += column[x->member[k] * GROUPS] * -A->value[i * SN + x->member[k]];
        speed = SIZES_OF(speed);
        spread += sum_of(&speed);
    }
    for (int j = 0; j < n; j++) {
        if (j != i && !x->inside[j]) continue;
        const double v = j == i ? w : -A->value[i * SN + j];
        spread += size_of(v) * x->beyond[j];
        scale += size_of(v) * x->all[j];
        if (j == i) continue;
        lo += v > 0.0 ? v * x->r_lo[j] : v * x->r_hi[j];
        hi += v > 0.0 ? v * x->r_hi[j] : v * x->r_lo[j];
    }
    if (!(w > slopes.own)) x->fits = 0; /* else not even the sign of its own answer is known */
    spread = x->shared * spread + stopset_rate_rounding * scale;
    const Four base[HULLS] = {FOUR_OF(hi), {hi, -lo, -lo, -lo}, FOUR_OF(-lo)};
    for (int g = 0; g < HULLS; g++) {
        const Four found = base[g] + w * x->torque[i][g] + (spread + slopes.own * x->far[i][g]), hull = x->hull[i][g];
        x->hull[i][g] = ABOVE(hull, found);
    }
}

STOPSET_WIDE static void read_row(const Along *A, int i, Relation *x) {
    SIZED(row_of, x->n, A, i, x);
}

/* B: A with joint k inside; 0 if that is not surely possible. */
static int joined(const Along *A, int k, Relation *x, Along *B) {
    if (!(A->own[k] > 1e-6 * x->start.own[k])) return x->fits = 0;
    stops_pivot_values(x->n, A, k, B);
    stops_pivot_slopes(x->n, A, k, B);
    return 1;
}

/* Every subset of the open joints from the k-th on; each is a few pivots away from the inertia itself. */
static void visit(const Along *A, int k, Relation *x) {
    Along B;
    if (k < x->count) {
        const int joint = x->open[k];
        if (x->s->zero[joint]) visit(A, k + 1, x); /* else it surely moves */
        if (!joined(A, joint, x, &B)) return;
        x->inside[joint] = 1;
        visit(&B, k + 1, x);
        x->inside[joint] = 0;
        return;
    }
    x->members = 0;
    for (int i = 0; i < x->n; i++)
        if (x->inside[i]) x->member[x->members++] = i;
    for (int i = 0; i < x->n; i++) {
        if (x->inside[i])
            read_row(A, i, x);
        else if (!x->s->plus[i] && !x->s->minus[i] && joined(A, i, x, &B))
            read_row(&B, i, x); /* at rest: with this it would start, were it to start */
    }
}

void stops_slopes(const Near *near, const double *size, Along *A, double *push, double *beyond) {
    const Expansion *E = &near->E;
    const Local *at = &near->at;
    const int n = E->n;
    memset(A->value, 0, sizeof A->value);
    for (int g = 0; g < groups_of(n); g++) memset(A->slope[g], 0, (size_t)(n * (n + 1) / 2) * sizeof *A->slope[g]);
    for (int i = 0; i < n; i++) {
        push[i] = beyond[i] = 0.0;
        for (int j = 0; j < n; j++) {
            const int ij = i * n + j, place = i < j ? pair(i, j) : pair(j, i);
            const double rotor = i == j ? near->plant->rotor_half[i] : 0.0; /* of each joint its own */
            double linear = 0.0;
            for (int l = 0; l < n; l++) {
                const double slope = E->dM[ij * n + l] * at->rad[l];
                A->slope[l / LANES][place][l % LANES] = slope;
                linear += size_of(slope);
            }
            A->slope[n / LANES][place][n % LANES] = at->Mp[ij] - rotor;
            if (i == j)
                A->own[i] = at->M[ij];
            else
                A->value[i * SN + j] = at->M[ij];
            push[i] += at->dM[ij] * size[j];
            beyond[i] += (most(at->M_rad[ij] - linear, 1e-12 * linear) + at->Mp_rad[ij] + rotor) * size[j];
        }
    }
}

/* Of a box: how far it is from the pose and how wide, zero beyond n; second slopes d2 M_ij / dq_k dq_l at the pose, at pair(i, j), k, l. */
typedef struct {
    double x[SN], rad[SN], second[PAIRS][SN][SN];
} Curved;

UNROLLED void curved(int n, const Near *near, Curved *out) {
    const Expansion *E = &near->E;
    memset(out->x, 0, sizeof out->x);
    memset(out->rad, 0, sizeof out->rad);
    for (int i = 0; i < n; i++) {
        const int m = n - 1 - i;
        out->x[i] = near->at.x[i];
        out->rad[i] = near->at.rad[i];
        for (int j = i; j < n; j++) {
            const double *row = E->ddM + bends_of(n, i, j);
            memset(out->second[pair(i, j)], 0, (size_t)n * sizeof *out->second[0]);
            for (int k = i + 1; k < n; k++)
                for (int l = i + 1; l < n; l++) out->second[pair(i, j)][k][l] = row[(k - i - 1) * m + l - i - 1];
        }
    }
}

/* Christoffel symbol of joint i and two speeds in the middle of the box; sizes of its slopes, each times how wide the box is, and their sum. */
typedef struct {
    Four turn[SN / LANES];
    double middle, slopes;
} Symbol;

UNROLLED void symbol_of(int n, const Expansion *E, const Curved *c, const int ijk[3], Symbol *out) {
    const int i = ijk[0], k = ijk[1], o = ijk[2], ik = i < k ? pair(i, k) : pair(k, i), io = i < o ? pair(i, o) : pair(o, i), ko = k < o ? pair(k, o) : pair(o, k);
    out->middle = E->Gamma[(k * n + o) * n + i];
    out->slopes = 0.0;
    for (int g = 0; g * LANES < n; g++) {
        const int at = g * LANES;
        const Four slope = 0.5 * (*(const Four *)(c->second[ik][o] + at) + *(const Four *)(c->second[io][k] + at) - *(const Four *)(c->second[ko][i] + at));
        const Four far = slope * *(const Four *)(c->x + at), turn = slope * *(const Four *)(c->rad + at), size = SIZES_OF(turn);
        out->turn[g] = turn;
        for (int l = 0; l < LANES && at + l < n; l++) {
            out->middle += far[l];
            out->slopes += size[l];
        }
    }
}

/* Columns of the Coriolis torque of joint i; its middle, and what is beyond, added. */
UNROLLED void coriolis(int n, const Near *near, const Curved *curves, int i, Columns *x) {
    const Expansion *E = &near->E;
    const Local *at = &near->at;
    double *turns = x->turns + i * SLOPES;
    Symbol symbol[PAIRS];
    for (int o = 0; o < n; o++)
        for (int k = 0; k <= o; k++) symbol_of(n, E, curves, (const int[]){i, k, o}, symbol + pair(k, o));
    for (int k = 0; k < n; k++)
        for (int o = 0; o < n; o++) {
            const Symbol *y = symbol + (k < o ? pair(k, o) : pair(o, k));
            const int ik = (i * n + k) * n + o, io = (i * n + o) * n + k, ko = (k * n + o) * n + i;
            const double c = at->v[k], r = at->v_rad[k], b = at->v[o], t = at->v_rad[o], spread = size_of(c) * t + r * size_of(b) + r * t, G = y->middle;
            for (int g = 0; g * LANES < n; g++) *(Four *)(turns + g * LANES) += y->turn[g] * c * b;
            turns[n] += E->Gammap[ko] * c * b;
            x->speeds[i * SLOPES + k] += 2.0 * G * b * r;
            x->middle[i] += G * (k == o ? c * c + 0.5 * r * r : c * b); /* a square is not negative */
            x->rest[i] += size_of(G) * (k == o ? 0.5 : 1.0) * r * t + (y->slopes + size_of(E->Gammap[ko])) * spread;
            x->rest[i] += 0.5 * (at->rest[ik] + at->rest[io] + at->rest[ko]) * (size_of(c) + r) * (size_of(b) + t);
        }
}

UNROLLED void columns_of(int n, const Near *near, const Curved *curves, int i, Columns *x) {
    const Expansion *E = &near->E;
    const Local *at = &near->at;
    x->middle[i] = E->g[i];
    x->rest[i] = 0.0;
    memset(x->speeds + i * SLOPES, 0, SLOPES * sizeof(double));
    memset(x->turns + i * SLOPES, 0, SLOPES * sizeof(double));
    for (int k = 0; k < n; k++) {
        double bend = 0.0;
        const double far = size_of(at->x[k]) + at->rad[k];
        for (int o = 0; o < n; o++) bend += 0.5 * near->plant->curvature.g[(i * n + k) * n + o] * (size_of(at->x[o]) + at->rad[o]);
        x->middle[i] += E->dg[i * n + k] * at->x[k];
        x->turns[i * SLOPES + k] = E->dg[i * n + k] * at->rad[k];
        x->rest[i] += (size_of(E->dgp[i * n + k]) + bend) * far;
    }
    x->turns[i * SLOPES + n] = E->gp[i];
    coriolis(n, near, curves, i, x);
}

UNROLLED void columns(int n, const Near *near, Columns *out) {
    Curved curves;
    curved(n, near, &curves);
    for (int i = 0; i < n; i++) columns_of(n, near, &curves, i, out);
}

STOPSET_WIDE void stops_columns(const Near *near, Columns *out) {
    SIZED(columns, near->E.n, near, out);
}

/* Torques of joint i: the box of all but columns. */
static void torques_of(const Near *near, int i, Relation *x) {
    const Local *at = &near->at;
    const Step *s = x->s;
    const int n = x->n;
    const double middle = x->h.middle[i], rest = x->h.rest[i];
    const double up = s->direction[i] >= 0.0 ? s->B_lo[i] : s->B_later[i], down = s->direction[i] <= 0.0 ? s->B_lo[i] : s->B_later[i];
    const double lo = s->s_lo[i] + at->h_hi[i] - middle - rest, hi = s->s_hi[i] + at->h_lo[i] - middle + rest;
    const double own[RATES] = {lo - s->B_hi[i], hi - up, lo + down, hi + s->B_hi[i], hi - up - s->own_up[i], lo - s->B_hi[i] + s->own_down[i],
                               hi + s->B_hi[i] - s->own_up[i], lo + down + s->own_down[i], hi - s->B_later[i], lo + s->B_later[i]};
    x->r_lo[i] = s->plus[i] || !s->minus[i] ? own[0] : own[2];
    x->r_hi[i] = s->minus[i] ? own[3] : own[1];
    x->r_mid[i] = 0.5 * (x->r_lo[i] + x->r_hi[i]);
    for (int g = 0; g < HULLS; g++) x->torque[i][g] = x->hull[i][g] = x->far[i][g] = FOUR_OF(0.0);
    for (int rate = 0; rate < RATES; rate++) {
        const int goes = s->zero[i] || (is_backward(rate) ? s->minus[i] : s->plus[i]), at_lane = place_of[rate]; /* else it is left where it began */
        ((double *)x->torque[i])[at_lane] = is_lower(rate) ? -own[rate] : own[rate];
        ((double *)x->far[i])[at_lane] = size_of(own[rate] - x->r_mid[i]);
        ((double *)x->hull[i])[at_lane] = -STOPS_INF;
        if (!goes) ((double *)x->torque[i])[at_lane] = -STOPS_INF;
        if (!goes) ((double *)x->far[i])[at_lane] = 0.0;
    }
    x->sized[i] = x->push[i];
    for (int k = 0; k < n; k++) x->sized[i] += size_of(x->h.speeds[i * SLOPES + k]);
    for (int l = 0; l <= n; l++) x->sized[i] += size_of(x->h.turns[i * SLOPES + l]);
    x->unsure[i] = x->sized[i] + 0.5 * (x->r_hi[i] - x->r_lo[i]);
    x->all[i] = most(size_of(x->r_lo[i]), size_of(x->r_hi[i])) + x->sized[i];
}

/* `out` of stops_accelerations cut to what is known so; left as it is where nothing is. */
void stops_related(const Near *near, const Step *s, double out[RATES][SN]) {
    const int n = near->E.n;
    Relation x;
    x.n = n;
    x.fits = 1;
    x.count = 0;
    x.s = s;
    x.shared = near->parts->shared;
    memset(x.inside, 0, sizeof x.inside);
    stops_slopes(near, s->a_far, &x.start, x.push, x.beyond);
    stops_columns(near, &x.h);
    for (int i = 0; i < n; i++) torques_of(near, i, &x);
    for (int i = 0; i < n; i++)
        if (!s->zero[i]) x.open[x.count++] = i;
    for (int i = 0; i < n; i++)
        if (s->zero[i] && (s->plus[i] || s->minus[i])) x.open[x.count++] = i;
    visit(&x.start, 0, &x);
    if (!x.fits) return;
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < n; i++) {
            const double found = ((const double *)x.hull[i])[place_of[row]];
            out[row][i] = is_lower(row) ? most(out[row][i], -found) : least(out[row][i], found);
        }
}

int stopset_acceleration_bounds(const StopsetPlant *plant, const StopsetBox *box, const StopsetRange *dry, const double *claim, int related,
                                const StopsetParts *parts, double *out) {
    const int n = plant->arm.n;
    const double *w_lo = box->v_lo, *w_hi = box->v_hi;
    const Local *at;
    Near near;
    Step s;
    double rates[RATES][SN];
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    memset(&s, 0, sizeof s);
    stops_look_at(plant, box, parts, 1, &near);
    at = &near.at;
    for (int i = 0; i < n; i++) {
        s.s_lo[i] = plant->u_lo[i] - at->h_hi[i] - most(plant->viscous_lo[i] * w_hi[i], plant->viscous_hi[i] * w_hi[i]);
        s.s_hi[i] = plant->u_hi[i] - at->h_lo[i] - least(plant->viscous_lo[i] * w_lo[i], plant->viscous_hi[i] * w_lo[i]);
        s.B_lo[i] = s.B_later[i] = dry->lo[i];
        s.B_hi[i] = dry->hi[i];
        s.a_far[i] = claim[i];
        s.plus[i] = w_hi[i] > 0.0;
        s.minus[i] = w_lo[i] < 0.0;
        s.zero[i] = w_lo[i] <= 0.0 && w_hi[i] >= 0.0;
    }
    stops_accelerations(at, &s, rates);
    if (related) stops_related(&near, &s, rates);
    for (int row = 0; row < 4; row++) memcpy(out + row * n, rates[row], (size_t)n * sizeof *out);
    return STOPSET_OK;
}
