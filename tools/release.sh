#!/bin/sh
# Builds the sdist and the wheel into dist, and checks them: tools/release.sh [PYTHON]
set -eu
cd "$(dirname "$0")/.."
python=${1:-python3}
tools=$(mktemp -d)
trap 'rm -rf "$tools"' EXIT
"$python" -m venv "$tools"
"$tools/bin/pip" install --quiet build twine
rm -rf dist
"$tools/bin/python" -m build --outdir dist
"$tools/bin/twine" check --strict dist/*
