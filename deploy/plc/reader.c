/* Example consumer (POSIX): states come on standard input, each as a 16-bit length and its bytes; nonces go to standard output
   as "nonce <16 hex digits>" for whoever puts them on <prefix>/challenge; every change of what may be believed as a line
   "state=0x2B why=0 seq=7 lost=0 refused=0 ..." with the numbers.
   usage: reader DATA_ID MODEL_HASH CONFIG_HASH WATCHDOG_MS [KEY_ID SECRET_HEX]...      (hashes: 16 hex digits) */
#define _POSIX_C_SOURCE 200809L
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "stopset_consumer.h"

static int64_t now_ns(void) {
  struct timespec t;
#ifdef CLOCK_BOOTTIME
  clock_gettime(CLOCK_BOOTTIME, &t);
#else
  clock_gettime(CLOCK_MONOTONIC, &t);
#endif
  return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static uint64_t fresh(FILE *source) {
  uint64_t x;
  if (fread(&x, sizeof x, 1, source) != 1) exit(3); /* without random numbers there is no proof of life */
  return x;
}

static void print_state(const stopset_consumer *c, uint8_t state) {
  uint64_t refused = 0;
  for (unsigned i = 0; i < sizeof c->refused / sizeof *c->refused; i++) refused += c->refused[i];
  printf("state=0x%02X why=%d seq=%lu lost=%llu refused=%llu flags=%lu violation_count=%lu first_joint=%u stop0_tcp=%.9g room_min=%.9g",
         state, c->why, (unsigned long)c->last.seq, (unsigned long long)c->lost, (unsigned long long)refused,
         (unsigned long)c->last.flags, (unsigned long)c->last.violation_count, c->last.first_joint, c->last.stop0_tcp,
         c->last.room_min);
  for (unsigned i = 0; i < c->last.joints && i < STOPSET_MAX_JOINTS; i++) printf(" stop0_time[%u]=%.9g", i, c->last.stop0_time[i]);
  printf("\n");
}

int main(int argc, char **argv) {
  static stopset_key keys[16];
  static uint8_t in[65536 + 2];
  size_t filled = 0;
  int printed_state = -1, printed_why = -1, open = 1;
  stopset_consumer c = {0};
  FILE *random = fopen("/dev/urandom", "rb");
  if (argc < 5 || !random) return 2;
  c.expect.data_id = (uint32_t)strtoul(argv[1], NULL, 0);
  c.expect.model_hash = strtoull(argv[2], NULL, 16);
  c.expect.config_hash = strtoull(argv[3], NULL, 16);
  c.expect.watchdog_ns = strtoll(argv[4], NULL, 0) * 1000000;
  for (int i = 5; i + 1 < argc && c.expect.n_keys < 16; i += 2) {
    stopset_key *k = &keys[c.expect.n_keys++];
    k->key_id = (uint32_t)strtoul(argv[i], NULL, 0);
    for (int j = 0; j < 32; j++) {
      unsigned byte;
      if (sscanf(argv[i + 1] + 2 * j, "%2x", &byte) != 1) return 2;
      k->secret[j] = (uint8_t)byte;
    }
    c.expect.keys = keys;
  }
  while (open) {
    struct pollfd p = {0, POLLIN, 0};
    uint64_t nonce = stopset_challenge(&c, now_ns(), fresh(random));
    uint8_t state;
    if (nonce) printf("nonce %016llx\n", (unsigned long long)nonce);
    if (poll(&p, 1, 2) > 0) {
      ssize_t got = read(0, in + filled, sizeof in - filled);
      if (got <= 0) open = 0;
      else filled += (size_t)got;
      while (filled >= 2) {
        size_t n = in[0] | (size_t)in[1] << 8;
        if (filled < n + 2) break;
        stopset_take(&c, in + 2, n, now_ns());
        filled -= n + 2;
        memmove(in, in + n + 2, filled);
      }
    }
    state = stopset_now(&c, now_ns());
    if (state != printed_state || c.why != printed_why) print_state(&c, state);
    printed_state = state;
    printed_why = c.why;
    fflush(stdout);
  }
  return 0;
}
