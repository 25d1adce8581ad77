/* Prints a checksum over results of the core's library on an arm at random: the same line on every platform.
 * Elementary functions, rigid body, checksums, directed rounding and a simulated stop, from numbers that are exact everywhere. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "stopset.h"

enum { N = 6, POSES = 200, STEPS = 800 };
static uint64_t seed = 1;
static uint32_t sum;

/* -1 to 1, in steps of 2^-30. */
static double drawn(void) {
    seed = seed * 6364136223846793005u + 1442695040888963407u;
    return (double)(int64_t)(seed >> 33) / 1073741824.0 - 1.0;
}

static void fill(double *x, int64_t count, double size) {
    for (int64_t k = 0; k < count; k++) x[k] = size * drawn();
}

static void eat(const double *x, int64_t count) {
    static uint8_t bytes[8];
    for (int64_t k = 0; k < count; k++) {
        uint64_t bits;
        memcpy(&bits, x + k, sizeof bits);
        if (x[k] != x[k]) bits = 0x7ff8000000000000u; /* which of the numbers that are none is the processor's choice */
        for (int b = 0; b < 8; b++) bytes[b] = (uint8_t)(bits >> (8 * b));
        sum = sum * 31u + stopset_crc32(8, bytes);
    }
}

int main(void) {
    static double x[POSES * N], y[POSES * N], z[POSES * N], out[POSES * N * 10 * N], q[(STEPS + 1) * N], v[(STEPS + 1) * N];
    double R[N * 9], p[N * 3], axis[N * 3], pi[N * 10], gravity[3] = {0.5, -0.25, -9.75}, push[4 * N];
    for (int which = 0; which < 6; which++) {
        for (double size = 1e-6; size < 2e3; size *= 10.0) {
            fill(x, POSES * N, size);
            if (which == 5)
                for (int k = 0; k < POSES * N; k++) x[k] = x[k] < 0.0 ? -x[k] : x[k];
            stopset_maths(which, POSES * N, x, out);
            eat(out, POSES * N);
        }
    }
    memset(R, 0, sizeof R);
    memset(pi, 0, sizeof pi);
    for (int i = 0; i < N; i++) {
        const double c = 0.6, s = i % 2 ? 0.8 : -0.8;
        R[9 * i] = 1.0, R[9 * i + 4] = R[9 * i + 8] = c, R[9 * i + 5] = -s, R[9 * i + 7] = s;
        axis[3 * i] = 0.0, axis[3 * i + 1] = i % 3 == 0 ? 0.0 : 0.6, axis[3 * i + 2] = i % 3 == 0 ? 1.0 : 0.8;
        pi[10 * i] = 4.0 - 0.5 * i, pi[10 * i + 3] = 0.25;
        pi[10 * i + 4] = pi[10 * i + 6] = pi[10 * i + 9] = 0.125;
    }
    fill(p, N * 3, 0.25);
    const StopsetArm arm = {N, R, p, axis, gravity, pi};
    fill(x, POSES * N, 3.0), fill(y, POSES * N, 2.0), fill(z, POSES * N, 9.0);
    int refused = stopset_torques(&arm, POSES, x, y, z, out);
    eat(out, POSES * N);
    refused |= stopset_mass_matrices(&arm, POSES, x, out);
    eat(out, POSES * N * N);
    refused |= stopset_regressors(&arm, POSES, x, y, z, out);
    eat(out, POSES * N * 10 * N);
    static int8_t side[POSES * N];
    static uint32_t bits[POSES * N];
    for (int k = 0; k < POSES * N; k++) side[k] = (int8_t)(k % 3 - 1);
    stopset_outward(POSES * N, x, side, bits);
    for (int k = 0; k < POSES * N; k++) out[k] = (double)bits[k];
    eat(out, POSES * N);
    const double rotor[N] = {2, 2, 1, 1, 0.5, 0.25}, dry[N] = {15, 15, 10, 8, 3, 2}, viscous[N] = {5, 5, 3, 3, 1, 1};
    const double brake[N] = {222, 222, 106, 106, 25, 12}, delay[N] = {0.0625, 0.0625, 0.03125, 0.0625, 0.0625, 0.0625};
    const double rise[N] = {0.015625, 0.015625, 0.03125, 0.015625, 0.015625, 0.0078125};
    const StopsetSimStops stop = {1, arm, rotor, dry, viscous, brake, delay, rise};
    fill(push, 4 * N, 1.0);
    const StopsetSimTime horizon = {1.0 / 1024.0, STEPS, 4, push};
    refused |= stopset_sim_stops(&stop, x, y, &horizon, q, v);
    eat(q, (STEPS + 1) * N), eat(v, (STEPS + 1) * N);
    printf("%s %08x\n", refused ? "refused" : stopset_sources(), (unsigned)sum);
    return refused;
}
