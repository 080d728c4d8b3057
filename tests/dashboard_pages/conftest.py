# SPDX-License-Identifier: Apache-2.0
"""A browser to look at the pages with: Debian's Chromium over its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, Self
from urllib.request import urlopen

import pytest

from slamhive.archive import Archive, CatalogEntry, SweepRecord
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-allow-origins=*",
    "--remote-debugging-port=0",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
)
PATIENCE = 20.0


def poll(probe: Callable[[], Any], what: str) -> Any:
    """Return what a probe gives once that is true; fail with its last answer after a minute."""
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

    def open(self, address: str, *, width: int = 1280, dark: bool = False) -> None:
        """Open an address in a window of a width, and wait until the page has its heading."""
        self.complaints.clear()
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=900,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
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
        self.wait(f"!!{labelled}")
        self.run(
            f"{{ const field = {field}; field.value = {json.dumps(value)};"
            " field.dispatchEvent(new Event('input', {bubbles: true}));"
            " field.dispatchEvent(new Event('change', {bubbles: true})); }"
        )

    def picture(self, path: Path) -> None:
        """Keep a picture of the entire page."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": min(size["height"], 4000), "scale": 1}
        shot = self.call("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)
        path.write_bytes(base64.b64decode(shot["data"]))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(30)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all tests."""
    pytest.importorskip("websocket", reason="no websocket-client here: pip install websocket-client")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("no chromium here: apt-get install chromium")
    with Browser(program, tmp_path_factory.mktemp("profile")) as opened:
        yield opened


LONG = "<img src=x onerror=alert(1)>" + "long " * 2000


def make_record(number: int) -> RunRecord:
    """Return a run of two algorithms over four numbers of features; every sixth failed without a result."""
    failed = number % 6 == 5
    error = 0.1 / (1 + number // 2 % 4) + 0.01 * (number % 2)
    result = Result(
        evaluation="se3",
        outcome=Outcome.PARTIAL if number % 6 == 4 else Outcome.TRACKED,
        coverage=0.8 if number % 6 == 4 else 0.99,
        values={
            "alignment": "se3",
            "scale": 1.0,
            "ate": {"rmse": error, "mean": error, "median": error, "std": 0.0, "min": 0.0, "max": error},
        },
    )
    spec = {
        "algorithmRef": {"name": ("first", "second")[number % 2]},
        "datasetRef": {"name": ("hall", "yard")[number // 8 % 2]},
        "sensors": "mono",
        "parameters": {"nFeatures": 500 * (1 + number // 2 % 4), "note": LONG},
        "input": {"pace": "Lockstep", "frameRate": 10.0, "resolution": 1.0},
        "repetition": number // 16,
        "seed": number,
    }
    finished = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(minutes=number)
    return RunRecord.model_validate(
        {
            "uid": f"run-{number:03d}",
            "name": f"<b>run</b> {number}",
            "sweep": "study",
            "index": number,
            "spec": spec,
            "phase": Phase.FAILED if failed else Phase.SUCCEEDED,
            "reason": Reason.OUT_OF_MEMORY if failed else None,
            "message": LONG if failed else None,
            "attempts": 1,
            "created": finished,
            "started": finished,
            "finished": finished,
            "usage": {
                "cpu": {"meanCores": 1.0 + number % 4, "maxCores": 2.0, "seconds": 60.0},
                "memory": {"peakBytes": 2**28 + number, "meanBytes": 1e8},
                "wallSeconds": 60.0,
                "samples": 30,
                "source": "cgroup",
                "includesReader": False,
            },
            "results": [] if failed else [result],
            "provenance": {"contentHash": f"{number:064x}", "slamhiveVersion": "0.1.0"},
        }
    )


@pytest.fixture(scope="session")
def archive_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An archive of 48 runs."""
    url = f"sqlite:///{tmp_path_factory.mktemp('home') / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="study", name="study", spec={}))
        archive.put_catalog(
            *(CatalogEntry(kind="Algorithm", name=name, spec={}) for name in ("first", "second"))
        )
        archive.put_runs(map(make_record, range(48)))
    return url


@contextlib.contextmanager
def serving(url: str, log: Path) -> Iterator[str]:
    """Serve an archive and give the address."""
    environment = os.environ | {"SLAMHIVE_HOME": str(log.parent), "SLAMHIVE_ARCHIVE": url}
    command = [sys.executable, "-c", "from slamhive.cli.main import main; main()", "dashboard", "--port", "0"]
    with log.open("w") as written:
        process = subprocess.Popen(command, env=environment, stdout=written, stderr=subprocess.STDOUT)
    try:
        found = poll(lambda: re.search(r"http://127\.0\.0\.1:\d+", log.read_text()), "the dashboard")
        yield found[0]
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture(scope="session")
def site(archive_url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a dashboard over the archive."""
    pytest.importorskip("fastapi")
    with serving(archive_url, tmp_path_factory.mktemp("served") / "log.txt") as address:
        yield address


@pytest.fixture
def empty_site(tmp_path: Path) -> Iterator[str]:
    """The address of a dashboard over an archive that holds nothing."""
    pytest.importorskip("fastapi")
    url = f"sqlite:///{tmp_path / 'archive.sqlite'}"
    Archive.open(url).close()
    with serving(url, tmp_path / "log.txt") as address:
        yield address
