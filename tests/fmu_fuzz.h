/* What both fuzzers draw from, and what every unit promises of `covered` and of a certified stop. */
#ifndef FMU_FUZZ_H
#define FMU_FUZZ_H
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "stopset_core.h"

enum { N_ALL = N_REAL + N_INT + N_BOOL, VR_COVERED = N_REAL + N_INT + IX_COVERED, VR_CERTIFIED = N_REAL + N_INT + IX_STOP_CERTIFIED,
       VR_MEASURED = N_REAL + N_INT + IX_MEASURED, STOP_OUTPUTS = 4 * NJ + 2 };

static char last[600];
static uint64_t state;
static long errors, covered_seen, certified_seen;

static uint64_t draw(void) { /* splitmix64 */
    uint64_t z = (state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}
static unsigned below(unsigned n) { return (unsigned)(draw() % n); }
static double number(void) {
    static const double wild[] = {0.0, -0.0, 1.0, -1.0, 1e-320, 1e-9, 3.0, 1e6, 1e9, 1e17, 1e308, -1e308, INFINITY, -INFINITY, NAN};
    if (!below(4)) return wild[below(sizeof wild / sizeof *wild)];
    return ((double)(draw() >> 11) / 9007199254740992.0 - 0.5) * (below(3) ? 1.0 : 10.0);
}

/* A variable of the first so many; often one that begins a stop or changes what is proved, which chance alone seldom puts together. */
static unsigned place(unsigned among) {
    static const unsigned often[] = {VR_PAYLOAD_MASS, VR_PAYLOAD_LO, VR_PAYLOAD_HI, VR_WARM, VR_DQ_START, N_REAL + IX_STOP, VR_MEASURED, N_REAL + N_INT + IX_EVALUATE_STOP};
    const unsigned one = often[below(sizeof often / sizeof *often)];
    return !below(3) && one < among ? one : below(among);
}

/* Why nothing may be covered with these values of all real variables, by what the model says it was identified for; 0: it may. */
static const char *beyond(const double r[N_REAL], int measured) {
    const StopsetModel *m = &stopset_model;
    const double *q = r + (measured ? VR_Q_MEASURED : VR_Q), *dq = r + (measured ? VR_DQ_MEASURED : VR_DQ);
    for (int v = VR_FIRST_PHYSICAL; v < VR_FIRST_PHYSICAL + N_PHYSICAL; v++)
        if (r[v] != m->start_real[v]) return "a parameter is another than identified";
    if (!(r[VR_PAYLOAD_MASS] >= m->payload_lo && r[VR_PAYLOAD_MASS] <= m->payload_hi)) return "the payload is beyond what was identified";
    for (int i = 0; i < NJ; i++) {
        if (!(q[i] >= m->lo[i] && q[i] <= m->hi[i] && dq[i] >= m->lo[NJ + i] && dq[i] <= m->hi[NJ + i])) return "the state is outside the domain";
        if (m->has_domain_temp && !(r[VR_TEMP + i] >= m->lo[3 * NJ + i] && r[VR_TEMP + i] <= m->hi[3 * NJ + i])) return "a temperature is outside the domain";
        for (int end = 0; end < 2; end++) {
            const unsigned at = (end ? VR_DQ_LO : VR_Q_LO) + (unsigned)i, to = (end ? VR_DQ_HI : VR_Q_HI) + (unsigned)i;
            if (!(r[at] <= r[to] && stopset_finite(r[at]) && stopset_finite(r[to]))) return "its bounds are none";
        }
    }
    return 0;
}

static double among(double lo, double hi) { return lo + (hi - lo) * ((double)(draw() >> 11) / 9007199254740992.0); }

/* An arm somewhere in the domain, mostly moving: readings and temperatures, at a start also where and how fast the unit's own begins. How many. */
static unsigned somewhere(unsigned *vr, double *x, int starting) {
    const StopsetModel *m = &stopset_model;
    const int stands = !below(4);
    const double wide = among(0.0, 1.0), pace = wide * among(0.0, 1.0); /* near its first pose and slow most arms' stops are proved */
    for (unsigned i = 0; i < NJ; i++) {
        const double first = m->start_real[VR_Q_START + i];
        vr[i] = VR_Q_MEASURED + i;
        vr[NJ + i] = VR_DQ_MEASURED + i;
        vr[2 * NJ + i] = VR_TEMP + i;
        vr[3 * NJ + i] = VR_Q_START + i;
        vr[4 * NJ + i] = VR_DQ_START + i;
        x[i] = x[3 * NJ + i] = stands ? first : among(fmax(m->lo[i], first - 3.0 * wide), fmin(m->hi[i], first + 3.0 * wide));
        x[NJ + i] = x[4 * NJ + i] = stands ? 0.0 : pace * among(m->lo[NJ + i], m->hi[NJ + i]);
        x[2 * NJ + i] = m->has_domain_temp ? among(m->lo[3 * NJ + i], m->hi[3 * NJ + i]) : m->start_real[VR_TEMP + i];
    }
    return (starting ? 5 : 3) * NJ;
}

/* A stop that is certified has numbers of at least zero, one that is not has none; brakes take time, and what is read is
 * not exact, so that no bound is zero. */
static const char *untrue(const double r[N_REAL], int certified) {
    for (int i = 0; i < NJ && certified; i++)
        if (!(r[VR_STOP_TIME + i] > 0.0)) return "a joint stops in no time";
    for (int k = 0; k < STOP_OUTPUTS; k++) {
        const double x = r[VR_STOP_TIME + k];
        if (certified ? !(stopset_finite(x) && x >= 0.0) : !isnan(x)) return certified ? "certified without a number" : "a number that is not certified";
    }
    return 0;
}

/* What is said of covered, of where the stop begins, of a ramp that may fail, and of a bound of each category but the path's. */
enum { PROOFS = N_STOPS > 1 ? STOP_2 + 1 : 1, FLAG_COVERED = 0, FLAG_MEASURED, FLAG_MONITORED, FLAG_CERTIFIED, FLAGS = FLAG_CERTIFIED + PROOFS };
#if N_STOPS > 1
enum { OFF_AFTER = VR_SS1_OFF_AFTER };
#else
enum { OFF_AFTER = 0 }; /* it has no ramp: the time, which nobody looks at */
#endif
static const unsigned flags_of[FLAGS] = {
    VR_COVERED, VR_MEASURED,
#if N_STOPS > 1
    N_REAL + N_INT + IX_SS1_MONITORED, VR_CERTIFIED, N_REAL + N_INT + IX_STOP1_NOMINAL_CERTIFIED, N_REAL + N_INT + IX_STOP1_GUARANTEED_CERTIFIED,
    N_REAL + N_INT + IX_STOP2_CERTIFIED,
#else
    VR_MEASURED, VR_CERTIFIED,
#endif
};

/* Every certified bound of this very state, for Python to hold against its own: category, whether the ramp is monitored and else when power goes,
 * angles, speeds, and all outputs of the bound. A box of states has another bound, and a payload of less than was identified. */
static FILE *kept;
static void keep(const double r[N_REAL], const int flag[FLAGS], int every) {
    static const unsigned first[] = {VR_STOP_TIME, VR_STOP1_NOMINAL_TIME, VR_STOP1_GUARANTEED_TIME, VR_STOP2_TIME};
    const double *start = stopset_model.start_real;
    const double *q = r + (flag[FLAG_MEASURED] ? VR_Q_MEASURED : VR_Q), *dq = r + (flag[FLAG_MEASURED] ? VR_DQ_MEASURED : VR_DQ);
    if (!kept || !flag[FLAG_COVERED] || every != 1 || r[VR_PAYLOAD_LO] != start[VR_PAYLOAD_LO] || r[VR_PAYLOAD_HI] != start[VR_PAYLOAD_HI]) return;
    for (int k = 0; k < PROOFS; k++) {
        if (!flag[FLAG_CERTIFIED + k]) continue;
        fprintf(kept, "%d %d %a", k, flag[FLAG_MONITORED], r[OFF_AFTER]);
        for (int i = 0; i < NJ; i++) fprintf(kept, " %a", q[i]);
        for (int i = 0; i < NJ; i++) fprintf(kept, " %a", dq[i]);
        for (int i = 0; i < STOP_OUTPUTS; i++) fprintf(kept, " %a", r[first[k] + (unsigned)i]);
        fprintf(kept, "\n");
    }
}

#define BROKEN(...) return printf(__VA_ARGS__), printf(" (seed %ld, call %d, last message: %s)\n", seed, call, last), fflush(stdout), 1
#endif
