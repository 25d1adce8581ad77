/* What the kinetic energy knows of the speeds: the layer that holds where coupling is too strong for joint-wise bands.
 *
 * With y = sqrt(v' M v), y dy/dt = v' (u - g - D v - f) <= sum_i w_i |v_i|, w_i = sup |u_i - g_i| - F_i - B_i(t): all w_i < 0 give
 * dy/dt <= -min_i |w_i| / sqrt(M_ii), else dy/dt <= sqrt(w+' |W| w+) with W >= M^-1; |v_i| <= sqrt(W_ii) y caps every speed.
 * W comes from M >= M_c - diag(r), r_i = M_ii sum_j d_ij / sqrt(M_ii M_jj) (weighted Gershgorin).
 *
 * How far the brakes still let it go with that energy: Lemma 5 of docs/stops.md. Source: Spong et al. (2006), ch. 7, for the skew symmetry of M' - 2 C.
 */
#include <math.h>
#include <string.h>

#include "stops.h"

enum { CLAIMS = STOPSET_ENERGY_CLAIMS };
const double stopset_energy_rounding = 1.0 + 1e-9;

/* Largest sqrt(v' M v) over a box of speeds: convex in v, so at a corner; inf for an unbounded box. */
double stops_largest(const Local *at, const double *v_lo, const double *v_hi) {
    const int n = at->n;
    double spread = 0.0, v[SN], p[SN], value = 0.0;
    for (int i = 0; i < n; i++) {
        const double a = most(size_of(v_lo[i]), size_of(v_hi[i]));
        if (!(a < STOPS_INF)) return STOPS_INF;
        for (int j = 0; j < n; j++) spread += at->dM[i * n + j] * a * most(size_of(v_lo[j]), size_of(v_hi[j]));
    }
    memcpy(v, v_lo, (size_t)n * sizeof *v);
    for (int i = 0; i < n; i++) {
        p[i] = 0.0;
        for (int j = 0; j < n; j++) p[i] += at->M[i * n + j] * v[j];
    }
    for (int i = 0; i < n; i++) value += v[i] * p[i];
    double best = value;
    for (int64_t corner = 1; corner < (int64_t)1 << n; corner++) { /* Gray code: one speed changes at a time */
        int i = 0;
        while (!((corner >> i) & 1)) i++;
        const double new = v[i] == v_lo[i] ? v_hi[i] : v_lo[i], step = new - v[i];
        value += step * (2.0 * p[i] + at->M[i * n + i] * step);
        for (int j = 0; j < n; j++) p[j] += at->M[j * n + i] * step;
        v[i] = new;
        best = most(best, value);
    }
    return sqrt(most(best + spread, 0.0)) * stopset_energy_rounding;
}

/* W >= M^-1; 0 if M is not surely positive definite. */
static int inverse(const Local *at, Energy *out) {
    const int n = at->n;
    double A[SN * SN], L[SN * SN], x[SN];
    memcpy(A, at->M, (size_t)(n * n) * sizeof *A);
    for (int i = 0; i < n; i++) {
        double relative = 0.0;
        for (int j = 0; j < n; j++) relative += at->dM[i * n + j] / sqrt(at->M[i * n + i] * at->M[j * n + j]);
        A[i * n + i] -= at->M[i * n + i] * relative;
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double s = A[i * n + j];
            for (int k = 0; k < j; k++) s -= L[i * n + k] * L[j * n + k];
            if (i == j && !(s > 1e-6 * at->M[i * n + i])) return 0;
            L[i * n + j] = i == j ? sqrt(s) : s / L[j * n + j];
        }
    for (int c = 0; c < n; c++) {
        for (int i = 0; i < n; i++) {
            double s = i == c ? 1.0 : 0.0;
            for (int k = 0; k < i; k++) s -= L[i * n + k] * x[k];
            x[i] = s / L[i * n + i];
        }
        for (int i = n - 1; i >= 0; i--) {
            double s = x[i];
            for (int k = i + 1; k < n; k++) s -= L[k * n + i] * x[k];
            x[i] = s / L[i * n + i];
        }
        for (int i = 0; i < n; i++) out->W[i * n + c] = x[i];
    }
    return 1;
}

/* w_i [N m] of this file's head while joint i moves forward (hi) and backward (lo). */
void stops_power_excess(int n, const Span *g, const StopsetRange *u, const double *B_lo, Span *w) {
    for (int i = 0; i < n; i++) {
        w->hi[i] = u->hi[i] - g->lo[i] - B_lo[i];
        w->lo[i] = g->hi[i] - u->lo[i] - B_lo[i];
    }
}

/* Caps on a step of h seconds from y, on whose box `at` holds and w bounds the power. Whatever the pose, M >= diag(rotor) and
 * M_ii <= K.size_i + rotor_i. */
static void caps(const StopsetPlant *p, Energy *e, double y, const Local *at, const double *w, double h) {
    const int n = at->n, local = inverse(at, e);
    double near = 0.0, far = 0.0, slowest = STOPS_INF;
    for (int i = 0; i < n; i++) {
        const double rotor_lo = p->rotor[i] - p->rotor_half[i], rotor_hi = p->rotor[i] + p->rotor_half[i], push = most(w[i], 0.0);
        slowest = least(slowest, -w[i] / sqrt(least(at->M[i * n + i] + at->dM[i * n + i], p->curvature.size[i] + rotor_hi)));
        far += push * push / rotor_lo;
        for (int j = 0; j < n; j++) near += push * size_of(e->W[i * n + j]) * most(w[j], 0.0);
    }
    const double rate = slowest > 0.0 ? -slowest : sqrt(local ? least(near, far) : far), after = most(y + h * rate, 0.0) * stopset_energy_rounding;
    for (int i = 0; i < n; i++) {
        const double light = 1.0 / (p->rotor[i] - p->rotor_half[i]), size = sqrt(local ? least(most(e->W[i * n + i], 0.0), light) : light) * stopset_energy_rounding;
        e->cap[i] = size * most(y, after);
        e->end[i] = size * after;
    }
    e->y = after;
}

/* Gravity's torque in the box looked at, at rest. */
static void weight(const Near *near, Span *g) {
    for (int i = 0; i < near->E.n; i++) {
        g->lo[i] = most(near->at.h_lo[i], -near->plant->curvature.load[i]);
        g->hi[i] = least(near->at.h_hi[i], near->plant->curvature.load[i]);
    }
}

/* Caps of the next step, from angles in E.q + x; 0 if none can be verified. The caps decide where the arm can be,
 * and that what M can be: they are claimed first, and claimed again while too small. */
int stops_step_energy(Near *near, Energy *e, const Span *x, const Step *s) {
    const StopsetPlant *p = near->plant;
    const Local *at = &near->at;
    const StopsetRange u = {p->u_lo, p->u_hi};
    const int n = near->E.n;
    const double y = e->y, h = s->h;
    const Span still = {{0}, {0}};
    double w[SN], claim[SN];
    Span either, there = still;
    for (int i = 0; i < n; i++) claim[i] = 1.02 * least(e->cap[i], sqrt(1.0 / (p->rotor[i] - p->rotor_half[i])) * y) + 1e-6;
    for (int attempt = 0; attempt < CLAIMS; attempt++) {
        int enough = 1;
        for (int i = 0; i < n; i++) {
            there.lo[i] = x->lo[i] - h * claim[i];
            there.hi[i] = x->hi[i] + h * claim[i];
        }
        stops_box_terms(near, &there, &still, &near->at); /* at rest: h is gravity alone */
        weight(near, &e->g);
        stops_power_excess(n, &e->g, &u, s->B_lo, &either);
        for (int i = 0; i < n; i++) w[i] = most(either.lo[i], either.hi[i]);
        caps(p, e, y, at, w, h);
        for (int i = 0; i < n; i++)
            if (e->cap[i] > claim[i]) {
                enough = 0;
                claim[i] = 1.05 * e->cap[i];
            }
        if (enough) return 1;
    }
    return 0;
}

/* More (n,) [N m] that gravity can push per way than in angles E.q + x, joints on from there by ways of which sum_i of
 * (all of joint i) / way_i <= 1: its work is what its potential differs by, so half of what it changes by. */
static void heavier(const Near *near, const Span *x, const double *travel, double *more) {
    const Expansion *E = &near->E;
    const int n = E->n;
    for (int i = 0; i < n; i++) {
        more[i] = 0.0;
        for (int k = 0; k < n; k++) {
            const double *bend = near->plant->curvature.g + (i * n + k) * n;
            double slope = size_of(E->dg[i * n + k]) + size_of(E->dgp[i * n + k]), on = 0.0;
            for (int o = 0; o < n; o++) {
                slope += bend[o] * most(size_of(x->lo[o]), size_of(x->hi[o]));
                on = most(on, bend[o] * travel[o]);
            }
            more[i] = most(more[i], 0.5 * least(slope + on, bend[k]) * travel[k]); /* of degree one in q_k: no slope is larger than a second one */
        }
    }
}

/* How far [rad] each joint can still go forward (hi) and backward (lo) from angles in E.q + x, whenever; 0 if that is not known.
 * Brakes only gain torque: once all hold more than gravity and u can push, sum_i |w_i| |v_i| takes from y^2 / 2, so joint i goes no farther than
 * y^2 / 2 |w_i|, w_i that of the direction. That decides where gravity is asked for: travel is claimed first, and claimed again while too short. */
int stops_travel_left(Near *near, const Energy *e, const Span *x, const double *B_lo, Span *travel) {
    const StopsetPlant *p = near->plant;
    const StopsetRange u = {p->u_lo, p->u_hi};
    const int n = near->E.n;
    const double work = 0.5 * e->y * e->y * stopset_energy_rounding;
    const Span still = {{0}, {0}};
    double more[SN], claim[SN];
    Span g, w, left;
    stops_box_terms(near, x, &still, &near->at); /* at rest: h is gravity alone */
    weight(near, &g);
    stops_power_excess(n, &g, &u, B_lo, &w);
    for (int i = 0; i < n; i++) {
        const double worst = most(w.lo[i], w.hi[i]);
        if (!(worst < 0.0)) return 0;
        claim[i] = 1.1 * work / -worst + 1e-9;
    }
    for (int attempt = 0; attempt < CLAIMS; attempt++) {
        int enough = 1;
        heavier(near, x, claim, more);
        for (int i = 0; i < n; i++) {
            left.lo[i] = least(w.lo[i] + more[i], p->curvature.load[i] - p->u_lo[i] - B_lo[i]);
            left.hi[i] = least(w.hi[i] + more[i], p->curvature.load[i] + p->u_hi[i] - B_lo[i]);
            const double worst = most(left.lo[i], left.hi[i]);
            if (!(worst < 0.0)) return 0;
            if (!(work / -worst < claim[i])) {
                enough = 0;
                claim[i] = 1.1 * work / -worst + 1e-9;
            }
        }
        if (!enough) continue;
        for (int i = 0; i < n; i++) {
            travel->lo[i] = work / -left.lo[i] * stopset_energy_rounding;
            travel->hi[i] = work / -left.hi[i] * stopset_energy_rounding;
        }
        return 1;
    }
    return 0;
}

/* What joint i gives at one speed: at most so much of v' p, and of the power. */
typedef struct {
    double energy, power;
} Share;

/* Corners of what one joint gives at the speeds of its range: from that of most power on, ever more energy, each step for the least power that
 * there is. Forward and backward are corners of their own, as torque and momentum have directions. Returns how many, at most 3. */
static int corners(double w_lo, double w_hi, double p_lo, double p_hi, double v_lo, double v_hi, Share out[3]) {
    Share all[3] = {{0.0, 0.0}, {0.0, 0.0}, {0.0, 0.0}};
    const double ends[2] = {v_lo, v_hi};
    const int still = v_lo <= 0.0 && 0.0 <= v_hi;
    int count = 1, first = 0;
    for (int k = 0; k < 2; k++) {
        const double fast = size_of(ends[k]);
        all[k].energy = fast * most(ends[k] > 0.0 ? p_hi : -p_lo, 0.0);
        all[k].power = fast * (ends[k] > 0.0 ? w_hi : w_lo);
    }
    for (int k = 1; k < 2 + still; k++)
        if (all[k].power > all[first].power) first = k;
    out[0] = all[first];
    for (int next = 0; next >= 0;) {
        const Share at = out[count - 1];
        next = -1;
        for (int k = 0; k < 2 + still; k++) {
            const double more = all[k].energy - at.energy, less = all[k].power - at.power;
            if (more > 0.0 && (next < 0 || less * (all[next].energy - at.energy) > (all[next].power - at.power) * more)) next = k;
        }
        if (next >= 0) out[count++] = all[next];
    }
    return count;
}

typedef struct {
    int n, count[SN];
    Share of[SN][3];
} Shares;

/* Largest power [W] of all joints of which v' p is at least z: what has much energy moves, and what moves is braked. From most power on, energy is
 * had first where it costs least power. */
static double power(const Shares *x, double z) {
    int at[SN] = {0};
    double out = 0.0, scale = 0.0;
    for (int i = 0; i < x->n; i++) {
        out += x->of[i][0].power;
        z -= x->of[i][0].energy;
        for (int k = 0; k < x->count[i]; k++) scale += size_of(x->of[i][k].power);
    }
    while (z > 0.0) {
        double energy = 0.0, cost = 0.0;
        int best = -1;
        for (int i = 0; i < x->n; i++) {
            if (at[i] + 1 >= x->count[i]) continue;
            const Share *here = x->of[i] + at[i];
            const double more = here[1].energy - here[0].energy, less = here[1].power - here[0].power;
            if (best >= 0 && !(less * energy > cost * more)) continue;
            best = i;
            energy = more;
            cost = less;
        }
        if (best < 0) break;
        const double part = least(1.0, z / energy);
        out += part * cost;
        z -= part * energy;
        at[best]++;
    }
    return out + 1e-12 * scale; /* for rounding */
}

/* y after a step from y on which the speeds lie in v and the momenta in p, the excess of power between a line from w[0] to w[1]: the energy
 * balance, Lemma 8 of docs/stops.md. */
double stops_by_power(int n, double y, const Span w[2], const Span *v, const Span *p, double h) {
    const double z = y * y;
    Shares x[2] = {{.n = n}, {.n = n}};
    for (int k = 0; k < 2; k++)
        for (int i = 0; i < n; i++) x[k].count[i] = corners(w[k].lo[i], w[k].hi[i], p->lo[i], p->hi[i], v->lo[i], v->hi[i], x[k].of[i]);
    const double first = 0.5 * (power(x, z) + power(x + 1, z)), low = least(most(z + 2.0 * h * first, 0.0), z), rate = 0.5 * (power(x, low) + power(x + 1, low));
    return sqrt(most(most(z + 2.0 * h * rate, low + 2.0 * h * most(rate, 0.0)), 0.0)) * stopset_energy_rounding;
}

/* Torques that a way is weighed with, over what brake and dry friction surely have in the end. */
static const double weighed_with[TORQUES] = {0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8, 0.9, 1.0, 1.3};

void stops_start_travels(const StopsetPlant *p, double y, Travels *out) {
    for (int c = 0; c < TORQUES; c++)
        for (int i = 0; i < p->arm.n; i++) {
            const double torque = weighed_with[c] * (p->coulomb_lo[i] + p->brake_lo[i]) + 1e-9; /* any above 0 holds */
            out->torque[c][i] = torque;
            out->hi[c][i] = out->lo[c][i] = 0.5 * y * y / torque * stopset_energy_rounding;
        }
}

/* Largest power [W] of a joint with a speed in v, if beside the excess w of its direction a torque pushes it. */
static double power_with(double w_lo, double w_hi, double v_lo, double v_hi, double push) {
    const double low = v_lo * (v_lo > 0.0 ? push + w_hi : push - w_lo), high = v_hi * (v_hi > 0.0 ? push + w_hi : push - w_lo);
    const double ends = most(low, high);
    return v_lo <= 0.0 && 0.0 <= v_hi ? most(ends, 0.0) : ends;
}

/* The same after a step of h seconds with speeds in v, the excess of power between a line from w[0] to w[1], and at all times of it: Lemma 13 of
 * docs/stops.md. */
void stops_travels_on(int n, const Span w[2], const Span *v, double h, Travels *travels) {
    double own[2][SN], all[2] = {0.0, 0.0}, scale[2] = {0.0, 0.0};
    for (int k = 0; k < 2; k++)
        for (int i = 0; i < n; i++) {
            own[k][i] = power_with(w[k].lo[i], w[k].hi[i], v->lo[i], v->hi[i], 0.0);
            all[k] += own[k][i];
            scale[k] += size_of(own[k][i]);
        }
    for (int c = 0; c < TORQUES; c++)
        for (int i = 0; i < n; i++) {
            const double torque = travels->torque[c][i];
            double on = 0.0, back = 0.0;
            for (int k = 0; k < 2; k++) {
                const double others = all[k] - own[k][i] + 1e-12 * scale[k]; /* for rounding */
                on += 0.5 * most(others + power_with(w[k].lo[i], w[k].hi[i], v->lo[i], v->hi[i], torque), 0.0);
                back += 0.5 * most(others + power_with(w[k].lo[i], w[k].hi[i], v->lo[i], v->hi[i], -torque), 0.0);
            }
            travels->hi[c][i] = (travels->hi[c][i] + h * on / torque) * stopset_energy_rounding;
            travels->lo[c][i] = (travels->lo[c][i] + h * back / torque) * stopset_energy_rounding;
        }
}

/* Displacements at a knot cut to these, and these to what displacements and energy are there. */
void stops_cut_travels(int n, double y, Travels *travels, double *d_lo, double *d_hi) {
    for (int c = 0; c < TORQUES; c++)
        for (int i = 0; i < n; i++) {
            d_hi[i] = least(d_hi[i], travels->hi[c][i]);
            d_lo[i] = most(d_lo[i], -travels->lo[c][i]);
        }
    for (int c = 0; c < TORQUES; c++)
        for (int i = 0; i < n; i++) {
            const double torque = travels->torque[c][i], left = 0.5 * y * y / torque * stopset_energy_rounding;
            travels->hi[c][i] = least(travels->hi[c][i], d_hi[i] + left);
            travels->lo[c][i] = least(travels->lo[c][i], left - d_lo[i]);
        }
}

/* Speed bands cut to the caps; a joint that has rested may rest. */
void stops_cap_bands(int n, Bands *b, const Span *cap) {
    for (int i = 0; i < n; i++) {
        b->first_lo[i] = most(b->first_lo[i], cap->lo[i]);
        b->first_hi[i] = least(b->first_hi[i], cap->hi[i]);
        b->later_lo[i] = most(b->later_lo[i], least(cap->lo[i], 0.0));
        b->later_hi[i] = least(b->later_hi[i], most(cap->hi[i], 0.0));
        /* the excursion cannot last; keep the end that is nearer to rest */
        if (b->first_lo[i] > b->first_hi[i]) b->first_lo[i] = b->first_hi[i] = b->sign[i] > 0.0 ? b->first_hi[i] : b->first_lo[i];
    }
}

/* Whether the displacement under the line from v to e (upper side) is larger than that under the constant c; a line that crosses zero is
 * counted at its end. */
static int beyond(double v, double e, double c) { return (v < 0.0 && e >= 0.0 ? e : 0.5 * (v + e)) > c; }

/* The lines that bound the speeds on a step, lowered to the caps where these are lower, or `alone` the caps. */
void stops_cap_lines(int n, const Span *cap, double *const line[4], int alone) {
    double *v_lo = line[0], *v_hi = line[1], *e_lo = line[2], *e_hi = line[3];
    for (int i = 0; i < n; i++) {
        if (alone || beyond(v_hi[i], e_hi[i], cap->hi[i])) v_hi[i] = e_hi[i] = cap->hi[i];
        if (alone || beyond(-v_lo[i], -e_lo[i], -cap->lo[i])) v_lo[i] = e_lo[i] = cap->lo[i];
    }
}

double stopset_largest_energy(const StopsetPlant *plant, const StopsetBox *box) {
    Near near;
    if (plant->arm.n < 1 || plant->arm.n > SN) return -STOPSET_TOO_MANY_JOINTS;
    stops_look_at(plant, box, &stops_whole, 0, &near);
    return stops_largest(&near.at, box->v_lo, box->v_hi);
}

int stopset_energy_after(int n, double y, const StopsetRange *w, const StopsetRange *v, const StopsetRange *p, double h, double *out) {
    Span excess[2], speeds, momenta;
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    for (int k = 0; k < 2; k++) stops_span(n, w[k].lo, w[k].hi, excess + k);
    stops_span(n, v->lo, v->hi, &speeds);
    stops_span(n, p->lo, p->hi, &momenta);
    *out = stops_by_power(n, y, excess, &speeds, &momenta, h);
    return STOPSET_OK;
}

int stopset_power_excess(int n, const StopsetRange *g, const StopsetRange *u, const double *B_lo, double *w_lo, double *w_hi) {
    Span gravity, w;
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    stops_span(n, g->lo, g->hi, &gravity);
    stops_power_excess(n, &gravity, u, B_lo, &w);
    memcpy(w_lo, w.lo, (size_t)n * sizeof *w_lo);
    memcpy(w_hi, w.hi, (size_t)n * sizeof *w_hi);
    return STOPSET_OK;
}
