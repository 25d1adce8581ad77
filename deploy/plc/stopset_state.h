/* Generated from stopset.monitor.layout; do not edit. Monitoring aid, not a safety function. Little-endian hosts. */
#ifndef STOPSET_STATE_H
#define STOPSET_STATE_H
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define STOPSET_MAGIC 0x53505453u
#define STOPSET_LAYOUT_VERSION 2u
#define STOPSET_LENGTH 616u
#define STOPSET_MAX_JOINTS 8u
#define STOPSET_MAC_AT 592u /* the authentication code covers all bytes before it */
#define STOPSET_MAC_LENGTH 16u
#define STOPSET_NONCES 4u
#define STOPSET_PROOF_LIFE_NS 1000000000LL /* an answered challenge is believed for this long */
#define STOPSET_CHALLENGE_NS 200000000LL
#define STOPSET_DRIFT_PPM 1000LL
#define STOPSET_STATE_NEVER_SENT 0x00u
#define STOPSET_STATE_INIT 0x17u
#define STOPSET_STATE_OK 0x2Bu
#define STOPSET_STATE_DEGRADED 0x4Du
#define STOPSET_STATE_VIOLATION 0x71u
#define STOPSET_STATE_UNKNOWN 0x8Eu
#define STOPSET_STATE_FAULT 0xB2u
#define STOPSET_STATE_SHUTDOWN 0xD4u
#define STOPSET_FLAG_VIOLATION_LATCHED 1u
#define STOPSET_FLAG_OUT_OF_DOMAIN 2u
#define STOPSET_FLAG_BUS_GAP 4u
#define STOPSET_FLAG_BUS_STALE 8u
#define STOPSET_FLAG_NO_STOP_PROVABLE 16u
#define STOPSET_FLAG_DEADLINE_MISS 32u
#define STOPSET_FLAG_DRIVES_NOT_POWERED 64u
#define STOPSET_FLAG_NO_TORQUE 128u
#define STOPSET_FLAG_FALLBACK_IN_FORCE 256u
#define STOPSET_FLAG_STOP_NOT_FRESH 512u
#define STOPSET_FLAG_NODE_NOT_GOOD 1024u
#define STOPSET_FLAG_EVIDENCE_YOUNG 2048u
#define STOPSET_FLAG_RECOVERING 4096u
#define STOPSET_FLAG_END_STOP 8192u
#define STOPSET_CLASS_NONE 0u
#define STOPSET_CLASS_UNCLASSED 1u
#define STOPSET_CLASS_SPIKE 2u
#define STOPSET_CLASS_FROZEN 3u
#define STOPSET_CLASS_STALE 4u
#define STOPSET_CLASS_LATE_TORQUE 5u
#define STOPSET_CLASS_CONTACT 6u
#define STOPSET_CLASS_DRIFT 7u
#define STOPSET_CLASS_MISSING_EFFECT 8u
#define STOPSET_CLASS_ENCODER_JUMP 9u
#define STOPSET_FAULT_NONE 0 /* none */
#define STOPSET_FAULT_NO_MESSAGE 1 /* no message yet */
#define STOPSET_FAULT_UNREADABLE 2 /* a message was damaged or of another version */
#define STOPSET_FAULT_FOREIGN 3 /* a message of another data id */
#define STOPSET_FAULT_FORGED 4 /* a message whose authentication code is not of a key held here */
#define STOPSET_FAULT_OTHER_MODEL 5 /* a message of another model than is expected */
#define STOPSET_FAULT_OTHER_CONFIG 6 /* a message of another configuration than is expected: a monitor keeps the one it was started with */
#define STOPSET_FAULT_REPEATED 7 /* a message repeated or out of order */
#define STOPSET_FAULT_UNPROVEN 8 /* no answer to my challenge by this daemon */
#define STOPSET_FAULT_SILENT 9 /* silent */
#define STOPSET_FAULT_STALE 10 /* the data may be older than they are valid for */
#define STOPSET_FAULT_AHEAD 11 /* the data are stamped later than now */
#define STOPSET_FAULT_NO_SUCH_STATE 12 /* unknown state code */
/* as they were called before */
#define STOPSET_DOUBT_NONE STOPSET_FAULT_NONE
#define STOPSET_DOUBT_NO_MESSAGE STOPSET_FAULT_NO_MESSAGE
#define STOPSET_DOUBT_UNREADABLE STOPSET_FAULT_UNREADABLE
#define STOPSET_DOUBT_FOREIGN STOPSET_FAULT_FOREIGN
#define STOPSET_DOUBT_FORGED STOPSET_FAULT_FORGED
#define STOPSET_DOUBT_OTHER_MODEL STOPSET_FAULT_OTHER_MODEL
#define STOPSET_DOUBT_OTHER_CONFIG STOPSET_FAULT_OTHER_CONFIG
#define STOPSET_DOUBT_REPEATED STOPSET_FAULT_REPEATED
#define STOPSET_DOUBT_UNPROVEN STOPSET_FAULT_UNPROVEN
#define STOPSET_DOUBT_SILENT STOPSET_FAULT_SILENT
#define STOPSET_DOUBT_STALE STOPSET_FAULT_STALE
#define STOPSET_DOUBT_AHEAD STOPSET_FAULT_AHEAD
#define STOPSET_DOUBT_NO_SUCH_STATE STOPSET_FAULT_NO_SUCH_STATE

typedef struct {
  uint32_t magic; /* @0 0x53505453 */
  uint16_t layout_version; /* @4 this table's version */
  uint16_t length; /* @6 [byte] of the whole message */
  uint32_t data_id; /* @8 identity of the source: site, cell, arm; from the configuration */
  uint32_t seq; /* @12 +1 per message and boot */
  uint64_t boot_id; /* @16 random per start of the daemon */
  uint64_t t_meas_ns; /* @24 [ns] sampling instant (SYNC), clock of the bus adapter */
  uint64_t t_pub_ns; /* @32 [ns] when this message was made, CLOCK_REALTIME of the daemon */
  uint64_t model_hash; /* @40 first 8 bytes of the model file's SHA-256 */
  uint64_t config_hash; /* @48 first 8 bytes of the configuration's SHA-256 */
  uint16_t valid_for_ms; /* @56 [ms] do not use the numbers longer than this after t_meas */
  uint8_t state; /* @58 see the state codes; anything unknown means FAULT */
  uint8_t conformance; /* @59 of this sample: 0 unknown, 1 conformant, 2 violation, 3 check failed */
  uint32_t cycle_us; /* @60 [us] nominal cycle of the messages */
  uint8_t joints; /* @64 number of joints in use; later slots are 0 */
  uint8_t first_joint; /* @65 first joint of the latched violation, 1 = joint 1; 0 none */
  uint16_t violation_class; /* @66 of the latched violation, by the evidence: see the class codes; 0 none */
  uint32_t flags; /* @68 see the flag bits */
  uint32_t violation_count; /* @72 samples outside their prediction since the last reset */
  float holding_margin_min; /* @76 [N m] least torque to spare in holding the arm on its brakes */
  float oldest_age; /* @80 [s] oldest prediction this sample was held against */
  float room_min; /* @84 distance to the nearest bound over the half width; negative outside */
  uint32_t stop0_provable; /* @88 STOP 0: bit i set = joint i+1 has a proven bound */
  float stop0_time[8]; /* @92 [s] STOP 0: stop time per joint, +Inf if not provable */
  float stop0_angle_forward[8]; /* @124 [rad] STOP 0: travel in + direction per joint */
  float stop0_angle_back[8]; /* @156 [rad] STOP 0: travel in - direction per joint */
  float stop0_time_max; /* @188 [s] STOP 0: stop time of the arm */
  float stop0_tcp; /* @192 [m] STOP 0: travel of the flange */
  float stop0_reaction; /* @196 [s] STOP 0: reaction time in the numbers (0: yours to add) */
  uint32_t stop1_provable; /* @200 STOP 1, the ramp works: bit i set = joint i+1 has a proven bound */
  float stop1_time[8]; /* @204 [s] STOP 1, the ramp works: stop time per joint, +Inf if not provable */
  float stop1_angle_forward[8]; /* @236 [rad] STOP 1, the ramp works: travel in + direction per joint */
  float stop1_angle_back[8]; /* @268 [rad] STOP 1, the ramp works: travel in - direction per joint */
  float stop1_time_max; /* @300 [s] STOP 1, the ramp works: stop time of the arm */
  float stop1_tcp; /* @304 [m] STOP 1, the ramp works: travel of the flange */
  float stop1_reaction; /* @308 [s] STOP 1, the ramp works: reaction time in the numbers (0: yours to add) */
  uint32_t stop1g_provable; /* @312 STOP 1, the ramp fails: bit i set = joint i+1 has a proven bound */
  float stop1g_time[8]; /* @316 [s] STOP 1, the ramp fails: stop time per joint, +Inf if not provable */
  float stop1g_angle_forward[8]; /* @348 [rad] STOP 1, the ramp fails: travel in + direction per joint */
  float stop1g_angle_back[8]; /* @380 [rad] STOP 1, the ramp fails: travel in - direction per joint */
  float stop1g_time_max; /* @412 [s] STOP 1, the ramp fails: stop time of the arm */
  float stop1g_tcp; /* @416 [m] STOP 1, the ramp fails: travel of the flange */
  float stop1g_reaction; /* @420 [s] STOP 1, the ramp fails: reaction time in the numbers (0: yours to add) */
  uint32_t stop2_provable; /* @424 STOP 2: bit i set = joint i+1 has a proven bound */
  float stop2_time[8]; /* @428 [s] STOP 2: stop time per joint, +Inf if not provable */
  float stop2_angle_forward[8]; /* @460 [rad] STOP 2: travel in + direction per joint */
  float stop2_angle_back[8]; /* @492 [rad] STOP 2: travel in - direction per joint */
  float stop2_time_max; /* @524 [s] STOP 2: stop time of the arm */
  float stop2_tcp; /* @528 [m] STOP 2: travel of the flange */
  float stop2_reaction; /* @532 [s] STOP 2: reaction time in the numbers (0: yours to add) */
  uint32_t check; /* @536 CRC-32/ISO-HDLC of all bytes before this field */
  uint32_t crc; /* @540 CRC-32C of all bytes before this field */
  uint64_t nonces[4]; /* @544 first 8 bytes of the last challenges heard, newest first; 0 none */
  uint32_t key_id; /* @576 key of the authentication code; 0 no code */
  uint32_t bad_nodes; /* @580 bit i set = the drive of joint i+1 is silent, not operational, or in an emergency */
  uint32_t dropped; /* @584 samples dropped unread since the start because newer ones were there */
  uint32_t reserved2; /* @588 0 */
  uint8_t mac[16]; /* @592 HMAC-SHA256 of all bytes before this field, its first 16 bytes */
  uint32_t end_check; /* @608 CRC-32/ISO-HDLC of all bytes before this field */
  uint32_t end_crc; /* @612 CRC-32C of all bytes before this field */
} stopset_state;
typedef char stopset_size_check[sizeof(stopset_state) == STOPSET_LENGTH ? 1 : -1];

static uint32_t stopset_crc(const uint8_t *p, size_t n, uint32_t polynomial) {
  uint32_t c = 0xFFFFFFFFu;
  for (size_t i = 0; i < n; i++) {
    c ^= p[i];
    for (int k = 0; k < 8; k++) c = (c >> 1) ^ ((c & 1u) ? polynomial : 0u);
  }
  return ~c;
}

/* 1: *out holds an undamaged message of this layout; 0: there is none. Whether it may be believed: stopset_consumer.h */
static int stopset_read(const uint8_t *data, size_t n, stopset_state *out) {
  if (n != STOPSET_LENGTH) return 0;
  memcpy(out, data, sizeof *out);
  return out->magic == STOPSET_MAGIC && out->layout_version == STOPSET_LAYOUT_VERSION && out->length == STOPSET_LENGTH &&
         out->crc == stopset_crc(data, 540u, 0x82F63B78u) && out->check == stopset_crc(data, 536u, 0xEDB88320u) &&
         out->end_crc == stopset_crc(data, 612u, 0x82F63B78u) &&
         out->end_check == stopset_crc(data, 608u, 0xEDB88320u);
}
#endif
