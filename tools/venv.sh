#!/usr/bin/env bash
# Make a virtual environment, if it does not exist, and install this project in it, by uv if it is
# installed, otherwise by pip. Without EXTRA, only the environment is made.
# Usage: [PYTHON=python] tools/venv.sh FOLDER [EXTRA], such as all or dev
set -euo pipefail
folder=$1
extra=${2:-}

# The libraries' wheels need a 64-bit CPython with its global lock; without uv also venv and pip.
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
        echo "PYTHON=$PYTHON is not a 64-bit CPython 3.10 to 3.14 with venv." >&2
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
        # pip 23.0, part of Python 3.10, needs ten minutes for a resolution that takes newer ones seconds.
        "$folder/bin/python" -m pip install --quiet --upgrade pip
    else
        echo "No CPython 3.10 to 3.14 with venv found: install uv (https://docs.astral.sh/uv) or Debian's python3-venv, or name one: make PYTHON=/path/to/python3 ..." >&2
        exit 1
    fi
fi
if [ -z "$extra" ]; then exit 0; fi
if command -v uv >/dev/null; then
    install=(uv pip install --quiet --compile-bytecode --python "$folder/bin/python")
else
    install=("$folder/bin/python" -m pip install --quiet --disable-pip-version-check)
fi
# Tested versions with hashes (tools/lock.sh); for an extra without them, pip chooses the versions.
if [ -f "requirements/$extra.txt" ]; then
    "${install[@]}" --require-hashes -r "requirements/$extra.txt"
    "${install[@]}" --no-deps -e .
else
    "${install[@]}" -e ".[$extra]"
fi
# Where Python must not write bytecode, each start of a process would compile all modules again.
"$folder/bin/python" -m compileall -q app
