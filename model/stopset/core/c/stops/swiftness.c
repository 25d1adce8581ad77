/* How fast a point can be for the energy that the arm has: no body has more of it than all of them.
 *
 * m |v_c|^2 + w' I_c w <= v' M v of a link's body, and v_p = v_c + w x r of its point r from the centre of mass, so in every pose
 *     |v_p|^2 <= lambda_max(A) v' M v,  A = 1 / m + [r]x I_c^-1 [r]x'.
 * A payload on top only adds to what the body has.
 *
 * Source: Featherstone (2008), ch. 2, for a body's inertia; Lemma 14 of docs/stops.md.
 */
#include <math.h>
#include <string.h>

#include "../vectors.h"
#include "stops.h"

static const double ROUNDED = 1e-10, NOTHING = 1e-15; /* of an inertia about a link's origin, and [kg m^2]: so much is rounding */
static const double FLAT = 1e-9;                      /* the determinant over the trace's cube, below which an inverse is not known */
static const double MARGIN = 1.0 + 1e-6;              /* of what rounding makes of all this */
enum { SQUARED = 12 };                                /* times: the 4096th root of a trace is 0.03 % above the largest eigenvalue at most */

/* Inertia (9,) [kg m^2] about the centre of mass c, of parameters (10,) with a mass. */
static void central(const double *pi, double c[3], double I[9]) {
    const double *h = pi + 1, about[9] = {pi[4], pi[5], pi[7], pi[5], pi[6], pi[8], pi[7], pi[8], pi[9]};
    for (int x = 0; x < 3; x++) c[x] = h[x] / pi[0];
    const double hc = dot(h, c);
    for (int x = 0; x < 3; x++)
        for (int y = 0; y < 3; y++) I[3 * x + y] = about[3 * x + y] + h[x] * c[y] - (x == y ? hc : 0.0);
}

/* Minors of two rows and columns other than these: rows x + 1, x + 2 and columns y + 1, y + 2, in turn. */
static double minor(const double I[9], int x, int y) {
    const int a = 3 * ((x + 1) % 3), b = 3 * ((x + 2) % 3), k = (y + 1) % 3, l = (y + 2) % 3;
    return I[a + k] * I[b + l] - I[a + l] * I[b + k];
}

static double determinant(const double I[9]) { return I[0] * minor(I, 0, 0) + I[1] * minor(I, 0, 1) + I[2] * minor(I, 0, 2); }

/* Whether no motion gives these parameters a negative energy, but for rounding: by leading minors. */
static int is_body(const double *pi) {
    double c[3], I[9];
    if (!(pi[0] > 0.0)) {
        for (int k = 0; k < 10; k++)
            if (pi[k] != 0.0) return 0;
        return 1;
    }
    central(pi, c, I);
    for (int x = 0; x < 9; x += 4) I[x] += ROUNDED * (size_of(pi[4]) + size_of(pi[6]) + size_of(pi[9])) + NOTHING;
    return least(I[0], least(minor(I, 2, 2), determinant(I))) > 0.0; /* what is not a number is no body */
}

/* No less than the largest eigenvalue of a matrix (9,) that has none below 0, and hardly more: the root of a trace of a high power. */
static double largest(const double *A) {
    double a[9], trace[SQUARED], out;
    memcpy(a, A, sizeof a);
    for (int k = 0; k < SQUARED; k++) { /* the largest of A is that of A / trace, times the trace */
        double b[9];
        trace[k] = a[0] + a[4] + a[8];
        for (int x = 0; x < 9; x++) b[x] = a[x] / trace[k];
        product(b, b, a);
    }
    out = a[0] + a[4] + a[8];
    for (int k = SQUARED - 1; k >= 0; k--) out = trace[k] * sqrt(out);
    return out;
}

double stopset_swiftness(const StopsetPlant *plant, int link, const double *at) {
    const int n = plant->arm.n;
    double lightest[10], c[3], I[9], inverse[9], A[9], r[3];
    if (link < 0 || link >= n) return 0.0;
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < 10; k++) lightest[k] = plant->arm.pi[10 * i + k] - plant->pi_half[10 * i + k];
        if (!is_body(lightest) || !is_body(plant->pi_half + 10 * i)) return 0.0;
    }
    for (int k = 0; k < 10; k++) lightest[k] = plant->arm.pi[10 * link + k] - plant->pi_half[10 * link + k];
    if (!(lightest[0] > 0.0)) return 0.0;
    central(lightest, c, I);
    const double trace = I[0] + I[4] + I[8], det = determinant(I);
    if (!(det > FLAT * trace * trace * trace)) return 0.0;
    for (int x = 0; x < 3; x++) {
        r[x] = at[x] - c[x];
        for (int y = 0; y < 3; y++) inverse[3 * x + y] = minor(I, y, x) / det;
    }
    const double turn[9] = {0.0, -r[2], r[1], r[2], 0.0, -r[0], -r[1], r[0], 0.0};
    double half[9], back[9];
    for (int x = 0; x < 3; x++)
        for (int y = 0; y < 3; y++) back[3 * x + y] = turn[3 * y + x];
    product(turn, inverse, half);
    product(half, back, A);
    for (int x = 0; x < 9; x += 4) A[x] += 1.0 / lightest[0];
    return sqrt(largest(A)) * MARGIN;
}
