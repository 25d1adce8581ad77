/* FMI 2.0 interface: co-simulation and model exchange. */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "stopset_fmi.h"

#define GIVEN(c) \
    if (!(c)) return fmi2Error
#define UNUSED(x) (void)(x)
#define REFUSE(text) return status(stopset_fail(c, __func__, text))

static fmi2Status status(Level level) { return level == LEVEL_OK ? fmi2OK : level == LEVEL_WARNING ? fmi2Warning : fmi2Error; }

static void say(Instance *c, Level level, const char *message) {
    fmi2CallbackLogger log;
    memcpy(&log, &c->callback, sizeof log);
    if (log && (c->logging || level == LEVEL_ERROR))
        log(c->environment, c->name, status(level), level == LEVEL_ERROR ? "logStatusError" : "logStatusWarning", "%s", message);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    GIVEN(c);
    UNUSED(n);
    UNUSED(categories);
    ((Instance *)c)->logging = on;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    UNUSED(resources);
    UNUSED(visible);
    void *callback = 0;
    if (functions) memcpy(&callback, &functions->logger, sizeof callback);
    return stopset_create(name, guid, type == fmi2CoSimulation, logging, functions ? functions->componentEnvironment : 0, callback, say);
}

void fmi2FreeInstance(fmi2Component c) { stopset_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stopDefined, fmi2Real stop) {
    GIVEN(c);
    UNUSED(toleranceDefined), UNUSED(tolerance), UNUSED(stopDefined), UNUSED(stop);
    if (stopset_expect(c, __func__, IN(PHASE_CREATED))) return fmi2Error;
    ((Instance *)c)->now.t0 = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    GIVEN(c);
    return status(stopset_enter_initialization(c, ((Instance *)c)->now.t0));
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    GIVEN(c);
    return status(stopset_exit_initialization(c));
}
fmi2Status fmi2Terminate(fmi2Component c) {
    GIVEN(c);
    if (stopset_expect(c, __func__, RUNNING)) return fmi2Error;
    ((Instance *)c)->now.phase = PHASE_TERMINATED;
    return fmi2OK;
}
fmi2Status fmi2Reset(fmi2Component c) {
    GIVEN(c);
    stopset_reset(c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    GIVEN(c);
    return status(stopset_get_real(c, vr, n, value));
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    GIVEN(c);
    return status(stopset_get_integer(c, vr, n, value));
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    GIVEN(c);
    for (size_t k = 0; k < n; k++) {
        uint8_t b;
        if (stopset_get_boolean(c, &vr[k], 1, &b)) return fmi2Error;
        value[k] = b ? fmi2True : fmi2False;
    }
    return fmi2OK;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(value);
    if (n) REFUSE("the model has no string variables");
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    GIVEN(c);
    return status(stopset_set_real(c, vr, n, value));
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    GIVEN(c);
    return status(stopset_set_integer(c, vr, n, value));
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    GIVEN(c);
    for (size_t k = 0; k < n; k++) {
        uint8_t b = value[k] != fmi2False;
        if (stopset_set_boolean(c, &vr[k], 1, &b)) return fmi2Error;
    }
    return fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(value);
    if (n) REFUSE("the model has no string variables");
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    GIVEN(c);
    return status(stopset_get_state(c, state));
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    GIVEN(c);
    return status(stopset_set_state(c, state));
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    GIVEN(c);
    if (state) {
        free(*state);
        *state = 0;
    }
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    GIVEN(c);
    UNUSED(state);
    *size = stopset_serialized_size();
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    GIVEN(c);
    return status(stopset_serialize(c, state, (unsigned char *)bytes, size));
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    GIVEN(c);
    return status(stopset_deserialize(c, (const unsigned char *)bytes, size, state));
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t nUnknown,
                                        const fmi2ValueReference knowns[], size_t nKnown, const fmi2Real seed[], fmi2Real out[]) {
    GIVEN(c);
    return status(stopset_directional(c, unknowns, nUnknown, knowns, nKnown, seed, out));
}

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    GIVEN(c);
    if (stopset_expect(c, __func__, IN(PHASE_CONTINUOUS))) return fmi2Error;
    ((Instance *)c)->now.phase = PHASE_EVENT;
    return fmi2OK;
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    GIVEN(c);
    if (stopset_expect(c, __func__, IN(PHASE_EVENT))) return fmi2Error;
    int changed, defined;
    if (stopset_update_discrete(c, &changed, &defined, &info->nextEventTime)) return fmi2Error;
    info->newDiscreteStatesNeeded = info->terminateSimulation = info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = changed ? fmi2True : fmi2False;
    info->nextEventTimeDefined = defined ? fmi2True : fmi2False;
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    GIVEN(c);
    if (stopset_expect(c, __func__, IN(PHASE_EVENT))) return fmi2Error;
    ((Instance *)c)->now.phase = PHASE_CONTINUOUS;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetPrior, fmi2Boolean *enterEventMode, fmi2Boolean *terminate) {
    GIVEN(c);
    UNUSED(noSetPrior);
    int event = 0;
    const Level done = stopset_completed_step(c, &event);
    *enterEventMode = event ? fmi2True : fmi2False;
    *terminate = fmi2False;
    return status(done);
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    GIVEN(c);
    return status(stopset_set_time(c, time));
}
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    GIVEN(c);
    return status(stopset_set_states(c, x, n));
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    GIVEN(c);
    return status(stopset_get_derivatives(c, dx, n));
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
    GIVEN(c);
    return status(stopset_get_indicators(c, indicators, n));
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    GIVEN(c);
    return status(stopset_get_states(c, x, n));
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n) {
    GIVEN(c);
    for (size_t k = 0; k < n; k++) nominals[k] = 1.0;
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(order), UNUSED(value);
    REFUSE("inputs are held over a step, see the capability flags");
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                        fmi2Real value[]) {
    GIVEN(c);
    UNUSED(vr), UNUSED(n), UNUSED(order), UNUSED(value);
    REFUSE("output derivatives are not offered, see the capability flags");
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean noSetPrior) {
    GIVEN(c);
    UNUSED(noSetPrior);
    return status(stopset_do_step(c, t, h));
}
fmi2Status fmi2CancelStep(fmi2Component c) {
    GIVEN(c);
    REFUSE("steps do not run in the background, there is none to cancel");
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    GIVEN(c);
    UNUSED(kind), UNUSED(value);
    REFUSE("steps do not run in the background");
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    GIVEN(c);
    if (kind != fmi2LastSuccessfulTime) REFUSE("only the last successful time is known");
    *value = ((Instance *)c)->now.s.r[VR_TIME];
    return fmi2OK;
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    GIVEN(c);
    UNUSED(kind), UNUSED(value);
    REFUSE("there is no such status");
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    GIVEN(c);
    if (kind != fmi2Terminated) REFUSE("there is no such status");
    *value = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    GIVEN(c);
    UNUSED(kind), UNUSED(value);
    REFUSE("there is no such status");
}
