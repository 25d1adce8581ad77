/* Nonlinear abstractions: nominal motions, what deviations from them obey, corners of decoupled joints, and the set at an age.
 *
 * Identification, comparison, monitor and FMU all come through here; what the sets are stands in stopset.reach.nonlinear.
 *
 * Source: Liu & Althoff (2018), eq. (13)-(16) and Sec. IV-C.
 */
#include <string.h>

#include "stopset.h"

enum { J = STOPSET_JOINTS };
const double stopset_corner_step = 0.1;

static double absolute(double x) { return x < 0.0 ? -x : x; }

int64_t stopset_dynamics_room(const StopsetDynamics *s) {
    return s->polynomials.monomials * (1 + s->polynomials.count) + s->polynomials.count * (1 + s->polynomials.dimension) + s->polynomials.dimension;
}

/* What the polynomials look at: dq, sin q, cos q, and u for model 3. */
static void argue(const StopsetDynamics *s, const double *q, const double *dq, const double *u, double *z) {
    for (int i = 0; i < s->n; i++) {
        z[i] = dq[i];
        z[s->n + i] = stopset_sin(q[i]);
        z[2 * s->n + i] = stopset_cos(q[i]);
        if (s->kind == 3) z[3 * s->n + i] = u[i];
    }
}

static double damping(const StopsetDynamics *s, int i, double dq) {
    double out = 0.0;
    for (int k = s->orders - 1; k >= 0; k--) out = (out + s->viscous[i * s->orders + k]) * dq;
    return out;
}

void stopset_drag(const StopsetDynamics *s, const double *q, const double *dq, double *work, double *out) {
    const int64_t count = s->polynomials.count;
    double *z = work, *value = z + s->polynomials.dimension, *rest = value + count;
    for (int i = 0; i < s->n; i++) out[i] = damping(s, i, dq[i]);
    if (s->kind != 2 || !count) return;
    argue(s, q, dq, 0, z);
    stopset_polynomials(&s->polynomials, 1, z, rest, value);
    for (int i = 0; i < s->n; i++) out[i] += value[i];
}

void stopset_acceleration(const StopsetDynamics *s, const double *q, const double *dq, const double *u, double *work, double *ddq) {
    const int n = s->n;
    double left[J];
    if (s->kind == 3) {
        argue(s, q, dq, u, work);
        stopset_polynomials(&s->polynomials, 1, work, work + s->polynomials.dimension, ddq);
        return;
    }
    stopset_drag(s, q, dq, work, left);
    for (int i = 0; i < n; i++) left[i] = u[i] - left[i];
    for (int i = 0; i < n; i++) {
        ddq[i] = 0.0;
        for (int j = 0; j < n; j++) ddq[i] += s->Minv[i * n + j] * left[j];
    }
}

/* Classical Runge-Kutta over dt. */
static void advance(const StopsetDynamics *s, const double *x, const double *u, double dt, double *work, double *out) {
    const int n = s->n;
    const double *q = x, *v = x + n;
    double k1[J], k2[J], k3[J], k4[J], at[J], fast[J];
    stopset_acceleration(s, q, v, u, work, k1);
    for (int i = 0; i < n; i++) {
        at[i] = q[i] + 0.5 * dt * v[i];
        fast[i] = v[i] + 0.5 * dt * k1[i];
    }
    stopset_acceleration(s, at, fast, u, work, k2);
    for (int i = 0; i < n; i++) {
        at[i] = q[i] + 0.5 * dt * v[i] + 0.25 * dt * dt * k1[i];
        fast[i] = v[i] + 0.5 * dt * k2[i];
    }
    stopset_acceleration(s, at, fast, u, work, k3);
    for (int i = 0; i < n; i++) {
        at[i] = q[i] + dt * v[i] + 0.5 * dt * dt * k2[i];
        fast[i] = v[i] + dt * k3[i];
    }
    stopset_acceleration(s, at, fast, u, work, k4);
    for (int i = 0; i < n; i++) {
        out[i] = q[i] + dt * v[i] + dt * dt / 6.0 * (k1[i] + k2[i] + k3[i]);
        out[n + i] = v[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    }
}

void stopset_nominal(const StopsetDynamics *s, const StopsetStarts *starts, double *work, double *out) {
    const int n = s->n, m = 2 * n;
    const double *x0 = starts->x0, *u = starts->u;
    for (int64_t w = 0; w < starts->W; w++, x0 += m, out += m) {
        memcpy(out, x0, (size_t)m * sizeof *out);
        for (int64_t k = 0; k < starts->N; k++, u += n, out += m) advance(s, out, u, starts->dt, work, out + m);
    }
}

/* d ddq / d(q, dq) (n, 2n) and d ddq / du (n, n). */
static void slopes(const StopsetDynamics *s, const double *x, const double *u, double *work, double *J_x, double *J_u) {
    const int n = s->n;
    const int64_t count = s->polynomials.count, d = s->polynomials.dimension;
    double *z = work, *P = z + d, *rest = P + count * d, own[J];
    memset(J_x, 0, (size_t)(2 * n * n) * sizeof *J_x);
    if (count) {
        argue(s, x, x + n, u, z);
        stopset_polynomial_slopes(&s->polynomials, 1, z, rest, P);
    }
    for (int i = 0; i < n; i++) {
        double power = 1.0;
        own[i] = 0.0;
        for (int k = 0; k < s->orders; k++, power *= x[n + i]) own[i] += (k + 1) * s->viscous[i * s->orders + k] * power;
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double by_q = 0.0, by_dq = 0.0;
            for (int k = s->kind == 3 ? i : 0; k < (s->kind == 3 ? i + 1 : n); k++) {
                /* the angle moves its sine and cosine: d sin = c dq, d cos = -s dq */
                const double *row = P + k * d;
                const double angle = count ? row[n + j] * z[2 * n + j] - row[2 * n + j] * z[n + j] : 0.0;
                const double speed = (count ? row[j] : 0.0) + (s->kind != 3 && k == j ? own[j] : 0.0);
                const double gain = s->kind == 3 ? 1.0 : -s->Minv[i * n + k];
                by_q += gain * angle;
                by_dq += gain * speed;
            }
            J_x[i * 2 * n + j] = by_q;
            J_x[i * 2 * n + n + j] = by_dq;
            J_u[i * n + j] = s->kind == 3 ? P[i * d + 3 * n + j] : s->Minv[i * n + j];
        }
}

void stopset_linearised(const StopsetDynamics *s, int64_t N, const double *x, const double *u, double *work, double *J_x, double *J_u) {
    const int n = s->n;
    for (int64_t k = 0; k < N; k++) slopes(s, x + 2 * n * k, u + n * k, work, J_x + 2 * n * n * k, J_u + n * n * k);
}

int64_t stopset_ahead_room(const StopsetDynamics *s, int64_t H) {
    const int64_t n = s->n, m = 2 * n;
    return stopset_dynamics_room(s) + (H + 1) * (n * m + n * n + n + m * m + 2 * m * n) + 3 * H * m * n;
}

int stopset_ahead(const StopsetDynamics *s, const StopsetSets *sets, const StopsetNominal *nominal, double *work, double *lo, double *hi) {
    const int n = s->n, m = 2 * n;
    const int64_t H = nominal->H;
    const double *path = nominal->path, *u = nominal->u;
    double *held = work + stopset_dynamics_room(s), *J_x = held + (H + 1) * n, *J_u = J_x + (H + 1) * n * m, *E1 = J_u + (H + 1) * n * n;
    double *plus = E1 + (H + 1) * m * m, *minus = plus + (H + 1) * m * n, *rest = minus + (H + 1) * m * n;
    if (H > 0) {
        memcpy(held, u, (size_t)(H * n) * sizeof *held);
        memcpy(held + H * n, u + (H - 1) * n, (size_t)n * sizeof *held);
        stopset_linearised(s, H + 1, path, held, work, J_x, J_u);
    }
    const StopsetResponses all = {H + 1, m, m, n, E1, plus, minus};
    const StopsetResponses last = {1, m, m, n, E1 + H * m * m, plus + H * m * n, minus + H * m * n};
    const int code = stopset_along(n, H, J_x, J_u, nominal->dt, &all, rest);
    if (code) return code;
    stopset_hulls(&last, sets, lo, hi);
    for (int i = 0; i < m; i++) {
        lo[i] = path[H * m + i] + lo[i];
        hi[i] = path[H * m + i] + hi[i];
    }
    stopset_read(m, sets, 0x1p-42, lo, hi);
    return STOPSET_OK;
}

void stopset_read(int m, const StopsetSets *sets, double round, double *lo, double *hi) {
    for (int i = 0; i < m; i++) {
        const double first = lo[i] + sets->V_lo[i], last = hi[i] + sets->V_hi[i];
        /* some thousand additions in double precision, rounded outward */
        const double slack = round * (absolute(first) > absolute(last) ? absolute(first) : absolute(last));
        lo[i] = sets->position_only && i >= m / 2 ? -1.0 / 0.0 : first - slack;
        hi[i] = sets->position_only && i >= m / 2 ? 1.0 / 0.0 : last + slack;
    }
}

int64_t stopset_parts(const StopsetDynamics *s, double dt, double speed) {
    double rate = 0.0;
    for (int i = 0; i < s->n; i++) {
        double slope = 0.0, power = 1.0;
        for (int k = 0; k < s->orders; k++, power *= speed) slope += absolute(s->viscous[i * s->orders + k]) * ((k + 1) * power);
        slope *= s->Minv[i * s->n + i];
        rate = slope > rate ? slope : rate;
    }
    const double most = dt * rate / stopset_corner_step;
    if (!(most < STOPSET_MOST_PARTS)) return STOPSET_MOST_PARTS; /* nor is what is no number made into a whole one */
    const int64_t whole = (int64_t)most;
    return most <= 1.0 ? 1 : whole + (most > (double)whole);
}

void stopset_corners(const StopsetDynamics *s, int64_t N, const double *u, double h, int64_t parts, double most, double *z) {
    const int n = s->n;
    for (int64_t r = 0; r < N; r++, z += 2 * n)
        for (int i = 0; i < n; i++) {
            double c[STOPSET_DAMPING], out[4];
            const double gain = s->Minv[i * n + i], w = gain * u[i];
            for (int k = 0; k < s->orders; k++) c[k] = gain * s->viscous[i * s->orders + k];
            const StopsetJoint joint = {s->orders, c, h / (double)parts, 1};
            for (int64_t part = 0; part < parts; part++) {
                stopset_corner(&joint, z[i], z[n + i], 1, &w, out);
                z[i] = out[2];
                z[n + i] = out[3] > most ? most : out[3] < -most ? -most : out[3];
            }
        }
}
