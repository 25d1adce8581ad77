/* The compiled core: what Python, the monitor and the FMU call. One header, plain C11, no Python in it.
 *
 * SI units throughout. Matrices lie row by row. n: joints, at most STOPSET_JOINTS. Nothing here allocates, keeps
 * anything between two calls or touches a file; a function that can refuse returns one of the codes below.
 * Lines between the marks `cffi` are read by build.py for the Python binding: declarations only.
 */
#ifndef STOPSET_H
#define STOPSET_H

#include <stdint.h>

#if defined(_WIN32)
#define STOPSET_API __declspec(dllexport)
#elif defined(__GNUC__)
#define STOPSET_API __attribute__((visibility("default")))
#else
#define STOPSET_API
#endif

/* cffi begin */
enum {
    STOPSET_OK = 0,
    STOPSET_TOO_MANY_JOINTS = 1 /* n is not within 1..STOPSET_JOINTS */
};
#define STOPSET_JOINTS 32

/* Hash of the sources and flags that the library was made from. */
STOPSET_API const char *stopset_sources(void);

/* ---- maths.c: elementary functions with the same bits everywhere; largest errors in units in the last place (ulp) */

/* |x| <= 1e6 rad: 0.75 ulp; beyond: not a number. */
STOPSET_API double stopset_sin(double x);
STOPSET_API double stopset_cos(double x);
/* 0.8 ulp; below the normal numbers 1 ulp. */
STOPSET_API double stopset_exp(double x);
/* 1.5 ulp. */
STOPSET_API double stopset_expm1(double x);
/* 2 ulp. */
STOPSET_API double stopset_tanh(double x);
/* 1 ulp; of zero -Inf, of less not a number. */
STOPSET_API double stopset_log(double x);
/* The same of many numbers, `which`: 0 sin, 1 cos, 2 exp, 3 expm1, 4 tanh, 5 log. */
STOPSET_API int stopset_maths(int which, int64_t N, const double *x, double *out);

/* ---- rigid.c: rigid-body dynamics of a serial arm of revolute joints */

/* Link frame i moves with joint i; R[i], p[i] place it in link i-1 at q_i = 0; axis[i] is the joint's axis in link frame i.
 * pi[i]: standard parameters [m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about the link frame's origin. */
typedef struct {
    int32_t n;
    const double *R;       /* (n, 3, 3) */
    const double *p;       /* (n, 3) [m] */
    const double *axis;    /* (n, 3) unit vectors */
    const double *gravity; /* (3,) [m/s^2] in the base frame, e.g. (0, 0, -9.81) */
    const double *pi;      /* (n, 10) [kg, kg m, kg m^2]; may be 0 where only geometry is asked for */
} StopsetArm;

/* tau (N, n) [N m] = M ddq + c + g for rows of q, dq, ddq (N, n): links only. */
STOPSET_API int stopset_torques(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq, double *tau);
/* g(q), (N, n) [N m]. */
STOPSET_API int stopset_gravity_torques(const StopsetArm *arm, int64_t N, const double *q, double *tau);
/* Torques of the joints from `lowest` on with `joint` bent by x, dx, ddx (N,) [rad, ..]; the other columns stay as they are. */
STOPSET_API int stopset_bent_torques(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq, int joint,
                                     const double *x, const double *dx, const double *ddx, int lowest, double *tau);
/* M(q), (N, n, n) [kg m^2]: links only, no rotors. */
STOPSET_API int stopset_mass_matrices(const StopsetArm *arm, int64_t N, const double *q, double *M);
/* Y (N, n, 10 n): torque = Y pi. */
STOPSET_API int stopset_regressors(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq, double *Y);
/* Rotation (N, n, 3, 3) and origin (N, n, 3) [m] of every link frame in the base frame. */
STOPSET_API int stopset_link_frames(const StopsetArm *arm, int64_t N, const double *q, double *R, double *o);
/* Position (3,) [m], Jacobian (3, n) [m/rad] of a point (3,) [m] of `link`, in the base frame; zero for joints beyond it. */
STOPSET_API int stopset_point(const StopsetArm *arm, const double *q, int link, const double *point, double *position, double *J);
/* Joint axes and axis x first moment of all beyond [kg m], (N, n, 3) each, in the base frame: g = -lever . gravity. */
STOPSET_API int stopset_levers(const StopsetArm *arm, int64_t N, const double *q, double *axis, double *lever);

/* ---- law.c: effects' laws, as the steps of stopset.ring.tape */

#define STOPSET_LAW_STEPS 256
#define STOPSET_MEMORIES 4
#define STOPSET_SIGNALS 31

typedef struct {
    int32_t length;        /* steps, at most STOPSET_LAW_STEPS; the last one's result is the law's */
    const int32_t *steps;  /* (length, 3) what, first and second argument: earlier steps, or a constant's or signal's number */
    const double *numbers; /* constants */
} StopsetProgram;

/* The law's value for N samples of its signals, (STOPSET_SIGNALS, N). */
STOPSET_API int stopset_law(const StopsetProgram *law, int64_t N, const double *signals, double *out);

/* ---- inputs.c: from measured torque to the input u of the abstraction */

typedef struct {
    int32_t joint, other;     /* whose torque; the other one of a pair, -1: none */
    int32_t memory, memories; /* place and number of its states among all */
    StopsetProgram torque;    /* [N m] */
} StopsetLaw;

enum {
    STOPSET_NEEDS_LOAD = 1,
    STOPSET_NEEDS_LINK = 2,
    STOPSET_NEEDS_STIFF = 4,
    STOPSET_NEEDS_INERTIA = 8,
    STOPSET_NEEDS_TILT = 16,
    STOPSET_NEEDS_TIP = 32
};

typedef struct {
    StopsetArm arm;
    int32_t motor_torque;         /* the torque holds gravity, which is taken off, and friction at rest */
    int32_t needs;                /* what laws look at of the rigid body */
    int32_t memories;             /* states of all laws */
    int32_t laws;
    const StopsetLaw *law;
    const double *gain;           /* (n,) recorded torque per true torque */
    const double *offset;         /* (n,) [N m] */
    const double *standstill;     /* (n,) [rad/s] at or below it friction balances what it can */
    double reference_temperature; /* [degC] laws count from here */
} StopsetInputs;

/* N samples in rows; what is 0 is not there. */
typedef struct {
    const double *q, *dq, *tau; /* (N, n) [rad, rad/s, N m] */
    const double *temp;         /* (N, n) [degC] */
    const double *dtau;         /* (N, n) [N m/s] */
    const double *t;            /* (N,) [s] */
    const double *memory;       /* (N, memories) */
    double warm;                /* place in the session, 0 to 1 */
} StopsetSamples;

/* u (N, n) [N m]. */
STOPSET_API int stopset_inputs(const StopsetInputs *map, int64_t N, const StopsetSamples *samples, double *u);

/* ---- watch.c: the monitor's cycle */

#define STOPSET_CARRIED 64

typedef struct {
    int32_t law;         /* place of the law that remembers, with one state, in which law and flow are affine */
    StopsetProgram rate; /* [1/s times the state's unit] */
} StopsetCarried;

typedef struct {
    const StopsetInputs *map;
    const double *quantum_q, *quantum_dq, *quantum_tau; /* (n,) greatest error of the bus [rad, rad/s, N m] */
    double warm[2];                                     /* places of the session: the arm is between them */
    int32_t places;                                     /* 1: the place is known or of no matter */
    int32_t plain;                                      /* u = tau - offset alone */
    double dt;                                          /* [s] from a sample to the next */
    int32_t states;
    const StopsetCarried *carried;                      /* (states,) */
} StopsetMonitor;

/* u, du (n,) [N m] of a sample: the input, and how much rounding, an unknown place and unknown states can have changed it.
 * `ends` (states, 2): intervals of the states at this sample, then at the next. `temp` may be 0. */
STOPSET_API int stopset_sample_input(const StopsetMonitor *monitor, const double *q, const double *dq, const double *tau,
                                     const double *temp, double *ends, double *u, double *du);

/* Predictions from past samples, one a row; joints' positions, then speeds. */
typedef struct {
    int32_t states;        /* 2n */
    int64_t rows, ages;
    double *e, *w;         /* (rows, 2n) measured minus predicted; what rounding can have added to that */
    int64_t *age;          /* (rows,) steps since its sample, -1: no prediction */
    uint8_t *foreign;      /* (rows,) passed samples outside the domain */
    const double *Ad, *Bd; /* (2n, 2n), (2n, n): one step, input held */
    const double *lo, *hi; /* (ages, 2n) tube of deviations */
    double *room;          /* (2n,) out: least distance to a bound over the half width */
    int64_t *row;          /* (2, 2n) out: the prediction contradicted worst, above and below, -1: none */
} StopsetPredictions;

/* Every prediction one step on under u from the state `before`, and the measured state x (2n,) against each at its age.
 * Returns the predictions alive; `oldest`: the greatest age. Not a number counts as outside. */
STOPSET_API int64_t stopset_advance(const StopsetPredictions *predictions, const double *x, const double *before, const double *u,
                                    const double *du, int outside, int widen, int64_t *oldest);

/* ---- message.c: what a message needs */

STOPSET_API uint32_t stopset_crc32(int64_t length, const uint8_t *data);
STOPSET_API uint32_t stopset_crc32c(int64_t length, const uint8_t *data);
/* Bits of the float32 that is not below x (side 1), not above it (-1) or nearest (0); not a number: +Inf, -Inf, not a number. */
STOPSET_API void stopset_outward(int64_t N, const double *x, const int8_t *side, uint32_t *bits);
/* cffi end */

#endif
