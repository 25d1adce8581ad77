/* One instance of an identified arm: state, parameters, prediction, bounds. No FMI in here.
 *
 * The header model_config.h and the file model_data.c are written by `stopset export-fmu` for one model: sizes, positions
 * of the variables, and every number. Nothing is read from disk, nothing is allocated after stopset_setup().
 */
#ifndef STOPSET_CORE_H
#define STOPSET_CORE_H

#include <stdint.h>

#include "core/inputs.h"
#include "core/stopset.h"
#include "model_config.h" /* NJ, NV, N_REAL, N_INT, N_BOOL, AGES and so on, the VR_ and IX_ positions */

enum { NX = 2 * NJ, NM = N_MEMORY > 0 ? N_MEMORY : 1, NS = NX + N_MEMORY }; /* joints, effects that remember, both */
enum { NONLINEAR = CORNERS || PATHS, NB = NV > 0 ? NV : 1 }; /* corners of decoupled joints; paths of all others, see core/along.c */
enum { N_SCALARS = N_REAL + N_INT + N_BOOL, NA = N_ARRAYS > 0 ? N_ARRAYS : 1 }; /* value references: scalars, arrays, clocks */
enum { NL = N_LAWS > 0 ? N_LAWS : 1, NN = N_NUMBERS > 0 ? N_NUMBERS : 1 };

/* Needs nothing of the C library, unlike isfinite on some platforms. */
static inline int stopset_finite(double x) { return x - x == 0.0; }

/* What may be done with a variable. */
enum { KIND_TIME, KIND_INPUT, KIND_OUTPUT, KIND_FIXED, KIND_TUNABLE, KIND_LOCAL };

/* Conformance verdict. */
enum { NOTHING_BEFORE = -1, VERDICT_NONE = 0, VERDICT_CONFORMANT = 1, VERDICT_VIOLATED = 2 };

/* A law on tape: its steps, where its constants begin among all, and its parameters, which these begin with, among the unit's. */
typedef struct {
    const int32_t *steps;
    int32_t length, numbers, parameters, parameter;
} StopsetTape;

/* Whose torque a tape gives, see StopsetLaw; a state that its effect remembers, whose rate a tape gives, and all it can be. */
typedef struct {
    int32_t joint, other, memory, memories, tape;
} StopsetPlace;
typedef struct {
    int32_t law, tape;
    double whole[2];
} StopsetMemory;

/* The model as identified, in SI units; same names as the model file. */
typedef struct {
    double Minv[NJ][NJ];                           /* inverse inertia, incl. rotors [1/(kg m^2)] */
    double X0_lo[NX], X0_hi[NX], V_lo[NX], V_hi[NX]; /* start and reading uncertainty over (q, dq) */
    double U_lo[N_TORQUES], U_hi[N_TORQUES];       /* additive torque [N m], along the directions .across */
    double across[NJ][N_TORQUES];
    double dt, horizon;                            /* grid and longest age of the prediction [s] */
    double lo[4 * NJ], hi[4 * NJ];                 /* domain of validity: q, dq, u, temp */
    double payload_lo, payload_hi;
    double stop_per_kg[10], stop_weighed;          /* of the last link by a payload [per kg]; [kg] by which it may be off */
    double R[NJ][3][3], p[NJ][3], axis[NJ][3], gravity[3], pi[NJ][10]; /* rigid body, see stopset.robot */
    double gain[NJ], standstill[NJ];               /* recorded per true torque; speed below which a joint counts as still [rad/s] */
    /* stops: where the model speaks of a measured state, the joints' ranges, what a stop starts from less that state, errors of a reading */
    double stop_q_lo[NJ], stop_q_hi[NJ], stop_dq_lo[NJ], stop_dq_hi[NJ], range_lo[NJ], range_hi[NJ], stop_centre[NX], stop_radius[NX], truth_centre[NX], truth_radius[NX], noise_lo[NX],
        noise_hi[NX];
    double brake_mid[NJ], brake_delay[NJ], brake_rise[NJ]; /* nominal brake, for the motion */
    int ramp_timed;                                /* nominal ramp: of a length, as shares of stop1_time, else of a deceleration */
    double ramp_value[NJ], ramp_delay[NJ], ramp_pace; /* [1] or [rad/s^2]; [s]; [1/s] */
    double q_a[NJ];                                /* posture at which Minv was taken [rad] */
    double reference_temperature;                  /* [degC] */
    int needs;                                     /* what laws look at of the rigid body */
    int decoupled, generators, position_only, motor_torque, swift, plain, sliding, timed, has_domain_temp, has_brakes;
    StopsetPlace place[NL];
    StopsetMemory memory[NM];
    double numbers[NN];                            /* constants of all tapes */
    double start_real[N_REAL];
    int32_t start_int[N_INT];
    uint8_t start_bool[N_BOOL];
    uint8_t kind[N_REAL + N_INT + N_BOOL];
    const char *name[N_REAL + N_INT + N_BOOL];
} StopsetModel;

extern const StopsetPolynomials stopset_polynomials_of; /* of models 2 and 3; empty else */
extern const StopsetTape stopset_tapes[];
extern const StopsetModel stopset_model;
extern const uint32_t stopset_arrays[]; /* the first of the NJ scalars that an array of FMI 3 is, N_ARRAYS of them */
extern const char stopset_token[];
extern const char stopset_refusal[]; /* why has_brakes is 0: no stop of this model is bounded */
extern const StopsetStops stopset_stops; /* what bounds a stop; empty where none is bounded */
extern const StopsetRamp stopset_ramp;   /* and a controlled one */
extern const StopsetPath stopset_path;   /* and one along a path, where HAS_PATH */
enum { STOP_0, STOP_1, STOP_1_FAILED, STOP_2, STOP_PATH }; /* the first N_STOPS of them have outputs */

/* One step's matrices, and with them those of its responses. */
enum { STEP_ROOM = 2 * NX * NX + 2 * NX * N_TORQUES, RESPONSE_ROOM = N_TORQUES * 7 * NX + NX * NX };

/* What follows from the parameters, and room to compute in: nothing in it outlives another choice of parameters. */
typedef struct {
    double key[N_KEY];                             /* the parameters it was made of */
    int made;
    double pi[NJ][10], offset[NJ], numbers[NN];    /* links with the payload; [N m]; constants of all tapes */
    double Minv[NJ][NJ], M[NJ][NJ], Av[NJ][NJ];
    double sliding[NJ][NJ];                        /* inverse of M's block of the joints that slide */
    uint8_t sliding_of[NJ], sliding_made;          /* which these are */
    StopsetLaw law[NL];
    StopsetCarried carried[NM];
    StopsetInputs map;
    StopsetMonitor monitor;
    StopsetLinear linear;
    StopsetSets sets;
    double grid[STEP_ROOM], piece[STEP_ROOM], h;   /* the model's own step, another one and its length */
    double lo[AGES][NX], hi[AGES][NX];             /* the deviation tube, and that of the monitor's cycle */
    double watch_lo[AGES][NX], watch_hi[AGES][NX], watch_middle[AGES][NX], watch_reach[AGES][NX];
    int64_t age;                                   /* steps until the responses below */
    double E[NX * NX], plus[NX * N_TORQUES], minus[NX * N_TORQUES], response[RESPONSE_ROOM];
    StopsetDynamics dynamics;
    double viscous[NJ][NB], carried_load[NJ][NJ], room[ROOM]; /* damping; inertia of the payload; work of the core */
    StopsetRigid rigid;
    double signals[STOPSET_SIGNALS][ROWS];         /* of one law; what is not asked of the rigid body stays zero */
    double since;                                  /* [s] the start, of the sample in hand */
    double (*between)(void *who, double end);      /* told where the integrator has come to in a step until `end`, says when it ends [s] */
    void *who;
    int ends_at_rest;                              /* whether a step in which a stopping arm comes to rest ends there */
    double *proof;                                 /* room of the proofs, where stops are bounded */
} StopsetWork;

/* Predictions from past samples, as the monitor has them. */
#if CORNERS || PATHS
typedef struct {
    double x[CORNERS ? 2 : 1][AGES][NX], sum[2][NJ], ends[NM][2]; /* see core/stopset.h; and what is remembered */
#if PATHS
    double u[AGES][2][NJ];
#endif
    int64_t count[STOPSET_ALONG_COUNTS];
    int32_t every, said;                 /* samples per step of the grid; its verdict */
    uint8_t starts[AGES], outside[AGES];
} StopsetPast;
#else
typedef struct {
    double e[PREDICTIONS][NX], w[PREDICTIONS][NX], ends[NM][2], x[NX], u[NJ], du[NJ];
    int64_t age[PREDICTIONS], next, since;
    uint8_t foreign[PREDICTIONS], known;
} StopsetPast;
#endif

/* A stop bound and the box of states that it holds for; `steps` since it was made; `begin`: the pose, as it is read, that its ways count from. */
typedef struct {
    double q[NJ], dq[NJ], q_radius[NJ], dq_radius[NJ], begin[NJ], time[NJ], forward[NJ], back[NJ], speed[NJ], tool[2], at, row, rate;
    int32_t steps;
    uint8_t made, exact, proved;
} StopsetCertificate;

/* Plain data: a copy of it is a complete state. */
typedef struct {
    double r[N_REAL];
    int32_t i[N_INT];
    uint8_t b[N_BOOL];
    double start_time, tube_start, stop_start;
    double h_try;                    /* step size that the nonlinear integrator takes up again */
    double corner[2][NX];            /* lower and upper corner trajectories of polynomial friction */
#if PATHS
    double path[AGES][NX], torque[AGES][NJ]; /* the unit's own prediction on the model's grid */
#endif
    int32_t along, parts;            /* its steps, -1: it has left the grid and has no bounds; parts of a corner's step */
    double length;                   /* of the last communication step [s], the model's own before */
    double stop_q[NJ], stop_dq[NJ], stop_lo[NX], stop_hi[NX]; /* of the moment a stop was asked for */
    StopsetCertificate certificate[N_STOPS];
    StopsetPast past;
    int32_t mode[NJ];                /* friction: sliding down -1, sticking 0, sliding up 1 */
    uint8_t as_identified, violated, outputs_ready;
    uint8_t unsampled;       /* no state was measured yet: the first one is where the prediction begins */
    uint8_t reloaded;        /* another payload since the prediction began: nothing was tested across that */
    uint8_t ticked;          /* the stop that a clock asks for, as `stopping` */
    uint8_t stopping;        /* 0 no, 1 STOP 0, 2 STOP 1, 3 STOP 2; stays until reset */
    uint8_t modes_by_events; /* model exchange: friction directions change at events only */
    uint8_t modes_held;      /* friction directions stay as they are, for derivatives */
} StopsetState;

void stopset_defaults(StopsetState *s);
/* Take over start values and parameters at time t0; returns 0 or a sentence what is wrong. */
const char *stopset_setup(StopsetState *s, StopsetWork *w, double t0);
/* Begin a stop that is asked for; returns 0 or a sentence. */
const char *stopset_trigger(StopsetState *s, StopsetWork *w);
/* Advance by h with the inputs held; returns 0 or a sentence. `done`: how far it came, less than h where work says so. */
const char *stopset_step(StopsetState *s, StopsetWork *w, double h, double *done);
/* Another payload within a run: what was predicted before does not speak of it. */
void stopset_reload(StopsetState *s);
/* Another parameter within a run: what was proved before does not speak of it. A sentence where a range is none. */
void stopset_retune(StopsetState *s);
const char *stopset_no_range(const StopsetState *s);
/* One more step since the certificates were made. */
void stopset_count(StopsetState *s);
/* Bounds, flags and accelerations at the present time and state, without the stop bounds. */
void stopset_outputs(StopsetState *s, StopsetWork *w);
/* Hold the measured inputs against the tube of the present time; latches a violation. */
void stopset_check(StopsetState *s, StopsetWork *w);
/* The prediction begins at the first state that is measured, wherever the unit was told to start. */
void stopset_begin(StopsetState *s, StopsetWork *w);
/* New prediction from the measured state if its bounds end before `ahead` [s] more, unless `restart` is off. */
void stopset_restart(StopsetState *s, StopsetWork *w, double ahead);

/* prepare.c: what follows from the parameters of s, made anew where they are others; 0 or a sentence. Nothing else has pointers. */
const char *stopset_prepare(const StopsetState *s, StopsetWork *w);
int stopset_invert(double X[NJ][NJ], double out[NJ][NJ]); /* 0 if singular */
void stopset_torque_part(const double step[STEP_ROOM], double Bd[NX * NJ]); /* its input matrix */
void stopset_grow(StopsetWork *w, int64_t k); /* the responses at the age of k steps */
/* sample.c */
void stopset_forget(StopsetState *s);
/* The sample in hand: state, input and how far that is unknown, whether a signal is beyond the domain. 0: it cannot be used, and what
 * came before is forgotten. */
int stopset_take_sample(StopsetState *s, StopsetWork *w, double x[NX], double u[NJ], double du[NJ], int *foreign);
/* A measured sample as the monitor takes it: a verdict, with the joint if it is a violation, or that it follows no other. nonlinear.c:
 * `every`: samples per step of the grid. */
int stopset_sample(StopsetState *s, StopsetWork *w, int32_t *joint);
int stopset_sample_along(StopsetState *s, StopsetWork *w, int32_t every, int32_t *joint);
/* nonlinear.c: the unit's own prediction: from the present state, one step of h under u, its bounds now. */
void stopset_own_start(StopsetState *s, const StopsetWork *w);
void stopset_own_step(StopsetState *s, StopsetWork *w, const double u[NJ], double h);
void stopset_own_bounds(const StopsetState *s, StopsetWork *w, double lo[NX], double hi[NX]);
/* motion.c */
int stopset_exact(const StopsetState *s); /* whether the next step has a closed form */
void stopset_input(const StopsetState *s, StopsetWork *w, double u[NJ]);
void stopset_memory_step(StopsetState *s, StopsetWork *w, double h); /* at the measured state, held */
/* Friction directions anew; velocities that came to rest within `slack` [rad/s] become zero. */
void stopset_update_modes(StopsetState *s, StopsetWork *w, double slack);
double stopset_brakes_change(double since); /* [s] after power off at which a brake's torque begins or ends to rise next (infinite: never) */
void stopset_indicators(const StopsetState *s, StopsetWork *w, double z[NJ]);
const char *stopset_integrate(StopsetState *s, StopsetWork *w, double h, double *done);
/* Rates of change at the present state: accelerations [rad/s^2], and of what the effects remember (N_MEMORY of them). */
void stopset_accelerations(const StopsetState *s, StopsetWork *w, double ddq[NJ], double *rate);
/* stops.c: the outputs of a category; `exact`: for this state alone. At a request: the bounds of this moment, and of what is read after. */
void stopset_stop_bounds(StopsetState *s, StopsetWork *w, int category, int exact);
void stopset_stop_request(StopsetState *s, StopsetWork *w, int request);
/* Whose output a real variable or a boolean is, -1: no stop's. */
int stopset_stop_output(unsigned real);
int stopset_stop_flag(unsigned boolean);
/* ramp.c: the nominal motion `since` [s] the request, its acceleration there, and when that changes next (infinite: never) */
void stopset_ramp_motion(const StopsetState *s, double since, double q[NJ], double dq[NJ], double ddq[NJ]);
double stopset_ramp_changes(const StopsetState *s, double since);
double stopset_ramp_length(const StopsetState *s); /* [s] from the request until every joint rests */

#endif
