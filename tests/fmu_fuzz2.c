/* Calls an FMI 2 unit in any order with any values, linked with its sources and the sanitizers; as fmu_fuzz.c for FMI 3.
 *
 * Usage: fuzz TOKEN FIRST_SEED COUNT [FILE]
 */
#include <stdarg.h>

#include "fmi2Functions.h"
#include "fmu_fuzz.h"

enum { CALLS = 60, KINDS_OF_CALL = 31 };

static void write_log(fmi2ComponentEnvironment env, fmi2String name, fmi2Status status, fmi2String category, fmi2String message, ...) {
    (void)env, (void)name, (void)status, (void)category;
    va_list given;
    va_start(given, message);
    vsnprintf(last, sizeof last, message, given);
    va_end(given);
}

static unsigned vr[N_ALL + 8];
static double x[N_ALL + 8], y[N_ALL + 8];
static fmi2FMUstate saved;

static void some(unsigned many, unsigned among, unsigned at) {
    for (unsigned k = 0; k < many; k++) {
        vr[at + k] = place(among);
        x[at + k] = number();
    }
}

static fmi2Status serialized(fmi2Component c) {
    size_t size = 0;
    if (!saved || fmi2SerializedFMUstateSize(c, saved, &size) != fmi2OK) return fmi2OK;
    fmi2Byte *bytes = malloc(size);
    fmi2Status got = fmi2SerializeFMUstate(c, saved, bytes, below(3) ? size : size / 2);
    const int damaged = got == fmi2OK && !below(2);
    if (damaged) bytes[below(below(2) ? 80 : (unsigned)size)] ^= 1u << below(8); /* in the head: whose state it is */
    if (got == fmi2OK) got = fmi2DeSerializeFMUstate(c, bytes, size, &saved);
    if (damaged && got == fmi2OK) printf("a damaged state was taken\n"), fflush(stdout), exit(1);
    free(bytes);
    return got;
}

static fmi2Status stepped(fmi2Component c) { /* time as the unit has it, mostly */
    const unsigned time = 0;
    double t = number();
    if (below(8) && fmi2GetReal(c, &time, 1, &x[0]) == fmi2OK) t = x[0];
    return fmi2DoStep(c, t, below(3) ? 0.01 : number(), below(2));
}

static fmi2Status any_call(fmi2Component c) {
    fmi2Integer whole = below(2) ? 1 : (fmi2Integer)below(7) - 2;
    fmi2Boolean yes = below(3) ? (fmi2Boolean)below(2) : (fmi2Boolean)below(1000), end;
    fmi2Status of;
    fmi2String text = "text";
    fmi2EventInfo info;
    const unsigned many = below(4), kind = below(KINDS_OF_CALL);
    switch (kind) {
    case 0: return fmi2SetupExperiment(c, yes, number(), number(), yes, number());
    case 1: return fmi2EnterInitializationMode(c);
    case 2: return fmi2ExitInitializationMode(c);
    case 3:
    case 4:
    case 5: return some(many, N_REAL + 2, 0), fmi2SetReal(c, vr, many, x);
    case 6: return some(1, N_ALL + 2, 0), vr[0] = below(2) ? vr[0] : N_REAL + IX_STOP, fmi2SetInteger(c, vr, 1, &whole);
    case 7:
    case 8: return some(1, N_ALL + 2, 0), fmi2SetBoolean(c, vr, 1, &yes);
    case 9:
    case 10:
    case 11: return stepped(c);
    case 12: return fmi2GetFMUstate(c, &saved);
    case 13: return saved ? fmi2SetFMUstate(c, saved) : fmi2OK;
    case 14: return serialized(c);
    case 15: return below(6) ? fmi2OK : fmi2Reset(c);
    case 16: return below(12) ? fmi2OK : fmi2Terminate(c);
    case 17: return some(2, N_ALL + 2, 0), some(2, N_ALL + 2, 4), fmi2GetDirectionalDerivative(c, vr, 2, vr + 4, 2, x, y);
    case 18: return fmi2SetTime(c, number());
    case 19: return some(NS, N_ALL, 0), fmi2SetContinuousStates(c, x, below(5) ? NS : below(NS));
    case 20: return fmi2GetDerivatives(c, y, below(5) ? NS : below(NS));
    case 21: return fmi2GetEventIndicators(c, y, below(5) && HAS_INDICATORS ? NJ : below(NJ));
    case 22: return fmi2NewDiscreteStates(c, &info);
    case 23: return below(2) ? fmi2EnterEventMode(c) : fmi2EnterContinuousTimeMode(c);
    case 24: return fmi2CompletedIntegratorStep(c, yes, &yes, &end);
    case 25: return below(2) ? fmi2GetContinuousStates(c, y, below(5) ? NS : below(NS)) : fmi2GetNominalsOfContinuousStates(c, y, NS);
    case 26: return some(1, N_ALL + 2, 0), below(2) ? fmi2SetString(c, vr, many > 0, &text) : fmi2GetString(c, vr, many > 0, &text);
    case 27: return some(1, N_REAL, 0), below(2) ? fmi2SetRealInputDerivatives(c, vr, 1, &whole, x) : fmi2GetRealOutputDerivatives(c, vr, 1, &whole, y);
    case 29: return fmi2SetReal(c, vr, somewhere(vr, x, 0), x);
    case 28: return below(2) ? fmi2GetStatus(c, fmi2DoStepStatus, &of) : fmi2CancelStep(c);
    default: return below(2) ? fmi2GetRealStatus(c, (fmi2StatusKind)below(4), y) : fmi2GetBooleanStatus(c, (fmi2StatusKind)below(4), &end);
    }
}

/* Mostly a run that begins as it should; of a model of motor torque only a measured state is covered. */
static void begin(fmi2Component c, int exchange) {
    const unsigned measured_of = VR_MEASURED;
    const unsigned speed_of = VR_DQ_START + below(NJ);
    const fmi2Boolean measured = below(3) != 0;
    const double speed = number();
    fmi2SetBoolean(c, &measured_of, 1, &measured);
    if (below(3)) fmi2SetReal(c, vr, somewhere(vr, x, 1), x);
    if (below(2)) fmi2SetReal(c, &speed_of, 1, &speed);
    const unsigned many = below(4);
    some(many, N_REAL + 1, 0);
    for (unsigned k = 0; k < many; k++) fmi2SetReal(c, vr + k, 1, x + k);
    fmi2SetupExperiment(c, below(2), number(), 0.0, below(2), number());
    fmi2EnterInitializationMode(c);
    fmi2ExitInitializationMode(c);
    if (exchange) fmi2EnterContinuousTimeMode(c);
}

static const char *promises(fmi2Component c) {
    static const unsigned every_of = N_REAL + IX_STOP_EVERY;
    static unsigned all[N_REAL];
    fmi2Boolean flag[FLAGS];
    fmi2Integer every;
    for (unsigned k = 0; k < N_REAL; k++) all[k] = k;
    if (fmi2GetBoolean(c, flags_of, FLAGS, flag) != fmi2OK || fmi2GetInteger(c, &every_of, 1, &every) != fmi2OK) return 0;
    if (fmi2GetReal(c, all, N_REAL, x) != fmi2OK) return 0;
    covered_seen += flag[FLAG_COVERED];
    certified_seen += flag[FLAG_CERTIFIED];
    keep(x, flag, every);
    const char *wrong = flag[FLAG_COVERED] ? beyond(x, flag[FLAG_MEASURED]) : 0;
    return wrong ? wrong : untrue(x, flag[FLAG_CERTIFIED]);
}

int main(int argc, char **argv) {
    if (argc != 4 && argc != 5) return 2;
    if (argc == 5 && !(kept = fopen(argv[4], "w"))) return 2;
    static const char *const folders[] = {0, "", "file:///nowhere", "no address", "file:///%00"};
    const fmi2CallbackFunctions callbacks = {write_log, calloc, free, 0, 0};
    const long first = atol(argv[2]), count = atol(argv[3]);
    for (long seed = first; seed < first + count; seed++) {
        state = (uint64_t)seed;
        int call = 0;
        const int exchange = below(3) == 0, right = below(20) != 0, heard = below(30) != 0;
        last[0] = 0;
        fmi2Component c = fmi2Instantiate("a", exchange ? fmi2ModelExchange : fmi2CoSimulation, right ? argv[1] : below(2) ? "no token" : 0,
                                          folders[below(sizeof folders / sizeof *folders)], heard ? &callbacks : 0, fmi2False, below(2) != 0);
        if (!right && (c || (heard && !last[0]))) BROKEN("a wrong GUID was taken, or refused without a sentence");
        if (right && !c) BROKEN("the right GUID was refused");
        if (c && below(10)) begin(c, exchange);
        for (call = 0; call < CALLS; call++) {
            last[0] = 0;
            const fmi2Status got = any_call(c);
            if (got != fmi2OK && c && heard && !last[0]) BROKEN("an error without a sentence");
            errors += got != fmi2OK;
            const char *wrong = c ? promises(c) : 0;
            if (wrong) BROKEN("%s", wrong);
        }
        if (c && saved) fmi2FreeFMUstate(c, &saved);
        free(saved);
        saved = 0;
        fmi2FreeInstance(c);
    }
    if (kept) fclose(kept);
    printf("ok %ld errors, %ld times covered, %ld times certified\n", errors, covered_seen, certified_seen);
    return 0;
}
