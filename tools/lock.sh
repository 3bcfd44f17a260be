#!/usr/bin/env bash
# Resolve all dependencies for every Python and system of the promise, with hashes: requirements/.
# Usage: tools/lock.sh [OPTIONS OF UV, such as --upgrade]; needs uv (https://docs.astral.sh/uv)
set -euo pipefail
cd "$(dirname "$0")/.."
for extra in dev all; do
    # What `make test` was run with is what `make run` installs.
    constraint=()
    if [ "$extra" != dev ]; then constraint=(--constraint requirements/dev.txt); fi
    uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-annotate \
        --custom-compile-command tools/lock.sh --extra "$extra" "${constraint[@]}" "$@" \
        --output-file "requirements/$extra.txt" pyproject.toml
done
