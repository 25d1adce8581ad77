/* The compiled core: what Python, the monitor and the FMU call. One header, plain C11, no Python in it.
 *
 * SI units throughout; [1]: without unit, [any]: of whatever unit the caller's numbers are. Matrices lie row by row. n: joints, at
 * most STOPSET_JOINTS. Nothing here allocates, keeps anything between two calls or touches a file; a function that can refuse returns
 * one of the codes below.
 * Lines between the marks `cffi` are read by build.py for the Python binding: declarations only.
 */
#ifndef STOPSET_H
#define STOPSET_H

#include <stdint.h>

#if defined(STOPSET_API)
/* said by whoever compiles it */
#elif defined(_WIN32)
#define STOPSET_API __declspec(dllexport)
#elif defined(__GNUC__)
#define STOPSET_API __attribute__((visibility("default")))
#else
#define STOPSET_API
#endif

/* cffi begin */
enum {
    STOPSET_OK = 0,
    STOPSET_TOO_MANY_JOINTS = 1, /* n is not within 1..STOPSET_JOINTS */
    STOPSET_OUT_OF_RANGE = 2     /* a place outside the array it counts in */
};
#define STOPSET_JOINTS 32

/* Hash of the sources and flags that the library was made from. */
STOPSET_API const char *stopset_sources(void);

/* ---- maths.c: elementary functions with the same bits everywhere; largest errors in units in the last place (ulp) */

/* Of x [rad], |x| <= 1e6: 0.75 ulp; beyond: not a number. */
STOPSET_API double stopset_sin(double x);
STOPSET_API double stopset_cos(double x);
/* Of x [1]: 0.8 ulp; below the normal numbers 1 ulp. */
STOPSET_API double stopset_exp(double x);
/* Of x [1]: 1.5 ulp. */
STOPSET_API double stopset_expm1(double x);
/* Of x [1]: 2 ulp. */
STOPSET_API double stopset_tanh(double x);
/* Of x [1]: 1 ulp; of zero -Inf, of less not a number. */
STOPSET_API double stopset_log(double x);
/* The same of many numbers x (N,) [1], of angles [rad], `which`: 0 sin, 1 cos, 2 exp, 3 expm1, 4 tanh, 5 log. */
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

/* A joint whose link is off its encoder by x, dx, ddx (N,) [rad, ..]; looked at from the joint `lowest` on. */
typedef struct {
    int32_t joint, lowest;
    const double *x, *dx, *ddx;
} StopsetBend;

/* Torques tau (N, n) [N m] with a joint bent; the columns of the joints before `lowest` stay as they are. */
STOPSET_API int stopset_bent_torques(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq,
                                     const StopsetBend *bend, double *tau);
/* M(q), (N, n, n) [kg m^2]: links only, no rotors. */
STOPSET_API int stopset_mass_matrices(const StopsetArm *arm, int64_t N, const double *q, double *M);
/* Y (N, n, 10 n) [N m per unit of pi]: torque = Y pi. */
STOPSET_API int stopset_regressors(const StopsetArm *arm, int64_t N, const double *q, const double *dq, const double *ddq, double *Y);
/* Rotation (N, n, 3, 3) and origin (N, n, 3) [m] of every link frame in the base frame. */
STOPSET_API int stopset_link_frames(const StopsetArm *arm, int64_t N, const double *q, double *R, double *o);
/* Position (3,) [m], Jacobian (3, n) [m/rad] of a point (3,) [m] of `link`, in the base frame; zero for joints beyond it. */
STOPSET_API int stopset_point(const StopsetArm *arm, const double *q, int link, const double *point, double *position, double *J);
/* Joint axes and axis x first moment of all beyond [kg m], (N, n, 3) each, in the base frame: g = -moment_arm . gravity. */
STOPSET_API int stopset_moment_arms(const StopsetArm *arm, int64_t N, const double *q, double *axis, double *moment_arm);

/* ---- law.c: effects' laws, as the steps of stopset.ring.tape */

#define STOPSET_LAW_STEPS 256
#define STOPSET_MEMORIES 4
#define STOPSET_SIGNALS 31

typedef struct {
    int32_t length;        /* steps, at most STOPSET_LAW_STEPS; the last one's result is the law's */
    const int32_t *steps;  /* (length, 3) what, first and second argument: earlier steps, or a constant's or signal's number */
    const double *numbers; /* constants */
} StopsetProgram;

/* The law's value (N,) [N m, or the rate of a state in its unit per s] for N samples of its signals, (STOPSET_SIGNALS, N). */
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
    int32_t swift;                /* and Coriolis and centrifugal torque, which is taken off too */
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

/* u, du (n,) [N m] of one sample, its q, dq, tau and temp: the input, and how much rounding, an unknown place and unknown states can have
 * changed it. `ends` (states, 2): intervals of the states at this sample, then at the next. */
STOPSET_API int stopset_sample_input(const StopsetMonitor *monitor, const StopsetSamples *sample, double *ends, double *u, double *du);

/* How many of x (N,) lie outside [lo - slack, hi + slack]. */
STOPSET_API int64_t stopset_beyond(int64_t N, const double *x, const double *lo, const double *hi, const double *slack);

/* Whether every one of x (N,) [any] is a number of at most this size. */
STOPSET_API int stopset_sound(int64_t N, const double *x, double most);

/* The row of least cost (count,) [any] among the boxes lo, hi (count, n) that hold x (n,) with `slack` (n,) either way, or -1. */
STOPSET_API int64_t stopset_tightest(int64_t count, int64_t n, const double *lo, const double *hi, const double *cost,
                                     const double *x, const double *slack);

/* ---- predictions.c: the tube around every prediction, and the measurement in it */

/* Predictions from past samples, one a row; joints' positions, then speeds. */
typedef struct {
    int32_t states;        /* 2n */
    int64_t rows, ages;
    double *e, *w;         /* (rows, 2n) measured minus predicted; what rounding can have added to that */
    int64_t *age;          /* (rows,) steps since its sample, -1: no prediction */
    uint8_t *foreign;      /* (rows,) passed samples outside the domain */
    const double *Ad, *Bd; /* (2n, 2n), (2n, n): one step, input held */
    const double *lo, *hi; /* (ages, 2n) tube of deviations */
    double *middle, *reach; /* (ages, 2n) of the tube, as `stopset_centre` leaves them */
    double *room;          /* (2n,) out: least distance to a bound over the half width */
    int64_t *nearest;      /* (2n,) the prediction whose bound that is, any number at the start */
    int64_t *row;          /* (2, 2n) out: the prediction contradicted worst, above and below, -1: none */
} StopsetPredictions;

/* To be called when lo or hi have changed. */
STOPSET_API void stopset_centre(const StopsetPredictions *predictions);

/* A step from the state `before` to x (2n,) [rad, rad/s], both measured, under u, +- du (n,) [N m]. */
typedef struct {
    const double *x, *before, *u, *du;
} StopsetReading;

/* Every prediction one step on, (rows,) of them, and x [rad, rad/s] against each at its age.
 * Returns the predictions alive; `seen`: the greatest age, and how many of x's bounds are passed. Not a number counts as outside. */
STOPSET_API int64_t stopset_advance(const StopsetPredictions *predictions, const StopsetReading *reading, int outside, int widen,
                                    int64_t seen[2]);

/* The whole check of one arm, a sample after the other. */
typedef struct {
    const StopsetMonitor *monitor;
    const StopsetPredictions *predictions;
    const double *domain_lo, *domain_hi; /* (4, n) of q, dq, u, temperature */
    int32_t temperatures;                /* the domain has bounds on them */
    int32_t every, sliding;              /* a prediction starts every so many samples, or (0) at the first one only */
    double most;                         /* largest reading that can be one [SI] */
    double *here;                        /* (4, n) the sample: q, dq, torque, temperature */
    double *ends;                        /* (states, 2) of the effects' memories */
    double *u, *du;                      /* (2, n) of this sample, then of the one before */
    double *x;                           /* (2n,) the state of the sample before */
    const double *start;                 /* (2n,) what rounding adds to a prediction at its start */
    int64_t place, since;                /* row of the next prediction; samples since the last one */
    int32_t known, widen;                /* there was a sample before; `w` changes from step to step */
    int64_t outside, live, seen[2];      /* out: signals beyond the domain, and as of `stopset_advance` */
} StopsetCheck;

enum { STOPSET_NOT_A_NUMBER = 3, STOPSET_ALL_ZERO = 4 };

/* Whether `here` can be a reading; `temp`: with temperatures. */
STOPSET_API int stopset_readable(const StopsetCheck *watch, int temp);
/* u, du and what is beyond the domain. */
STOPSET_API int stopset_look(StopsetCheck *watch, int temp);
/* The state x (2n,) [rad, rad/s] of this sample against all predictions. */
STOPSET_API int stopset_compare(StopsetCheck *watch, const double *x);
/* A prediction from this sample, if one is due. */
STOPSET_API void stopset_launch(StopsetCheck *watch);
/* The next sample is the one after this, whose state is x (2n,) [rad, rad/s]. */
STOPSET_API void stopset_keep(StopsetCheck *watch, const double *x);
/* All of these, for a sample that follows the one before. */
STOPSET_API int stopset_next(StopsetCheck *watch, int temp);

/* ---- decode.c: CAN frames to readings */

#define STOPSET_IDS 2048
#define STOPSET_NODES 128

typedef struct {
    uint32_t id;
    int32_t length;  /* bytes as sent; at most 8 of them are here */
    uint8_t data[8];
    double t;        /* [s] as stamped */
} StopsetFrame;

enum {
    STOPSET_I8, STOPSET_I16, STOPSET_I32, STOPSET_I64, STOPSET_U8, STOPSET_U16, STOPSET_U32, STOPSET_U64, STOPSET_F32, STOPSET_F64,
    STOPSET_BOOL
};

typedef struct {
    int32_t offset, kind, target; /* byte, kind of number, place in (signals, n) */
} StopsetField;

typedef struct {
    int32_t length, synchronous, first, count; /* bytes; once after every SYNC; which fields */
} StopsetPdo;

enum { STOPSET_SYNC = -2 };                            /* place of SYNC; -1: of no PDO */
enum { STOPSET_CYCLE = 1, STOPSET_SERVICE = 2 };       /* what `stopset_decode` has stopped at */
enum { STOPSET_STRANGER, STOPSET_GOOD, STOPSET_BAD };  /* a node: not one of ours; operational without an emergency; else */

typedef struct {
    int32_t n, signals, pdos, synchronous, overflow; /* joints, signals; PDOs, of these after SYNC; SYNC's counter, 0: none */
    double cycle_s;
    const int32_t *place;                            /* (STOPSET_IDS,) */
    const StopsetPdo *pdo;
    const StopsetField *field;
    const double *scale;                             /* (signals, n) SI value of a count */
    double *raw, *held, *values;                     /* (signals, n): counts, a cycle held back, the cycle given out */
    uint8_t *came;                                   /* (pdos,) since SYNC */
    int32_t synced, seen, doubtful, holds, hold;
    int32_t counter, held_counter, out_counter;      /* of SYNC, -1: none */
    double t, held_t, held_at, out_t;                /* [s] of SYNC; when the held cycle was whole */
    int64_t syncs, incomplete, doubted;              /* cycles begun; that lacked a frame or had one twice; whole, and in doubt */
    int64_t unknown, frames;
    const uint8_t *node;                             /* (STOPSET_NODES,) STOPSET_STRANGER, .. */
    double *heard, patience;                         /* (STOPSET_NODES,) [s] last heartbeat; longest silence, 0: they send none */
    int32_t nodes_good;                              /* out: so are all, as of the cycle given out */
    int32_t foreign;                                 /* another clock stamps the frames; -1: not known yet */
    double shift, shifted;                           /* [s] least delay seen, and when */
    StopsetFrame *log;                               /* (room,) the last frames, number `frames` - 1 the newest */
    int64_t room;
    int32_t status;                                  /* the signal that holds the drives' statuswords (CiA 402), -1: none */
    int32_t out_powered;                             /* as of the cycle given out: no drive says that it is not in operation */
    uint32_t out_lacks;                              /* bit s set: signal s of some joint is not a number */
} StopsetDecoder;

/* Frames number `taken` on until one completes a cycle, or is of a service that the caller knows (the last in the log), or none are
 * left (0). `now` [s]: when they were received at the latest. */
STOPSET_API int stopset_decode(StopsetDecoder *decoder, const StopsetFrame *frames, int64_t count, double now, int64_t *taken);
/* Whether no node is in a bad state or silent at `now` [s]. */
STOPSET_API int stopset_nodes_good(const StopsetDecoder *decoder, double now);

/* ---- message.c: what a message needs */

/* CRC-32 (ISO-HDLC) and CRC-32C (Castagnoli) of `length` bytes. */
STOPSET_API uint32_t stopset_crc32(int64_t length, const uint8_t *data);
STOPSET_API uint32_t stopset_crc32c(int64_t length, const uint8_t *data);
/* Bits (N,) of the float32 that is not below x (N,) [any] (side 1), not above it (-1) or nearest (0); not a number: +Inf, -Inf, not a
 * number. */
STOPSET_API void stopset_outward(int64_t N, const double *x, const int8_t *side, uint32_t *bits);

/* A message in the place where all are made, one after another: `count` numbers [any] to be rounded to their `side`, from byte `first` on. */
typedef struct {
    uint8_t *bytes;
    const double *numbers;    /* (count,) */
    const int8_t *side;       /* (count,) as in `stopset_outward` */
    int64_t count, first;
    int64_t summed;           /* bytes that the sums below hold, which are not yet inverted */
    uint32_t iso, castagnoli;
} StopsetMessage;

/* The numbers, into a message of which nothing is summed yet; then as `stopset_seal`. */
STOPSET_API void stopset_message(StopsetMessage *message, int64_t end);
/* CRC-32 of all bytes before `end`, a multiple of four, then CRC-32C of these and of that; what was summed before is not summed again. */
STOPSET_API void stopset_seal(StopsetMessage *message, int64_t end);

/* ---- windows.c: envelopes of deviations over all windows of a trial */

typedef struct {
    int64_t ages, columns;   /* ages 0 .. ages - 1; positions, then speeds, of what is looked at */
    int64_t trial;           /* number of the trial that widens it */
    double *hi, *lo;         /* (ages, columns) */
    int64_t *hi_at, *lo_at;  /* (ages, columns, 2) trial and start sample that put it there */
} StopsetEnvelope;

/* Largest and least of x (N,) [any]. */
STOPSET_API void stopset_extremes(int64_t N, const double *x, double *top, double *bottom);
/* Joints on their own: a (n, 2, 2) one step of position and speed, residual (2n, N) [rad, rad/s] of every step, `starts` windows, work
 * (2, starts). */
STOPSET_API int stopset_widen_decoupled(const StopsetEnvelope *envelope, int n, const double *a, int64_t N, const double *residual,
                                        int64_t starts, double *work);

/* A step Ad (2n, 2n) [1, s, 1/s] of n joints, looked at along k directions `across` (k, n). */
typedef struct {
    int32_t n, k;
    const double *Ad, *across;
} StopsetLooked;

/* The same of joints together, residual (2n, N) [rad, rad/s]; work (4n + 1, starts). */
STOPSET_API int stopset_widen_coupled(const StopsetEnvelope *envelope, const StopsetLooked *step, int64_t N, const double *residual,
                                      int64_t starts, double *work);

/* ---- filter.c: what recordings pass before a regression */

/* x (N, columns) [any] in place, columns side by side, through `sections` of second order: sos (sections, 6) [1] numerator and denominator
 * of each, the denominator's first 1; state (sections, 2, columns), with which the filter begins and ends.
 * Source: Oppenheim & Schafer, Discrete-Time Signal Processing (transposed direct form II). */
STOPSET_API void stopset_filter(int64_t N, int64_t columns, int sections, const double *sos, double *state, double *x);

/* ---- linear.c: the linear model's exact step and its reachable set */

/* Ad (2n, 2n), Bd (2n, n): a step of h [s] of q' = v, v' = Av v + Minv u, (n, n) each, the input held. */
STOPSET_API int stopset_discretise(int n, const double *Av, const double *Minv, double h, double *Ad, double *Bd);
/* out (2n,) [rad, rad/s] = Ad x + Bd u; the same for N rows of u (N, n), from the first row of x (N, 2n). */
STOPSET_API void stopset_stride(int n, const double *Ad, const double *Bd, const double *x, const double *u, double *out);
STOPSET_API void stopset_predict(int n, const double *Ad, const double *Bd, int64_t N, const double *u, double *x);

typedef struct {
    int32_t n, rows, inputs;  /* joints; what is looked at; directions of torque */
    const double *Av, *Minv;  /* (n, n) */
    const double *across;     /* (n, inputs) those directions; 0: the joints' own, inputs = n */
    const double *look;       /* (rows, 2n) combinations of states; 0: every state, rows = 2n */
    int32_t keeps_sign;       /* the response to a torque is known to keep its sign */
} StopsetLinear;

/* Numbers that a step and the work below have to hold. */
STOPSET_API int64_t stopset_step_room(const StopsetLinear *linear);
STOPSET_API int64_t stopset_response_room(const StopsetLinear *linear);
/* A step (stopset_step_room,) of h [s]. */
STOPSET_API int stopset_linear_step(const StopsetLinear *linear, double h, double *step);
/* One step of h [s] on: E (2n, 2n) [1, s, 1/s] = e^{At}; plus, minus (rows, inputs): no less than the integral of max(K, 0), no more
 * than that of min(K, 0). */
STOPSET_API void stopset_respond(const StopsetLinear *linear, double h, const double *step, double *E, double *plus, double *minus,
                                 double *work);

/* At every age, of what is looked at: E1 (ages, rows, states) [1, s, 1/s] to the start, plus, minus (ages, rows, inputs) to torques of either sign. */
typedef struct {
    int64_t ages;
    int32_t rows, states, inputs;
    double *E1, *plus, *minus;
} StopsetResponses;

/* The same (ages, rows, ..) for ages 0, dt, .. [s]. */
STOPSET_API int stopset_responses(const StopsetLinear *linear, double dt, double *step, double *work, const StopsetResponses *out);

typedef struct {
    const double *X0_lo, *X0_hi, *U_lo, *U_hi, *V_lo, *V_hi; /* (states,), (inputs,), (states,) */
    int32_t position_only;                                   /* no speed was promised */
} StopsetSets;

/* Bounds (ages, rows) [rad, rad/s] of E1 X0 + the response to U; with a reading's noise V on top, rounded outward, `look` (rows,
 * states) or 0. */
STOPSET_API void stopset_hulls(const StopsetResponses *responses, const StopsetSets *sets, double *lo, double *hi);
STOPSET_API void stopset_tubes(const StopsetResponses *responses, const double *look, const StopsetSets *sets, double *lo, double *hi);

/* ---- predict.c: nominal predictions and their sets */

/* x(k+1) <- Ad x(k) + x(k+1) for rows (N, m) [any] that hold the start, then what drives each step. */
STOPSET_API void stopset_march(int m, const double *Ad, int64_t N, double *x);

/* A decoupled joint, q' = v, v' = w - sum c_k v^(k+1) with w [rad/s^2] held over steps of dt [s], each cut into `parts`. */
typedef struct {
    int32_t orders;
    const double *c; /* (orders,) of the friction curve over inertia */
    double dt;
    int64_t parts;
} StopsetJoint;

/* Its trajectory (N + 1, 2) [rad, rad/s] under w (N,). */
STOPSET_API void stopset_corner(const StopsetJoint *joint, double q, double v, int64_t N, const double *w, double *out);

typedef struct {
    StopsetJoint joint;
    double dq0, dv0, sign, runaway; /* this corner of the start; side; speed [rad/s] that is no solution any more */
    int64_t horizon;
    double limit[2];                /* noise that a reading may be beyond the corner */
} StopsetCorner;

/* A trial: readings x (N, 2) [rad, rad/s] under w (N,) [rad/s^2], looked at from every `start` (starts,). */
typedef struct {
    int64_t trial, N;
    const double *x, *w;
    int64_t starts;
    const int64_t *start;
} StopsetTrial;

/* Per age the largest, best (horizon + 1, 2) [rad, rad/s], and where, at (horizon + 1, 2, 2) trial and start; `outside` (starts,) is set for starts
 * from which a reading is beyond the limit. */
typedef struct {
    double *best;
    int64_t *at;
    uint8_t *outside;
} StopsetExcess;

/* How far the readings of a trial lie beyond a corner's solutions, (horizon + 1, 2) [rad, rad/s], on top of what was found before. */
STOPSET_API void stopset_corner_excess(const StopsetCorner *corner, const StopsetTrial *trial, const StopsetExcess *found);
/* End (q, v) [rad, rad/s] after w (N,) [rad/s^2] and its derivatives S (2, 3) by start angle, start speed and a constant added to w. */
STOPSET_API void stopset_corner_sensitivity(const StopsetJoint *joint, double *q, double *v, int64_t N, const double *w, double *S);
/* Terms of the exponential of one step's matrix, whose norm is below 1. */
#define STOPSET_TERMS 12
/* Responses along a nominal solution in steps of dt [s]: J_x (H + 1, n, 2n), J_u (H + 1, n, n), of every state; work (3, H, 2n, n). */
STOPSET_API int stopset_along(int n, int64_t H, const double *J_x, const double *J_u, double dt, const StopsetResponses *out, double *work);
/* z (N,) of dz/dt = b + a z, both held over dt (N,) [s], from `start` wherever `first` is set: exact. */
STOPSET_API void stopset_remember(int64_t N, const double *b, const double *a, const double *dt, const uint8_t *first, double start,
                                  double *z);

/* ---- polynomials.c */

typedef struct {
    int64_t monomials, count, dimension;
    const int64_t *parent, *variable; /* monomial k = monomial parent[k] times z[variable[k]]; number 0 is 1 */
    const double *coefficient;        /* (monomials, count) */
} StopsetPolynomials;

/* Values (N, count) [any] at the rows of z (N, dimension) [any]; work (monomials,). */
STOPSET_API void stopset_polynomials(const StopsetPolynomials *polynomials, int64_t N, const double *z, double *work, double *out);
/* Derivatives (N, count, dimension) [any] at the rows of z (N, dimension); work (monomials, 1 + count). */
STOPSET_API void stopset_polynomial_slopes(const StopsetPolynomials *polynomials, int64_t N, const double *z, double *work, double *out);
/* ---- along.c: nonlinear abstractions */

#define STOPSET_DAMPING 16 /* orders of a damping polynomial at most */

/* ddq = Minv (u - damping - polynomials(dq, sin q, cos q)) (models 1, 2) or polynomials(dq, sin q, cos q, u) (model 3). */
typedef struct {
    int32_t n, kind, orders;
    const double *Minv;              /* (n, n) [1/(kg m^2)] */
    const double *viscous;           /* (n, orders) [N m (s/rad)^k] */
    StopsetPolynomials polynomials;  /* count 0: none */
} StopsetDynamics;

/* Numbers that `work` of the functions below has to hold. */
STOPSET_API int64_t stopset_dynamics_room(const StopsetDynamics *dynamics);
/* ddq (n,) [rad/s^2]; what models 1 and 2 take off the input, (n,) [N m]. */
STOPSET_API void stopset_acceleration(const StopsetDynamics *dynamics, const double *q, const double *dq, const double *u, double *work, double *ddq);
STOPSET_API void stopset_drag(const StopsetDynamics *dynamics, const double *q, const double *dq, double *work, double *out);

/* W starts x0 (W, 2n) [rad, rad/s], each under inputs u (W, N, n) [N m] held over N steps of dt [s]. */
typedef struct {
    int64_t W, N;
    const double *x0, *u;
    double dt;
} StopsetStarts;

/* Solutions out (W, N + 1, 2n) [rad, rad/s]: classical Runge-Kutta. */
STOPSET_API void stopset_nominal(const StopsetDynamics *dynamics, const StopsetStarts *starts, double *work, double *out);
/* d ddq / d(q, dq) (N, n, 2n) [1/s^2, 1/s] and d ddq / du (N, n, n) [1/(kg m^2)] at rows of x (N, 2n), u (N, n). */
STOPSET_API void stopset_linearised(const StopsetDynamics *dynamics, int64_t N, const double *x, const double *u, double *work, double *J_x,
                                    double *J_u);

/* A nominal path (H + 1, 2n) [rad, rad/s] under u (H, n) [N m] held for dt [s]. */
typedef struct {
    int64_t H;
    const double *path, *u;
    double dt;
} StopsetNominal;

/* Where a reading may lie at the end of a path: lo, hi (2n,) [rad, rad/s]. work: stopset_ahead_room. */
STOPSET_API int64_t stopset_ahead_room(const StopsetDynamics *dynamics, int64_t H);
STOPSET_API int stopset_ahead(const StopsetDynamics *dynamics, const StopsetSets *sets, const StopsetNominal *nominal, double *work,
                              double *lo, double *hi);
/* Bounds of states (m,) [rad, rad/s] become those of readings, rounded outward by `round` of their size. */
STOPSET_API void stopset_read(int m, const StopsetSets *sets, double round, double *lo, double *hi);
/* A step's rate of decay times its length. */
STOPSET_API extern const double stopset_corner_step;
#define STOPSET_MOST_PARTS 1000000
/* Into how many parts a step of dt is cut so that no rate of decay up to `speed` [rad/s] is too fast for it; STOPSET_MOST_PARTS are not enough. */
STOPSET_API int64_t stopset_parts(const StopsetDynamics *dynamics, double dt, double speed);
/* Corners z (N, 2n) of decoupled joints one step of h [s] on under u (n,); none gets faster than `most` [rad/s]. */
STOPSET_API void stopset_corners(const StopsetDynamics *dynamics, int64_t N, const double *u, double h, int64_t parts, double most, double *z);

/* ---- predictions_along.c: predictions of a nonlinear model from past samples */

/* Steps of the oldest prediction along a nominal motion: one that is twice as old costs four times as much; steps up to which all
 * ages that are looked at are, of older ones one per step, in turn. */
enum { STOPSET_FAR = 64, STOPSET_NEAR = 24 };
/* What is counted: steps of the grid, samples since the last one, turns of the old ages, and whether a sample since was outside. */
enum { STOPSET_ALONG_STEPS, STOPSET_ALONG_SAMPLES, STOPSET_ALONG_TURN, STOPSET_ALONG_OUTSIDE, STOPSET_ALONG_COUNTS };

/* What is kept of past samples; a row is a step of the sets' grid. At the start, and to forget, `starts` and `count` are zero. */
typedef struct {
    const StopsetDynamics *dynamics;
    const StopsetSets *sets;     /* as identified, U along the joints */
    const double *rounding;      /* (2n,) greatest error of the bus */
    double dt, fastest;          /* [s] of a step; [rad/s] of any joint's readings */
    int64_t oldest;              /* steps of the oldest prediction */
    int32_t corners, sliding;    /* of decoupled joints, else along paths; one starts at every step, or (0) at the first one only */
    double *x;                   /* corners (2, oldest + 1, 2n): lower, upper; paths (oldest + 1, 2n): where predictions start */
    double *u;                   /* paths (oldest + 1, 2, n): inputs to the next step, and how far these are unknown */
    uint8_t *starts, *outside;   /* (oldest + 1,) a prediction starts there; a sample until the next step is outside the domain */
    double *sum;                 /* (2, n) inputs since the last step: their sum, and how far they are unknown at most */
    int64_t *count;              /* (STOPSET_ALONG_COUNTS,) */
    double *work;                /* paths: stopset_along_room */
} StopsetAlong;

/* A sample against predictions. */
typedef struct {
    double *room, *lo, *hi; /* (2n,) least distance to a bound over half the width, 1: there is none; what all predictions leave */
    double *worst, *ends;   /* (2, 2n), above and below: how far beyond the bound over its width; (2, 2n, 2) that prediction's bounds */
    int64_t *age;           /* (2, 2n) of it in steps, 0: none is passed */
    uint8_t *foreign;       /* (2, 2n) it passed samples outside the domain */
    int64_t *oldest;        /* (1,) the greatest age looked at */
} StopsetHeld;

/* How many doubles [1] `work` of StopsetAlong holds, for predictions of up to `oldest` steps; (n,) joints as in `dynamics`. */
STOPSET_API int64_t stopset_along_room(const StopsetDynamics *dynamics, int64_t oldest);
/* Whether predictions along paths are looked at at an age [steps]. */
STOPSET_API int stopset_looked_at(int64_t age, int64_t oldest);
/* The next sample belongs to no earlier one. */
STOPSET_API void stopset_along_forget(const StopsetAlong *along);
/* Between which bounds (2n,) [rad, rad/s] a reading may be now, by the prediction that began `age` steps ago. */
STOPSET_API void stopset_along_bounds(const StopsetAlong *along, int64_t age, double *lo, double *hi);
/* A sample x (2n,) [rad, rad/s] with its input u, known to within du (n,) [N m]; `every`: samples per step. At a step it is held against all predictions
 * that are due, and kept for later ones: returns how many these were; between two steps -1, and `held` is not touched. */
STOPSET_API int64_t stopset_along_sample(const StopsetAlong *along, int64_t every, const double *x, const double *u, const double *du,
                                         int outside, const StopsetHeld *held);

/* Terms of a Taylor form, sorted: keys (count,), coefficients [any]. */
typedef struct {
    int64_t count;
    const int64_t *key;
    const double *value;
} StopsetTaylor;

/* Where a product goes: key and value (room,) [any]; slot: work of `size`, a power of two of at least twice room. */
typedef struct {
    int64_t room, size;
    int64_t *slot, *key;
    double *value;
} StopsetProduct;

/* Terms (room,) [any] of a product up to `order`, unsorted. Returns how many, -1: room is too small. */
STOPSET_API int64_t stopset_taylor_multiply(const StopsetTaylor *a, const StopsetTaylor *b, int order, int shift, const StopsetProduct *out);
/* Sorted terms [any] of a + factor b, into key and value (of both counts,); returns how many. */
STOPSET_API int64_t stopset_taylor_add(const StopsetTaylor *a, const StopsetTaylor *b, double factor, int64_t *key, double *value);

/* ---- rows.c: the diagnosis' rows; `first`, `start` (N,): a new trial, a new run of rows begins */

/* x (N,) [any] smoothed over about +-3 rows within each trial, whose rows begin at `first` (N,). */
STOPSET_API void stopset_calm(int64_t N, const double *x, const uint8_t *first, double *out);

/* Weights h (width,) [1]; the width is odd. */
typedef struct {
    int64_t width;
    const double *h;
} StopsetKernel;

/* out (rows, columns) [any]: rows of x (N, columns) about each `centre`, weighted. */
STOPSET_API int stopset_weighted(int64_t N, int64_t columns, const double *x, int64_t rows, const int64_t *centre,
                                 const StopsetKernel *kernel, double *out);

typedef struct {
    int64_t order;
    const double *a, *sd; /* of each kind of row (order + 1, order), (order + 1,): prediction from 0, 1, .. rows before, its deviation */
    const int64_t *kind;  /* (N,) of each row; the rows of one run are of one kind */
} StopsetPredictor;

/* Rows (N, columns) [any] less their prediction, over its deviation [1]; back again; and the adjoint. */
STOPSET_API void stopset_whiten(const StopsetPredictor *predictor, int64_t N, int64_t columns, const double *X, const uint8_t *start,
                                double *out);
STOPSET_API void stopset_coloured(const StopsetPredictor *predictor, int64_t N, const double *e, const uint8_t *start, double *out);
STOPSET_API void stopset_whiten_adjoint(const StopsetPredictor *predictor, int64_t N, const double *r, const uint8_t *start, double *out);

/* R ripples of n, n + step, .. cycles per turn, faded by exp(-fade n^2), at q, fade (N,) [rad, 1]. */
typedef struct {
    int64_t N, R;
    const double *q, *fade;
    double n, step;
} StopsetRipples;

/* Sums (R,) of r (N,) [1] times sine and cosine; work (2, R). */
STOPSET_API void stopset_ripple_products(const StopsetRipples *ripples, const double *r, double *work, double *a, double *b);
/* Sums (R,) [1] of squares and products of the whitened sines and cosines; work (2 order + 4, R). */
STOPSET_API void stopset_ripple_power(const StopsetPredictor *predictor, const StopsetRipples *ripples, const uint8_t *start, double *work,
                                      double *ss, double *cc, double *sc);

typedef struct {
    const double *M, *g;  /* (N,) inertia [kg m^2], gravity's stiffness [N m/rad] */
    const uint8_t *first;
    double K, D;          /* [N m/rad], [N m s/rad] */
    double dt;            /* [s] between rows, in so many parts */
    int32_t parts;
} StopsetSwing;

/* Position, speed, acceleration, out (3, N), of a link against its motor under `link` (N,) [N m], from x0, dx0 at each first row. */
STOPSET_API void stopset_swung(const StopsetSwing *swing, int64_t N, const double *link, const double *x0, const double *dx0, double *out);
/* State at the first rows: from rest under `rest` (N,) [N m], `steps` parts under the row's torque; not a number: bent. */
STOPSET_API void stopset_led(const StopsetSwing *swing, int64_t N, const double *link, const double *rest, int64_t steps, double *x0,
                             double *dx0);

/* ---- simulation/: the arm that models are tested on; it shares no code with what bounds stops. At most 16 joints. */

/* M (n, n) [kg m^2] and bias (n,) [N m], the torque at no acceleration, at q [rad], dq [rad/s]. */
STOPSET_API int stopset_sim_mass_and_bias(const StopsetArm *arm, const double *q, const double *dq, double *M, double *bias);
/* Torque (N, n) [N m] of rigid body and rotors for rows of q, dq, ddq. */
STOPSET_API int stopset_sim_torques(const StopsetArm *arm, const double *rotor, int64_t N, const double *q, const double *dq,
                                    const double *ddq, double *out);
/* A w + p = b with friction p (n,) [N m s], A (n, n) [kg m^2], w [rad/s], see inclusion.c; mode (n,) is the guess who moves which way,
 * then the answer. 1: solved to rounding, 0: not; negative: a code. */
STOPSET_API int stopset_sim_inclusion(int n, const double *A, const double *b, const double *plus, const double *minus, int64_t *mode,
                                      double *w);

/* Stops of one arm; what they differ in stands row by row. */
typedef struct {
    int64_t count;
    StopsetArm arm;                       /* pi (count, n, 10) */
    const double *rotor;                  /* (count, n) [kg m^2] */
    const double *dry, *viscous;          /* (count, n) [N m], [N m s/rad] */
    const double *brake, *delay, *rise;   /* (count, n) [N m], [s], [s] after the cut at t = 0 */
} StopsetSimStops;

/* So many steps of dt [s]; disturbance (count, pieces, n) [N m], constant over equal pieces of them. */
typedef struct {
    double dt;
    int64_t steps, pieces;
    const double *disturbance;
} StopsetSimTime;

/* Positions and velocities (count, steps + 1, n) [rad, rad/s] of power-off stops from q0, v0 (count, n). */
STOPSET_API int stopset_sim_stops(const StopsetSimStops *stops, const double *q0, const double *v0, const StopsetSimTime *time, double *q,
                                  double *v);

typedef struct {
    StopsetArm arm;
    int32_t states;        /* n + number of elastic joints */
    double *table;         /* (n, columns) of stopset.simulation.plant; its friction warms */
    const int64_t *motor;  /* (n,) the state that each joint's motor, friction and encoder belong to */
    double *x, *v, *rate;  /* (states,) [rad, rad/s, rad/s^2] */
    double *slip;          /* (n, 4) [N m] forces of the Maxwell elements */
    double *load;          /* (n,) [N m] that the gears transmit */
    double *temp, *film;   /* (n,) [degC]; how much the drives' own losses have warmed their oil */
} StopsetSimArm;

typedef struct {
    int64_t ticks, steps_per_tick;
    double period;                              /* [s] of control and recording */
    const double *feedforward, *q, *dq;         /* (ticks, n) [N m, rad, rad/s] */
    const double *kp, *kd;                      /* (n,) [N m/rad, N m s/rad] */
    int64_t brake_at, cut_at;                   /* ticks at which the brakes are told to close, the motors lose power */
    const double *q_noise, *dq_noise, *walk;    /* (ticks, n) of the readings [rad, rad/s]; wander of dry friction [N m] */
    double resolution;                          /* [rad] of the encoder */
} StopsetSimScript;

/* The joints' thermal balance. */
typedef struct {
    const double *heating;   /* (n,) [K/J] */
    double ambient, cooling; /* [degC], [1/s] */
} StopsetSimHeat;

/* Logs (6, ticks, n): readings [rad], their speed [rad/s], reported torque [N m], temperature [degC], link angle and speed. */
STOPSET_API int stopset_sim_run(const StopsetSimArm *arm, const StopsetSimScript *script, const StopsetSimHeat *heat, double *logs);

/* ---- stops/: proofs of power-off stops; at most STOPSET_STOP_JOINTS joints; passes of claims per step */

#define STOPSET_STOP_JOINTS 12
#define STOPSET_TUBE_PASSES 40
#define STOPSET_ENERGY_CLAIMS 12
#define STOPSET_PULL_CLAIMS 6

/* Bounds over all poses: |d2 M_ij/dq_k dq_l| (n, n, n, n), |d2 g_i/dq_k dq_l| (n, n, n); of M_ii without rotor, |g_i| (n,). */
typedef struct {
    const double *M, *g, *size, *load;
} StopsetCurvature;

/* Numbers (n,) from lo to hi. */
typedef struct {
    const double *lo, *hi;
} StopsetRange;

/* A box of states (n,): angles [rad] in q + [x_lo, x_hi], q 0: the angles themselves; speeds [rad/s], 0: at rest. */
typedef struct {
    const double *q, *x_lo, *x_hi, *v_lo, *v_hi;
} StopsetBox;

/* How much of each part of the bound is taken: all of it (1), but for mutants. */
typedef struct {
    double coupling, christoffel, gravity_slope, whole_step, bend, pull, shared, held, still;
} StopsetParts;

/* What bounds a power-off stop: (n,) arrays unless said. */
typedef struct {
    StopsetArm arm;                                         /* pi at the middle of the payload's range */
    const double *pi_half;                                  /* (n, 10) half the payload's range */
    const double *rotor, *rotor_half;                       /* [kg m^2] */
    const double *coulomb_lo, *coulomb_hi;                  /* [N m] */
    const double *viscous_lo, *viscous_hi;                  /* [N m s/rad] */
    const double *u_lo, *u_hi, *brake_lo, *brake_hi;        /* [N m] */
    const double *delay_lo, *delay_hi, *rise_lo, *rise_hi;  /* [s] */
    StopsetCurvature curvature;
} StopsetPlant;

/* Filled by the proof: bounds at the knots (steps + 1, n), lines' ends and accelerations of each step. */
typedef struct {
    double *t;                          /* (steps + 1,) [s] */
    double *d_lo, *d_hi, *v_lo, *v_hi;  /* (steps + 1, n) [rad], [rad/s] */
    double *e_lo, *e_hi;                /* (steps, n) */
    double *rates[4];                   /* (steps, n) each: forward lo, hi, backward lo, hi [rad/s^2] */
    double *margin;                     /* (n,) [N m] */
    double *travel_left;                /* (steps + 1, n) [rad]: from this knot on sum_i of joint i's travel / travel_left_i <= 1; or inf */
    double *energy;                     /* (steps,) [(kg m^2)^1/2 rad/s] sqrt(v' M v) is no more on each step; or inf */
} StopsetTube;

/* Sum of angles [rad] from the pose of expansion after which a new one is worth its cost; outward factor of energies and widening
 * of accelerations, where the arithmetic itself errs by some 1e-13. */
STOPSET_API extern const double stopset_tube_recentre, stopset_energy_rounding, stopset_rate_rounding;

/* How a tube is marched: in steps of h [s], of at most `brief` [s] from when the first brake may close until all have, at most `count` of them;
 * `energetic`: with the kinetic energy's caps. */
typedef struct {
    double h, brief;
    int64_t count;
    int32_t energetic;
} StopsetStride;

/* The tube from a box of states (n,) [rad, rad/s] at the cut. Returns how it ends: 0 at rest, 1 still moving at the last step, 2 not provable;
 * negative: a code. `made`: steps that count. */
STOPSET_API int stopset_stop_tube(const StopsetPlant *plant, const StopsetBox *box, const StopsetStride *stride, const StopsetParts *parts,
                                  const StopsetTube *tube, int64_t *made);

/* Inertia M (n, n) [kg m^2], gravity g (n,) [N m], their slopes by q, and Christoffel symbols Gamma (n, n, n) [kg m^2]. */
typedef struct {
    double *M, *dM, *g, *dg, *Gamma;
} StopsetExpansion;

/* At q (n,) [rad], of the middle payload, rotors [kg m^2] included, and of half its range. */
STOPSET_API int stopset_expand(const StopsetArm *arm, const double *pi_half, const double *rotor, const double *q,
                               const StopsetExpansion *middle, const StopsetExpansion *half);
/* For angles in a box (n,) the inertia lies in M +- dM (n, n) [kg m^2], rotors included, and its slopes in those at its pose, of the same
 * payload, +- turn (n, n, n). */
STOPSET_API int stopset_inertia_box(const StopsetPlant *plant, const StopsetBox *box, const StopsetParts *parts, double *M, double *dM,
                                    double *turn);
/* Accelerations [rad/s^2] of each joint while it moves forward, lo and hi, and while it moves backward, out (4, n), in a box of states, `dry` friction (n,)
 * [N m], if none is larger than its claim: each row for itself, or `related`. Infinite: no such motion. */
STOPSET_API int stopset_acceleration_bounds(const StopsetPlant *plant, const StopsetBox *box, const StopsetRange *dry, const double *claim,
                                            int related, const StopsetParts *parts, double *out);
/* What momenta p (n,) [kg m^2/s] leave of the speeds of a box [rad/s], out (4, n): lo, hi; least momentum of a joint that does not move
 * backward, largest of one that does not move forward. Infinite: nothing known, or no such motion. */
STOPSET_API int stopset_speed_bounds(const StopsetPlant *plant, const StopsetBox *box, const StopsetRange *p, const StopsetParts *parts,
                                     double *out);
/* Largest sqrt(v' M v) [(kg m^2)^1/2 rad/s] in a box of states (n,), rotors included; negative: a code. */
STOPSET_API double stopset_largest_energy(const StopsetPlant *plant, const StopsetBox *box);
/* Largest power per speed w (n,) [N m] that gravity g and u have beyond the brakes B_lo, backward (w_lo) and forward (w_hi). */
STOPSET_API int stopset_power_excess(int n, const StopsetRange *g, const StopsetRange *u, const double *B_lo, double *w_lo, double *w_hi);
/* Bound of sqrt(v' M v) after h [s] from y on which no joint has more power per speed than w.lo backward and w.hi forward [N m], these lines from
 * w[0] to w[1], with speeds v [rad/s] and momenta p [kg m^2/s], (n,) each. */
STOPSET_API int stopset_energy_after(int n, double y, const StopsetRange *w, const StopsetRange *v, const StopsetRange *p, double h, double *out);
/* A tube cut into stretches of about equal travel: what holds on each, (count, n) [rad, rad/s]; from [near_lo, near_hi] on no more than the
 * travel `left` [rad], as in a tube: these may be 0, not known. [begin_lo, begin_hi] at its beginning; sqrt(v' M v) is no more than `energy`
 * on it, and no more than `path` over the time since the cut until its end: inf where that is not known. */
typedef struct {
    int64_t count;
    double *border;                    /* (count + 1,) [s] */
    double *d_lo, *d_hi, *v_lo, *v_hi;
    double *near_lo, *near_hi, *left;
    double *begin_lo, *begin_hi;
    double *energy, *path;             /* (count,) [(kg m^2)^1/2 rad/s], [(kg m^2)^1/2 rad] */
} StopsetSlices;

/* A point of a link, (3,) [m] in its frame; no faster in any pose than `swiftness` [kg^-1/2] times sqrt(v' M v); 0: not known. */
typedef struct {
    int32_t link;
    const double *at;
    double swiftness;
} StopsetPoint;

/* On every slice, displacements and velocities (count, 3, n + 1) [m, m/s], centre first, with balls (count,). */
typedef struct {
    double *travel, *travel_ball, *pace, *pace_ball;
} StopsetPointSets;

/* A tube of K steps, n joints, cut into at most `out->count` slices, which is then how many they are; work (K + 1,) [rad]. */
STOPSET_API void stopset_slices(const StopsetTube *tube, int64_t K, int n, double *work, StopsetSlices *out);
/* The swiftness of a point (3,) [m] of a link, see StopsetPoint, whatever the payload of the range; 0 where a body has no mass or no inertia that a
 * body can have. */
STOPSET_API double stopset_swiftness(const StopsetPlant *plant, int link, const double *at);
/* Sets of a point's displacement [m] and of its velocity, angles (n,) [rad] at the cut in q +- q_radius. */
STOPSET_API int stopset_point_sets(const StopsetArm *arm, const double *q, const double *q_radius, const StopsetSlices *slices,
                                   const StopsetPoint *point, const StopsetPointSets *out);
/* The largest length [m], speed [m/s] and box (3, 2) [m] of `count` such sets. */
STOPSET_API void stopset_point_motion(const StopsetArm *arm, const StopsetPoint *point, int64_t count, const StopsetPointSets *sets,
                                      double *far, double *fast, double *box);
/* Capsules (count, n, 7) that contain what the links' own `capsules` (n, 7) [m], in their frames, sweep: both ends [m], radius [m]. */
STOPSET_API int stopset_swept_capsules(const StopsetArm *arm, const double *q, const double *q_radius, const StopsetSlices *slices,
                                       const double *capsules, double *out);
/* ---- stops/bound.c: one stop from a box of states, as a loop asks for it */

/* Rough length of a stop [s] from q [rad] at speeds (n,) [rad/s], to choose the time step: until the brakes hold, and the slowest joint's
 * deceleration by them. */
STOPSET_API double stopset_expected_stop(const StopsetPlant *plant, const double *q, const double *speed);

#define STOPSET_STOP_KNOTS 100       /* time steps over the expected stop, and where the kinetic energy has to help */
#define STOPSET_STOP_ENERGY_KNOTS 16
#define STOPSET_STOP_ALIKE_KNOTS 28  /* and then of one payload, or where payloads are alike: one tube of finer steps in place of three */
#define STOPSET_STOP_CLOSING 35      /* at least so many of them from when the first brake may close until all have, in each case */
#define STOPSET_STOP_ENERGY_CLOSING 20
#define STOPSET_STOP_ALIKE_CLOSING 35
#define STOPSET_STOP_PATIENCE 6      /* times the expected stop before a tube is called endless, in each case */
#define STOPSET_STOP_MORE_PATIENCE 30
#define STOPSET_STOP_WINDOWS 2       /* of the brakes' common delay */
#define STOPSET_STOP_SLICES 10       /* stretches of time that the tool's travel is given for */

/* ---- stops/laws.c, stops/torques.c: a model's effects in a stop, each by its own law over intervals */

#define STOPSET_COLUMNS 16 /* of one law at most */
enum { STOPSET_NO_BOUND = 5 }; /* a law gives no number over these intervals */
/* What an effect does in a stop: friction that never drives the joint; any torque; one that may be the drive's own. */
enum { STOPSET_RUBS = 0, STOPSET_PULLS = 1, STOPSET_ARM_OR_DRIVE = 2 };

/* The steps of stopset.ring.tape; numbers are intervals (.., 2). */
typedef struct {
    int32_t length;
    const int32_t *steps; /* (length, 3) */
    const double *numbers;
} StopsetBoundLaw;

/* An effect at one joint, see stopset.effects.bound. */
typedef struct {
    int32_t joint, other;   /* other: of a pair, else -1 */
    int32_t role, straight; /* straight: at rest a line over the direction of friction */
    int32_t roams;          /* looks at the pose or another joint */
    int32_t terms, states;
    StopsetBoundLaw law;
    const int32_t *column;  /* (terms,) steps of the law */
    const double *value;    /* (terms, 2) */
    const double *state;    /* (states, 2) at speeds seen */
    StopsetBoundLaw flow;   /* of one affine state, by which it is bounded at higher speeds; empty: `state` holds at all */
    double start, range[2]; /* of that state: where it begins, what is admissible */
} StopsetActing;

/* What a law may see at one joint. Speeds [rad/s]: no faster, nor before (past), nor the partner (other); gear [N m]: no more loads it. */
typedef struct {
    double speed, past, other, gear, q[2], load[2], temp[2], stiff[2], inertia[2], coriolis[2], tilt[2][2];
} StopsetSight;

/* Relative, on top of friction's bounds: it drifts with wear, oil and temperature. */
STOPSET_API extern const double stopset_friction_tolerance;
/* Torque of an effect, direction (dry + viscous |dq|) + push: out (3, 2) lower and upper ends [N m, N m s/rad, N m]. */
STOPSET_API int stopset_act(const StopsetActing *law, const StopsetSight *sight, double *out);

/* All of them, see stopset.reach.stops.friction; (n,) arrays unless said. */
typedef struct {
    int32_t laws, needs;                               /* needs: what laws look at of the rigid body */
    const StopsetActing *law;
    const double *turn;                                /* (n, n, n, n) |d Gamma_ikl/dq_m| over all poses */
    const double *tilt_gravity, *tilt_bend, *tilt_load; /* (2, 3), (2, n, n, n), (2, n) of gravity's derivatives by roll and pitch */
    const double *gear, *temp;                         /* [N m]; (n, 2) [K], 0: not known */
    const double *base, *fixed;                        /* (5, n, 2) sums without any law; with those that do not roam, up to `speed` */
    const double *speed, *fastest;                     /* [rad/s]; seen in identification */
    const double *free_lo, *free_hi;                   /* [N m] torque of no effect */
} StopsetTorques;

/* ---- stops/bound.c again */

typedef struct {
    StopsetPlant plant;
    const double *lag;           /* (n,) [s] by which a joint's brake is always later; may be 0 */
    double delay_spread;                /* [s] the brakes' delays, less lag, differ by no more; negative: they are independent */
    const double *tool;          /* (3,) [m] in the last link's frame */
    const StopsetTorques *torques; /* where friction and u depend on pose or speed; 0: the plant's hold everywhere */
    int32_t ranged;              /* what stopset_payloads says of the range that pi_half is of */
} StopsetStops;
/* Payloads from lo to hi [kg]: one, some, which two parts of their range may bound more tightly, or so much alike that finer steps bound all more tightly. */
enum { STOPSET_ONE_PAYLOAD, STOPSET_SOME_PAYLOADS, STOPSET_ALIKE_PAYLOADS };
STOPSET_API int stopset_payloads(double lo, double hi);
/* pi, half (n, 10) [kg, kg m, kg m^2] of a part (0: the heavier, 1) of what pi_half allows: every payload of it lies in one of the two. */
STOPSET_API void stopset_payload_part(const StopsetPlant *plant, int part, double *pi, double *half);

typedef struct {
    double *time, *forward, *back, *speed; /* (n,) [s], [rad] both >= 0, [rad/s] largest on the way */
    double *tool;                          /* (2,) displacement [m], speed [m/s] */
} StopsetBound;

/* How the drives brake on request, see stopset.reach.stops.ramp; (n,) arrays. */
typedef struct {
    int32_t timed;                                                 /* value [s] from the speed to rest, else [rad/s^2] */
    const double *value_lo, *value_hi, *control_lo, *control_hi;   /* .. and [s] from the request until it begins */
    const double *q_error, *dq_error, *band, *limit;               /* tracking [rad], [rad/s]; standstill [rad/s]; drives [N m] */
    const double *gear;                                            /* [N m] of links and rotors, up to which friction by a gear's load is known */
    double off_after;                                              /* [s] until power is taken whatever happens; negative: never */
    int32_t monitored;                                             /* power is taken when the ramp is left */
    double reaction, tolerance, share;                             /* [s]; shares of the speed at the request */
    double window, pace[2], settle;                                /* [rad]; [1/s]; [s] to rest after its end, negative: not known */
    const double *residual_lo, *residual_hi;                       /* [rad/s] what drives still give while their power goes */
} StopsetRamp;

/* A box of measured states: q +- q_radius [rad], dq +- dq_radius [rad/s], (n,) each. */
typedef struct {
    const double *q, *dq, *q_radius, *dq_radius;
} StopsetStates;

/* Friction and u at angles in [q_lo, q_hi] (n,) [rad], no joint faster than speed (n,) [rad/s]: out (6, n) [N m, N m s/rad] dry lo,
 * hi, viscous lo, hi, u lo, hi. STOPSET_NO_BOUND + k: the k-th law gives no number there; negative: a code. */
STOPSET_API int stopset_friction_over(const StopsetPlant *plant, const StopsetTorques *torques, const double *q_lo, const double *q_hi,
                                      const double *speed, double *out);
/* Numbers that `work` below has to hold. */
STOPSET_API int64_t stopset_stop_room(int n);
/* The stop from every state in a box (n,) [rad, rad/s]. 0: bounded; 1: not provable, then `out` holds nothing of use; negative: a code. */
STOPSET_API int stopset_power_off(const StopsetStops *stops, const StopsetStates *from, double *work, const StopsetBound *out);
/* Largest torque `asked` (n,) [N m] of links and rotors along a ramp that works from any state of the box (n,) [rad, rad/s], within `tube`,
 * the ramp's own of so many steps; it is looked at closely where it is more than the drives `have` (n,). 0, or a code. */
STOPSET_API int stopset_ramp_torque(const StopsetPlant *plant, const StopsetRamp *ramp, const StopsetStates *from, const StopsetTube *tube,
                                    int64_t steps, const double *have, double *asked);
/* The same (n,) [rad, rad/s] of a ramp that works: STOP 1, or with `stays` STOP 2, whose standstill window is part of the bound. */
STOPSET_API int stopset_working_ramp(const StopsetStops *stops, const StopsetRamp *ramp, int stays, const StopsetStates *from, double *work,
                                     const StopsetBound *out);
/* Of a ramp that fails in any way, from requests (n,) [rad, rad/s]: from every state in which power can then be taken. */
STOPSET_API int stopset_failed_ramp(const StopsetStops *stops, const StopsetRamp *ramp, const StopsetStates *from, double *work,
                                    const StopsetBound *out);

/* ---- stops/path.c: STOP 1 along a programmed path q = p(s), a cubic between two knots */

typedef struct {
    int32_t pieces;
    const double *knots;             /* (pieces + 1,) [1] s where pieces meet, growing from 0 */
    const double *coefficient;       /* (pieces, n, 4) [rad] of 1, x, x^2, x^3 with x = s - knots[k] */
    const double *noise;             /* (2n,) [rad], [rad/s] by which a reading of the state may be off */
    const double *share;             /* (n,) [1] by which a joint may turn more or less than it reads, as effects misread its angle */
    const double *q_lo, *q_hi, *fastest; /* (n,) [rad], [rad/s] limits of the arm */
    const double *seen_lo, *seen_hi; /* (2n,) [rad], [rad/s] where every state on the way has to lie */
} StopsetPath;

/* Why there is no stop on a path: the request comes too late on it; it leads beyond the arm's limits; it is too fast for the arm; a drive
 * has no torque left beside friction; it cannot be stopped on; or only with more torque than a drive has between two knots; it
 * leads through states not seen; nothing says when the arm rests; brakes do not surely hold it. */
enum {
    STOPSET_PATH_ENDS = 10, STOPSET_PATH_BEYOND, STOPSET_PATH_SPEED, STOPSET_PATH_WEAK, STOPSET_PATH_FAST, STOPSET_PATH_SHORT,
    STOPSET_PATH_UNSEEN, STOPSET_PATH_UNSETTLED, STOPSET_PATH_FALLS
};

/* What a stop passes; s in rows of the path [1]. */
typedef struct {
    int64_t poses;
    int32_t joint;          /* of a refusal, -1: none */
    double begin, length;   /* where drives begin to brake; from the request to rest */
    double time, room;      /* [s] until the ramp's end; [N m] least torque left */
    double rate;            /* largest [1/s] */
    double *s, *q, *dq;     /* (poses,), (poses, n) [rad], [rad/s], in `work` */
} StopsetPassed;

/* Where on a path a stop is asked for [1], and how fast [1/s]. */
typedef struct {
    double s, rate;
} StopsetRequest;

/* Numbers that `work` below has to hold. */
STOPSET_API int64_t stopset_path_room(int n);
/* The shortest stop along the path within the drives' torque: `passed`, and bounds `out` of displacements (n,)
 * [rad], speeds [rad/s], time [s] and tool [m, m/s]. 0: bounded; STOPSET_PATH_..: why not; from STOPSET_PATH_UNSEEN on both are filled all the same. */
STOPSET_API int stopset_path_stop(const StopsetStops *stops, const StopsetRamp *ramp, const StopsetPath *path,
                                  const StopsetRequest *request, double *work, StopsetPassed *passed, const StopsetBound *out);
/* cffi end */


#endif
