#!/bin/sh
# A new version takes the old one's place, and gives it back if the health check is not green:
#   upgrade.sh /opt/stopset-VERSION [MODEL]
# The link /opt/stopset is moved, the unit restarted, the message of the daemon looked at for a minute; the old folder stays where it is.
# MODEL (and MODEL.sig beside it), for a version that reads another schema, takes the place of the configured model, which stays beside it
# as FILE.before and comes back with the old version. The arm must be on: a daemon that does not hear it is not healthy.
set -eu
[ $# -ge 1 ] && [ $# -le 2 ] || { echo "usage: upgrade.sh FOLDER-OF-THE-NEW-VERSION [MODEL]" >&2; exit 2; }
link=${STOPSET_LINK:-/opt/stopset} config=${STOPSET_CONFIG:-/etc/stopset/arm.toml} ctl=${SYSTEMCTL:-systemctl} patience=${PATIENCE:-60}
new=$(realpath "$1") given=${2:-}
[ -x "$new/bin/stopset" ] || { echo "upgrade.sh: $new/bin/stopset is no program; expected an installed version: install it there first" >&2; exit 2; }
old=$(realpath "$link" 2>/dev/null) || { echo "upgrade.sh: $link leads nowhere; expected the version that runs now: make the link first" >&2; exit 2; }
[ "$old" != "$new" ] || { echo "upgrade.sh: $new is what runs already; expected another version: name that" >&2; exit 2; }
if [ -n "$given" ]; then
  [ -f "$given" ] || { echo "upgrade.sh: $given is no file; expected a model of the new version" >&2; exit 2; }
  model=$(sed -n 's/^model *= *"\([^"]*\)".*/\1/p' "$config" | head -n 1)
  case $model in /*) ;; *) model=$(dirname "$config")/$model ;; esac
  [ -f "$model" ] || { echo "upgrade.sh: $model is no file; expected the model that $config names" >&2; exit 2; }
fi
# put FROM TO: a model and its signature under another name, never half a file; what has no signature leaves none
put() {
  for end in .sig ""; do
    if [ -f "$1$end" ]; then
      cp "$1$end" "$2$end.new"
      chown --reference="$model" "$2$end.new"
      chmod --reference="$model" "$2$end.new"
      mv "$2$end.new" "$2$end"
    else
      rm -f "$2$end"
    fi
  done
}
place() { ln -s "$1" "$link.new" && mv -T "$link.new" "$link" && "$ctl" restart stopset.service; }
healthy() {
  for _ in $(seq "$patience"); do
    if "$link/bin/stopset" watch --config "$config" --check --seconds 1; then return 0; fi
    sleep "${PAUSE:-1}"
  done
  return 1
}
if [ -n "$given" ]; then # which may be FILE.before itself
  put "$given" "$model.coming"
  put "$model" "$model.before"
  put "$model.coming" "$model"
  rm -f "$model.coming" "$model.coming.sig"
fi
place "$new"
if healthy; then echo "upgraded: $old -> $new; back with: upgrade.sh $old${given:+ $model.before}"; exit 0; fi
if [ -n "$given" ]; then put "$model.before" "$model"; fi
place "$old"
if healthy; then echo "upgrade.sh: $new gave no good message; $old is back${given:+, with its model}" >&2; exit 1; fi
echo "upgrade.sh: $new gave no good message, and $old gives none either; look with: journalctl -u stopset" >&2
exit 1
