#!/usr/bin/env bash
# Run the tests in parallel on all cores; the report goes to out/tests.
# Usage: tools/test.sh VENV [OPTIONS AND TESTS OF PYTEST]
set -euo pipefail
venv=$1
shift

# Many tests start Python again, which is 15 % slower without stored bytecode.
export PYTHONDONTWRITEBYTECODE=
# One process more than cores, because tests of the page wait during a quarter of their time; one
# thread in each. The tests of a file run in one process, because they share fixtures.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
processes=$("$venv/bin/python" -c 'from app.system import usable_cores; print(usable_cores() + 1)')
exec "$venv/bin/python" -m pytest -n "$processes" --dist loadfile --no-loadscope-reorder \
    --junitxml out/tests/tests.xml "$@"
