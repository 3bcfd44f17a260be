#!/usr/bin/env bash
# Run the tests, without slow and browser tests, with each CPython 3.10 to 3.14 of pyenv, uv or the
# system, in new environments, one after the other; print a table. Logs go to out/pythons.
# Usage: tools/test_pythons.sh [PYTHON ...]; default: one interpreter of each version
set -uo pipefail
cd "$(dirname "$0")/.."
trap 'exit 130' INT
mkdir -p out/pythons

candidates() {
    for minor in 10 11 12 13 14; do
        ls -d "${PYENV_ROOT:-$HOME/.pyenv}/versions/3.$minor."*/bin/python 2>/dev/null | tail -n 1
        if command -v uv >/dev/null; then uv python find --no-python-downloads "3.$minor" 2>/dev/null; fi
        command -v "python3.$minor"
    done
}
version() { # PYTHON: prints, for example, 3.12 3.12.1; nothing if the interpreter cannot run
    "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2], ".".join(map(str, sys.version_info[:3])))' \
        2>/dev/null
}

chosen() { # the named interpreters; otherwise one of each version
    if [ "$#" -gt 0 ]; then printf '%s\n' "$@"; return; fi
    seen=" "
    candidates | while read -r python; do
        minor=$(version "$python" | cut -d ' ' -f 1)
        case "$seen" in *" $minor "*) continue ;; esac
        seen="$seen$minor "
        if [ -n "$minor" ]; then echo "$python"; fi
    done
}

rows=()
status=0
while read -r python <&3; do
    full=$(version "$python" | cut -d ' ' -f 2)
    venv=out/pythons/$full
    log=$venv.log
    rm -rf "$venv"
    echo "== $full: $python"
    began=$SECONDS
    if PYTHON=$python tools/venv.sh "$venv" dev >"$log" 2>&1; then
        installed=$((SECONDS - began))
        began=$SECONDS
        OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 "$venv/bin/python" -m pytest -q \
            -m 'not slow and not browser' -n logical --dist loadfile --color no >>"$log" 2>&1 || status=1
        result=$(grep -E '^=* ?[0-9]+ (passed|failed|error|skipped)' "$log" | tail -n 1 | tr -d '=' | sed 's/ in [0-9].*//; s/^ *//')
    else
        status=1 installed=$((SECONDS - began)) began=$SECONDS
        result="not installed: $(tail -n 1 "$log")"
    fi
    engines=$("$venv/bin/python" -c '
from importlib.metadata import distributions
names = ("pybullet", "pybullet-arm64", "mujoco", "mujoco-core")
print(", ".join(f"{d.name} {d.version}" for d in distributions() if d.name in names))' 2>/dev/null)
    rows+=("| $full | $engines | $installed s | $result | $((SECONDS - began)) s |")
    rm -rf "$venv"
done 3< <(chosen "$@")
echo
echo "| CPython | engines | installation | tests | duration |"
echo "|---|---|---|---|---|"
if [ "${#rows[@]}" -eq 0 ]; then
    echo "No CPython 3.10 to 3.14 was found." >&2
    exit 1
fi
printf '%s\n' "${rows[@]}"
exit "$status"
