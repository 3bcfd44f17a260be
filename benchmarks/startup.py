"""Start time of the dashboard: `python -m benchmarks.startup`.

It measures the time from the command, with the border in the cache, to the answer of the page and
to the first complete picture in a headless browser, which is started before the command.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request

import tyro

from tests.browser import DashboardTab, chromium


def main() -> None:
    """Measure the start time of the dashboard, and print one JSON object."""
    load = os.getloadavg()[0]
    with chromium() as browser:
        begin = time.perf_counter()
        command = [sys.executable, "-m", "app", "serve", "--port", "0"]
        server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            address = _address(server)
            urllib.request.urlopen(address, timeout=30).read()
            answered = time.perf_counter() - begin
            tab = DashboardTab(browser, address, dpr=1.0)
            drawn = time.perf_counter() - begin
            errors = tab.errors
            tab.close()
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(timeout=30)
    print(
        json.dumps(
            {
                "page_answers_s": answered,
                "first_picture_s": drawn,
                "page_errors": errors,
                "cores": os.cpu_count(),
                "load_before": load,
            },
            indent=2,
        )
    )


def _address(server: subprocess.Popen[str]) -> str:
    """Wait until the server has printed its address, and return the address."""
    assert server.stderr is not None
    for line in server.stderr:
        if found := re.search(r"http://\S+", line):
            return found.group()
    raise RuntimeError(f"dbb serve ended with status {server.wait()} without an address")


if __name__ == "__main__":
    tyro.cli(main)
