/* Three numbers and nine: what every file here writes down many times. Sums run left to right. */
#ifndef STOPSET_VECTORS_H
#define STOPSET_VECTORS_H

static inline void cross(const double *a, const double *b, double *out) {
    const double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

static inline double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* R v */
static inline void times(const double *R, const double *v, double *out) {
    const double x = dot(R, v), y = dot(R + 3, v), z = dot(R + 6, v);
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

/* R' v */
static inline void transposed_times(const double *R, const double *v, double *out) {
    const double x = R[0] * v[0] + R[3] * v[1] + R[6] * v[2], y = R[1] * v[0] + R[4] * v[1] + R[7] * v[2],
                 z = R[2] * v[0] + R[5] * v[1] + R[8] * v[2];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

/* A B, out apart from both */
static inline void product(const double *A, const double *B, double *out) {
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) out[3 * r + c] = A[3 * r] * B[c] + A[3 * r + 1] * B[3 + c] + A[3 * r + 2] * B[6 + c];
}

/* Rotational inertia of a link's ten parameters, times a vector. */
static inline void inertia_times(const double *P, const double *v, double *out) {
    const double x = P[4] * v[0] + P[5] * v[1] + P[7] * v[2], y = P[5] * v[0] + P[6] * v[1] + P[8] * v[2],
                 z = P[7] * v[0] + P[8] * v[1] + P[9] * v[2];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

#endif
