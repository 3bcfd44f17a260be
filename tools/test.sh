#!/usr/bin/env bash
# Run the tests side by side, on every core; the report goes to out/tests.
# Usage: tools/test.sh VENV [OPTIONS AND TESTS OF PYTEST]
set -euo pipefail
venv=$1
shift

# One thread a process: there are as many processes as cores. A file's tests share what they make.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
exec "$venv/bin/python" -m pytest -n logical --dist loadfile --no-loadscope-reorder \
    --junitxml out/tests/tests.xml "$@"
