/* Polynomials of the model file on one table of monomials, and the products and sums that Taylor forms are composed of.
 *
 * Source: Berz (1999) for the forms, with a monomial as one key.
 */
#include <string.h>

#include "stopset.h"

static void monomials(const StopsetPolynomials *s, const double *z, double *monomial) {
    monomial[0] = 1.0;
    for (int64_t k = 1; k < s->monomials; k++) monomial[k] = monomial[s->parent[k]] * z[s->variable[k]];
}

void stopset_polynomials(const StopsetPolynomials *s, int64_t N, const double *z, double *work, double *out) {
    for (int64_t r = 0; r < N; r++, z += s->dimension, out += s->count) {
        monomials(s, z, work);
        memset(out, 0, (size_t)s->count * sizeof *out);
        for (int64_t k = 0; k < s->monomials; k++)
            for (int64_t i = 0; i < s->count; i++) out[i] += work[k] * s->coefficient[k * s->count + i];
    }
}

/* By going back through the table. */
void stopset_polynomial_slopes(const StopsetPolynomials *s, int64_t N, const double *z, double *work, double *out) {
    const int64_t n = s->count, d = s->dimension;
    double *weight = work + s->monomials;
    memset(out, 0, (size_t)(N * n * d) * sizeof *out);
    for (int64_t r = 0; r < N; r++, z += d, out += n * d) {
        monomials(s, z, work);
        memcpy(weight, s->coefficient, (size_t)(s->monomials * n) * sizeof *weight);
        for (int64_t k = s->monomials - 1; k > 0; k--) {
            const int64_t p = s->parent[k], v = s->variable[k];
            for (int64_t i = 0; i < n; i++) {
                out[i * d + v] += weight[k * n + i] * work[p];
                weight[p * n + i] += weight[k * n + i] * z[v];
            }
        }
    }
}

/* Terms are keys (degree from bit `shift` up, exponents below) and coefficients. A hash table with linear probing. */
int64_t stopset_taylor_multiply(const StopsetTaylor *one, const StopsetTaylor *other, int order, int shift, const StopsetProduct *out) {
    const int64_t A = one->count, B = other->count, *ka = one->key, *kb = other->key, mask = out->size - 1;
    const double *a = one->value, *b = other->value;
    int64_t *slot = out->slot, *key = out->key;
    double *value = out->value;
    int64_t used = 0, end[64] = {0}; /* end[k]: terms of b of degree <= k */
    if (order < 0 || order > 63) return -1;
    for (int64_t k = 0; k < out->size; k++) slot[k] = -1;
    for (int64_t j = 0; j < B; j++)
        if (kb[j] >> shift <= order) end[kb[j] >> shift] = j + 1;
    for (int k = 1; k <= order; k++)
        if (end[k] < end[k - 1]) end[k] = end[k - 1];
    for (int64_t i = 0; i < A; i++) {
        const int64_t left = order - (ka[i] >> shift);
        for (int64_t j = 0; left >= 0 && j < end[left]; j++) {
            const int64_t k = ka[i] + kb[j];
            int64_t h = (int64_t)(((uint64_t)k * 0x9E3779B97F4A7C1u) >> 20) & mask; /* spread by an odd multiplier */
            while (slot[h] >= 0 && key[slot[h]] != k) h = (h + 1) & mask;
            if (slot[h] >= 0)
                value[slot[h]] += a[i] * b[j];
            else {
                if (used == out->room) return -1;
                slot[h] = used;
                key[used] = k;
                value[used++] = a[i] * b[j];
            }
        }
    }
    return used;
}

int64_t stopset_taylor_add(const StopsetTaylor *one, const StopsetTaylor *other, double factor, int64_t *key, double *value) {
    const int64_t A = one->count, B = other->count, *ka = one->key, *kb = other->key;
    const double *a = one->value, *b = other->value;
    int64_t i = 0, j = 0, m = 0;
    while (i < A || j < B) {
        const int first = j == B || (i < A && ka[i] <= kb[j]), second = i == A || (j < B && kb[j] <= ka[i]);
        const int64_t k = first ? ka[i] : kb[j];
        const double v = first && second ? a[i] + factor * b[j] : first ? a[i] : factor * b[j];
        i += first;
        j += second;
        if (v != 0.0) {
            key[m] = k;
            value[m++] = v;
        }
    }
    return m;
}
