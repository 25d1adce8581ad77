/* The arm with its load, by the rigid body of the core that identification and monitor use (stopset.h). */
#include <string.h>

#include "stopset_core.h"

/* The core's view of the arm; `pi` may be 0 where only geometry is asked for. */
static StopsetArm arm_of(const double (*pi)[10], const double *gravity) {
    const StopsetModel *m = &stopset_model;
    const StopsetArm arm = {NJ, &m->R[0][0][0], &m->p[0][0], &m->axis[0][0], gravity, pi ? pi[0] : 0};
    return arm;
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

/* Torque of gravity and velocity, no acceleration. */
void stopset_bias_torque(double pi[NJ][10], const double gravity[3], const double q[NJ], const double dq[NJ], double tau[NJ]) {
    const StopsetArm arm = arm_of((const double(*)[10])pi, gravity);
    const double rest[NJ] = {0};
    stopset_torques(&arm, 1, q, dq, rest, tau);
}

void stopset_gravity_torque(double pi[NJ][10], const double gravity[3], const double q[NJ], double tau[NJ]) {
    const StopsetArm arm = arm_of((const double(*)[10])pi, gravity);
    stopset_gravity_torques(&arm, 1, q, tau);
}

/* Derivative of each joint's gravity torque by its own position, central differences as in the core's inputs. */
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

/* Mass matrix of a point mass at `com` [m] in the last link's frame, at posture q: mass J'J. */
void stopset_point_mass(double mass, const double com[3], const double q[NJ], double M[NJ][NJ]) {
    const StopsetArm arm = arm_of(0, stopset_model.gravity);
    double p[3], J[3][NJ];
    stopset_point(&arm, q, NJ - 1, com, p, J[0]);
    for (int r = 0; r < NJ; r++)
        for (int c = 0; c < NJ; c++) M[r][c] = mass * (J[0][r] * J[0][c] + J[1][r] * J[1][c] + J[2][r] * J[2][c]);
}
