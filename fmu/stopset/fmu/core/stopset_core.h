/* One instance of an identified arm: state, parameters, prediction, bounds. No FMI in here.
 *
 * The header model_config.h and the file model_data.c are written by `stopset export-fmu` for one model: sizes, positions
 * of the variables, and every number. Nothing is read from disk, nothing is allocated after stopset_setup().
 */
#ifndef STOPSET_CORE_H
#define STOPSET_CORE_H

#include <stdint.h>

#include "core/stopset.h"
#include "model_config.h" /* NJ, NV, N_REAL, N_INT, N_BOOL, the VR_ and IX_ positions */

enum { NX = 2 * NJ, NM = N_MEMORY > 0 ? N_MEMORY : 1, NS = NX + N_MEMORY }; /* joints, effects that remember, both */

/* Needs nothing of the C library, unlike isfinite on some platforms. */
static inline int stopset_finite(double x) { return x - x == 0.0; }

/* What may be done with a variable. */
enum { KIND_TIME, KIND_INPUT, KIND_OUTPUT, KIND_FIXED, KIND_TUNABLE, KIND_LOCAL };

/* Conformance verdict. */
enum { VERDICT_NONE = 0, VERDICT_CONFORMANT = 1, VERDICT_VIOLATED = 2 };

/* The model as identified, in SI units; same names as the model file. */
typedef struct {
    double Minv[NJ][NJ];                           /* inverse inertia, incl. rotors [1/(kg m^2)] */
    double X0_lo[NX], X0_hi[NX], V_lo[NX], V_hi[NX]; /* start and reading uncertainty over (q, dq) */
    double U_lo[NJ], U_hi[NJ];                     /* additive torque [N m] */
    double dt, horizon;                            /* grid and longest age of the prediction [s] */
    double q_lo[NJ], q_hi[NJ], dq_lo[NJ], dq_hi[NJ], u_lo[NJ], u_hi[NJ]; /* domain of validity */
    double temp_lo[NJ], temp_hi[NJ], payload_lo, payload_hi;
    double R[NJ][3][3], p[NJ][3], axis[NJ][3], gravity[3], pi[NJ][10], tip[3]; /* rigid body, see stopset.robot */
    double standstill[NJ];                         /* speed below which a joint counts as still [rad/s] */
    /* stops: where the model speaks of a measured state, what a stop starts from less that state, errors of a reading */
    double stop_q_lo[NJ], stop_q_hi[NJ], stop_dq_lo[NJ], stop_dq_hi[NJ], stop_centre[NX], stop_radius[NX], noise_lo[NX], noise_hi[NX];
    double brake_mid[NJ], brake_delay[NJ], brake_rise[NJ]; /* nominal brake, for the motion */
    double q_a[NJ];                                /* posture at which Minv was taken [rad] */
    int decoupled, signed_response, position_only, motor_torque, swift, has_domain_temp, has_brakes;
    double start_real[N_REAL];
    int32_t start_int[N_INT];
    uint8_t start_bool[N_BOOL];
    uint8_t kind[N_REAL + N_INT + N_BOOL];
    const char *name[N_REAL + N_INT + N_BOOL];
} StopsetModel;

extern const StopsetModel stopset_model;
extern const char stopset_token[];
extern const char stopset_refusal[]; /* why has_brakes is 0: no stop of this model is bounded */
extern const StopsetStops stopset_stops; /* what bounds a stop; empty where none is bounded */

/* phi functions of one step h: e^{Ah}, its integral, and the integral of that (velocity part of the linear model). */
typedef struct {
    double h, F[NJ][NJ], G[NJ][NJ], H[NJ][NJ];
} StopsetStep;

/* A stop bound and the box of states that it holds for; `steps` since it was made. */
typedef struct {
    double q[NJ], dq[NJ], q_radius[NJ], dq_radius[NJ], time[NJ], forward[NJ], back[NJ], speed[NJ], tool[2], at;
    int32_t steps;
    uint8_t made, exact, proved;
} StopsetCertificate;

/* Plain data: a copy of it is a complete state. */
typedef struct {
    double r[N_REAL];
    int32_t i[N_INT];
    uint8_t b[N_BOOL];
    double Minv[NJ][NJ], M[NJ][NJ], Av[NJ][NJ]; /* with payload and parameters as set */
    double start_time, tube_start, stop_start;
    StopsetStep step;                /* of the last communication step */
    StopsetStep grid;                /* of the tube's grid */
    double growth_q[NJ][NJ], growth_v[NJ][NJ];
    int64_t tube_k;                  /* grid age of what follows */
    double tube_F[NJ][NJ], tube_G[NJ][NJ], plus[NX][NJ], minus[NX][NJ];
    double h_try;                    /* step size that the nonlinear integrator takes up again */
    double corner[2][NX];            /* lower and upper corner trajectories of polynomial friction */
    double length;                   /* of the last communication step [s], the model's own before */
    double stop_q[NJ], stop_dq[NJ], stop_lo[NX], stop_hi[NX]; /* of the moment a stop was asked for */
    StopsetCertificate certificate;
    int32_t mode[NJ];                /* friction: sliding down -1, sticking 0, sliding up 1 */
    uint8_t as_identified, violated, outputs_ready;
    uint8_t stopping;        /* 0 no, 1 STOP 0, 2 STOP 1; stays until reset */
    uint8_t modes_by_events; /* model exchange: friction directions change at events only */
    uint8_t modes_held;      /* friction directions stay as they are, for derivatives */
} StopsetState;

void stopset_defaults(StopsetState *s);
/* Take over start values and parameters at time t0; returns 0 or a sentence what is wrong. */
const char *stopset_setup(StopsetState *s, double t0);
/* Begin a stop that is asked for; returns 0 or a sentence. `work`: what the stop proofs need, stopset_stop_room(NJ) numbers. */
const char *stopset_trigger(StopsetState *s, double *work);
/* Advance by h with the inputs held; returns 0 or a sentence. */
const char *stopset_step(StopsetState *s, double h, double *work);
/* Bounds, flags and accelerations at the present time and state, without the stop bounds. */
void stopset_outputs(StopsetState *s);
/* Hold the measured inputs against the tube of the present time; latches a violation. */
void stopset_check(StopsetState *s);
/* New prediction from the measured state if the horizon ends before `ahead` [s] more and `restart` asks for it. */
int stopset_restart(StopsetState *s, double ahead);
/* Rates of change at the present state: accelerations [rad/s^2], and of what the effects remember (N_MEMORY of them). */
void stopset_accelerations(const StopsetState *s, double ddq[NJ], double *rate);

/* linear.c */
void stopset_phi(double Av[NJ][NJ], double h, StopsetStep *out);
int stopset_invert(double X[NJ][NJ], double out[NJ][NJ]);
/* tube.c */
void stopset_tube_reset(StopsetState *s);
void stopset_tube(StopsetState *s, double age, double lo[NX], double hi[NX]);
/* motion.c */
int stopset_exact(const StopsetState *s); /* whether the next step has a closed form */
void stopset_input(const StopsetState *s, double u[NJ]);
void stopset_memory_step(StopsetState *s, double h); /* at the measured state, held */
void stopset_motion_reset(StopsetState *s);
/* Friction directions anew; velocities that came to rest within `slack` [rad/s] become zero; whether one changed. */
int stopset_update_modes(StopsetState *s, double slack);
void stopset_indicators(const StopsetState *s, double z[NJ]);
const char *stopset_integrate(StopsetState *s, double h);
void stopset_corner_tube(const StopsetState *s, double lo[NX], double hi[NX]);
/* stops.c: the stop outputs; `exact`: for this state alone. At a request: the bounds of this moment, and of what is read after. */
void stopset_stop_bounds(StopsetState *s, int exact, double *work);
void stopset_stop_request(StopsetState *s, double *work);
/* model_data.c: torque of the model's effects beyond the viscous polynomial [N m], and the flow of what they remember */
void stopset_effects(const StopsetState *s, const double q[NJ], const double dq[NJ], const double way[NJ],
                     const double load[NJ], const double *memory, double tau[NJ]);
void stopset_memory_rates(const StopsetState *s, const double q[NJ], const double dq[NJ], const double way[NJ],
                          const double load[NJ], const double *memory, double *rate);
/* body.c */
void stopset_loaded_links(const StopsetState *s, double pi[NJ][10]); /* standard parameters with the payload */
void stopset_bias_torque(double pi[NJ][10], const double gravity[3], const double q[NJ], const double dq[NJ], double tau[NJ]);
void stopset_stiffness(double pi[NJ][10], const double q[NJ], double stiff[NJ]);
void stopset_gravity_torque(double pi[NJ][10], const double gravity[3], const double q[NJ], double tau[NJ]);
void stopset_point_mass(double mass, const double com[3], const double q[NJ], double M[NJ][NJ]);

#endif
