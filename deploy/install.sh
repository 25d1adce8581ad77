#!/bin/sh
# Puts one version on this machine, beside those that are there: install.sh STOPSET-WHEEL   (as root; Debian 12 or like it)
# The program goes to /opt/stopset-VERSION with every package by its hash, deploy/ beside it; user, units and limits into place;
# configuration into /etc/stopset where there is none, never over one. Nothing is started, and the link /opt/stopset is made only where there is
# none: to go over to another version is upgrade.sh's.
set -eu
[ $# -eq 1 ] || { echo "usage: install.sh STOPSET-WHEEL" >&2; exit 2; }
deploy=$(dirname "$(realpath "$0")") python=${PYTHON:-python3}
version=$(basename "$1" | sed -n 's/^stopset-\([0-9][^-]*\)-.*\.whl$/\1/p')
[ -f "$1" ] && [ -n "$version" ] || { echo "install.sh: $1 is no wheel of stopset; expected stopset-VERSION-...whl: make it with .ci/release, or pip wheel --no-deps ." >&2; exit 2; }
[ "$(id -u)" = 0 ] || { echo "install.sh: this is not root; expected root, for units and a user are made: sudo $0 $1" >&2; exit 2; }
"$python" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || {
  echo "install.sh: $python is older than 3.11 or has no venv; expected both: apt-get install python3-venv, or PYTHON=..." >&2; exit 2; }
to=/opt/stopset-$version
[ ! -e "$to" ] || { echo "install.sh: $to is there already; expected a new version: remove it, or build another one" >&2; exit 2; }
trap 'rm -rf "$to"' EXIT
"$python" -m venv "$to"
"$to/bin/pip" install --quiet --disable-pip-version-check --require-hashes --only-binary :all: -r "$deploy/container/requirements.lock"
"$to/bin/pip" install --quiet --disable-pip-version-check --no-deps --no-index "$1"
"$to/bin/stopset" monitor --help > /dev/null
cp -R "$deploy" "$to/deploy"
trap - EXIT

install -D -m 644 "$deploy/systemd/stopset.sysusers.conf" /etc/sysusers.d/stopset.conf
systemd-sysusers /etc/sysusers.d/stopset.conf
for unit in "$deploy"/systemd/*.service "$deploy"/systemd/*.timer "$deploy"/systemd/*.slice; do
  install -D -m 644 "$unit" "/etc/systemd/system/$(basename "$unit")"
done
install -D -m 644 "$deploy/sysctl/80-stopset.conf" /etc/sysctl.d/80-stopset.conf
install -d -m 750 -g stopset /etc/stopset /etc/stopset/zenoh
# new FILE PLACE: a file that the cell makes its own
new() { [ -e "$2" ] || install -D -m 640 -g stopset "$1" "$2"; }
new "$deploy/stopset.toml.example" /etc/stopset/arm.toml
new "$deploy/systemd/stopset.env.example" /etc/stopset/stopset.env
for file in daemon plc router; do new "$deploy/zenoh/$file.json5" "/etc/stopset/zenoh/$file.json5"; done
[ -e /opt/stopset ] || ln -s "$to" /opt/stopset
echo "installed $to; /opt/stopset is $(realpath /opt/stopset); next: docs/how-to/deploy.md"
