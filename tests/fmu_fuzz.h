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
        if (!(r[VR_TEMP + i] >= m->lo[3 * NJ + i] && r[VR_TEMP + i] <= m->hi[3 * NJ + i])) return "a temperature is outside the domain";
        for (int end = 0; end < 2; end++) {
            const unsigned at = (end ? VR_DQ_LO : VR_Q_LO) + (unsigned)i, to = (end ? VR_DQ_HI : VR_Q_HI) + (unsigned)i;
            if (!(r[at] <= r[to] && stopset_finite(r[at]) && stopset_finite(r[to]))) return "its bounds are none";
        }
    }
    return 0;
}

/* Readings of an arm that stands where the model says one may begin; as zeros they are outside the domain of many an arm. How many. */
static unsigned at_start(unsigned *vr, double *x) {
    for (unsigned i = 0; i < NJ; i++) {
        vr[i] = VR_Q_MEASURED + i;
        x[i] = stopset_model.start_real[VR_Q_START + i];
    }
    return NJ;
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

#define BROKEN(...) return printf(__VA_ARGS__), printf(" (seed %ld, call %d, last message: %s)\n", seed, call, last), 1
#endif
