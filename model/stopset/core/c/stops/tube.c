/* The certified tube of a power-off stop: all positions and speeds the arm can have at any time after the cut.
 *
 *     M(q) dv/dt + c(q, v) + g(q) + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i),   u in U (any function of time)
 *
 * The march through time, its claims and their verification are told in stopset.reach.stops.tube.
 *
 * Source: Moreau (1988) for the inclusion; Goodnight (1979) for the sweep operator.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "stops.h"

enum { OK, ENDLESS, UNBOUNDED };
enum { PASSES = STOPSET_TUBE_PASSES, FEW_PASSES = 20 }; /* where there are caps to fall back on, what has not closed by then hardly ever does */
const double stopset_tube_recentre = 0.01;
const StopsetParts stops_whole = {.coupling = 1.0, .christoffel = 1.0, .gravity_slope = 1.0, .whole_step = 1.0, .bend = 1.0, .pull = 1.0, .shared = 1.0, .held = 1.0, .still = 1.0};

enum { most_idle = 12 }; /* steps on which all brakes are closed and the energy does not fall */
static const double worth = 0.9; /* share of the energy's range of a speed above which the momenta are not worth their cost */

static const double too_far = 100.0; /* times the range of a speed, or its widest band, by which claims let it change on one step */

typedef struct {
    const StopsetTube *tube;
    double widest; /* band of speeds with which a tube ends */
    int n, energetic, pulled, related, asked; /* pulled: the momenta still say more than the energy; asked: so do accelerations, or may yet */
    int tightens; /* what first excursions have left of momentum still cuts bands, or may yet */
    _Alignas(32) double claim[4][SN], last[4][SN], out[RATES][SN], need[SN], drop[SN], retained[SN];
    Span q, farthest; /* angles at the cut; displacements from now on, by energy */
    Span w, x, v;     /* on the step: claimed speeds, angles from the pose, speeds under its lines */
    Span momenta, cap, room; /* of all joints at the knot; of speeds on the step; beyond those at the knot, first claimed */
    Step s;
    Bands b, end;
    Energy energy;
    Travels travels;
    Near near; /* from here on nothing is read that was not written, and much is room for more joints */
    Momentum momentum;
} March;

static double ramp(double t, double delay, double rise) {
    if (t <= delay) return 0.0;
    if (t >= delay + rise) return 1.0;
    return (t - delay) / rise;
}

/* Integral of `ramp` up to t [s]. */
static double ramped(double t, double delay, double rise) {
    const double since = most(t - delay, 0.0);
    return since < rise ? 0.5 * since * since / rise : since - 0.5 * rise;
}

static int is_finite(double x) { return x - x == 0.0; }

/* Claims for step k: the last step's rates, carried on as they changed, and a little more. */
static void guess_claims(March *m, int64_t k) {
    for (int i = 0; i < m->n; i++) {
        for (int row = 0; row < 4; row++) {
            const double guess = k > 0 && is_finite(m->out[row][i]) ? m->out[row][i] : 0.0, step = k > 1 ? guess - m->last[row][i] : 0.0;
            const double grow = 0.02 * size_of(guess) + 1e-3 + size_of(step);
            m->claim[row][i] = row == 0 || row == 2 ? guess + least(step, 0.0) - grow : guess + most(step, 0.0) + grow;
            m->last[row][i] = guess;
        }
        /* a joint that could not start from rest is first taken not to start */
        if (k > 0 && m->out[1][i] <= 0.0) m->claim[1][i] = least(m->claim[1][i], 0.0);
        if (k > 0 && m->out[2][i] >= 0.0) m->claim[2][i] = most(m->claim[2][i], 0.0);
    }
}

/* Speeds on a step under the claimed accelerations and the caps, and which signs are possible. */
static void claimed_speeds(March *m, const double *lo, const double *hi) {
    Step *s = &m->s;
    for (int i = 0; i < m->n; i++) {
        double z = lo[i] + m->s.h * least(0.0, lo[i] > 0.0 ? m->claim[0][i] : m->claim[2][i]);
        if (lo[i] > 0.0 && z <= 0.0) z = m->s.h * least(0.0, m->claim[2][i]);
        m->w.lo[i] = most(z, m->cap.lo[i]);
        z = hi[i] + m->s.h * most(0.0, hi[i] < 0.0 ? m->claim[3][i] : m->claim[1][i]);
        if (hi[i] < 0.0 && z >= 0.0) z = m->s.h * most(0.0, m->claim[1][i]);
        m->w.hi[i] = least(z, m->cap.hi[i]);
        s->plus[i] = m->w.hi[i] > 0.0;
        s->minus[i] = m->w.lo[i] < 0.0;
        s->zero[i] = m->w.lo[i] <= 0.0 && m->w.hi[i] >= 0.0;
        s->a_far[i] = 0.0;
        if (s->plus[i]) s->a_far[i] = most(size_of(m->claim[0][i]), size_of(m->claim[1][i]));
        if (s->minus[i]) s->a_far[i] = most(s->a_far[i], most(size_of(m->claim[2][i]), size_of(m->claim[3][i])));
    }
}

/* Do the accelerations lie inside the claims? If not, the claims grow. A joint at rest on the whole step (neither sign
 * possible) only has to be kept from starting. */
static int claims_hold(March *m) {
    const Step *s = &m->s;
    int good = 1;
    for (int i = 0; i < m->n; i++)
        for (int row = 0; row < 4; row++) {
            const int used = row < 2 ? s->plus[i] || (row == 1 && s->zero[i]) : s->minus[i] || (row == 2 && s->zero[i]);
            const double value = m->out[row][i];
            double *claim = &m->claim[row][i];
            if (!used) continue;
            if (row == 0 || row == 2) { /* what is not a number holds no claim */
                if (!(value >= *claim) && !(row == 2 && !s->minus[i] && value >= 0.0)) {
                    good = 0;
                    *claim = value - 0.05 * size_of(value) - 1e-3;
                }
            } else if (!(value <= *claim) && !(row == 1 && !s->plus[i] && value <= 0.0)) {
                good = 0;
                *claim = value + 0.05 * size_of(value) + 1e-3;
            }
        }
    return good;
}

/* Bands at the end of a step, from the verified accelerations. */
static void advance(March *m) {
    const Bands *b = &m->b;
    Bands *end = &m->end;
    double(*out)[SN] = m->out;
    const double h = m->s.h;
    for (int i = 0; i < m->n; i++) {
        const double start_up = h * most(0.0, out[8][i]), start_down = h * least(0.0, out[9][i]);
        int ends;
        end->alive[i] = b->alive[i];
        end->rested[i] = b->rested[i];
        end->later_lo[i] = end->later_hi[i] = 0.0;
        if (b->rested[i]) {
            /* the rate refined at the bound's own speed belongs to the first excursion while that may last */
            const double up = b->alive[i] ? out[8][i] : out[4][i], down = b->alive[i] ? out[9][i] : out[7][i];
            end->later_hi[i] = b->later_hi[i] > 0.0 ? most(b->later_hi[i] + h * up, 0.0) : start_up;
            end->later_lo[i] = b->later_lo[i] < 0.0 ? least(b->later_lo[i] + h * down, 0.0) : start_down;
        }
        if (!b->alive[i]) continue;
        if (b->sign[i] > 0.0) {
            end->first_hi[i] = most(b->first_hi[i] + h * out[4][i], 0.0);
            end->first_lo[i] = most(b->first_lo[i] + h * (b->rested[i] ? out[0][i] : out[5][i]), 0.0);
            ends = end->first_lo[i] <= 0.0;
        } else {
            end->first_lo[i] = least(b->first_lo[i] + h * out[7][i], 0.0);
            end->first_hi[i] = least(b->first_hi[i] + h * (b->rested[i] ? out[3][i] : out[6][i]), 0.0);
            ends = end->first_hi[i] >= 0.0;
        }
        if (ends && !b->rested[i]) {
            end->rested[i] = 1;
            end->later_hi[i] = start_up;
            end->later_lo[i] = start_down;
        }
        if (end->first_lo[i] == 0.0 && end->first_hi[i] == 0.0) end->alive[i] = 0;
    }
}

/* The expansion at q, the rotors' half intervals beside the payload's: both are constant during a stop. */
static void expand(March *m, const double *q) {
    stops_expand(&m->near.plant->arm, m->near.plant->pi_half, m->near.plant->rotor, q, &m->near.E);
    for (int i = 0; i < m->n; i++) {
        double *own = &m->near.E.Mp[i * m->n + i];
        *own = size_of(*own) + m->near.plant->rotor_half[i];
    }
}

/* Least dry friction of a joint that has come to rest by `now`, the end of the step, and the direction it can move in with
 * less. Its brake has given at least the impulse that ended the first excursion, and its torque only grows. */
static void later_friction(March *m, double now) {
    const StopsetPlant *p = m->near.plant;
    Step *s = &m->s;
    for (int i = 0; i < m->n; i++) {
        s->B_later[i] = s->B_lo[i];
        s->direction[i] = 0.0;
        if (m->b.sign[i] == 0.0) continue;
        if (m->b.alive[i]) s->direction[i] = m->b.sign[i];
        const double since = now - p->delay_lo[i];
        if (m->b.rested[i] && m->need[i] > 0.0 && since > 0.0) { /* having rested it needed some finite impulse */
            const double worked = most(0.5 * since, since - 0.5 * p->rise_lo[i]); /* a ramp has given half of its torque times the time */
            s->B_later[i] = least(most(s->B_lo[i], p->coulomb_lo[i] + m->need[i] / worked), s->B_hi[i]);
        }
        if (m->b.alive[i] || s->B_later[i] <= s->B_lo[i]) continue;
        s->B_lo[i] = s->last[i] = s->B_later[i];
        s->less[i] = most(s->less[i], s->B_later[i]);
    }
}

/* Torques without dry friction on a step; and what viscous friction surely takes at a joint's own speed bound. */
static void torques(March *m, const double *lo, const double *hi) {
    const StopsetPlant *p = m->near.plant;
    const Bands *b = &m->b;
    Step *s = &m->s;
    for (int i = 0; i < m->n; i++) {
        const double D_lo = p->viscous_lo[i], D_hi = p->viscous_hi[i], h = m->s.h;
        const double few = least(D_lo * m->w.lo[i], D_hi * m->w.lo[i]), many = most(D_lo * m->w.hi[i], D_hi * m->w.hi[i]);
        s->s_lo[i] = -m->near.at.h_hi[i] - many + p->u_lo[i];
        s->s_hi[i] = -m->near.at.h_lo[i] - few + p->u_hi[i];
        double fast = m->w.lo[i], slow = m->w.hi[i];
        const double upper = b->alive[i] && b->sign[i] > 0.0 ? b->first_hi[i] : hi[i];
        const double lower = b->alive[i] && b->sign[i] < 0.0 ? b->first_lo[i] : lo[i];
        if (upper > 0.0)
            fast = most(upper + h * least(0.0, m->claim[0][i]), 0.0);
        else if (upper < 0.0)
            fast = upper + h * least(0.0, m->claim[2][i]);
        if (lower < 0.0)
            slow = least(lower + h * most(0.0, m->claim[3][i]), 0.0);
        else if (lower > 0.0)
            slow = lower + h * most(0.0, m->claim[1][i]);
        s->own_up[i] = most(0.0, least(D_lo * fast, D_hi * fast) - few);
        s->own_down[i] = most(0.0, many - most(D_lo * slow, D_hi * slow));
    }
}

/* Whether claims have left what the caps allow, or where a tube ends, so far behind that they would only grow; or are no numbers any more. */
static int hopeless(const March *m) {
    for (int row = 0; row < 4; row++)
        for (int i = 0; i < m->n; i++)
            if (!(m->s.h * size_of(m->claim[row][i]) <= too_far * least(m->cap.hi[i] - m->cap.lo[i], m->widest))) return 1;
    return 0;
}

/* Claims until they hold; whether they did. */
static int verify(March *m, int64_t k) {
    const int n = m->n;
    const double *v_lo = m->tube->v_lo + k * n, *v_hi = m->tube->v_hi + k * n, *d_lo = m->tube->d_lo + k * n, *d_hi = m->tube->d_hi + k * n;
    for (int attempt = 0; attempt < (m->energetic ? FEW_PASSES : PASSES); attempt++) {
        claimed_speeds(m, v_lo, v_hi);
        for (int i = 0; i < n; i++) {
            m->x.lo[i] = m->q.lo[i] + d_lo[i] + m->s.h * least(0.0, m->w.lo[i]) - m->near.E.q[i];
            m->x.hi[i] = m->q.hi[i] + d_hi[i] + m->s.h * most(0.0, m->w.hi[i]) - m->near.E.q[i];
        }
        stops_box_terms(&m->near, &m->x, &m->w, &m->near.at);
        torques(m, v_lo, v_hi);
        stops_accelerations(&m->near.at, &m->s, m->out);
        if (m->related) stops_related(&m->near, &m->s, m->out);
        if (claims_hold(m)) return 1;
        if (hopeless(m)) return 0;
    }
    return 0;
}

/* Where claims cannot be verified the caps alone bound the step: accelerations of which nothing is known. */
static void caps_alone(March *m, int64_t k) {
    const int n = m->n;
    for (int i = 0; i < n; i++) {
        m->x.lo[i] = m->q.lo[i] + m->tube->d_lo[k * n + i] - m->near.E.q[i] + m->s.h * least(m->cap.lo[i], 0.0);
        m->x.hi[i] = m->q.hi[i] + m->tube->d_hi[k * n + i] - m->near.E.q[i] + m->s.h * most(m->cap.hi[i], 0.0);
    }
    stops_box_terms(&m->near, &m->x, &m->cap, &m->near.at);
    for (int row = 0; row < RATES; row++)
        for (int i = 0; i < n; i++) m->out[row][i] = is_lower(row) ? -STOPS_INF : STOPS_INF;
}

/* Whether accelerations say more of the speeds at the end of a step than the energy does. */
static int cuts(const March *m, const double *lo, const double *hi) {
    int more = 0;
    for (int i = 0; i < m->n; i++) more |= hi[i] - lo[i] < least(m->cap.hi[i], m->energy.end[i]) - most(m->cap.lo[i], -m->energy.end[i]);
    return more;
}

/* Bands, lines and retained impulse of step k; whether accelerations were verified. The impulse that ends first excursions during
 * the step is known after it: it was taken a little less, and the step is repeated where that was too much. */
static int take_step(March *m, int64_t k, double now) {
    const int n = m->n;
    const StopsetTube *t = m->tube;
    double *v_lo = t->v_lo + k * n, *v_hi = t->v_hi + k * n, *e_lo = t->e_lo + k * n, *e_hi = t->e_hi + k * n;
    int verified = 0;
    for (int i = 0; i < n; i++) m->need[i] = m->b.alive[i] ? m->momentum.needed[i] - 2.0 * m->drop[i] : m->momentum.needed[i];
    for (int redo = 0;; redo++) { /* ends: from the second on each takes nothing of one more joint */
        int enough = 1;
        later_friction(m, now + m->s.h);
        verified = m->asked && verify(m, k);
        if (!verified && !m->energetic) return 0;
        if (!verified) caps_alone(m, k);
        advance(m);
        if (!verified) stops_cap_bands(n, &m->end, &m->cap);
        stops_total(n, &m->end, e_lo, e_hi);
        if (m->energetic) stops_cap_lines(n, &m->cap, (double *[]){v_lo, v_hi, e_lo, e_hi}, !verified);
        for (int i = 0; i < n; i++) {
            m->v.lo[i] = least(v_lo[i], e_lo[i]);
            m->v.hi[i] = most(v_hi[i], e_hi[i]);
        }
        stops_retained_impulse(&m->near, &m->momentum, &m->s, &m->b, &m->end, &m->v, m->retained);
        for (int i = 0; i < n; i++)
            if (m->b.alive[i] && m->b.rested[i] && 0.0 < m->need[i] && m->retained[i] < m->need[i]) {
                enough = 0;
                m->need[i] = redo ? 0.0 : m->retained[i] - 0.01 * size_of(m->retained[i]);
            }
        if (enough) break;
    }
    return verified;
}

/* Displacements by trapezoids: chords lie outside a bound that is convex; where it crosses zero, its larger end does. */
static void displace(const March *m, int64_t k) {
    const int n = m->n;
    const StopsetTube *t = m->tube;
    for (int i = 0; i < n; i++) {
        const int64_t at = k * n + i;
        const double hi = t->v_hi[at], lo = t->v_lo[at], new_hi = t->e_hi[at], new_lo = t->e_lo[at], h = m->s.h;
        t->d_hi[at + n] = t->d_hi[at] + h * (hi < 0.0 && new_hi >= 0.0 ? most(new_hi, 0.0) : 0.5 * (hi + new_hi));
        t->d_lo[at + n] = t->d_lo[at] + h * (lo > 0.0 && new_lo <= 0.0 ? least(new_lo, 0.0) : 0.5 * (lo + new_lo));
        t->d_hi[at + n] = least(t->d_hi[at + n], m->farthest.hi[i]);
        t->d_lo[at + n] = most(t->d_lo[at + n], m->farthest.lo[i]);
        if (m->near.parts->whole_step == 0.0) {
            t->d_hi[at + n] = t->d_hi[at] + h * new_hi;
            t->d_lo[at + n] = t->d_lo[at] + h * new_lo;
        }
        for (int row = 0; row < 4; row++) t->rates[row][at] = m->out[row][i];
    }
}

/* What dry friction is on the step from `now` in the mean, and a line below the least of it: a ramp that has begun bends downward alone. Lemma 12 of
 * docs/stops.md. */
static void brakes_in_mean(March *m, double now) {
    const StopsetPlant *p = m->near.plant;
    Step *s = &m->s;
    const double end = now + s->h, hair = 1e-12; /* for rounding */
    for (int i = 0; i < m->n; i++) {
        const double few = (ramped(end, p->delay_hi[i], p->rise_hi[i]) - ramped(now, p->delay_hi[i], p->rise_hi[i])) / s->h;
        const double many = (ramped(end, p->delay_lo[i], p->rise_lo[i]) - ramped(now, p->delay_lo[i], p->rise_lo[i])) / s->h;
        s->less[i] = most(s->B_lo[i], p->coulomb_lo[i] + p->brake_lo[i] * (few - hair));
        s->more[i] = least(s->B_hi[i], p->coulomb_hi[i] + p->brake_hi[i] * (many + hair));
        s->last[i] = s->B_lo[i];
        if (now >= p->delay_hi[i]) s->last[i] = most(s->B_lo[i], p->coulomb_lo[i] + p->brake_lo[i] * ramp(end, p->delay_hi[i], p->rise_hi[i]));
    }
}

/* Friction of the step, the expansion where it has moved too far, and the energy's caps; 0 if these cannot be verified. */
static int prepare(March *m, int64_t k, double now, const double *middle, const double *gravity) {
    const StopsetPlant *p = m->near.plant;
    const StopsetTube *t = m->tube;
    const int n = m->n;
    double here[SN], far = 0.0;
    for (int i = 0; i < n; i++) {
        here[i] = middle[i] + 0.5 * (t->d_lo[k * n + i] + t->d_hi[k * n + i]);
        far += size_of(here[i] - m->near.E.q[i]);
    }
    if (far > stopset_tube_recentre) {
        for (int i = 0; i < n; i++) here[i] = here[i] + 0.5 * (here[i] - m->near.E.q[i]);
        expand(m, here);
        if (m->near.parts->gravity_slope == 0.0) memcpy(m->near.E.g, gravity, (size_t)n * sizeof *gravity);
    }
    const double early = m->near.parts->whole_step > 0.0 ? now : now + m->s.h, late = m->near.parts->whole_step > 0.0 ? now + m->s.h : now;
    for (int i = 0; i < n; i++) {
        m->s.B_lo[i] = p->coulomb_lo[i] + p->brake_lo[i] * ramp(early, p->delay_hi[i], p->rise_hi[i]);
        m->s.B_hi[i] = p->coulomb_hi[i] + p->brake_hi[i] * ramp(late, p->delay_lo[i], p->rise_lo[i]);
    }
    brakes_in_mean(m, now);
    if (!m->energetic) return 1;
    for (int i = 0; i < n; i++) {
        m->x.lo[i] = m->q.lo[i] + t->d_lo[k * n + i] - m->near.E.q[i];
        m->x.hi[i] = m->q.hi[i] + t->d_hi[k * n + i] - m->near.E.q[i];
    }
    Span travel, speeds;
    const int braked = stops_travel_left(&m->near, &m->energy, &m->x, m->s.B_lo, &travel);
    for (int i = 0; i < n; i++) {
        t->travel_left[k * n + i] = braked ? most(travel.lo[i], travel.hi[i]) : STOPS_INF;
        if (!braked) continue;
        m->farthest.lo[i] = most(m->farthest.lo[i], t->d_lo[k * n + i] - travel.lo[i]);
        m->farthest.hi[i] = least(m->farthest.hi[i], t->d_hi[k * n + i] + travel.hi[i]);
    }
    if (!stops_step_energy(&m->near, &m->energy, &m->x, &m->s)) return 0;
    for (int i = 0; i < n; i++) {
        m->cap.lo[i] = -m->energy.cap[i];
        m->cap.hi[i] = m->energy.cap[i];
    }
    stops_span(n, t->v_lo + k * n, t->v_hi + k * n, &speeds);
    if (m->pulled) stops_pull_caps(&m->near, &m->x, &speeds, &m->momenta, &m->s, &m->room, &m->cap);
    m->pulled = 0;
    for (int i = 0; i < n; i++) m->pulled |= m->cap.hi[i] - m->cap.lo[i] < worth * 2.0 * m->energy.cap[i];
    for (int i = 0; i < n; i++) { /* known before any claim: speeds at this knot */
        t->v_lo[k * n + i] = most(t->v_lo[k * n + i], m->cap.lo[i]);
        t->v_hi[k * n + i] = least(t->v_hi[k * n + i], m->cap.hi[i]);
    }
    return 1;
}

/* Momenta on a step on which speeds lie in w and the energy is no more than y, as |p_i| <= sqrt(M_ii) y; those that are followed, at its end. */
static void follow_momenta(March *m, double y, const Span *w, Span *p) {
    stops_start_pulls(&m->near.at, w, p);
    for (int i = 0; i < m->n; i++) {
        const int own = i * (m->n + 1);
        const double most_own = sqrt(m->near.at.M[own] + m->near.at.dM[own]) * y * stopset_energy_rounding;
        p->lo[i] = most(p->lo[i], -most_own);
        p->hi[i] = least(p->hi[i], most_own);
    }
    if (m->pulled) stops_pull_on(&m->near, &m->s, w, &m->momenta, p);
    for (int i = 0; i < m->n; i++) {
        p->lo[i] *= m->near.parts->held;
        p->hi[i] *= m->near.parts->held;
    }
}

/* What momenta and energy know of the speeds at the end of a step. */
static void pull(March *m, double *v_lo, double *v_hi) {
    Span end;
    stops_span(m->n, v_lo, v_hi, &end);
    m->energy.y = least(m->energy.y, stops_pull_cut(&m->near, &m->momenta, &end));
    stops_cap_bands(m->n, &m->end, &end);
    stops_total(m->n, &m->end, v_lo, v_hi);
    m->energy.y = least(m->energy.y, stops_largest(&m->near.at, v_lo, v_hi));
}

/* Bands cut by the momenta of first excursions; no more, as subsets of joints are what that costs, once they have cut none after a step of
 * which accelerations are not known. */
static void tighten(March *m, int verified, double *v_lo, double *v_hi) {
    const Bands before = m->end;
    if (!m->tightens) return;
    stops_tighten(&m->end, &m->momentum, &m->near.at, v_lo, v_hi);
    m->tightens = verified || !stops_same_bands(m->n, &before, &m->end);
    stops_total(m->n, &m->end, v_lo, v_hi);
}

/* Momenta, energy, bands and displacements at the knot after step k. */
static void settle(March *m, int64_t k, double y, int verified) {
    const int n = m->n;
    double before[SN], *v_lo = m->tube->v_lo + (k + 1) * n, *v_hi = m->tube->v_hi + (k + 1) * n;
    memcpy(before, m->momentum.needed, sizeof before);
    stops_carry_on(&m->near, &m->momentum, &m->s, &m->b, &m->end, &m->v, m->retained);
    for (int i = 0; i < n; i++) m->drop[i] = before[i] < STOPS_INF ? most(before[i] - m->momentum.needed[i], 0.0) : 0.0;
    memcpy(v_lo, m->tube->e_lo + k * n, (size_t)n * sizeof *v_lo);
    memcpy(v_hi, m->tube->e_hi + k * n, (size_t)n * sizeof *v_hi);
    if (m->energetic) {
        const StopsetRange u = {m->near.plant->u_lo, m->near.plant->u_hi};
        Span excess[2], momenta, end;
        stops_power_excess(n, &m->energy.g, &u, m->s.B_lo, excess);
        stops_power_excess(n, &m->energy.g, &u, m->s.last, excess + 1);
        follow_momenta(m, most(y, m->energy.y), &m->v, &momenta);
        m->energy.y = least(m->energy.y, stops_by_power(n, y, excess, &m->v, &momenta, m->s.h));
        stops_travels_on(n, excess, &m->v, m->s.h, &m->travels);
        for (int i = 0; i < n; i++) {
            end.lo[i] = -m->energy.end[i];
            end.hi[i] = m->energy.end[i];
        }
        stops_cap_bands(n, &m->end, &end);
        stops_total(n, &m->end, v_lo, v_hi);
    }
    tighten(m, verified, v_lo, v_hi);
    if (m->energetic && m->pulled)
        pull(m, v_lo, v_hi);
    else if (m->energetic)
        m->energy.y = least(m->energy.y, stops_largest(&m->near.at, v_lo, v_hi));
    if (m->energetic) stops_cut_travels(n, m->near.parts->still * m->energy.y, &m->travels, m->tube->d_lo + (k + 1) * n, m->tube->d_hi + (k + 1) * n);
    const Bands swap = m->b;
    m->b = m->end;
    m->end = swap;
}

/* Whether all speeds are zero at the knot after step k and gravity and disturbance are surely held: so it stays. */
static int held(const March *m, int64_t k) {
    const int n = m->n;
    int surely = 1;
    for (int i = 0; i < n; i++)
        if (m->tube->v_lo[(k + 1) * n + i] != 0.0 || m->tube->v_hi[(k + 1) * n + i] != 0.0) return 0;
    for (int i = 0; i < n; i++) {
        const double load = m->near.plant->curvature.load[i];
        const double up = least(-m->near.at.h_lo[i], load) + m->near.plant->u_hi[i], down = least(m->near.at.h_hi[i], load) - m->near.plant->u_lo[i];
        m->tube->margin[i] = m->s.B_lo[i] - most(up, down);
        if (!(m->tube->margin[i] >= 0.0)) surely = 0; /* what is not a number holds nothing */
    }
    return surely;
}

static void begin(March *m, const StopsetBox *box, const double *middle) {
    const int n = m->n;
    Span x, v;
    stops_span(n, box->x_lo, box->x_hi, &m->q);
    stops_span(n, box->v_lo, box->v_hi, &v);
    stops_span(n, box->v_lo, box->v_hi, &m->v);
    memcpy(m->tube->v_lo, v.lo, (size_t)n * sizeof *v.lo);
    memcpy(m->tube->v_hi, v.hi, (size_t)n * sizeof *v.hi);
    memset(m->tube->d_lo, 0, (size_t)n * sizeof *m->tube->d_lo);
    memset(m->tube->d_hi, 0, (size_t)n * sizeof *m->tube->d_hi);
    expand(m, middle);
    for (int i = 0; i < n; i++) {
        x.lo[i] = m->q.lo[i] - m->near.E.q[i];
        x.hi[i] = m->q.hi[i] - m->near.E.q[i];
        m->tube->margin[i] = -STOPS_INF;
        m->energy.cap[i] = m->energy.end[i] = m->farthest.hi[i] = m->cap.hi[i] = STOPS_INF;
        m->cap.lo[i] = -STOPS_INF;
        m->farthest.lo[i] = -STOPS_INF;
        m->room.lo[i] = m->room.hi[i] = 0.05 * (v.hi[i] - v.lo[i]) + 0.02;
    }
    stops_start_local(n, &m->near.at);
    stops_start_bands(n, &v, &m->b);
    m->end = m->b;
    stops_start_momentum(&m->near, &x, &v, &m->b, &m->momentum);
    stops_start_pulls(&m->momentum.start, &v, &m->momenta);
    m->energy.y = stops_largest(&m->momentum.start, v.lo, v.hi);
    stops_start_travels(m->near.plant, m->near.parts->still * m->energy.y, &m->travels);
}

/* The longest step from `now`: none passes the moment at which the first brake may close, and until all have closed none is longer than `brief`. */
static double step_from(double now, double closing, double engaged, double h, double brief) {
    if (now < closing) return least(h, closing - now);
    return now < engaged ? least(h, brief) : h;
}

static int march(const StopsetPlant *plant, const StopsetBox *box, const StopsetStride *stride, const StopsetParts *parts, int related,
                 const StopsetTube *tube, int64_t *made) {
    const int n = plant->arm.n, energetic = stride->energetic;
    double middle[SN], gravity[SN], closing = STOPS_INF, engaged = -STOPS_INF, quick = 0.0, lowest = STOPS_INF;
    int idle = 0;
    March m;
    memset(&m, 0, offsetof(March, near));
    m.near.plant = plant;
    m.near.parts = parts;
    m.tube = tube;
    m.n = n;
    m.energetic = m.pulled = energetic;
    m.asked = m.tightens = 1;
    m.related = related;
    tube->t[0] = 0.0;
    for (int i = 0; i < n; i++) tube->travel_left[i] = STOPS_INF;
    for (int i = 0; i < n; i++) {
        middle[i] = 0.5 * (box->x_lo[i] + box->x_hi[i]);
        closing = least(closing, plant->delay_lo[i]);
        engaged = most(engaged, plant->delay_hi[i] + plant->rise_hi[i]);
        quick = most(quick, most(size_of(box->v_lo[i]), size_of(box->v_hi[i])));
    }
    begin(&m, box, middle);
    memcpy(gravity, m.near.E.g, sizeof gravity);
    /* bands that feed on each other grow without end; what the energy allows is finite, however fast an arm may fall */
    m.widest = energetic ? STOPS_INF : related ? 4.0 * quick + 2.0 : 20.0 * quick + 20.0;
    for (int64_t k = 0; k < stride->count; k++) {
        const double now = tube->t[k], y = m.energy.y;
        double widest = -STOPS_INF;
        const int pulled = m.pulled;
        *made = k;
        m.s.h = step_from(now, closing, engaged, stride->h, stride->brief);
        if (!prepare(&m, k, now, middle, gravity)) return UNBOUNDED;
        tube->energy[k] = energetic ? most(y, m.energy.y) : STOPS_INF;
        guess_claims(&m, k);
        const int verified = take_step(&m, k, now);
        if (!verified && !energetic) return UNBOUNDED;
        m.related = m.related && verified; /* where it does not help it costs the most */
        m.asked = !energetic || (m.asked && verified && (pulled || cuts(&m, tube->e_lo + k * n, tube->e_hi + k * n)));
        displace(&m, k);
        settle(&m, k, y, verified);
        tube->t[k + 1] = now + m.s.h;
        *made = k + 1;
        for (int i = 0; i < n; i++) tube->travel_left[(k + 1) * n + i] = STOPS_INF;
        for (int i = 0; i < n; i++) {
            const double wide = tube->v_hi[(k + 1) * n + i] - tube->v_lo[(k + 1) * n + i];
            const double span = tube->d_hi[(k + 1) * n + i] - tube->d_lo[(k + 1) * n + i];
            if (wide != wide || span != span) return UNBOUNDED; /* not a number is no bound */
            widest = most(widest, wide);
        }
        if (!(widest < m.widest)) return UNBOUNDED;
        if (now >= engaged && held(&m, k)) return OK; /* from now on nothing changes any more */
        idle = now < engaged || m.energy.y < lowest ? 0 : idle + 1;
        lowest = now < engaged ? STOPS_INF : least(lowest, m.energy.y);
        if (idle > most_idle && energetic) return ENDLESS; /* brakes gain no more torque: what they do not slow now falls on */
    }
    *made = stride->count;
    return ENDLESS;
}

/* Share of the time from when the first brake may close until all have that rows for themselves must last for columns to be worth their cost: of
 * tubes that these close, all but a few lasted that long. */
static const double lasting = 0.75;

/* Whether a tube that ended at time t lasted so. */
static int lasted(const StopsetPlant *p, double t) {
    double closing = STOPS_INF, engaged = -STOPS_INF;
    for (int i = 0; i < p->arm.n; i++) {
        closing = least(closing, p->delay_lo[i]);
        engaged = most(engaged, p->delay_hi[i] + p->rise_hi[i]);
    }
    return t >= closing + lasting * (engaged - closing);
}

int stopset_stop_tube(const StopsetPlant *plant, const StopsetBox *box, const StopsetStride *stride, const StopsetParts *parts,
                      const StopsetTube *tube, int64_t *made) {
    if (plant->arm.n < 1 || plant->arm.n > SN) return -STOPSET_TOO_MANY_JOINTS;
    const int end = march(plant, box, stride, parts, stride->energetic, tube, made);
    if (end == OK || stride->energetic || !lasted(plant, tube->t[*made])) return end;
    return march(plant, box, stride, parts, 1, tube, made);
}
