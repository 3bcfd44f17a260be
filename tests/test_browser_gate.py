"""Access control in a real browser: the page works, and foreign pages are refused."""

from __future__ import annotations

import http.server
import threading
from contextlib import contextmanager

import pytest

from app.dashboard.viser_compat import close_server, open_server
from tests.browser import wait_for

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@contextmanager
def viser_page():
    server = open_server("127.0.0.1", 0)
    try:
        yield server, f"http://127.0.0.1:{server.get_port()}"
    finally:
        close_server(server)


@contextmanager
def foreign_page(html: str):
    """A page on another port, which is another origin."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(html.encode())

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


@pytest.fixture
def page(browser):
    tab = browser.new_page()
    tab.problems = []
    tab.on("pageerror", lambda error: tab.problems.append(str(error)))
    yield tab
    tab.close()


def test_page_works_under_its_content_security_policy(page):
    with viser_page() as (server, address):
        server.gui.add_markdown("**markdown** is compiled in the page")
        server.scene.add_box("/box")
        page.goto(address)
        wait_for(server.get_clients, what="a client")
        page.get_by_text("is compiled in the page").wait_for()
        assert page.problems == []


def test_link_that_names_another_server_is_refused(page):
    with viser_page() as (server, address):
        answer = page.goto(f"{address}/?websocket=ws://127.0.0.1:1")
        assert answer.status == 400
        assert server.get_clients() == {}


def test_page_behind_a_proxy_names_the_missing_option(page, monkeypatch):
    """The page's timer of 300 ms runs at ten times its rate; it counts to 30."""
    page.add_init_script(
        "{ const real = setInterval; setInterval = (f, ms) => real(f, ms === 300 ? 30 : ms); }"
    )
    with viser_page() as (server, address), monkeypatch.context() as proxy:
        proxy.setattr("app.dashboard.gate.is_allowed", lambda origin, *_: origin is None)
        page.goto(address)
        page.get_by_role("alert").get_by_text("--allow-host 127.0.0.1").wait_for()
        proxy.undo()
        wait_for(server.get_clients, what="a client")
        page.get_by_role("alert").wait_for(state="detached")


def test_foreign_page_can_neither_embed_the_page_nor_connect_to_its_server(page):
    with viser_page() as (server, address):
        script = f"""<iframe src="{address}"></iframe><script>
            const socket = new WebSocket("{address.replace("http", "ws")}", "viser-v1.1.1");
            socket.onopen = () => document.title = "open";
            socket.onerror = () => document.title = "refused";
            </script>"""
        with foreign_page(script) as foreign:
            page.goto(foreign)
            page.wait_for_function("() => document.title")
            assert page.title() == "refused"
            page.wait_for_timeout(500)
            assert server.get_clients() == {}


def test_policy_prevents_the_page_from_connecting_elsewhere(page):
    """Without the policy, viser's own code could connect the page to another server."""
    with viser_page() as (server, address), foreign_page("") as foreign:
        page.goto(address)
        wait_for(server.get_clients, what="a client")
        outcome = page.evaluate(
            """url => new Promise(done => {
                document.addEventListener(
                    "securitypolicyviolation", e => done(e.violatedDirective));
                try { new WebSocket(url) } catch (e) { done("connect-src") }
            })""",
            foreign.replace("http", "ws"),
        )
        assert outcome.startswith("connect-src")
