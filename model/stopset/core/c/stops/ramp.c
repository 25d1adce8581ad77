/* STOP 1 and STOP 2 as a loop asks for them: a ramp that works, and one that fails.
 *
 * The same as stopset.reach.stops.bounds with `fast`. What is assumed of ramps and failures stands in stopset.reach.stops.ramp and .failed.
 *
 * Source: IEC 61800-5-2 for SS1-t, SS1-r, SS2; stop notes of the project.
 */
#include <string.h>

#include "bound.h"

enum { KNOTS = 60 }; /* of a ramp */
enum { FEW_SLICES = 4, SLICES = 8 }; /* by when a monitored ramp is left: where joint speeds say enough; where the kinetic energy has to help */

static double clip(double x, double lo, double hi) { return x < lo ? lo : x > hi ? hi : x; }

/* Of joint i at t from speed v, [s] of the programmed motion that were run through and what is left of the speed without any pace: latest
 * start and gentlest ramp, or the opposite. */
typedef struct {
    double run, speed;
} Motion;

static Motion curve(const StopsetRamp *r, int i, double v, double t, int slow) {
    const double begin = slow ? r->control_hi[i] : r->control_lo[i], gentle = slow == (r->timed != 0) ? r->value_hi[i] : r->value_lo[i];
    const double lasts = r->timed ? gentle : size_of(v) / gentle;
    const double s = clip((t - begin) / most(lasts, 1e-12), 0.0, 1.0);
    const Motion out = {least(t, begin) + lasts * (s - 0.5 * s * s), v * (1.0 - s)};
    return out;
}

/* [s] Displacement per speed of a motion that gets faster by its pace, or slower until it rests. */
static double moved(double run, double pace) { return 1.0 + pace * run > 0.0 ? run + 0.5 * pace * run * run : -0.5 / least(pace, -1e-12); }

/* Displacements and speeds of joint i at t, tracking errors apart. */
typedef struct {
    double d_lo, d_hi, v_lo, v_hi;
} Reach;

static Reach reach_of(const StopsetRamp *r, int i, const double v[2], double t) {
    Reach out = {STOPS_INF, -STOPS_INF, STOPS_INF, -STOPS_INF};
    double speed[2] = {STOPS_INF, -STOPS_INF}, run[2] = {STOPS_INF, -STOPS_INF}, share[2] = {STOPS_INF, 0.0};
    for (int corner = 0; corner < 4; corner++) {
        const Motion m = curve(r, i, v[corner / 2], t, corner % 2 == 0);
        run[0] = least(run[0], m.run);
        run[1] = most(run[1], m.run);
        speed[0] = least(speed[0], m.speed);
        speed[1] = most(speed[1], m.speed);
        for (int side = 0; side < 2; side++) {
            const double d = v[corner / 2] * moved(m.run, r->pace[side]);
            out.d_lo = least(out.d_lo, d);
            out.d_hi = most(out.d_hi, d);
        }
    }
    /* between a speed one way and one the other way lies one that is no sooner to brake than at rest */
    if (!r->timed && v[0] < 0.0 && v[1] > 0.0) run[0] = least(t, r->control_lo[i]);
    /* what a ramp leaves of a speed and what a pace makes of it: a late ramp with a motion that gets slower has less than any of both ends */
    for (int corner = 0; corner < 4; corner++) {
        const double x = most(1.0 + r->pace[corner / 2] * run[corner % 2], 0.0);
        share[0] = least(share[0], x);
        share[1] = most(share[1], x);
    }
    for (int corner = 0; corner < 4; corner++) {
        const double w = speed[corner / 2] * share[corner % 2];
        out.v_lo = least(out.v_lo, w);
        out.v_hi = most(out.v_hi, w);
    }
    return out;
}

/* KNOTS steps to `end`, and one more at every joint's latest start: a motion that gets faster does so until its ramp begins. */
static int64_t knots_of(const StopsetRamp *r, int n, double end, double *t) {
    int64_t count = KNOTS + 1;
    for (int k = 0; k <= KNOTS; k++) t[k] = k < KNOTS ? k * (end / KNOTS) : end;
    for (int i = 0; i < n; i++) {
        int64_t k = 0;
        while (t[k] < r->control_hi[i]) k++; /* no ramp begins after the end */
        if (t[k] == r->control_hi[i]) continue;
        for (int64_t l = count++; l > k; l--) t[l] = t[l - 1];
        t[k] = r->control_hi[i];
    }
    return count;
}

/* The ramp from all speeds of the box as a tube; returns its largest speeds. */
static void ramp_tube(StopAsk *a, const StopsetRamp *r, double fastest[SN]) {
    StopsetTube *tube = &a->tube;
    const int n = a->stops->plant.arm.n;
    double end = -STOPS_INF, hasty = most(size_of(r->pace[0]), size_of(r->pace[1]));
    for (int i = 0; i < n; i++) {
        const double fast = most(size_of(a->from.dq[i] - a->from.dq_radius[i]), size_of(a->from.dq[i] + a->from.dq_radius[i]));
        end = most(end, r->control_hi[i] + (r->timed ? r->value_hi[i] : fast / r->value_lo[i]));
    }
    a->made = knots_of(r, n, end, tube->t) - 1;
    for (int i = 0; i < n; i++) {
        const double v[2] = {a->from.dq[i] - a->from.dq_radius[i], a->from.dq[i] + a->from.dq_radius[i]}, fast = most(size_of(v[0]), size_of(v[1]));
        const double shortest = r->timed ? r->value_lo[i] : fast / r->value_hi[i];
        /* between knots a speed that bends leaves its chord by an eighth of its second derivative times the step squared */
        const double bend = fast * hasty * 3.0 / most(shortest, 1e-3) * ((end / KNOTS) * (end / KNOTS)) / 8.0;
        fastest[i] = 0.0;
        for (int64_t k = 0; k <= a->made; k++) {
            const int64_t at = k * n + i;
            const Reach here = reach_of(r, i, v, tube->t[k]);
            /* tracking errors exist from the request on; the first knot is exact */
            tube->d_lo[at] = k ? here.d_lo - r->q_error[i] : here.d_lo;
            tube->d_hi[at] = k ? here.d_hi + r->q_error[i] : here.d_hi;
            tube->v_lo[at] = here.v_lo - r->dq_error[i] - bend;
            tube->v_hi[at] = here.v_hi + r->dq_error[i] + bend;
            tube->travel_left[at] = STOPS_INF; /* no brakes' work bounds a ramp */
            fastest[i] = most(fastest[i], most(size_of(tube->v_lo[at]), size_of(tube->v_hi[at])));
        }
        for (int64_t k = 0; k < a->made; k++) {
            tube->energy[k] = STOPS_INF; /* nor does anything take from its energy */
            tube->e_lo[k * n + i] = least(tube->v_lo[k * n + i], tube->v_lo[(k + 1) * n + i]);
            tube->e_hi[k * n + i] = most(tube->v_hi[k * n + i], tube->v_hi[(k + 1) * n + i]);
        }
    }
}

/* Whether the drives have the torque for the ramp from every state of the box, friction at its largest speeds on top. */
static int feasible(const StopAsk *a, const StopsetRamp *r, const StopsetPlant *p, const double fastest[SN]) {
    double asked[SN] = {0}, extra[SN], left[SN];
    for (int i = 0; i < p->arm.n; i++) {
        extra[i] = p->coulomb_hi[i] + p->viscous_hi[i] * fastest[i] + most(size_of(p->u_lo[i]), size_of(p->u_hi[i]));
        left[i] = least(r->limit[i] - extra[i], r->gear[i]);
    }
    int have = stopset_ramp_torque(p, r, &a->from, &a->tube, a->made, left, asked) == STOPSET_OK;
    for (int i = 0; i < p->arm.n; i++) have &= (asked[i] + extra[i] <= r->limit[i]) & (asked[i] <= r->gear[i]);
    return have;
}

int stops_near(const StopsetStops *s, const double *q_lo, const double *q_hi, const double *speed, double friction[6 * SN], StopsetPlant *out) {
    *out = s->plant;
    if (!s->torques) return 1;
    if (stopset_friction_over(&s->plant, s->torques, q_lo, q_hi, speed, friction)) return 0;
    *out = stops_with_friction(&s->plant, friction);
    return 1;
}

int stops_held(const StopsetStops *s, const double *q, const double *radius) {
    const int n = s->plant.arm.n;
    const double still[SN] = {0};
    double g[2][SN], body[2][10 * SN], lo[SN], hi[SN], friction[6 * SN] = {0};
    StopsetPlant plant, *p = &plant;
    Expansion E;
    for (int i = 0; i < n; i++) {
        lo[i] = q[i] - radius[i];
        hi[i] = q[i] + radius[i];
    }
    const int bounded = stops_near(s, lo, hi, still, friction, p);
    for (int side = 0; side < 2; side++) {
        StopsetArm arm = p->arm;
        for (int k = 0; k < 10 * n; k++) body[side][k] = p->arm.pi[k] + (side ? 1.0 : -1.0) * p->pi_half[k];
        arm.pi = body[side];
        stopset_gravity_torques(&arm, 1, q, g[side]);
    }
    stops_expand(&p->arm, p->pi_half, p->rotor, q, &E);
    for (int i = 0; i < n; i++) {
        const double first = least(g[0][i], g[1][i]), last = most(g[0][i], g[1][i]), load = p->curvature.load[i] * (1.0 + 1e-12);
        double near = 0.0, bent = 0.0;
        for (int k = 0; k < n; k++) {
            near += (size_of(E.dg[i * n + k]) + size_of(E.dgp[i * n + k])) * radius[k];
            for (int l = 0; l < n; l++) bent += p->curvature.g[(i * n + k) * n + l] * radius[k] * radius[l];
        }
        const double more = near + 0.5 * bent;
        /* in a wide box slopes say more than what gravity can ask in any pose */
        const double low = least(most(first - more, -load), first) - p->u_hi[i], high = most(least(last + more, load), last) - p->u_lo[i];
        if (!(bounded & (p->brake_lo[i] + p->coulomb_lo[i] - most(size_of(low), size_of(high)) > 0.0))) return 0;
    }
    return 1;
}

int stopset_working_ramp(const StopsetStops *stops, const StopsetRamp *r, int stays, const StopsetStates *from, double *work,
                         const StopsetBound *out) {
    const double *q = from->q, *dq = from->dq, *q_radius = from->q_radius, *dq_radius = from->dq_radius;
    const int n = stops->plant.arm.n;
    if (n < 1 || n > SN) return -STOPSET_TOO_MANY_JOINTS;
    double fastest[SN], end[SN], half[SN], lo[SN], hi[SN], friction[6 * SN], after = 0.0;
    StopsetPlant plant;
    StopAsk a = {stops, *from, 0.0, 0, 0, {0}, 0, 0};
    stops_begin(&a, work, out);
    ramp_tube(&a, r, fastest);
    for (int i = 0; i < n; i++) {
        double up = -STOPS_INF, down = STOPS_INF;
        for (int64_t k = i; k < (a.made + 1) * n; k += n) {
            up = most(up, a.tube.d_hi[k]);
            down = least(down, a.tube.d_lo[k]);
        }
        lo[i] = q[i] - q_radius[i] + down;
        hi[i] = q[i] + q_radius[i] + up;
    }
    if (!stops_near(stops, lo, hi, fastest, friction, &plant)) return 1;
    for (int i = 0; i < n; i++)
        if (!(r->dq_error[i] <= r->band[i])) after = r->settle;
    if (!(after >= 0.0)) return 1;
    for (int i = 0; i < n; i++) {
        const double fast = most(size_of(dq[i] - dq_radius[i]), size_of(dq[i] + dq_radius[i]));
        out->time[i] = r->control_hi[i] + (r->timed ? r->value_hi[i] : fast / r->value_lo[i]) + after;
        /* power is taken before the ramp has brought the arm to rest: it does not stop by the ramp */
        if (!stays && r->off_after >= 0.0 && r->off_after < out->time[i]) return 1;
    }
    if (!feasible(&a, r, &plant, fastest)) return 1;
    if (stays)
        for (int64_t k = n; k < (a.made + 1) * n; k++) {
            a.tube.d_lo[k] -= r->window;
            a.tube.d_hi[k] += r->window;
        }
    else {
        for (int i = 0; i < n; i++) {
            const double first = a.tube.d_lo[a.made * n + i], last = a.tube.d_hi[a.made * n + i];
            end[i] = q[i] + 0.5 * (first + last);
            half[i] = q_radius[i] + 0.5 * (last - first);
        }
        if (!stops_held(stops, q, q_radius) || !stops_held(stops, end, half)) return 1;
    }
    stops_widen(&a, q, q_radius, fastest, out);
    return STOPSET_OK;
}

/* States at power-off: every joint has travelled up to `travel` seconds at the speed of the request, and has up to `share` of it. */
typedef struct {
    double travel, share, time;
} Cell;

/* Of a path time run through at a share of the programmed motion's speed, which grows by its pace. */
static Cell cell_of(const StopsetRamp *r, double path_time, double speed, double time) {
    const double pace = most(0.0, most(r->pace[0], r->pace[1]));
    const Cell out = {path_time * (1.0 + 0.5 * pace * path_time), speed * (1.0 + pace * path_time), time};
    return out;
}

/* All of them but those that lie in the next one, which is later: so does their stop. 0 where nothing says when power is taken. */
static int cells_of(const StopsetRamp *r, int n, const StopsetStates *from, int slices, Cell cell[SLICES + 1]) {
    double lasts = -STOPS_INF, control = -STOPS_INF;
    int count = 0;
    if (!r->monitored) {
        cell[0] = cell_of(r, r->share * r->off_after, r->share, r->off_after);
        return r->off_after >= 0.0;
    }
    for (int i = 0; i < n; i++) {
        lasts = most(lasts, r->timed ? r->value_hi[i] : (size_of(from->dq[i]) + from->dq_radius[i]) / r->value_lo[i]);
        control = most(control, r->control_hi[i]);
    }
    for (int k = 0; k <= slices; k++) { /* left in slice k, until whose start the speed was below the line */
        const double line = least(r->share, 1.0 - (k > 1 ? k - 1 : 0) / (double)slices + r->tolerance), s = k / (double)slices;
        const double path_time = control * least(r->share, 1.0 + r->tolerance) + lasts * (s - 0.5 * s * s + r->tolerance * s);
        /* without drives that accelerate the speed stays below the line while power is being taken */
        const double speed = r->share <= 1.0 ? line : r->share;
        const Cell one = cell_of(r, path_time + r->reaction * speed, speed, control + lasts * s + r->reaction);
        if (count && cell[count - 1].share <= one.share) count--; /* later, no joint has travelled less */
        cell[count++] = one;
    }
    return count;
}

/* One cell's stop, from the box of the request; whether it comes to rest. */
static int fall(StopAsk *a, const StopsetRamp *r, const Cell *cell, const StopsetStates *request, int energetic, const StopsetBound *out) {
    const double *q = request->q, *dq = request->dq, *q_radius = request->q_radius, *dq_radius = request->dq_radius;
    const int n = a->stops->plant.arm.n;
    double box[4][SN], lo[SN], hi[SN], speed[SN], fastest[SN];
    Region region;
    for (int i = 0; i < n; i++) {
        const double moved = cell->travel * dq[i], v = cell->share * dq[i], off = cell->travel * dq_radius[i], unsure = cell->share * dq_radius[i];
        lo[i] = least(0.0, moved) - off - r->q_error[i];
        hi[i] = most(0.0, moved) + off + r->q_error[i];
        const double v_lo = least(0.0, v) - unsure - r->dq_error[i] + r->residual_lo[i];
        const double v_hi = most(0.0, v) + unsure + r->dq_error[i] + r->residual_hi[i];
        box[0][i] = q[i] + 0.5 * (lo[i] + hi[i]);
        box[1][i] = 0.5 * (v_lo + v_hi);
        box[2][i] = 0.5 * (hi[i] - lo[i]) + q_radius[i];
        box[3][i] = 0.5 * (v_hi - v_lo);
        speed[i] = size_of(box[1][i]) + box[3][i];
    }
    a->from = (StopsetStates){box[0], box[1], box[2], box[3]};
    a->lasts = stopset_expected_stop(&a->stops->plant, a->from.q, speed);
    stops_guess(a, &region);
    if (!stops_march(a, a->stops->plant.delay_lo, a->stops->plant.delay_hi, energetic, &region, fastest)) return 0;
    for (int i = 0; i < n; i++) {
        out->time[i] = most(out->time[i], cell->time + stops_rests_after(a, i));
        for (int64_t k = i; k < (a->made + 1) * n; k += n) { /* since the request */
            a->tube.d_lo[k] += lo[i];
            a->tube.d_hi[k] += hi[i];
        }
    }
    stops_widen(a, q, q_radius, fastest, out);
    return 1;
}

/* All cells' stops, as in stopset.reach.stops.failed with the budget of a loop; whether every one comes to rest. */
static int falls(const StopsetStops *stops, const StopsetRamp *r, const StopsetStates *from, int energetic, double *work, const StopsetBound *out) {
    Cell cell[SLICES + 1];
    StopAsk a = {stops, *from, 0.0, 0, 0, {0}, 0, 0};
    const int count = cells_of(r, stops->plant.arm.n, from, energetic ? SLICES : FEW_SLICES, cell);
    stops_begin(&a, work, out);
    for (int k = 0; k < count; k++)
        if (!fall(&a, r, cell + k, from, energetic, out)) return 0;
    return count > 0;
}

int stopset_failed_ramp(const StopsetStops *stops, const StopsetRamp *r, const StopsetStates *from, double *work, const StopsetBound *out) {
    const int n = stops->plant.arm.n;
    if (n < 1 || n > SN) return -STOPSET_TOO_MANY_JOINTS;
    return falls(stops, r, from, 0, work, out) || falls(stops, r, from, 1, work, out) ? STOPSET_OK : 1;
}
