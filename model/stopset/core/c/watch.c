/* The monitor's cycle: the input of a sample and how far it is unknown, every prediction one step on, and the comparison.
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
        for (int way = -1; way <= 1; way += 2) { /* at rest friction may take either direction */
            stopset_law_signals(m->map, law, law->joint, rows, &here, rigid, way, 1, signals);
            for (int z = 0; z < 2; z++) {
                for (int k = 0; k < rows; k++) signals[S_MEMORY][k] = z;
                stopset_play(&law->torque, (const double(*)[ROWS])signals, rows, at[z]);
            }
            for (int k = 0; k < rows; k++) slope = larger(slope, absolute(at[1][k] - at[0][k]));
        }
        stopset_law_signals(m->map, law, law->joint, rows, &here, rigid, 0.0, 1, signals);
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

int stopset_sample_input(const StopsetMonitor *m, const double *q, const double *dq, const double *tau, const double *temp, double *ends,
                         double *u, double *du) {
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

/* Coefficients of one step where a joint's position and speed depend on nothing but these two: rows (4, n) of position by
 * position and speed, speed by position and speed. 0 if joints are coupled. */
static int own_steps(const StopsetPredictions *s, double own[4][J]) {
    const int n = s->states / 2, n2 = 2 * n;
    for (int i = 0; i < n2; i++)
        for (int j = 0; j < n2; j++)
            if (s->Ad[i * n2 + j] != 0.0 && j % n != i % n) return 0;
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 4; k++) own[k][i] = s->Ad[(k / 2 * n + i) * n2 + k % 2 * n + i];
    return 1;
}

/* e <- Ad e + r of one row. */
static void step_own(int n, double own[4][J], const double *r, double *restrict e) {
    for (int i = 0; i < n; i++) {
        const double q = r[i] + own[0][i] * e[i] + own[1][i] * e[n + i], v = r[n + i] + own[2][i] * e[i] + own[3][i] * e[n + i];
        e[i] = q;
        e[n + i] = v;
    }
}

static void step_coupled(int n2, const double *Ad, const double *r, double *e) {
    double new[X];
    for (int i = 0; i < n2; i++) {
        double sum = r[i];
        for (int j = 0; j < n2; j++) sum += Ad[i * n2 + j] * e[j];
        new[i] = sum;
    }
    memcpy(e, new, (size_t)n2 * sizeof *e);
}

/* Row p against the tube at its age, where something is outside or nearer to a bound than all before. */
static void look_closely(const StopsetPredictions *s, int64_t p, double worst[2][X]) {
    const int n2 = s->states;
    const double *e = s->e + p * n2, *w = s->w + p * n2, *lo = s->lo + s->age[p] * n2, *hi = s->hi + s->age[p] * n2;
    const double inf = 1.0 / 0.0;
    for (int i = 0; i < n2; i++) {
        const double low = lo[i] - w[i], high = hi[i] + w[i], width = high - low, over = e[i] - high, under = low - e[i];
        /* written so that what is not a number is outside */
        if (!(over <= 0.0 || high == inf) && !(over / width <= worst[0][i])) {
            worst[0][i] = over / width;
            s->row[i] = p;
        }
        if (!(under <= 0.0 || low == -inf) && !(under / width <= worst[1][i])) {
            worst[1][i] = under / width;
            s->row[n2 + i] = p;
        }
        if (width > 0.0 && width < inf) {
            const double room = -2.0 * (over > under ? over : under) / width;
            if (room < s->room[i]) s->room[i] = room;
        }
    }
}

/* Whether row p asks for a closer look: most are well inside, and no division is needed to see it. */
static int remarkable(const StopsetPredictions *s, int64_t p) {
    const int n2 = s->states;
    const double *e = s->e + p * n2, *w = s->w + p * n2, *lo = s->lo + s->age[p] * n2, *hi = s->hi + s->age[p] * n2, *room = s->room;
    double count = 0.0;
    for (int i = 0; i < n2; i++) {
        const double low = lo[i] - w[i], high = hi[i] + w[i], over = e[i] - high, under = low - e[i], most = over > under ? over : under;
        const double bound = room[i] * (high - low), slack = 1e-12 * absolute(bound); /* beyond what the division rounds */
        count += over <= 0.0 ? 0.0 : 1.0;
        count += under <= 0.0 ? 0.0 : 1.0;
        count += -2.0 * most <= bound + slack ? 1.0 : 0.0;
    }
    return count > 0.0;
}

int64_t stopset_advance(const StopsetPredictions *s, const double *x, const double *before, const double *u, const double *du, int outside,
                        int widen, int64_t seen[2]) {
    const int n2 = s->states, n = n2 / 2;
    double residual[X], dw[X], worst[2][X] = {{0}}, own[4][J], wide[4][J], size[X * X];
    int64_t live = 0;
    if (n < 1 || n > J) return -1;
    seen[0] = seen[1] = 0;
    for (int i = 0; i < n2; i++) {
        double sum = 0.0, push = 0.0, more = 0.0;
        for (int j = 0; j < n2; j++) sum += s->Ad[i * n2 + j] * before[j];
        for (int j = 0; j < n; j++) {
            push += s->Bd[i * n + j] * u[j];
            more += absolute(s->Bd[i * n + j]) * du[j];
        }
        residual[i] = x[i] - sum - push;
        dw[i] = more;
        s->room[i] = 1.0 / 0.0;
        s->row[i] = s->row[n2 + i] = -1;
    }
    const int apart = own_steps(s, own);
    for (int k = 0; k < 4 * n; k++) wide[k / n][k % n] = absolute(own[k / n][k % n]);
    for (int k = 0; !apart && widen && k < n2 * n2; k++) size[k] = absolute(s->Ad[k]);
    for (int64_t p = 0; p < s->rows; p++) {
        if (s->age[p] < 0) continue;
        if (++s->age[p] >= s->ages) {
            s->age[p] = -1;
            continue;
        }
        live++;
        if (s->age[p] > seen[0]) seen[0] = s->age[p];
        if (outside) s->foreign[p] = 1;
        if (apart)
            step_own(n, own, residual, s->e + p * n2);
        else
            step_coupled(n2, s->Ad, residual, s->e + p * n2);
        if (widen && apart)
            step_own(n, wide, dw, s->w + p * n2);
        else if (widen)
            step_coupled(n2, size, dw, s->w + p * n2);
        if (remarkable(s, p)) look_closely(s, p, worst);
    }
    for (int i = 0; i < 2 * n2; i++) seen[1] += s->row[i] >= 0;
    return live;
}
