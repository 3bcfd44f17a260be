#!/usr/bin/env bash
# Run the tests in two phases: side by side on every core what may, then one by one what needs the
# machine for itself (browsers, loops in real time). Both are always run; it fails if either does.
# Reports go to out/tests/PHASE.xml.
# Usage: tools/test.sh VENV [OPTIONS AND TESTS OF PYTEST]
set -uo pipefail
python=$1/bin/python
shift
trap 'exit 130' INT

readonly NOTHING=5 # pytest's status when nothing was selected
status=$NOTHING
phase() { # NAME OPTIONS: the worse status is kept; nothing selected is no failure of one phase
    local name=$1 ended
    shift
    echo "== tests: $name"
    "$python" -m pytest -p tests.phases --phase "$name" --junitxml "out/tests/$name.xml" "$@"
    ended=$?
    if [ "$ended" -ne "$NOTHING" ] && { [ "$status" -eq "$NOTHING" ] || [ "$ended" -ne 0 ]; }; then
        status=$ended
    fi
}

# One thread a process: there are as many processes as cores. A file's tests share what they make.
OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
    phase together -n logical --dist loadfile --no-loadscope-reorder "$@"
phase alone "$@"
exit "$status"
