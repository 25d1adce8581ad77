/* Mass matrix and bias torque of an arm in one pass, for loops that need both ten thousand times a second.
 *
 * Source: Featherstone (2008), ch. 2.10 (acceleration), 5.3 and 6.2, in base coordinates.
 */
#include "../maths.h"
#include "../wide.h"
#include "simulation.h"

#define NUMBER double
#define ALL(x) (x)
#define OF(name) one_##name
#define one_sincos stopset_sincos
#include "dynamics_of.h"

void sim_mass_and_bias(const StopsetArm *arm, const double *q, const double *dq, double *M, double *bias) {
    one_mass_and_bias(arm->n, arm, arm->pi, q, dq, M, bias);
}

int stopset_sim_mass_and_bias(const StopsetArm *arm, const double *q, const double *dq, double *M, double *bias) {
    if (arm->n < 1 || arm->n > SIM_JOINTS) return STOPSET_TOO_MANY_JOINTS;
    sim_mass_and_bias(arm, q, dq, M, bias);
    return STOPSET_OK;
}

int stopset_sim_torques(const StopsetArm *arm, const double *rotor, int64_t N, const double *q, const double *dq, const double *ddq,
                        double *out) {
    const int n = arm->n;
    double M[SIM_JOINTS * SIM_JOINTS], bias[SIM_JOINTS];
    if (n < 1 || n > SIM_JOINTS) return STOPSET_TOO_MANY_JOINTS;
    for (int64_t k = 0; k < N * n; k += n) {
        sim_mass_and_bias(arm, q + k, dq + k, M, bias);
        for (int i = 0; i < n; i++) {
            double sum = bias[i] + rotor[i] * ddq[k + i];
            for (int j = 0; j < n; j++) sum += M[i * n + j] * ddq[k + j];
            out[k + i] = sum;
        }
    }
    return STOPSET_OK;
}
