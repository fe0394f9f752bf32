#!/usr/bin/env bash
# As run.sh where there is no Docker daemon: buildah builds the image, runc starts it in a network of its own. Needs root,
# buildah, runc, npm, python3, and scopt for the tokens; the base image of the Dockerfile has to be there or be pulled.
set -euo pipefail
cd "$(dirname "$0")"
export BUILDAH_ISOLATION=chroot
bundle=$(mktemp -d)
name=scopt-smoke-$$
container=""
finish() {
    runc delete --force "$name" >/dev/null 2>&1 || true
    [[ -z $container ]] || buildah rm "$container" >/dev/null
    rm -rf "$bundle"
}
trap finish EXIT
mkdir "$bundle/secrets"
../make_secrets.sh localhost "$bundle/secrets"
chmod 755 "$bundle" "$bundle/secrets" && chmod 644 "$bundle/secrets/server.pem" && chmod 640 "$bundle/secrets"/{server.key,tokens.yaml}
buildah bud --quiet --format docker --layers=false ${BUILD_OPTIONS:-} -t scopt ../.. >/dev/null
container=$(buildah from --pull-never localhost/scopt)
root=$(buildah mount "$container")
runc spec --bundle "$bundle"
buildah inspect --type image localhost/scopt >"$bundle/image.json"
python3 configure.py "$bundle" "$root" "$PWD/../server.toml" "$(id -g)"
runc run --bundle "$bundle" "$name" >"$bundle/log" 2>&1 &
server=$!
for _ in $(seq 60); do
    runc exec "$name" scopt health --target unix:/run/scopt/probe.sock >/dev/null 2>&1 && break
    kill -0 "$server" || { cat "$bundle/log"; exit 1; }
    sleep 2
done
runc exec "$name" scopt health --target unix:/run/scopt/probe.sock
npm install --silent --no-fund --no-audit
pid=$(runc state "$name" | python3 -c 'import json, sys; print(json.load(sys.stdin)["pid"])')
nsenter --target "$pid" --net node client.mjs localhost:50051 "$bundle/secrets/server.pem" "$bundle/secrets/plan.token"
runc kill "$name" TERM
wait "$server" && code=0 || code=$?
echo "the container planned and stopped with $code"
exit "$code"
