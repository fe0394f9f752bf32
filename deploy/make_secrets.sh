#!/usr/bin/env bash
# Make a certificate for a name, and a token for one client per role: deploy/make_secrets.sh [NAME] [FOLDER]. For a trial;
# a lasting server has a certificate of the own authority.
set -euo pipefail
name=${1:-localhost}
folder=${2:-$(dirname "$0")/secrets}
umask 077
mkdir -p "$folder"
openssl req -x509 -newkey rsa:2048 -nodes -days 30 -subj "/CN=$name" -addext "subjectAltName=DNS:$name" \
    -keyout "$folder/server.key" -out "$folder/server.pem" 2>/dev/null
: >"$folder/tokens.yaml"
for role in plan review execute command admin; do
    scopt token "trial-$role" --role "$role" 2>>"$folder/tokens.yaml" >"$folder/$role.token"
done
echo "$folder: server.pem (also the authority for clients), server.key, tokens.yaml, plan.token and so on, one per role"
