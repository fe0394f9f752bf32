#!/usr/bin/env bash
# Types, style and tests of the viewer's page. Without npm they are left out with a word about it, unless CI needs them.
set -euo pipefail
cd "$(dirname "$0")/../service/viewer/page"
if ! command -v npm >/dev/null 2>&1; then
    echo "check: no npm; types, style and tests of service/viewer/page are NOT checked (install Node 20 or later)" >&2
    exit "${SCOPT_NEEDS_NPM:-0}"
fi
# What npm has installed is older than what it should install.
if [[ ! node_modules/.package-lock.json -nt package.json ]]; then
    npm install --no-audit --no-fund --loglevel=error
    touch node_modules/.package-lock.json
fi
npm run --silent check
