/* What a message needs: numbers rounded to their safe side, and both checksums.
 *
 * Source: CRC-32/ISO-HDLC and CRC-32C (Castagnoli), both reflected, start and end inverted.
 */
#include <string.h>

#include "stopset.h"

/* Remainders of the sixteen half bytes. */
static const uint32_t ISO_HDLC[16] = {0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
                                      0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c};
static const uint32_t CASTAGNOLI[16] = {0x00000000, 0x105ec76f, 0x20bd8ede, 0x30e349b1, 0x417b1dbc, 0x5125dad3, 0x61c69362, 0x7198540d,
                                        0x82f63b78, 0x92a8fc17, 0xa24bb5a6, 0xb21572c9, 0xc38d26c4, 0xd3d3e1ab, 0xe330a81a, 0xf36e6f75};

static uint32_t checksum(const uint32_t *table, int64_t length, const uint8_t *data) {
    uint32_t crc = 0xffffffffu;
    for (int64_t k = 0; k < length; k++) {
        crc ^= data[k];
        crc = table[crc & 15] ^ (crc >> 4);
        crc = table[crc & 15] ^ (crc >> 4);
    }
    return ~crc;
}

uint32_t stopset_crc32(int64_t length, const uint8_t *data) { return checksum(ISO_HDLC, length, data); }

uint32_t stopset_crc32c(int64_t length, const uint8_t *data) { return checksum(CASTAGNOLI, length, data); }

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
