#!/usr/bin/env bash
# Make a virtual environment with a Python that has pybullet wheels: 3.11 or 3.10.
# Usage: tools/venv.sh FOLDER
set -euo pipefail
folder=$1

if [ -x "$folder/bin/python" ]; then
    exit 0
fi
for candidate in "${PYTHON:-}" python3.11 python3.10 python3 python; do
    if [ -n "$candidate" ] && "$candidate" -c \
        'import ensurepip, sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 11))' 2>/dev/null
    then
        exec "$candidate" -m venv "$folder"
    fi
done
if command -v uv >/dev/null; then
    exec uv venv --seed --python 3.11 "$folder"
fi
echo "No Python 3.10 or 3.11 with venv found. Install one (Debian: apt-get install python3-venv)," >&2
echo "or uv (https://docs.astral.sh/uv), or name one: make PYTHON=/path/to/python3.11 ..." >&2
exit 1
