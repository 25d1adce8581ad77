/* How far and how long, if the power is cut now: an energy bound of the whole coupled arm (STOP 0).
 *
 * With y = sqrt(v'Mv) the power balance gives y y' <= sum w_i |v_i|, w_i = |g_i| + |u_i| - F_i - b_i(t): Coriolis torque
 * does no work, coupling is inside M. Where all w_i < 0: y' <= -min |w_i|/sqrt(M_ii); else y' <= sqrt(sum w_i^2/J_i) over
 * the positive ones, since M >= J (rotors). What the
 * identified inertia exceeds the rigid body by (rotor_hi - rotor) is counted where it lengthens the stop only. Speeds are |v_i| <= y/sqrt(J_i), angles their integral. Gravity on the way
 * belongs to claimed angles, verified afterwards: a continuous motion cannot leave claims that it has to leave first.
 * Slopes of M and g by Bernstein's inequality (trigonometric polynomials of degree 2 and 1 in each angle).
 * The same in Python: stopset.fmu.energy. Source: Liu & Althoff (2018), sec. VI, for what it serves; Bernstein (1912).
 */
#include <math.h>
#include <string.h>

#include "stopset_core.h"

enum { RAMP = 64, CLAIMS = 60 };

/* Bounds over all postures: rigid-body inertia about each axis [kg m^2] and gravity torque [N m]. */
static void over_all_postures(double pi[NJ][10], double S[NJ], double G[NJ]) {
    const StopsetModel *m = &stopset_model;
    double g = sqrt(m->gravity[0] * m->gravity[0] + m->gravity[1] * m->gravity[1] + m->gravity[2] * m->gravity[2]);
    for (int i = 0; i < NJ; i++) {
        double far = 0.0;
        S[i] = G[i] = 0.0;
        for (int k = i; k < NJ; k++) {
            const double *P = pi[k];
            if (k > i) far += sqrt(m->p[k][0] * m->p[k][0] + m->p[k][1] * m->p[k][1] + m->p[k][2] * m->p[k][2]);
            double moment = sqrt(P[1] * P[1] + P[2] * P[2] + P[3] * P[3]);
            double spin = sqrt(P[4] * P[4] + P[6] * P[6] + P[9] * P[9] + 2.0 * (P[5] * P[5] + P[7] * P[7] + P[8] * P[8]));
            S[i] += fabs(P[0]) * far * far + 2.0 * far * moment + spin;
            G[i] += g * (fabs(P[0]) * far + moment);
        }
    }
}

/* y' on a stretch where the brakes give at least `share` of their torque. */
static double rate(const double load[NJ], double share, const double Mii[NJ]) {
    const StopsetModel *m = &stopset_model;
    double push = 0.0, least = HUGE_VAL;
    for (int i = 0; i < NJ; i++) {
        double w = load[i] - m->brake_lo[i] * share;
        if (w >= 0.0) push += w * w / m->rotor[i];
        least = fmin(least, -w / sqrt(Mii[i]));
    }
    return least > 0.0 ? -least : sqrt(push);
}

/* Integral of y and the time to rest; 0 where the brakes cannot be shown to stop the arm. */
static int run_down(double y, const double load[NJ], const double Mii[NJ], double *way, double *time, double *fastest) {
    const StopsetModel *m = &stopset_model;
    double delay = 0.0, engaged = 0.0;
    for (int i = 0; i < NJ; i++) {
        delay = fmax(delay, m->brake_delay_hi[i]);
        engaged = fmax(engaged, m->brake_delay_hi[i] + m->brake_rise_hi[i]);
    }
    double h = (engaged - delay) / RAMP, t = 0.0;
    *way = 0.0;
    *fastest = y;
    for (int k = -1; k < RAMP; k++) {
        /* torque at the start of a piece is the least on it, the slowest brake counts for all */
        double length = k < 0 ? delay : h, slope = rate(load, k < 0 ? 0.0 : (double)k / RAMP, Mii);
        double end = fmax(y + slope * length, 0.0);
        *way += 0.5 * (y + end) * length;
        *fastest = fmax(*fastest, end);
        y = end;
        t += length;
    }
    double slope = rate(load, 1.0, Mii);
    if (!(slope < 0.0)) return 0;
    *way += 0.5 * y * y / -slope;
    *time = t + y / -slope;
    return 1;
}

/* v'Mv of the links, twice the kinetic energy; and distances of the flange from the axes. */
static double kinetic(double pi[NJ][10], const double q[NJ], const double dq[NJ], double radius[NJ]) {
    double w[NJ][3], v[NJ][3], sum = 0.0;
    stopset_link_motion(q, dq, w, v, radius);
    for (int i = 0; i < NJ; i++) {
        const double *P = pi[i], *a = w[i], *b = v[i];
        double c[3] = {a[1] * P[3] - a[2] * P[2], a[2] * P[1] - a[0] * P[3], a[0] * P[2] - a[1] * P[1]};
        sum += P[0] * (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]) + 2.0 * (b[0] * c[0] + b[1] * c[1] + b[2] * c[2]);
        sum += P[4] * a[0] * a[0] + P[6] * a[1] * a[1] + P[9] * a[2] * a[2];
        sum += 2.0 * (P[5] * a[0] * a[1] + P[7] * a[0] * a[2] + P[8] * a[1] * a[2]);
    }
    return sum;
}

/* Stop from the box q +- rq, dq +- rdq; 0 where nothing can be proved. */
int stopset_energy_stop(const StopsetState *s, const double q[NJ], const double dq[NJ], const double rq[NJ], const double rdq[NJ],
                        double angle[NJ], double speed[NJ], double *time, double *tcp) {
    const StopsetModel *m = &stopset_model;
    double pi[NJ][10], S[NJ], G[NJ], g[NJ], Mii[NJ], radius[NJ], claim[NJ], load[NJ];
    if (!m->has_brakes) return 0;
    stopset_loaded_links(s, pi);
    over_all_postures(pi, S, G);
    stopset_gravity_torque(pi, m->gravity, q, g);
    double energy = kinetic(pi, q, dq, radius), reach = 0.0, spread = 0.0, blur = 0.0;
    for (int i = 0; i < NJ; i++) {
        if (!(m->rotor[i] > 0.0)) return 0;
        Mii[i] = S[i] + m->rotor_hi[i];
        energy += m->rotor_hi[i] * dq[i] * dq[i];
        reach += sqrt(S[i]) * fabs(dq[i]);
        spread += rq[i];
        blur += sqrt(Mii[i]) * rdq[i];
        claim[i] = 0.0;
    }
    double y0 = sqrt(fmax(energy, 0.0) + 2.0 * spread * reach * reach) + blur, way = 0.0, fastest = 0.0;
    for (int attempt = 0; attempt < CLAIMS; attempt++) {
        double moved = 0.0;
        int held = 1;
        for (int i = 0; i < NJ; i++) moved += claim[i] + rq[i];
        for (int i = 0; i < NJ; i++) {
            double offset = s->r[VR_OFFSET + i];
            double u = fmax(fabs(m->stop_u_hi[i] - offset), fabs(m->stop_u_lo[i] - offset));
            load[i] = fmin(G[i], fabs(g[i]) + G[i] * moved) + u - m->dry_lo[i];
        }
        if (!run_down(y0, load, Mii, &way, time, &fastest)) return 0;
        for (int i = 0; i < NJ; i++) {
            angle[i] = way / sqrt(m->rotor[i]) * (1.0 + 1e-9);
            held = held && angle[i] <= claim[i];
        }
        if (held) {
            double R[NJ];
            *tcp = 0.0;
            for (int i = NJ - 1; i >= 0; i--) {
                R[i] = radius[i];
                for (int k = i + 1; k < NJ; k++) R[i] += R[k] * (angle[k] + rq[k]);
                *tcp += R[i] * angle[i];
                speed[i] = fastest / sqrt(m->rotor[i]);
            }
            return 1;
        }
        for (int i = 0; i < NJ; i++) claim[i] = fmax(claim[i], 1.02 * angle[i] + 1e-9);
    }
    return 0;
}

void stopset_stop_bounds(StopsetState *s) {
    const StopsetModel *m = &stopset_model;
    double q[NJ], dq[NJ], rq[NJ], rdq[NJ], angle[NJ], speed[NJ], time = 0.0, tcp = 0.0;
    int seen = s->b[IX_MEASURED], proved = 0;
    if (s->stopping) return; /* the bounds are those of the moment of the request */
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
    if (believed) proved = stopset_energy_stop(s, q, dq, rq, rdq, angle, speed, &time, &tcp);
    for (int i = 0; i < NJ; i++) {
        s->r[VR_STOP_TIME + i] = proved ? time : (double)NAN;
        s->r[VR_STOP_ANGLE + i] = proved ? angle[i] : (double)NAN;
        s->stop_speed[i] = proved ? speed[i] : (double)NAN;
    }
    s->r[VR_TCP_STOP_DISTANCE] = proved ? tcp : (double)NAN;
    s->b[IX_STOP_CERTIFIED] = (uint8_t)proved;
}
