/* An importing side without Python: loads the FMU's library and uses it as a simulator would.
 *
 * Usage: importer LIBRARY TOKEN STEPS STEP_SIZE JOINTS [VR_TAU VR_Q]. Torque of joint j at step k: 0.1 (j + 1) ((k / 10) % 7 - 3).
 * Prints the final positions in full precision, then "ok", or what failed.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#define OPEN(p) (void *)LoadLibraryA(p)
#define FIND(l, n) (void *)GetProcAddress((HMODULE)(l), n)
#else
#include <dlfcn.h>
#define OPEN(p) dlopen(p, RTLD_NOW | RTLD_LOCAL)
#define FIND(l, n) dlsym(l, n)
#endif

#include "fmi3FunctionTypes.h"

static char last[512];

static void write_log(fmi3InstanceEnvironment env, fmi3Status status, fmi3String category, fmi3String message) {
    (void)env, (void)status, (void)category;
    snprintf(last, sizeof last, "%s", message);
}

#define BIND(name)                                                             \
    fmi3##name##TYPE *name;                                                    \
    {                                                                          \
        void *symbol = FIND(library, "fmi3" #name);                            \
        if (!symbol) return printf("no symbol fmi3" #name "\n"), 1;            \
        memcpy(&name, &symbol, sizeof symbol);                                 \
    }
#define CHECK(what) \
    if (!(what)) return printf("failed: %s (line %d; last message: %s)\n", #what, __LINE__, last), 1

int main(int argc, char **argv) {
    if (argc < 8) return 2;
    void *library = OPEN(argv[1]);
    if (!library) return printf("cannot load %s\n", argv[1]), 1;
    int steps = atoi(argv[3]), n = atoi(argv[5]);
    double h = atof(argv[4]);
    unsigned vr_tau = (unsigned)atoi(argv[6]), vr_q = (unsigned)atoi(argv[7]);
    BIND(InstantiateCoSimulation)
    BIND(InstantiateModelExchange)
    BIND(FreeInstance)
    BIND(EnterInitializationMode)
    BIND(ExitInitializationMode)
    BIND(Terminate)
    BIND(Reset)
    BIND(SetFloat64)
    BIND(GetFloat64)
    BIND(DoStep)
    BIND(GetFMUState)
    BIND(SetFMUState)
    BIND(FreeFMUState)
    BIND(SerializedFMUStateSize)
    BIND(SerializeFMUState)
    BIND(DeserializeFMUState)
    BIND(GetVersion)
    CHECK(strcmp(GetVersion(), "3.0") == 0);
    CHECK(InstantiateCoSimulation("x", "{wrong}", 0, 0, 0, 0, 0, 0, 0, 0, write_log, 0) == 0);
    CHECK(strstr(last, "token") && strstr(last, "unpack the FMU again"));
    fmi3Instance a = InstantiateCoSimulation("a", argv[2], 0, 0, 0, 0, 0, 0, 0, 0, write_log, 0);
    fmi3Instance b = InstantiateCoSimulation("b", argv[2], 0, 0, 0, 0, 0, 0, 0, 0, write_log, 0);
    fmi3Instance c = InstantiateModelExchange("c", argv[2], 0, 0, 0, 0, write_log);
    CHECK(a && b && c);
    fmi3Boolean event, terminate, early;
    fmi3Float64 reached, q[8], other[8], tau[8];
    fmi3ValueReference tau_vr[8], q_vr[8];
    for (int j = 0; j < n; j++) tau_vr[j] = vr_tau + (unsigned)j, q_vr[j] = vr_q + (unsigned)j;
    CHECK(DoStep(a, 0.0, h, fmi3True, &event, &terminate, &early, &reached) == fmi3Error);
    CHECK(strstr(last, "calling sequence"));
    for (int round = 0; round < 2; round++) {
        CHECK(EnterInitializationMode(a, fmi3False, 0, 0.0, fmi3False, 0) == fmi3OK);
        CHECK(ExitInitializationMode(a) == fmi3OK);
        if (round == 0) {
            CHECK(EnterInitializationMode(b, fmi3False, 0, 0.0, fmi3False, 0) == fmi3OK);
            CHECK(ExitInitializationMode(b) == fmi3OK);
        }
        fmi3FMUState half = 0, again = 0;
        fmi3Byte *bytes = 0;
        size_t size = 0;
        for (int pass = 0; pass < 2; pass++) {
            if (pass == 1) CHECK(SetFMUState(a, again) == fmi3OK);
            for (int k = pass ? steps / 2 : 0; k < steps; k++) {
                if (k == steps / 2 && pass == 0) {
                    CHECK(GetFMUState(a, &half) == fmi3OK && SerializedFMUStateSize(a, half, &size) == fmi3OK);
                    bytes = malloc(size);
                    CHECK(SerializeFMUState(a, half, bytes, size) == fmi3OK);
                    CHECK(DeserializeFMUState(a, bytes, size, &again) == fmi3OK);
                }
                for (int j = 0; j < n; j++) tau[j] = 0.1 * (j + 1) * ((k / 10) % 7 - 3);
                CHECK(SetFloat64(a, tau_vr, (size_t)n, tau, (size_t)n) == fmi3OK);
                CHECK(DoStep(a, k * h, h, fmi3True, &event, &terminate, &early, &reached) == fmi3OK);
                CHECK(!event && !terminate && !early && fabs(reached - (k + 1) * h) < 1e-9);
            }
            CHECK(GetFloat64(a, q_vr, (size_t)n, q, (size_t)n) == fmi3OK);
            if (pass == 1 || round == 1)
                for (int j = 0; j < n; j++) CHECK(q[j] == other[j]);
            memcpy(other, q, sizeof q);
        }
        bytes[0] ^= 1;
        CHECK(DeserializeFMUState(a, bytes, size, &again) == fmi3Error && strstr(last, "not a state of this FMU"));
        free(bytes);
        CHECK(FreeFMUState(a, &half) == fmi3OK && FreeFMUState(a, &again) == fmi3OK && !half);
        if (round == 0) {
            CHECK(DoStep(a, 0.0, h, fmi3True, &event, &terminate, &early, &reached) == fmi3Error && strstr(last, "communication point"));
            CHECK(SetFloat64(a, q_vr, 1, q, 1) == fmi3Error && strstr(last, "cannot be set now"));
            CHECK(Terminate(a) == fmi3OK);
            CHECK(Reset(a) == fmi3OK);
        }
    }
    tau[0] = NAN;
    CHECK(SetFloat64(b, tau_vr, 1, tau, 1) == fmi3OK);
    CHECK(DoStep(b, 0.0, h, fmi3True, &event, &terminate, &early, &reached) == fmi3Error && strstr(last, "tau"));
    for (int j = 0; j < n; j++) printf("%.17g\n", q[j]);
    FreeInstance(a);
    FreeInstance(b);
    FreeInstance(c);
    printf("ok\n");
    return 0;
}
