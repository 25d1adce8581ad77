/* CPU time of a unit's calls without an importer: compiled with the unit's own sources, see fmu.py.
 *
 * Usage: fmu IN.csv TOKEN; the reference inputs of the unit are played, free and with the measured state connected, and of every second
 * row the bound of every kind of stop is read. Linked with -Wl,--wrap=stopset_power_off, so that the core's proof is timed apart from the call around it.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi3Functions.h"
#include "stopset_core.h"

enum { MOST_ROWS = 4000, COLUMNS = 1 + 4 * NJ, REPEATED = 5 };
static double rows[MOST_ROWS][COLUMNS], took[REPEATED * MOST_ROWS], around[MOST_ROWS], proof;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int __real_stopset_power_off(const StopsetStops *stops, const StopsetStates *from, double *work, const StopsetBound *out);
int __wrap_stopset_power_off(const StopsetStops *stops, const StopsetStates *from, double *work, const StopsetBound *out) {
    const double begin = now();
    const int done = __real_stopset_power_off(stops, from, work, out);
    proof += now() - begin;
    return done;
}

static void say(fmi3InstanceEnvironment env, fmi3Status status, fmi3String category, fmi3String message) {
    (void)env, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

static int by_size(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}
static double at_share(double *x, int n, double share) {
    qsort(x, (size_t)n, sizeof *x, by_size);
    return 1e6 * x[(int)(share * (n - 1))];
}

static int read_rows(const char *path) {
    static char line[64 * COLUMNS];
    int n = 0;
    FILE *f = fopen(path, "r");
    if (!f || !fgets(line, sizeof line, f)) exit(2);
    while (n < MOST_ROWS && fgets(line, sizeof line, f)) {
        char *p = line;
        for (int k = 0; k < COLUMNS; k++) {
            rows[n][k] = strtod(p, &p);
            if (*p == ',') p++;
        }
        n++;
    }
    fclose(f);
    return n;
}

/* A kind of stop: of a ramp that may fail, when power is taken then: when it is left (SS1-r), else after a time [s] (SS1-t). */
typedef struct {
    const char *name;
    fmi3ValueReference time;
    fmi3Boolean monitored;
    fmi3Float64 off_after;
} Kind;

static fmi3Instance begun(const char *token, fmi3Boolean measured, const Kind *kind) {
    const fmi3ValueReference flag = N_REAL + N_INT + IX_MEASURED;
    fmi3Instance c = fmi3InstantiateCoSimulation("a", token, "", fmi3False, fmi3False, fmi3False, fmi3False, 0, 0, 0, say, 0);
    if (!c) exit(1);
#if N_STOPS > 1
    const fmi3ValueReference monitored = N_REAL + N_INT + IX_SS1_MONITORED, off_after = VR_SS1_OFF_AFTER;
    if (kind && (fmi3SetBoolean(c, &monitored, 1, &kind->monitored, 1) || fmi3SetFloat64(c, &off_after, 1, &kind->off_after, 1))) exit(1);
#endif
    if (fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3False, 0.0) || fmi3ExitInitializationMode(c) ||
        fmi3SetBoolean(c, &flag, 1, &measured, 1))
        exit(1);
    return c;
}

/* Inputs of a row: torque, temperature, measured angle and speed, as the columns of the file. */
static void connect(fmi3Instance c, int row) {
    fmi3ValueReference vr[4 * NJ];
    for (unsigned i = 0; i < NJ; i++) {
        vr[i] = VR_TAU + i;
        vr[NJ + i] = VR_TEMP + i;
        vr[2 * NJ + i] = VR_Q_MEASURED + i;
        vr[3 * NJ + i] = VR_DQ_MEASURED + i;
    }
    if (fmi3SetFloat64(c, vr, 4 * NJ, rows[row] + 1, 4 * NJ)) exit(1);
}

static void steps(const char *token, int n, fmi3Boolean measured) {
    double sum = 0.0, last;
    int count = 0;
    fmi3Boolean event, end, early;
    for (int r = 0; r < REPEATED; r++) {
        fmi3Instance c = begun(token, measured, 0);
        for (int k = 0; k + 1 < n; k++, count++) {
            connect(c, k);
            const double begin = now();
            if (fmi3DoStep(c, rows[k][0], rows[k + 1][0] - rows[k][0], fmi3True, &event, &end, &early, &last)) exit(1);
            sum += took[count] = now() - begin;
        }
        fmi3FreeInstance(c);
    }
    printf("in C, %s: step %.1f us CPU (median), %.1f us (mean), %.0f us at 99 %%\n", measured ? "measured state connected" : "free running",
           at_share(took, count, 0.5), 1e6 * sum / count, at_share(took, count, 0.99));
}

/* Of every second row the bound of one kind, with the brakes' proof apart where that is all of it. */
static void bounds(const char *token, int n, const Kind *kind) {
    int count = 0, proved = 0;
    fmi3Instance c = begun(token, fmi3True, kind);
    for (int k = 0; k < n; k += 2, count++) {
        double x;
        connect(c, k);
        proof = 0.0;
        const double begin = now();
        if (fmi3GetFloat64(c, &kind->time, 1, &x, 1)) exit(1);
        took[count] = now() - begin;
        around[count] = took[count] - proof;
        proved += isfinite(x);
    }
    fmi3FreeInstance(c);
    const double median = at_share(took, count, 0.5), most = at_share(took, count, 1.0);
    printf("in C, %s: a bound is read in %.0f us CPU (median), %.0f us at most; %d of %d states proved", kind->name, median, most, proved, count);
    if (proof > 0.0) printf("; beside the core's proof %.1f us", at_share(around, count, 0.5));
    printf("\n");
}

int main(int argc, char **argv) {
    if (argc != 3) return 2;
    const int n = read_rows(argv[1]);
    steps(argv[2], n, fmi3False);
    steps(argv[2], n, fmi3True);
    static const Kind kinds[] = {{"STOP 0", VR_STOP_TIME, fmi3False, -1.0}, {"STOP 1 that works", VR_STOP1_NOMINAL_TIME, fmi3False, -1.0},
                                 {"STOP 1 that may fail, SS1-t of 0.3 s", VR_STOP1_GUARANTEED_TIME, fmi3False, 0.3},
                                 {"STOP 1 that may fail, SS1-r", VR_STOP1_GUARANTEED_TIME, fmi3True, -1.0}, {"STOP 2", VR_STOP2_TIME, fmi3False, -1.0}};
    for (int k = 0; stopset_model.has_brakes && k < (N_STOPS > 1 ? 5 : 1); k++) bounds(argv[2], n, kinds + k);
    return 0;
}
