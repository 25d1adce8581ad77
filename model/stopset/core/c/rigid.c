/* Rigid-body dynamics of a serial arm of revolute joints: Newton and Euler's equations about each link frame's origin.
 *
 * They are linear in a link's ten standard parameters, so one outward pass serves torque and regressor alike.
 *
 * Source: Featherstone (2008), ch. 5 and 6; Liu & Althoff (2018), eq. (3); Atkeson et al. (1986) for the regressor.
 */
#include <string.h>

#include "maths.h"
#include "stopset.h"
#include "vectors.h"

enum { J = STOPSET_JOINTS };

#define KNOWN_SIZE(arm) \
    if ((arm)->n < 1 || (arm)->n > J) return STOPSET_TOO_MANY_JOINTS

/* What the outward pass leaves: rotation of link frame i in link frame i-1; of each link frame, in it, the angular velocity,
 * angular acceleration and acceleration of the origin less gravity. */
typedef struct {
    double E[J][9], w[J][3], dw[J][3], a[J][3];
} Motion;

/* The rotation R0 followed by one about `axis` by an angle of this sine and cosine (Rodrigues). */
static void turn(const double *R0, const double *axis, double s, double c, double *out) {
    const double x = axis[0], y = axis[1], z = axis[2], d = 1.0 - c;
    const double T[9] = {c + x * x * d,     x * y * d - z * s, x * z * d + y * s, y * x * d + z * s, c + y * y * d,
                         y * z * d - x * s, z * x * d - y * s, z * y * d + x * s, c + z * z * d};
    product(R0, T, out);
}

/* Each joint's rotation at angles q: sines of four at once, which have the bits of one by one. */
static void turn_all(const StopsetArm *arm, const double *q, double E[J][9]) {
    double angle[4], s[4], c[4];
    for (int i = 0; i < arm->n; i += 4) {
        for (int k = 0; k < 4; k++) angle[k] = i + k < arm->n ? q[i + k] : 1.0; /* near zero it would be done by itself */
        stopset_sincos_of_four(angle, s, c);
        for (int k = 0; k < 4 && i + k < arm->n; k++) turn(arm->R + 9 * (i + k), arm->axis + 3 * (i + k), s[k], c[k], E[i + k]);
    }
}

/* Base to tip; the rotations m->E are given. */
static void outward(const StopsetArm *arm, const double *dq, const double *ddq, Motion *m) {
    const double rest[3] = {0, 0, 0}, up[3] = {-arm->gravity[0], -arm->gravity[1], -arm->gravity[2]};
    const double *wp = rest, *dwp = rest, *ap = up;
    for (int i = 0; i < arm->n; i++) {
        const double *p = arm->p + 3 * i, *z = arm->axis + 3 * i;
        double x[3], y[3];
        cross(wp, p, x);
        cross(wp, x, y);
        cross(dwp, p, x);
        for (int r = 0; r < 3; r++) x[r] = ap[r] + x[r] + y[r];
        transposed_times(m->E[i], x, m->a[i]);
        transposed_times(m->E[i], wp, m->w[i]);
        transposed_times(m->E[i], dwp, m->dw[i]);
        for (int r = 0; r < 3; r++) x[r] = z[r] * dq[i];
        cross(m->w[i], x, y);
        for (int r = 0; r < 3; r++) {
            m->dw[i][r] += y[r] + z[r] * ddq[i];
            m->w[i][r] += x[r];
        }
        wp = m->w[i];
        dwp = m->dw[i];
        ap = m->a[i];
    }
}

/* Tip to base: torques of the joints from `lowest` on. */
static void inward(const StopsetArm *arm, const Motion *m, int lowest, double *tau) {
    double F[3] = {0, 0, 0}, N[3] = {0, 0, 0}, x[3], y[3], z[3];
    for (int i = arm->n - 1; i >= lowest; i--) {
        const double *P = arm->pi + 10 * i, *h = P + 1, *w = m->w[i], *dw = m->dw[i], *a = m->a[i];
        cross(w, h, x);
        cross(w, x, y);
        cross(dw, h, x);
        for (int r = 0; r < 3; r++) F[r] += P[0] * a[r] + x[r] + y[r];
        inertia_times(P, w, x);
        cross(w, x, y);
        inertia_times(P, dw, x);
        cross(h, a, z);
        for (int r = 0; r < 3; r++) N[r] += x[r] + y[r] + z[r];
        tau[i] = dot(arm->axis + 3 * i, N);
        times(m->E[i], F, F);
        times(m->E[i], N, N);
        cross(arm->p + 3 * i, F, x);
        for (int r = 0; r < 3; r++) N[r] += x[r];
    }
}

int stopset_torques(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq, double *tau) {
    KNOWN_SIZE(arm);
    Motion m;
    for (int64_t k = 0; k < N * arm->n; k += arm->n) {
        turn_all(arm, q + k, m.E);
        outward(arm, dq + k, ddq + k, &m);
        inward(arm, &m, 0, tau + k);
    }
    return STOPSET_OK;
}

int stopset_bent_torques(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq, const StopsetBend *bend,
                         double *tau) {
    KNOWN_SIZE(arm);
    const int joint = bend->joint;
    Motion m;
    double at[J], speed[J], rate[J];
    const size_t row = (size_t)arm->n * sizeof(double);
    for (int64_t k = 0; k < N; k++) {
        memcpy(at, q + k * arm->n, row);
        memcpy(speed, dq + k * arm->n, row);
        memcpy(rate, ddq + k * arm->n, row);
        if (joint >= 0 && joint < arm->n) {
            at[joint] += bend->x[k];
            speed[joint] += bend->dx[k];
            rate[joint] += bend->ddx[k];
        }
        turn_all(arm, at, m.E);
        outward(arm, speed, rate, &m);
        inward(arm, &m, bend->lowest, tau + k * arm->n);
    }
    return STOPSET_OK;
}

/* At rest the reaction to gravity is all that moves through the arm, and only first moments turn it into torque. */
int stopset_gravity_torques(const StopsetArm *arm, int64_t N, const double *q, double *tau) {
    KNOWN_SIZE(arm);
    const int n = arm->n;
    double E[J][9], a[J][3], x[3];
    for (int64_t k = 0; k < N; k++) {
        const double up[3] = {-arm->gravity[0], -arm->gravity[1], -arm->gravity[2]};
        turn_all(arm, q + k * n, E);
        for (int i = 0; i < n; i++) transposed_times(E[i], i ? a[i - 1] : up, a[i]);
        double F[3] = {0, 0, 0}, M[3] = {0, 0, 0};
        for (int i = n - 1; i >= 0; i--) {
            const double *P = arm->pi + 10 * i;
            cross(P + 1, a[i], x);
            for (int r = 0; r < 3; r++) {
                F[r] += P[0] * a[i][r];
                M[r] += x[r];
            }
            tau[k * n + i] = dot(arm->axis + 3 * i, M);
            times(E[i], M, M);
            times(E[i], F, F);
            cross(arm->p + 3 * i, F, x);
            for (int r = 0; r < 3; r++) M[r] += x[r];
        }
    }
    return STOPSET_OK;
}

/* A composite body moved from its own frame to its parent's: parallel axes, by way of the first moment h. */
static void to_parent(const double *E, const double *p, double m, double *h, double *I) {
    double hr[3], A[9];
    times(E, h, hr);
    product(E, I, A);
    const double hp = dot(hr, p), pp = dot(p, p);
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            I[3 * r + c] = dot(A + 3 * r, E + 3 * c) - hr[r] * p[c] - p[r] * hr[c] - m * p[r] * p[c];
            if (r == c) I[3 * r + c] += 2.0 * hp + m * pp;
        }
    for (int r = 0; r < 3; r++) h[r] = hr[r] + m * p[r];
}

/* Composite bodies, tip to base: a unit acceleration of joint i alone moves all beyond it as one. */
int stopset_mass_matrices(const StopsetArm *arm, int64_t N, const double *q, double *M) {
    KNOWN_SIZE(arm);
    const int n = arm->n;
    double E[J][9];
    for (int64_t k = 0; k < N; k++, M += n * n) {
        double m = 0.0, h[3] = {0, 0, 0}, I[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0}, f[3], t[3], x[3];
        turn_all(arm, q + k * n, E);
        for (int i = n - 1; i >= 0; i--) {
            const double *P = arm->pi + 10 * i, *z = arm->axis + 3 * i;
            const double own[9] = {P[4], P[5], P[7], P[5], P[6], P[8], P[7], P[8], P[9]};
            m += P[0];
            for (int r = 0; r < 3; r++) h[r] += P[1 + r];
            for (int r = 0; r < 9; r++) I[r] += own[r];
            cross(z, h, f);
            times(I, z, t);
            for (int j = i; j >= 0; j--) {
                M[i * n + j] = M[j * n + i] = dot(arm->axis + 3 * j, t);
                times(E[j], f, f);
                times(E[j], t, t);
                cross(arm->p + 3 * j, f, x);
                for (int r = 0; r < 3; r++) t[r] += x[r];
            }
            to_parent(E[i], arm->p + 3 * i, m, h, I);
        }
    }
    return STOPSET_OK;
}

/* One link's ten columns y in one joint's row. In the link's frame: z the joint's axis, u = z x (link's origin - joint's), so
 * that a wrench (f, m) at the link's origin gives the joint z.m + u.f. */
static void link_row(const double *z, const double *u, const double *w, const double *dw, const double *a, double *y) {
    double s[3], v[3];
    const double uw = dot(u, w), ww = dot(w, w);
    y[0] = dot(u, a);
    cross(a, z, s);
    cross(u, dw, v);
    for (int r = 0; r < 3; r++) y[1 + r] = s[r] + v[r] + uw * w[r] - ww * u[r];
    cross(z, w, s);
    y[4] = z[0] * dw[0] + s[0] * w[0];
    y[5] = z[0] * dw[1] + z[1] * dw[0] + s[0] * w[1] + s[1] * w[0];
    y[6] = z[1] * dw[1] + s[1] * w[1];
    y[7] = z[0] * dw[2] + z[2] * dw[0] + s[0] * w[2] + s[2] * w[0];
    y[8] = z[1] * dw[2] + z[2] * dw[1] + s[1] * w[2] + s[2] * w[1];
    y[9] = z[2] * dw[2] + s[2] * w[2];
}

int stopset_regressors(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq, double *Y) {
    KNOWN_SIZE(arm);
    const int n = arm->n;
    double z[J][3], u[J][3], v[3];
    Motion m;
    for (int64_t k = 0; k < N; k++, Y += 10 * n * n) {
        turn_all(arm, q + k * n, m.E);
        outward(arm, dq + k * n, ddq + k * n, &m);
        for (int j = 0; j < n; j++) memset(Y + 10 * n * j, 0, 10 * (size_t)j * sizeof(double)); /* links before the joint */
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < i; j++) {
                cross(z[j], arm->p + 3 * i, v);
                for (int r = 0; r < 3; r++) v[r] += u[j][r];
                transposed_times(m.E[i], v, u[j]);
                transposed_times(m.E[i], z[j], z[j]);
            }
            for (int r = 0; r < 3; r++) {
                z[i][r] = arm->axis[3 * i + r];
                u[i][r] = 0.0;
            }
            for (int j = 0; j <= i; j++) link_row(z[j], u[j], m.w[i], m.dw[i], m.a[i], Y + 10 * (n * j + i));
        }
    }
    return STOPSET_OK;
}

int stopset_link_frames(const StopsetArm *arm, int64_t N, const double *q, double *R, double *o) {
    KNOWN_SIZE(arm);
    const int n = arm->n;
    const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, zero[3] = {0, 0, 0};
    double E[J][9], x[3];
    for (int64_t k = 0; k < N; k++) {
        const double *Rp = unit, *op = zero;
        turn_all(arm, q + k * n, E);
        for (int i = 0; i < n; i++, R += 9, o += 3) {
            times(Rp, arm->p + 3 * i, x);
            for (int r = 0; r < 3; r++) o[r] = op[r] + x[r];
            product(Rp, E[i], R);
            Rp = R;
            op = o;
        }
    }
    return STOPSET_OK;
}

int stopset_point(const StopsetArm *arm, const double *q, int link, const double *point, double *position, double *jacobian) {
    KNOWN_SIZE(arm);
    const int n = arm->n;
    double R[9 * J], o[3 * J], z[3], s[3];
    stopset_link_frames(arm, 1, q, R, o);
    times(R + 9 * link, point, position);
    for (int r = 0; r < 3; r++) position[r] += o[3 * link + r];
    memset(jacobian, 0, 3 * (size_t)n * sizeof(double));
    for (int i = 0; i <= link; i++) {
        times(R + 9 * i, arm->axis + 3 * i, z);
        for (int r = 0; r < 3; r++) s[r] = position[r] - o[3 * i + r];
        cross(z, s, s);
        for (int r = 0; r < 3; r++) jacobian[r * n + i] = s[r];
    }
    return STOPSET_OK;
}

int stopset_moment_arms(const StopsetArm *arm, int64_t N, const double *q, double *axis, double *moment_arm) {
    KNOWN_SIZE(arm);
    const int n = arm->n;
    double R[9 * J], o[3 * J], x[3];
    for (int64_t k = 0; k < N; k++, axis += 3 * n, moment_arm += 3 * n) {
        double beyond = 0.0, h[3] = {0, 0, 0}; /* mass, and first moment about the present joint, of all beyond it */
        stopset_link_frames(arm, 1, q + k * n, R, o);
        for (int i = n - 1; i >= 0; i--) {
            const double *P = arm->pi + 10 * i;
            if (i + 1 < n)
                for (int r = 0; r < 3; r++) h[r] += beyond * (o[3 * i + 3 + r] - o[3 * i + r]);
            times(R + 9 * i, P + 1, x);
            for (int r = 0; r < 3; r++) h[r] += x[r];
            beyond += P[0];
            times(R + 9 * i, arm->axis + 3 * i, axis + 3 * i);
            cross(axis + 3 * i, h, moment_arm + 3 * i);
        }
    }
    return STOPSET_OK;
}
