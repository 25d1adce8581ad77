#!/bin/sh
# New certificates by the same authority, under the same names: renew-certs.sh FOLDER ROUTER-HOST [NAME...]
# The old ones stay as NAME.pem.old and NAME.key.old: put them back if a peer does not come up. The authority itself is not renewed.
set -eu
[ $# -ge 2 ] || { echo "usage: renew-certs.sh FOLDER ROUTER-HOST [NAME...]" >&2; exit 2; }
here=$(dirname "$(realpath "$0")") folder=$1
[ -f "$folder/ca.key" ] || { echo "$folder/ca.key is missing; expected the cell's own authority: bring it, others would not trust a new one" >&2; exit 2; }
host=$2
shift 2
for name in router "$@"; do
  for end in pem key; do
    if [ -f "$folder/$name.$end" ]; then mv "$folder/$name.$end" "$folder/$name.$end.old"; fi
  done
done
exec "$here/make-certs.sh" "$folder" "$host" "$@"
