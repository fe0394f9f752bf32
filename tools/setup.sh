#!/usr/bin/env bash
# Brings what pip cannot (system packages), then makes the virtual environment named by the first argument; the second
# one names the extras to install.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=${1:-.venv}
extras=${2:-dev}
unset PYTHONPATH PYTHONHOME PYTHONSTARTUP VIRTUAL_ENV PIP_USER PIP_TARGET PIP_PREFIX

have_uv() { command -v uv >/dev/null 2>&1; }

# The first Python of a supported version that can make a virtual environment; nothing if there is none. That of the
# distribution comes first: it is built with profiles, and one that was compiled without takes a quarter longer for all.
find_python() {
    local modules="venv, ensurepip" candidate
    if have_uv; then modules="sys"; fi
    for candidate in /usr/bin/python3.1{1,2,3} /usr/bin/python3 $(type -ap python3.11 python3.12 python3.13 python3); do
        if "$candidate" -c "import sys, $modules; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))" 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
}

has_library() {
    local cache
    cache=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null || true)
    [[ $cache == *"$1"* ]]
}

missing_packages() {
    if [[ -z $(find_python) ]] && ! have_uv; then echo python3 python3-venv; fi
    if ! has_library libgomp.so.1; then echo libgomp1; fi
    if ! has_library libEGL.so.1; then echo libegl1; fi
    if ! has_library libusb-1.0.so.0; then echo libusb-1.0-0; fi
    if ! has_library libGL.so.1; then echo libgl1; fi
}

install_system_packages() {
    local -a missing
    read -ra missing <<<"$(missing_packages | tr '\n' ' ')"
    if ((${#missing[@]} == 0)); then return; fi
    if ((EUID != 0)) || ! command -v apt-get >/dev/null 2>&1; then
        echo "setup: system packages are missing; install them and run make again: sudo apt-get install -y ${missing[*]}" >&2
        exit 1
    fi
    echo "setup: installing system packages: ${missing[*]}"
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq
    apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}

install_environment() {
    local python
    python=$(find_python)
    if [[ -z $python ]] && ! have_uv; then
        echo "setup: no Python 3.11, 3.12 or 3.13 with venv found; install one (Debian 12, Ubuntu 24.04: sudo apt-get install -y python3 python3-venv)" >&2
        exit 1
    fi
    rm -rf "$venv"
    if have_uv; then
        echo "setup: $(uv --version), ${python:-a Python of its own}"
        uv venv --quiet --python "${python:-3.12}" "$venv"
        uv pip install -qq --python "$venv/bin/python" --constraints constraints.txt --editable ".[$extras]"
    else
        echo "setup: venv and pip of $python (a few minutes; uv, if installed, is faster)"
        "$python" -m venv "$venv"
        # Compiling all 13,000 modules takes 20 s; Python compiles the tenth that is used when it is first imported.
        "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-compile --constraint constraints.txt \
            --editable ".[$extras]"
    fi
}

started=$SECONDS
install_system_packages
install_environment
echo "setup: ready after $((SECONDS - started)) s"
