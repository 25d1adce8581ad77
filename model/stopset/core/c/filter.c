/* Linear filters in second-order sections, columns side by side.
 * Source: Oppenheim & Schafer, Discrete-Time Signal Processing (transposed direct form II). */
#include "stopset.h"

void stopset_filter(int64_t N, int64_t columns, int sections, const double *sos, double *state, double *x)
{
    for (int64_t row = 0; row < N; row++) {
        double *at = x + row * columns;
        for (int s = 0; s < sections; s++) {
            const double *b = sos + 6 * s, *a = b + 3;
            double *first = state + 2 * s * columns, *second = first + columns;
            for (int64_t c = 0; c < columns; c++) {
                const double in = at[c], out = b[0] * in + first[c];
                first[c] = b[1] * in - a[1] * out + second[c];
                second[c] = b[2] * in - a[2] * out;
                at[c] = out;
            }
        }
    }
}
