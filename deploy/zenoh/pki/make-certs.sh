#!/bin/sh
# A small certificate authority for one cell: make-certs.sh FOLDER ROUTER-HOST NAME...   (names as in router.json5)
# Keep ca.key off the machines; the others get their own .pem and .key and ca.pem.
set -eu
[ $# -ge 2 ] || { echo "usage: make-certs.sh FOLDER ROUTER-HOST [NAME...]" >&2; exit 2; }
folder=$1 host=$2
shift 2
umask 077
mkdir -p "$folder"
cd "$folder"
[ -f ca.key ] || openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 -subj "/CN=stopset cell CA" \
  -keyout ca.key -out ca.pem
sign() { # name, subject alternative names
  openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "/CN=$1" -keyout "$1.key" -out "$1.csr"
  printf 'subjectAltName=%s\nextendedKeyUsage=serverAuth,clientAuth\n' "$2" > "$1.ext"
  openssl x509 -req -in "$1.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days 730 -extfile "$1.ext" -out "$1.pem"
  rm "$1.csr" "$1.ext"
}
sign router "DNS:$host,DNS:localhost,IP:127.0.0.1"
for name in "$@"; do sign "$name" "DNS:$name"; done
