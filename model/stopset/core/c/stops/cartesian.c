/* From joint tubes to space: how far a point of the arm can get, how fast, and what a link can sweep.
 *
 * For a point p of link l, d2 p/dq_i dq_k = z_a x (z_b x (p - o_b)) with b = max(i, k): its length is at most R_b, the largest
 * distance of p from axis b. So around the middle c of a box of joint displacements
 *     p(q0 + d) - p(q0)  in  p(q + c) - p(q) + J(q + c) [-r, r] + ball(curved part),
 * and the largest length over the box of the linear part sits at a corner.
 *
 * No body has more energy than the arm: a point is no faster than its swiftness times sqrt(v' M v), which adds up to its way (Lemma 14 of
 * docs/stops.md).
 *
 * Source: Featherstone (2008) for the frames; stopset.reach.stops.cartesian.
 */
#include <math.h>
#include <string.h>

#include "../vectors.h"
#include "stops.h"

typedef struct {
    double p[3], J[3 * SN], distance[SN]; /* of a point, its Jacobian, its distance from each axis; zero for joints beyond */
} Point;

static void locate(const StopsetArm *arm, const double *q, int link, const double *point, Point *out) {
    const int n = arm->n;
    stopset_point(arm, q, link, point, out->p, out->J);
    for (int i = 0; i < n; i++) {
        const double column[3] = {out->J[i], out->J[n + i], out->J[2 * n + i]};
        out->distance[i] = sqrt(dot(column, column));
    }
}

/* Largest distance of a point from each axis while the angles stay within `radius`: tip to base, it moves by the joints beyond; and it is
 * never farther than the links beyond are long. */
static void reach_of(const StopsetArm *arm, const double *distance, const double *radius, int link, const double *point, double *out) {
    double beyond = 0.0, arm_length = sqrt(dot(point, point));
    memset(out, 0, (size_t)arm->n * sizeof *out);
    for (int i = link; i >= 0; i--) {
        out[i] = least(distance[i] + beyond, arm_length * (1.0 + 1e-12));
        beyond += out[i] * radius[i];
        arm_length += sqrt(dot(arm->p + 3 * i, arm->p + 3 * i));
    }
}

static double curved(const double *reach, const double *r, const double *s, int link) {
    double total = 0.0;
    for (int i = 0; i <= link; i++)
        for (int k = 0; k <= link; k++) total += reach[i > k ? i : k] * r[i] * s[k];
    return total;
}

/* Largest length of start + G [-1, 1], columns of G (3, stride) times radius: at a corner, since a length is convex. */
static double longest(const double *start, const double *G, int stride, const double *radius, int link) {
    double p[3] = {start[0], start[1], start[2]}, sign[SN], best;
    for (int i = 0; i <= link; i++) {
        sign[i] = 1.0;
        for (int r = 0; r < 3; r++) p[r] += G[r * stride + i] * radius[i];
    }
    best = dot(p, p);
    for (int64_t corner = 1; corner < (int64_t)1 << (link + 1); corner++) { /* Gray code */
        int i = 0;
        while (!((corner >> i) & 1)) i++;
        sign[i] = -sign[i];
        for (int r = 0; r < 3; r++) p[r] += 2.0 * sign[i] * radius[i] * G[r * stride + i];
        best = most(best, dot(p, p));
    }
    return sqrt(best);
}

/* A point whose displacements are asked for; or, in place of it, the origin of a joint before it, about which the point stays in a ball. */
typedef struct {
    const StopsetArm *arm;
    const double *q, *q_radius, *point;
    int link;
    Point start;
    double from[3], about; /* from that origin to the point at angles q, the ball's radius and what `from` may be off by; 0 of the point itself */
} Asked;

/* The point at the middle of a box, half the box's widths, and how far it is from every axis anywhere in it. */
typedef struct {
    Point here;
    double wide[SN], reach[SN];
} Middle;

/* A set of displacements (3, n + 1): centre, generators, the ball's radius, and the longest of them. */
typedef struct {
    double travel[3 * (SN + 1)], ball, span;
} Displaced;

static double span_of(const double *travel, int m, int link, double ball) {
    double one[SN];
    const double from[3] = {travel[0], travel[m], travel[2 * m]};
    for (int i = 0; i <= link; i++) one[i] = 1.0;
    return longest(from, travel + 1, m, one, link) + ball;
}

/* Displacements for joints in [d_lo, d_hi], and on from there while sum_i of travel / left_i <= 1 (left 0: not at all): the point moves by
 * no more than max_i reach_i left_i. Kept in `shortest` where none so far is, `gone` [m] less. */
static void displaced(const Asked *a, const double *d_lo, const double *d_hi, const double *left, double gone, Middle *middle, Displaced *shortest) {
    const int n = a->arm->n, m = n + 1;
    double *wide = middle->wide, *reach = middle->reach;
    Point *here = &middle->here;
    double c[SN], r[SN], far[SN], at[SN], farther = 0.0;
    Displaced d = {{0}, 0, 0};
    for (int i = 0; i < n; i++) {
        c[i] = 0.5 * (d_lo[i] + d_hi[i]);
        r[i] = 0.5 * (d_hi[i] - d_lo[i]);
        wide[i] = r[i] + a->q_radius[i];
        far[i] = wide[i] + size_of(c[i]) + (left ? left[i] : 0.0); /* also on the way from q to q + c */
        at[i] = a->q[i] + c[i];
    }
    locate(a->arm, at, a->link, a->point, here);
    reach_of(a->arm, here->distance, far, a->link, a->point, reach);
    d.ball = 0.5 * curved(reach, wide, wide, a->link) + 0.5 * curved(reach, a->q_radius, a->q_radius, a->link);
    for (int x = 0; x < 3; x++) d.travel[x * m] = here->p[x] - a->start.p[x] - a->from[x];
    for (int i = 0; i <= a->link; i++) {
        const double *J = here->J, *S = a->start.J, change[3] = {J[i] - S[i], J[n + i] - S[n + i], J[2 * n + i] - S[2 * n + i]};
        d.ball += a->q_radius[i] * sqrt(dot(change, change));
        for (int x = 0; x < 3; x++) d.travel[x * m + i + 1] = J[x * n + i] * r[i];
        if (left) farther = most(farther, reach[i] * left[i]);
    }
    d.ball += farther * (1.0 + 1e-12) + a->about - gone;
    d.span = span_of(d.travel, m, a->link, d.ball);
    if (d.span < shortest->span) *shortest = d;
}

/* The point itself in asked[0], the origins of the joints behind the first in those after it. Returns how many. */
static int pivots(const StopsetArm *arm, const double *q, const double *q_radius, const StopsetPoint *point, Asked *asked) {
    const int link = point->link;
    double length = sqrt(dot(point->at, point->at)), off = 0.0;
    for (int i = 0; i <= link; i++) off += q_radius[i];
    for (int k = link; k >= 0; k--) { /* tip to base */
        Asked *a = &asked[k];
        *a = (Asked){.arm = arm, .q = q, .q_radius = q_radius, .point = k ? arm->p + 3 * k : point->at, .link = k ? k - 1 : link};
        locate(arm, q, a->link, a->point, &a->start);
        if (!k) continue;
        a->about = length * (1.0 + off) * (1.0 + 1e-12);
        length += sqrt(dot(a->point, a->point));
    }
    for (int k = 1; k <= link; k++)
        for (int x = 0; x < 3; x++) asked[k].from[x] = asked[0].start.p[x] - asked[k].start.p[x];
    return link + 1;
}

int stopset_point_sets(const StopsetArm *arm, const double *q, const double *q_radius, const StopsetSlices *slices, const StopsetPoint *point,
                       const StopsetPointSets *out) {
    const int n = arm->n, m = n + 1, link = point->link;
    double *travel = out->travel, *pace = out->pace, fast[SN];
    Asked asked[SN];
    Middle middle, other;
    Displaced before, flown; /* what is left from a box that the joints were in before holds on; how far the energy takes it from one */
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    const int count = pivots(arm, q, q_radius, point, asked);
    before.span = flown.span = STOPS_INF;
    memset(pace, 0, (size_t)(slices->count * 3 * m) * sizeof *pace);
    for (int64_t s = 0; s < slices->count; s++, travel += 3 * m, pace += 3 * m) {
        const int64_t at = s * n;
        const int braked = slices->left && slices->left[at] < STOPS_INF, paid = point->swiftness > 0.0 && slices->path && slices->path[s] < STOPS_INF;
        const double gone = paid && s ? point->swiftness * slices->path[s - 1] : 0.0;
        Displaced now;
        now.span = STOPS_INF;
        /* joints that go far bend the way that a slope tells too much for it to tell anything: there a ball about an origin before them does */
        for (int k = 0; k < count; k++) {
            if (asked[k].about < now.span) displaced(&asked[k], slices->d_lo + at, slices->d_hi + at, 0, 0.0, k ? &other : &middle, &now);
            if (braked && asked[k].about < before.span)
                displaced(&asked[k], slices->near_lo + at, slices->near_hi + at, slices->left + at, 0.0, &other, &before);
            if (paid && asked[k].about - gone < flown.span)
                displaced(&asked[k], slices->begin_lo + at, slices->begin_hi + at, 0, gone, &other, &flown);
        }
        for (int i = 0; i <= link; i++) {
            const double lo = slices->v_lo[at + i], hi = slices->v_hi[at + i], vc = 0.5 * (lo + hi), vr = 0.5 * (hi - lo);
            fast[i] = size_of(vc) + vr;
            for (int x = 0; x < 3; x++) {
                pace[x * m + i + 1] = middle.here.J[x * n + i] * vr;
                pace[x * m] += middle.here.J[x * n + i] * vc;
            }
        }
        out->pace_ball[s] = curved(middle.reach, middle.wide, fast, link);
        if (before.span < now.span) now = before;
        if (paid) {
            const double travel_since = point->swiftness * slices->path[s] * (1.0 + 1e-12), speed = point->swiftness * slices->energy[s];
            if (flown.span + travel_since < now.span) {
                now = flown;
                now.ball += travel_since;
            }
            if (speed < span_of(pace, m, link, out->pace_ball[s])) {
                memset(pace, 0, (size_t)(3 * m) * sizeof *pace);
                out->pace_ball[s] = speed;
            }
        }
        memcpy(travel, now.travel, (size_t)(3 * m) * sizeof *travel);
        out->travel_ball[s] = now.ball;
    }
    return STOPSET_OK;
}

void stopset_point_motion(const StopsetArm *arm, const StopsetPoint *point, int64_t count, const StopsetPointSets *sets, double *far,
                          double *fast, double *box) {
    const int m = arm->n + 1, link = point->link;
    const double *travel = sets->travel, *travel_ball = sets->travel_ball, *pace = sets->pace, *pace_ball = sets->pace_ball;
    double reach = sqrt(dot(point->at, point->at));
    *far = *fast = 0.0;
    memset(box, 0, 6 * sizeof *box);
    for (int i = 1; i <= link; i++) reach += sqrt(dot(arm->p + 3 * i, arm->p + 3 * i));
    for (int64_t s = 0; s < count; s++, travel += 3 * m, pace += 3 * m) {
        *far = most(*far, span_of(travel, m, link, travel_ball[s]));
        *fast = most(*fast, span_of(pace, m, link, pace_ball[s]));
        for (int x = 0; x < 3; x++) {
            double half = travel_ball[s];
            for (int i = 0; i <= link; i++) half += size_of(travel[x * m + i + 1]);
            box[2 * x] = least(box[2 * x], travel[x * m] - half);
            box[2 * x + 1] = most(box[2 * x + 1], travel[x * m] + half);
        }
    }
    /* however far joints turn, no point leaves the ball about the first one that the arm reaches */
    *far = least(*far, 2.0 * reach);
    for (int x = 0; x < 6; x++) box[x] = least(most(box[x], -2.0 * reach), 2.0 * reach);
}

/* How far [m] both ends (6,) of a link's axis can get from where they are at angles `at`, and those places (6,). */
static double ends_move(const StopsetArm *arm, const double *at, const double *r, int link, const double *ends, double *places) {
    const double none[3] = {0, 0, 0};
    double radius = 0.0, reach[SN];
    Point here;
    for (int e = 0; e < 6; e += 3) {
        locate(arm, at, link, ends + e, &here);
        memcpy(places + e, here.p, sizeof here.p);
        reach_of(arm, here.distance, r, link, ends + e, reach);
        radius = most(radius, longest(none, here.J, arm->n, r, link) + 0.5 * curved(reach, r, r, link));
    }
    return radius;
}

/* However far joints turn, a link stays in a ball about the origin of each joint before it: as wide as that origin moves and the links
 * from there are long. Where angles are wide the best of these balls is smaller than what the slopes tell. */
int stopset_swept_capsules(const StopsetArm *arm, const double *q, const double *q_radius, const StopsetSlices *slices, const double *capsules,
                           double *out) {
    const double *d_lo = slices->d_lo, *d_hi = slices->d_hi;
    const int n = arm->n;
    double at[SN], r[SN], pivot[6 * SN], pivot_moves[SN];
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    for (int64_t s = 0; s < slices->count; s++) {
        for (int i = 0; i < n; i++) {
            at[i] = q[i] + 0.5 * (d_lo[s * n + i] + d_hi[s * n + i]);
            r[i] = 0.5 * (d_hi[s * n + i] - d_lo[s * n + i]) + q_radius[i];
        }
        for (int link = 0; link < n; link++, out += 7) {
            const double *own = capsules + 7 * link, origin[6] = {0};
            double length = sqrt(most(dot(own, own), dot(own + 3, own + 3))) * (1.0 + 1e-12);
            pivot_moves[link] = ends_move(arm, at, r, link, origin, pivot + 6 * link);
            double radius = ends_move(arm, at, r, link, own, out);
            for (int k = link; k >= 0; k--) {
                if (pivot_moves[k] + length < radius) {
                    radius = pivot_moves[k] + length;
                    memcpy(out, pivot + 6 * k, 3 * sizeof *out);
                    memcpy(out + 3, pivot + 6 * k, 3 * sizeof *out);
                }
                length += sqrt(dot(arm->p + 3 * k, arm->p + 3 * k)) * (1.0 + 1e-12);
            }
            out[6] = radius + own[6];
        }
    }
    return STOPSET_OK;
}

/* The knot from `first` to `last` from which what is left of the travel adds least, joints nearer to the base counted more; -1 if none
 * knows. */
static int64_t nearest(int n, int64_t first, int64_t last, const double *d_lo, const double *d_hi, const double *travel) {
    int64_t best = -1;
    double least_so_far = STOPS_INF;
    for (int64_t k = first; k <= last; k++) {
        double width = 0.0, farthest = 0.0;
        for (int i = 0; i < n; i++) {
            width += (n - i) * (d_hi[k * n + i] - d_lo[k * n + i]);
            farthest = most(farthest, (n - i) * travel[k * n + i]);
        }
        if (!(width + 2.0 * farthest < least_so_far)) continue;
        least_so_far = width + 2.0 * farthest;
        best = k;
    }
    return best;
}

/* What holds of joint i from knot `begin` to `end`: displacements, then speeds. */
static void stretch(const StopsetTube *t, int n, int i, int64_t begin, int64_t end, double out[4]) {
    double dl = STOPS_INF, dh = -STOPS_INF, vl = STOPS_INF, vh = -STOPS_INF;
    for (int64_t k = begin; k <= end; k++) {
        const int64_t at = k * n + i;
        dl = least(dl, t->d_lo[at]);
        dh = most(dh, t->d_hi[at]);
        vl = least(vl, t->v_lo[at]);
        vh = most(vh, t->v_hi[at]);
        if (k == end) continue;
        vl = least(vl, t->e_lo[at]);
        vh = most(vh, t->e_hi[at]);
        /* a displacement bound that turns round within a step bulges out by less than half of it */
        const double h = t->t[k + 1] - t->t[k];
        if (t->v_hi[at] > 0.0 && t->e_hi[at] <= 0.0) dh = most(dh, t->d_hi[at] + 0.5 * h * t->v_hi[at]);
        if (t->v_lo[at] < 0.0 && t->e_lo[at] >= 0.0) dl = least(dl, t->d_lo[at] + 0.5 * h * t->v_lo[at]);
    }
    out[0] = dl;
    out[1] = dh;
    out[2] = vl;
    out[3] = vh;
}

void stopset_slices(const StopsetTube *t, int64_t K, int n, double *work, StopsetSlices *out) {
    const int64_t count = out->count;
    int64_t begin = 0, first = 0;
    double *travel = work, path = 0.0, hull[4];
    travel[0] = 0.0;
    out->border[0] = 0.0;
    out->count = 0;
    for (int64_t k = 0; k < K; k++) {
        double sum = 0.0;
        for (int64_t i = k * n; i < (k + 1) * n; i++) sum += 0.5 * size_of(t->d_lo[i + n] + t->d_hi[i + n] - t->d_lo[i] - t->d_hi[i]);
        travel[k + 1] = travel[k] + sum;
    }
    for (int64_t s = 0; s < count && begin < K; s++) {
        int64_t end = begin + 1;
        while (end < K && (s == count - 1 || travel[end] < travel[K] * (double)(s + 1) / (double)count)) end++;
        out->energy[s] = 0.0;
        for (int64_t k = begin; k < end; k++) {
            path += t->energy[k] * (t->t[k + 1] - t->t[k]);
            out->energy[s] = most(out->energy[s], t->energy[k]);
        }
        out->path[s] = path * (1.0 + 1e-12);
        const int64_t from = nearest(n, first, begin, t->d_lo, t->d_hi, t->travel_left);
        for (int i = 0; i < n; i++) {
            const int64_t at = s * n + i;
            stretch(t, n, i, begin, end, hull);
            out->d_lo[at] = hull[0];
            out->d_hi[at] = hull[1];
            out->v_lo[at] = hull[2];
            out->v_hi[at] = hull[3];
            out->near_lo[at] = from < 0 ? 0.0 : t->d_lo[from * n + i];
            out->near_hi[at] = from < 0 ? 0.0 : t->d_hi[from * n + i];
            out->begin_lo[at] = t->d_lo[begin * n + i];
            out->begin_hi[at] = t->d_hi[begin * n + i];
            out->left[at] = from < 0 ? STOPS_INF : t->travel_left[from * n + i];
        }
        out->count = s + 1;
        out->border[s + 1] = t->t[end];
        first = begin + 1;
        begin = end;
    }
}
