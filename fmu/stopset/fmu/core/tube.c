/* What a measured state may differ from the prediction at an age: the box hull of stopset.reach.flowpipe, in C.
 *
 * sup d(a) = E1+ X0.hi + E1- X0.lo + plus U.hi + minus U.lo + V.hi, plus/minus the integrals of the positive and negative
 * part of K(t) = e^{At} B (bounds of them in a step where an entry may change its sign).
 * Source: Liu & Althoff (2018), eq. (17)-(20), time-varying inputs, signs of the response respected.
 */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

static void product(double A[NJ][NJ], double B[NJ][NJ], double out[NJ][NJ]) {
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            double sum = 0.0;
            for (int k = 0; k < NJ; k++) sum += A[r][k] * B[k][c];
            out[r][c] = sum;
        }
}

void stopset_tube_reset(StopsetState *s) {
    s->tube_k = 0;
    memset(s->tube_G, 0, sizeof s->tube_G);
    memset(s->plus, 0, sizeof s->plus);
    memset(s->minus, 0, sizeof s->minus);
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) s->tube_F[r][c] = r == c ? 1.0 : 0.0;
}

/* From the grid age of s onward by the piece `step`: responses at its end, integrals over it added. */
static void advance(StopsetState *s, StopsetStep *step, double F[NJ][NJ], double G[NJ][NJ], double plus[NX][NJ],
                    double minus[NX][NJ]) {
    double Ka[NX][NJ], Kb[NX][NJ], whole[NX][NJ], work[NJ][NJ], other[NJ][NJ];
    /* E1(a) = [[I, G], [0, F]];  G(a + h) = G(h) + G(a) F(h) */
    product(s->tube_G, s->Minv, work);
    memcpy(Ka, work, sizeof work);
    product(s->tube_F, s->Minv, work);
    memcpy(Ka + NJ, work, sizeof work);
    product(step->H, s->Minv, work);      /* position part of the step's input matrix */
    product(step->G, s->Minv, other);     /* velocity part */
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            double top = work[r][c], low = 0.0;
            for (int k = 0; k < NJ; k++) {
                top += s->tube_G[r][k] * other[k][c];
                low += s->tube_F[r][k] * other[k][c];
            }
            whole[r][c] = top;
            whole[NJ + r][c] = low;
        }
    product(s->tube_G, step->F, work);
    product(s->tube_F, step->F, other);
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            G[r][c] = step->G[r][c] + work[r][c];
            F[r][c] = other[r][c];
        }
    product(G, s->Minv, work);
    memcpy(Kb, work, sizeof work);
    product(F, s->Minv, work);
    memcpy(Kb + NJ, work, sizeof work);
    for (int r = 0; r < NX; r++)
        for (int c = 0; c < NJ; c++) {
            double a = Ka[r][c], b = Kb[r][c], magnitude = fabs(whole[r][c]);
            if (!stopset_model.signed_response) {
                double slope = 0.0; /* |K'| on the step is below this over h */
                for (int k = 0; k < NJ; k++)
                    slope += (r < NJ ? s->growth_q[r][k] : s->growth_v[r - NJ][k]) * fabs(Ka[NJ + k][c]);
                slope *= step->h;
                if (!(a * b >= 0.0 && fabs(a) + fabs(b) >= slope)) magnitude = step->h * (fmin(fabs(a), fabs(b)) + slope);
            }
            plus[r][c] = s->plus[r][c] + 0.5 * (magnitude + whole[r][c]);
            minus[r][c] = s->minus[r][c] - 0.5 * (magnitude - whole[r][c]);
        }
}

void stopset_tube(StopsetState *s, double age, double lo[NX], double hi[NX]) {
    const StopsetModel *m = &stopset_model;
    double F[NJ][NJ], G[NJ][NJ], plus[NX][NJ], minus[NX][NJ];
    int64_t k = (int64_t)floor(age / m->dt + 1e-9);
    double rest = age - (double)k * m->dt;
    if (k < s->tube_k) stopset_tube_reset(s);
    while (s->tube_k < k) {
        advance(s, &s->grid, F, G, plus, minus);
        memcpy(s->tube_F, F, sizeof F);
        memcpy(s->tube_G, G, sizeof G);
        memcpy(s->plus, plus, sizeof plus);
        memcpy(s->minus, minus, sizeof minus);
        s->tube_k++;
    }
    if (rest > 1e-9 * m->dt) {
        StopsetStep piece;
        stopset_phi(s->Av, rest, &piece);
        advance(s, &piece, F, G, plus, minus);
    } else {
        memcpy(F, s->tube_F, sizeof F);
        memcpy(G, s->tube_G, sizeof G);
        memcpy(plus, s->plus, sizeof plus);
        memcpy(minus, s->minus, sizeof minus);
    }
    for (int r = 0; r < NX; r++) {
        double low = 0.0, high = 0.0;
        for (int c = 0; c < NX; c++) {
            double e = r < NJ ? (c < NJ ? (r == c ? 1.0 : 0.0) : G[r][c - NJ]) : (c < NJ ? 0.0 : F[r - NJ][c - NJ]);
            low += e * (e > 0.0 ? m->X0_lo[c] : m->X0_hi[c]);
            high += e * (e > 0.0 ? m->X0_hi[c] : m->X0_lo[c]);
        }
        for (int c = 0; c < NJ; c++) {
            low += plus[r][c] * m->U_lo[c] + minus[r][c] * m->U_hi[c];
            high += plus[r][c] * m->U_hi[c] + minus[r][c] * m->U_lo[c];
        }
        low += m->V_lo[r];
        high += m->V_hi[r];
        /* some 4 NJ products and sums in double precision, rounded outward as in the Python tube */
        double slack = ldexp(NJ * fmax(fabs(low), fabs(high)), -50);
        lo[r] = low - slack;
        hi[r] = high + slack;
        if (m->position_only && r >= NJ) {
            lo[r] = -HUGE_VAL;
            hi[r] = HUGE_VAL;
        }
    }
}
