/* What the effects of a model do to its joints in a region of angles and speeds: every one by its own law, and their sum.
 *
 * Which of them act at all: Lemma 1 of docs/stops.md; a lower end below zero of what only opposes: Lemma 2. What laws see of the rigid body is an expansion at the middle
 * of the region and a bound of what lies beyond.
 */
#include <string.h>

#include "laws.h"

/* Rows of a sum over effects: friction that never drives, what else opposes the motion, and what may push. */
enum { RUBS, RUBS_VISCOUS, DRY, VISCOUS, PUSH, ROWS_OF_SUM };
static const double ROUNDING = 1e-12; /* of an expansion, relative to the largest */
const double stopset_friction_tolerance = 0.25;

/* value +- half, cut at +- largest */
static void around(double value, double half, double largest, double hair, double out[2]) {
    out[0] = most(value - half, -largest) - hair;
    out[1] = least(value + half, largest) + hair;
}

static double highest(int n, const double *x) {
    double out = x[0];
    for (int i = 1; i < n; i++) out = most(out, x[i]);
    return out;
}

static double bent(int n, const double *K, const double *r) {
    double out = 0.0;
    for (int k = 0; k < n; k++)
        for (int l = 0; l < n; l++) out += K[k * n + l] * r[k] * r[l];
    return out;
}

static void gravity(const Expansion *E, const double *r, const double *bend, const double *largest, double (*out)[2]) {
    const int n = E->n;
    const double hair = ROUNDING * (1.0 + highest(n, largest));
    for (int i = 0; i < n; i++) {
        double near = size_of(E->gp[i]);
        for (int k = 0; k < n; k++) near += (size_of(E->dg[i * n + k]) + size_of(E->dgp[i * n + k])) * r[k];
        around(E->g[i], near + 0.5 * bent(n, bend + i * n * n, r), largest[i], hair, out[i]);
    }
}

static void stiffness(const Expansion *E, const StopsetCurvature *K, const double *r, StopsetSight *sight) {
    const int n = E->n;
    const double hair = ROUNDING * (1.0 + highest(n, K->load));
    for (int i = 0; i < n; i++) {
        double half = size_of(E->dgp[i * n + i]);
        for (int k = 0; k < n; k++) half += K->g[(i * n + i) * n + k] * r[k];
        around(E->dg[i * n + i], half, K->load[i], hair, sight[i].stiff);
    }
}

static void inertia(const Expansion *E, const StopsetCurvature *K, const double *r, StopsetSight *sight) {
    const int n = E->n;
    const double hair = ROUNDING * (1.0 + highest(n, K->size));
    for (int i = 0; i < n; i++) {
        const int own = i * n + i;
        double half = size_of(E->Mp[own]);
        for (int k = 0; k < n; k++) half += (size_of(E->dM[own * n + k]) + size_of(E->dMp[own * n + k])) * r[k];
        around(E->M[own], half + 0.5 * bent(n, K->M + own * n * n, r), K->size[i], hair, sight[i].inertia);
        for (int k = 0; k < 2; k++) sight[i].inertia[k] = most(sight[i].inertia[k], 0.0);
    }
}

static void coriolis(const Expansion *E, const double *turn, const double *r, const double *speed, StopsetSight *sight) {
    const int n = E->n;
    for (int i = 0; i < n; i++) {
        double size = 0.0;
        for (int k = 0; k < n; k++)
            for (int l = 0; l < n; l++) {
                const int at = (i * n + k) * n + l;
                double symbol = size_of(E->Gamma[at]) + size_of(E->Gammap[at]);
                for (int m = 0; m < n; m++) symbol += turn[at * n + m] * r[m];
                size += symbol * speed[k] * speed[l];
            }
        size *= 1.0 + ROUNDING;
        sight[i].coriolis[0] = -size;
        sight[i].coriolis[1] = size;
    }
}

/* What the laws of every joint see at angles in [q_lo, q_hi]. */
static void look(const StopsetPlant *plant, const StopsetTorques *t, const double *q_lo, const double *q_hi, const double *speed,
                 StopsetSight sight[SN]) {
    const int n = plant->arm.n, needs = t->needs;
    const double still[SN] = {0};
    double middle[SN], r[SN], g[SN][2];
    Expansion E;
    for (int i = 0; i < n; i++) {
        StopsetSight *s = sight + i;
        middle[i] = 0.5 * (q_lo[i] + q_hi[i]);
        r[i] = 0.5 * (q_hi[i] - q_lo[i]) + ROUNDING;
        s->speed = speed[i];
        s->past = t->fastest[i];
        s->gear = t->gear[i];
        s->q[0] = q_lo[i];
        s->q[1] = q_hi[i];
        for (int k = 0; k < 2; k++) s->temp[k] = t->temp ? t->temp[2 * i + k] : 0.0;
    }
    if (!needs) return;
    if (needs & ~STOPSET_NEEDS_TILT) stops_expand(&plant->arm, plant->pi_half, still, middle, &E);
    if (needs & STOPSET_NEEDS_LOAD) {
        gravity(&E, r, plant->curvature.g, plant->curvature.load, g);
        for (int i = 0; i < n; i++) memcpy(sight[i].load, g[i], sizeof g[i]);
    }
    if (needs & STOPSET_NEEDS_STIFF) stiffness(&E, &plant->curvature, r, sight);
    if (needs & STOPSET_NEEDS_INERTIA) inertia(&E, &plant->curvature, r, sight);
    if (needs & STOPSET_NEEDS_LINK) coriolis(&E, t->turn, r, speed, sight);
    for (int k = 0; k < 2 && needs & STOPSET_NEEDS_TILT; k++) {
        StopsetArm arm = plant->arm;
        arm.gravity = t->tilt_gravity + 3 * k;
        stops_expand(&arm, plant->pi_half, still, middle, &E);
        gravity(&E, r, t->tilt_bend + k * n * n * n, t->tilt_load + k * n, g);
        for (int i = 0; i < n; i++) memcpy(sight[i].tilt[k], g[i], sizeof g[i]);
    }
}

/* One of the sums: no less than nothing of what rubs, and what else would be negative pushes, `per` of it. */
static void separate(const double *rubs, const double *other, double per, double push[2], double out[2]) {
    const double lo = most(rubs[0], 0.0) + other[0], hi = most(rubs[1], 0.0) + other[1];
    const double lacks = (1.0 + stopset_friction_tolerance) * most(-lo, 0.0) * per;
    push[0] -= lacks;
    push[1] += lacks;
    out[0] = most(lo, 0.0) * (1.0 - stopset_friction_tolerance);
    out[1] = most(hi, 0.0) * (1.0 + stopset_friction_tolerance);
}

int stopset_friction_over(const StopsetPlant *plant, const StopsetTorques *t, const double *q_lo, const double *q_hi, const double *speed,
                          double *out) {
    const int n = plant->arm.n, row = 2 * n;
    if (n < 1 || n > SN) return -STOPSET_TOO_MANY_JOINTS;
    double total[ROWS_OF_SUM * 2 * SN], parts[6];
    StopsetSight sight[SN];
    int slow = 1;
    for (int i = 0; i < n; i++) slow = slow && !(speed[i] > t->speed[i]);
    memcpy(total, slow ? t->fixed : t->base, (size_t)(ROWS_OF_SUM * row) * sizeof *total);
    memset(sight, 0, sizeof sight);
    look(plant, t, q_lo, q_hi, speed, sight);
    for (int k = 0; k < t->laws; k++) {
        const StopsetActing *law = t->law + k;
        if (slow && !law->roams) continue;
        StopsetSight here = sight[law->joint];
        if (law->other >= 0) here.other = speed[law->other];
        if (stopset_act(law, &here, parts)) return STOPSET_NO_BOUND + k;
        const int rubs = law->role == STOPSET_RUBS, rows[3] = {rubs ? RUBS : DRY, rubs ? RUBS_VISCOUS : VISCOUS, PUSH};
        for (int p = 0; p < 3; p++) {
            double *sum = total + rows[p] * row + 2 * law->joint;
            const Ends new = ends_add((Ends){sum[0], sum[1]}, (Ends){parts[2 * p], parts[2 * p + 1]});
            sum[0] = new.lo;
            sum[1] = new.hi;
        }
    }
    for (int i = 0; i < n; i++) {
        double push[2] = {total[PUSH * row + 2 * i], total[PUSH * row + 2 * i + 1]}, dry[2], viscous[2];
        separate(total + RUBS * row + 2 * i, total + DRY * row + 2 * i, 1.0, push, dry);
        separate(total + RUBS_VISCOUS * row + 2 * i, total + VISCOUS * row + 2 * i, speed[i], push, viscous);
        /* effects stand on the side of the arm's own torques: what they give, the arm is pushed by with the opposite sign */
        const double ends[6] = {dry[0], dry[1], viscous[0], viscous[1], t->free_lo[i] - push[1], t->free_hi[i] - push[0]};
        for (int p = 0; p < 6; p++) out[p * n + i] = ends[p];
    }
    return STOPSET_OK;
}
