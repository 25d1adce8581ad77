"""Writes the C and Structured Text views of the state message: ``python -m stopset.monitor.plc deploy/plc``."""

from __future__ import annotations

import sys
from pathlib import Path

from stopset.monitor.consumer import CHALLENGE_EVERY, DRIFT_PPM, PROOF_LIFE, SAYS, Fault
from stopset.monitor.evidence.cause import Kind
from stopset.monitor.layout import FIELDS, LAYOUT_VERSION, LENGTH, MAC, MAGIC, MAX_JOINTS, NONCES, Flag, State, offsets

_C = {"u8": "uint8_t", "u16": "uint16_t", "u32": "uint32_t", "u64": "uint64_t", "f32": "float"}
_ST = {"u8": "USINT", "u16": "UINT", "u32": "UDINT", "u64": "ULINT", "f32": "REAL"}
_NOTE = "Generated from stopset.monitor.layout; do not edit. Monitoring aid, not a safety function."


def c_header() -> str:
    """``stopset_state.h``: the struct, its codes, and the check for damage."""
    at = offsets()
    rows = "\n".join(
        f"  {_C[f.kind]} {f.name}{f'[{f.count}]' if f.count > 1 else ''}; "
        f"/* @{at[f.name]} {f'[{f.unit}] ' if f.unit else ''}{f.means} */"
        for f in FIELDS
    )
    states = "\n".join(f"#define STOPSET_STATE_{s.name} 0x{s.value:02X}u" for s in State)
    flags = "\n".join(f"#define STOPSET_FLAG_{f.name} {f.value}u" for f in Flag)
    classes = "\n".join(f"#define STOPSET_CLASS_{k.name} {k.code}u" for k in Kind)
    faults = "\n".join(f"#define STOPSET_FAULT_{d.name} {d.value} /* {SAYS[d] or 'none'} */" for d in Fault)
    older = "\n".join(
        f"#define STOPSET_DOUBT_{d.name} STOPSET_FAULT_{d.name}" for d in Fault
    )  # programs that were written with these names
    return f"""/* {_NOTE} Little-endian hosts. */
#ifndef STOPSET_STATE_H
#define STOPSET_STATE_H
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define STOPSET_MAGIC 0x{MAGIC:08X}u
#define STOPSET_LAYOUT_VERSION {LAYOUT_VERSION}u
#define STOPSET_LENGTH {LENGTH}u
#define STOPSET_MAX_JOINTS {MAX_JOINTS}u
#define STOPSET_MAC_AT {at["mac"]}u /* the authentication code covers all bytes before it */
#define STOPSET_MAC_LENGTH {MAC}u
#define STOPSET_NONCES {NONCES}u
#define STOPSET_PROOF_LIFE_NS {PROOF_LIFE}LL /* an answered challenge is believed for this long */
#define STOPSET_CHALLENGE_NS {CHALLENGE_EVERY}LL
#define STOPSET_DRIFT_PPM {DRIFT_PPM}LL
{states}
{flags}
{classes}
{faults}
/* as they were called before */
{older}

typedef struct {{
{rows}
}} stopset_state;
typedef char stopset_size_check[sizeof(stopset_state) == STOPSET_LENGTH ? 1 : -1];

static uint32_t stopset_crc(const uint8_t *p, size_t n, uint32_t polynomial) {{
  uint32_t c = 0xFFFFFFFFu;
  for (size_t i = 0; i < n; i++) {{
    c ^= p[i];
    for (int k = 0; k < 8; k++) c = (c >> 1) ^ ((c & 1u) ? polynomial : 0u);
  }}
  return ~c;
}}

/* 1: *out holds an undamaged message of this layout; 0: there is none. Whether it may be believed: stopset_consumer.h */
static int stopset_read(const uint8_t *data, size_t n, stopset_state *out) {{
  if (n != STOPSET_LENGTH) return 0;
  memcpy(out, data, sizeof *out);
  return out->magic == STOPSET_MAGIC && out->layout_version == STOPSET_LAYOUT_VERSION && out->length == STOPSET_LENGTH &&
         out->crc == stopset_crc(data, {at["crc"]}u, 0x82F63B78u) && out->check == stopset_crc(data, {at["check"]}u, 0xEDB88320u) &&
         out->end_crc == stopset_crc(data, {at["end_crc"]}u, 0x82F63B78u) &&
         out->end_check == stopset_crc(data, {at["end_check"]}u, 0xEDB88320u);
}}
#endif
"""


def structured_text() -> str:
    """``stopset_state.st``: the same as an IEC 61131-3 structure with constants (SCL and CODESYS read it)."""
    at = offsets()
    rows = "\n".join(
        f"    {f.name} : {f'ARRAY[1..{f.count}] OF ' if f.count > 1 else ''}{_ST[f.kind]}; "
        f"(* @{at[f.name]} {f'[{f.unit}] ' if f.unit else ''}{f.means} *)"
        for f in FIELDS
    )
    states = "\n".join(f"    STOPSET_STATE_{s.name} : USINT := 16#{s.value:02X};" for s in State)
    flags = "\n".join(f"    STOPSET_FLAG_{f.name} : UDINT := {f.value};" for f in Flag)
    classes = "\n".join(f"    STOPSET_CLASS_{k.name} : UINT := {k.code};" for k in Kind)
    return f"""(* {_NOTE} Little endian; swap bytes on a big-endian PLC. *)
TYPE STOPSET_STATE :
STRUCT (* {LENGTH} bytes, layout version {LAYOUT_VERSION} *)
{rows}
END_STRUCT
END_TYPE

VAR_GLOBAL CONSTANT
    STOPSET_MAGIC : UDINT := 16#{MAGIC:08X};
    STOPSET_LENGTH : UINT := {LENGTH};
{states}
{flags}
{classes}
END_VAR
"""


FILES = {"stopset_state.h": c_header, "stopset_state.st": structured_text}

if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "deploy/plc")
    for name, text in FILES.items():
        (folder / name).write_text(text(), encoding="utf-8")
