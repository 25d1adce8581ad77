/* Authentication codes: HMAC-SHA256 under a key that was taken in once.
 *
 * Where the processor has instructions for it they are used: the key says so, which is asked of the processor once a key and not
 * once a message. The bits are the same either way.
 *
 * Source: FIPS 180-4, section 6.2; RFC 2104, section 2.
 */
#include <string.h>

#include "stopset.h"

enum { BLOCK = 64, WORDS = 8, DIGEST = 32, ROUNDS = 64 };

static const uint32_t K[ROUNDS] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
};
static const uint32_t BEGIN[WORDS] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};

static uint32_t turned(uint32_t x, int by) { return x >> by | x << (32 - by); }

static uint32_t word(const uint8_t *data) {
    return (uint32_t)data[0] << 24 | (uint32_t)data[1] << 16 | (uint32_t)data[2] << 8 | (uint32_t)data[3];
}

static void words_into(uint8_t *out, const uint32_t *h) {
    for (int k = 0; k < DIGEST; k++) out[k] = (uint8_t)(h[k / 4] >> (24 - 8 * (k % 4)));
}

static uint32_t mixed(uint32_t e, uint32_t f, uint32_t g, uint32_t h) {
    return h + (turned(e, 6) ^ turned(e, 11) ^ turned(e, 25)) + (((f ^ g) & e) ^ g);
}

static uint32_t voted(uint32_t a, uint32_t b, uint32_t c) {
    return (turned(a, 2) ^ turned(a, 13) ^ turned(a, 22)) + ((a & b) | (c & (a | b)));
}

/* One round; names move on by one from this to the next, so that no word has to. */
#define ROUND(a, b, c, d, e, f, g, h, t)                \
    {                                                   \
        const uint32_t now = mixed(e, f, g, h) + K[t] + w[t]; \
        (d) += now;                                     \
        (h) = now + voted(a, b, c);                     \
    }

static void take_plainly(uint32_t *state, int64_t blocks, const uint8_t *data) {
    uint32_t w[ROUNDS];
    for (; blocks > 0; blocks--, data += BLOCK) {
        uint32_t a = state[0], b = state[1], c = state[2], d = state[3], e = state[4], f = state[5], g = state[6], h = state[7];
        for (int t = 0; t < 16; t++) w[t] = word(data + 4 * t);
        for (int t = 16; t < ROUNDS; t++) {
            const uint32_t far = w[t - 15], near = w[t - 2];
            w[t] = (turned(near, 17) ^ turned(near, 19) ^ near >> 10) + w[t - 7] + (turned(far, 7) ^ turned(far, 18) ^ far >> 3) + w[t - 16];
        }
        for (int t = 0; t < ROUNDS; t += WORDS) {
            ROUND(a, b, c, d, e, f, g, h, t)
            ROUND(h, a, b, c, d, e, f, g, t + 1)
            ROUND(g, h, a, b, c, d, e, f, t + 2)
            ROUND(f, g, h, a, b, c, d, e, t + 3)
            ROUND(e, f, g, h, a, b, c, d, t + 4)
            ROUND(d, e, f, g, h, a, b, c, t + 5)
            ROUND(c, d, e, f, g, h, a, b, t + 6)
            ROUND(b, c, d, e, f, g, h, a, t + 7)
        }
        const uint32_t all[WORDS] = {a, b, c, d, e, f, g, h};
        for (int i = 0; i < WORDS; i++) state[i] += all[i];
    }
}

#if defined(__x86_64__) && defined(__GNUC__) && !defined(STOPSET_NARROW)
#include <cpuid.h>
#include <immintrin.h>

enum { HAS_SHA = 1 << 29 }; /* in EBX of leaf 7 */

static int swift(void) {
    unsigned a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_SSE4_1) || !(c & bit_SSSE3)) return 0;
    return __get_cpuid_count(7, 0, &a, &b, &c, &d) && b & HAS_SHA;
}

/* The state in the halves that the instructions want: a, b, e, f and c, d, g, h, the last the lowest. */
__attribute__((target("sha,sse4.1"))) static void take_swiftly(uint32_t *h, int64_t blocks, const uint8_t *data) {
    const __m128i reversed = _mm_set_epi64x(0x0c0d0e0f08090a0b, 0x0405060700010203);
    __m128i abef = _mm_set_epi32((int)h[0], (int)h[1], (int)h[4], (int)h[5]);
    __m128i cdgh = _mm_set_epi32((int)h[2], (int)h[3], (int)h[6], (int)h[7]), w[4];
    uint32_t x[4], y[4];
    for (; blocks > 0; blocks--, data += BLOCK) {
        const __m128i before = abef, behind = cdgh;
        for (int g = 0; g < ROUNDS / 4; g++) { /* four rounds */
            if (g < 4) {
                w[g] = _mm_shuffle_epi8(_mm_loadu_si128((const __m128i *)(data + 16 * g)), reversed);
            } else {
                const __m128i last = w[(g + 3) % 4], seventh = _mm_alignr_epi8(last, w[(g + 2) % 4], 4);
                w[g % 4] = _mm_sha256msg2_epu32(_mm_add_epi32(_mm_sha256msg1_epu32(w[g % 4], w[(g + 1) % 4]), seventh), last);
            }
            const __m128i added = _mm_add_epi32(w[g % 4], _mm_loadu_si128((const __m128i *)(K + 4 * g)));
            cdgh = _mm_sha256rnds2_epu32(cdgh, abef, added);
            abef = _mm_sha256rnds2_epu32(abef, cdgh, _mm_shuffle_epi32(added, 0x0e));
        }
        abef = _mm_add_epi32(abef, before);
        cdgh = _mm_add_epi32(cdgh, behind);
    }
    _mm_storeu_si128((__m128i *)x, abef);
    _mm_storeu_si128((__m128i *)y, cdgh);
    for (int i = 0; i < 2; i++) {
        h[i] = x[3 - i];
        h[4 + i] = x[1 - i];
        h[2 + i] = y[3 - i];
        h[6 + i] = y[1 - i];
    }
}
#else
static int swift(void) { return 0; }

static void take_swiftly(uint32_t *h, int64_t blocks, const uint8_t *data) { take_plainly(h, blocks, data); }
#endif

static void take(const StopsetKey *key, uint32_t *h, int64_t blocks, const uint8_t *data) {
    if (key->swift) take_swiftly(h, blocks, data);
    else take_plainly(h, blocks, data);
}

/* What is left of `length` bytes behind one block of the key and all whole ones, its end and its length. */
static void end(const StopsetKey *key, uint32_t *h, int64_t length, const uint8_t *data) {
    uint8_t last[2 * BLOCK] = {0};
    const int64_t left = length % BLOCK, blocks = left + 9 > BLOCK ? 2 : 1;
    const uint64_t bits = 8 * (uint64_t)(BLOCK + length);
    if (left) memcpy(last, data + length - left, (size_t)left);
    last[left] = 0x80;
    for (int k = 0; k < 8; k++) last[BLOCK * blocks - 1 - k] = (uint8_t)(bits >> 8 * k);
    take(key, h, blocks, last);
}

void stopset_key(int64_t length, const uint8_t *secret, StopsetKey *key) {
    uint8_t inner[BLOCK], outer[BLOCK];
    for (int k = 0; k < BLOCK; k++) {
        const uint8_t x = k < length ? secret[k] : 0;
        inner[k] = x ^ 0x36;
        outer[k] = x ^ 0x5c;
    }
    key->swift = swift();
    memcpy(key->inner, BEGIN, sizeof BEGIN);
    memcpy(key->outer, BEGIN, sizeof BEGIN);
    take(key, key->inner, 1, inner);
    take(key, key->outer, 1, outer);
}

void stopset_code(const StopsetKey *key, int64_t length, const uint8_t *data, uint8_t *code) {
    uint32_t h[WORDS];
    uint8_t digest[DIGEST];
    memcpy(h, key->inner, sizeof h);
    take(key, h, length / BLOCK, data);
    end(key, h, length, data);
    words_into(digest, h);
    memcpy(h, key->outer, sizeof h);
    end(key, h, DIGEST, digest);
    words_into(digest, h);
    memcpy(code, digest, STOPSET_CODE);
}
