/* Small matrices: phi functions of the exact step, inverse. */
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

/* F = e^{Ah}, G = int_0^h e^{As} ds, H = int_0^h G ds: Taylor on a step scaled to norm <= 1/4, then doubling.
 * phi2(2X) = (phi1(X)^2 + 2 phi2(X))/4, phi1(2X) = (phi0 phi1 + phi1)/2, phi0(2X) = phi0^2. */
void stopset_phi(double Av[NJ][NJ], double h, StopsetStep *out) {
    double norm = 0.0, X[NJ][NJ], term[NJ][NJ], f0[NJ][NJ], f1[NJ][NJ], f2[NJ][NJ], work[NJ][NJ];
    for (int r = 0; r < NJ; r++) {
        double row = 0.0;
        for (int c = 0; c < NJ; c++) row += fabs(Av[r][c]) * fabs(h);
        if (row > norm) norm = row;
    }
    int doublings = 0;
    while (norm > 0.25 && doublings < 60) {
        norm *= 0.5;
        doublings++;
    }
    double scale = ldexp(h, -doublings), factorial = 0.5;
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            X[r][c] = Av[r][c] * scale;
            term[r][c] = r == c ? 1.0 : 0.0;
            f2[r][c] = r == c ? 0.5 : 0.0;
        }
    for (int k = 1; k < 18; k++) { /* 0.25^18 / 20! is below 1e-29 */
        product(term, X, work);
        memcpy(term, work, sizeof term);
        factorial /= k + 2;
        for (int r = 0; r < NJ; r++)
            for (int c = 0; c < NJ; c++) f2[r][c] += factorial * term[r][c];
    }
    product(X, f2, f1);
    for (int r = 0; r < NJ; r++) f1[r][r] += 1.0;
    product(X, f1, f0);
    for (int r = 0; r < NJ; r++) f0[r][r] += 1.0;
    for (int d = 0; d < doublings; d++) {
        product(f1, f1, work);
        for (int r = 0; r < NJ; r++)
            for (int c = 0; c < NJ; c++) f2[r][c] = 0.25 * (work[r][c] + 2.0 * f2[r][c]);
        product(f0, f1, work);
        for (int r = 0; r < NJ; r++)
            for (int c = 0; c < NJ; c++) f1[r][c] = 0.5 * (work[r][c] + f1[r][c]);
        product(f0, f0, work);
        memcpy(f0, work, sizeof f0);
    }
    out->h = h;
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            out->F[r][c] = f0[r][c];
            out->G[r][c] = h * f1[r][c];
            out->H[r][c] = h * h * f2[r][c];
        }
}

/* Gauss-Jordan with row pivots; returns 0 if singular. */
int stopset_invert(double X[NJ][NJ], double out[NJ][NJ]) {
    double A[NJ][2 * NJ];
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) {
            A[r][c] = X[r][c];
            A[r][NJ + c] = r == c ? 1.0 : 0.0;
        }
    for (int c = 0; c < NJ; c++) {
        int best = c;
        for (int r = c + 1; r < NJ; r++)
            if (fabs(A[r][c]) > fabs(A[best][c])) best = r;
        if (!(fabs(A[best][c]) > 0.0)) return 0;
        for (int k = 0; k < 2 * NJ; k++) {
            double swap = A[c][k];
            A[c][k] = A[best][k];
            A[best][k] = swap;
        }
        double pivot = A[c][c];
        for (int k = 0; k < 2 * NJ; k++) A[c][k] /= pivot;
        for (int r = 0; r < NJ; r++) {
            if (r == c) continue;
            double f = A[r][c];
            if (f == 0.0) continue;
            for (int k = 0; k < 2 * NJ; k++) A[r][k] -= f * A[c][k];
        }
    }
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) out[r][c] = A[r][NJ + c];
    return 1;
}
