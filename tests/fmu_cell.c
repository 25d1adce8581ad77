/* Parts of a cell as FMI 2 units: a controller that drives the first joint, a light curtain with the person who walks through it,
 * and the stop logic. One of CONTROLLER, CURTAIN, LOGIC is defined; values are r[], the stop request an integer too. */
#include <math.h>
#include <stdlib.h>

#include "fmi2Functions.h"

typedef struct {
    double r[8];
} Part;

static void act(double *r, double t) {
#if defined CONTROLLER /* q, dq -> tau */
    const double wanted = fmin(SPEED, 4.0 * t);
    r[2] = 200.0 * (wanted - r[1]) + DAMPING * wanted;
    (void)r[0];
#elif defined CURTAIN /* -> broken, walked [m] past the curtain */
    r[1] = fmax(t - BREAKS, 0.0) * 1.6;
    r[0] = t >= BREAKS;
#else /* q, dq, forward, broken -> stop, ahead: where the arm can still come, two cycles of delay and the present one included */
#if TEXTBOOK
    const double way = r[1] * fabs(r[1]) / (2.0 * DECELERATION);
#else
    const double way = r[2];
#endif
    r[5] = r[0] + 3.0 * CYCLE * fabs(r[1]) + way;
    if (t > 0.0 && r[3] > 0.5 && !(r[5] < EDGE)) r[4] = 1.0; /* where nothing is proved she is in reach */
#endif
}

#define OK(...)       \
    do {              \
        __VA_ARGS__;  \
        return fmi2OK; \
    } while (0)
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *f, fmi2Boolean v,
                              fmi2Boolean log) {
    (void)name, (void)type, (void)guid, (void)resources, (void)f, (void)v, (void)log;
    return calloc(1, sizeof(Part));
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real g) {
    OK((void)c, (void)a, (void)b, (void)d, (void)e, (void)g);
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { OK((void)c); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { OK(act(((Part *)c)->r, 0.0)); }
fmi2Status fmi2Terminate(fmi2Component c) { OK((void)c); }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) value[k] = ((Part *)c)->r[vr[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) ((Part *)c)->r[vr[k]] = value[k];
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    for (size_t k = 0; k < n; k++) value[k] = (int)((Part *)c)->r[vr[k]];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b) {
    (void)h, (void)b;
    OK(act(((Part *)c)->r, t));
}

/* What importers look for and these parts have no use of. */
#define NO(name, ...) \
    fmi2Status name(__VA_ARGS__) { return fmi2Error; }
#define VALUES(type) fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
NO(fmi2SetDebugLogging, fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
NO(fmi2Reset, fmi2Component c)
NO(fmi2SetInteger, VALUES(const fmi2Integer))
NO(fmi2GetBoolean, VALUES(fmi2Boolean))
NO(fmi2SetBoolean, VALUES(const fmi2Boolean))
NO(fmi2GetString, VALUES(fmi2String))
NO(fmi2SetString, VALUES(const fmi2String))
NO(fmi2CancelStep, fmi2Component c)
NO(fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[])
NO(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[])
NO(fmi2GetStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
NO(fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
NO(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
NO(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
NO(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
NO(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *state)
NO(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate state)
NO(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *state)
NO(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate state, size_t *size)
NO(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
NO(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
NO(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference u[], size_t n, const fmi2ValueReference k[], size_t m, const fmi2Real d[], fmi2Real out[])
