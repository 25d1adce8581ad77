/* STOP 1 along a programmed path: the shortest stop that keeps the arm on q = p(s) within the drives' torque.
 *
 * Along a path the torques are lines over s'' and s'^2, so at every knot of a grid the hardest deceleration is an end of an interval,
 * with the torques at both ends of the step within what friction leaves; s'^2 is a line over s in between. Three passes: each takes
 * its grid from the length that the one before has found. What lies between the knots is looked at four times as densely.
 *
 * Source: Pham & Pham (2018), A new approach to time-optimal path parameterization based on reachability analysis, eq. 5 and 13.
 */
#include <math.h>
#include <string.h>

#include "bound.h"

enum { ROUGH = 20, GRID = 60, LONGEST = 4, DENSE = 4, EARLY = 60, BANDS = 60, MOST_STEPS = LONGEST * GRID, POSES = EARLY + MOST_STEPS * DENSE + 1 };
static const double RESERVE = 0.02; /* share of the torque kept for what happens between the knots */
static const double HAIR = 1e-12;   /* of evaluating a cubic, relative */
static const double SHORT = 1e-7;   /* of the path that is left: no grid is for less */
static const double ROOMY = 1e-3;   /* by which the last grid is wider than the length found, so that the stop ends on it */

enum { SIDES = 4 }; /* of what is known as ranges: the least payload with the least and the largest rotors, then the largest payload */

/* Torque of arm `side` and joint i: u a + x b + c, with x = s'^2, u = s''. */
typedef struct {
    double a[SIDES][SN], b[SIDES][SN], c[SIDES][SN];
} Lines;

/* x at the knots, `step` apart in s. */
typedef struct {
    double x[MOST_STEPS + 1], step, length; /* length: where x would be zero, had the last step gone on */
    int made;
} Profile;

typedef struct {
    const StopsetStops *stops;
    const StopsetRamp *ramp;
    const StopsetPath *path;
    int n;
    double off[SN], off_speed[SN]; /* of the arm from its path, as read */
    double body[2][10 * SN];
} Task;

static int piece_of(const StopsetPath *p, double s) {
    int lo = 0, hi = p->pieces - 1;
    while (lo < hi) {
        const int middle = (lo + hi + 1) / 2;
        if (p->knots[middle] <= s)
            lo = middle;
        else
            hi = middle - 1;
    }
    return lo;
}

static void place(const Task *t, double s, double *q, double *first, double *second) {
    const int k = piece_of(t->path, s);
    const double x = s - t->path->knots[k];
    for (int i = 0; i < t->n; i++) {
        const double *c = t->path->coefficient + 4 * ((int64_t)k * t->n + i);
        q[i] = c[0] + x * (c[1] + x * (c[2] + x * c[3]));
        first[i] = c[1] + x * (2.0 * c[2] + x * (3.0 * c[3]));
        second[i] = 2.0 * c[2] + x * (6.0 * c[3]);
    }
}

static double cubic(const double *c, double x) { return c[0] + x * (c[1] + x * (c[2] + x * c[3])); }

/* The ends of joint i's angle on [from, to] of one piece, and what is steepest there. */
static void over_piece(const double *c, double from, double to, double *lo, double *hi, double *first, double *second) {
    double at[4] = {from, to, from, to};
    const double root = c[2] * c[2] - 3.0 * c[3] * c[1], bend = -(c[2] + (c[2] < 0.0 ? -1.0 : 1.0) * sqrt(most(root, 0.0)));
    if (root >= 0.0) { /* where it turns round; no number where it does not */
        at[2] = bend / (3.0 * c[3]);
        at[3] = c[1] / bend;
    }
    for (int k = 0; k < 4; k++) {
        if (!(at[k] >= from && at[k] <= to)) continue;
        const double y = cubic(c, at[k]), hair = HAIR * (1.0 + size_of(y));
        *lo = least(*lo, y - hair);
        *hi = most(*hi, y + hair);
    }
    const double vertex = -c[2] / (3.0 * c[3]), ends[3] = {from, to, vertex >= from && vertex <= to ? vertex : from};
    for (int k = 0; k < 3; k++) *first = most(*first, size_of(c[1] + ends[k] * (2.0 * c[2] + ends[k] * (3.0 * c[3]))) * (1.0 + HAIR));
    for (int k = 0; k < 2; k++) *second = most(*second, size_of(2.0 * c[2] + 6.0 * c[3] * ends[k]) * (1.0 + HAIR));
}

/* Least and largest angles on [begin, end], largest |dp/ds| and |d2p/ds2|, (n,) each. */
static void stretch(const Task *t, double begin, double end, double *lo, double *hi, double *first, double *second) {
    const StopsetPath *p = t->path;
    for (int i = 0; i < t->n; i++) {
        lo[i] = STOPS_INF;
        hi[i] = -STOPS_INF;
        first[i] = second[i] = 0.0;
    }
    for (int k = piece_of(p, begin); k < p->pieces && (p->knots[k] < end || k == piece_of(p, begin)); k++)
        for (int i = 0; i < t->n; i++) {
            const double from = most(begin, p->knots[k]) - p->knots[k], to = least(end, p->knots[k + 1]) - p->knots[k];
            over_piece(p->coefficient + 4 * ((int64_t)k * t->n + i), from, most(from, to), lo + i, hi + i, first + i, second + i);
        }
}

/* The plant with what the effects give on a stretch of the path, passed at `rate` at most; 0 where they have no bound. */
static int there(const Task *t, double begin, double end, double rate, double friction[6 * SN], double top[SN], StopsetPlant *out) {
    double lo[SN], hi[SN], second[SN], speed[SN];
    stretch(t, begin, end, lo, hi, top, second);
    for (int i = 0; i < t->n; i++) {
        top[i] *= rate;
        lo[i] -= t->off[i];
        hi[i] += t->off[i];
        speed[i] = top[i] + t->off_speed[i];
    }
    return stops_near(t->stops, lo, hi, speed, friction, out);
}

static double rubbing(const StopsetPlant *p, int i, double speed) {
    return p->coulomb_hi[i] + p->viscous_hi[i] * speed + most(size_of(p->u_lo[i]), size_of(p->u_hi[i]));
}

/* What the rigid body may use of every drive on a stretch; the joint whose drive has nothing left, or -1. */
static int room_of(const Task *t, double begin, double end, double rate, double room[SN]) {
    double friction[6 * SN], top[SN];
    StopsetPlant plant;
    const int bounded = there(t, begin, end, rate, friction, top, &plant); /* friction without a bound leaves nothing */
    for (int i = 0; i < t->n; i++) {
        room[i] = least(bounded * t->ramp->limit[i] * (1.0 - RESERVE) - rubbing(&plant, i, top[i]), t->ramp->gear[i] * (1.0 - RESERVE));
        if (!(room[i] > 0.0)) return i;
    }
    return -1;
}

static void lines_at(const Task *t, double s, Lines *out) {
    double q[3 * SN], first[SN], second[SN], v[3 * SN] = {0}, a[3 * SN] = {0}, tau[3 * SN];
    StopsetArm arm = t->stops->plant.arm;
    const int n = t->n;
    place(t, s, q, first, second);
    for (int k = 1; k < 3; k++) memcpy(q + k * n, q, (size_t)n * sizeof *q);
    memcpy(a + n, first, (size_t)n * sizeof *a);
    memcpy(a + 2 * n, second, (size_t)n * sizeof *a);
    memcpy(v + 2 * n, first, (size_t)n * sizeof *v);
    for (int side = 0; side < SIDES; side++) {
        arm.pi = t->body[side / 2];
        if (side % 2 == 0) stopset_torques(&arm, 3, q, v, a, tau);
        for (int i = 0; i < n; i++) {
            const double rotor = t->stops->plant.rotor[i] + (side % 2 ? 1.0 : -1.0) * t->stops->plant.rotor_half[i];
            out->c[side][i] = tau[i];
            out->a[side][i] = tau[n + i] - tau[i] + rotor * first[i];
            out->b[side][i] = tau[2 * n + i] - tau[i] + rotor * second[i];
        }
    }
}

/* [lo, hi] cut to the u with |slope u + rest| <= room: where the slope is zero all of them, or none. */
static void cut(double slope, double rest, double room, double *lo, double *hi) {
    const double one = (-room - rest) / slope, other = (room - rest) / slope;
    *lo = most(*lo, least(one, other));
    *hi = least(*hi, most(one, other));
}

/* The decelerations from lo to hi that the torques at both ends of a step allow: there are any if they are in order. */
typedef struct {
    double lo, hi;
} Allowed;

static Allowed allowed(const Task *t, const Lines *here, const Lines *next, double x, double step, const double room[SN]) {
    Allowed out = {-STOPS_INF, STOPS_INF};
    for (int side = 0; side < SIDES; side++)
        for (int i = 0; i < t->n; i++) {
            cut(here->a[side][i], here->b[side][i] * x + here->c[side][i], room[i], &out.lo, &out.hi);
            if (next) cut(next->a[side][i] + 2.0 * step * next->b[side][i], next->b[side][i] * x + next->c[side][i], room[i], &out.lo, &out.hi);
        }
    return out;
}

/* Full braking from s = begin at `rate` on a grid of `step`; whether it ends on the path, and no farther than MOST_STEPS. */
static int brake(const Task *t, double begin, double rate, double step, const double room[SN], Profile *out) {
    const double last = t->path->knots[t->path->pieces], ahead = least(last - begin, MOST_STEPS * step) * (1.0 + HAIR);
    Lines both[2];
    out->x[0] = rate * rate;
    out->step = step;
    lines_at(t, begin, both);
    for (int k = 0; (k + 1) * step <= ahead; k++) {
        const double x = out->x[k], s = begin + (k + 1) * step, whole = -x / (2.0 * step);
        lines_at(t, least(s, last), both + (k + 1) % 2);
        const Allowed a = allowed(t, both + k % 2, both + (k + 1) % 2, x, step, room);
        if (!(a.lo <= least(a.hi, 0.0))) return 0; /* torques contradict each other, or let it run on faster */
        out->made = k + 1;
        if (a.lo <= whole) {
            out->x[k + 1] = 0.0;
            out->length = (k + whole / a.lo) * step;
            return 1;
        }
        out->x[k + 1] = x + 2.0 * step * a.lo;
    }
    return 0;
}

/* The shortest stop; a code. */
static int shortest(const Task *t, double begin, double rate, StopsetPassed *passed, Profile *out) {
    const double left = t->path->knots[t->path->pieces] - begin;
    const int steps[3] = {ROUGH, GRID, GRID};
    double room[SN], length = left;
    Lines here;
    passed->joint = room_of(t, begin, begin, rate, room);
    if (passed->joint >= 0) return STOPSET_PATH_WEAK;
    lines_at(t, begin, &here);
    const Allowed first = allowed(t, &here, 0, rate * rate, 0.0, room); /* where there is none the first step finds none either */
    length = least(length, rate * rate / most(-2.0 * first.lo, 1e-12 * rate * rate));
    for (int pass = 0; pass < 3; pass++) { /* the region that friction is looked up in holds a stop half as long again */
        passed->joint = room_of(t, begin, begin + least(1.5 * length, left), rate, room);
        if (passed->joint >= 0) return STOPSET_PATH_WEAK;
        const double step = most(least(length * (1.0 + ROOMY), left), SHORT * left) / steps[pass];
        if (!brake(t, begin, rate, step, room, out)) return STOPSET_PATH_FAST;
        length = least(out->length, left);
    }
    return STOPSET_OK;
}

/* The hardest deceleration at x that any one of the arms can have, be its payload and its rotors known: no stop brakes harder. */
static double hardest(const Task *t, const Lines *at, double x, const double room[SN]) {
    double out = STOPS_INF;
    for (int side = 0; side < SIDES; side++) {
        double lo = -STOPS_INF, hi = STOPS_INF;
        for (int i = 0; i < t->n; i++) cut(at->a[side][i], at->b[side][i] * x + at->c[side][i], room[i], &lo, &hi);
        out = least(out, lo);
    }
    return out;
}

/* Rates of the stop that is over first, (GRID + 1,): from the first place and the slowest rate at which a ramp can begin, as hard as drives can brake at all.
 * At the last place all are over, whatever rounding leaves there: below any rate. */
static void soonest(const Task *t, const Lines *at, double step, double rate, const double room[SN], double x[GRID + 1]) {
    double strong[SN];
    for (int i = 0; i < t->n; i++) strong[i] = 2.0 * t->ramp->limit[i] - room[i]; /* friction helps to brake */
    x[0] = rate * rate;
    for (int k = 0; k < GRID; k++) {
        const double u = least(hardest(t, at + k, x[k], strong), hardest(t, at + k + 1, x[k], strong));
        x[k + 1] = most(least(x[k] + 2.0 * step * u, x[k]), 0.0);
    }
    x[GRID] = -1.0;
}

/* The least deceleration that the torques surely allow at knots from to to and rates of which x is one of two; the less, the longer it takes. */
static double surely(const Task *t, const Lines *at, int from, int to, const double x[2], const double room[SN]) {
    double out = STOPS_INF;
    for (int k = from; k <= to; k++)
        for (int side = 0; side < 2; side++) { /* lines over x: the hardest one is hardest at an end */
            const Allowed a = allowed(t, at + k, 0, x[side], 0.0, room);
            out = least(out, a.lo <= a.hi ? -a.lo : -STOPS_INF);
        }
    return out;
}

/* [s] from the request until every stop is over, whenever its ramp begins and however fast the motion then is; infinite where drives cannot surely brake.
 *
 * Stops that brake as hard as drives allow do not cross in the plane of place and rate: at any rate each is between the stop that is over first and the one
 * that begins last, at the highest rate (`f`). One that begins early may brake where drives have less torque, or creep there, and so take
 * longer than that one though it ends before it: so each band of rates lasts as long as the weakest place between these two makes it. */
static double longest(const Task *t, double first, double slowest, double begin, double control, const Profile *f) {
    const double last = t->path->knots[t->path->pieces], end = least(begin + f->made * f->step, last), step = (end - first) / GRID;
    const double top = sqrt(f->x[0]);
    double room[SN], x[GRID + 1], out = control;
    int from = 0, to = 0;
    Lines at[GRID + 1];
    if (room_of(t, first, end, top, room) >= 0) return STOPS_INF;
    for (int k = 0; k <= GRID; k++) lines_at(t, least(first + k * step, last), at + k);
    soonest(t, at, step, slowest, room, x);
    for (int band = 0; band < BANDS; band++) {
        const double rate[2] = {top * (BANDS - band) / BANDS, top * (BANDS - band - 1) / BANDS}, ends[2] = {rate[0] * rate[0], rate[1] * rate[1]};
        while (x[from + 1] >= ends[0]) from++;
        int knot = f->made; /* the last at which the latest stop is as fast */
        while (f->x[knot - 1] < ends[1]) knot--;
        to = (int)least((begin + knot * f->step - first) / step, GRID - 1) + 1;
        const double u = surely(t, at, (int)least(from, to), to, ends, room);
        if (!(u > 0.0)) return STOPS_INF;
        out += (rate[0] - rate[1]) / u;
    }
    return out;
}

/* A pose and its speeds; the joint whose speed is beyond the arm's. */
static void pass(const Task *t, StopsetPassed *p, double s, const double *q, const double *speed) {
    const int64_t at = p->poses++ * t->n;
    p->s[p->poses - 1] = s;
    for (int i = 0; i < t->n; i++) {
        p->q[at + i] = q[i];
        p->dq[at + i] = speed[i];
        if (size_of(speed[i]) > t->path->fastest[i] * (1.0 + 1e-9)) p->joint = i;
    }
}

static double clamped(double x, double size) { return most(least(x, size), -size); }

/* What is passed from s0 on, where the path is run through at `asked`, and the least torque left on the way; a code. Until it brakes it may get faster,
 * up to f's first rate, but no joint faster than the arm's. */
static int look(const Task *t, double s0, double asked, double begin, const Profile *f, StopsetPassed *p) {
    const int n = t->n;
    const double end = begin + f->made * f->step;
    double q[SN], first[SN], second[SN], v[SN], a[SN], tau[SN], friction[6 * SN], top[SN];
    StopsetPlant plant;
    StopsetArm arm = t->stops->plant.arm;
    p->rate = sqrt(f->x[0]);
    for (int k = 0; k < EARLY; k++) {
        const double s = s0 + (begin - s0) * k / (EARLY - 1);
        place(t, s, q, first, second);
        for (int i = 0; i < n; i++) {
            const double at_request = first[i] * asked, most_of_it = most(t->path->fastest[i], size_of(at_request));
            v[i] = k ? clamped(first[i] * p->rate, most_of_it) : at_request;
        }
        pass(t, p, s, q, v);
    }
    for (int k = 0; k <= f->made; k++) p->rate = most(p->rate, sqrt(f->x[k]));
    const int bounded = there(t, begin, least(end, t->path->knots[t->path->pieces]), p->rate, friction, top, &plant);
    for (int k = 0; k < f->made; k++) {
        const double u = (f->x[k + 1] - f->x[k]) / (2.0 * f->step);
        /* the last step is as long as the drives' torque makes it, not as the grid is */
        p->time += 2.0 * (least((k + 1) * f->step, f->length) - k * f->step) / (sqrt(f->x[k]) + sqrt(f->x[k + 1]));
        for (int part = 0; part < DENSE; part++) {
            const double ahead = f->step * part / DENSE, s = begin + k * f->step + ahead, sd = sqrt(most(f->x[k] + 2.0 * u * ahead, 0.0));
            place(t, s, q, first, second);
            for (int i = 0; i < n; i++) {
                v[i] = first[i] * sd;
                a[i] = first[i] * u + second[i] * (sd * sd);
            }
            pass(t, p, s, q, v);
            for (int side = 0; side < 2; side++) {
                arm.pi = t->body[side];
                stopset_torques(&arm, 1, q, v, a, tau);
                for (int i = 0; i < n; i++) {
                    const double used = size_of(tau[i] + plant.rotor[i] * a[i]) + plant.rotor_half[i] * size_of(a[i]);
                    p->room = least(p->room, bounded * t->ramp->limit[i] - used - rubbing(&plant, i, size_of(v[i])));
                    p->room = least(p->room, t->ramp->gear[i] - most(used, size_of(tau[i]))); /* the gear bears the link's alone */
                }
            }
        }
    }
    memset(v, 0, sizeof v);
    place(t, least(end, t->path->knots[t->path->pieces]), q, first, second);
    pass(t, p, end, q, v);
    if (p->joint >= 0) return STOPSET_PATH_SPEED;
    return p->room < 0.0 ? STOPSET_PATH_SHORT : STOPSET_OK;
}

/* How far the arm is moved, how fast, in joints and at the tool; what lies between two poses is within half their spacing of one.
 *
 * The arm is beside the poses by what is wrong of its reading at the request, which moves with it: no point is moved by more than twice that times its reach
 * more or less for it, nor by more than how far the arm has turned meanwhile times that; and by what changes on the way, tracking and misreading. */
static void bound(const Task *t, double s0, const StopsetPassed *p, const StopsetBound *out) {
    const int n = t->n;
    const StopsetArm *arm = &t->stops->plant.arm;
    double lo[SN], hi[SN], first[SN], second[SN], J[3 * SN], here[3], start[3], spacing = 0.0, far = 0.0, fast = 0.0;
    double reach = sqrt(t->stops->tool[0] * t->stops->tool[0] + t->stops->tool[1] * t->stops->tool[1] + t->stops->tool[2] * t->stops->tool[2]);
    double off = 0.0, aside = 0.0, beside = 0.0, travel = 0.0, sway = 0.0, turned = 0.0, bent = 0.0, misread = 0.0;
    stretch(t, s0, least(s0 + p->length, t->path->knots[t->path->pieces]), lo, hi, first, second);
    for (int i = 1; i < n; i++) reach += sqrt(arm->p[3 * i] * arm->p[3 * i] + arm->p[3 * i + 1] * arm->p[3 * i + 1] + arm->p[3 * i + 2] * arm->p[3 * i + 2]);
    for (int64_t k = 1; k < p->poses; k++) spacing = most(spacing, p->s[k] - p->s[k - 1]);
    for (int i = 0; i < n; i++) {
        const double more = t->ramp->q_error[i], share = t->path->share[i], ahead = most(hi[i] - p->q[i], 0.0), behind = most(p->q[i] - lo[i], 0.0);
        out->forward[i] = ahead * (1.0 + share) + more;
        out->back[i] = behind * (1.0 + share) + more;
        out->speed[i] = p->rate * first[i] * (1.0 + share) + t->ramp->dq_error[i];
        off += 0.5 * spacing * first[i] + more + most(ahead, behind) * share;
        aside += t->path->noise[i];
        beside += t->off[i];
        travel += most(ahead, behind);
        sway += t->ramp->dq_error[i];
        turned += first[i] * (1.0 + share);
        misread += first[i] * share;
        bent += second[i];
    }
    for (int64_t k = 0; k < p->poses; k++) {
        double pose[SN], slope[SN], curve[SN], move = 0.0, pace = 0.0;
        place(t, least(p->s[k], t->path->knots[t->path->pieces]), pose, slope, curve);
        stopset_point(arm, pose, n - 1, t->stops->tool, here, J);
        if (!k) memcpy(start, here, sizeof start);
        for (int x = 0; x < 3; x++) {
            double going = 0.0;
            for (int i = 0; i < n; i++) going += J[x * n + i] * slope[i];
            move += (here[x] - start[x]) * (here[x] - start[x]);
            pace += going * going;
        }
        far = most(far, move);
        fast = most(fast, pace);
    }
    out->tool[0] = sqrt(far) + reach * (off + aside * least(travel, 2.0));
    out->tool[1] = p->rate * (sqrt(fast) + 0.5 * spacing * reach * (turned * turned + bent) + reach * (beside * turned + misread)) + reach * sway;
}

/* Whether every state passed lies where the model speaks. */
static int seen(const Task *t, const StopsetPassed *p) {
    const int n = t->n;
    const double *lo = t->path->seen_lo, *hi = t->path->seen_hi;
    int inside = 1;
    for (int64_t k = 0; k < p->poses; k++)
        for (int i = 0; i < n; i++) {
            const double q = p->q[k * n + i], dq = p->dq[k * n + i];
            inside &= (q >= lo[i]) & (q <= hi[i]) & (dq >= lo[n + i]) & (dq <= hi[n + i]);
        }
    return inside;
}

/* Whether brakes surely hold the arm at poses `from` up to `to` (exclusive) and half a `spacing` beyond: all around the middle one, or by halves.
 * Its joints turn by at most `first` per unit of s. */
static int held_between(const Task *t, const StopsetPassed *p, int64_t from, int64_t to, double spacing, const double first[SN]) {
    const int64_t middle = from + (to - from) / 2;
    const double far = most(p->s[middle] - p->s[from], p->s[to - 1] - p->s[middle]);
    double near[SN];
    for (int i = 0; i < t->n; i++) near[i] = t->off[i] + (far + 0.5 * spacing) * first[i];
    if (stops_held(t->stops, p->q + middle * t->n, near)) return 1;
    return to - from > 1 && held_between(t, p, from, middle, spacing, first) && held_between(t, p, middle, to, spacing, first);
}

/* Whether brakes surely hold the arm wherever it is led: a ramp that begins early ends before the last pose. */
static int held(const Task *t, double s0, const StopsetPassed *p) {
    double lo[SN], hi[SN], first[SN], second[SN], spacing = 0.0;
    stretch(t, s0, least(s0 + p->length, t->path->knots[t->path->pieces]), lo, hi, first, second);
    for (int64_t k = 1; k < p->poses; k++) spacing = most(spacing, p->s[k] - p->s[k - 1]);
    return held_between(t, p, 0, p->poses, spacing, first);
}

/* The joint that the rest of the path takes beyond the arm's limits, or -1. */
static int beyond(const Task *t, double s0) {
    double lo[SN], hi[SN], first[SN], second[SN];
    stretch(t, s0, t->path->knots[t->path->pieces], lo, hi, first, second);
    for (int i = 0; i < t->n; i++)
        if (!((lo[i] >= t->path->q_lo[i] - 1e-9) & (hi[i] <= t->path->q_hi[i] + 1e-9))) return i;
    return -1;
}

int64_t stopset_path_room(int n) { return POSES * (1 + 2 * (int64_t)n); }

int stopset_path_stop(const StopsetStops *stops, const StopsetRamp *ramp, const StopsetPath *path, const StopsetRequest *request, double *work,
                      StopsetPassed *passed, const StopsetBound *out) {
    const double s = request->s, rate = request->rate, pace = most(0.0, most(ramp->pace[0], ramp->pace[1]));
    Task t = {stops, ramp, path, stops->plant.arm.n, {0}, {0}, {{0}}};
    Profile f;
    double after = 0.0, control = 0.0, soon = STOPS_INF; /* ramps begin between these */
    if (t.n < 1 || t.n > SN) return -STOPSET_TOO_MANY_JOINTS;
    for (int i = 0; i < t.n; i++) {
        t.off[i] = ramp->q_error[i] + path->noise[i];
        t.off_speed[i] = ramp->dq_error[i] + path->noise[t.n + i];
        control = most(control, ramp->control_hi[i]);
        soon = least(soon, ramp->control_lo[i]);
        if (!(ramp->dq_error[i] <= ramp->band[i])) after = ramp->settle;
    }
    for (int k = 0; k < 10 * t.n; k++)
        for (int side = 0; side < 2; side++) t.body[side][k] = stops->plant.arm.pi[k] + (side ? 1.0 : -1.0) * stops->plant.pi_half[k];
    StopsetPassed none = {0, -1, 0.0, 0.0, control, STOPS_INF, 0.0, work, work + POSES, work + POSES + POSES * (int64_t)t.n};
    *passed = none;
    const double quick = rate * (1.0 + pace * control); /* at the latest start of the ramp, of a motion that gets faster */
    passed->begin = s + rate * control * (1.0 + 0.5 * pace * control);
    if (!((s >= 0.0) & (s < path->knots[path->pieces]) & (rate > 0.0) & (rate < STOPS_INF))) return STOPSET_OUT_OF_RANGE;
    if (!(passed->begin < path->knots[path->pieces])) return STOPSET_PATH_ENDS;
    passed->joint = beyond(&t, s);
    if (passed->joint >= 0) return STOPSET_PATH_BEYOND;
    double q[SN], first[SN], second[SN];
    place(&t, s, q, first, second);
    for (int i = 0; i < t.n; i++)
        if (!(size_of(first[i] * rate) <= path->fastest[i] * (1.0 + 1e-9))) passed->joint = i;
    if (passed->joint >= 0) return STOPSET_PATH_SPEED;
    int code = shortest(&t, passed->begin, quick, passed, &f);
    if (!code) code = look(&t, s, rate, passed->begin, &f, passed);
    if (code) return code;
    const double slower = least(0.0, least(ramp->pace[0], ramp->pace[1])), share = most(1.0 + slower * control, 0.0);
    const double run = 1.0 + slower * soon > 0.0 ? soon * (1.0 + 0.5 * slower * soon) : -0.5 / slower;
    passed->time = most(passed->time, longest(&t, s + rate * run, rate * share, passed->begin, control, &f));
    if (!(passed->time < STOPS_INF)) return STOPSET_PATH_FAST;
    passed->length = passed->begin - s + f.made * f.step;
    bound(&t, s, passed, out);
    for (int i = 0; i < t.n; i++) out->time[i] = passed->time + after;
    if (!seen(&t, passed)) return STOPSET_PATH_UNSEEN;
    if (!(after >= 0.0)) return STOPSET_PATH_UNSETTLED;
    if (ramp->off_after >= 0.0 && ramp->off_after < passed->time + after) return STOPSET_PATH_UNSETTLED; /* power is taken before */
    return held(&t, s, passed) ? STOPSET_OK : STOPSET_PATH_FALLS;
}
