#!/usr/bin/env bash
# Find or install a Chromium for the tests: the system's, otherwise playwright's, otherwise Debian's package.
# Usage: tools/browser.sh VENV
set -uo pipefail
venv=$1
found() {
    "$venv/bin/python" - 2>/dev/null <<'PY'
from app.dashboard.export.browser import browser_path
from playwright.sync_api import sync_playwright

with sync_playwright() as playwright:
    own = playwright.chromium.executable_path
print(browser_path(own) or own)
PY
}

if where=$(found); then
    echo "browser: $where"
    exit 0
fi
echo "browser: none found; trying playwright's own"
if timeout 300 "$venv/bin/playwright" install chromium >/dev/null 2>&1 && where=$(found); then
    echo "browser: $where"
    exit 0
fi
echo "browser: playwright could not download one; trying Debian's package"
as_root=""
[ "$(id -u)" = 0 ] || as_root="sudo -n"
if command -v apt-get >/dev/null; then
    $as_root apt-get update -qq && DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq chromium >/dev/null
fi
if where=$(found); then
    echo "browser: $where"
    exit 0
fi
echo "No Chromium could be provided. Install one (Debian: apt-get install chromium) or set DBB_BROWSER." >&2
exit 1
