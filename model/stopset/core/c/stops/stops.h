/* Inside the stop proofs: what one file gives the next. Matrices are dense, with the arm's n as their stride. */
#ifndef STOPSET_STOPS_H
#define STOPSET_STOPS_H
#include <math.h>

#include "../stopset.h"
#include "../wide.h"

enum { SN = STOPSET_STOP_JOINTS, PAIRS = SN * (SN + 1) / 2 };

/* As Python's: the second wins only where it is really smaller (larger). */
static inline double least(double a, double b) { return b < a ? b : a; }
static inline double most(double a, double b) { return b > a ? b : a; }
static inline double size_of(double x) { return fabs(x); } /* an instruction, where a comparison is a branch that goes either way */
/* Place of two joints, a <= b, among all pairs. */
static inline int pair(int a, int b) { return b * (b + 1) / 2 + a; }
#define STOPS_INF HUGE_VAL /* 1.0 / 0.0 would be divided anew each time */
/* Where the second slopes of M_ij, i <= j, begin among all: m x m of each, m = n - 1 - i, as those of joints up to i are zero. */
static inline int bends_up_to(int m) { return m * (m + 1) / 2 * (m * (m + 1) / 2) + m * (m + 1) * (2 * m + 1) / 6; }
static inline int bends_of(int n, int i, int j) {
    const int m = n - 1 - i;
    return bends_up_to(n - 1) - bends_up_to(m) + (j - i) * m * m;
}
enum { LANES = 4, BENDS = (SN - 1) * SN / 2 * ((SN - 1) * SN / 2) + (SN - 1) * SN * (2 * SN - 1) / 6 };

/* Inertia, gravity and Christoffel symbols at a pose and their slopes, of the middle payload and of half its range (p: all zero
 * unless `loaded`). ddM: d2 M_ij/dq_k dq_l, k, l > i, at bends_of(n, i, j) + (k - i - 1) (n - 1 - i) + l - i - 1. root[a, b], a <= b, L_ab: no less than the root of
 * the inertia, rotors apart, about axis a of what is behind joint b, whatever the payload; solid: whether from joint b on all
 * parameters are those of bodies of positive masses. Gamma: of joint i at [k, l, i]. */
typedef struct {
    int n, loaded, solid[SN];
    double q[SN], M[SN * SN], dM[SN * SN * SN], Mp[SN * SN], dMp[SN * SN * SN], g[SN], dg[SN * SN], gp[SN], dgp[SN * SN],
        Gamma[SN * SN * SN], Gammap[SN * SN * SN], ddM[BENDS + LANES], ddMp[BENDS + LANES], root[SN * SN];
} Expansion;

/* Over a box of angles and speeds: inertia M +- M_rad (middle payload), Mp +- Mp_rad (half its range), dM: all of its
 * uncertainty; h: Coriolis and gravity torque; e: 1/2 v' dM/dq_i v - g_i; g: gravity alone; turn: how far dM_ij/dq_k can be from the
 * pose's, turn_of: the same at [j, k, i], rest: from what its slopes there tell; x +- rad: the box of angles, from the pose on, v +- v_rad: that of speeds. */
typedef struct {
    int n;
    double M[SN * SN], M_rad[SN * SN], Mp[SN * SN], Mp_rad[SN * SN], dM[SN * SN], h_lo[SN], h_hi[SN], e_lo[SN], e_hi[SN],
        g_lo[SN], g_hi[SN], turn[SN * SN * SN], turn_of[SN * SN * SN], rest[SN * SN * SN], x[SN], rad[SN], v[SN], v_rad[SN];
} Local;

/* Speed bounds of every joint, apart for its first excursion and for later. */
typedef struct {
    double sign[SN];          /* of the first, 0 if it had none */
    int alive[SN], rested[SN]; /* the first may still last; it may be over */
    double first_lo[SN], first_hi[SN], later_lo[SN], later_hi[SN];
} Bands;

/* Of every joint, from lo to hi. */
typedef struct {
    double lo[SN], hi[SN];
} Span;

/* Integrals since the cut, see momentum.c; from `start` on: what was so at the cut, the inertia and the speeds. */
typedef struct {
    double P_lo[SN], P_hi[SN], up[SN], down[SN], needed[SN], drive[SN], restart_up[SN], restart_down[SN];
    Local start;
    Span v0;
} Momentum;

/* Bound of sqrt(v' M v), speed caps on a step and at its end, bound of the inverse inertia, gravity on the step. */
typedef struct {
    double y, cap[SN], end[SN], W[SN * SN];
    Span g;
} Energy;

/* For some torques of each joint, no less than its way since the cut and y^2 / (2 torque) together [rad]: forward (hi), backward (lo). */
enum { TORQUES = 16 };
typedef struct {
    double torque[TORQUES][SN], hi[TORQUES][SN], lo[TORQUES][SN];
} Travels;

/* A step of h seconds: torques without dry friction, dry friction, and which signs are possible on it. Dry friction is no less than B_lo and no more than B_hi
 * throughout, in the mean no less than `less` and no more than `more`, and no less than the line from B_lo to `last`. */
typedef struct {
    double h, s_lo[SN], s_hi[SN], own_up[SN], own_down[SN], B_lo[SN], B_hi[SN], B_later[SN], less[SN], more[SN], last[SN], direction[SN], a_far[SN];
    int plus[SN], minus[SN], zero[SN];
} Step;

/* An arm near a pose: the expansion there, and what is so in the box of angles and speeds looked at last. */
typedef struct {
    const StopsetPlant *plant;
    const StopsetParts *parts;
    Expansion E;
    Local at;
} Near;

/* Rows of accelerations: 0-3 forward lo, hi, backward lo, hi; 4 forward hi at the upper speed bound, 5 forward lo at the
 * lower; 6, 7 the same backward; 8, 9 forward hi and backward lo of a joint that has rested before. */
enum { RATES = 10 };
static inline int is_lower(int row) { return row == 0 || row == 2 || row == 5 || row == 7 || row == 9; }
static inline int is_backward(int row) { return row == 2 || row == 3 || row == 6 || row == 7 || row == 9; }

extern const StopsetParts stops_whole; /* nothing left out */

void stops_expand(const StopsetArm *arm, const double *pi_half, const double *rotor, const double *q, Expansion *E);
/* The inertia does not change with the angles of joints up to the first of two: there `turn` and `rest` are zero, once and for all. */
void stops_start_local(int n, Local *out);
/* For angles E.q + x and speeds v, into what was started. */
void stops_box_terms(const Near *near, const Span *x, const Span *v, Local *out);
/* The arm near a box's pose, `rotors`: with their half intervals beside the payload's, and what is so in the box. */
void stops_look_at(const StopsetPlant *plant, const StopsetBox *box, const StopsetParts *parts, int rotors, Near *out);
void stops_span(int n, const double *lo, const double *hi, Span *out);
/* Joint k into (or out of) the moving set, A transposed, stride SN: A_ff = -M_ff^-1, A_sf = M_sf M_ff^-1, A_ss = Schur complement; some rows beyond n
 * are written too. */
void stops_turn_over(int n, double *A, int k, int into);
/* A symmetric matrix and its slopes in all angles and in the payload, each times its half range: entries apart from the diagonal, (n, n) with
 * stride SN and the diagonal zero, then those on it; slopes by pair(i, j), LANES of them side by side. What is beyond n is zero. */
enum { GROUPS = (SN + LANES) / LANES, SLOPES = GROUPS * LANES };
typedef struct {
    double own[SN], value[SN * SN];
    Four slope[GROUPS][PAIRS];
} Along;
enum { LANE_BITS = (1 << LANES) - 1 };
static inline double sum_of(const Four *x) { return ((*x)[0] + (*x)[1]) + ((*x)[2] + (*x)[3]); }
static inline int groups_of(int n) { return (n + LANES) / LANES; }
/* The inertia at the middle of a box, and its slopes; how much its change, and what is beyond the slopes, can make of numbers no larger than `size`.
 * Then: B is A with joint k in the moving set; its slopes where its values are there already. */
/* Coriolis and gravity torque of each joint in the box looked at: middle +- rest, and columns, each times a number in [-1, 1] that all joints share:
 * `turns` of the angles and, at n, of the payload, `speeds` of the speeds (Lemma 7). */
typedef struct {
    double middle[SN], rest[SN], turns[SN * SLOPES], speeds[SN * SLOPES];
} Columns;
void stops_columns(const Near *near, Columns *out);
void stops_slopes(const Near *near, const double *size, Along *A, double *push, double *beyond);
void stops_pivot_values(int n, const Along *A, int k, Along *B);
void stops_pivot_slopes(int n, const Along *A, int k, Along *B);
void stops_accelerations(const Local *at, const Step *s, double out[RATES][SN]);
void stops_related(const Near *near, const Step *s, double out[RATES][SN]);
void stops_start_bands(int n, const Span *v, Bands *b);
int stops_same_bands(int n, const Bands *a, const Bands *b);
void stops_total(int n, const Bands *b, double *lo, double *hi);
void stops_start_momentum(const Near *near, const Span *x, const Span *v, const Bands *b, Momentum *m);
void stops_retained_impulse(const Near *near, const Momentum *m, const Step *s, const Bands *before, const Bands *after, const Span *v,
                            double *retained);
void stops_carry_on(const Near *near, Momentum *m, const Step *s, const Bands *before, const Bands *after, const Span *v,
                    const double *retained);
void stops_tighten(Bands *b, const Momentum *m, const Local *at, double *lo, double *hi);
double stops_largest(const Local *at, const double *v_lo, const double *v_hi);
void stops_power_excess(int n, const Span *g, const StopsetRange *u, const double *B_lo, Span *w);
int stops_step_energy(Near *near, Energy *e, const Span *x, const Step *s);
int stops_travel_left(Near *near, const Energy *e, const Span *x, const double *B_lo, Span *travel);
double stops_by_power(int n, double y, const Span w[2], const Span *v, const Span *p, double h);
void stops_start_travels(const StopsetPlant *p, double y, Travels *out);
void stops_travels_on(int n, const Span w[2], const Span *v, double h, Travels *travels);
void stops_cut_travels(int n, double y, Travels *travels, double *d_lo, double *d_hi);
void stops_cap_bands(int n, Bands *b, const Span *cap);
void stops_cap_lines(int n, const Span *cap, double *const line[4], int alone); /* line: v_lo, v_hi, e_lo, e_hi */
void stops_start_pulls(const Local *at, const Span *v, Span *p);
void stops_pull_caps(Near *near, const Span *x, const Span *v, const Span *p, const Step *s, Span *room, Span *cap);
void stops_pull_on(const Near *near, const Step *s, const Span *w, Span *p, Span *step);
double stops_pull_cut(const Near *near, Span *p, Span *v);
#endif
