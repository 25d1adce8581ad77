/* Gravity torque and the inertia of a load, from the arm's geometry (conventions of stopset.robot.rigid). */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

static void cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Rotation of link frame i in link frame i-1 at angle q (Rodrigues). */
static void joint_rotation(int i, double q, double R[3][3]) {
    const StopsetModel *m = &stopset_model;
    double s = sin(q), c = cos(q), d = 1.0 - c, x = m->axis[i][0], y = m->axis[i][1], z = m->axis[i][2];
    double E[3][3] = {{c + x * x * d, x * y * d - z * s, x * z * d + y * s},
                      {x * y * d + z * s, c + y * y * d, y * z * d - x * s},
                      {x * z * d - y * s, y * z * d + x * s, c + z * z * d}};
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) R[r][k] = m->R[i][r][0] * E[0][k] + m->R[i][r][1] * E[1][k] + m->R[i][r][2] * E[2][k];
}

static void times(double R[3][3], const double v[3], double out[3]) {
    for (int r = 0; r < 3; r++) out[r] = R[r][0] * v[0] + R[r][1] * v[1] + R[r][2] * v[2];
}

static void transposed(double R[3][3], const double v[3], double out[3]) {
    for (int r = 0; r < 3; r++) out[r] = R[0][r] * v[0] + R[1][r] * v[1] + R[2][r] * v[2];
}

void stopset_loaded_links(const StopsetState *s, double pi[NJ][10]) {
    double mass = s->r[VR_PAYLOAD_MASS];
    memcpy(pi, stopset_model.pi, sizeof stopset_model.pi);
    pi[NJ - 1][0] += mass;
    const double *c = &s->r[VR_PAYLOAD_COM];
    double *P = pi[NJ - 1];
    for (int r = 0; r < 3; r++) P[1 + r] += mass * c[r];
    /* a point mass: its inertia about the link frame's origin */
    P[4] += mass * (c[1] * c[1] + c[2] * c[2]);
    P[5] -= mass * c[0] * c[1];
    P[6] += mass * (c[0] * c[0] + c[2] * c[2]);
    P[7] -= mass * c[0] * c[2];
    P[8] -= mass * c[1] * c[2];
    P[9] += mass * (c[0] * c[0] + c[1] * c[1]);
}

/* Torque of gravity and velocity, no acceleration: Newton and Euler from base to tip and back. */
void stopset_bias_torque(double pi[NJ][10], const double gravity[3], const double q[NJ], const double dq[NJ], double tau[NJ]) {
    const StopsetModel *m = &stopset_model;
    double R[NJ][3][3], w[NJ][3], dw[NJ][3], a[NJ][3], x[3], y[3], z[3];
    double wp[3] = {0, 0, 0}, dwp[3] = {0, 0, 0}, ap[3] = {-gravity[0], -gravity[1], -gravity[2]};
    for (int i = 0; i < NJ; i++) {
        joint_rotation(i, q[i], R[i]);
        cross(dwp, m->p[i], x);
        cross(wp, m->p[i], y);
        cross(wp, y, z);
        for (int r = 0; r < 3; r++) x[r] += ap[r] + z[r];
        transposed(R[i], x, a[i]);
        transposed(R[i], wp, w[i]);
        transposed(R[i], dwp, dw[i]);
        for (int r = 0; r < 3; r++) y[r] = m->axis[i][r] * dq[i];
        cross(w[i], y, z);
        for (int r = 0; r < 3; r++) {
            dw[i][r] += z[r];
            w[i][r] += y[r];
        }
        memcpy(wp, w[i], sizeof wp);
        memcpy(dwp, dw[i], sizeof dwp);
        memcpy(ap, a[i], sizeof ap);
    }
    double F[3] = {0, 0, 0}, N[3] = {0, 0, 0};
    for (int i = NJ - 1; i >= 0; i--) {
        const double *P = pi[i], *h = &pi[i][1];
        double I[3][3] = {{P[4], P[5], P[7]}, {P[5], P[6], P[8]}, {P[7], P[8], P[9]}};
        cross(dw[i], h, x);
        cross(w[i], h, y);
        cross(w[i], y, z);
        for (int r = 0; r < 3; r++) F[r] += P[0] * a[i][r] + x[r] + z[r];
        times(I, dw[i], x);
        times(I, w[i], y);
        cross(w[i], y, z);
        for (int r = 0; r < 3; r++) N[r] += x[r] + z[r];
        cross(h, a[i], x);
        for (int r = 0; r < 3; r++) N[r] += x[r];
        tau[i] = m->axis[i][0] * N[0] + m->axis[i][1] * N[1] + m->axis[i][2] * N[2];
        times(R[i], F, x);
        times(R[i], N, y);
        memcpy(F, x, sizeof F);
        cross(m->p[i], F, z);
        for (int r = 0; r < 3; r++) N[r] = y[r] + z[r];
    }
}

void stopset_gravity_torque(double pi[NJ][10], const double gravity[3], const double q[NJ], double tau[NJ]) {
    const double rest[NJ] = {0};
    stopset_bias_torque(pi, gravity, q, rest, tau);
}

/* Derivative of each joint's gravity torque by its own position, central differences as in stopset.effects.signals. */
void stopset_stiffness(double pi[NJ][10], const double q[NJ], double stiff[NJ]) {
    const double step = 1e-4;
    double x[NJ], up[NJ], down[NJ];
    memcpy(x, q, sizeof x);
    for (int j = 0; j < NJ; j++) {
        x[j] = q[j] + step;
        stopset_gravity_torque(pi, stopset_model.gravity, x, up);
        x[j] = q[j] - step;
        stopset_gravity_torque(pi, stopset_model.gravity, x, down);
        x[j] = q[j];
        stiff[j] = (up[j] - down[j]) / (2.0 * step);
    }
}

/* Angular velocity and velocity of the origin of each link frame, in it; distance of the flange from each axis [m]. */
void stopset_link_motion(const double q[NJ], const double dq[NJ], double w[NJ][3], double v[NJ][3], double radius[NJ]) {
    const StopsetModel *m = &stopset_model;
    double R[NJ][3][3], x[3], y[3], zero[3] = {0, 0, 0}, tip[3];
    for (int i = 0; i < NJ; i++) {
        const double *wp = i ? w[i - 1] : zero, *vp = i ? v[i - 1] : zero;
        joint_rotation(i, q[i], R[i]);
        cross(wp, m->p[i], x);
        for (int r = 0; r < 3; r++) x[r] += vp[r];
        transposed(R[i], x, v[i]);
        transposed(R[i], wp, w[i]);
        for (int r = 0; r < 3; r++) w[i][r] += m->axis[i][r] * dq[i];
    }
    memcpy(tip, m->tip, sizeof tip);
    for (int i = NJ - 1; i >= 0; i--) { /* tip: the flange seen from link frame i */
        cross(m->axis[i], tip, y);
        radius[i] = sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
        times(R[i], tip, x);
        for (int r = 0; r < 3; r++) tip[r] = m->p[i][r] + x[r];
    }
}

/* Mass matrix of a point mass at `com` [m] in the last link's frame, at posture q: mass J'J. */
void stopset_point_mass(double mass, const double com[3], const double q[NJ], double M[NJ][NJ]) {
    const StopsetModel *m = &stopset_model;
    double R[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, o[3] = {0, 0, 0}, z[NJ][3], origin[NJ][3], J[NJ][3];
    double Rj[3][3], next[3][3], work[3];
    for (int i = 0; i < NJ; i++) {
        times(R, m->p[i], work);
        for (int r = 0; r < 3; r++) o[r] += work[r];
        joint_rotation(i, q[i], Rj);
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++) next[r][k] = R[r][0] * Rj[0][k] + R[r][1] * Rj[1][k] + R[r][2] * Rj[2][k];
        memcpy(R, next, sizeof R);
        memcpy(origin[i], o, sizeof o);
        times(R, m->axis[i], z[i]);
    }
    times(R, com, work);
    for (int r = 0; r < 3; r++) o[r] += work[r];
    for (int i = 0; i < NJ; i++) {
        double arm[3] = {o[0] - origin[i][0], o[1] - origin[i][1], o[2] - origin[i][2]};
        cross(z[i], arm, J[i]);
    }
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) M[r][c] = mass * (J[r][0] * J[c][0] + J[r][1] * J[c][1] + J[r][2] * J[c][2]);
}
