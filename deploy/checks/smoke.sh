#!/bin/sh
# After every change: a recording is replayed on loopback, the monitor judges it, a consumer reads it, silence is noticed.
# usage: smoke.sh MODEL.model.json RECORDING.parquet [PROFILE]: over a CAN bus of this profile, without one as joint_states
set -eu
[ $# -eq 2 ] || [ $# -eq 3 ] || { echo "usage: smoke.sh MODEL RECORDING [PROFILE]" >&2; exit 2; }
work=$(mktemp -d)
trap 'kill $monitor 2>/dev/null || true; rm -rf "$work"' EXIT
if [ $# -eq 3 ]; then
  profile=$3
  [ ! -e "$profile" ] || profile=$(realpath "$profile")
  source="[bus]
link = \"hub:28799\"
profile = \"$profile\""
  set -- "$1" "$2" --to hub:28799 --profile "$profile" --wait 1
else
  # a message per step of the model
  source="[joint_states]
key = \"joint_states\"
cycle_s = $(grep -o '"dt": *[0-9.e-]*' "$1" | head -n 1 | cut -d: -f2)"
  set -- "$1" "$2" --to zenoh:tcp/127.0.0.1:28798 --key joint_states
fi
cat > "$work/arm.toml" <<END
model = "$(realpath "$1")"
data_id = 1001
$source
[zenoh]
listen = ["tcp/127.0.0.1:28798"]
[publish]
valid_for_ms = 1000
END
stopset monitor --config "$work/arm.toml" > "$work/monitor" & monitor=$!
sleep 3
stopset watch --config "$work/arm.toml" --port 0 --seconds 12 > "$work/watch" & watch=$!
recording=$2
shift 2
stopset replay "$recording" "$@" --trials 2 | tee "$work/replay"
wait $watch
! grep -q "the other nodes sent" "$work/replay" || grep -q "the other nodes sent 0 frames" "$work/replay" || { echo "FAILED: the monitor sent on the bus"; exit 1; }
grep -Eq "^(OK|DEGRADED)" "$work/watch" || { echo "FAILED: no conformant state seen"; cat "$work/watch"; exit 1; }
if grep -q "^VIOLATION" "$work/watch"; then echo "FAILED: violation"; exit 1; fi
kill -STOP $monitor
stopset watch --config "$work/arm.toml" --port 0 --seconds 2 > "$work/frozen" 2>&1 || true
if stopset watch --config "$work/arm.toml" --check; then echo "FAILED: the health check of a frozen monitor is green"; exit 1; fi
kill -CONT $monitor
if grep -Eq "^(OK|DEGRADED)" "$work/frozen"; then echo "FAILED: a frozen monitor looked alive"; exit 1; fi
echo "passed"
