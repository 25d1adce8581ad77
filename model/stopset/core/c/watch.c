/* The monitor's cycle: the input of a sample and how far it is unknown, the comparison, and predictions that start.
 *
 * Source: Liu & Althoff (2018), Def. 2 and eq. (17)-(21).
 */
#include <string.h>

#include "inputs.h"
#include "maths.h"

enum { J = STOPSET_JOINTS, X = 2 * STOPSET_JOINTS };

static double absolute(double x) { return x < 0.0 ? -x : x; }
static double larger(double a, double b) { return a > b ? a : b; }
static double smaller(double a, double b) { return a < b ? a : b; }

/* The five samples that rounding may have made of one: itself, the speed and the position up and down. */
static int around(const StopsetMonitor *m, const double *q, const double *dq, double *qs, double *dqs) {
    static const double by[5][2] = {{0, 0}, {0, 1}, {0, -1}, {1, 0}, {-1, 0}};
    const int n = m->map->arm.n;
    int rounded = 0;
    for (int i = 0; i < n; i++) rounded |= m->quantum_q[i] != 0.0 || m->quantum_dq[i] != 0.0;
    const int rows = rounded ? 5 : 1;
    for (int k = 0; k < rows; k++)
        for (int i = 0; i < n; i++) {
            qs[k * n + i] = q[i] + by[k][0] * m->quantum_q[i];
            dqs[k * n + i] = dq[i] + by[k][1] * m->quantum_dq[i];
        }
    return rows;
}

/* dz/dt = b + a z over dt with b, a held: exact. */
static double stepped(double z, double b, double a, double dt) {
    const double x = a * dt, grown = absolute(x) < 1e-12 ? 1.0 : stopset_expm1(x) / x;
    return z + (b + a * z) * dt * grown;
}

/* What the unknown part of one state changes, added to `half`; its interval goes on to the next sample. */
static void carry(const StopsetMonitor *m, const StopsetCarried *c, int rows, const StopsetSamples *s, const StopsetRigid *rigid,
                  double *ends, double *half) {
    const StopsetLaw *law = m->map->law + c->law;
    const double lo = ends[0], hi = ends[1], width = 0.5 * (hi - lo);
    double signals[STOPSET_SIGNALS][ROWS], at[2][ROWS], slope = 0.0, first = 0.0, last = 0.0;
    int begun = 0;
    memset(signals, 0, sizeof signals);
    for (int place = 0; place < m->places; place++) {
        StopsetSamples here = *s;
        here.warm = m->warm[place];
        for (int direction = -1; direction <= 1; direction += 2) { /* at rest friction may take either direction */
            stopset_law_signals(m->map, law, &(StopsetLook){rows, 1, direction}, &here, rigid, signals);
            for (int z = 0; z < 2; z++) {
                for (int k = 0; k < rows; k++) signals[S_MEMORY][k] = z;
                stopset_play(&law->torque, (const double(*)[ROWS])signals, rows, at[z]);
            }
            for (int k = 0; k < rows; k++) slope = larger(slope, absolute(at[1][k] - at[0][k]));
        }
        stopset_law_signals(m->map, law, &(StopsetLook){rows, 1, 0.0}, &here, rigid, signals);
        for (int z = 0; z < 2; z++) {
            for (int k = 0; k < rows; k++) signals[S_MEMORY][k] = z;
            stopset_play(&c->rate, (const double(*)[ROWS])signals, rows, at[z]);
        }
        for (int k = 0; k < rows; k++) {
            const double b = at[0][k], a = at[1][k] - b, low = stepped(lo, b, a, m->dt), high = stepped(hi, b, a, m->dt);
            first = begun ? smaller(first, low) : low;
            last = begun ? larger(last, high) : high;
            begun = 1;
        }
    }
    half[law->joint] += slope * width;
    ends[0] = first;
    ends[1] = last;
}

/* Unknown states: du grows by what they can change; a joint that may have stood still counts as still too. */
static void remembered(const StopsetMonitor *m, int rows, const StopsetSamples *s, double *ends, double *du) {
    const int n = m->map->arm.n;
    double qs[6 * J], dqs[6 * J], temps[6 * J], half[J] = {0};
    StopsetSamples all = *s;
    StopsetRigid rigid;
    memcpy(qs, s->q, (size_t)(rows * n) * sizeof *qs);
    memcpy(dqs, s->dq, (size_t)(rows * n) * sizeof *dqs);
    for (int i = 0; i < n; i++) {
        qs[rows * n + i] = qs[i];
        dqs[rows * n + i] = absolute(dqs[i]) <= larger(m->quantum_dq[i], m->map->standstill[i]) ? 0.0 : dqs[i];
    }
    for (int k = 0; s->temp && k <= rows; k++) memcpy(temps + k * n, s->temp, (size_t)n * sizeof *temps);
    all.q = qs;
    all.dq = dqs;
    all.temp = s->temp ? temps : 0;
    all.memory = 0;
    memset(&rigid, 0, sizeof rigid);
    if (m->map->needs) stopset_rigid_signals(m->map, rows + 1, qs, dqs, 0, &rigid);
    for (int c = 0; c < m->states; c++) carry(m, m->carried + c, rows + 1, &all, &rigid, ends + 2 * c, half);
    for (int i = 0; i < n; i++) du[i] += half[i];
}

int stopset_sample_input(const StopsetMonitor *m, const StopsetSamples *sample, double *ends, double *u, double *du) {
    const double *q = sample->q, *dq = sample->dq, *tau = sample->tau, *temp = sample->temp;
    const int n = m->map->arm.n;
    double qs[5 * J], dqs[5 * J], taus[5 * J], temps[5 * J], memory[5 * STOPSET_CARRIED], us[2][5 * J];
    if (n < 1 || n > J || m->states > STOPSET_CARRIED) return STOPSET_TOO_MANY_JOINTS;
    const int rows = m->plain ? 1 : around(m, q, dq, qs, dqs);
    for (int k = 0; k < rows; k++) {
        memcpy(taus + k * n, tau, (size_t)n * sizeof *taus);
        if (temp) memcpy(temps + k * n, temp, (size_t)n * sizeof *temps);
        for (int c = 0; c < m->states; c++) memory[k * m->states + m->map->law[m->carried[c].law].memory] = (ends[2 * c] + ends[2 * c + 1]) / 2.0;
    }
    StopsetSamples s = {m->plain ? q : qs, m->plain ? dq : dqs, taus, temp ? temps : 0, 0, 0, memory, m->warm[0]};
    if (m->plain) {
        memcpy(du, m->quantum_tau, (size_t)n * sizeof *du);
        return stopset_inputs(m->map, 1, &s, u);
    }
    for (int place = 0; place < m->places; place++) {
        s.warm = m->warm[place];
        stopset_inputs(m->map, rows, &s, us[place]);
    }
    const double *a = us[0], *b = us[m->places - 1];
    for (int i = 0; i < n; i++) {
        double most = 0.0;
        u[i] = 0.5 * (a[i] + b[i]);
        for (int place = 0; rows > 1 && place < m->places; place++) {
            const double *x = us[place];
            const double v = larger(absolute(x[n + i] - x[i]), absolute(x[2 * n + i] - x[i]));
            const double p = larger(absolute(x[3 * n + i] - x[i]), absolute(x[4 * n + i] - x[i]));
            most = larger(most, v + p);
        }
        du[i] = m->quantum_tau[i] / m->map->gain[i] + 0.5 * absolute(b[i] - a[i]) + most;
    }
    if (m->states) remembered(m, rows, &s, ends, du);
    return STOPSET_OK;
}

int64_t stopset_beyond(int64_t N, const double *x, const double *lo, const double *hi, const double *slack) {
    int64_t count = 0;
    for (int64_t k = 0; k < N; k++) count += x[k] < lo[k] - slack[k] || x[k] > hi[k] + slack[k];
    return count;
}

int stopset_sound(int64_t N, const double *x, double most) {
    for (int64_t k = 0; k < N; k++)
        if (!(absolute(x[k]) <= most)) return 0;
    return 1;
}

int64_t stopset_tightest(int64_t count, int64_t n, const double *lo, const double *hi, const double *cost, const double *x,
                         const double *slack) {
    int64_t best = -1;
    for (int64_t k = 0; k < count; k++) {
        int64_t i = 0;
        while (i < n && x[i] - slack[i] >= lo[k * n + i] && x[i] + slack[i] <= hi[k * n + i]) i++;
        if (i == n && (best < 0 || cost[k] < cost[best])) best = k;
    }
    return best;
}

int stopset_readable(const StopsetCheck *w, int temp) {
    const int n = w->monitor->map->arm.n;
    int zero = 1;
    if (n < 1 || n > J) return STOPSET_TOO_MANY_JOINTS;
    if (!stopset_sound((temp ? 4 : 3) * n, w->here, w->most)) return STOPSET_NOT_A_NUMBER;
    for (int i = 0; i < 3 * n; i++) zero &= w->here[i] == 0.0;
    return zero ? STOPSET_ALL_ZERO : STOPSET_OK;
}

int stopset_look(StopsetCheck *w, int temp) {
    const StopsetMonitor *m = w->monitor;
    const int n = m->map->arm.n;
    const double *q = w->here, *lo = w->domain_lo, *hi = w->domain_hi;
    double none[J] = {0}, du[J];
    const StopsetSamples sample = {.q = q, .dq = q + n, .tau = q + 2 * n, .temp = temp ? q + 3 * n : 0};
    const int code = stopset_sample_input(m, &sample, w->ends, w->u, w->du);
    if (code) return code;
    for (int i = 0; i < n; i++) du[i] = w->du[i] + 1e-12; /* bus rounding is given the benefit */
    w->outside = stopset_beyond(n, q, lo, hi, m->quantum_q) + stopset_beyond(n, q + n, lo + n, hi + n, m->quantum_dq) +
                 stopset_beyond(n, w->u, lo + 2 * n, hi + 2 * n, du);
    if (temp && w->temperatures) w->outside += stopset_beyond(n, q + 3 * n, lo + 3 * n, hi + 3 * n, none);
    return STOPSET_OK;
}

int stopset_compare(StopsetCheck *w, const double *x) {
    const StopsetMonitor *m = w->monitor;
    const int n = m->map->arm.n;
    double added[J];
    /* what rounding of the torque adds stands in the tube's limits already where inputs are plain */
    for (int i = 0; i < n; i++) added[i] = !m->plain ? w->du[n + i] : w->widen ? w->du[n + i] - m->quantum_tau[i] : 0.0;
    const StopsetReading reading = {x, w->x, w->u + n, added};
    w->live = stopset_advance(w->predictions, &reading, w->outside != 0, w->widen, w->seen);
    return w->live < 0 ? STOPSET_TOO_MANY_JOINTS : STOPSET_OK;
}

void stopset_launch(StopsetCheck *w) {
    const StopsetPredictions *s = w->predictions;
    const int64_t row = w->place, n2 = s->states;
    w->since++;
    if (w->known && (!w->sliding || w->since < w->every)) return;
    w->since = 0;
    w->place = (row + 1) % s->rows;
    memset(s->e + row * n2, 0, (size_t)n2 * sizeof *s->e);
    memcpy(s->w + row * n2, w->start, (size_t)n2 * sizeof *s->w);
    s->age[row] = 0;
    s->foreign[row] = w->outside != 0;
}

void stopset_keep(StopsetCheck *w, const double *x) {
    const int64_t n = w->predictions->states / 2;
    memcpy(w->u + n, w->u, (size_t)n * sizeof *w->u);
    memcpy(w->du + n, w->du, (size_t)n * sizeof *w->du);
    memcpy(w->x, x, (size_t)(2 * n) * sizeof *x);
    w->known = 1;
}

int stopset_next(StopsetCheck *w, int temp) {
    int code = stopset_readable(w, temp);
    if (!code) code = stopset_look(w, temp);
    if (!code) code = stopset_compare(w, w->here);
    if (code) return code;
    /* what is refuted itself predicts nothing: one bad sample counts once */
    if (!w->seen[1]) stopset_launch(w);
    stopset_keep(w, w->here);
    return STOPSET_OK;
}
