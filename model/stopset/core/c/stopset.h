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
/* cffi end */

#endif
