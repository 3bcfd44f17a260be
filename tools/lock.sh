#!/usr/bin/env bash
# Resolve all dependencies, for every supported Python and system, with hashes, into requirements/.
# Usage: tools/lock.sh [OPTIONS OF UV, such as --upgrade]; needs uv (https://docs.astral.sh/uv)
set -euo pipefail
cd "$(dirname "$0")/.."
for extra in dev all; do
    # `make run` installs the versions with which `make test` runs.
    constraint=()
    if [ "$extra" != dev ]; then constraint=(--constraint requirements/dev.txt); fi
    uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-annotate \
        --custom-compile-command tools/lock.sh --extra "$extra" "${constraint[@]}" "$@" \
        --output-file "requirements/$extra.txt" pyproject.toml
done
