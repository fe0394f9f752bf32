#!/usr/bin/env bash
# Build the image, start it alone with a certificate and tokens of its own, and plan with a client in Node.js. Needs Docker,
# npm, and scopt for the tokens.
set -euo pipefail
cd "$(dirname "$0")"
secrets=$(mktemp -d)
name=scopt-smoke-$$
trap 'docker rm -f "$name" >/dev/null 2>&1 || true; rm -rf "$secrets"' EXIT
../make_secrets.sh localhost "$secrets"
chmod 755 "$secrets" && chmod 644 "$secrets/server.pem" && chmod 640 "$secrets"/{server.key,tokens.yaml}
docker build -q -t scopt ../..
# The group of the files may read them.
docker run -d --name "$name" --read-only --tmpfs /tmp --tmpfs /run/scopt:uid=10001 --tmpfs /var/lib/scopt:uid=10001 --shm-size 1g \
    --cap-drop ALL --security-opt no-new-privileges --group-add "$(id -g)" -p 127.0.0.1:50051:50051 \
    -v "$PWD/../server.toml:/etc/scopt/server.toml:ro" -v "$secrets:/etc/scopt/secrets:ro" scopt
for _ in $(seq 60); do
    [[ $(docker inspect -f '{{.State.Health.Status}}' "$name") == healthy ]] && break
    sleep 2
done
docker exec "$name" scopt health --target unix:/run/scopt/probe.sock
npm install --silent --no-fund --no-audit
node client.mjs localhost:50051 "$secrets/server.pem" "$secrets/plan.token"
docker stop -t 45 "$name" >/dev/null
echo "the container planned and stopped with $(docker inspect -f '{{.State.ExitCode}}' "$name")"
