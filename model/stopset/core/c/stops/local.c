/* Inertia and torques while angles and speeds stay in a box, from the local expansion of a pose. */
#include "stops.h"

static void inertia(const Expansion *E, const StopsetCurvature *K, const double *mid, const double *rad, const double *far, double coupling,
                    Local *out) {
    const int n = E->n;
    for (int i = 0; i < n; i++)
        for (int j = i; j < n; j++) {
            const double *dM = E->dM + (i * n + j) * n, *dMp = E->dMp + (i * n + j) * n;
            double m = E->M[i * n + j], r = 0.0, p = E->Mp[i * n + j], pr = 0.0;
            for (int k = i + 1; k < n; k++) {
                m += dM[k] * mid[k];
                p += dMp[k] * mid[k];
                double second = 0.0;
                for (int o = i + 1; o < n; o++) second += K->M[((i * n + j) * n + k) * n + o] * far[o];
                out->turn[(i * n + j) * n + k] = out->turn[(j * n + i) * n + k] = second;
                r += size_of(dM[k]) * rad[k] + 0.5 * second * far[k];
                pr += size_of(dMp[k]) * rad[k];
            }
            for (int k = 0; k <= i; k++) out->turn[(i * n + j) * n + k] = out->turn[(j * n + i) * n + k] = 0.0;
            const double scale = i != j ? coupling : 1.0;
            out->M[i * n + j] = out->M[j * n + i] = scale * m;
            out->M_rad[i * n + j] = out->M_rad[j * n + i] = scale * r;
            out->Mp[i * n + j] = out->Mp[j * n + i] = scale * p;
            out->Mp_rad[i * n + j] = out->Mp_rad[j * n + i] = scale * pr;
            out->dM[i * n + j] = out->dM[j * n + i] = scale * (r + size_of(p) + pr);
        }
}

/* Coriolis torque and the momentum's rate: c, e +- cr, er of joint i. */
static void velocity_terms(const Expansion *E, const double *turn, int i, const double *vc, const double *vr, const double *va, double *out) {
    const int n = E->n;
    double c = 0.0, cr = 0.0, e = 0.0, er = 0.0;
    for (int k = 0; k < n; k++)
        for (int o = k; o < n; o++) {
            const double twice = k == o ? 1.0 : 2.0, prod = twice * vc[k] * vc[o];
            const double spread = twice * (size_of(vc[k]) * vr[o] + vr[k] * size_of(vc[o]) + vr[k] * vr[o]), largest = twice * va[k] * va[o];
            const double G = E->Gamma[(i * n + k) * n + o];
            const double beyond =
                size_of(E->Gammap[(i * n + k) * n + o]) + 0.5 * (turn[(i * n + k) * n + o] + turn[(i * n + o) * n + k] + turn[(k * n + o) * n + i]);
            c += G * prod;
            cr += size_of(G) * spread + beyond * largest;
            if (k >= i) continue;
            const double d = 0.5 * E->dM[(k * n + o) * n + i];
            e += d * prod;
            er += size_of(d) * spread + 0.5 * (size_of(E->dMp[(k * n + o) * n + i]) + turn[(k * n + o) * n + i]) * largest;
        }
    out[0] = c;
    out[1] = cr;
    out[2] = e;
    out[3] = er;
}

/* For angles E->q + [x_lo, x_hi] and speeds [w_lo, w_hi]. */
void stops_box_terms(const Expansion *E, const StopsetCurvature *K, const double *x_lo, const double *x_hi, const double *w_lo,
                     const double *w_hi, const StopsetParts *parts, Local *out) {
    const int n = E->n;
    double mid[SN], rad[SN], far[SN], vc[SN], vr[SN], va[SN], v[4];
    out->n = n;
    for (int k = 0; k < n; k++) {
        mid[k] = 0.5 * (x_lo[k] + x_hi[k]);
        rad[k] = 0.5 * (x_hi[k] - x_lo[k]);
        far[k] = most(size_of(x_lo[k]), size_of(x_hi[k]));
        vc[k] = 0.5 * (w_lo[k] + w_hi[k]);
        vr[k] = 0.5 * (w_hi[k] - w_lo[k]);
        va[k] = size_of(vc[k]) + vr[k];
    }
    inertia(E, K, mid, rad, far, parts->coupling, out);
    for (int i = 0; i < n; i++) {
        double g = E->g[i], r = size_of(E->gp[i]);
        for (int k = 0; k < n; k++) {
            g += parts->gravity_slope * E->dg[i * n + k] * mid[k];
            double second = 0.0;
            for (int o = 0; o < n; o++) second += K->g[(i * n + k) * n + o] * far[o];
            r += parts->gravity_slope * (size_of(E->dg[i * n + k]) * rad[k] + (size_of(E->dgp[i * n + k]) + 0.5 * second) * far[k]);
        }
        velocity_terms(E, out->turn, i, vc, vr, va, v);
        const double share = parts->christoffel;
        out->h_lo[i] = g - r + share * (v[0] - v[1]);
        out->h_hi[i] = g + r + share * (v[0] + v[1]);
        out->e_lo[i] = share * (v[2] - v[3]) - g - r;
        out->e_hi[i] = share * (v[2] + v[3]) - g + r;
    }
}
