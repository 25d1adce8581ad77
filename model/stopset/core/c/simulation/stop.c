/* Stops of the simulated arm, the truth that bounds are tested on: power off, brakes close, joints slide, then stick.
 *
 *     M(q) dv/dt + c(q, v) + g(q) + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i),   M with rotor inertia
 *
 * B_i(t) is zero until the brake's delay is over, then a ramp to its torque. Time stepping after Moreau, of second order in
 * smooth phases; a step in which a joint comes to rest or turns round is split at that moment.
 *
 * Source: Moreau (1988); Acary & Brogliato (2008), ch. 10.
 */
#include <string.h>

#include "simulation.h"

/* Impulse a brake can give from t to t + h [N m s]: the exact integral of its torque ramp. */
double sim_brake_impulse(double t, double h, double delay, double rise, double level) {
    const double s = t - delay, e = t + h - delay;
    double total = 0.0;
    if (e > 0.0) total = e >= rise ? e - 0.5 * rise : 0.5 * e * e / rise;
    if (s > 0.0) total -= s >= rise ? s - 0.5 * rise : 0.5 * s * s / rise;
    return level * total;
}

typedef struct {
    double q[SIM_JOINTS], v[SIM_JOINTS], rate[SIM_JOINTS];
} State;

static void set_up(const StopsetSimStop *s, const State *x, double t, double h, const double *u, SimFriction *f) {
    const int n = s->arm.n;
    double middle[SIM_JOINTS], speed[SIM_JOINTS], bias[SIM_JOINTS];
    for (int i = 0; i < n; i++) {
        middle[i] = x->q[i] + 0.5 * h * x->v[i];
        speed[i] = x->v[i] + 0.5 * h * x->rate[i];
    }
    sim_mass_and_bias(&s->arm, middle, speed, f->A, bias);
    for (int i = 0; i < n; i++) {
        f->A[i * n + i] += s->rotor[i];
        double b = h * (u[i] - bias[i] - 0.5 * s->viscous[i] * x->v[i]);
        for (int j = 0; j < n; j++) b += f->A[i * n + j] * x->v[j];
        f->b[i] = b;
        f->plus[i] = f->minus[i] = h * s->dry[i] + sim_brake_impulse(t, h, s->delay[i], s->rise[i], s->brake[i]);
        if (x->v[i] != 0.0) f->mode[i] = x->v[i] > 0.0 ? 1 : -1;
    }
    for (int i = 0; i < n; i++) f->A[i * n + i] += 0.5 * h * s->viscous[i];
}

int stopset_sim_stop(const StopsetSimStop *s, const double *q0, const double *v0, const StopsetSimTime *time, double *qs, double *vs) {
    const double dt = time->dt;
    const int64_t steps = time->steps;
    const int n = s->arm.n;
    const size_t row = (size_t)(n > 0 ? n : 0) * sizeof(double);
    State x;
    SimFriction f;
    if (n < 1 || n > SIM_JOINTS) return STOPSET_TOO_MANY_JOINTS;
    memset(&x, 0, sizeof x);
    memset(&f, 0, sizeof f);
    f.n = n;
    memcpy(x.q, q0, row);
    memcpy(x.v, v0, row);
    memcpy(qs, q0, row);
    memcpy(vs, v0, row);
    for (int64_t k = 0; k < steps; k++) {
        const double *u = time->disturbance + k * time->pieces / steps * n;
        double t = (double)k * dt, left = dt;
        int splits = 0;
        while (left > 0.0) {
            double h = left;
            int event = -1;
            for (;;) {
                set_up(s, &x, t, h, u, &f);
                sim_solve(&f);
                if (event >= 0 || splits >= SIM_SPLITS * n || !sim_crosses(&f, x.v)) break;
                const double share = sim_first_crossing(&f, x.v, &event);
                splits = event >= 0 ? splits + 1 : SIM_SPLITS * n;
                h = (share > SIM_SMALLEST ? share : SIM_SMALLEST) * left;
            }
            if (event >= 0) { /* this joint is at rest at the end of the piece, exactly */
                f.w[event] = 0.0;
                f.mode[event] = 0;
            }
            for (int i = 0; i < n; i++) {
                x.q[i] += 0.5 * h * (x.v[i] + f.w[i]);
                x.rate[i] = (f.w[i] - x.v[i]) / h;
                x.v[i] = f.w[i];
            }
            t += h;
            left = left - h < SIM_SMALLEST * dt ? 0.0 : left - h;
        }
        memcpy(qs + (k + 1) * n, x.q, row);
        memcpy(vs + (k + 1) * n, x.v, row);
    }
    return STOPSET_OK;
}
