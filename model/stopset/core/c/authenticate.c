/* Who made a message: HMAC-SHA256, its first 128 bits. A key is taken in once, for all messages.
 *
 * Source: RFC 2104, section 2; FIPS 180-4, section 6.2.
 */
#include <string.h>

#include "stopset.h"

enum { BLOCK = 64, ROUNDS = 64, WORDS = 8, LENGTH_AT = 56 };

static const uint32_t BEGIN[WORDS] = {0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au, 0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u};
static const uint32_t K[ROUNDS] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5, 0xd807aa98, 0x12835b01, 0x243185be,
    0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa,
    0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967, 0x27b70a85,
    0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85, 0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3,
    0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f,
    0x682e6ff3, 0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
};

static uint32_t turned(uint32_t x, int by) { return x >> by | x << (32 - by); }

/* One round; the eight words have moved on by one place in the next, which their names do here. */
#define ROUND(a, b, c, d, e, f, g, h, i) \
    do { \
        const uint32_t one = h + (turned(e, 6) ^ turned(e, 11) ^ turned(e, 25)) + (g ^ (e & (f ^ g))) + K[i] + w[i]; \
        d += one; \
        h = one + (turned(a, 2) ^ turned(a, 13) ^ turned(a, 22)) + ((a & b) | (c & (a | b))); \
    } while (0)

static void take_block(uint32_t *state, const uint8_t *data) {
    uint32_t w[ROUNDS], s[WORDS];
    for (int i = 0; i < 16; i++, data += 4) w[i] = (uint32_t)data[0] << 24 | (uint32_t)data[1] << 16 | (uint32_t)data[2] << 8 | data[3];
    for (int i = 16; i < ROUNDS; i++) {
        const uint32_t x = w[i - 15], y = w[i - 2];
        w[i] = w[i - 16] + (turned(x, 7) ^ turned(x, 18) ^ x >> 3) + w[i - 7] + (turned(y, 17) ^ turned(y, 19) ^ y >> 10);
    }
    memcpy(s, state, sizeof s);
    for (int i = 0; i < ROUNDS; i += WORDS) {
        ROUND(s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], i);
        ROUND(s[7], s[0], s[1], s[2], s[3], s[4], s[5], s[6], i + 1);
        ROUND(s[6], s[7], s[0], s[1], s[2], s[3], s[4], s[5], i + 2);
        ROUND(s[5], s[6], s[7], s[0], s[1], s[2], s[3], s[4], i + 3);
        ROUND(s[4], s[5], s[6], s[7], s[0], s[1], s[2], s[3], i + 4);
        ROUND(s[3], s[4], s[5], s[6], s[7], s[0], s[1], s[2], i + 5);
        ROUND(s[2], s[3], s[4], s[5], s[6], s[7], s[0], s[1], i + 6);
        ROUND(s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[0], i + 7);
    }
    for (int i = 0; i < WORDS; i++) state[i] += s[i];
}

/* What is left of the data, and the end: SHA-256 of a block taken before and of `length` bytes. */
static void digest(const uint32_t *begun, int64_t length, const uint8_t *data, uint32_t *state) {
    uint8_t last[2 * BLOCK] = {0};
    const uint64_t bits = 8 * ((uint64_t)length + BLOCK);
    memcpy(state, begun, WORDS * sizeof *state);
    for (; length >= BLOCK; length -= BLOCK, data += BLOCK) take_block(state, data);
    for (int64_t i = 0; i < length; i++) last[i] = data[i];
    last[length] = 0x80;
    const int end = length < LENGTH_AT ? BLOCK : 2 * BLOCK;
    for (int i = 0; i < 8; i++) last[end - 1 - i] = (uint8_t)(bits >> 8 * i);
    for (int at = 0; at < end; at += BLOCK) take_block(state, last + at);
}

static void put(const uint32_t *words, int count, uint8_t *out) {
    for (int i = 0; i < 4 * count; i++) out[i] = (uint8_t)(words[i / 4] >> (24 - i % 4 * 8));
}

void stopset_key(const uint8_t *secret, StopsetKey *key) {
    uint8_t inner[BLOCK], outer[BLOCK];
    for (int i = 0; i < BLOCK; i++) {
        inner[i] = secret[i] ^ 0x36;
        outer[i] = secret[i] ^ 0x5c;
    }
    memcpy(key->inner, BEGIN, sizeof BEGIN);
    memcpy(key->outer, BEGIN, sizeof BEGIN);
    take_block(key->inner, inner);
    take_block(key->outer, outer);
}

void stopset_code(const StopsetKey *key, int64_t length, const uint8_t *data, uint8_t *code) {
    uint32_t state[WORDS];
    uint8_t inside[4 * WORDS];
    digest(key->inner, length, data, state);
    put(state, WORDS, inside);
    digest(key->outer, sizeof inside, inside, state);
    put(state, STOPSET_CODE / 4, code);
}
