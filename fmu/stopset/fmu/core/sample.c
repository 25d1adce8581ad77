/* The conformance check of a measured sample: the monitor's own cycle (core/watch.c), as stopset.monitor.watch calls it.
 *
 * Samples come at the model's own step; a prediction begins at every one of them, and each sample is held against all. What is
 * remembered begins anywhere, as for a monitor that does not know what came before.
 */
#include <string.h>

#include "stopset_core.h"

static const double LARGEST = 1e6; /* of any reading [SI] */

#if !(CORNERS || PATHS)
void stopset_forget(StopsetState *s) {
    StopsetPast *c = &s->past;
    for (int k = 0; k < PREDICTIONS; k++) c->age[k] = -1;
    for (int k = 0; k < N_MEMORY; k++) memcpy(c->ends[k], stopset_model.memory[k].whole, sizeof c->ends[k]);
    c->next = c->since = 0;
    c->known = 0;
}
#endif

/* Why no verdict can be had of this sample. */
static int unusable(const StopsetState *s, const double x[NX]) {
    const double payload = s->r[VR_PAYLOAD_MASS];
    int all_zero = 1;
    for (int i = 0; i < NX; i++) all_zero = all_zero && x[i] == 0.0 && (i >= NJ || s->r[VR_TAU + i] == 0.0);
    return !stopset_sound(NX, x, LARGEST) || !stopset_sound(NJ, &s->r[VR_TAU], LARGEST) || !stopset_sound(NJ, &s->r[VR_TEMP], LARGEST) ||
           all_zero || !(payload >= stopset_model.payload_lo && payload <= stopset_model.payload_hi);
}

/* Whether a signal is beyond the domain of validity. */
static int outside(const StopsetState *s, const double x[NX], const double u[NJ], const double du[NJ]) {
    double here[4 * NJ], slack[4 * NJ] = {0};
    memcpy(here, x, NX * sizeof *x);
    memcpy(here + NX, u, NJ * sizeof *u);
    memcpy(here + 3 * NJ, &s->r[VR_TEMP], NJ * sizeof *here);
    for (int i = 0; i < NJ; i++) slack[NX + i] = du[i] + 1e-12;
    return stopset_beyond((stopset_model.has_domain_temp ? 4 : 3) * NJ, here, stopset_model.lo, stopset_model.hi, slack) > 0;
}

int stopset_take_sample(StopsetState *s, StopsetWork *w, double x[NX], double u[NJ], double du[NJ], int *foreign) {
    memcpy(x, &s->r[VR_Q_MEASURED], NJ * sizeof *x);
    memcpy(x + NJ, &s->r[VR_DQ_MEASURED], NJ * sizeof *x);
    if (unusable(s, x)) {
        stopset_forget(s);
        return 0;
    }
    const StopsetSamples here = {.q = x, .dq = x + NJ, .tau = &s->r[VR_TAU], .temp = &s->r[VR_TEMP]};
    stopset_sample_input(&w->monitor, &here, s->past.ends[0], u, du);
    *foreign = outside(s, x, u, du);
    return 1;
}

#if !(CORNERS || PATHS)
/* A prediction from this sample: every STRIDE of them, or at the first one alone where the sets conform from the start only. */
static void launch(StopsetPast *c, int foreign) {
    const int first = !c->known;
    c->since++;
    if (!first && (c->since < STRIDE || !stopset_model.sliding)) return;
    c->since = 0;
    const int64_t row = c->next;
    c->next = (c->next + 1) % PREDICTIONS;
    memset(c->e[row], 0, sizeof c->e[row]);
    memset(c->w[row], 0, sizeof c->w[row]);
    c->age[row] = 0;
    c->foreign[row] = (uint8_t)foreign;
}

int stopset_sample(StopsetState *s, StopsetWork *w, int32_t *joint) {
    static const double none[NJ] = {0};
    const StopsetModel *m = &stopset_model;
    StopsetPast *c = &s->past;
    double x[NX], u[NJ], du[NJ], room[NX];
    int64_t row[2 * NX], nearest[NX], seen[2] = {0, 0}, live = 0;
    int verdict = c->known ? VERDICT_NONE : NOTHING_BEFORE, foreign;
    if (!stopset_take_sample(s, w, x, u, du, &foreign)) return VERDICT_NONE;
    if (c->known) {
        double Bd[NX * NJ];
        stopset_torque_part(w->grid, Bd);
        const StopsetPredictions all = {NX, PREDICTIONS, AGES, c->e[0], c->w[0], c->age, c->foreign, w->grid, Bd, w->watch_lo[0],
                                        w->watch_hi[0], w->watch_middle[0], w->watch_reach[0], room, nearest, row};
        for (int i = 0; i < NX; i++) nearest[i] = -1; /* where to look first is not known */
        const StopsetReading reading = {x, c->x, c->u, m->plain ? none : c->du};
        live = stopset_advance(&all, &reading, foreign, !m->plain, seen);
    }
    if (live && !seen[1] && !foreign) verdict = VERDICT_CONFORMANT;
    for (int i = 0; live && seen[1] && verdict != VERDICT_VIOLATED && i < 2 * NX; i++)
        if (row[i] >= 0) {
            verdict = VERDICT_VIOLATED;
            *joint = i % NJ + 1;
        }
    /* what is refuted itself predicts nothing */
    if (verdict != VERDICT_VIOLATED) launch(c, foreign);
    memcpy(c->x, x, sizeof x);
    memcpy(c->u, u, sizeof u);
    memcpy(c->du, du, sizeof du);
    c->known = 1;
    return verdict;
}
#endif
