# SPDX-License-Identifier: Apache-2.0
"""A browser that tests and benchmarks look at pages with: Debian's Chromium over its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import json
import shutil
import subprocess
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from urllib.request import urlopen

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
"""The first choice first: what can't open a window takes two thirds of the processor time."""
MISSING = "no chromium here: apt-get install chromium-headless-shell, or chromium"

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # One process draws all pages of a site: a new one for each takes a fifth of what opening a page takes.
    "--process-per-site",
    "--remote-allow-origins=*",
    "--remote-debugging-port=0",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
)
PATIENCE = 120.0
AXE = Path(__file__).parent / "dashboard_pages" / "vendor" / "axe.min.js.txt"
FAULTS = """axe.run({exclude: ['tbody tr:nth-child(n + 13)']}, {resultTypes: ['violations']})
    .then((found) => found.violations
    .map((one) => `${one.id}: ${one.nodes.map((node) => node.html.slice(0, 200)).join(' ')}`))"""
"""Rows of a table behind the twelfth are like those before, and take half of the time."""


def find_browser() -> str | None:
    """Return the program's path, if there is one."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


def poll(probe: Callable[[], Any], what: str) -> Any:
    """Return the value of a probe once it is true; fail after PATIENCE."""
    deadline = time.monotonic() + PATIENCE
    pause = threading.Event()
    while not (found := probe()):
        if time.monotonic() > deadline:
            pytest.fail(f"waited {PATIENCE:.0f} s for {what}")
        pause.wait(0.05)
    return found


class Browser:
    """One page of a headless Chromium; what it complains of is kept in ``complaints``."""

    def __init__(self, program: str, profile: Path) -> None:
        command = [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._number = 0
        self.complaints: list[str] = []
        port_file = profile / "DevToolsActivePort"
        port = poll(lambda: port_file.exists() and port_file.read_text().split("\n")[0], "Chromium")
        self._socket = self._open(port)
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    @staticmethod
    def _open(port: str) -> Any:
        from websocket import create_connection

        def page() -> str | None:
            with contextlib.suppress(OSError), urlopen(f"http://127.0.0.1:{port}/json", timeout=5) as answer:
                return next(
                    (one["webSocketDebuggerUrl"] for one in json.load(answer) if one["type"] == "page"), None
                )
            return None

        return create_connection(poll(page, "a page"), timeout=PATIENCE, suppress_origin=True)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv())
            if message.get("id") == self._number:
                assert "error" not in message, message["error"]
                return dict(message["result"])
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", details["text"]))
        elif message.get("method") == "Runtime.consoleAPICalled" and params["type"] in {"error", "warning"}:
            self.complaints.append(" ".join(str(one.get("value", "")) for one in params["args"]))
        elif message.get("method") == "Log.entryAdded" and params["entry"]["level"] in {"error", "warning"}:
            self.complaints.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")

    def run(self, script: str) -> Any:
        """Return the value of an expression in the page; promises are awaited."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, script: str) -> Any:
        """Return the value of an expression once it is true."""
        return poll(lambda: self.run(script), script)

    def look(self, *, width: int = 1280, dark: bool = False) -> None:
        """Give the window a width, and the reader a taste."""
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def open(self, address: str, *, width: int = 1280, dark: bool = False) -> None:
        """Open an address in a window of a width, and wait until the page has its heading."""
        self.look(width=width, dark=dark)
        if address.partition("#")[0] != str(self.run("location.href")).partition("#")[0]:
            # Of a page that is left, whose server may be gone, nothing is heard any more.
            self.call("Page.navigate", url="about:blank")
            self.run("0")
        self.complaints.clear()
        self.call("Page.navigate", url=address)
        self.wait(f"location.href === {json.dumps(address)} && document.readyState === 'complete'")
        ready = "!!document.querySelector('h1') && !document.body.innerText.includes('Loading…')"

        def shown() -> bool:
            # Chromium gives up loading when any interface of the machine comes or goes.
            if any("ERR_NETWORK_CHANGED" in one for one in self.complaints):
                self.complaints.clear()
                self.call("Page.reload")
            return bool(self.run(ready))

        poll(shown, f"{address}; the page has: {self.text()[:1500]}; {self.complaints}")

    def text(self) -> str:
        """Return the text of the page as it is seen."""
        return str(self.run("document.body?.innerText ?? ''"))

    def click(self, selector: str, text: str = "") -> None:
        """Click the first element of a selector that holds a text."""
        holds = f"(one) => one.innerText.includes({json.dumps(text)})"
        found = f"[...document.querySelectorAll({json.dumps(selector)})].find({holds})"
        self.wait(f"!!{found}")
        self.run(f"{found}.click()")

    def choose(self, label: str, value: str) -> None:
        """Give the field behind a label a value, as a person does."""
        starts = f"(one) => one.innerText.startsWith({json.dumps(label)})"
        labelled = f"[...document.querySelectorAll('label')].find({starts})"
        field = f"{labelled}.querySelector('select, input')"
        offered = f"[...field.options].some((one) => one.value === {json.dumps(value)})"
        self.wait(f"!!{labelled} && ((field) => !field.options || {offered})({field})")
        self.run(
            f"{{ const field = {field}; field.value = {json.dumps(value)};"
            " field.dispatchEvent(new Event('input', {bubbles: true}));"
            " field.dispatchEvent(new Event('change', {bubbles: true})); }"
        )

    def barriers(self) -> list[str]:
        """Return the faults that axe-core finds, slight ones too."""
        if not self.run("!!window.axe"):
            self.run(AXE.read_text(encoding="utf-8") + ";0")
        return list(self.run(FAULTS))

    def press(self, *keys: str) -> None:
        """Press keys one after the other."""
        for key in keys:
            for kind in ("keyDown", "keyUp"):
                text = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
                more = {"text": text} if text and kind == "keyDown" else {}
                code = {"Tab": 9, "Enter": 13}.get(key, 0)
                self.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **more)

    def drag(self, selector: str, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag the mouse over an element, between shares of its width and height; equal ones only hover."""
        self.run(f"document.querySelector({selector!r}).scrollIntoView({{block: 'center'}})")
        box = self.run(f"document.querySelector({selector!r}).getBoundingClientRect().toJSON()")
        steps = [tuple(a + (b - a) * k / 4 for a, b in zip(begin, end, strict=True)) for k in range(5)]
        places = [{"x": box["x"] + box["width"] * x, "y": box["y"] + box["height"] * y} for x, y in steps]
        held = {"button": "left", "clickCount": 1} if begin != end else {}
        self.call("Input.dispatchMouseEvent", type="mouseMoved", **places[0])
        if held:
            self.call("Input.dispatchMouseEvent", type="mousePressed", **places[0], **held)
        for place in places[1:]:
            buttons = {"buttons": 1} if held else {}
            self.call("Input.dispatchMouseEvent", type="mouseMoved", **place, **buttons)
        if held:
            self.call("Input.dispatchMouseEvent", type="mouseReleased", **places[-1], **held)

    def click_at(self, selector: str, place: tuple[float, float]) -> None:
        """Click the mouse at a place of an element, given in shares of its width and height."""
        box = self.run(f"document.querySelector({selector!r}).getBoundingClientRect().toJSON()")
        at = {"x": box["x"] + box["width"] * place[0], "y": box["y"] + box["height"] * place[1]}
        self.call("Input.dispatchMouseEvent", type="mouseMoved", **at)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, **at, button="left", clickCount=1)

    def picture(self, path: Path) -> None:
        """Keep a picture of the entire page."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": min(size["height"], 4000), "scale": 1}
        shot = self.call("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)
        path.write_bytes(base64.b64decode(shot["data"]))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        # The program may be a script that starts the browser: a signal would end the script alone.
        # Its answer isn't waited for: the browser may be gone before it is read.
        self._socket.send(json.dumps({"id": 0, "method": "Browser.close"}))
        self._process.wait(50)
        self._socket.close()
