/* What FMI 2 and FMI 3 share. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "stopset_fmi.h"

/* Before the bytes of a serialized state: these, the unit's token, the sum of the bytes. */
static const char MAGIC[8] = {'s', 't', 'o', 'p', 's', 'e', 't', '2'};
enum { TOKEN = 64, SUM = sizeof(uint64_t), HEAD = sizeof MAGIC + TOKEN + SUM };

Level stopset_fail(Instance *c, const char *function, const char *what) {
    char message[512];
    snprintf(message, sizeof message, "%s: %s", function, what);
    c->write(c, LEVEL_ERROR, message);
    return LEVEL_ERROR;
}

Level stopset_expect(Instance *c, const char *function, unsigned phases) {
    static const char *const names[] = {"instantiated", "initialization mode", "event mode", "continuous-time mode", "step mode",
                                        "terminated", "intermediate update mode"};
    if (phases & IN(c->now.phase)) return LEVEL_OK;
    char what[160];
    snprintf(what, sizeof what, "not allowed while the FMU is in state \"%s\"; follow the calling sequence of the standard",
             names[c->now.phase]);
    return stopset_fail(c, function, what);
}

Instance *stopset_create(const char *name, const char *token, int co_simulation, int logging, void *environment, void *callback,
                         void (*write)(Instance *, Level, const char *)) {
    Instance *c = calloc(1, sizeof *c);
    if (!c) return 0;
    c->co_simulation = co_simulation;
    c->logging = logging;
    c->environment = environment;
    c->callback = callback;
    c->write = write;
    snprintf(c->name, sizeof c->name, "%s", name ? name : "");
    if (!token || strcmp(token, stopset_token) != 0) {
        stopset_fail(c, "instantiate", "the token (GUID) is not the one of this binary; unpack the FMU again, do not mix FMUs");
        free(c);
        return 0;
    }
    c->work = calloc(1, sizeof *c->work);
    c->spare = malloc(3 * sizeof *c->spare);
    int64_t proofs = stopset_stop_room(NJ);
    if (HAS_PATH && stopset_path_room(NJ) > proofs) proofs = stopset_path_room(NJ);
    if (c->work && stopset_model.has_brakes) c->work->proof = malloc((size_t)proofs * sizeof(double));
    if (!c->work || !c->spare || (stopset_model.has_brakes && !c->work->proof)) {
        stopset_fail(c, "instantiate", "no memory left; free instances that are no longer needed");
        stopset_free(c);
        return 0;
    }
    stopset_reset(c);
    return c;
}

void stopset_free(Instance *c) {
    if (!c) return;
    if (c->work) free(c->work->proof);
    free(c->work);
    free(c->spare);
    free(c);
}

void stopset_reset(Instance *c) {
    stopset_defaults(&c->now.s);
    c->now.t0 = 0.0;
    c->now.phase = PHASE_CREATED;
    c->now.stale = 1;
}

/* Before and during initialization every value follows from parameters and inputs. */
static Level refresh(Instance *c) {
    if (!c->now.stale) return LEVEL_OK;
    const char *wrong = stopset_setup(&c->now.s, c->work, c->now.t0);
    if (wrong) return stopset_fail(c, "initialization", wrong);
    c->now.stale = 0;
    return LEVEL_OK;
}

/* And what follows from the parameters is that of these. */
static Level prepared(Instance *c, const char *function) {
    if (refresh(c)) return LEVEL_ERROR;
    const char *wrong = stopset_prepare(&c->now.s, c->work);
    return wrong ? stopset_fail(c, function, wrong) : LEVEL_OK;
}

Level stopset_enter_initialization(Instance *c, double t0) {
    if (stopset_expect(c, "enterInitializationMode", IN(PHASE_CREATED))) return LEVEL_ERROR;
    if (!stopset_finite(t0)) return stopset_fail(c, "enterInitializationMode", "the start time is not a finite number; give one [s]");
    c->now.t0 = t0;
    c->now.stale = 1;
    c->now.phase = PHASE_INITIALIZATION;
    return LEVEL_OK;
}

Level stopset_exit_initialization(Instance *c) {
    if (stopset_expect(c, "exitInitializationMode", IN(PHASE_INITIALIZATION)) || refresh(c)) return LEVEL_ERROR;
    stopset_begin(&c->now.s, c->work);
    c->now.s.unsampled = 1; /* inputs of now are often starts that connections overwrite before the first step */
    stopset_check(&c->now.s, c->work);
    c->now.s.modes_by_events = (uint8_t)!c->co_simulation;
    if (!c->co_simulation) stopset_update_modes(&c->now.s, c->work, 0.0);
    c->now.phase = c->co_simulation && !c->event_mode ? PHASE_STEP : PHASE_EVENT;
    return LEVEL_OK;
}

static Level unknown(Instance *c, const char *function, unsigned vr, const char *type) {
    char what[160];
    snprintf(what, sizeof what, "there is no %s variable with value reference %u; read modelDescription.xml", type, vr);
    return stopset_fail(c, function, what);
}

static Level ready(Instance *c) {
    if (refresh(c)) return LEVEL_ERROR;
    stopset_outputs(&c->now.s, c->work);
    return LEVEL_OK;
}

Level stopset_get_real(Instance *c, const unsigned vr[], size_t n, double value[]) {
    if (ready(c)) return LEVEL_ERROR;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= N_REAL) return unknown(c, "get", vr[k], "floating-point");
        const int stop = stopset_stop_output(vr[k]);
        if (stop >= 0) stopset_stop_bounds(&c->now.s, c->work, stop, 0);
        value[k] = c->now.s.r[vr[k]];
    }
    return LEVEL_OK;
}

Level stopset_get_integer(Instance *c, const unsigned vr[], size_t n, int32_t value[]) {
    if (ready(c)) return LEVEL_ERROR;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] < N_REAL || vr[k] >= N_REAL + N_INT) return unknown(c, "get", vr[k], "integer");
        value[k] = c->now.s.i[vr[k] - N_REAL];
    }
    return LEVEL_OK;
}

Level stopset_get_boolean(Instance *c, const unsigned vr[], size_t n, uint8_t value[]) {
    if (ready(c)) return LEVEL_ERROR;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] < N_REAL + N_INT || vr[k] >= N_REAL + N_INT + N_BOOL) return unknown(c, "get", vr[k], "boolean");
        const int stop = stopset_stop_flag(vr[k] - N_REAL - N_INT);
        if (stop >= 0) stopset_stop_bounds(&c->now.s, c->work, stop, 0);
        value[k] = c->now.s.b[vr[k] - N_REAL - N_INT];
    }
    return LEVEL_OK;
}

static Level may_set(Instance *c, unsigned vr) {
    int kind = stopset_model.kind[vr], early = c->now.phase <= PHASE_INITIALIZATION;
    int allowed = kind == KIND_INPUT || kind == KIND_TUNABLE || (kind == KIND_FIXED && early);
    if (allowed && c->now.phase != PHASE_TERMINATED && c->now.phase != PHASE_BETWEEN) {
        if (early) c->now.stale = 1;
        c->now.s.outputs_ready = 0;
        return LEVEL_OK;
    }
    char what[400];
    snprintf(what, sizeof what, "%s cannot be set now; expected an input, or a parameter before the initialization ends",
             stopset_model.name[vr]);
    return stopset_fail(c, "set", what);
}

/* A parameter that may change in a run: what was proved before does not speak of it. */
static Level set_in_a_run(Instance *c, unsigned vr, double value) {
    StopsetState *s = &c->now.s;
    const int another = s->r[vr] != value;
    if (vr == VR_PAYLOAD_MASS && (!(value >= 0.0) || !stopset_finite(value)))
        return stopset_fail(c, "set", "payload_mass is not a mass; set a finite number >= 0 [kg]");
    if (!stopset_finite(value)) {
        char what[160];
        snprintf(what, sizeof what, "%s is not a finite number; set one", stopset_model.name[vr]);
        return stopset_fail(c, "set", what);
    }
    s->r[vr] = value;
    if (another && vr == VR_PAYLOAD_MASS) stopset_reload(s);
    if (another) stopset_retune(s);
    return LEVEL_OK;
}

Level stopset_set_real(Instance *c, const unsigned vr[], size_t n, const double value[]) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= N_REAL) return unknown(c, "set", vr[k], "floating-point");
        if (may_set(c, vr[k])) return LEVEL_ERROR;
        if (stopset_model.kind[vr[k]] == KIND_TUNABLE && c->now.phase > PHASE_INITIALIZATION) {
            if (set_in_a_run(c, vr[k], value[k])) return LEVEL_ERROR;
            continue;
        }
        c->now.s.r[vr[k]] = value[k];
    }
    return LEVEL_OK;
}

Level stopset_set_integer(Instance *c, const unsigned vr[], size_t n, const int32_t value[]) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] < N_REAL || vr[k] >= N_REAL + N_INT) return unknown(c, "set", vr[k], "integer");
        if (may_set(c, vr[k])) return LEVEL_ERROR;
        if (vr[k] - N_REAL == IX_STOP && (value[k] < 0 || value[k] > 3)) {
            char what[120];
            snprintf(what, sizeof what, "stop is %d; expected 0 (none), 1 (STOP 0), 2 (STOP 1) or 3 (STOP 2)", (int)value[k]);
            return stopset_fail(c, "set", what);
        }
        if (vr[k] - N_REAL == IX_STOP_EVERY && value[k] < 0) {
            char what[120];
            snprintf(what, sizeof what, "stop_every is %d; expected a number of steps, or 0 for never", (int)value[k]);
            return stopset_fail(c, "set", what);
        }
        c->now.s.i[vr[k] - N_REAL] = value[k];
    }
    return LEVEL_OK;
}

Level stopset_set_boolean(Instance *c, const unsigned vr[], size_t n, const uint8_t value[]) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] < N_REAL + N_INT || vr[k] >= N_REAL + N_INT + N_BOOL) return unknown(c, "set", vr[k], "boolean");
        if (may_set(c, vr[k])) return LEVEL_ERROR;
        c->now.s.b[vr[k] - N_REAL - N_INT] = value[k] != 0;
    }
    return LEVEL_OK;
}

Level stopset_tick(Instance *c, unsigned clock, int active) {
    if (stopset_expect(c, "setClock", IN(PHASE_EVENT))) return LEVEL_ERROR;
    if (clock > 2) return stopset_fail(c, "setClock", "there is no clock with this value reference; read modelDescription.xml");
    /* of several that tick at once power off counts first */
    if (active && (!c->now.s.ticked || clock + 1u < c->now.s.ticked)) c->now.s.ticked = (uint8_t)(clock + 1);
    if (!active && c->now.s.ticked == clock + 1) c->now.s.ticked = 0;
    return LEVEL_OK;
}

static const double LONGEST_STEP = 3600.0; /* [s] */

Level stopset_do_step(Instance *c, double t, double h) {
    StopsetState *s = &c->now.s;
    char what[160];
    if (stopset_expect(c, "doStep", IN(PHASE_STEP))) return LEVEL_ERROR;
    if (!(h > 0.0) || !stopset_finite(h)) return stopset_fail(c, "doStep", "the step size is not positive; expected a finite number > 0 [s]");
    if (h > LONGEST_STEP) {
        snprintf(what, sizeof what, "a step of %.9g s; expected at most %g s, as an arm is integrated cycle by cycle: divide it", h, LONGEST_STEP);
        return stopset_fail(c, "doStep", what);
    }
    /* masters add up their step sizes: rounding of some 1e6 steps is no reason to refuse */
    if (!(fabs(t - s->r[VR_TIME]) <= 1e-9 * (1.0 + fabs(t)) + 1e-6 * h)) {
        snprintf(what, sizeof what, "the communication point %.9g s is not where the FMU stands, %.9g s; continue there or set a state",
                 t, s->r[VR_TIME]);
        return stopset_fail(c, "doStep", what);
    }
    s->r[VR_TIME] = t;
    double done;
    const char *wrong = stopset_step(s, c->work, h, &done);
    if (wrong) return stopset_fail(c, "doStep", wrong);
    s->r[VR_TIME] = t + done;
    s->outputs_ready = 0;
    return LEVEL_OK;
}

/* `from` with the knowns moved by `step` along the seed; a sentence where that is none. */
static const char *moved(StopsetWork *w, const Saved *from, const unsigned known[], size_t m, const double seed[], double step, Saved *out) {
    memcpy(out, from, sizeof *out);
    for (size_t k = 0; k < m; k++) out->s.r[known[k]] += step * seed[k];
    if (out->phase <= PHASE_INITIALIZATION) {
        const char *wrong = stopset_setup(&out->s, w, out->t0);
        if (wrong) return wrong;
    }
    out->s.outputs_ready = 0;
    stopset_outputs(&out->s, w);
    return 0;
}

static int may_be_known(const Instance *c, unsigned vr) {
    if (vr >= N_REAL) return 0;
    const int kind = stopset_model.kind[vr];
#if N_MEMORY
    if (vr >= VR_MEMORY && vr < VR_MEMORY + N_MEMORY) return 1;
#endif
    if (kind == KIND_INPUT || (vr >= VR_Q && vr < VR_DQ + NJ)) return 1;
    return (kind == KIND_FIXED || kind == KIND_TUNABLE) && c->now.phase <= PHASE_INITIALIZATION;
}

Level stopset_directional(Instance *c, const unsigned unknown[], size_t n, const unsigned known[], size_t m, const double seed[], double out[]) {
    if (stopset_expect(c, "getDirectionalDerivative", RUNNING | IN(PHASE_INITIALIZATION)) || ready(c)) return LEVEL_ERROR;
    double largest = 0.0, size = 1.0;
    for (size_t k = 0; k < m; k++) {
        if (!may_be_known(c, known[k]))
            return stopset_fail(c, "getDirectionalDerivative", "a known is no input, state or start value; read ModelStructure in modelDescription.xml");
        if (!stopset_finite(seed[k])) return stopset_fail(c, "getDirectionalDerivative", "a seed is not a finite number; give finite ones");
        largest = fmax(largest, fabs(seed[k]));
        size = fmax(size, fabs(c->now.s.r[known[k]]));
    }
    for (size_t k = 0; k < n; k++) {
        const int kind = unknown[k] < N_REAL ? stopset_model.kind[unknown[k]] : KIND_FIXED;
        if ((kind != KIND_OUTPUT && kind != KIND_LOCAL) || stopset_stop_output(unknown[k]) >= 0)
            return stopset_fail(c, "getDirectionalDerivative", "an unknown is no output that has a derivative; stop bounds have none");
        out[k] = 0.0;
    }
    if (!(largest > 0.0)) return LEVEL_OK;
    Saved *here = c->spare, *low = here + 1, *high = here + 2;
    memcpy(here, &c->now, sizeof *here);
    if (!here->s.modes_by_events) stopset_update_modes(&here->s, c->work, 0.0);
    here->s.modes_held = 1;
    const double step = 1e-5 * size / largest;
    const char *wrong = moved(c->work, here, known, m, seed, -step, low);
    if (!wrong) wrong = moved(c->work, here, known, m, seed, step, high);
    if (wrong) return stopset_fail(c, "getDirectionalDerivative", wrong);
    for (size_t k = 0; k < n; k++) out[k] = (high->s.r[unknown[k]] - low->s.r[unknown[k]]) / (2.0 * step);
    return LEVEL_OK;
}

Level stopset_get_state(Instance *c, void **state) {
    if (stopset_expect(c, "getFMUState", ~IN(PHASE_BETWEEN))) return LEVEL_ERROR;
    if (!*state) *state = malloc(sizeof(Saved));
    if (!*state) return stopset_fail(c, "getFMUState", "no memory left for a state; free states that are no longer needed");
    memcpy(*state, &c->now, sizeof(Saved));
    return LEVEL_OK;
}

Level stopset_set_state(Instance *c, const void *state) {
    if (stopset_expect(c, "setFMUState", ~IN(PHASE_BETWEEN))) return LEVEL_ERROR;
    if (!state) return stopset_fail(c, "setFMUState", "the state is a null pointer; give one from getFMUState");
    memcpy(&c->now, state, sizeof(Saved));
    return LEVEL_OK;
}

/* FNV-1a of a serialized state: who stored it may have damaged it, and a wrong state has wrong bounds. */
static uint64_t sum_of(const unsigned char *bytes) {
    uint64_t h = UINT64_C(14695981039346656037);
    for (size_t k = 0; k < sizeof(Saved); k++) h = (h ^ bytes[k]) * UINT64_C(1099511628211);
    return h;
}

size_t stopset_serialized_size(void) { return HEAD + sizeof(Saved); }

Level stopset_serialize(Instance *c, const void *state, unsigned char *bytes, size_t size) {
    if (!state || size < stopset_serialized_size())
        return stopset_fail(c, "serializeFMUState", "no state, or too few bytes; ask for the size first");
    memset(bytes, 0, size);
    memcpy(bytes, MAGIC, sizeof MAGIC);
    snprintf((char *)bytes + sizeof MAGIC, TOKEN, "%s", stopset_token);
    memcpy(bytes + HEAD, state, sizeof(Saved));
    const uint64_t sum = sum_of(bytes + HEAD);
    memcpy(bytes + sizeof MAGIC + TOKEN, &sum, SUM);
    return LEVEL_OK;
}

Level stopset_deserialize(Instance *c, const unsigned char *bytes, size_t size, void **state) {
    char token[TOKEN] = {0};
    snprintf(token, sizeof token, "%s", stopset_token);
    if (size < stopset_serialized_size() || memcmp(bytes, MAGIC, sizeof MAGIC) != 0 || memcmp(bytes + sizeof MAGIC, token, TOKEN) != 0)
        return stopset_fail(c, "deserializeFMUState", "these bytes are not a state of this FMU; use those it wrote itself");
    const uint64_t sum = sum_of(bytes + HEAD);
    if (memcmp(bytes + sizeof MAGIC + TOKEN, &sum, SUM) != 0)
        return stopset_fail(c, "deserializeFMUState", "these bytes are damaged, their sum is another than when they were written; use those of another store");
    if (!*state) *state = malloc(sizeof(Saved));
    if (!*state) return stopset_fail(c, "deserializeFMUState", "no memory left for a state; free states that are no longer needed");
    memcpy(*state, bytes + HEAD, sizeof(Saved));
    return LEVEL_OK;
}

/* In co-simulation another time or state would be one that no bound was made for. */
static Level in_exchange(Instance *c, const char *function, unsigned phases) {
    if (c->co_simulation) return stopset_fail(c, function, "belongs to model exchange, and this is co-simulation; use doStep");
    return stopset_expect(c, function, phases);
}

Level stopset_set_time(Instance *c, double t) {
    if (in_exchange(c, "setTime", IN(PHASE_EVENT) | IN(PHASE_CONTINUOUS))) return LEVEL_ERROR;
    if (!stopset_finite(t)) return stopset_fail(c, "setTime", "the time is not a finite number; give one [s]");
    c->now.s.r[VR_TIME] = t;
    c->now.s.outputs_ready = 0;
    return LEVEL_OK;
}

static Level right_count(Instance *c, const char *function, size_t n) {
    if (n == NS) return LEVEL_OK;
    char what[120];
    snprintf(what, sizeof what, "%u states; this model has %d", (unsigned)n, (int)NS);
    return stopset_fail(c, function, what);
}

Level stopset_set_states(Instance *c, const double x[], size_t n) {
    if (in_exchange(c, "setContinuousStates", IN(PHASE_EVENT) | IN(PHASE_CONTINUOUS)) || right_count(c, "setContinuousStates", n)) return LEVEL_ERROR;
    for (int i = 0; i < NJ; i++) {
        c->now.s.r[VR_Q + i] = x[i];
        c->now.s.r[VR_DQ + i] = x[NJ + i];
    }
    for (int k = 0; k < N_MEMORY; k++) c->now.s.r[VR_MEMORY + k] = x[NX + k];
    c->now.s.outputs_ready = 0;
    return LEVEL_OK;
}

Level stopset_get_states(Instance *c, double x[], size_t n) {
    if (right_count(c, "getContinuousStates", n) || refresh(c)) return LEVEL_ERROR;
    for (int i = 0; i < NJ; i++) {
        x[i] = c->now.s.r[VR_Q + i];
        x[NJ + i] = c->now.s.r[VR_DQ + i];
    }
    for (int k = 0; k < N_MEMORY; k++) x[NX + k] = c->now.s.r[VR_MEMORY + k];
    return LEVEL_OK;
}

Level stopset_get_derivatives(Instance *c, double dx[], size_t n) {
    if (right_count(c, "getDerivatives", n) || prepared(c, "getDerivatives")) return LEVEL_ERROR;
    for (int i = 0; i < NJ; i++) dx[i] = c->now.s.r[VR_DQ + i];
    stopset_accelerations(&c->now.s, c->work, dx + NJ, dx + NX);
    return LEVEL_OK;
}

Level stopset_get_indicators(Instance *c, double z[], size_t n) {
    double all[NJ];
    if (n != N_INDICATORS) return stopset_fail(c, "getEventIndicators", "the number of event indicators differs from modelDescription.xml");
    if (!n) return LEVEL_OK;
    if (prepared(c, "getEventIndicators")) return LEVEL_ERROR;
    stopset_indicators(&c->now.s, c->work, all);
    memcpy(z, all, n * sizeof *z);
    return LEVEL_OK;
}

Level stopset_completed_step(Instance *c, int *event) {
    if (in_exchange(c, "completedIntegratorStep", IN(PHASE_CONTINUOUS))) return LEVEL_ERROR;
    int before = c->now.s.i[IX_VERDICT];
    stopset_count(&c->now.s);
    stopset_check(&c->now.s, c->work);
    *event = c->now.s.i[IX_VERDICT] != before;
    return LEVEL_OK;
}

Level stopset_update_discrete(Instance *c, int *states_changed, int *next_defined, double *next) {
    StopsetState *s = &c->now.s;
    *states_changed = *next_defined = 0;
    if (prepared(c, "updateDiscreteStates")) return LEVEL_ERROR;
    if (!c->co_simulation) {
        stopset_begin(s, c->work);
        stopset_check(s, c->work);
        if (!s->stopping) stopset_restart(s, c->work, 1e-6 * stopset_model.dt); /* an event at the horizon is there but for rounding */
    }
    const char *wrong = stopset_trigger(s, c->work);
    if (wrong) return stopset_fail(c, "updateDiscreteStates", wrong);
    if (c->co_simulation) return LEVEL_OK; /* samples are looked at where a step takes them, and steps find their own events */
    /* an importer finds the zero crossing of a velocity within its own tolerance */
    stopset_update_modes(s, c->work, 1e-7);
    /* at events the right side jumps: an importer that begins its solver anew only where states do would go on with the old one's history */
    *states_changed = 1;
    s->outputs_ready = 0;
    /* the bounds were tested up to the horizon: the flag `covered` changes there */
    *next = s->tube_start + stopset_model.horizon;
    const double since = s->r[VR_TIME] - s->stop_start;
    if (s->stopping) *next = s->stop_start + (s->stopping == 1 ? stopset_brakes_change(since) : stopset_ramp_changes(s, since));
    *next_defined = *next > s->r[VR_TIME] && stopset_finite(*next);
    return LEVEL_OK;
}
