/* One power-off stop from a box of states, as a loop asks for it: the brakes' windows, a tube of each, the tool's travel.
 *
 * Source: the same as stopset.reach.stops.bounds with `fast`. The windows of the brakes' common delay are told in stopset.reach.stops.windows, the
 * region in which effects are evaluated in stopset.reach.stops.tubes.
 */
#include <string.h>

#include "bound.h"

enum { KNOTS = STOPSET_STOP_KNOTS, ENERGY_KNOTS = STOPSET_STOP_ENERGY_KNOTS, WINDOWS = STOPSET_STOP_WINDOWS };
enum { CLOSING = STOPSET_STOP_CLOSING, ENERGY_CLOSING = STOPSET_STOP_ENERGY_CLOSING };
enum { ALIKE_KNOTS = STOPSET_STOP_ALIKE_KNOTS, ALIKE_CLOSING = STOPSET_STOP_ALIKE_CLOSING };
enum { PATIENCE = STOPSET_STOP_PATIENCE, MORE_PATIENCE = STOPSET_STOP_MORE_PATIENCE, SLICES = STOPSET_STOP_SLICES };
enum { REGIONS = 5, COARSE = 4 }; /* that a tube is tried in; times fewer knots of the tube that finds one */
enum { LONG = KNOTS * PATIENCE + CLOSING, LONG_ENERGY = ALIKE_KNOTS * MORE_PATIENCE + ALIKE_CLOSING, STEPS = LONG > LONG_ENERGY ? LONG : LONG_ENERGY };
static const double BLURRED = 0.5, HAIR = 1e-9; /* [rad/s] by which a band is wider than the fastest joint was; [rad] of a way, at least */
static const double WIDTH = 5e-3, TINY = 1e-12; /* [s] of a window, at least; by which an interval is not empty for rounding alone, or wider than it */

int64_t stopset_stop_room(int n) { return (STEPS + 1) * (1 + 4 * n) + STEPS * 6 * n + n + (STEPS + 1) * (1 + n) + STEPS + SLICES * (9 * n + 6 * n + 10) + 1; }

/* The next `count` numbers of the work space. */
static double *take(double **room, int64_t count) {
    double *out = *room;
    *room += count;
    return out;
}

double stopset_expected_stop(const StopsetPlant *p, const double *q, const double *speed) {
    const int n = p->arm.n;
    double g[SN], engaged = -STOPS_INF, longest = -STOPS_INF;
    stopset_gravity_torques(&p->arm, 1, q, g);
    for (int i = 0; i < n; i++) {
        const double M = p->rotor[i] + most(1e-3, size_of(p->arm.pi[10 * i]) * 0.1);
        const double authority = most(p->brake_lo[i] + p->coulomb_lo[i] - size_of(g[i]), 0.2 * p->brake_lo[i] + 1e-6);
        engaged = most(engaged, p->delay_hi[i] + p->rise_hi[i]);
        longest = most(longest, speed[i] * M / authority);
    }
    return engaged + least(0.5, longest);
}

/* Delays between `early` and `late` plus each joint's own, no joint without any: see `windows`. */
static void window(const StopsetStops *s, double early, double late, double lo[SN], double hi[SN]) {
    for (int i = 0; i < s->plant.arm.n; i++) {
        const double own = s->lag ? s->lag[i] : 0.0;
        lo[i] = most(s->plant.delay_lo[i], early + own);
        hi[i] = most(least(s->plant.delay_hi[i], late + own), lo[i]); /* but for rounding these are in order */
    }
}

/* Delays (n,) of every window of the common delay, all of them where delays are independent or no such stop fits; returns how many.
 * The common delay is at most every joint's largest and at least every joint's least less `delay_spread`, so all have delays in a window. */
static int windows(const StopsetStops *s, double lo[WINDOWS][SN], double hi[WINDOWS][SN]) {
    const StopsetPlant *p = &s->plant;
    const int n = p->arm.n;
    double first = STOPS_INF, latest = -STOPS_INF, soonest = STOPS_INF, last = -STOPS_INF;
    for (int i = 0; i < n; i++) {
        const double own = s->lag ? s->lag[i] : 0.0, a = p->delay_lo[i] - own, b = p->delay_hi[i] - own;
        first = least(first, a);
        latest = most(latest, a);
        soonest = least(soonest, b);
        last = most(last, b);
    }
    const double delay_spread = s->delay_spread, begin = most(first, latest - delay_spread), end = least(soonest, most(last - delay_spread, begin));
    if (!(delay_spread >= 0.0) || end < begin - TINY) {
        memcpy(lo[0], p->delay_lo, (size_t)n * sizeof(double));
        memcpy(hi[0], p->delay_hi, (size_t)n * sizeof(double));
        return 1;
    }
    const double room = end - begin > TINY ? end - begin : 0.0;
    const int count = room / most(WIDTH, 0.5 * delay_spread) > 1.0 ? WINDOWS : 1; /* WINDOWS is two */
    for (int k = 0; k < count; k++) window(s, k * (room / count) + begin, (k + 1 < count ? (k + 1) * (room / count) + begin : end) + delay_spread, lo[k], hi[k]);
    return count;
}

/* Largest speed of each joint of the tube, and how far it gets. */
static void extent(const StopAsk *a, double fastest[SN], double moved[SN]) {
    const StopsetTube *t = &a->tube;
    const int n = a->stops->plant.arm.n;
    for (int i = 0; i < n; i++) {
        double up = -STOPS_INF, down = STOPS_INF;
        fastest[i] = 0.0;
        for (int64_t k = 0; k <= a->made; k++) {
            const int64_t at = k * n + i;
            double fast = most(size_of(t->v_lo[at]), size_of(t->v_hi[at]));
            if (k < a->made) fast = most(fast, most(size_of(t->e_lo[at]), size_of(t->e_hi[at])));
            fastest[i] = most(fastest[i], fast);
            up = most(up, t->d_hi[at]);
            down = least(down, t->d_lo[at]);
        }
        moved[i] = most(up, -down);
    }
}

StopsetPlant stops_with_friction(const StopsetPlant *plant, const double *friction) {
    const int n = plant->arm.n;
    StopsetPlant out = *plant;
    out.coulomb_lo = friction;
    out.coulomb_hi = friction + n;
    out.viscous_lo = friction + 2 * n;
    out.viscous_hi = friction + 3 * n;
    out.u_lo = friction + 4 * n;
    out.u_hi = friction + 5 * n;
    return out;
}

void stops_guess(const StopAsk *a, Region *region) {
    const StopsetTorques *torques = a->stops->torques;
    region->known = region->asked = 0;
    for (int i = 0; torques && i < a->stops->plant.arm.n; i++) {
        const double fast = size_of(a->from.dq[i]) + a->from.dq_radius[i], speed = 1.05 * fast + 0.05, limit = torques->speed[i];
        region->travel[i] = 1.1 * a->lasts * fast + 0.01;
        region->speed[i] = fast < limit ? least(speed, limit) : speed;
    }
}

/* What the effects give in the region; whether they have a bound there. */
static int asked(const StopAsk *a, Region *region) {
    const StopsetStops *s = a->stops;
    double lo[SN], hi[SN];
    if (region->asked) return 1;
    for (int i = 0; i < s->plant.arm.n; i++) {
        lo[i] = a->from.q[i] - a->from.q_radius[i] - region->travel[i];
        hi[i] = a->from.q[i] + a->from.q_radius[i] + region->travel[i];
    }
    region->asked = stopset_friction_over(&s->plant, s->torques, lo, hi, region->speed, region->friction) == STOPSET_OK;
    return region->asked;
}

/* Whether what is `moved` and `fastest` stays inside. */
static int inside(const Region *region, int n, const double moved[SN], const double fastest[SN]) {
    int within = 1;
    for (int i = 0; i < n; i++) within = within && moved[i] < region->travel[i] && fastest[i] < region->speed[i];
    return within;
}

/* Whether the tube stays inside; if not the region is now a larger one, in which it stays where the effects give the same there:
 * then it is that region's tube too. */
static int holds(const StopAsk *a, Region *region, double fastest[SN]) {
    const int n = a->stops->plant.arm.n;
    double moved[SN], before[6 * SN];
    extent(a, fastest, moved);
    if (inside(region, n, moved, fastest)) return 1;
    for (int i = 0; i < n; i++) {
        region->travel[i] = most(region->travel[i], 1.3 * moved[i]);
        region->speed[i] = most(region->speed[i], 1.1 * fastest[i]);
    }
    memcpy(before, region->friction, (size_t)(6 * n) * sizeof *before);
    region->known = 1;
    region->asked = 0;
    const int bounded = asked(a, region), same = !memcmp(before, region->friction, (size_t)(6 * n) * sizeof *before);
    return bounded & same & inside(region, n, moved, fastest);
}

/* Whether laws look at most joints, as they do by the rigid body: then the guess mostly has to be mended. */
static int far_seeing(const StopsetTorques *torques, int n) {
    int seen[SN] = {0}, count = 0;
    for (int k = 0; k < torques->laws; k++) seen[torques->law[k].joint] |= torques->law[k].roams;
    for (int i = 0; i < n; i++) count += seen[i];
    return torques->needs || 2 * count > n;
}

/* A continuous motion that stays inside a region while it has not left cannot leave. */
int stops_march(StopAsk *a, const double *delay_lo, const double *delay_hi, int energetic, Region *region, double fastest[SN]) {
    const StopsetStops *s = a->stops;
    const int n = s->plant.arm.n, patience = energetic ? MORE_PATIENCE : PATIENCE;
    const int knots = !energetic ? KNOTS : a->fine ? ALIKE_KNOTS : ENERGY_KNOTS, closing = !energetic ? CLOSING : a->fine ? ALIKE_CLOSING : ENERGY_CLOSING;
    double q_lo[SN], q_hi[SN], v_lo[SN], v_hi[SN], moved[SN], first = STOPS_INF, last = -STOPS_INF;
    for (int i = 0; i < n; i++) {
        first = least(first, delay_lo[i]);
        last = most(last, delay_hi[i] + s->plant.rise_hi[i]);
        q_lo[i] = a->from.q[i] - a->from.q_radius[i];
        q_hi[i] = a->from.q[i] + a->from.q_radius[i];
        v_lo[i] = a->from.dq[i] - a->from.dq_radius[i];
        v_hi[i] = a->from.dq[i] + a->from.dq_radius[i];
    }
    const StopsetBox box = {0, q_lo, q_hi, v_lo, v_hi};
    for (int k = 0; k < REGIONS; k++) {
        const int coarse = s->torques && !region->known && far_seeing(s->torques, n), steps = coarse ? knots / COARSE : knots, brief = coarse ? closing / COARSE : closing;
        if (s->torques && !asked(a, region)) return 0;
        StopsetPlant plant = s->torques ? stops_with_friction(&s->plant, region->friction) : s->plant;
        plant.delay_lo = delay_lo;
        plant.delay_hi = delay_hi;
        const StopsetStride stride = {a->lasts / steps, (last - first) / brief, steps * patience + brief, energetic};
        const int end = stopset_stop_tube(&plant, &box, &stride, &stops_whole, &a->tube, &a->made);
        if (!s->torques) {
            extent(a, fastest, moved);
            return end == 0;
        }
        if (end && !coarse) return 0;
        if (end)
            region->known = 1; /* no more is found with so few steps */
        else if (holds(a, region, fastest)) {
            if (!coarse) return 1;
            region->known = 1;
        }
    }
    return 0;
}

double stops_rests_after(const StopAsk *a, int i) {
    const StopsetTube *t = &a->tube;
    const int n = a->stops->plant.arm.n;
    int64_t last = -1;
    for (int64_t k = 0; k <= a->made; k++) {
        const int64_t at = k * n + i;
        /* the momenta may show that a joint rests at a knot, having moved since the one before */
        if (t->v_lo[at] != 0.0 || t->v_hi[at] != 0.0 || (k < a->made && (t->e_lo[at] != 0.0 || t->e_hi[at] != 0.0))) last = k;
    }
    return t->t[last + 1 < a->made ? last + 1 : a->made];
}

/* How far the tool gets from where it was [m], and how fast it is [m/s]. */
static void tool_motion(const StopAsk *a, const double *q, const double *q_radius, double *far, double *fast) {
    const StopsetArm *arm = &a->stops->plant.arm;
    const int n = arm->n, m = 3 * (n + 1);
    const StopsetPoint tool = {n - 1, a->stops->tool, stopset_swiftness(&a->stops->plant, n - 1, a->stops->tool)};
    double *room = a->cut, border[SLICES + 1], box[6];
    StopsetSlices cut = {.count = SLICES, .border = border};
    StopsetPointSets sets;
    double **const lines[] = {&cut.d_lo, &cut.d_hi, &cut.v_lo, &cut.v_hi, &cut.near_lo, &cut.near_hi, &cut.left, &cut.begin_lo, &cut.begin_hi};
    for (int k = 0; k < 9; k++) *lines[k] = take(&room, SLICES * n);
    cut.energy = take(&room, SLICES);
    cut.path = take(&room, SLICES);
    sets.travel = take(&room, SLICES * m);
    sets.pace = take(&room, SLICES * m);
    sets.travel_ball = take(&room, SLICES);
    sets.pace_ball = take(&room, SLICES);
    stopset_slices(&a->tube, a->made, n, a->lines, &cut);
    stopset_point_sets(arm, q, q_radius, &cut, &tool, &sets);
    stopset_point_motion(arm, &tool, cut.count, &sets, far, fast, box);
}

void stops_widen(const StopAsk *a, const double *q, const double *q_radius, const double fastest[SN], const StopsetBound *out) {
    const StopsetTube *t = &a->tube;
    const int n = a->stops->plant.arm.n;
    double far, fast;
    for (int i = 0; i < n; i++) {
        out->speed[i] = most(out->speed[i], fastest[i]);
        for (int64_t k = 0; k <= a->made; k++) {
            out->forward[i] = most(out->forward[i], t->d_hi[k * n + i]);
            out->back[i] = most(out->back[i], -t->d_lo[k * n + i]);
        }
    }
    tool_motion(a, q, q_radius, &far, &fast);
    out->tool[0] = most(out->tool[0], far);
    out->tool[1] = most(out->tool[1], fast);
}

void stops_begin(StopAsk *a, double *work, const StopsetBound *out) {
    const int n = a->stops->plant.arm.n;
    const int64_t knots = (int64_t)(STEPS + 1) * n, lines = (int64_t)STEPS * n;
    double *room = work;
    double **const parts[] = {&a->tube.d_lo, &a->tube.d_hi, &a->tube.v_lo, &a->tube.v_hi};
    a->tube.t = take(&room, STEPS + 1);
    for (int k = 0; k < 4; k++) *parts[k] = take(&room, knots);
    a->tube.e_lo = take(&room, lines);
    a->tube.e_hi = take(&room, lines);
    for (int k = 0; k < 4; k++) a->tube.rates[k] = take(&room, lines);
    a->tube.margin = take(&room, n);
    a->tube.travel_left = take(&room, knots);
    a->tube.energy = take(&room, STEPS);
    a->lines = take(&room, STEPS + 1);
    a->cut = room;
    for (int i = 0; i < n; i++) out->time[i] = out->forward[i] = out->back[i] = out->speed[i] = 0.0;
    out->tool[0] = out->tool[1] = 0.0;
}

enum { NOWHERE, BY_SPEEDS, BY_ENERGY }; /* what bounds a stop */

/* Whether bands of speeds have fed on each other, though they closed: there the energy often knows more. */
static int blurred(const StopAsk *a) {
    const StopsetTube *t = &a->tube;
    const int64_t n = a->stops->plant.arm.n;
    double fastest = 0.0, widest = 0.0;
    for (int64_t k = 0; k < n; k++) fastest = most(fastest, most(size_of(t->v_lo[k]), size_of(t->v_hi[k])));
    for (int64_t k = 0; k < n * (a->made + 1); k++) widest = most(widest, t->v_hi[k] - t->v_lo[k]);
    return widest > fastest + BLURRED;
}

/* Tubes of one window of delays, the nearer proof where bands are blurred: as `nearer` of stopset.reach.stops.split. */
static int window_rests(StopAsk *a, const double *lo, const double *hi, Region region[2], double fastest[SN]) {
    const int n = a->stops->plant.arm.n;
    double speeds[SN], energy[SN], any[SN], share = 0.0;
    if (!stops_march(a, lo, hi, 0, region, fastest)) return stops_march(a, lo, hi, 1, region + 1, fastest) ? BY_ENERGY : NOWHERE;
    if (!blurred(a)) return BY_SPEEDS;
    extent(a, any, speeds);
    const int ends = stops_march(a, lo, hi, 1, region + 1, fastest);
    extent(a, any, energy);
    for (int i = 0; i < n; i++) share += most(energy[i], HAIR) / most(speeds[i], HAIR);
    if (ends & (share < n)) return BY_ENERGY;
    /* the tube of speeds once more, in the region that held it: there is room for one */
    return stops_march(a, lo, hi, 0, region, fastest) * BY_SPEEDS;
}

/* Tubes of all windows of the brakes' delay, and what shows that they come to rest. */
static int rests(const StopsetStops *stops, const StopsetStates *from, double *work, const StopsetBound *out) {
    const int n = stops->plant.arm.n;
    int by = BY_SPEEDS;
    double speed[SN], fastest[SN], lo[WINDOWS][SN], hi[WINDOWS][SN];
    Region region[2];
    StopAsk a = {stops, *from, 0.0, 0, 0, {0}, 0, stops->ranged != STOPSET_SOME_PAYLOADS};
    stops_begin(&a, work, out);
    for (int i = 0; i < n; i++) speed[i] = size_of(from->dq[i]) + from->dq_radius[i];
    a.lasts = stopset_expected_stop(&stops->plant, from->q, speed);
    for (int k = 0; k < 2; k++) stops_guess(&a, region + k); /* the kinetic energy's tubes lead farther */
    /* the latest brakes are the hardest: what cannot be proved is known at once */
    for (int k = windows(stops, lo, hi) - 1; k >= 0; k--) {
        const int one = window_rests(&a, lo[k], hi[k], region, fastest);
        if (one == NOWHERE) return NOWHERE;
        if (one == BY_ENERGY) by = BY_ENERGY;
        for (int i = 0; i < n; i++) out->time[i] = most(out->time[i], stops_rests_after(&a, i));
        stops_widen(&a, from->q, from->q_radius, fastest, out);
    }
    return by;
}

static const double ALIKE = 0.025; /* share of the largest payload by which others are less */

int stopset_payloads(double lo, double hi) {
    if (!(lo < hi)) return STOPSET_ONE_PAYLOAD;
    return hi - lo <= ALIKE * hi ? STOPSET_ALIKE_PAYLOADS : STOPSET_SOME_PAYLOADS;
}

static const double LIGHTER = 2.0 / 3.0; /* of a range is its lighter part: of 1/3, 1/2, 2/3 what bounds a UR10e-like arm most tightly */

void stopset_payload_part(const StopsetPlant *plant, int part, double *pi, double *half) {
    const double middle = part ? LIGHTER - 1.0 : LIGHTER, share = (part ? LIGHTER : 1.0 - LIGHTER) + TINY; /* so much that rounding leaves nothing between them */
    for (int k = 0; k < 10 * plant->arm.n; k++) {
        pi[k] = plant->arm.pi[k] + middle * plant->pi_half[k];
        half[k] = share * plant->pi_half[k];
    }
}

static int part_rests(const StopsetStops *stops, int part, const StopsetStates *from, double *work, const StopsetBound *out) {
    StopsetStops some = *stops;
    double pi[10 * SN], half[10 * SN];
    stopset_payload_part(&stops->plant, part, pi, half);
    some.plant.arm.pi = pi;
    some.plant.pi_half = half;
    return rests(&some, from, work, out);
}

/* The worse of two bounds, into the first. */
static void worse(int n, const StopsetBound *a, const StopsetBound *b) {
    double *const into[] = {a->time, a->forward, a->back, a->speed, a->tool}, *const of[] = {b->time, b->forward, b->back, b->speed, b->tool};
    for (int x = 0; x < 5; x++)
        for (int i = 0; i < (x < 4 ? n : 2); i++) into[x][i] = most(into[x][i], of[x][i]);
}

int stopset_power_off(const StopsetStops *stops, const StopsetStates *from, double *work, const StopsetBound *out) {
    const int n = stops->plant.arm.n;
    if (n < 1 || n > SN) return -STOPSET_TOO_MANY_JOINTS;
    const int by = rests(stops, from, work, out);
    if (by == BY_SPEEDS || stops->ranged == STOPSET_ONE_PAYLOAD || (by == BY_ENERGY && stops->ranged == STOPSET_ALIKE_PAYLOADS)) return by == NOWHERE;
    /* The kinetic energy bounds the heaviest and the lightest arm at once, several times too far for each. A payload is one mass throughout a stop,
     * so it lies in one of the parts, and the worse of their bounds holds, too: taken where the tool gets less far. */
    const double far = by == NOWHERE ? STOPS_INF : out->tool[0];
    double room[2][4][SN], tool[2][2];
    const StopsetBound part[2] = {{room[0][0], room[0][1], room[0][2], room[0][3], tool[0]}, {room[1][0], room[1][1], room[1][2], room[1][3], tool[1]}};
    for (int k = 0; k < 2; k++)
        if (!part_rests(stops, k, from, work, part + k) || tool[k][0] >= far) return by == NOWHERE;
    stops_begin(&(StopAsk){stops, *from, 0.0, 0, 0, {0}, 0, 0}, work, out);
    for (int k = 0; k < 2; k++) worse(n, out, part + k);
    return STOPSET_OK;
}
