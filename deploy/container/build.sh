#!/bin/sh
# Builds the image from a base that is named by its digest: build.sh python:3.11-slim@sha256:... TAG
set -eu
[ $# -eq 2 ] || { echo "usage: build.sh BASE@sha256:DIGEST TAG" >&2; exit 2; }
digest=${1##*@sha256:}
case $1 in *@sha256:*) ;; *) digest= ;; esac
if [ "${#digest}" -ne 64 ] || [ -n "$(printf %s "$digest" | tr -d 0-9a-f)" ]; then
  echo "build.sh: $1 names no digest; expected BASE@sha256: and 64 hex digits, for a tag is another image tomorrow: look it up and name it" >&2
  exit 2
fi
cd "$(dirname "$0")/../.."
exec "${DOCKER:-docker}" build -f deploy/container/Dockerfile --build-arg "BASE=$1" -t "$2" .
