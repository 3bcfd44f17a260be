#!/usr/bin/env bash
# Make a virtual environment, unless it is there, and install this project in it: by uv where there
# is one, else by pip.
# Usage: [PYTHON=python] tools/venv.sh FOLDER [EXTRA], such as all or dev
set -euo pipefail
folder=$1
extra=${2:-}

# CPython of 64 bits with its lock, as the libraries' wheels want it; without uv, with venv and pip.
supported() {
    "$1" - "$(command -v uv || true)" 2>/dev/null <<'PY'
import sys, sysconfig
uv = sys.argv[1]
if not uv:
    import ensurepip, venv
good = (3, 10) <= sys.version_info[:2] <= (3, 14) and sys.implementation.name == "cpython"
sys.exit(not (good and sys.maxsize > 2**32 and not sysconfig.get_config_var("Py_GIL_DISABLED")))
PY
}

found() {
    if [ -n "${PYTHON:-}" ]; then
        if supported "$PYTHON"; then echo "$PYTHON"; return; fi
        echo "PYTHON=$PYTHON is no CPython 3.10 to 3.14 with venv." >&2
        return 2
    fi
    # The newest first, but 3.14 last: pybullet, the default plant, has no wheels for it.
    for candidate in python3.13 python3.12 python3.11 python3.10 python3.14 python3 python; do
        if supported "$candidate"; then echo "$candidate"; return; fi
    done
    return 1
}

if [ ! -x "$folder/bin/python" ]; then
    status=0
    python=$(found) || status=$?
    if [ "$status" -eq 2 ]; then exit 1; fi
    if command -v uv >/dev/null && uv venv --quiet --seed --python "${python:-3.13}" "$folder"; then
        :
    elif [ -n "$python" ]; then
        "$python" -m venv "$folder"
        # pip 23.0, which Python 3.10 brings, tries versions for ten minutes where a new one takes seconds.
        "$folder/bin/python" -m pip install --quiet --upgrade pip
    else
        echo "No CPython 3.10 to 3.14 with venv found: install uv (https://docs.astral.sh/uv) or Debian's python3-venv, or name one: make PYTHON=/path/to/python3 ..." >&2
        exit 1
    fi
fi
if [ -z "$extra" ]; then exit 0; fi
if command -v uv >/dev/null; then
    install=(uv pip install --quiet --python "$folder/bin/python")
else
    install=("$folder/bin/python" -m pip install --quiet --disable-pip-version-check)
fi
# The versions that were tested, each with its hash (tools/lock.sh); what has none is searched for.
if [ -f "requirements/$extra.txt" ]; then
    "${install[@]}" --require-hashes -r "requirements/$extra.txt"
    "${install[@]}" --no-deps -e .
else
    "${install[@]}" -e ".[$extra]"
fi
