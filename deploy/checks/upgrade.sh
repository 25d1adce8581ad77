#!/bin/sh
# A new version takes the old one's place, and gives it back if the health check is not green: upgrade.sh /opt/stopset-VERSION
# The link /opt/stopset is moved, the unit restarted, the message of the daemon looked at for a minute; the old folder stays where it is.
set -eu
[ $# -eq 1 ] || { echo "usage: upgrade.sh FOLDER-OF-THE-NEW-VERSION" >&2; exit 2; }
link=${STOPSET_LINK:-/opt/stopset} config=${STOPSET_CONFIG:-/etc/stopset/arm.toml} ctl=${SYSTEMCTL:-systemctl} patience=${PATIENCE:-60}
new=$(realpath "$1")
[ -x "$new/bin/stopset" ] || { echo "upgrade.sh: $new/bin/stopset is no program; expected an installed version: install it there first" >&2; exit 2; }
old=$(realpath "$link" 2>/dev/null) || { echo "upgrade.sh: $link leads nowhere; expected the version that runs now: make the link first" >&2; exit 2; }
[ "$old" != "$new" ] || { echo "upgrade.sh: $new is what runs already; expected another version: name that" >&2; exit 2; }
place() { ln -s "$1" "$link.new" && mv -T "$link.new" "$link" && "$ctl" restart stopset.service; }
healthy() {
  for _ in $(seq "$patience"); do
    if "$link/bin/stopset" watch --config "$config" --check --seconds 1; then return 0; fi
    sleep "${PAUSE:-1}"
  done
  return 1
}
place "$new"
if healthy; then echo "upgraded: $old -> $new; back with: upgrade.sh $old"; exit 0; fi
place "$old"
if healthy; then echo "upgrade.sh: $new gave no good message; $old is back" >&2; exit 1; fi
echo "upgrade.sh: $new gave no good message, and $old gives none either; look with: journalctl -u stopset" >&2
exit 1
