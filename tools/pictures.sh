#!/usr/bin/env bash
# Draw pictures of README and documentation into docs/pictures; copy PNG files to out/pictures.
# Usage: tools/pictures.sh VENV
set -euo pipefail
dbb=$1/bin/dbb
docs=docs/pictures
mkdir -p "$docs" out/pictures
shoot() {
    "$dbb" screenshot "$@"
}
shoot guiding-front --at 3.5 --width 900 --height 600 --out "$docs/front.png"
shoot guiding-lateral --at 0 4 8 --width 520 --height 400 --light --out "$docs/lateral.png"
shoot guiding-lateral --at 3.8 --width 1280 --height 720 --page --out "$docs/page.png"
# Two robots side by side: a pull without and with avoidance; the wheel axis, where a distance constraint stops.
pair() {
    "$dbb" film "$@" --side-by-side --layer none --rate 10 --width 480 --height 360
}
pair guiding-lateral --move 0 -0.375 0 --beside none --out "$docs/pull.webp"
pair tracking --start 0 0.72 0.3 --move 0 -0.3 0 --beside barrier --speed 4 --out "$docs/axis.webp"
cp "$docs"/*.png out/pictures/
