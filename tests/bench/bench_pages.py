# SPDX-License-Identifier: Apache-2.0
"""Benchmark of page loads over 80,000 runs in headless Chromium, beside their limits.

Times are the page's own clock: from the navigation until the content stands, and from letting go of the mouse
until the table below is filtered. The server is warm, the browser's cache is empty at the first page.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from bench_dashboard import RUNS, Server, fill, report, wait_for_cache  # noqa: E402

from browsers import MISSING, Browser, find_browser  # type: ignore[import-not-found]  # noqa: E402

TURNS = 3
READY = "document.querySelector('h1') && !document.body.innerText.includes('Loading…')"
DRAWN = "document.querySelector('.canvas[data-drawn=yes] canvas')"
SELECTED = "document.body.innerText.includes('Selected runs')"
BYTES = """[...performance.getEntriesByType('navigation'), ...performance.getEntriesByType('resource')]
  .reduce((sum, one) => sum + one.transferSize, 0)"""


def watch(condition: str) -> str:
    """Return a script that notes when a condition first holds."""
    return (
        f"(() => {{ const look = () => {{ if ({condition}) window.stands = performance.now();"
        " else requestAnimationFrame(look); }; requestAnimationFrame(look); })()"
    )


def visit(browser: Browser, address: str, condition: str) -> float:
    """Open a page and return when its content stood, ms after the navigation began."""
    script = browser.call("Page.addScriptToEvaluateOnNewDocument", source=watch(condition))["identifier"]
    browser.call("Page.navigate", url="about:blank")
    browser.call("Page.navigate", url=address)
    took = float(browser.wait(f"location.href === {address!r} && window.stands"))
    browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)
    return took


def brush(browser: Browser, turn: int) -> float:
    """Drag over the points and return how long after the release the runs in it are counted, ms."""
    browser.run(
        "window.stands = 0; addEventListener('mouseup', () => { window.released = performance.now(); "
        f"{watch(SELECTED)}; }}, {{once: true, capture: true}})"
    )
    browser.drag(".canvas", (0.3, 0.8), (0.4 + turn / 20, 0.1))
    return float(browser.wait("window.stands && window.stands - window.released"))


def measure(root: str, browser: Browser) -> None:
    """Print what a visitor waits for."""
    times = [visit(browser, root, READY)]
    size = float(browser.run(BYTES))
    times += [visit(browser, root, READY) for _ in range(TURNS)]
    report("start page, first view", times[0], "ms", 1000)
    report("start page, all that comes over the wire", size / 1000, "kB", 1500)
    address = f"{root}explore?kind=scatter&x=parameters.p0&y=ate.rmse"
    drawn = statistics.median(visit(browser, address, DRAWN) for _ in range(TURNS))
    report("80,000 points, from the click on the link until drawn", drawn, "ms", 1000)
    browser.click("label.tick", "Select by dragging")
    brushed = []
    for turn in range(TURNS):
        brushed.append(brush(browser, turn))
        browser.click("button", "All runs again")
        browser.wait(f"!{SELECTED}")
    report(
        "80,000 points brushed, until the table shows those inside", statistics.median(brushed), "ms", 1000
    )


def main() -> int:
    """Measure, if there is a browser."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--keep", type=Path, help="SQLite file to keep the runs in, or to find them in")
    options = parser.parse_args()
    program = find_browser()
    if program is None:
        print(f"pages · {MISSING}", flush=True)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        file = options.keep or Path(folder) / "archive.sqlite"
        if not file.exists():
            fill(f"sqlite:///{file}", options.runs)
        server = Server(f"sqlite:///{file}", Path(folder))
        try:
            server.get("runs?limit=1")
            wait_for_cache(Path(folder))
            with Browser(program, Path(folder) / "profile") as browser:
                browser.look()
                measure(server.root.removesuffix("api/v1/"), browser)
        finally:
            server.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
