#!/usr/bin/env bash
# The pictures of README and documentation, into docs/pictures, with a copy in out/pictures.
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
"$dbb" film guiding-front --beside none --span 2.5 7.5 --rate 12 --width 640 --height 400 --out "$docs/front.webp"
cp "$docs"/*.png out/pictures/
