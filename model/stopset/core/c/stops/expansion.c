/* Inertia, gravity and Christoffel symbols near a pose: value, exact slope and the inertia's exact second slope, by turning
 * composite bodies about each axis; and the roots of inertia L_ab that bound its third slopes.
 *
 * Source: Featherstone (2008), ch. 2; Wensing et al. (2018) for the pseudo-inertia. The bounds of what lies beyond are told in
 * stopset.reach.stops.expansion.
 */
#include <math.h>
#include <string.h>

#include "../vectors.h"
#include "stops.h"

/* Angular momentum about the base origin, then linear momentum. */
typedef struct {
    double l[3], p[3];
} Wrench;

typedef struct {
    int n;
    double R[9 * SN], o[3 * SN], z[3 * SN], s[3 * SN]; /* link frames; twists of the joints */
    double mass[SN], moment[3 * SN], inertia[9 * SN];  /* composite bodies from joint i on, about the base origin, in base axes */
    double turn_moment[3 * SN], turn_inertia[9 * SN];  /* how these change as they turn about axis i */
    Wrench own[SN], rate[SN][SN]; /* momentum of what joint j turns, at its unit speed; how that changes with the angle of joint k > 0 */
} Bodies;

/* Points r of a body move with z x r + s: so do m r, summed, and m (r.r 1 - r r'). */
static void turn_composite(Bodies *b, int i) {
    const double *z = b->z + 3 * i, *s = b->s + 3 * i, *h = b->moment + 3 * i, *I = b->inertia + 9 * i, hs = 2.0 * dot(h, s);
    double zI[3][3]; /* its columns: z x those of I, which is symmetric */
    cross(z, h, b->turn_moment + 3 * i);
    for (int r = 0; r < 3; r++) {
        b->turn_moment[3 * i + r] += b->mass[i] * s[r];
        cross(z, I + 3 * r, zI[r]);
    }
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) b->turn_inertia[9 * i + 3 * r + c] = zI[c][r] + zI[r][c] - (s[r] * h[c] + h[r] * s[c]) + (r == c ? hs : 0.0);
}

static void composites(const double *pi, Bodies *b) {
    for (int i = b->n - 1; i >= 0; i--) {
        const double *P = pi + 10 * i, *R = b->R + 9 * i, *p = b->o + 3 * i;
        const double T[9] = {P[4], P[5], P[7], P[5], P[6], P[8], P[7], P[8], P[9]};
        double h[3], A[9];
        times(R, P + 1, h);
        product(R, T, A);
        const double hp = 2.0 * (h[0] * p[0] + h[1] * p[1] + h[2] * p[2]) + P[0] * (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
        for (int r = 0; r < 3; r++)
            for (int c = 0; c < 3; c++) {
                double x = dot(A + 3 * r, R + 3 * c) - (h[r] * p[c] + p[r] * h[c] + P[0] * p[r] * p[c]);
                x += r == c ? hp : 0.0;
                b->inertia[9 * i + 3 * r + c] = x + (i + 1 < b->n ? b->inertia[9 * i + 9 + 3 * r + c] : 0.0);
            }
        for (int r = 0; r < 3; r++) b->moment[3 * i + r] = h[r] + P[0] * p[r] + (i + 1 < b->n ? b->moment[3 * i + 3 + r] : 0.0);
        b->mass[i] = P[0] + (i + 1 < b->n ? b->mass[i + 1] : 0.0);
        turn_composite(b, i);
    }
}

/* Momentum of the body from joint k on that turns with w and moves with v at the base origin. */
static Wrench momentum_of(const Bodies *b, int k, const double *w, const double *v) {
    Wrench f;
    double x[3];
    times(b->inertia + 9 * k, w, f.l);
    cross(b->moment + 3 * k, v, x);
    for (int r = 0; r < 3; r++) f.l[r] += x[r];
    cross(w, b->moment + 3 * k, x);
    for (int r = 0; r < 3; r++) f.p[r] = b->mass[k] * v[r] + x[r];
    return f;
}

/* The same of one that does not turn. */
static Wrench pushed(const Bodies *b, int k, const double *v) {
    Wrench f;
    cross(b->moment + 3 * k, v, f.l);
    for (int r = 0; r < 3; r++) f.p[r] = b->mass[k] * v[r];
    return f;
}

/* How a wrench changes when all of it turns along with the twist of joint k. */
static Wrench turned(const Bodies *b, int k, const Wrench *f) {
    Wrench out;
    double x[3];
    cross(b->z + 3 * k, f->l, out.l);
    cross(b->s + 3 * k, f->p, x);
    for (int r = 0; r < 3; r++) out.l[r] += x[r];
    cross(b->z + 3 * k, f->p, out.p);
    return out;
}

/* Power along the twist of joint i. */
static double along(const Bodies *b, int i, const Wrench *f) {
    const double *z = b->z + 3 * i, *s = b->s + 3 * i;
    return z[0] * f->l[0] + z[1] * f->l[1] + z[2] * f->l[2] + s[0] * f->p[0] + s[1] * f->p[1] + s[2] * f->p[2];
}

static Wrench less(Wrench a, const Wrench *b) {
    for (int r = 0; r < 3; r++) {
        a.l[r] -= b->l[r];
        a.p[r] -= b->p[r];
    }
    return a;
}

/* How the twist (w, v) changes when it turns along with the twist of joint k. */
static void moved(const Bodies *b, int k, const double *w, const double *v, double *dw, double *dv) {
    double x[3];
    cross(b->z + 3 * k, v, dv);
    cross(b->s + 3 * k, w, x);
    cross(b->z + 3 * k, w, dw);
    for (int r = 0; r < 3; r++) dv[r] += x[r];
}

/* The bodies from k on turn under a motion (w, v) that does not: how its momentum changes. */
static Wrench behind(const Bodies *b, int k, const double *w, const double *v) {
    const double *moment = b->turn_moment + 3 * k;
    Wrench f;
    double x[3];
    times(b->turn_inertia + 9 * k, w, f.l);
    cross(moment, v, x);
    for (int r = 0; r < 3; r++) f.l[r] += x[r];
    cross(w, moment, f.p);
    return f;
}

/* What turns about axis k gives a momentum's rate: joint j with it, or the bodies behind joint j's own turn. */
static void momenta(Bodies *b) {
    for (int j = 0; j < b->n; j++) {
        const double *z = b->z + 3 * j, *s = b->s + 3 * j;
        b->own[j] = momentum_of(b, j, z, s);
        for (int k = 1; k < b->n; k++) b->rate[j][k] = k <= j ? turned(b, k, b->own + j) : behind(b, k, z, s);
    }
}

/* Second slopes of M: the picture of a rate turns about axis o <= k. */
static void bends(const Bodies *b, double *ddM) {
    const int n = b->n;
    for (int j = 0; j < n; j++)
        for (int k = 1; k < n; k++)
            for (int o = 1; o <= k; o++) {
                Wrench y = turned(b, o, &b->rate[j][k]);
                if (o > j) {
                    double w[3], v[3];
                    moved(b, o, b->z + 3 * j, b->s + 3 * j, w, v);
                    const Wrench along_with = behind(b, k, w, v);
                    y = less(y, &along_with);
                }
                for (int i = 0; i <= j && i < o; i++) {
                    const int m = n - 1 - i, at = bends_of(n, i, j);
                    ddM[at + (k - i - 1) * m + o - i - 1] = ddM[at + (o - i - 1) * m + k - i - 1] = along(b, i, &y);
                }
            }
}

/* Share of a pseudo-inertia's trace by which its least eigenvalue may be below zero: what rounding leaves of a point mass. */
static const double thin = 1e-12;

/* Half the trace of the inertia tensor, and the mass: the trace of the pseudo-inertia [[S, h], [h', m]], S = that - tensor. */
static double trace_of(const double *P) { return P[0] + 0.5 * (P[4] + P[6] + P[9]); }

/* Whether a link's parameters are those of a body of positive masses: pseudo-inertia + thin * trace positive definite. */
static int is_body(const double *P) {
    const double half = 0.5 * (P[4] + P[6] + P[9]), trace = trace_of(P), shift = thin * trace;
    double A[4][4] = {{half - P[4] + shift, -P[5], -P[7], P[1]},
                      {-P[5], half - P[6] + shift, -P[8], P[2]},
                      {-P[7], -P[8], half - P[9] + shift, P[3]},
                      {P[1], P[2], P[3], P[0] + shift}};
    if (!(trace > 0.0)) {
        for (int r = 0; r < 10; r++)
            if (P[r] != 0.0) return 0;
        return 1;
    }
    for (int c = 0; c < 4; c++) {
        if (!(A[c][c] > 0.0)) return 0;
        for (int r = c + 1; r < 4; r++)
            for (int k = c + 1; k < 4; k++) A[r][k] -= A[r][c] / A[c][c] * A[c][k];
    }
    return 1;
}

/* Squares of L_ab, and which bodies are solid, go on with the links' parameters `pi`. With 2 `thin` on each eigenvalue a link
 * is a body, and what was put on it is one too: eight times `thin`; the rest is for rounding. */
static void inertia_roots(const Bodies *b, const double *pi, Expansion *E) {
    const int n = b->n;
    double slack[SN] = {0};
    for (int k = n - 1; k >= 0; k--) {
        const double *P = pi + 10 * k, *o = b->o + 3 * k, trace = most(trace_of(P), 0.0), away = sqrt(dot(o, o));
        E->solid[k] = E->solid[k] && (k + 1 == n || E->solid[k + 1]) && is_body(P);
        for (int a = 0; a <= k; a++) {
            const double *za = b->z + 3 * a, *sa = b->s + 3 * a, *oa = b->o + 3 * a, far = 1.0 + away + sqrt(dot(oa, oa));
            const Wrench f = momentum_of(b, k, za, sa);
            slack[a] += 10.0 * thin * trace * far * far;
            E->root[a * n + k] += most(along(b, a, &f), 0.0) + slack[a];
        }
    }
}

static void slopes(Bodies *b, const double *pi, const double *gravity, const StopsetExpansion *out) {
    double *M = out->M, *dM = out->dM, *g = out->g, *dg = out->dg, *Gamma = out->Gamma, x[3 * SN];
    const int n = b->n;
    Wrench weight[SN];
    composites(pi, b);
    momenta(b);
    memset(dM, 0, (size_t)(n * n * n) * sizeof *dM);
    for (int k = 0; k < n; k++) {
        const Wrench own = pushed(b, k, gravity);
        g[k] = -along(b, k, &own);
        weight[k] = turned(b, k, &own);
        cross(b->z + 3 * k, gravity, x + 3 * k);
    }
    for (int j = 0; j < n; j++) {
        for (int i = 0; i <= j; i++) M[i * n + j] = M[j * n + i] = along(b, i, b->own + j);
        for (int k = 1; k < n; k++)
            for (int i = 0; i < k && i <= j; i++) dM[(i * n + j) * n + k] = dM[(j * n + i) * n + k] = along(b, i, &b->rate[j][k]);
        for (int k = 0; k < n; k++) {
            const Wrench w = pushed(b, j > k ? j : k, x + 3 * k);
            dg[j * n + k] = along(b, j, &w);
            if (k > j) dg[j * n + k] -= along(b, j, weight + k);
        }
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++)
            for (int j = 0; j < n; j++)
                Gamma[(k * n + j) * n + i] = 0.5 * (dM[(i * n + k) * n + j] + dM[(i * n + j) * n + k] - dM[(k * n + j) * n + i]);
}

void stops_expand(const StopsetArm *arm, const double *pi_half, const double *rotor, const double *q, Expansion *E) {
    const int n = arm->n;
    const StopsetExpansion middle = {E->M, E->dM, E->g, E->dg, E->Gamma}, half = {E->Mp, E->dMp, E->gp, E->dgp, E->Gammap};
    Bodies b;
    b.n = E->n = n;
    E->loaded = 0;
    stopset_link_frames(arm, 1, q, b.R, b.o);
    memcpy(E->q, q, (size_t)n * sizeof *q);
    for (int i = 0; i < n; i++) {
        times(b.R + 9 * i, arm->axis + 3 * i, b.z + 3 * i);
        cross(b.o + 3 * i, b.z + 3 * i, b.s + 3 * i);
    }
    for (int i = 0; i < n; i++) E->solid[i] = 1;
    memset(E->root, 0, (size_t)(n * n) * sizeof *E->root);
    slopes(&b, arm->pi, arm->gravity, &middle);
    bends(&b, E->ddM);
    inertia_roots(&b, arm->pi, E);
    for (int i = 0; i < n; i++) E->M[i * n + i] += rotor[i];
    for (int r = 0; r < 10; r++) E->loaded |= pi_half[10 * (n - 1) + r] != 0.0;
    if (E->loaded) {
        slopes(&b, pi_half, arm->gravity, &half);
        bends(&b, E->ddMp);
        inertia_roots(&b, pi_half, E);
    } else {
        const size_t one = (size_t)n * sizeof(double), two = one * (size_t)n, three = two * (size_t)n;
        memset(E->Mp, 0, two);
        memset(E->dMp, 0, three);
        memset(E->gp, 0, one);
        memset(E->dgp, 0, two);
        memset(E->Gammap, 0, three);
    }
    for (int i = 0; i < n * n; i++) E->root[i] = sqrt(E->root[i]);
}

int stopset_expand(const StopsetArm *arm, const double *pi_half, const double *rotor, const double *q, const StopsetExpansion *middle,
                   const StopsetExpansion *half) {
    const int n = arm->n;
    Expansion E;
    if (n < 1 || n > SN) return STOPSET_TOO_MANY_JOINTS;
    const size_t one = (size_t)n * sizeof(double), two = one * (size_t)n, three = two * (size_t)n;
    stops_expand(arm, pi_half, rotor, q, &E);
    memcpy(middle->M, E.M, two);
    memcpy(middle->dM, E.dM, three);
    memcpy(middle->g, E.g, one);
    memcpy(middle->dg, E.dg, two);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n * n; k++) {
            middle->Gamma[i * n * n + k] = E.Gamma[k * n + i];
            half->Gamma[i * n * n + k] = E.Gammap[k * n + i];
        }
    memcpy(half->M, E.Mp, two);
    memcpy(half->dM, E.dMp, three);
    memcpy(half->g, E.gp, one);
    memcpy(half->dg, E.dgp, two);
    return STOPSET_OK;
}
