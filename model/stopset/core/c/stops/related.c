/* Accelerations of an arm whose joints slide or stick, with what the same angle or speed does to all of them at once.
 *
 *     M(q) a = r - h(q, v),   q = q_c + delta, v = v_c + nu
 *
 * Boxes of M and h forget that one delta_l, or nu_k, enters every row. Here every subset of moving joints carries the slopes of its inverse
 * along with it, so columns of h meet the inverse before their sizes are added: most of what they say then cancels. What is beyond first
 * slopes is bounded in the norm of M, one number for all subsets.
 *
 * The lemma and its proof are in docs/stops.md. Source: Goodnight (1979) for the sweep operator.
 */
#include <math.h>
#include <string.h>

#include "stops.h"

enum { WIDE = SN + 2, COLUMNS = SN + PAIRS }; /* an entry: its value, its slopes in all angles and in the payload */

typedef struct {
    int n, inside[SN], open[SN], count, fits;
    double start[SN * SN * WIDE];
    double near_lo[SN], near_hi[SN], speeds[SN * COLUMNS], angles[SN * (SN + 1)]; /* torque r - h: its middle, columns of nu, of delta */
    double r_lo[SN], r_hi[SN], r_mid[SN], r_rad[SN], most[SN], own[RATES][SN];
    double push[SN], beyond[SN], diagonal[SN];
    const Step *s;
    double (*out)[SN];
} Relation;

/* Joint k into the moving set, slopes along. */
static void pivot(int n, double *A, int k) {
    double row[SN * WIDE], share[SN];
    const int wide = n + 2;
    const double *p = row + k * wide;
    memcpy(row, A + k * n * wide, (size_t)(n * wide) * sizeof *row);
    const double d = 1.0 / p[0];
    for (int i = 0; i < n; i++) share[i] = row[i * wide] * d;
    for (int i = 0; i < n; i++) {
        if (i == k) continue;
        const double b = share[i], *a = row + i * wide;
        for (int j = 0; j < n; j++) {
            if (j == k) continue;
            double *x = A + (i * n + j) * wide;
            const double c = share[j], *e = row + j * wide;
            x[0] -= b * e[0];
            for (int l = 1; l < wide; l++) x[l] += b * c * p[l] - a[l] * c - b * e[l];
        }
        double *x = A + (i * n + k) * wide, *y = A + (k * n + i) * wide;
        x[0] = y[0] = b;
        for (int l = 1; l < wide; l++) x[l] = y[l] = d * (a[l] - b * p[l]);
    }
    double *x = A + (k * n + k) * wide;
    x[0] = -d;
    for (int l = 1; l < wide; l++) x[l] = d * d * p[l];
}

/* Acceleration of joint i when it moves and so do those inside. */
static void read_row(const double *A, int i, Relation *x) {
    const int n = x->n, wide = n + 2;
    const double *row = A + i * n * wide;
    double lo = 0.0, hi = 0.0, spread = 0.0, scale = 0.0, column[COLUMNS], angle[SN + 1], own = 0.0;
    memset(column, 0, sizeof column);
    memset(angle, 0, sizeof angle);
    for (int j = 0; j < n; j++) {
        if (j != i && !x->inside[j]) continue;
        const double *e = row + j * wide, w = -e[0];
        double turned = 0.0;
        for (int l = 0; l <= n; l++) {
            turned += size_of(e[1 + l]);
            angle[l] += w * x->angles[j * (n + 1) + l] + e[1 + l] * x->r_mid[j];
        }
        for (int c = 0; c < n; c++) column[c] += w * x->speeds[j * COLUMNS + c];
        const double unknown = x->most[j] - most(size_of(x->r_lo[j]), size_of(x->r_hi[j]));
        spread += turned * unknown;
        spread += turned * x->push[j] + size_of(w) * x->beyond[j];
        scale += (size_of(w) + turned) * x->most[j];
        if (j == i) {
            own = turned;
            continue;
        }
        spread += turned * x->r_rad[j];
        lo += w > 0.0 ? w * x->r_lo[j] : w * x->r_hi[j];
        hi += w > 0.0 ? w * x->r_hi[j] : w * x->r_lo[j];
    }
    for (int c = 0; c < n; c++) spread += size_of(column[c]);
    for (int l = 0; l <= n; l++) spread += size_of(angle[l]);
    const double w = -row[i * wide];
    spread += stopset_rate_rounding * (scale + 1.0);
    if (!(w > own)) x->fits = 0;
    for (int rate = 0; rate < RATES; rate++) {
        const int forward = rate < 2 || rate == 4 || rate == 5 || rate == 8;
        if (!(x->s->zero[i] || (forward ? x->s->plus[i] : x->s->minus[i]))) continue;
        const double f = x->own[rate][i], away = own * size_of(f - x->r_mid[i]);
        double *out = &x->out[rate][i];
        *out = is_lower(rate) ? least(*out, lo + w * f - spread - away) : most(*out, hi + w * f + spread + away);
    }
}

static void visit(const double *A, int k, Relation *x) {
    const int n = x->n, wide = n + 2;
    double B[SN * SN * WIDE];
    const size_t size = (size_t)(n * n * wide) * sizeof *B;
    if (k < x->count) {
        const int joint = x->open[k];
        if (!x->s->zero[joint]) x->inside[joint] = 1; /* surely moves */
        else visit(A, k + 1, x);
        memcpy(B, A, size);
        if (!(B[joint * (n + 1) * wide] > 1e-6 * x->diagonal[joint])) {
            x->fits = 0;
            return;
        }
        pivot(n, B, joint);
        x->inside[joint] = 1;
        visit(B, k + 1, x);
        x->inside[joint] = 0;
        return;
    }
    for (int i = 0; i < n; i++) {
        if (x->inside[i]) {
            read_row(A, i, x);
            continue;
        }
        if (x->s->plus[i] || x->s->minus[i]) continue; /* visited with i moving instead */
        memcpy(B, A, size); /* at rest: with what it would start, were it to start */
        if (!(B[i * (n + 1) * wide] > 1e-6 * x->diagonal[i])) {
            x->fits = 0;
            return;
        }
        pivot(n, B, i);
        read_row(B, i, x);
    }
}

/* Second slope d2 M_ij / dq_k dq_l at the pose. */
static double second(const Expansion *E, int i, int j, int k, int l) {
    const int a = i < j ? i : j, b = i < j ? j : i, m = k < l ? k : l, o = k < l ? l : k;
    return m > a ? E->ddM[pair(a, b) * PAIRS + pair(m, o)] : 0.0;
}

/* Middle, columns and remainder of the torque h of joint i, angles mid +- rad from the pose, speeds vc +- vr. */
static void coriolis(const Expansion *E, const Local *at, const double *mid, const double *vc, const double *vr, int i, Relation *x, double *middle,
                     double *rest) {
    const int n = at->n;
    double *angles = x->angles + i * (n + 1), *speeds = x->speeds + i * COLUMNS;
    for (int k = 0; k < n; k++)
        for (int o = 0; o < n; o++) {
            double G = E->Gamma[(i * n + k) * n + o], slopes = 0.0;
            const double prod = vc[k] * vc[o], spread = size_of(vc[k]) * vr[o] + vr[k] * size_of(vc[o]) + vr[k] * vr[o];
            for (int l = 0; l < n; l++) {
                const double slope = 0.5 * (second(E, i, k, o, l) + second(E, i, o, k, l) - second(E, k, o, i, l));
                G += slope * mid[l];
                slopes += size_of(slope) * at->rad[l];
                angles[l] += slope * prod * at->rad[l];
            }
            const double Gp = E->Gammap[(i * n + k) * n + o];
            const double beyond = 0.5 * (at->rest[(i * n + k) * n + o] + at->rest[(i * n + o) * n + k] + at->rest[(k * n + o) * n + i]);
            angles[n] += Gp * prod;
            *middle += G * prod;
            if (k == o) *middle += 0.5 * G * vr[k] * vr[k]; /* a square is not negative */
            speeds[k] += 2.0 * G * vc[o] * vr[k];
            *rest += (slopes + size_of(Gp)) * spread + beyond * (size_of(vc[k]) + vr[k]) * (size_of(vc[o]) + vr[o]);
            *rest += size_of(G) * (k == o ? 0.5 : 1.0) * vr[k] * vr[o];
        }
}

/* The inertia with its slopes, and the torques of all of its change, and of what is beyond slopes, at the claimed accelerations. */
static void inertia(const StopsetPlant *p, const Expansion *E, const Local *at, const Step *s, Relation *x) {
    const int n = at->n, wide = n + 2;
    for (int i = 0; i < n; i++) {
        x->push[i] = x->beyond[i] = 0.0;
        x->diagonal[i] = at->M[i * n + i];
        for (int j = 0; j < n; j++) {
            double *a = x->start + (i * n + j) * wide, linear = 0.0;
            a[0] = at->M[i * n + j];
            for (int l = 0; l < n; l++) {
                a[1 + l] = E->dM[(i * n + j) * n + l] * at->rad[l];
                linear += size_of(a[1 + l]);
            }
            const double rotor = i == j ? p->rotor_half[i] : 0.0; /* of each joint its own */
            a[1 + n] = at->Mp[i * n + j] - rotor;
            const double rest = most(at->M_rad[i * n + j] - linear, 1e-12 * linear) + at->Mp_rad[i * n + j] + rotor;
            x->push[i] += at->dM[i * n + j] * s->a_far[j];
            x->beyond[i] += rest * s->a_far[j];
        }
    }
}

int stops_related_accelerations(const StopsetPlant *p, const Expansion *E, const Local *at, const double *x_lo, const double *x_hi, const double *w_lo,
                                const double *w_hi, const Step *s, double out[RATES][SN]) {
    const int n = at->n;
    double mid[SN], far[SN], vc[SN], vr[SN], found[RATES][SN];
    Relation x;
    x.n = n;
    x.s = s;
    x.out = found;
    x.fits = 1;
    x.count = 0;
    inertia(p, E, at, s, &x);
    memset(x.angles, 0, sizeof x.angles);
    memset(x.speeds, 0, sizeof x.speeds);
    for (int k = 0; k < n; k++) {
        mid[k] = 0.5 * (x_lo[k] + x_hi[k]);
        far[k] = most(size_of(x_lo[k]), size_of(x_hi[k]));
        vc[k] = 0.5 * (w_lo[k] + w_hi[k]);
        vr[k] = 0.5 * (w_hi[k] - w_lo[k]);
        x.inside[k] = 0;
        if (!s->zero[k]) x.open[x.count++] = k;
    }
    for (int k = 0; k < n; k++)
        if (s->zero[k] && (s->plus[k] || s->minus[k])) x.open[x.count++] = k;
    for (int i = 0; i < n; i++) {
        double middle = E->g[i], rest = 0.0, known = 0.0;
        for (int k = 0; k < n; k++) {
            double bend = 0.0;
            for (int o = 0; o < n; o++) bend += p->curvature.g[(i * n + k) * n + o] * far[o];
            middle += E->dg[i * n + k] * mid[k];
            x.angles[i * (n + 1) + k] += E->dg[i * n + k] * at->rad[k];
            rest += (size_of(E->dgp[i * n + k]) + 0.5 * bend) * far[k];
        }
        x.angles[i * (n + 1) + n] += E->gp[i];
        coriolis(E, at, mid, vc, vr, i, &x, &middle, &rest);
        for (int c = 0; c < n; c++) known += size_of(x.speeds[i * COLUMNS + c]);
        for (int l = 0; l <= n; l++) known += size_of(x.angles[i * (n + 1) + l]);
        const double lo = s->s_lo[i] + at->h_hi[i] - middle - rest, hi = s->s_hi[i] + at->h_lo[i] - middle + rest;
        const double later = s->B_later[i] - s->B_lo[i];
        const double f_lo = lo - s->B_hi[i], f_hi = hi - (s->way[i] >= 0.0 ? s->B_lo[i] : s->B_later[i]);
        const double b_lo = lo + (s->way[i] <= 0.0 ? s->B_lo[i] : s->B_later[i]), b_hi = hi + s->B_hi[i];
        x.own[0][i] = f_lo;
        x.own[1][i] = f_hi;
        x.own[2][i] = b_lo;
        x.own[3][i] = b_hi;
        x.own[4][i] = f_hi - s->own_up[i];
        x.own[5][i] = f_lo + s->own_down[i];
        x.own[6][i] = b_hi - s->own_up[i];
        x.own[7][i] = b_lo + s->own_down[i];
        x.own[8][i] = f_hi - (s->way[i] >= 0.0 ? later : 0.0);
        x.own[9][i] = b_lo + (s->way[i] <= 0.0 ? later : 0.0);
        x.r_lo[i] = s->plus[i] || !s->minus[i] ? f_lo : b_lo;
        x.r_hi[i] = s->minus[i] ? b_hi : f_hi;
        x.r_mid[i] = 0.5 * (x.r_lo[i] + x.r_hi[i]);
        x.r_rad[i] = 0.5 * (x.r_hi[i] - x.r_lo[i]);
        x.most[i] = most(size_of(x.r_lo[i]), size_of(x.r_hi[i])) + known;
    }
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < n; i++) found[row][i] = is_lower(row) ? STOPS_INF : -STOPS_INF;
    visit(x.start, 0, &x);
    if (!x.fits) return 0;
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < n; i++) out[row][i] = is_lower(row) ? most(out[row][i], found[row][i]) : least(out[row][i], found[row][i]);
    return 1;
}
