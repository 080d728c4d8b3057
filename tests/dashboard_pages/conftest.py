# SPDX-License-Identifier: Apache-2.0
"""A browser to look at the pages with: Debian's Chromium over its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from urllib.request import urlopen

import numpy as np
import pytest

from slamhive.archive import Archive, CatalogEntry, SweepRecord
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

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
PATIENCE = 120.0
AXE = Path(__file__).parent / "vendor" / "axe.min.js.txt"
FAULTS = """axe.run(document, {resultTypes: ['violations']}).then((found) => found.violations
    .filter((one) => ['serious', 'critical'].includes(one.impact))
    .map((one) => `${one.id}: ${one.nodes.map((node) => node.html.slice(0, 200)).join(' ')}`))"""


def poll(probe: Callable[[], Any], what: str) -> Any:
    """Return what a probe gives once that is true; fail after PATIENCE."""
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
        self.complaints.clear()
        self.look(width=width, dark=dark)
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
        """Return the serious and critical faults that axe-core finds."""
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
        self.call("Browser.close")
        self._socket.close()
        self._process.wait(50)


@pytest.fixture(scope="session")
def browser(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all tests."""
    pytest.importorskip("websocket", reason="no websocket-client here: pip install websocket-client")
    with Browser(chromium, tmp_path_factory.mktemp("profile")) as opened:
        yield opened


LONG = "<img src=x onerror=alert(1)>" + "long " * 2000


WITH_FILES = 3
STARTED = datetime(2026, 1, 1, tzinfo=UTC)
SWEEP = {
    "template": {
        "spec": {"algorithmRef": {"name": "first"}, "datasetRef": {"name": "hall"}, "sensors": "mono"}
    },
    "matrix": [{"path": "parameters.nFeatures", "values": [500, 1000, 1500, 2000]}],
    "repetitions": 15,
}


def write_files(home: Path) -> None:
    """Write the paths and the load of the first runs, and their ground truth.

    The second run's path begins 4 s later. The third was played in real time: its program began 5 s before.
    """
    t = np.arange(200) / 10
    path = np.stack([t, np.cos(t), np.sin(t), t / 20], axis=1)
    for number in range(WITH_FILES):
        output = home / "runs" / "study" / f"run-{number:03d}" / "run" / "output"
        output.mkdir(parents=True)
        moved = path + np.array([0, 0.01, 0, 0]) * (number + 1)
        moved[:, 3] += 0.01 * (number + 1) * np.sin(7 * t)
        poses = np.hstack([moved, np.eye(4)[np.full(200, 3)]])
        np.savetxt(output / "trajectory.txt", poses[40:] if number == 1 else poses)
        load = np.stack([t, 1 + np.sin(t) ** 2, 2e8 + 1e6 * t, 1e8 + 1e6 * t], axis=1)
        header = "time_seconds,cpu_cores,memory_bytes,anonymous_bytes"
        np.savetxt(output / "usage.csv", load, delimiter=",", header=header, comments="")
        files = output.parent / "files" / "config"
        files.mkdir(parents=True)
        (files / "vins.yaml").write_text('%YAML:1.0\n---\ntopic: "<b>imu</b>"\n   data: [1.0]\n')
    played = {"dataset": {"startTime": -2.0}, "input": {"pace": "Realtime", "rate": 1.0, "start": 0.0}}
    (output.parent / "config.yaml").write_text(json.dumps(played))
    started = (STARTED + timedelta(minutes=number)).timestamp()
    rows = [f"{stamp:.1f},{started + 5 + stamp:.4f},0,0" for stamp in t]
    (output / "latency.csv").write_text("\n".join(["stamp,frame_arrival,pose_arrival,latency", *rows, ""]))
    (home / "groundtruth").mkdir()
    np.savetxt(home / "groundtruth" / "hall.txt", np.hstack([path, np.eye(4)[np.full(200, 3)]]))


def make_record(number: int) -> RunRecord:
    """Return a run of two algorithms over four numbers of features; every sixth failed without a result."""
    failed = number % 6 == 5
    error = 0.1 / (1 + number // 2 % 4) + 0.01 * (number % 2)
    result = Result(
        evaluation="sim3",
        outcome=Outcome.PARTIAL if number % 6 == 4 else Outcome.TRACKED,
        coverage=0.8 if number % 6 == 4 else 0.99,
        values={
            "alignment": "sim3",
            "scale": 1.04 if number % 2 else 0.4 + 0.01 * number,
            "transform": np.eye(4).tolist(),
            "ate": {"rmse": error, "mean": error, "median": error, "std": 0.0, "min": 0.0, "max": error},
        },
    )
    if number == 12:
        others = {
            "keyframes": {"outcome": "Tracked", "coverage": 0.99, "ate": {"rmse": 0.125}},
            "online": {"outcome": "Partial", "ate": {"rmse": 0.25}, "message": "the estimate covers 40%"},
        }
        result = result.replace(values=result.values | {"beside": others})
    spec = {
        "algorithmRef": {"name": ("first", "second")[number % 2]},
        "datasetRef": {"name": ("hall", "yard")[number // 8 % 2]},
        "sensors": ("mono", "stereo")[number % 2],
        "parameters": {"nFeatures": 500 * (1 + number // 2 % 4), "note": LONG},
        "input": {"pace": "Lockstep", "frameRate": 10.0, "resolution": 1.0},
        "repetition": number // 16,
        "seed": number,
    }
    finished = STARTED + timedelta(minutes=number)
    return RunRecord.model_validate(
        {
            "uid": f"run-{number:03d}",
            "name": LONG[:9000] if number == 2 else f"<b>run</b> {number}",
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
            "metrics": {"loops": number % 5, "ratio": float("nan"), "largest": float("inf"), "keyframes": 12},
            "labels": {"camera": ("front", "back")[number // 4 % 2]},
            "results": [] if failed else [result],
            "folder": f"runs/study/run-{number:03d}" if number < WITH_FILES else None,
            "provenance": {"contentHash": f"{number:064x}", "slamhiveVersion": "0.1.0"},
        }
    )


@pytest.fixture(scope="session")
def archive_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An archive of 48 runs, in a home with the files of some."""
    home = tmp_path_factory.mktemp("home")
    write_files(home)
    url = f"sqlite:///{home / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="study", name="study", spec=SWEEP))
        archive.put_catalog(
            *(CatalogEntry(kind="Algorithm", name=name, spec={}) for name in ("first", "second"))
        )
        archive.put_runs(map(make_record, range(48)))
    return url


@contextlib.contextmanager
def serving(url: str, log: Path) -> Iterator[str]:
    """Serve an archive and give the address."""
    home = Path(url.removeprefix("sqlite:///")).parent
    environment = os.environ | {"SLAMHIVE_HOME": str(home), "SLAMHIVE_ARCHIVE": url}
    command = [sys.executable, "-c", "from slamhive.cli.main import main; main()", "dashboard", "--port", "0"]
    with log.open("w") as written:
        process = subprocess.Popen(command, env=environment, stdout=written, stderr=subprocess.STDOUT)
    try:
        found = poll(lambda: re.search(r"http://127\.0\.0\.1:\d+", log.read_text()), "the dashboard")
        yield found[0]
    finally:
        process.terminate()
        process.wait(50)


@pytest.fixture(scope="session")
def site(archive_url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a dashboard over the archive."""
    pytest.importorskip("fastapi")
    with serving(archive_url, tmp_path_factory.mktemp("served") / "log.txt") as address:
        yield address


@pytest.fixture(scope="session")
def serve() -> Callable[[str, Path], contextlib.AbstractContextManager[str]]:
    """Serves an archive as ``with`` begins, and gives the address."""
    pytest.importorskip("fastapi")
    return serving


@pytest.fixture
def empty_site(tmp_path: Path) -> Iterator[tuple[str, str]]:
    """The address of a dashboard over an archive that holds nothing, and the archive's."""
    pytest.importorskip("fastapi")
    url = f"sqlite:///{tmp_path / 'archive.sqlite'}"
    Archive.open(url).close()
    with serving(url, tmp_path / "log.txt") as address:
        yield address, url


@pytest.fixture(scope="session")
def make_run() -> Callable[[int], RunRecord]:
    """Return the function that makes runs."""
    return make_record


@pytest.fixture(autouse=True)
def quiet(request: pytest.FixtureRequest) -> Iterator[None]:
    """After a test, nothing was written to the console that the test did not take away."""
    if "browser" not in request.fixturenames:
        yield
        return
    browser = request.getfixturevalue("browser")
    browser.call("Page.navigate", url="about:blank")
    browser.complaints.clear()
    yield
    browser.run("1")
    assert [one for one in browser.complaints if "ERR_NETWORK_CHANGED" not in one] == []
