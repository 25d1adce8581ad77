/* How far and how long, if the power is cut now (STOP 0): two proofs for the coupled arm, the smaller bound of each joint counts.
 *
 * Accelerations. At almost every time the joints split into moving ones and resting ones (acceleration zero), M_ff a_f = r_f.
 * With the comparison matrix <M> (least diagonal, largest off-diagonal) an M-matrix, |a| <= <M>^-1 |r| for every such split.
 * The coupling |M_ij| |a_j| then is a torque among others, and each speed obeys |v_i|' <= rate_i while it moves, and stays
 * zero where rate_i <= 0: a one-sided comparison with reflection at zero.
 * Energy. With y = sqrt(v'Mv): y y' <= sum w_i |v_i|, w_i = |g_i| + |u_i| - F_i - b_i(t); Coriolis torque does no work. Where
 * all w_i < 0: y' <= -min |w_i|/sqrt(M_ii); else y' <= sqrt(sum w_i^2/J_i) over the positive ones, as M >= J (rotors).
 * Speeds are |v_i| <= y/sqrt(J_i). Loose, but it does not fail where coupling is strong.
 * In both, M, c and g on the way belong to claimed angles and speeds, verified afterwards: a continuous motion cannot leave
 * claims that it would have to leave first. Slopes of M and g by Bernstein's inequality (degree 2 and 1 in each angle).
 * What the identified inertia exceeds the rigid body by (rotor_hi - rotor) may be there or not; the worse counts.
 * The same in Python: stopset.fmu.stops. Source: stop notes of the project; Bernstein (1912); Berman & Plemmons (1994), ch. 6.
 */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

enum { RAMP = 64, CLAIMS = 60, PIECES = 40, STEPS = 2000 };
static const double DIFFERENCE = 1e-3; /* [rad] of the slope of M; its error is below (8/6) 1e-6 of the bound of M */

typedef struct {
    double angle[NJ], speed[NJ], time;
} Bound;

/* Everything that does not change while claims are tried. */
typedef struct {
    double pi[NJ][10], T[NJ][NJ], G[NJ], g[NJ], M[NJ][NJ], slope[NJ][NJ][NJ], radius[NJ], u[NJ];
    double v[NJ], rq[NJ], rdq[NJ];
} Stop;

/* Bounds over all postures: |M_ij| of the links [kg m^2] and |g_i| [N m]. */
static void over_all_postures(Stop *x) {
    const StopsetModel *m = &stopset_model;
    double g = sqrt(m->gravity[0] * m->gravity[0] + m->gravity[1] * m->gravity[1] + m->gravity[2] * m->gravity[2]);
    double far[NJ][NJ];
    memset(x->T, 0, sizeof x->T);
    memset(x->G, 0, sizeof x->G);
    for (int k = 0; k < NJ; k++) {
        const double *P = x->pi[k];
        double step = sqrt(m->p[k][0] * m->p[k][0] + m->p[k][1] * m->p[k][1] + m->p[k][2] * m->p[k][2]);
        double moment = sqrt(P[1] * P[1] + P[2] * P[2] + P[3] * P[3]);
        double spin = sqrt(P[4] * P[4] + P[6] * P[6] + P[9] * P[9] + 2.0 * (P[5] * P[5] + P[7] * P[7] + P[8] * P[8]));
        for (int i = 0; i <= k; i++) far[i][k] = i < k ? far[i][k - 1] + step : 0.0;
        for (int i = 0; i <= k; i++) {
            x->G[i] += g * (fabs(P[0]) * far[i][k] + moment);
            for (int j = 0; j <= k; j++)
                x->T[i][j] += fabs(P[0]) * far[i][k] * far[j][k] + moment * (far[i][k] + far[j][k]) + spin;
        }
    }
}

/* Mass matrix of the links. */
static void links(double pi[NJ][10], const double q[NJ], double M[NJ][NJ], double radius[NJ]) {
    double w[NJ][NJ][3], v[NJ][NJ][3], unit[NJ];
    for (int j = 0; j < NJ; j++) {
        memset(unit, 0, sizeof unit);
        unit[j] = 1.0;
        stopset_link_motion(q, unit, w[j], v[j], radius);
    }
    for (int i = 0; i < NJ; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = i; k < NJ; k++) {
                const double *P = pi[k], *a = w[i][k], *b = v[i][k], *c = w[j][k], *d = v[j][k];
                sum += P[0] * (b[0] * d[0] + b[1] * d[1] + b[2] * d[2]);
                sum += b[0] * (c[1] * P[3] - c[2] * P[2]) + b[1] * (c[2] * P[1] - c[0] * P[3]) + b[2] * (c[0] * P[2] - c[1] * P[1]);
                sum += d[0] * (a[1] * P[3] - a[2] * P[2]) + d[1] * (a[2] * P[1] - a[0] * P[3]) + d[2] * (a[0] * P[2] - a[1] * P[1]);
                sum += a[0] * (P[4] * c[0] + P[5] * c[1] + P[7] * c[2]) + a[1] * (P[5] * c[0] + P[6] * c[1] + P[8] * c[2]);
                sum += a[2] * (P[7] * c[0] + P[8] * c[1] + P[9] * c[2]);
            }
            M[i][j] = M[j][i] = sum;
        }
}

static void prepare(const StopsetState *s, const double q[NJ], const double dq[NJ], const double rq[NJ], const double rdq[NJ], Stop *x) {
    const StopsetModel *m = &stopset_model;
    double near[NJ], up[NJ][NJ], down[NJ][NJ];
    stopset_loaded_links(s, x->pi);
    over_all_postures(x);
    stopset_gravity_torque(x->pi, m->gravity, q, x->g);
    memcpy(near, q, sizeof near);
    for (int k = 0; k < NJ; k++) {
        near[k] = q[k] + DIFFERENCE;
        links(x->pi, near, up, x->radius);
        near[k] = q[k] - DIFFERENCE;
        links(x->pi, near, down, x->radius);
        near[k] = q[k];
        for (int i = 0; i < NJ; i++)
            for (int j = 0; j < NJ; j++) x->slope[i][j][k] = fabs(up[i][j] - down[i][j]) / (2.0 * DIFFERENCE);
    }
    links(x->pi, q, x->M, x->radius);
    for (int i = 0; i < NJ; i++) {
        double offset = s->r[VR_OFFSET + i];
        /* the constant torque of the powered data may belong to the drives or to the arm: with and without it */
        x->u[i] = fmax(fabs(m->stop_u_hi[i] - offset), fabs(m->stop_u_lo[i] - offset));
        x->u[i] = fmax(x->u[i], fmax(fabs(m->stop_u_hi[i]), fabs(m->stop_u_lo[i])));
        x->v[i] = dq[i];
        x->rq[i] = rq[i];
        x->rdq[i] = rdq[i];
    }
}

static double ramp(double t, double delay, double rise) { return t <= delay ? 0.0 : t >= delay + rise ? 1.0 : (t - delay) / rise; }

static double longest_engagement(double *delay) {
    double engaged = 0.0;
    *delay = 0.0;
    for (int i = 0; i < NJ; i++) {
        *delay = fmax(*delay, stopset_model.brake_delay_hi[i]);
        engaged = fmax(engaged, stopset_model.brake_delay_hi[i] + stopset_model.brake_rise_hi[i]);
    }
    return engaged;
}

/* March the comparison under claims; 0 if it does not come to rest. */
static int march(const Stop *x, const double claim[NJ], const double fastest[NJ], Bound *out) {
    const StopsetModel *m = &stopset_model;
    double off[NJ][NJ], least[NJ], most[NJ], compare[NJ][NJ], inverse[NJ][NJ], load[NJ], z[NJ], moved = 0.0, delay;
    for (int i = 0; i < NJ; i++) moved += claim[i] + x->rq[i];
    for (int i = 0; i < NJ; i++)
        for (int j = 0; j < NJ; j++) {
            double wide = 0.0;
            for (int k = 0; k < NJ; k++)
                wide += (x->slope[i][j][k] + (4.0 * moved + 2e-6) * x->T[i][j]) * (claim[k] + x->rq[k]);
            if (i == j) {
                least[i] = fmax(x->M[i][i] - wide, 0.0) + m->rotor[i];
                most[i] = fmin(x->M[i][i] + wide, x->T[i][i]) + m->rotor_hi[i];
                compare[i][i] = least[i];
                off[i][i] = 0.0;
            } else {
                off[i][j] = fmin(fabs(x->M[i][j]) + wide, x->T[i][j]);
                compare[i][j] = -off[i][j];
            }
        }
    if (!stopset_invert(compare, inverse)) return 0;
    for (int i = 0; i < NJ; i++)
        for (int j = 0; j < NJ; j++)
            if (!(inverse[i][j] >= 0.0)) return 0; /* not an M-matrix: coupling too strong for this proof */
    for (int i = 0; i < NJ; i++) {
        double coriolis = 0.0;
        for (int j = 0; j < NJ; j++)
            for (int k = 0; k < NJ; k++) {
                double far = 4.0 * moved + 2e-6;
                double gamma = x->slope[i][j][k] + far * x->T[i][j] + 0.5 * (x->slope[j][k][i] + far * x->T[j][k]);
                coriolis += gamma * fastest[j] * fastest[k];
            }
        load[i] = fmin(x->G[i], fabs(x->g[i]) + x->G[i] * moved) + x->u[i] + coriolis;
        z[i] = fabs(x->v[i]) + x->rdq[i];
        out->angle[i] = 0.0;
        out->speed[i] = z[i];
    }
    double engaged = longest_engagement(&delay), h = engaged / PIECES;
    for (int step = 0; step < STEPS; step++) {
        double t = step * h, A[NJ], rate[NJ], torque[NJ], dry[NJ];
        int rest[NJ] = {0}, moving = 0;
        for (int i = 0; i < NJ; i++) {
            torque[i] = load[i] + m->dry_hi[i] + m->viscous_hi[i] * fastest[i];
            torque[i] += m->brake_hi[i] * ramp(t + h, m->brake_delay_lo[i], m->brake_rise_lo[i]);
            dry[i] = m->dry_lo[i] + m->brake_lo[i] * ramp(t, m->brake_delay_hi[i], m->brake_rise_hi[i]);
        }
        for (int pass = 0; pass < 3; pass++) { /* joints shown to rest on the step give no coupling torque */
            for (int i = 0; i < NJ; i++) {
                A[i] = 0.0;
                for (int j = 0; j < NJ; j++)
                    if (!rest[j]) A[i] += inverse[i][j] * torque[j];
                if (rest[i]) A[i] = 0.0;
            }
            for (int i = 0; i < NJ; i++) {
                double net = load[i] - dry[i];
                for (int j = 0; j < NJ; j++) net += off[i][j] * A[j];
                rate[i] = net > 0.0 ? net / least[i] : net / most[i];
                if (z[i] == 0.0 && rate[i] <= 0.0) rest[i] = 1;
            }
        }
        for (int i = 0; i < NJ; i++) {
            double end = fmax(z[i] + h * rate[i], 0.0);
            if (rest[i]) end = 0.0;
            out->angle[i] += 0.5 * h * (z[i] + end);
            out->speed[i] = fmax(out->speed[i], end);
            z[i] = end;
            moving += !rest[i];
        }
        if (!moving && t >= engaged) {
            out->time = t; /* at rest on this step, and with brakes as strong on all later ones */
            return 1;
        }
    }
    return 0;
}

static int by_accelerations(const Stop *x, Bound *out) {
    double claim[NJ], fastest[NJ];
    for (int i = 0; i < NJ; i++) {
        claim[i] = 0.0;
        fastest[i] = fabs(x->v[i]) + x->rdq[i];
    }
    for (int attempt = 0; attempt < CLAIMS; attempt++) {
        int held = 1;
        if (!march(x, claim, fastest, out)) return 0;
        for (int i = 0; i < NJ; i++) {
            held = held && out->angle[i] <= claim[i] && out->speed[i] <= fastest[i];
            claim[i] = fmax(claim[i], 1.02 * out->angle[i] + 1e-9);
            fastest[i] = fmax(fastest[i], 1.02 * out->speed[i] + 1e-9);
        }
        if (held) return 1;
    }
    return 0;
}

/* y' on a stretch where the brakes give at least `share` of their torque. */
static double energy_rate(const double load[NJ], double share, const double Mii[NJ]) {
    const StopsetModel *m = &stopset_model;
    double push = 0.0, least = HUGE_VAL;
    for (int i = 0; i < NJ; i++) {
        double w = load[i] - m->brake_lo[i] * share;
        if (w >= 0.0) push += w * w / m->rotor[i];
        least = fmin(least, -w / sqrt(Mii[i]));
    }
    return least > 0.0 ? -least : sqrt(push);
}

/* Integral of y, largest y and the time to rest; 0 where the brakes cannot be shown to stop the arm. */
static int run_down(double y, const double load[NJ], const double Mii[NJ], double *way, double *fastest, double *time) {
    double delay, engaged = longest_engagement(&delay), h = (engaged - delay) / RAMP, t = 0.0;
    *way = 0.0;
    *fastest = y;
    for (int k = -1; k < RAMP; k++) {
        /* torque at the start of a piece is the least on it, the slowest brake counts for all */
        double length = k < 0 ? delay : h, end = fmax(y + energy_rate(load, k < 0 ? 0.0 : (double)k / RAMP, Mii) * length, 0.0);
        *way += 0.5 * (y + end) * length;
        *fastest = fmax(*fastest, end);
        y = end;
        t += length;
    }
    double rate = energy_rate(load, 1.0, Mii);
    if (!(rate < 0.0)) return 0;
    *way += 0.5 * y * y / -rate;
    *time = t + y / -rate;
    return 1;
}

static int by_energy(const Stop *x, Bound *out) {
    const StopsetModel *m = &stopset_model;
    double Mii[NJ], claim[NJ], load[NJ], energy = 0.0, reach = 0.0, spread = 0.0, blur = 0.0, way, fastest;
    for (int i = 0; i < NJ; i++) {
        Mii[i] = x->T[i][i] + m->rotor_hi[i];
        energy += m->rotor_hi[i] * x->v[i] * x->v[i];
        for (int j = 0; j < NJ; j++) {
            energy += x->v[i] * x->M[i][j] * x->v[j];
            reach += x->T[i][j] * fabs(x->v[i] * x->v[j]);
        }
        spread += x->rq[i];
        blur += sqrt(Mii[i]) * x->rdq[i];
        claim[i] = 0.0;
    }
    double y0 = sqrt(fmax(energy, 0.0) + 2.0 * spread * reach) + blur;
    for (int attempt = 0; attempt < CLAIMS; attempt++) {
        double moved = 0.0;
        int held = 1;
        for (int i = 0; i < NJ; i++) moved += claim[i] + x->rq[i];
        for (int i = 0; i < NJ; i++) load[i] = fmin(x->G[i], fabs(x->g[i]) + x->G[i] * moved) + x->u[i] - m->dry_lo[i];
        if (!run_down(y0, load, Mii, &way, &fastest, &out->time)) return 0;
        for (int i = 0; i < NJ; i++) {
            out->angle[i] = way / sqrt(m->rotor[i]);
            out->speed[i] = fastest / sqrt(m->rotor[i]);
            held = held && out->angle[i] <= claim[i];
            claim[i] = fmax(claim[i], 1.02 * out->angle[i] + 1e-9);
        }
        if (held) return 1;
    }
    return 0;
}

int stopset_stop(const StopsetState *s, const double q[NJ], const double dq[NJ], const double rq[NJ], const double rdq[NJ],
                 double angle[NJ], double speed[NJ], double *time, double *tcp) {
    Stop x;
    Bound a, b;
    if (!stopset_model.has_brakes) return 0;
    for (int i = 0; i < NJ; i++)
        if (!(stopset_model.rotor[i] > 0.0)) return 0;
    prepare(s, q, dq, rq, rdq, &x);
    int first = by_accelerations(&x, &a), second = by_energy(&x, &b);
    if (!first && !second) return 0;
    if (!first) a = b;
    if (!second) b = a;
    double R[NJ];
    *time = fmin(a.time, b.time);
    *tcp = 0.0;
    for (int i = 0; i < NJ; i++) {
        /* a part in 1e9 covers the rounding of some thousand additions */
        angle[i] = fmin(a.angle[i], b.angle[i]) * (1.0 + 1e-9);
        speed[i] = fmin(a.speed[i], b.speed[i]) * (1.0 + 1e-9);
        /* what the effects give on the way was computed for stops no longer and no faster than these */
        if (angle[i] > stopset_model.stop_angle[i] || speed[i] > stopset_model.stop_speed[i]) return 0;
    }
    for (int i = NJ - 1; i >= 0; i--) {
        R[i] = x.radius[i];
        for (int k = i + 1; k < NJ; k++) R[i] += R[k] * (angle[k] + rq[k]);
        *tcp += R[i] * angle[i];
    }
    /* the flange never leaves the ball of its reach */
    double far = sqrt(stopset_model.tip[0] * stopset_model.tip[0] + stopset_model.tip[1] * stopset_model.tip[1] +
                      stopset_model.tip[2] * stopset_model.tip[2]);
    for (int k = 1; k < NJ; k++) {
        const double *p = stopset_model.p[k];
        far += sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    }
    *tcp = fmin(*tcp, 2.0 * far);
    return 1;
}

void stopset_stop_bounds(StopsetState *s) {
    const StopsetModel *m = &stopset_model;
    double q[NJ], dq[NJ], rq[NJ], rdq[NJ], angle[NJ], speed[NJ], time = 0.0, tcp = 0.0;
    int seen = s->b[IX_MEASURED], proved = 0;
    if (s->stopping || s->stop_ready) return; /* while stopping the bounds are those of the request */
    s->stop_ready = 1;
    for (int i = 0; i < NJ; i++) {
        if (seen) { /* what was measured is the state and a reading error in V */
            q[i] = s->r[VR_Q_MEASURED + i] - 0.5 * (m->V_hi[i] + m->V_lo[i]);
            dq[i] = s->r[VR_DQ_MEASURED + i] - 0.5 * (m->V_hi[NJ + i] + m->V_lo[NJ + i]);
            rq[i] = 0.5 * (m->V_hi[i] - m->V_lo[i]);
            rdq[i] = 0.5 * (m->V_hi[NJ + i] - m->V_lo[NJ + i]);
        } else {
            q[i] = 0.5 * (s->r[VR_Q_HI + i] + s->r[VR_Q_LO + i]);
            dq[i] = 0.5 * (s->r[VR_DQ_HI + i] + s->r[VR_DQ_LO + i]);
            rq[i] = 0.5 * (s->r[VR_Q_HI + i] - s->r[VR_Q_LO + i]);
            rdq[i] = 0.5 * (s->r[VR_DQ_HI + i] - s->r[VR_DQ_LO + i]);
        }
        seen = seen && stopset_finite(q[i]) && stopset_finite(dq[i]);
    }
    int believed = s->b[IX_COVERED] && !s->violated && (seen || !s->b[IX_MEASURED]) && s->i[IX_STOP] != 2;
    for (int i = 0; i < NJ; i++) believed = believed && stopset_finite(rq[i]) && stopset_finite(rdq[i]);
    if (believed) proved = stopset_stop(s, q, dq, rq, rdq, angle, speed, &time, &tcp);
    for (int i = 0; i < NJ; i++) {
        s->r[VR_STOP_TIME + i] = proved ? time : (double)NAN;
        s->r[VR_STOP_ANGLE + i] = proved ? angle[i] : (double)NAN;
        s->stop_speed[i] = proved ? speed[i] : (double)NAN;
    }
    s->r[VR_TCP_STOP_DISTANCE] = proved ? tcp : (double)NAN;
    s->b[IX_STOP_CERTIFIED] = (uint8_t)proved;
}
