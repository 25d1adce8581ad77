#!/bin/sh
# Which certificates of a folder end soon: expiry.sh FOLDER [DAYS]   (default 30). Ends with 1 if one does, with 2 if none is there.
set -eu
[ $# -ge 1 ] || { echo "usage: expiry.sh FOLDER [DAYS]" >&2; exit 2; }
days=${2:-30} found=0 soon=0
for pem in "$1"/*.pem; do
  [ -f "$pem" ] || continue
  found=1
  end=$(openssl x509 -in "$pem" -noout -enddate) || { echo "$pem: no certificate; expected PEM: make it anew"; soon=1; continue; }
  if ! openssl x509 -in "$pem" -noout -checkend $((days * 86400)) >/dev/null; then
    echo "$pem ends within $days days (${end#notAfter=}); expected longer: renew-certs.sh, then restart who uses it"
    soon=1
  fi
done
[ $found = 1 ] || { echo "$1 holds no certificate; expected *.pem: name the folder" >&2; exit 2; }
exit $soon
