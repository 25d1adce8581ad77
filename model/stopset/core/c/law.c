/* Effects' laws, played step by step: one law for arrays, monitor and FMU, without a compiler where it is registered.
 *
 * Source: the steps are those of stopset.ring.tape, in the order of the law's own operators, one rounding each.
 */
#include "law.h"

#include <math.h>

#include "maths.h"

/* x^n, n >= 1, one product after the other. */
static double power(double x, int n) {
    double out = x;
    for (int k = 1; k < n; k++) out *= x;
    return out;
}

#define EACH(expression) \
    for (int k = 0; k < rows; k++) z[k] = (expression); \
    break

/* One sample alone: the same steps, without loops. */
static double play_one(const StopsetProgram *law, const double (*signals)[ROWS]) {
    double r[STEPS];
    const int length = law->length < STEPS ? law->length : STEPS;
    for (int i = 0; i < length; i++) {
        const int32_t *step = law->steps + 3 * i;
        if (step[0] <= LAW_SIGNAL) {
            r[i] = step[0] == LAW_CONSTANT ? law->numbers[step[1]] : signals[step[1]][0];
            continue;
        }
        const double x = r[step[1]], y = step[0] == LAW_POWER ? 0.0 : r[step[2]];
        switch (step[0]) {
        case LAW_ADD: r[i] = x + y; break;
        case LAW_SUB: r[i] = x - y; break;
        case LAW_MUL: r[i] = x * y; break;
        case LAW_DIV: r[i] = x / y; break;
        case LAW_NEG: r[i] = -x; break;
        case LAW_ABSOLUTE: r[i] = x < 0.0 ? -x : x; break;
        case LAW_SIGN: r[i] = x != x ? x : (double)((x > 0.0) - (x < 0.0)); break;
        case LAW_SQUARE: r[i] = x * x; break;
        case LAW_SQRT: r[i] = sqrt(x); break;
        case LAW_SIN: r[i] = stopset_sin(x); break;
        case LAW_COS: r[i] = stopset_cos(x); break;
        case LAW_EXP: r[i] = stopset_exp(x); break;
        case LAW_TANH: r[i] = stopset_tanh(x); break;
        case LAW_POWER: r[i] = power(x, step[2]); break;
        case LAW_MINIMUM: r[i] = x != x || x < y ? x : y; break;
        default: r[i] = x != x || x > y ? x : y; break;
        }
    }
    return length > 0 ? r[length - 1] : 0.0;
}

void stopset_play(const StopsetProgram *law, const double (*signals)[ROWS], int rows, double *out) {
    if (rows == 1) {
        out[0] = play_one(law, signals);
        return;
    }
    double r[STEPS][ROWS];
    const int length = law->length < STEPS ? law->length : STEPS;
    for (int i = 0; i < length; i++) {
        const int32_t *step = law->steps + 3 * i;
        double *z = r[i];
        if (step[0] == LAW_CONSTANT) {
            for (int k = 0; k < rows; k++) z[k] = law->numbers[step[1]];
            continue;
        }
        if (step[0] == LAW_SIGNAL) {
            for (int k = 0; k < rows; k++) z[k] = signals[step[1]][k];
            continue;
        }
        const double *x = r[step[1]], *y = step[0] == LAW_POWER ? x : r[step[2]];
        switch (step[0]) {
        case LAW_ADD: EACH(x[k] + y[k]);
        case LAW_SUB: EACH(x[k] - y[k]);
        case LAW_MUL: EACH(x[k] * y[k]);
        case LAW_DIV: EACH(x[k] / y[k]);
        case LAW_NEG: EACH(-x[k]);
        case LAW_ABSOLUTE: EACH(x[k] < 0.0 ? -x[k] : x[k]);
        case LAW_SIGN: EACH(x[k] != x[k] ? x[k] : (double)((x[k] > 0.0) - (x[k] < 0.0)));
        case LAW_SQUARE: EACH(x[k] * x[k]);
        case LAW_SQRT: EACH(sqrt(x[k]));
        case LAW_SIN: EACH(stopset_sin(x[k]));
        case LAW_COS: EACH(stopset_cos(x[k]));
        case LAW_EXP: EACH(stopset_exp(x[k]));
        case LAW_TANH: EACH(stopset_tanh(x[k]));
        case LAW_POWER: EACH(power(x[k], step[2]));
        /* what is not a number stays so, on either side */
        case LAW_MINIMUM: EACH(x[k] != x[k] || x[k] < y[k] ? x[k] : y[k]);
        default: EACH(x[k] != x[k] || x[k] > y[k] ? x[k] : y[k]);
        }
    }
    for (int k = 0; k < rows; k++) out[k] = length > 0 ? r[length - 1][k] : 0.0;
}

int stopset_law(const StopsetProgram *law, int64_t N, const double *signals, double *out) {
    double block[STOPSET_SIGNALS][ROWS];
    for (int64_t k = 0; k < N; k += ROWS) {
        const int rows = N - k < ROWS ? (int)(N - k) : ROWS;
        for (int s = 0; s < STOPSET_SIGNALS; s++)
            for (int i = 0; i < rows; i++) block[s][i] = signals[s * N + k + i];
        stopset_play(law, (const double(*)[ROWS])block, rows, out + k);
    }
    return STOPSET_OK;
}
