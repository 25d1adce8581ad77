/* What an effect can do to an arm whose drives are off: its own law over intervals, separated into what opposes the motion and what
 * pushes. What is asked of a law, and why this encloses it, stands in stopset.effects.bound.
 *
 * Numbers are slopes: a function f(x) with 0 <= x <= X and all else in intervals has its values in `all`, f(0) in `start` and f(x) - f(0)
 * in rate * x, so viscous friction keeps its coefficient. Every operation rounds outward.
 *
 * Source: Moore, Kearfott & Cloud (2009), ch. 2-6 (intervals, slopes and the mean value form).
 */
#include <math.h>
#include <string.h>

#include "../law.h"
#include "../inputs.h"
#include "laws.h"

enum { PIECES = 3, COLUMNS = STOPSET_COLUMNS };
enum { NO_RATE, CONSTANT_RATE, RATE };
static const double PI = 3.141592653589793, LARGEST_ANGLE = 1e6;

typedef struct {
    Ends all, start, rate;
    int how; /* whether a rate is known, or the number does not change at all */
} Slope;

/* The next double towards `up` (or down). */
static double next(double x, int up) {
    int64_t bits;
    if (!(x - x == 0.0)) { /* what is infinite comes back only from within */
        if (x == x && (x > 0.0) != up) return up ? -0x1.fffffffffffffp1023 : 0x1.fffffffffffffp1023;
        return x;
    }
    if (x == 0.0) return up ? 0x1p-1074 : -0x1p-1074;
    memcpy(&bits, &x, sizeof bits);
    bits += (x > 0.0) == up ? 1 : -1;
    memcpy(&x, &bits, sizeof x);
    return x;
}

Ends ends_out(double lo, double hi, int ulps) {
    for (int k = 0; k < ulps; k++) {
        lo = next(lo, 0);
        hi = next(hi, 1);
    }
    const Ends out = {lo, hi};
    return out;
}

static Ends of(double lo, double hi) {
    const Ends out = {lo, hi};
    return out;
}

Ends ends_add(Ends a, Ends b) { return ends_out(a.lo + b.lo, a.hi + b.hi, 1); }
static Ends minus(Ends a) { return of(-a.hi, -a.lo); }
static Ends sub(Ends a, Ends b) { return ends_out(a.lo - b.hi, a.hi - b.lo, 1); }
static int sound(Ends a) { return a.lo <= a.hi; }

Ends ends_mul(Ends a, Ends b) {
    const double p[4] = {a.lo * b.lo, a.lo * b.hi, a.hi * b.lo, a.hi * b.hi};
    double lo = p[0], hi = p[0];
    for (int k = 0; k < 4; k++) {
        if (p[k] != p[k]) return of(p[k], p[k]);
        lo = least(lo, p[k]);
        hi = most(hi, p[k]);
    }
    return ends_out(lo, hi, 1);
}

static Ends divide(Ends a, Ends b) {
    if (b.lo <= 0.0 && b.hi >= 0.0) return of((double)NAN, (double)NAN);
    return ends_mul(a, ends_out(1.0 / b.hi, 1.0 / b.lo, 1));
}

static Ends hull(Ends a, Ends b) { return of(least(a.lo, b.lo), most(a.hi, b.hi)); }
static int holds_zero(Ends a) { return a.lo <= 0.0 && a.hi >= 0.0; }
static Ends clipped(Ends a, double lo, double hi) { return of(most(a.lo, lo), least(a.hi, hi)); }

static double times_itself(double x, int n) {
    double out = x;
    for (int k = 1; k < n; k++) out *= x;
    return out;
}

/* n > 1: as many products, each rounds by half a unit in the last place. */
static Ends power(Ends a, int n) {
    if (n % 2) return ends_out(times_itself(a.lo, n), times_itself(a.hi, n), n);
    const double x = size_of(a.lo), y = size_of(a.hi);
    const Ends out = ends_out(holds_zero(a) ? 0.0 : times_itself(least(x, y), n), times_itself(most(x, y), n), n);
    return of(most(out.lo, 0.0), out.hi);
}

static Ends magnitude(Ends a) {
    const double x = size_of(a.lo), y = size_of(a.hi);
    return of(holds_zero(a) ? 0.0 : least(x, y), most(x, y));
}

/* One that reaches 0 takes in all friction directions (Filippov). */
static Ends direction(Ends a) { return of(a.lo > 0.0 ? 1.0 : -1.0, a.hi < 0.0 ? -1.0 : 1.0); }

/* The core's functions err by 2 units in the last place at most. */
enum { ULPS = 4 };
static Ends exponential(Ends a) {
    const Ends out = ends_out(stopset_exp(a.lo), stopset_exp(a.hi), ULPS);
    return of(most(out.lo, 0.0), out.hi);
}
static Ends saturation(Ends a) { return clipped(ends_out(stopset_tanh(a.lo), stopset_tanh(a.hi), ULPS), -1.0, 1.0); }
static Ends root(Ends a) {
    const Ends out = ends_out(sqrt(a.lo), sqrt(a.hi), 1); /* below zero not a number */
    return out.lo == out.lo ? of(most(out.lo, 0.0), out.hi) : out;
}

/* Whether some whole number lies in [lo, hi] / (2 pi), with 1e-9 rad to spare. */
static int full_turn(double lo, double hi) {
    const double first = (lo - 1e-9) / (2.0 * PI), last = (hi + 1e-9) / (2.0 * PI);
    const int64_t down = (int64_t)last, whole = down - (last < (double)down);
    return (double)whole >= first;
}

static Ends cosine(Ends a) {
    if (!(a.lo >= -LARGEST_ANGLE && a.hi <= LARGEST_ANGLE)) return of(-1.0, 1.0);
    const double x = stopset_cos(a.lo), y = stopset_cos(a.hi);
    const double lo = full_turn(a.lo - PI, a.hi - PI) ? -1.0 : least(x, y), hi = full_turn(a.lo, a.hi) ? 1.0 : most(x, y);
    return clipped(ends_out(lo, hi, ULPS), -1.0, 1.0);
}
static Ends sine(Ends a) { return cosine(sub(a, of(0.5 * PI, 0.5 * PI))); }

static Slope constant(Ends x) {
    const Slope out = {x, x, {0.0, 0.0}, CONSTANT_RATE};
    return out;
}

/* side * x, 0 <= x <= largest */
static Slope speed(double largest, double side) {
    const double end = side * largest;
    const Slope out = {{least(end, 0.0), most(end, 0.0)}, {0.0, 0.0}, {side, side}, RATE};
    return out;
}

/* The rate of a sum, product ... of two; where neither changes the result does not. */
static int both(const Slope *x, const Slope *y) {
    if (x->how == CONSTANT_RATE && y->how == CONSTANT_RATE) return CONSTANT_RATE;
    return x->how == NO_RATE || y->how == NO_RATE ? NO_RATE : RATE;
}

static Ends size_rate(const Slope *x) {
    const double largest = most(size_of(x->rate.lo), size_of(x->rate.hi));
    if (x->all.lo >= 0.0) return x->rate;
    return x->all.hi <= 0.0 ? minus(x->rate) : of(-largest, largest);
}

/* x^n by one product after the other. */
static Slope raised(const Slope *x, int n) {
    Slope out = constant(of(1.0, 1.0));
    for (int k = 0; k < n && x->how == RATE; k++) {
        out.rate = ends_add(ends_mul(out.all, x->rate), ends_mul(out.rate, x->start));
        out.all = ends_mul(out.all, x->all);
    }
    out.how = x->how;
    out.all = power(x->all, n);
    out.start = power(x->start, n);
    return out;
}

/* A smooth function of it: mean value theorem. */
static Slope by(const Slope *x, Ends (*f)(Ends), Ends derivative) {
    const Slope out = {f(x->all), f(x->start), x->how == RATE ? ends_mul(derivative, x->rate) : of(0.0, 0.0), x->how};
    return out;
}

static Slope arithmetic(int what, const Slope *x, const Slope *y) {
    Slope z = constant(of(0.0, 0.0));
    z.how = both(x, y);
    const int rates = z.how == RATE;
    switch (what) {
    case LAW_ADD:
        z.all = ends_add(x->all, y->all);
        z.start = ends_add(x->start, y->start);
        if (rates) z.rate = ends_add(x->rate, y->rate);
        break;
    case LAW_SUB:
        z.all = sub(x->all, y->all);
        z.start = sub(x->start, y->start);
        if (rates) z.rate = sub(x->rate, y->rate);
        break;
    case LAW_MUL: /* f g - f0 g0 = f (g - g0) + (f - f0) g0 */
        z.all = ends_mul(x->all, y->all);
        z.start = ends_mul(x->start, y->start);
        if (rates) z.rate = ends_add(ends_mul(x->all, y->rate), ends_mul(x->rate, y->start));
        break;
    case LAW_DIV:
        z.all = divide(x->all, y->all);
        z.start = divide(x->start, y->start);
        if (rates) z.rate = divide(sub(x->rate, ends_mul(z.start, y->rate)), y->all);
        break;
    case LAW_MINIMUM:
        z.all = of(least(x->all.lo, y->all.lo), least(x->all.hi, y->all.hi));
        z.start = of(least(x->start.lo, y->start.lo), least(x->start.hi, y->start.hi));
        if (rates) z.rate = hull(x->rate, y->rate);
        break;
    default:
        z.all = of(most(x->all.lo, y->all.lo), most(x->all.hi, y->all.hi));
        z.start = of(most(x->start.lo, y->start.lo), most(x->start.hi, y->start.hi));
        if (rates) z.rate = hull(x->rate, y->rate);
    }
    return z;
}

static Slope applied(int what, const Slope *x) {
    Slope z = *x;
    switch (what) {
    case LAW_NEG:
        z.all = minus(x->all);
        z.start = minus(x->start);
        z.rate = minus(x->rate);
        return z;
    case LAW_ABSOLUTE: /* changes no faster than the number itself */
        z.all = magnitude(x->all);
        z.start = magnitude(x->start);
        z.rate = size_rate(x);
        return z;
    case LAW_SIGN: /* no slope where the number can pass zero */
        z.all = direction(x->all);
        z.start = direction(x->start);
        z.how = x->how == CONSTANT_RATE || x->all.lo > 0.0 || x->all.hi < 0.0 ? CONSTANT_RATE : NO_RATE;
        z.rate = of(0.0, 0.0);
        return z;
    case LAW_SQUARE:
        z.all = power(x->all, 2);
        z.start = power(x->start, 2);
        if (x->how == RATE) z.rate = ends_mul(ends_add(x->all, x->start), x->rate);
        return z;
    case LAW_SQRT: /* nor has a root one where it starts from zero */
        if (x->all.lo > 0.0) return by(x, root, divide(of(0.5, 0.5), root(x->all)));
        z.all = root(x->all);
        z.start = root(x->start);
        z.how = x->how == CONSTANT_RATE ? CONSTANT_RATE : NO_RATE;
        z.rate = of(0.0, 0.0);
        return z;
    case LAW_SIN: return by(x, sine, cosine(x->all));
    case LAW_COS: return by(x, cosine, minus(sine(x->all)));
    case LAW_EXP: return by(x, exponential, exponential(x->all));
    default: return by(x, saturation, sub(of(1.0, 1.0), power(saturation(x->all), 2)));
    }
}

/* Every step of a law; whether all have a bound. */
static int play(const StopsetBoundLaw *law, const Slope *signals, Slope *r) {
    for (int i = 0; i < law->length; i++) {
        const int32_t *step = law->steps + 3 * i;
        const int what = step[0];
        if (what == LAW_CONSTANT)
            r[i] = constant(of(law->numbers[2 * step[1]], law->numbers[2 * step[1] + 1]));
        else if (what == LAW_SIGNAL)
            r[i] = signals[step[1]];
        else if (what == LAW_POWER)
            r[i] = raised(r + step[1], step[2]);
        else if (what == LAW_ADD || what == LAW_SUB || what == LAW_MUL || what == LAW_DIV || what == LAW_MINIMUM || what == LAW_MAXIMUM)
            r[i] = arithmetic(what, r + step[1], r + step[2]);
        else
            r[i] = applied(what, r + step[1]);
        if (!(sound(r[i].all) & sound(r[i].start) & sound(r[i].rate))) return 0;
    }
    return 1;
}

/* Where the state of an affine effect can be at speeds up to `fastest`: bisection, as stopset.effects.memory.whole. */
static int remembered(const StopsetActing *law, double fastest, Ends *out) {
    Slope signals[STOPSET_SIGNALS], r[STEPS];
    for (int k = 0; k < STOPSET_SIGNALS; k++) signals[k] = constant(of(0.0, 0.0));
    signals[S_DQ] = constant(of(-fastest, fastest));
    signals[S_DIRECTION] = constant(of(-1.0, 1.0));
    for (int side = 0; side < 2; side++) {
        double near = law->start, beyond = law->range[side];
        for (int k = 0; k < 50; k++) {
            const double middle = 0.5 * (near + beyond);
            signals[S_MEMORY] = constant(of(middle, middle));
            if (!play(&law->flow, signals, r)) return 0;
            const Ends rate = r[law->flow.length - 1].all;
            if (side ? rate.hi <= 0.0 : rate.lo >= 0.0) /* leads back, whatever the speed */
                beyond = middle;
            else
                near = middle;
        }
        if (side)
            out->hi = beyond;
        else
            out->lo = beyond;
    }
    return sound(*out);
}

static Ends pair_of(const double x[2]) { return of(x[0], x[1]); }

/* What the law sees, but for direction, speed and the gear's load. */
static int seen(const StopsetActing *law, const StopsetSight *s, Slope *signals) {
    for (int k = 0; k < STOPSET_SIGNALS; k++) signals[k] = constant(of((double)NAN, (double)NAN)); /* refused where it is looked at */
    signals[S_Q] = constant(pair_of(s->q));
    signals[S_LOAD] = constant(pair_of(s->load));
    signals[S_TEMP] = constant(pair_of(s->temp));
    signals[S_WARM] = constant(of(0.0, 1.0));
    signals[S_STIFF] = constant(pair_of(s->stiff));
    signals[S_INERTIA] = constant(pair_of(s->inertia));
    signals[S_CORIOLIS] = constant(pair_of(s->coriolis));
    signals[S_DQ_OTHER] = constant(of(-s->other, s->other));
    for (int k = 0; k < 2; k++) signals[S_TILT + k] = constant(pair_of(s->tilt[k]));
    for (int k = 0; k < law->states; k++) signals[S_MEMORY + k] = constant(pair_of(law->state + 2 * k));
    if (law->flow.length && s->speed > s->past) { /* `state` is of the fastest speeds seen */
        Ends z = of(0.0, 0.0);
        if (!remembered(law, s->speed, &z)) return 0;
        signals[S_MEMORY] = constant(z);
    }
    return 1;
}

/* torque in a + b |dq|, forward and backward. Each column keeps its slope or is bounded as a whole, whichever is narrower at full speed. */
static int lines(const StopsetActing *law, const StopsetSight *s, Slope *signals, Ends a[2], Ends b[2]) {
    const int pieces = law->role == STOPSET_RUBS ? PIECES : 1;
    const double border[PIECES + 1] = {-s->gear, -1e-9 * s->gear, 1e-9 * s->gear, s->gear};
    Slope r[STEPS], column[2][PIECES][COLUMNS];
    int steady[COLUMNS];
    for (int c = 0; c < law->terms; c++) steady[c] = 1;
    for (int side = 0; side < 2; side++)
        for (int piece = 0; piece < pieces; piece++) {
            const double sign = side ? -1.0 : 1.0;
            signals[S_DQ] = speed(s->speed, sign);
            signals[S_DIRECTION] = constant(of(sign, sign));
            /* which way the gear is loaded cannot be told from gravity while the brakes work: both ways, and no load */
            if (law->role == STOPSET_RUBS) signals[S_LOAD] = constant(of(border[piece], border[piece + 1]));
            if (!play(&law->law, signals, r)) return 0;
            for (int c = 0; c < law->terms; c++) {
                const Slope *x = &column[side][piece][c];
                column[side][piece][c] = r[law->column[c]];
                const Ends value = pair_of(law->value + 2 * c), all = ends_mul(x->all, value), rate = ends_mul(x->rate, value);
                if (x->how == NO_RATE || (x->how == RATE && !((rate.hi - rate.lo) * s->speed <= (all.hi - all.lo) * (1.0 + 1e-9))))
                    steady[c] = 0;
            }
        }
    for (int side = 0; side < 2; side++)
        for (int piece = 0; piece < pieces; piece++) {
            Ends here = {0.0, 0.0}, per = {0.0, 0.0};
            for (int c = 0; c < law->terms; c++) {
                const Slope *x = &column[side][piece][c];
                const Ends value = pair_of(law->value + 2 * c);
                here = ends_add(here, ends_mul(steady[c] ? x->start : x->all, value));
                if (steady[c] && x->how == RATE) per = ends_add(per, ends_mul(x->rate, value));
            }
            a[side] = piece ? hull(a[side], here) : here;
            b[side] = piece ? hull(b[side], per) : per;
        }
    return 1;
}

/* All torque of the law where the joint stands, whatever direction its friction takes. */
static int at_rest(const StopsetActing *law, Slope *signals, Ends *out) {
    Slope r[STEPS];
    signals[S_DQ] = constant(of(0.0, 0.0));
    signals[S_DIRECTION] = constant(of(-1.0, 1.0));
    if (!play(&law->law, signals, r)) return 0;
    *out = of(0.0, 0.0);
    for (int c = 0; c < law->terms; c++) *out = ends_add(*out, ends_mul(pair_of(law->value + 2 * c), r[law->column[c]].all));
    return 1;
}

/* Torques forward and backward as direction * odd + even: what opposes the motion, and what does not. */
static void split(int role, Ends plus, Ends back, Ends *odd, Ends *even) {
    if (role == STOPSET_RUBS) {
        *odd = of(least(plus.lo, -back.hi), most(plus.hi, -back.lo));
        *even = of(0.0, 0.0);
        return;
    }
    const double ahead = 0.5 * (plus.lo + plus.hi), behind = 0.5 * (back.lo + back.hi);
    const double radius = most(most(plus.hi - ahead, ahead - plus.lo), most(back.hi - behind, behind - back.lo));
    const double rubs = 0.5 * (ahead - behind), pushes = 0.5 * (ahead + behind);
    /* what is not known goes to what opposes the motion as long as it then still does: the rest may push */
    const double unsure = least(radius, size_of(rubs)), slack = 4e-16 * (size_of(ahead) + size_of(behind) + radius);
    *odd = of(rubs - (unsure + slack), rubs + (unsure + slack));
    *even = of(pushes - (radius - unsure + slack), pushes + (radius - unsure + slack));
}

static int ends_finite(Ends x) { return (x.lo - x.lo == 0.0) & (x.hi - x.hi == 0.0); }

int stopset_act(const StopsetActing *law, const StopsetSight *s, double *out) {
    Slope signals[STOPSET_SIGNALS];
    Ends a[2], b[2], dry, push, viscous, along, rest;
    if (!seen(law, s, signals) || !lines(law, s, signals, a, b)) return STOPSET_NO_BOUND;
    split(law->role, a[0], a[1], &dry, &push);
    split(law->role, b[0], b[1], &viscous, &along);
    push.lo += least(along.lo, 0.0) * s->speed;
    push.hi += most(along.hi, 0.0) * s->speed;
    if (!law->straight && law->role != STOPSET_RUBS) {
        const double largest = most(dry.hi, 0.0);
        if (!at_rest(law, signals, &rest)) return STOPSET_NO_BOUND;
        push = of(least(push.lo, rest.lo + largest), most(push.hi, rest.hi - largest));
    }
    Ends parts[3] = {dry, viscous, push};
    for (int k = 0; k < 3; k++) {
        if (law->role == STOPSET_ARM_OR_DRIVE) parts[k] = of(least(parts[k].lo, 0.0), most(parts[k].hi, 0.0));
        if (!ends_finite(parts[k])) return STOPSET_NO_BOUND;
        out[2 * k] = parts[k].lo;
        out[2 * k + 1] = parts[k].hi;
    }
    return STOPSET_OK;
}
