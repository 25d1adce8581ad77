/* Plays calls from standard input on a unit's library, on whatever machine it is compiled for, and prints numbers with all their bits.
 *
 * Usage: player LIBRARY TOKEN. A line is one call: `r VR VALUE` (real), `i VR VALUE` (integer), `b VR VALUE` (flag), `step T H`,
 * `get VR COUNT`. At the end it says on standard error how much processor time the calls of `get` took.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifdef _WIN32
#include <windows.h>
#define OPEN(p) (void *)LoadLibraryA(p)
#define FIND(l, n) (void *)GetProcAddress((HMODULE)(l), n)

static double now(void) { /* clock() is the time of day there */
    FILETIME begun, ended, kernel, user;
    GetProcessTimes(GetCurrentProcess(), &begun, &ended, &kernel, &user);
    return 1e-7 * ((double)user.dwHighDateTime * 4294967296.0 + (double)user.dwLowDateTime);
}
#else
#include <dlfcn.h>
#define OPEN(p) dlopen(p, RTLD_NOW | RTLD_LOCAL)
#define FIND(l, n) dlsym(l, n)

static double now(void) { return (double)clock() / CLOCKS_PER_SEC; }
#endif

#include "fmi3FunctionTypes.h"

enum { MOST = 64 };

static void say(fmi3InstanceEnvironment env, fmi3Status status, fmi3String category, fmi3String message) {
    (void)env, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

#define BIND(name)                                                             \
    fmi3##name##TYPE *name;                                                    \
    {                                                                          \
        void *symbol = FIND(library, "fmi3" #name);                            \
        if (!symbol) return printf("no symbol fmi3" #name "\n"), 1;            \
        memcpy(&name, &symbol, sizeof symbol);                                 \
    }

int main(int argc, char **argv) {
    void *library = argc == 3 ? OPEN(argv[1]) : 0;
    if (!library) return printf("no library\n"), 1;
    BIND(InstantiateCoSimulation)
    BIND(EnterInitializationMode)
    BIND(ExitInitializationMode)
    BIND(SetFloat64)
    BIND(SetInt32)
    BIND(SetBoolean)
    BIND(GetFloat64)
    BIND(DoStep)
    BIND(FreeInstance)
    fmi3Instance c = InstantiateCoSimulation("a", argv[2], 0, 0, 0, 0, 0, 0, 0, 0, say, 0);
    if (!c || EnterInitializationMode(c, fmi3False, 0, 0.0, fmi3False, 0) || ExitInitializationMode(c)) return 1;
    char line[256], what[8], first[64], second[64];
    double took = 0.0;
    while (fgets(line, sizeof line, stdin)) {
        if (sscanf(line, "%7s %63s %63s", what, first, second) != 3) return printf("what is %s\n", line), 1;
        fmi3ValueReference vr[MOST];
        const int count = atoi(second);
        for (int k = 0; k < MOST; k++) vr[k] = (fmi3ValueReference)(atoi(first) + k);
        fmi3Float64 x[MOST] = {strtod(second, 0)}, reached;
        fmi3Boolean flag = count != 0, event, end, early;
        fmi3Status status = fmi3OK;
        if (!strcmp(what, "r")) status = SetFloat64(c, vr, 1, x, 1);
        if (!strcmp(what, "i")) status = SetInt32(c, vr, 1, (const fmi3Int32[]){count}, 1);
        if (!strcmp(what, "b")) status = SetBoolean(c, vr, 1, &flag, 1);
        if (!strcmp(what, "step")) status = DoStep(c, strtod(first, 0), x[0], fmi3True, &event, &end, &early, &reached);
        if (!strcmp(what, "get")) {
            if (count > MOST) return 1;
            const double begin = now();
            status = GetFloat64(c, vr, (size_t)count, x, (size_t)count);
            took += now() - begin;
            for (int k = 0; k < count; k++) {
                unsigned long long bits;
                memcpy(&bits, x + k, sizeof bits);
                printf("%016llx\n", x[k] == x[k] ? bits : 0x7ff8000000000000ull);
            }
        }
        if (status != fmi3OK) return printf("refused: %s\n", line), 1;
    }
    FreeInstance(c);
    fprintf(stderr, "%.6f\n", took);
    return 0;
}
