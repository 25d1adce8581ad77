/* Inertia and torques while angles and speeds stay in a box, from the local expansion of a pose: Lemma 4 of docs/stops.md. */
#include <string.h>

#include "stops.h"

/* L anywhere within `far` of the pose: L_ab changes with q_c, c > a, by no more than L_c,max(b, c). */
static void far_roots(const Expansion *E, const double *far, double *root) {
    const int n = E->n;
    for (int a = n - 1; a >= 0; a--)
        for (int b = a; b < n; b++) {
            root[a * n + b] = E->root[a * n + b];
            for (int c = a + 1; c < n; c++) root[a * n + b] += far[c] * root[c * n + (b > c ? b : c)];
        }
}

/* of[m], m > i: sum over o, u > i of far_o far_u times a bound of the third slopes of M_i. about joints of which the last but o and u
 * is m; pairs[c]: sum of far_o far_u over pairs of which c is the last. */
static void third_slopes(const Expansion *E, int i, const double *far, const double *root, double *of, double *pairs) {
    const int n = E->n;
    double third[SN], before = 0.0, behind = 0.0;
    for (int c = i + 1; c < n; c++) {
        double longest = 0.0;
        for (int a = i; a <= c; a++) longest = most(longest, root[a * n + c]);
        third[c] = 8.0 * root[c * n + c] * longest;
        pairs[c] = far[c] * (2.0 * before + far[c]);
        before += far[c];
    }
    for (int m = n - 1; m > i; m--) {
        double so_far = 0.0;
        for (int c = i + 1; c <= m; c++) so_far += pairs[c];
        of[m] = third[m] * so_far + behind;
        behind += third[m] * pairs[m];
    }
}

static void inertia(const Near *near, const double *mid, const double *rad, const double *far, Local *out) {
    const Expansion *E = &near->E;
    const StopsetCurvature *K = &near->plant->curvature;
    const StopsetParts *parts = near->parts;
    const int n = E->n;
    double root[SN * SN], third[SN], pairs[SN], bend[SN], extra[SN];
    far_roots(E, far, root);
    for (int i = 0; i < n; i++) {
        third_slopes(E, i, far, root, third, pairs);
        for (int j = i; j < n; j++) {
            const double *dM = E->dM + (i * n + j) * n, *dMp = E->dMp + (i * n + j) * n;
            const double *ddM = E->ddM + pair(i, j) * PAIRS, *ddMp = E->ddMp + pair(i, j) * PAIRS;
            double m = E->M[i * n + j], r = 0.0, p = E->Mp[i * n + j], pr = 0.0;
            for (int k = i + 1; k < n; k++) { /* sums over all o, of which those beyond k come later */
                const double *row = ddM + pair(0, k), *loaded = ddMp + pair(0, k);
                bend[k] = extra[k] = 0.0;
                for (int o = i + 1; o <= k; o++) {
                    const double second = size_of(row[o]) + (E->loaded ? size_of(loaded[o]) : 0.0);
                    bend[k] += second * far[o];
                    if (o < k) bend[o] += second * far[k];
                    if (!E->loaded) continue;
                    extra[k] += size_of(loaded[o]) * far[o];
                    if (o < k) extra[o] += size_of(loaded[o]) * far[k];
                }
            }
            for (int k = i + 1; k < n; k++) {
                const int last = j > k ? j : k;
                double beyond = 0.0;
                if (E->solid[last])
                    beyond = third[last];
                else /* Bernstein: no more than twice the largest second slope of all poses */
                    for (int o = i + 1; o < n; o++) beyond += 2.0 * K->M[((i * n + j) * n + k) * n + o] * pairs[o];
                double rest = extra[k] + 0.5 * beyond, turn = bend[k] + 0.5 * beyond, bow = 0.5 * bend[k] + beyond / 6.0;
                if (beyond > bend[k]) { /* a wide box: second slopes over all poses may say more */
                    double second = 0.0;
                    for (int o = i + 1; o < n; o++) second += K->M[((i * n + j) * n + k) * n + o] * far[o];
                    turn = least(turn, second);
                    bow = least(bow, 0.5 * second);
                    rest = least(rest, turn + bend[k]);
                }
                m += dM[k] * mid[k];
                p += dMp[k] * mid[k];
                r += size_of(dM[k]) * rad[k] + parts->bend * bow * far[k];
                pr += size_of(dMp[k]) * rad[k];
                out->turn[(i * n + j) * n + k] = out->turn[(j * n + i) * n + k] = parts->bend * turn;
                out->rest[(i * n + j) * n + k] = out->rest[(j * n + i) * n + k] = rest;
            }
            for (int k = 0; k <= i; k++) out->turn[(i * n + j) * n + k] = out->turn[(j * n + i) * n + k] = out->rest[(i * n + j) * n + k] = out->rest[(j * n + i) * n + k] = 0.0;
            const double scale = i != j ? parts->coupling : 1.0;
            out->M[i * n + j] = out->M[j * n + i] = scale * m;
            out->M_rad[i * n + j] = out->M_rad[j * n + i] = scale * r;
            out->Mp[i * n + j] = out->Mp[j * n + i] = scale * p;
            out->Mp_rad[i * n + j] = out->Mp_rad[j * n + i] = scale * pr;
            out->dM[i * n + j] = out->dM[j * n + i] = scale * (r + size_of(p) + pr);
        }
    }
}

/* Products v_k v_o of two speeds, k <= o and both orders together, row after row: their middle, half their range, the largest size. */
typedef struct {
    double middle[PAIRS], spread[PAIRS], largest[PAIRS];
} Products;

static void products(int n, const double *vc, const double *vr, const double *va, Products *out) {
    int m = 0;
    for (int k = 0; k < n; k++)
        for (int o = k; o < n; o++, m++) {
            const double twice = k == o ? 1.0 : 2.0;
            out->middle[m] = twice * vc[k] * vc[o];
            out->spread[m] = twice * (size_of(vc[k]) * vr[o] + vr[k] * size_of(vc[o]) + vr[k] * vr[o]);
            out->largest[m] = twice * va[k] * va[o];
        }
}

/* Coriolis torque and the momentum's rate: c, e +- cr, er of joint i. */
static void velocity_terms(const Expansion *E, const double *turn, int i, const Products *v, double *out) {
    const int n = E->n;
    const double *G = E->Gamma + i * n * n, *Gp = E->Gammap + i * n * n, *own = turn + i * n * n;
    double c = 0.0, cr = 0.0, e = 0.0, er = 0.0;
    int m = 0;
    for (int k = 0; k < n; k++)
        for (int o = k; o < n; o++, m++) {
            const double of_pair = turn[(k * n + o) * n + i];
            const double beyond = size_of(Gp[k * n + o]) + 0.5 * (own[k * n + o] + own[o * n + k] + of_pair);
            c += G[k * n + o] * v->middle[m];
            cr += size_of(G[k * n + o]) * v->spread[m] + beyond * v->largest[m];
            if (k >= i) continue;
            const double d = 0.5 * E->dM[(k * n + o) * n + i];
            e += d * v->middle[m];
            er += size_of(d) * v->spread[m] + 0.5 * (size_of(E->dMp[(k * n + o) * n + i]) + of_pair) * v->largest[m];
        }
    out[0] = c;
    out[1] = cr;
    out[2] = e;
    out[3] = er;
}

void stops_box_terms(const Near *near, const Span *x, const Span *w, Local *out) {
    const Expansion *E = &near->E;
    const StopsetParts *parts = near->parts;
    const double *of_gravity = near->plant->curvature.g, *x_lo = x->lo, *x_hi = x->hi, *w_lo = w->lo, *w_hi = w->hi;
    const int n = E->n;
    double mid[SN], rad[SN], far[SN], vc[SN], vr[SN], va[SN], v[4];
    Products speeds;
    out->n = n;
    for (int k = 0; k < n; k++) {
        mid[k] = 0.5 * (x_lo[k] + x_hi[k]);
        rad[k] = 0.5 * (x_hi[k] - x_lo[k]);
        far[k] = most(size_of(x_lo[k]), size_of(x_hi[k]));
        vc[k] = 0.5 * (w_lo[k] + w_hi[k]);
        vr[k] = 0.5 * (w_hi[k] - w_lo[k]);
        va[k] = size_of(vc[k]) + vr[k];
        out->x[k] = mid[k];
        out->rad[k] = rad[k];
        out->v[k] = vc[k];
        out->v_rad[k] = vr[k];
    }
    inertia(near, mid, rad, far, out);
    products(n, vc, vr, va, &speeds);
    for (int i = 0; i < n; i++) {
        double g = E->g[i], r = size_of(E->gp[i]);
        for (int k = 0; k < n; k++) {
            g += parts->gravity_slope * E->dg[i * n + k] * mid[k];
            double second = 0.0;
            for (int o = 0; o < n; o++) second += of_gravity[(i * n + k) * n + o] * far[o];
            r += parts->gravity_slope * (size_of(E->dg[i * n + k]) * rad[k] + (size_of(E->dgp[i * n + k]) + 0.5 * second) * far[k]);
        }
        velocity_terms(E, out->turn, i, &speeds, v);
        const double share = parts->christoffel;
        out->g_lo[i] = g - r;
        out->g_hi[i] = g + r;
        out->h_lo[i] = g - r + share * (v[0] - v[1]);
        out->h_hi[i] = g + r + share * (v[0] + v[1]);
        out->e_lo[i] = share * (v[2] - v[3]) - g - r;
        out->e_hi[i] = share * (v[2] + v[3]) - g + r;
    }
}

void stops_span(int n, const double *lo, const double *hi, Span *out) {
    memcpy(out->lo, lo, (size_t)n * sizeof *lo);
    memcpy(out->hi, hi, (size_t)n * sizeof *hi);
}

void stops_look_at(const StopsetPlant *plant, const StopsetBox *box, const StopsetParts *parts, int rotors, Near *out) {
    const int n = plant->arm.n;
    Span x, v = {{0}, {0}};
    out->plant = plant;
    out->parts = parts;
    stops_expand(&plant->arm, plant->pi_half, plant->rotor, box->q, &out->E);
    for (int i = 0; rotors && i < n; i++) out->E.Mp[i * (n + 1)] += plant->rotor_half[i];
    stops_span(n, box->x_lo, box->x_hi, &x);
    if (box->v_lo) stops_span(n, box->v_lo, box->v_hi, &v);
    stops_box_terms(out, &x, &v, &out->at);
}

int stopset_inertia_box(const StopsetPlant *plant, const StopsetBox *box, const StopsetParts *parts, double *M, double *dM, double *turn) {
    const int n = plant->arm.n;
    Near near;
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    stops_look_at(plant, box, parts, 0, &near);
    memcpy(M, near.at.M, (size_t)(n * n) * sizeof *M);
    memcpy(dM, near.at.dM, (size_t)(n * n) * sizeof *dM);
    memcpy(turn, near.at.turn, (size_t)(n * n * n) * sizeof *turn);
    return STOPSET_OK;
}
