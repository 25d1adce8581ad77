/* From measured torque to the input u of the abstraction: what the model knows is taken off.
 *
 * u = tau / gain - offset - gravity (and Coriolis torque, where the model says so) - effects; where a joint stands still friction is set-valued and balances what it can.
 * Identification, comparison, monitor and FMU all come through here.
 *
 * Source: Liu & Althoff (2018), eq. (11).
 */
#include "inputs.h"

#include <string.h>

#include "maths.h"

enum { J = STOPSET_JOINTS };

static double absolute(double x) { return x < 0.0 ? -x : x; }
static double smaller(double a, double b) { return a < b ? a : b; }
static double larger(double a, double b) { return a > b ? a : b; }

static void turned_gravity(const StopsetInputs *map, const double *gravity, int rows, const double *q, int axis, StopsetRigid *out) {
    StopsetArm arm = map->arm;
    double g[J];
    arm.gravity = gravity;
    for (int k = 0; k < rows; k++) {
        stopset_gravity_torques(&arm, 1, q + k * arm.n, g);
        for (int i = 0; i < arm.n; i++) out->tilt[i][axis][k] = g[i];
    }
}

/* Derivative of each joint's gravity torque by its own position: central difference, error ~ step^2 of the torque. */
static void stiffness(const StopsetArm *arm, int k, const double *q, StopsetRigid *out) {
    const double step = 1e-4;
    double x[J], up[J], down[J];
    memcpy(x, q, (size_t)arm->n * sizeof *x);
    for (int j = 0; j < arm->n; j++) {
        x[j] = q[j] + step;
        stopset_gravity_torques(arm, 1, x, up);
        x[j] = q[j] - step;
        stopset_gravity_torques(arm, 1, x, down);
        x[j] = q[j];
        out->stiff[j][k] = (up[j] - down[j]) / (2.0 * step);
    }
}

void stopset_rigid_signals(const StopsetInputs *map, int rows, const double *q, const double *dq, int rest, StopsetRigid *out) {
    const StopsetArm *arm = &map->arm;
    const int n = arm->n, needs = map->needs;
    const double zero[J] = {0};
    double tau[J], M[J * J], Y[10 * J * J];
    for (int k = 0; k < rows; k++) {
        const double *x = q + k * n, *v = rest ? zero : dq + k * n;
        if (needs & STOPSET_NEEDS_LINK) {
            stopset_torques(arm, 1, x, v, zero, tau);
            for (int i = 0; i < n; i++) out->link[i][k] = tau[i];
        }
        if (needs & STOPSET_NEEDS_TIP) {
            stopset_regressors(arm, 1, x, v, zero, Y);
            for (int i = 0; i < n; i++)
                for (int c = 0; c < 10; c++) out->tip[i][c][k] = Y[10 * n * i + 10 * (n - 1) + c];
        }
        if (rest) continue; /* what follows from the pose alone is there already */
        if (needs & STOPSET_NEEDS_LOAD) {
            stopset_gravity_torques(arm, 1, x, tau);
            for (int i = 0; i < n; i++) out->load[i][k] = tau[i];
        }
        if (needs & STOPSET_NEEDS_STIFF) stiffness(arm, k, x, out);
        if (needs & STOPSET_NEEDS_INERTIA) {
            stopset_mass_matrices(arm, 1, x, M);
            for (int i = 0; i < n; i++) out->inertia[i][k] = M[i * n + i];
        }
    }
    if (!rest && needs & STOPSET_NEEDS_TILT) {
        /* a base rolled by +a sees gravity rolled by -a: g' = g - a e_x x g */
        const double *g = arm->gravity, roll[3] = {0.0, g[2], -g[1]}, pitch[3] = {-g[2], 0.0, g[0]};
        turned_gravity(map, roll, rows, q, 0, out);
        turned_gravity(map, pitch, rows, q, 1, out);
    }
}

void stopset_law_signals(const StopsetInputs *map, const StopsetLaw *law, const StopsetLook *look, const StopsetSamples *s,
                         const StopsetRigid *rigid, double (*out)[ROWS]) {
    const int n = map->arm.n, joint = law->joint, other = law->other, rows = look->rows, moves = look->moves;
    const double direction = look->direction;
    for (int k = 0; k < rows; k++) {
        const double dq = moves ? s->dq[k * n + joint] : 0.0;
        out[S_Q][k] = s->q[k * n + joint];
        out[S_DQ][k] = dq;
        out[S_DDQ][k] = 0.0;
        out[S_DIRECTION][k] = direction != 0.0 ? direction : dq != dq ? dq : (double)((dq > 0.0) - (dq < 0.0));
        out[S_DTAU][k] = moves && s->dtau ? s->dtau[k * n + joint] : 0.0;
        out[S_TEMP][k] = s->temp ? s->temp[k * n + joint] - map->reference_temperature : 0.0;
        out[S_WARM][k] = s->warm;
        out[S_T][k] = s->t ? s->t[k] : 0.0;
        out[S_DQ_OTHER][k] = moves && other >= 0 ? s->dq[k * n + other] : 0.0;
        for (int m = 0; m < STOPSET_MEMORIES; m++)
            out[S_MEMORY + m][k] = m < law->memories && s->memory ? s->memory[k * map->memories + law->memory + m] : 0.0;
    }
    if (!map->needs) return;
    for (int k = 0; k < rows; k++) {
        const double load = rigid->load[joint][k], link = rigid->link[joint][k];
        out[S_LOAD][k] = load;
        out[S_TAU][k] = out[S_LINK][k] = link;
        out[S_CORIOLIS][k] = link - load;
        out[S_STIFF][k] = rigid->stiff[joint][k];
        out[S_INERTIA][k] = rigid->inertia[joint][k];
        out[S_TILT][k] = rigid->tilt[joint][0][k];
        out[S_TILT + 1][k] = rigid->tilt[joint][1][k];
        for (int c = 0; c < 10; c++) out[S_TIP + c][k] = rigid->tip[joint][c][k];
    }
}

/* Torque of all laws together, out (J, ROWS). */
static void effects(const StopsetInputs *map, const StopsetLook *look, const StopsetSamples *s, const StopsetRigid *rigid, double (*out)[ROWS]) {
    const int rows = look->rows;
    double signals[STOPSET_SIGNALS][ROWS], tau[ROWS];
    memset(signals, 0, sizeof signals);
    memset(out, 0, (size_t)map->arm.n * sizeof *out);
    for (int l = 0; l < map->laws; l++) {
        const StopsetLaw *law = map->law + l;
        stopset_law_signals(map, law, look, s, rigid, signals);
        stopset_play(&law->torque, (const double(*)[ROWS])signals, rows, tau);
        for (int k = 0; k < rows; k++) out[law->joint][k] += tau[k];
    }
}

static void block(const StopsetInputs *map, int rows, const StopsetSamples *s, double *u) {
    const int n = map->arm.n;
    StopsetRigid rigid;
    double moving[J][ROWS], ahead[J][ROWS], back[J][ROWS], g[J];
    const double zero[J] = {0};
    int still = 0;
    memset(&rigid, 0, map->needs ? sizeof rigid : 0);
    if (map->needs) stopset_rigid_signals(map, rows, s->q, s->dq, 0, &rigid);
    for (int k = 0; k < rows; k++) {
        if (map->motor_torque && map->swift)
            stopset_torques(&map->arm, 1, s->q + k * n, s->dq + k * n, zero, g);
        else if (map->motor_torque)
            stopset_gravity_torques(&map->arm, 1, s->q + k * n, g);
        for (int i = 0; i < n; i++) {
            double x = s->tau[k * n + i] / map->gain[i] - map->offset[i];
            if (map->motor_torque) x -= g[i];
            u[k * n + i] = x;
            still |= absolute(s->dq[k * n + i]) <= map->standstill[i];
        }
    }
    if (!map->laws) return;
    effects(map, &(StopsetLook){rows, 1, 0.0}, s, &rigid, moving);
    still = still && map->motor_torque;
    if (still) {
        if (map->needs & (STOPSET_NEEDS_LINK | STOPSET_NEEDS_TIP)) stopset_rigid_signals(map, rows, s->q, s->dq, 1, &rigid);
        effects(map, &(StopsetLook){rows, 0, 1.0}, s, &rigid, ahead);
        effects(map, &(StopsetLook){rows, 0, -1.0}, s, &rigid, back);
    }
    for (int k = 0; k < rows; k++)
        for (int i = 0; i < n; i++) {
            double *x = u + k * n + i;
            if (still && absolute(s->dq[k * n + i]) <= map->standstill[i]) {
                const double low = smaller(ahead[i][k], back[i][k]), high = larger(ahead[i][k], back[i][k]);
                *x -= *x < low ? low : *x > high ? high : *x;
            } else
                *x -= moving[i][k];
        }
}

int stopset_inputs(const StopsetInputs *map, int64_t N, const StopsetSamples *s, double *u) {
    const int n = map->arm.n;
    if (n < 1 || n > J) return STOPSET_TOO_MANY_JOINTS;
    for (int64_t k = 0; k < N; k += ROWS) {
        StopsetSamples part = *s;
        part.q += k * n;
        part.dq += k * n;
        part.tau += k * n;
        if (s->temp) part.temp += k * n;
        if (s->dtau) part.dtau += k * n;
        if (s->t) part.t += k;
        if (s->memory) part.memory += k * map->memories;
        block(map, N - k < ROWS ? (int)(N - k) : ROWS, &part, u + k * n);
    }
    return STOPSET_OK;
}
