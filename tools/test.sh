#!/usr/bin/env bash
# Run the tests in parallel on all cores; the report goes to out/tests.
# Usage: tools/test.sh VENV [OPTIONS AND TESTS OF PYTEST]
set -euo pipefail
venv=$1
shift

# One thread in each process, because there are as many processes as cores. The tests of a file run
# in one process, because they share fixtures.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
exec "$venv/bin/python" -m pytest -n logical --dist loadfile --no-loadscope-reorder \
    --junitxml out/tests/tests.xml "$@"
