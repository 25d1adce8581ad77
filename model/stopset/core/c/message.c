/* What a message needs: numbers rounded to their safe side, both checksums.
 *
 * Source: CRC-32/ISO-HDLC and CRC-32C (Castagnoli), both reflected, start and end inverted.
 */
#include <string.h>

#include "stopset.h"

/* Remainders of the sixteen half bytes at each of the eight places of a word, the lowest first. */
static const uint32_t ISO_HDLC[8][16] = {
    {0x00000000, 0xb8bc6765, 0xaa09c88b, 0x12b5afee, 0x8f629757, 0x37def032, 0x256b5fdc, 0x9dd738b9,
     0xc5b428ef, 0x7d084f8a, 0x6fbde064, 0xd7018701, 0x4ad6bfb8, 0xf26ad8dd, 0xe0df7733, 0x58631056},
    {0x00000000, 0x5019579f, 0xa032af3e, 0xf02bf8a1, 0x9b14583d, 0xcb0d0fa2, 0x3b26f703, 0x6b3fa09c,
     0xed59b63b, 0xbd40e1a4, 0x4d6b1905, 0x1d724e9a, 0x764dee06, 0x2654b999, 0xd67f4138, 0x866616a7},
    {0x00000000, 0x01c26a37, 0x0384d46e, 0x0246be59, 0x0709a8dc, 0x06cbc2eb, 0x048d7cb2, 0x054f1685,
     0x0e1351b8, 0x0fd13b8f, 0x0d9785d6, 0x0c55efe1, 0x091af964, 0x08d89353, 0x0a9e2d0a, 0x0b5c473d},
    {0x00000000, 0x1c26a370, 0x384d46e0, 0x246be590, 0x709a8dc0, 0x6cbc2eb0, 0x48d7cb20, 0x54f16850,
     0xe1351b80, 0xfd13b8f0, 0xd9785d60, 0xc55efe10, 0x91af9640, 0x8d893530, 0xa9e2d0a0, 0xb5c473d0},
    {0x00000000, 0x191b3141, 0x32366282, 0x2b2d53c3, 0x646cc504, 0x7d77f445, 0x565aa786, 0x4f4196c7,
     0xc8d98a08, 0xd1c2bb49, 0xfaefe88a, 0xe3f4d9cb, 0xacb54f0c, 0xb5ae7e4d, 0x9e832d8e, 0x87981ccf},
    {0x00000000, 0x4ac21251, 0x958424a2, 0xdf4636f3, 0xf0794f05, 0xbabb5d54, 0x65fd6ba7, 0x2f3f79f6,
     0x3b83984b, 0x71418a1a, 0xae07bce9, 0xe4c5aeb8, 0xcbfad74e, 0x8138c51f, 0x5e7ef3ec, 0x14bce1bd},
    {0x00000000, 0x77073096, 0xee0e612c, 0x990951ba, 0x076dc419, 0x706af48f, 0xe963a535, 0x9e6495a3,
     0x0edb8832, 0x79dcb8a4, 0xe0d5e91e, 0x97d2d988, 0x09b64c2b, 0x7eb17cbd, 0xe7b82d07, 0x90bf1d91},
    {0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
     0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c},
};
static const uint32_t CASTAGNOLI[8][16] = {
    {0x00000000, 0xdd45aab8, 0xbf672381, 0x62228939, 0x7b2231f3, 0xa6679b4b, 0xc4451272, 0x1900b8ca,
     0xf64463e6, 0x2b01c95e, 0x49234067, 0x9466eadf, 0x8d665215, 0x5023f8ad, 0x32017194, 0xef44db2c},
    {0x00000000, 0xe964b13d, 0xd725148b, 0x3e41a5b6, 0xaba65fe7, 0x42c2eeda, 0x7c834b6c, 0x95e7fa51,
     0x52a0c93f, 0xbbc47802, 0x8585ddb4, 0x6ce16c89, 0xf90696d8, 0x106227e5, 0x2e238253, 0xc747336e},
    {0x00000000, 0xa541927e, 0x4f6f520d, 0xea2ec073, 0x9edea41a, 0x3b9f3664, 0xd1b1f617, 0x74f06469,
     0x38513ec5, 0x9d10acbb, 0x773e6cc8, 0xd27ffeb6, 0xa68f9adf, 0x03ce08a1, 0xe9e0c8d2, 0x4ca15aac},
    {0x00000000, 0x70a27d8a, 0xe144fb14, 0x91e6869e, 0xc76580d9, 0xb7c7fd53, 0x26217bcd, 0x56830647,
     0x8b277743, 0xfb850ac9, 0x6a638c57, 0x1ac1f1dd, 0x4c42f79a, 0x3ce08a10, 0xad060c8e, 0xdda47104},
    {0x00000000, 0x13a29877, 0x274530ee, 0x34e7a899, 0x4e8a61dc, 0x5d28f9ab, 0x69cf5132, 0x7a6dc945,
     0x9d14c3b8, 0x8eb65bcf, 0xba51f356, 0xa9f36b21, 0xd39ea264, 0xc03c3a13, 0xf4db928a, 0xe7790afd},
    {0x00000000, 0x3fc5f181, 0x7f8be302, 0x404e1283, 0xff17c604, 0xc0d23785, 0x809c2506, 0xbf59d487,
     0xfbc3faf9, 0xc4060b78, 0x844819fb, 0xbb8de87a, 0x04d43cfd, 0x3b11cd7c, 0x7b5fdfff, 0x449a2e7e},
    {0x00000000, 0xf26b8303, 0xe13b70f7, 0x1350f3f4, 0xc79a971f, 0x35f1141c, 0x26a1e7e8, 0xd4ca64eb,
     0x8ad958cf, 0x78b2dbcc, 0x6be22838, 0x9989ab3b, 0x4d43cfd0, 0xbf284cd3, 0xac78bf27, 0x5e133c24},
    {0x00000000, 0x105ec76f, 0x20bd8ede, 0x30e349b1, 0x417b1dbc, 0x5125dad3, 0x61c69362, 0x7198540d,
     0x82f63b78, 0x92a8fc17, 0xa24bb5a6, 0xb21572c9, 0xc38d26c4, 0xd3d3e1ab, 0xe330a81a, 0xf36e6f75},
};

static uint32_t word(const uint8_t *data) {
    return (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24;
}

static uint32_t word_taken(const uint32_t (*table)[16], uint32_t crc, uint32_t x) {
    x ^= crc;
    crc = 0;
    for (int k = 0; k < 8; k++) crc ^= table[k][x >> 4 * k & 15];
    return crc;
}

static uint32_t taken(const uint32_t (*table)[16], uint32_t crc, int64_t length, const uint8_t *data) {
    for (; length >= 4; length -= 4, data += 4) crc = word_taken(table, crc, word(data));
    for (; length > 0; length--, data++) {
        const uint32_t x = crc ^ data[0];
        crc = x >> 8 ^ table[6][x & 15] ^ table[7][x >> 4 & 15];
    }
    return crc;
}

uint32_t stopset_crc32(int64_t length, const uint8_t *data) { return ~taken(ISO_HDLC, ~0u, length, data); }

uint32_t stopset_crc32c(int64_t length, const uint8_t *data) { return ~taken(CASTAGNOLI, ~0u, length, data); }

static void put(uint8_t *data, uint32_t x) {
    for (int k = 0; k < 4; k++) data[k] = (uint8_t)(x >> 8 * k);
}

static uint32_t float_bits(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* Bits of the float that is not below (side 1) or not above (side -1) x; not a number bounds nothing: an infinity. */
static uint32_t outward(double x, int side) {
    const uint32_t inf = 0x7f800000u, sign = 0x80000000u;
    if (x != x) return side > 0 ? inf : side < 0 ? sign | inf : 0x7fc00000u;
    const float y = (float)x;
    const uint32_t bits = float_bits(y);
    if (side > 0 && (double)y < x) return y == 0.0f ? 1u : bits & sign ? bits - 1u : bits + 1u;
    if (side < 0 && (double)y > x) return y == 0.0f ? sign | 1u : bits & sign ? bits + 1u : bits - 1u;
    return bits;
}

void stopset_outward(int64_t N, const double *x, const int8_t *side, uint32_t *bits) {
    for (int64_t k = 0; k < N; k++) bits[k] = outward(x[k], side[k]);
}

void stopset_seal(StopsetMessage *m, int64_t end) {
    for (; m->summed + 4 <= end; m->summed += 4) { /* side by side: neither waits for the other */
        const uint32_t x = word(m->bytes + m->summed);
        m->iso = word_taken(ISO_HDLC, m->iso, x);
        m->castagnoli = word_taken(CASTAGNOLI, m->castagnoli, x);
    }
    put(m->bytes + end, ~m->iso);
    put(m->bytes + end + 4, ~word_taken(CASTAGNOLI, m->castagnoli, ~m->iso));
}

void stopset_message(StopsetMessage *m, int64_t end) {
    for (int64_t k = 0; k < m->count; k++) put(m->bytes + m->first + 4 * k, outward(m->numbers[k], m->side[k]));
    m->summed = 0;
    m->iso = m->castagnoli = ~0u;
    stopset_seal(m, end);
}
