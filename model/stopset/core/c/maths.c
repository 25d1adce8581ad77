/* Elementary functions, so that no platform's library decides a bit of a result.
 *
 * Each is an exact reduction to a small interval and there the function's own Taylor series, as long as it takes for what
 * is cut off to lie below 0.02 ulp. IEEE 754 double precision, round to nearest, no contraction: the compiler's flags and
 * the assertion below see to it. Errors are measured against 200-bit arithmetic in tests/test_core_maths.py.
 *
 * Source: Cody & Waite (1980); Dekker (1971) for the exact sums.
 */
#include "maths.h"

#include <float.h>
#include <string.h>

#include "stopset.h"
#include "wide.h"

_Static_assert(FLT_EVAL_METHOD == 0, "double expressions must be evaluated as doubles; compile for SSE2 or a 64-bit ARM");
_Static_assert(sizeof(double) == 8 && DBL_MANT_DIG == 53, "IEEE 754 double precision is needed");

static const double NOT_A_NUMBER_BITS = 0.0; /* 0/0 below */
static double not_a_number(void) { return NOT_A_NUMBER_BITS / NOT_A_NUMBER_BITS; }

static double absolute(double x) { return x < 0.0 ? -x : x; }

/* Nearest whole number of |x| < 2^51: adding and taking away 1.5 * 2^52 rounds there. */
static double nearest(double x) { return (x + 6755399441055744.0) - 6755399441055744.0; }

/* 2^k for -1022 <= k <= 1023. */
static double power_of_two(int64_t k) {
    uint64_t bits = (uint64_t)(k + 1023) << 52;
    double out;
    memcpy(&out, &bits, sizeof out);
    return out;
}

/* a + b = sum + rest exactly. */
static double two_sum(double a, double b, double *rest) {
    const double sum = a + b, other = sum - a;
    *rest = (a - (sum - other)) + (b - other);
    return sum;
}

/* x = k pi/2 + hi + lo, |hi| <= pi/4 (1 + 1e-9); returns k modulo 4. pi/2 in parts of 33 bits: k times one is exact. */
static int quarter_turns(double x, double *hi, double *lo) {
    const double k = nearest(x * 0x1.45f306dc9c883p-1);
    double a, b, c, w;
    const double r = x - k * 0x1.921fb544p+0;
    const double s = two_sum(r, -(k * 0x1.0b4611a6p-34), &a);
    if (absolute(s) > 0x1p-10) {
        w = a - k * 0x1.3198a2e037073p-69;
        *hi = s + w;
        *lo = (s - *hi) + w;
    } else { /* so near to a multiple that more digits of pi count */
        const double t = two_sum(s, -(k * 0x1.3198a2ep-69), &b);
        *hi = two_sum(t, (a + b) - k * 0x1.b839a252049c1p-104, &c);
        *lo = c;
    }
    return (int)((int64_t)k & 3);
}

/* On |r| <= pi/4, r = hi + lo, z = hi^2: r - r^3/3! + ..., the last term 0.3 % of an ulp; one number, or four. */
#define SINE_SERIES(z)                                                                                                                    \
    (-1.0 / 6 +                                                                                                                           \
     z * (1.0 / 120 +                                                                                                                     \
          z * (-1.0 / 5040 +                                                                                                              \
               z * (1.0 / 362880 +                                                                                                        \
                    z * (-1.0 / 39916800 + z * (1.0 / 6227020800.0 + z * (-1.0 / 1307674368000.0 + z / 355687428096000.0)))))))
#define COSINE_SERIES(z)                                                                                                                  \
    (1.0 / 24 + z * (-1.0 / 720 +                                                                                                         \
                     z * (1.0 / 40320 +                                                                                                   \
                          z * (-1.0 / 3628800 +                                                                                           \
                               z * (1.0 / 479001600.0 +                                                                                   \
                                    z * (-1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0 - z / 6402373705728000.0)))))))

static double sine_there(double hi, double lo) {
    const double z = hi * hi;
    return hi + (hi * z * SINE_SERIES(z) + lo * (1.0 - 0.5 * z));
}

static double cosine_there(double hi, double lo) {
    const double z = hi * hi, half = 0.5 * z, one = 1.0 - half;
    return one + (((1.0 - one) - half) + (z * z * COSINE_SERIES(z) - hi * lo));
}

void stopset_sincos(double x, double *s, double *c) {
    double hi, lo;
    if (!(absolute(x) <= 1e6)) {
        *s = *c = not_a_number();
        return;
    }
    const int k = quarter_turns(x, &hi, &lo);
    const double a = sine_there(hi, lo), b = cosine_there(hi, lo);
    const double sine = k & 1 ? b : a, cosine = k & 1 ? a : b;
    *s = k & 2 ? -sine : sine;
    *c = (k + 1) & 2 ? -cosine : cosine;
}

/* As one by one; where a number asks for more digits of pi, or is none, they are. */
STOPSET_WIDE void stopset_sincos_of_four(const double *x, double *s, double *c) {
    const Four X = *(const Four *)x, turned = X * 0x1.45f306dc9c883p-1 + 6755399441055744.0, k = turned - 6755399441055744.0;
    const Four r = X - k * 0x1.921fb544p+0, b = -(k * 0x1.0b4611a6p-34), sum = r + b, other = sum - r;
    const Four w = (r - (sum - other)) + (b - other) - k * 0x1.3198a2e037073p-69, hi = sum + w, lo = (sum - hi) + w;
    const Choice plain = (SIZES_OF(X) <= FOUR_OF(1e6)) & (SIZES_OF(sum) > FOUR_OF(0x1p-10)), quarter = (Choice)turned;
    if (!(plain[0] & plain[1] & plain[2] & plain[3])) {
        for (int i = 0; i < 4; i++) stopset_sincos(x[i], s + i, c + i);
        return;
    }
    const Four z = hi * hi, half = 0.5 * z, one = 1.0 - half;
    const Four sine = hi + (hi * z * SINE_SERIES(z) + lo * (1.0 - half)), cosine = one + (((1.0 - one) - half) + (z * z * COSINE_SERIES(z) - hi * lo));
    const Choice odd = (quarter & 1) != 0, minus = ((quarter & 2) != 0) & INT64_MIN, other_minus = (((quarter + 1) & 2) != 0) & INT64_MIN;
    *(Four *)s = (Four)((Choice)CHOSEN(odd, cosine, sine) ^ minus);
    *(Four *)c = (Four)((Choice)CHOSEN(odd, sine, cosine) ^ other_minus);
}

double stopset_sin(double x) {
    double s, c;
    if (absolute(x) < 0x1p-27) return x; /* keeps the sign of zero */
    stopset_sincos(x, &s, &c);
    return s;
}

double stopset_cos(double x) {
    double s, c;
    stopset_sincos(x, &s, &c);
    return c;
}

/* x = k ln 2 + hi + lo, |hi| <= 0.347; the first part of ln 2 has 32 bits, so that k times it is exact. */
static int64_t halvings(double x, double *hi, double *lo) {
    const double k = nearest(x * 0x1.71547652b82fep+0);
    const double a = x - k * 0x1.62e42feep-1, b = k * 0x1.a39ef35793c76p-33;
    *hi = a - b;
    *lo = (a - *hi) - b;
    return (int64_t)k;
}

/* e^(hi + lo) - 1 - hi - lo on |hi| <= 0.347, the last term 0.5 % of an ulp of e^hi. */
static double beyond_linear(double r) {
    const double p =
        1.0 / 2 +
        r * (1.0 / 6 +
             r * (1.0 / 24 +
                  r * (1.0 / 120 +
                       r * (1.0 / 720 +
                            r * (1.0 / 5040 +
                                 r * (1.0 / 40320 +
                                      r * (1.0 / 362880 +
                                           r * (1.0 / 3628800 + r * (1.0 / 39916800 + r * (1.0 / 479001600.0 + r / 6227020800.0))))))))));
    return r * r * p;
}

double stopset_exp(double x) {
    double hi, lo;
    if (x != x) return x;
    if (x > 709.782712893384) return 1.0 / NOT_A_NUMBER_BITS; /* +Inf */
    if (x < -745.1332191019412) return 0.0;
    const int64_t k = halvings(x, &hi, &lo), half = k / 2;
    const double y = 1.0 + (hi + (beyond_linear(hi) + lo * (1.0 + hi)));
    return y * power_of_two(half) * power_of_two(k - half);
}

double stopset_expm1(double x) {
    double hi, lo, rest;
    if (x != x || absolute(x) < 0x1p-54) return x;
    if (x > 709.782712893384) return 1.0 / NOT_A_NUMBER_BITS;
    if (x < -40.0) return -1.0;
    const int64_t k = halvings(x, &hi, &lo);
    const double small = beyond_linear(hi) + lo * (1.0 + hi);
    if (k == 0) return hi + small;
    if (k > 60) return (1.0 + (hi + small)) * power_of_two(k - 1) * 2.0; /* the 1 is below half an ulp */
    const double y = two_sum(1.0 - power_of_two(-k), hi, &rest);
    return (y + (rest + small)) * power_of_two(k);
}

double stopset_tanh(double x) {
    const double a = absolute(x);
    double y;
    if (x != x || a < 0x1p-28) return x;
    if (a > 22.0)
        y = 1.0;
    else if (a >= 1.0)
        y = 1.0 - 2.0 / (stopset_expm1(2.0 * a) + 2.0);
    else {
        const double t = stopset_expm1(-2.0 * a);
        y = -t / (t + 2.0);
    }
    return x < 0.0 ? -y : y;
}

/* x = 2^k (1 + f), f in [-0.293, 0.415]; log(1 + f) = f - f^2/2 + s (f^2/2 + R), s = f/(2 + f), R = 2/3 s^2 + 2/5 s^4 + ... */
double stopset_log(double x) {
    uint64_t bits;
    int64_t k = 0;
    if (x != x || x < 0.0) return not_a_number();
    if (x == 0.0) return -1.0 / NOT_A_NUMBER_BITS;
    if (x > DBL_MAX) return x;
    if (x < DBL_MIN) {
        x *= 0x1p54;
        k = -54;
    }
    memcpy(&bits, &x, sizeof bits);
    k += (int64_t)(bits >> 52) - 1023;
    bits = (bits & 0xfffffffffffffu) | (uint64_t)1023 << 52;
    memcpy(&x, &bits, sizeof x);
    if (x > 0x1.6a09e667f3bcdp+0) {
        x *= 0.5;
        k += 1;
    }
    const double f = x - 1.0, s = f / (2.0 + f), z = s * s, half = 0.5 * f * f;
    const double R =
        z * (2.0 / 3 +
             z * (2.0 / 5 +
                  z * (2.0 / 7 +
                       z * (2.0 / 9 + z * (2.0 / 11 + z * (2.0 / 13 + z * (2.0 / 15 + z * (2.0 / 17 + z * (2.0 / 19 + z * (2.0 / 21))))))))));
    const double m = (double)k;
    return m * 0x1.62e42feep-1 - ((half - (s * (half + R) + m * 0x1.a39ef35793c76p-33)) - f);
}

int stopset_maths(int which, int64_t N, const double *x, double *out) {
    static double (*const functions[])(double) = {stopset_sin,   stopset_cos,  stopset_exp,
                                                  stopset_expm1, stopset_tanh, stopset_log};
    for (int64_t k = 0; k < N; k++) out[k] = functions[which](x[k]);
    return STOPSET_OK;
}
