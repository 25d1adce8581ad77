/* Inertia and torques while angles and speeds stay in a box, from the local expansion of a pose: Lemma 4 of docs/stops.md. */
#include <string.h>

#include "stops.h"

/* L anywhere within `far` of the pose: L_ab changes with q_c, c > a, by no more than L_c,max(b, c). */
UNROLLED void far_roots(int n, const Expansion *E, const double *far, double *root) {
    for (int a = n - 1; a >= 0; a--)
        for (int b = a; b < n; b++) {
            root[a * n + b] = E->root[a * n + b];
            for (int c = a + 1; c < n; c++) root[a * n + b] += far[c] * root[c * n + (b > c ? b : c)];
        }
}

/* of[m], m > i: sum over o, u > i of far_o far_u times a bound of the third slopes of M_i. about joints of which the last but o and u
 * is m; pairs[c]: sum of far_o far_u over pairs of which c is the last. */
UNROLLED void third_slopes(int n, int i, const double *far, const double *root, double *of, double *pairs) {
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

enum { BEND_ROWS = (SN - 1) * SN * (2 * SN - 1) / 6 + (SN - 1) * SN / 2 };

/* Sums of second slopes over all angles of a box, a row of those behind joint i for each M_ij: of all the payload, and of half its range. */
typedef struct {
    double all[BEND_ROWS + LANES], half[BEND_ROWS + LANES];
} Bends;

UNROLLED void sum_bends(int n, const Expansion *E, const double *far, Bends *out) {
    int row = 0;
    for (int i = 0; i + 1 < n; i++) {
        const int m = n - 1 - i;
        for (int j = i; j < n; j++, row += m) {
            const double *ddM = E->ddM + bends_of(n, i, j), *ddMp = E->ddMp + bends_of(n, i, j);
            for (int k = 0; k < m; k += LANES) { /* what is written beyond the row is the next one's, and comes anew */
                Four all = {0}, half = {0};
                for (int o = 0; o < m; o++) {
                    const Four middle = SIZES_OF(*(const Four *)(ddM + o * m + k));
                    if (E->loaded) {
                        const Four loaded = SIZES_OF(*(const Four *)(ddMp + o * m + k));
                        all += (middle + loaded) * far[i + 1 + o];
                        half += loaded * far[i + 1 + o];
                    } else
                        all += middle * far[i + 1 + o];
                }
                *(Four *)(out->all + row + k) = all;
                *(Four *)(out->half + row + k) = half;
            }
        }
    }
}

UNROLLED void inertia(int n, const Near *near, const double *mid, const double *rad, const double *far, Local *out) {
    const Expansion *E = &near->E;
    const StopsetCurvature *K = &near->plant->curvature;
    const StopsetParts *parts = near->parts;
    double root[SN * SN], third[SN], pairs[SN];
    Bends bends;
    const double *bend = bends.all, *extra = bends.half;
    far_roots(n, E, far, root);
    sum_bends(n, E, far, &bends);
    for (int i = 0; i < n; i++) {
        third_slopes(n, i, far, root, third, pairs);
        for (int j = i; j < n; j++, bend += n - 1 - i, extra += n - 1 - i) {
            const double *dM = E->dM + (i * n + j) * n, *dMp = E->dMp + (i * n + j) * n;
            double m = E->M[i * n + j], r = 0.0, p = E->Mp[i * n + j], pr = 0.0;
            for (int k = i + 1; k < n; k++) {
                const int last = j > k ? j : k;
                const double bent = bend[k - i - 1];
                double beyond = 0.0;
                if (E->solid[last])
                    beyond = third[last];
                else /* Bernstein: no more than twice the largest second slope of all poses */
                    for (int o = i + 1; o < n; o++) beyond += 2.0 * K->M[((i * n + j) * n + k) * n + o] * pairs[o];
                double rest = extra[k - i - 1] + 0.5 * beyond, turn = bent + 0.5 * beyond, bow = 0.5 * bent + beyond / 6.0;
                if (beyond > bent) { /* a wide box: second slopes over all poses may say more */
                    double second = 0.0;
                    for (int o = i + 1; o < n; o++) second += K->M[((i * n + j) * n + k) * n + o] * far[o];
                    turn = least(turn, second);
                    bow = least(bow, 0.5 * second);
                    rest = least(rest, turn + bent);
                }
                m += dM[k] * mid[k];
                r += size_of(dM[k]) * rad[k] + parts->bend * bow * far[k];
                if (E->loaded) {
                    p += dMp[k] * mid[k];
                    pr += size_of(dMp[k]) * rad[k];
                }
                out->turn[(i * n + j) * n + k] = out->turn[(j * n + i) * n + k] = parts->bend * turn;
                out->turn_of[(j * n + k) * n + i] = out->turn_of[(i * n + k) * n + j] = parts->bend * turn;
                out->rest[(i * n + j) * n + k] = out->rest[(j * n + i) * n + k] = rest;
            }
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

UNROLLED void products(int n, const double *vc, const double *vr, const double *va, Products *out) {
    int m = 0;
    for (int k = 0; k < n; k++)
        for (int o = k; o < n; o++, m++) {
            const double twice = k == o ? 1.0 : 2.0;
            out->middle[m] = twice * vc[k] * vc[o];
            out->spread[m] = twice * (size_of(vc[k]) * vr[o] + vr[k] * size_of(vc[o]) + vr[k] * vr[o]);
            out->largest[m] = twice * va[k] * va[o];
        }
}

/* Of every joint, the Coriolis torque c +- cr and the momentum's rate e +- er. */
typedef struct {
    double c[SN], cr[SN], e[SN], er[SN];
} Velocity;

UNROLLED void velocity_terms(int n, const Expansion *E, const Local *at, const Products *v, Velocity *out) {
    for (int i = 0; i < n; i += LANES) {
        Four c = {0}, cr = {0}, e = {0}, er = {0};
        int m = 0;
        for (int k = 0; k < n; k++) {
            const Choice turned = LANES_FROM(i) > k; /* turning the arm from joint k on turns what is behind it */
            for (int o = k; o < n; o++, m++) {
                const int ko = (k * n + o) * n + i, ok = (o * n + k) * n + i;
                const Four G = *(const Four *)(E->Gamma + ko), Gp = *(const Four *)(E->Gammap + ko), of_pair = *(const Four *)(at->turn + ko);
                const Four own = *(const Four *)(at->turn_of + ko) + *(const Four *)(at->turn_of + ok);
                const Four beyond = SIZES_OF(Gp) + 0.5 * (own + of_pair);
                c += G * v->middle[m];
                cr += SIZES_OF(G) * v->spread[m] + beyond * v->largest[m];
                const Four d = 0.5 * *(const Four *)(E->dM + ko), dp = *(const Four *)(E->dMp + ko);
                const Four rate = d * v->middle[m], loose = SIZES_OF(d) * v->spread[m] + 0.5 * (SIZES_OF(dp) + of_pair) * v->largest[m];
                e += (Four)((Choice)rate & turned);
                er += (Four)((Choice)loose & turned);
            }
        }
        *(Four *)(out->c + i) = c;
        *(Four *)(out->cr + i) = cr;
        *(Four *)(out->e + i) = e;
        *(Four *)(out->er + i) = er;
    }
}

void stops_start_local(int n, Local *out) {
    const size_t size = (size_t)(n * n * n) * sizeof *out->turn;
    out->n = n;
    memset(out->turn, 0, size);
    memset(out->turn_of, 0, size);
    memset(out->rest, 0, size);
}

UNROLLED void box_terms(int n, const Near *near, const Span *x, const Span *w, Local *out) {
    const Expansion *E = &near->E;
    const StopsetParts *parts = near->parts;
    const double *of_gravity = near->plant->curvature.g, *x_lo = x->lo, *x_hi = x->hi, *w_lo = w->lo, *w_hi = w->hi;
    double mid[SN], rad[SN], far[SN] = {0.0}, vc[SN], vr[SN], va[SN], fast = 0.0;
    Products speeds;
    Velocity v;
    for (int k = 0; k < n; k++) {
        mid[k] = 0.5 * (x_lo[k] + x_hi[k]);
        rad[k] = 0.5 * (x_hi[k] - x_lo[k]);
        far[k] = most(size_of(x_lo[k]), size_of(x_hi[k]));
        vc[k] = 0.5 * (w_lo[k] + w_hi[k]);
        vr[k] = 0.5 * (w_hi[k] - w_lo[k]);
        va[k] = size_of(vc[k]) + vr[k];
        fast += va[k];
        out->x[k] = mid[k];
        out->rad[k] = rad[k];
        out->v[k] = vc[k];
        out->v_rad[k] = vr[k];
    }
    inertia(n, near, mid, rad, far, out);
    if (fast == 0.0) /* gravity alone is asked for */
        memset(&v, 0, sizeof v);
    else {
        products(n, vc, vr, va, &speeds);
        velocity_terms(n, E, out, &speeds, &v);
    }
    for (int i = 0; i < n; i++) {
        double g = E->g[i], r = size_of(E->gp[i]);
        for (int k = 0; k < n; k++) {
            g += parts->gravity_slope * E->dg[i * n + k] * mid[k];
            double second = 0.0;
            for (int o = 0; o < n; o++) second += of_gravity[(i * n + k) * n + o] * far[o];
            r += parts->gravity_slope * (size_of(E->dg[i * n + k]) * rad[k] + (size_of(E->dgp[i * n + k]) + 0.5 * second) * far[k]);
        }
        const double share = parts->christoffel;
        out->g_lo[i] = g - r;
        out->g_hi[i] = g + r;
        out->h_lo[i] = g - r + share * (v.c[i] - v.cr[i]);
        out->h_hi[i] = g + r + share * (v.c[i] + v.cr[i]);
        out->e_lo[i] = share * (v.e[i] - v.er[i]) - g - r;
        out->e_hi[i] = share * (v.e[i] + v.er[i]) - g + r;
    }
}

STOPSET_WIDE void stops_box_terms(const Near *near, const Span *x, const Span *w, Local *out) { SIZED(box_terms, near->E.n, near, x, w, out); }

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
    stops_start_local(n, &out->at);
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
