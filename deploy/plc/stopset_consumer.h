/* How a controller must read the state: every doubt is FAULT. The same as stopset.monitor.consumer, step by step.
   No allocation, no library, C99. Monitoring aid, not a safety function.

   Once:         stopset_consumer c = {0}; fill c.expect; keep c.
   Every cycle:  nonce = stopset_challenge(&c, now_ns, random64)  -> if not 0, send its 8 bytes on <prefix>/challenge
                 stopset_take(&c, bytes, n, now_ns)               for every message that has come on <prefix>/state
                 stopset_now(&c, now_ns)                          -> the state that holds; c.last has the numbers, c.why the doubt
   now_ns: own clock that is never set and goes on while the machine sleeps (Linux: CLOCK_BOOTTIME), not 0 at the first call. random64: 64 fresh random bits. */
#ifndef STOPSET_CONSUMER_H
#define STOPSET_CONSUMER_H
#include "stopset_state.h"

typedef struct {
  uint32_t key_id;
  uint8_t secret[32];
} stopset_key;

typedef struct {
  uint32_t data_id;
  uint64_t model_hash, config_hash; /* first 8 bytes of the SHA-256 of the model's content and of the configuration */
  const stopset_key *keys;          /* 0: no authentication code is asked for */
  unsigned n_keys;
  int64_t watchdog_ns; /* longest silence: at least two cycles and jitter */
} stopset_expected;

typedef struct {
  stopset_expected expect;
  stopset_state last;
  int have_last, have_boot, why;
  int64_t arrived, asked, proved, lo, hi; /* lo, hi: how far the daemon's clock is ahead of this one, at `proved` */
  uint64_t nonce, boot;
  uint64_t lost, refused[16];
  uint64_t answered; /* the nonce before */
  int64_t beside;    /* when another living sender was heard beside the one that is believed; if have_beside */
  int have_beside;
  int settled; /* OK or DEGRADED has come without a break since the last answer: the daemon's clock was not set meanwhile */
  int64_t refused_at; /* when a message was refused last, and why; if that is not 0 */
  int refusal;
} stopset_consumer;

/* ---- SHA-256 (FIPS 180-4) and HMAC (RFC 2104) ---- */
static const uint32_t stopset_k[64] = {
    0x428a2f98u, 0x71374491u, 0xb5c0fbcfu, 0xe9b5dba5u, 0x3956c25bu, 0x59f111f1u, 0x923f82a4u, 0xab1c5ed5u, 0xd807aa98u, 0x12835b01u,
    0x243185beu, 0x550c7dc3u, 0x72be5d74u, 0x80deb1feu, 0x9bdc06a7u, 0xc19bf174u, 0xe49b69c1u, 0xefbe4786u, 0x0fc19dc6u, 0x240ca1ccu,
    0x2de92c6fu, 0x4a7484aau, 0x5cb0a9dcu, 0x76f988dau, 0x983e5152u, 0xa831c66du, 0xb00327c8u, 0xbf597fc7u, 0xc6e00bf3u, 0xd5a79147u,
    0x06ca6351u, 0x14292967u, 0x27b70a85u, 0x2e1b2138u, 0x4d2c6dfcu, 0x53380d13u, 0x650a7354u, 0x766a0abbu, 0x81c2c92eu, 0x92722c85u,
    0xa2bfe8a1u, 0xa81a664bu, 0xc24b8b70u, 0xc76c51a3u, 0xd192e819u, 0xd6990624u, 0xf40e3585u, 0x106aa070u, 0x19a4c116u, 0x1e376c08u,
    0x2748774cu, 0x34b0bcb5u, 0x391c0cb3u, 0x4ed8aa4au, 0x5b9cca4fu, 0x682e6ff3u, 0x748f82eeu, 0x78a5636fu, 0x84c87814u, 0x8cc70208u,
    0x90befffau, 0xa4506cebu, 0xbef9a3f7u, 0xc67178f2u};

static uint32_t stopset_turn(uint32_t x, int k) { return (x >> k) | (x << (32 - k)); }

static void stopset_block(uint32_t h[8], const uint8_t *p) {
  uint32_t w[64], s[8];
  for (int i = 0; i < 16; i++)
    w[i] = (uint32_t)p[4 * i] << 24 | (uint32_t)p[4 * i + 1] << 16 | (uint32_t)p[4 * i + 2] << 8 | p[4 * i + 3];
  for (int i = 16; i < 64; i++) {
    uint32_t a = w[i - 15], b = w[i - 2];
    w[i] = w[i - 16] + (stopset_turn(a, 7) ^ stopset_turn(a, 18) ^ (a >> 3)) + w[i - 7] +
           (stopset_turn(b, 17) ^ stopset_turn(b, 19) ^ (b >> 10));
  }
  memcpy(s, h, sizeof s);
  for (int i = 0; i < 64; i++) {
    uint32_t t1 = s[7] + (stopset_turn(s[4], 6) ^ stopset_turn(s[4], 11) ^ stopset_turn(s[4], 25)) +
                  ((s[4] & s[5]) ^ (~s[4] & s[6])) + stopset_k[i] + w[i];
    uint32_t t2 = (stopset_turn(s[0], 2) ^ stopset_turn(s[0], 13) ^ stopset_turn(s[0], 22)) +
                  ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
    for (int j = 7; j > 0; j--) s[j] = s[j - 1];
    s[4] += t1;
    s[0] = t1 + t2;
  }
  for (int i = 0; i < 8; i++) h[i] += s[i];
}

/* SHA-256 of `pad` (64 bytes) followed by n bytes */
static void stopset_sha256(const uint8_t pad[64], const uint8_t *data, size_t n, uint8_t out[32]) {
  uint32_t h[8] = {0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au, 0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u};
  uint8_t tail[128] = {0};
  size_t rest = n % 64, end = rest < 56 ? 64 : 128;
  uint64_t bits = 8u * (uint64_t)(n + 64);
  stopset_block(h, pad);
  for (size_t at = 0; at + 64 <= n; at += 64) stopset_block(h, data + at);
  memcpy(tail, data + (n - rest), rest);
  tail[rest] = 0x80;
  for (int i = 0; i < 8; i++) tail[end - 1 - (size_t)i] = (uint8_t)(bits >> 8 * i);
  for (size_t at = 0; at < end; at += 64) stopset_block(h, tail + at);
  for (int i = 0; i < 32; i++) out[i] = (uint8_t)(h[i / 4] >> 8 * (3 - i % 4));
}

static int stopset_made_by(const stopset_key *key, const uint8_t *data) {
  uint8_t inner[64], outer[64], digest[32], differ = 0;
  for (int i = 0; i < 64; i++) {
    uint8_t k = i < 32 ? key->secret[i] : 0;
    inner[i] = k ^ 0x36;
    outer[i] = k ^ 0x5c;
  }
  stopset_sha256(inner, data, STOPSET_MAC_AT, digest);
  stopset_sha256(outer, digest, sizeof digest, digest);
  for (unsigned i = 0; i < STOPSET_MAC_LENGTH; i++) differ |= digest[i] ^ data[STOPSET_MAC_AT + i];
  return differ == 0;
}

/* ---- the consumer ---- */
/* by how much two clocks part in `span` ns, at most */
static int64_t stopset_drift_of(int64_t span) { return (span > 0 ? span * STOPSET_DRIFT_PPM / 1000000 : 0) + 1; }

static int64_t stopset_drift(const stopset_consumer *c, int64_t now) { return stopset_drift_of(now - c->proved); }

/* The nonce to send now; 0 when it is not time. */
static uint64_t stopset_challenge(stopset_consumer *c, int64_t now, uint64_t random) {
  int64_t due = c->nonce ? STOPSET_PROOF_LIFE_NS / 2 : STOPSET_CHALLENGE_NS;
  if (c->asked && now - c->asked < due) return 0;
  c->nonce = random ? random : 1;
  c->asked = now;
  return c->nonce;
}

static int stopset_stranger(const stopset_consumer *c, const stopset_state *m, const uint8_t *data) {
  const stopset_expected *e = &c->expect;
  if (m->data_id != e->data_id) return STOPSET_FAULT_FOREIGN;
  if (e->keys) {
    int known = 0;
    for (unsigned i = 0; i < e->n_keys; i++) known |= e->keys[i].key_id == m->key_id && stopset_made_by(&e->keys[i], data);
    if (!known) return STOPSET_FAULT_FORGED;
  }
  if (m->model_hash != e->model_hash) return STOPSET_FAULT_OTHER_MODEL;
  if (m->config_hash != e->config_hash) return STOPSET_FAULT_OTHER_CONFIG;
  return STOPSET_FAULT_NONE;
}

static void stopset_prove(stopset_consumer *c, const stopset_state *m, int64_t now) {
  int64_t since = stopset_drift_of(now - c->asked); /* it was made between the two, and the clocks have parted further since */
  int64_t lo = (int64_t)m->t_pub_ns - now - since, hi = (int64_t)m->t_pub_ns - c->asked + since;
  if (c->have_boot && m->boot_id == c->boot && c->settled) { /* what was known before still holds, but for the drift since */
    int64_t drift = stopset_drift(c, now), before_lo = c->lo - drift, before_hi = c->hi + drift;
    if (before_lo < lo) before_lo = lo;
    if (before_hi > hi) before_hi = hi;
    if (before_lo <= before_hi) {
      lo = before_lo;
      hi = before_hi;
    }
  }
  c->boot = m->boot_id;
  c->have_boot = 1;
  c->answered = c->nonce;
  c->proved = now;
  c->lo = lo;
  c->hi = hi;
  c->nonce = 0;
}

static int stopset_refuse(stopset_consumer *c, int fault, int64_t now) {
  c->refused[fault]++;
  c->refused_at = now;
  c->refusal = fault;
  return fault;
}

static int stopset_believed(const stopset_state *m) { return m->state == STOPSET_STATE_OK || m->state == STOPSET_STATE_DEGRADED; }

/* A message arrived; a doubtful one counts as silence. Returns the doubt, 0 if there is none. */
static int stopset_take(stopset_consumer *c, const uint8_t *data, size_t n, int64_t now) {
  stopset_state m;
  int fault, answer = 0, lives = 0, same_boot, alive;
  if (!stopset_read(data, n, &m)) return stopset_refuse(c, STOPSET_FAULT_UNREADABLE, now);
  if ((fault = stopset_stranger(c, &m, data)) != 0) return stopset_refuse(c, fault, now);
  for (unsigned i = 0; i < STOPSET_NONCES; i++) {
    answer |= c->nonce && m.nonces[i] == c->nonce;
    lives |= c->answered && m.nonces[i] == c->answered;
  }
  same_boot = c->have_boot && m.boot_id == c->boot;
  alive = c->have_last && now - c->arrived <= c->expect.watchdog_ns;
  if (!same_boot && alive) { /* another sender beside the one that is there */
    if (answer || lives) { /* two monitors have this data id, and one of them may watch another arm */
      c->beside = now;
      c->have_beside = 1;
    }
    return stopset_refuse(c, STOPSET_FAULT_UNPROVEN, now);
  }
  if (!same_boot && !answer) return stopset_refuse(c, STOPSET_FAULT_UNPROVEN, now);
  if (c->have_last && m.boot_id == c->last.boot_id) {
    uint32_t step = m.seq - c->last.seq;
    if (step == 0u || step >= 0x80000000u) return stopset_refuse(c, STOPSET_FAULT_REPEATED, now);
    c->lost += step - 1u;
  }
  c->settled = c->settled && alive && stopset_believed(&m);
  if (answer) {
    stopset_prove(c, &m, now);
    c->settled = stopset_believed(&m);
  } else if (now + c->hi + stopset_drift(c, now) < (int64_t)m.t_pub_ns) { /* made later than now: its clock has been set forward */
    c->proved = now - STOPSET_PROOF_LIFE_NS - 1;
  }
  c->last = m;
  c->have_last = 1;
  c->arrived = now;
  return STOPSET_FAULT_NONE;
}

static int stopset_fault(const stopset_consumer *c, int64_t now) {
  const stopset_state *m = &c->last;
  int64_t oldest;
  if (!c->have_last || now - c->arrived > c->expect.watchdog_ns) {
    if (c->refusal && now - c->refused_at <= c->expect.watchdog_ns) return c->refusal; /* somebody speaks, but not as is expected */
    return c->have_last ? STOPSET_FAULT_SILENT : STOPSET_FAULT_NO_MESSAGE;
  }
  if (now - c->proved > STOPSET_PROOF_LIFE_NS || (c->have_beside && now - c->beside <= STOPSET_PROOF_LIFE_NS))
    return STOPSET_FAULT_UNPROVEN;
  switch (m->state) {
    case STOPSET_STATE_OK:
    case STOPSET_STATE_DEGRADED: break;
    case STOPSET_STATE_INIT:
    case STOPSET_STATE_VIOLATION:
    case STOPSET_STATE_UNKNOWN:
    case STOPSET_STATE_FAULT:
    case STOPSET_STATE_SHUTDOWN: return STOPSET_FAULT_NONE; /* nothing in it is to be used */
    default: return STOPSET_FAULT_NO_SUCH_STATE;
  }
  if (!c->settled) return STOPSET_FAULT_UNPROVEN;
  oldest = now + c->hi + stopset_drift(c, now) - (int64_t)m->t_meas_ns;
  if (oldest < 0) return STOPSET_FAULT_AHEAD;
  return oldest > (int64_t)m->valid_for_ms * 1000000 ? STOPSET_FAULT_STALE : STOPSET_FAULT_NONE;
}

/* The state that holds now: the daemon's, or FAULT if there is any doubt. */
static uint8_t stopset_now(stopset_consumer *c, int64_t now) {
  c->why = stopset_fault(c, now);
  return c->why ? STOPSET_STATE_FAULT : c->last.state;
}
/* as it was called before */
#define stopset_doubt stopset_fault

#endif
