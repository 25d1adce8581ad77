/* FMI 3.0 interface: co-simulation and model exchange. */
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "stopset_fmi.h"

#define GIVEN(c) \
    if (!(c)) return fmi3Error
#define UNUSED(x) (void)(x)

static fmi3Status status(Level level) { return level == LEVEL_OK ? fmi3OK : level == LEVEL_WARNING ? fmi3Warning : fmi3Error; }

static void say(Instance *c, Level level, const char *message) {
    fmi3LogMessageCallback log;
    memcpy(&log, &c->callback, sizeof log);
    if (log && (c->logging || level == LEVEL_ERROR))
        log(c->environment, status(level), level == LEVEL_ERROR ? "logStatusError" : "logStatusWarning", message);
}

static Instance *create(fmi3String name, fmi3String token, int co_simulation, fmi3Boolean logging, fmi3InstanceEnvironment env,
                        fmi3LogMessageCallback log) {
    void *callback;
    memcpy(&callback, &log, sizeof callback);
    return stopset_create(name, token, co_simulation, logging, env, callback, say);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    GIVEN(c);
    UNUSED(n);
    UNUSED(categories);
    ((Instance *)c)->logging = on;
    return fmi3OK;
}

/* A time within a step: its outputs can be read, and the step may be asked to end there or later. */
static double between(void *who, double end) {
    Instance *c = who;
    fmi3IntermediateUpdateCallback update;
    fmi3Boolean requested = fmi3False;
    const double now = c->now.s.r[VR_TIME];
    fmi3Float64 until = now;
    memcpy(&update, &c->update, sizeof update);
    c->now.phase = PHASE_BETWEEN;
    update(c->environment, now, fmi3False, fmi3True, fmi3True, c->work->ends_at_rest != 0, &requested, &until);
    c->now.phase = PHASE_STEP;
    return requested && c->work->ends_at_rest && until < end ? until : end;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment env, fmi3LogMessageCallback log) {
    UNUSED(resources);
    UNUSED(visible);
    return create(name, token, 0, logging, env, log);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference required[], size_t nRequired, fmi3InstanceEnvironment env,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    UNUSED(resources);
    UNUSED(visible);
    UNUSED(required);
    UNUSED(nRequired);
    Instance *c = create(name, token, 1, logging, env, log);
    if (!c) return 0;
    memcpy(&c->update, &update, sizeof update);
    c->event_mode = eventModeUsed;
    c->work->ends_at_rest = earlyReturnAllowed;
    c->work->between = c->update ? between : 0;
    c->work->who = c;
    return c;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging, fmi3InstanceEnvironment env, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    UNUSED(name);
    UNUSED(token);
    UNUSED(resources);
    UNUSED(visible);
    UNUSED(logging);
    UNUSED(clock);
    UNUSED(lock);
    UNUSED(unlock);
    if (log) log(env, fmi3Error, "logStatusError", "scheduled execution is not offered; use co-simulation or model exchange");
    return 0;
}

void fmi3FreeInstance(fmi3Instance c) { stopset_free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stopDefined, fmi3Float64 stop) {
    GIVEN(c);
    UNUSED(toleranceDefined);
    UNUSED(tolerance);
    UNUSED(stopDefined);
    UNUSED(stop);
    return status(stopset_enter_initialization(c, start));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    GIVEN(c);
    return status(stopset_exit_initialization(c));
}

fmi3Status fmi3EnterEventMode(fmi3Instance c) {
    GIVEN(c);
    if (stopset_expect(c, "fmi3EnterEventMode", IN(((Instance *)c)->event_mode ? PHASE_STEP : PHASE_CONTINUOUS))) return fmi3Error;
    ((Instance *)c)->now.phase = PHASE_EVENT;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance c) {
    GIVEN(c);
    if (stopset_expect(c, "fmi3Terminate", RUNNING)) return fmi3Error;
    ((Instance *)c)->now.phase = PHASE_TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c) {
    GIVEN(c);
    if (stopset_expect(c, __func__, ~IN(PHASE_BETWEEN))) return fmi3Error;
    stopset_reset(c);
    return fmi3OK;
}

static fmi3Status counted(Instance *c, size_t nvr, size_t n) {
    return nvr == n ? fmi3OK : status(stopset_fail(c, "get/set", "as many values as value references are expected; integers and booleans are scalars"));
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Float64 values[], size_t n) {
    GIVEN(c);
    return status(stopset_get_reals(c, vr, nvr, values, n));
}

fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Int32 values[], size_t n) {
    GIVEN(c);
    return counted(c, nvr, n) ? fmi3Error : status(stopset_get_integer(c, vr, nvr, values));
}

fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Boolean values[], size_t n) {
    GIVEN(c);
    if (counted(c, nvr, n)) return fmi3Error;
    for (size_t k = 0; k < n; k++) {
        uint8_t value;
        if (stopset_get_boolean(c, &vr[k], 1, &value)) return fmi3Error;
        values[k] = value != 0;
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Float64 values[], size_t n) {
    GIVEN(c);
    return status(stopset_set_reals(c, vr, nvr, values, n));
}

fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Int32 values[], size_t n) {
    GIVEN(c);
    return counted(c, nvr, n) ? fmi3Error : status(stopset_set_integer(c, vr, nvr, values));
}

fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Boolean values[], size_t n) {
    GIVEN(c);
    if (counted(c, nvr, n)) return fmi3Error;
    for (size_t k = 0; k < n; k++) {
        uint8_t value = values[k];
        if (stopset_set_boolean(c, &vr[k], 1, &value)) return fmi3Error;
    }
    return fmi3OK;
}

/* Types this model has no variables of. */
#define NO_GET(Type, type)                                                                                                     \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, type values[], size_t n) {             \
        GIVEN(c);                                                                                                              \
        UNUSED(vr);                                                                                                            \
        UNUSED(values);                                                                                                        \
        return nvr || n ? status(stopset_fail(c, "fmi3Get" #Type, "the model has no variable of this type")) : fmi3OK;         \
    }
#define NO_SET(Type, type)                                                                                                     \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const type values[], size_t n) {       \
        GIVEN(c);                                                                                                              \
        UNUSED(vr);                                                                                                            \
        UNUSED(values);                                                                                                        \
        return nvr || n ? status(stopset_fail(c, "fmi3Set" #Type, "the model has no variable of this type")) : fmi3OK;         \
    }
#define NO_TYPE(Type, type) NO_GET(Type, type) NO_SET(Type, type)
NO_TYPE(Float32, fmi3Float32)
NO_TYPE(Int8, fmi3Int8)
NO_TYPE(UInt8, fmi3UInt8)
NO_TYPE(Int16, fmi3Int16)
NO_TYPE(UInt16, fmi3UInt16)
NO_TYPE(UInt32, fmi3UInt32)
NO_TYPE(Int64, fmi3Int64)
NO_TYPE(UInt64, fmi3UInt64)
NO_TYPE(String, fmi3String)

#define REFUSE(text) return status(stopset_fail(c, __func__, text))
/* The clocks come behind the arrays: 0 to 2 for STOP 0 to 2. */
static unsigned clock_of(fmi3ValueReference vr) { return vr - (N_SCALARS + N_ARRAYS); }

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, size_t sizes[], fmi3Binary values[], size_t n) {
    GIVEN(c);
    UNUSED(vr), UNUSED(nvr), UNUSED(sizes), UNUSED(values), UNUSED(n);
    REFUSE("the model has no variable of this type");
}
fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const size_t sizes[], const fmi3Binary values[],
                         size_t n) {
    GIVEN(c);
    UNUSED(vr), UNUSED(nvr), UNUSED(sizes), UNUSED(values), UNUSED(n);
    REFUSE("the model has no variable of this type");
}
fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Clock values[]) {
    GIVEN(c);
    for (size_t k = 0; k < nvr; k++) {
        if (clock_of(vr[k]) > 2) REFUSE("there is no clock with this value reference; read modelDescription.xml");
        values[k] = ((Instance *)c)->now.s.ticked == clock_of(vr[k]) + 1;
    }
    return fmi3OK;
}
fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Clock values[]) {
    GIVEN(c);
    for (size_t k = 0; k < nvr; k++)
        if (stopset_tick(c, clock_of(vr[k]), values[k])) return fmi3Error;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n);
    REFUSE("dependencies of single elements are not offered; those of variables are in modelDescription.xml");
}
fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t elements[], fmi3ValueReference independents[],
                                       size_t elementsOfIndependents[], fmi3DependencyKind kinds[], size_t n) {
    GIVEN(c);
    UNUSED(dependent), UNUSED(elements), UNUSED(independents), UNUSED(elementsOfIndependents), UNUSED(kinds), UNUSED(n);
    REFUSE("dependencies of single elements are not offered; those of variables are in modelDescription.xml");
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
    GIVEN(c);
    return status(stopset_get_state(c, state));
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
    GIVEN(c);
    return status(stopset_set_state(c, state));
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
    GIVEN(c);
    if (state) {
        free(*state);
        *state = 0;
    }
    return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
    GIVEN(c);
    UNUSED(state);
    *size = stopset_serialized_size();
    return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    GIVEN(c);
    return status(stopset_serialize(c, state, bytes, size));
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    GIVEN(c);
    return status(stopset_deserialize(c, bytes, size, state));
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                        fmi3Float64 sensitivity[], size_t nSensitivity) {
    GIVEN(c);
    const Sensitivities d = {unknowns, knowns, nUnknowns, nKnowns, nSeed, nSensitivity, seed, sensitivity};
    return status(stopset_directional_arrays(c, &d));
}
fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                    fmi3Float64 sensitivity[], size_t nSensitivity) {
    GIVEN(c);
    const Sensitivities d = {unknowns, knowns, nUnknowns, nKnowns, nSeed, nSensitivity, seed, sensitivity};
    return status(stopset_adjoint_arrays(c, &d));
}
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) {
    GIVEN(c);
    REFUSE("the model has no structural parameters");
}
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) {
    GIVEN(c);
    REFUSE("the model has no structural parameters");
}
fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(intervals), UNUSED(qualifiers);
    REFUSE("the clocks of the model are triggered and have no interval");
}
fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                                   fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(counters), UNUSED(resolutions), UNUSED(qualifiers);
    REFUSE("the clocks of the model are triggered and have no interval");
}
fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(shifts);
    REFUSE("the clocks of the model are triggered and have no interval");
}
fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                                fmi3UInt64 resolutions[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(counters), UNUSED(resolutions);
    REFUSE("the clocks of the model are triggered and have no interval");
}
fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 intervals[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(intervals);
    REFUSE("the clocks of the model are triggered and have no interval");
}
fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(counters), UNUSED(resolutions);
    REFUSE("the clocks of the model are triggered and have no interval");
}
fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(shifts);
    REFUSE("the clocks of the model are triggered and have no interval");
}
fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                const fmi3UInt64 resolutions[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(counters), UNUSED(resolutions);
    REFUSE("the clocks of the model are triggered and have no interval");
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) {
    GIVEN(c);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *more, fmi3Boolean *terminate, fmi3Boolean *nominalsChanged,
                                    fmi3Boolean *statesChanged, fmi3Boolean *nextDefined, fmi3Float64 *next) {
    GIVEN(c);
    if (stopset_expect(c, __func__, IN(PHASE_EVENT))) return fmi3Error;
    int changed, defined;
    if (stopset_update_discrete(c, &changed, &defined, next)) return fmi3Error;
    *more = *terminate = *nominalsChanged = fmi3False;
    *statesChanged = changed != 0;
    *nextDefined = defined != 0;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) {
    GIVEN(c);
    if (stopset_expect(c, __func__, IN(PHASE_EVENT))) return fmi3Error;
    if (((Instance *)c)->co_simulation) REFUSE("continuous-time mode is of model exchange; enter step mode");
    ((Instance *)c)->now.phase = PHASE_CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean noSetPrior, fmi3Boolean *enterEventMode, fmi3Boolean *terminate) {
    GIVEN(c);
    UNUSED(noSetPrior);
    int event = 0;
    const Level done = stopset_completed_step(c, &event);
    *enterEventMode = event ? fmi3True : fmi3False;
    *terminate = fmi3False;
    return status(done);
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
    GIVEN(c);
    return status(stopset_set_time(c, time));
}
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    GIVEN(c);
    return status(stopset_set_states(c, x, n));
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
    GIVEN(c);
    return status(stopset_get_derivatives(c, dx, n));
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n) {
    GIVEN(c);
    return status(stopset_get_indicators(c, indicators, n));
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    GIVEN(c);
    return status(stopset_get_states(c, x, n));
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t n) {
    GIVEN(c);
    for (size_t k = 0; k < n; k++) nominals[k] = 1.0;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    GIVEN(c);
    *n = N_INDICATORS;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    GIVEN(c);
    *n = NS;
    return fmi3OK;
}
fmi3Status fmi3EnterStepMode(fmi3Instance c) {
    GIVEN(c);
    if (stopset_expect(c, __func__, IN(PHASE_EVENT))) return fmi3Error;
    if (!((Instance *)c)->co_simulation) REFUSE("step mode is of co-simulation; enter continuous-time mode");
    ((Instance *)c)->now.phase = PHASE_STEP;
    return fmi3OK;
}
fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Int32 orders[],
                                    fmi3Float64 values[], size_t n) {
    GIVEN(c);
    UNUSED(vr), UNUSED(nvr), UNUSED(orders), UNUSED(values), UNUSED(n);
    REFUSE("output derivatives are not offered, see the capability flags");
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean noSetPrior, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminate, fmi3Boolean *earlyReturn, fmi3Float64 *lastTime) {
    GIVEN(c);
    UNUSED(noSetPrior);
    Level level = stopset_do_step(c, t, h);
    *eventHandlingNeeded = *terminate = fmi3False;
    *lastTime = ((Instance *)c)->now.s.r[VR_TIME];
    *earlyReturn = level == LEVEL_OK && *lastTime < t + h;
    return status(level);
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) {
    GIVEN(c);
    UNUSED(clock), UNUSED(time);
    REFUSE("scheduled execution is not offered");
}
