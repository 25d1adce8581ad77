/* Calls an FMI 3 unit in any order with any values, linked with its sources and the sanitizers.
 *
 * Usage: fuzz TOKEN FIRST_SEED COUNT [FILE]
 * FILE: where certified bounds are written, see `keep`. Says "ok" and how often which promise was looked at, or what was broken: every error has a sentence, see fmu_fuzz.h for the others.
 */
#include "fmi3Functions.h"
#include "fmu_fuzz.h"

static void write_log(fmi3InstanceEnvironment env, fmi3Status status, fmi3String category, fmi3String message) {
    (void)env, (void)status, (void)category;
    snprintf(last, sizeof last, "%s", message);
}

static fmi3Instance running;

/* Within a step everything may be read and nothing set; sometimes the step shall end here, later, or at no time at all. */
static void within(fmi3InstanceEnvironment env, fmi3Float64 t, fmi3Boolean set, fmi3Boolean get, fmi3Boolean finished, fmi3Boolean may_end,
                   fmi3Boolean *end, fmi3Float64 *until) {
    (void)env, (void)set, (void)get, (void)finished;
    unsigned vr = below(N_REAL);
    double x, at;
    fmi3FMUState saved = 0;
    const unsigned time = 0;
    if (fmi3GetFloat64(running, &vr, 1, &x, 1) != fmi3OK) printf("broken: no value within a step\n"), exit(1);
    if (fmi3GetFloat64(running, &time, 1, &at, 1) != fmi3OK || at != t) printf("broken: told %g, and it is %g\n", t, at), exit(1);
    if (!below(8) && fmi3SetFloat64(running, &vr, 1, &x, 1) == fmi3OK) printf("broken: set within a step\n"), exit(1);
    if (!below(8) && fmi3DoStep(running, t, 0.01, fmi3True, &set, &get, &finished, &x) == fmi3OK) printf("broken: a step within a step\n"), exit(1);
    if (!below(8) && fmi3GetFMUState(running, &saved) == fmi3OK) printf("broken: a state within a step\n"), exit(1);
    if (!below(8) && fmi3Reset(running) == fmi3OK) printf("broken: reset within a step\n"), exit(1);
    *end = below(3) == 0;
    *until = below(3) ? t + 0.001 * below(5) : number();
    (void)may_end;
}

int main(int argc, char **argv) {
    if (argc != 4 && argc != 5) return 2;
    if (argc == 5 && !(kept = fopen(argv[4], "w"))) return 2;
    const char *token = argv[1];
    const long first = atol(argv[2]), count = atol(argv[3]);
    double x[N_ALL + 8], y[N_ALL + 8];
    unsigned vr[N_ALL + 8], all[N_REAL], measured_of = VR_MEASURED, every_of = N_REAL + IX_STOP_EVERY;
    for (unsigned k = 0; k < N_REAL; k++) all[k] = k;
    for (long seed = first; seed < first + count; seed++) {
        state = (uint64_t)seed;
        int call = 0;
        const int exchange = below(3) == 0, events = below(3) == 0;
        fmi3Instance c = below(20) ? (exchange ? fmi3InstantiateModelExchange("a", token, "", fmi3False, fmi3False, 0, write_log)
                                               : fmi3InstantiateCoSimulation("a", token, "", fmi3False, fmi3False, events, below(2) != 0, 0, 0, 0,
                                                                             write_log, below(2) ? within : 0))
                                   : fmi3InstantiateCoSimulation("a", "no token", 0, fmi3False, fmi3False, fmi3False, fmi3False, 0, 0, 0, write_log, 0);
        fmi3FMUState saved = 0;
        double t = 0.0;
        running = c;
        if (c && below(10)) { /* mostly a run that begins as it should */
            const fmi3Boolean measured = below(3) != 0; /* a model of motor torque is covered only then */
            fmi3SetBoolean(c, &measured_of, 1, &measured, 1);
            if (below(3)) fmi3SetFloat64(c, vr, somewhere(vr, x, 1), x, 5 * NJ);
            vr[0] = VR_DQ_START + below(NJ);
            x[0] = number();
            if (below(2)) fmi3SetFloat64(c, vr, 1, x, 1);
            for (unsigned k = below(4); k; k--) {
                vr[0] = place(N_REAL + 1);
                x[0] = number();
                fmi3SetFloat64(c, vr, 1, x, 1);
            }
            fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3False, 0.0);
            fmi3ExitInitializationMode(c);
            if (exchange) fmi3EnterContinuousTimeMode(c);
            if (!exchange && events) fmi3EnterStepMode(c);
        }
        for (call = 0; call < 60; call++) {
            fmi3Status got = fmi3OK;
            fmi3Boolean a, b, d, e, f, flags[FLAGS];
            int flag[FLAGS];
            int32_t every, i = below(2) ? 1 : (int32_t)below(7) - 2;
            unsigned many = below(4);
            size_t size = 0;
            last[0] = 0;
            switch (below(27)) {
            case 0: got = fmi3EnterInitializationMode(c, fmi3False, 0.0, number(), fmi3False, 0.0); break;
            case 1: got = fmi3ExitInitializationMode(c); break;
            case 2:
            case 3:
            case 4:
                for (unsigned k = 0; k < many; k++) {
                    vr[k] = place(N_REAL + 2);
                    x[k] = number();
                }
                got = fmi3SetFloat64(c, vr, many, x, below(20) ? many : many + 1);
                break;
            case 5:
                vr[0] = below(2) ? below(N_ALL + 2) : N_REAL + IX_STOP;
                got = fmi3SetInt32(c, vr, 1, &i, 1);
                break;
            case 6:
            case 7:
                vr[0] = place(N_ALL + 2);
                a = below(2) != 0;
                got = fmi3SetBoolean(c, vr, 1, &a, 1);
                break;
            case 8:
            case 9:
            case 10: { /* time as the unit has it, mostly */
                vr[0] = 0;
                if (below(4) && fmi3GetFloat64(c, vr, 1, x, 1) == fmi3OK) t = x[0];
                got = fmi3DoStep(c, below(8) ? t : number(), below(3) ? 0.01 : number(), fmi3True, &a, &b, &d, y);
                break;
            }
            case 11: got = fmi3GetFMUState(c, &saved); break;
            case 12:
                if (saved) got = fmi3SetFMUState(c, saved);
                break;
            case 13: {
                if (!saved || fmi3SerializedFMUStateSize(c, saved, &size) != fmi3OK) break;
                unsigned char *bytes = malloc(size);
                got = fmi3SerializeFMUState(c, saved, bytes, below(3) ? size : size / 2);
                const int damaged = got == fmi3OK && !below(2);
                if (damaged) bytes[below(below(2) ? 80 : (unsigned)size)] ^= 1u << below(8); /* in the head: whose state it is */
                if (got == fmi3OK) got = fmi3DeserializeFMUState(c, bytes, size, &saved);
                if (damaged && got == fmi3OK) BROKEN("a damaged state was taken");
                free(bytes);
                break;
            }
            case 14:
                if (!below(6)) got = fmi3Reset(c);
                break;
            case 15:
                if (!below(12)) got = fmi3Terminate(c);
                break;
            case 16:
                for (unsigned k = 0; k < 2; k++) {
                    vr[k] = below(N_ALL + 2);
                    vr[4 + k] = below(N_ALL + 2);
                    x[k] = number();
                }
                got = (below(2) ? fmi3GetDirectionalDerivative : fmi3GetAdjointDerivative)(c, vr, 2, vr + 4, 2, x, 2, y, 2);
                break;
            case 17: got = fmi3SetTime(c, number()); break;
            case 18:
                if (fmi3GetNumberOfContinuousStates(c, &size) != fmi3OK || size > N_ALL) break;
                for (size_t k = 0; k < size; k++) x[k] = number();
                got = below(2) ? fmi3SetContinuousStates(c, x, size) : fmi3GetContinuousStateDerivatives(c, y, size);
                break;
            case 19:
                if (fmi3GetNumberOfEventIndicators(c, &size) == fmi3OK && size <= N_ALL) got = fmi3GetEventIndicators(c, y, size);
                break;
            case 20: got = fmi3UpdateDiscreteStates(c, &a, &b, &d, &e, &f, y); break;
            case 21: got = below(2) ? fmi3EnterEventMode(c) : fmi3EnterContinuousTimeMode(c); break;
            case 24: /* arrays come behind the scalars, clocks behind them */
                vr[0] = below(N_REAL);
                vr[1] = N_ALL + below(N_ARRAYS);
                for (unsigned k = 0; k < 1 + NJ; k++) x[k] = number();
                got = below(2) ? fmi3SetFloat64(c, vr, 2, x, below(9) ? 1 + NJ : 2) : fmi3GetFloat64(c, vr, 2, y, 1 + NJ);
                break;
            case 25:
                vr[0] = N_ALL + N_ARRAYS + below(4);
                a = below(3) != 0;
                got = below(4) ? fmi3SetClock(c, vr, 1, &a) : fmi3GetClock(c, vr, 1, &b);
                break;
            case 26:
                got = below(2) ? fmi3EnterStepMode(c) : fmi3EnterEventMode(c);
                break;
            case 23: got = fmi3SetFloat64(c, vr, somewhere(vr, x, 0), x, 3 * NJ); break;
            case 22: got = fmi3CompletedIntegratorStep(c, fmi3True, &a, &b); break;
            default: break;
            }
            if (got != fmi3OK && c && !last[0]) BROKEN("an error without a sentence");
            errors += got != fmi3OK;
            if (!c) continue;
            if (fmi3GetBoolean(c, flags_of, FLAGS, flags, FLAGS) != fmi3OK || fmi3GetInt32(c, &every_of, 1, &every, 1) != fmi3OK) continue;
            if (fmi3GetFloat64(c, all, N_REAL, x, N_REAL) != fmi3OK) continue;
            for (int k = 0; k < FLAGS; k++) flag[k] = flags[k];
            const char *wrong = flag[FLAG_COVERED] ? beyond(x, flag[FLAG_MEASURED]) : 0;
            if (!wrong) wrong = untrue(x, flag[FLAG_CERTIFIED]);
            if (wrong) BROKEN("covered %d, certified %d, and %s", flag[FLAG_COVERED], flag[FLAG_CERTIFIED], wrong);
            covered_seen += flag[FLAG_COVERED];
            certified_seen += flag[FLAG_CERTIFIED];
            keep(x, flag, every);
        }
        if (c && saved) fmi3FreeFMUState(c, &saved);
        free(saved);
        fmi3FreeInstance(c);
    }
    if (kept) fclose(kept);
    printf("ok %ld errors, %ld times covered, %ld times certified\n", errors, covered_seen, certified_seen);
    return 0;
}
