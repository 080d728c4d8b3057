# SPDX-License-Identifier: Apache-2.0
"""A site of files is walked in a browser, and says what the dashboard's API says."""

from __future__ import annotations

import asyncio
import functools
import gzip
import http.server
import json
import re
import shutil
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import httpx
import pytest
from typer.testing import CliRunner

from browsers import AXE, FAULTS
from slamhive.archive import Archive, SweepRecord
from slamhive.cli.main import app
from slamhive.model.errors import InputError

pytest.importorskip("fastapi")

from slamhive.dashboard.publishing.building import SiteWish, build
from slamhive.dashboard.publishing.runpages import RunPages
from slamhive.dashboard.sources.archived import Workstation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from browsers import Browser
    from slamhive.dashboard.publishing.building import BuiltSite
    from slamhive.model.results import RunRecord

MARKUP = 'Lab\'s <b>runs</b> & "more"'
BASE = "https://lab.example/slam"
PAGES = (
    *("/", "/sweeps/study", "/runs", "/runs/run-002", "/leaderboard", "/explore", "/table"),
    *("/compare?uid=run-000&uid=run-001", "/explore?sweep=study", "/algorithms/first", "/datasets"),
    *(f"/explore?kind={kind}" for kind in ("line", "box", "ecdf", "heat", "contour", "slices")),
    *(f"/explore?kind={kind}" for kind in ("parallel", "pareto&x=usage.cpu.meanCores", "multiples")),
    *(f"/studies?kind={kind}" for kind in ("pairs", "importance", "repeatability", "robustness")),
    *(f"/studies?kind={kind}" for kind in ("versions", "common", "suspects", "suspects&dataset=hall")),
    "/timeline?sweep=study",
)
NARROW = 8
"""Pages that are looked at on a phone too: those that differ there most."""

OF_THE_TABLE = (
    "runs?columns=uid,run,algorithm,ate.rmse,finished,parameters.nFeatures&sort=-ate.rmse&limit=7",
    "runs?columns=uid,ate.rmse&sort=ate.rmse&limit=100&algorithm=first&coverage%3E=0.9",
    "runs?columns=uid,reason,note&status=OutOfMemory&sort=uid&ate.rmse=null",
    "runs?columns=uid,dataset&sort=-uid&dataset!=hall&parameters.nFeatures=1000&parameters.nFeatures=1500",
    "runs?columns=uid,run&sort=-run&limit=100",
    "analysis/points?x=run&y=ate.rmse&colour=run",
    "analysis/points?x=parameters.nFeatures&y=ate.rmse&colour=algorithm",
    "analysis/points?x=usage.cpu.meanCores&y=coverage&facet=dataset&ate.rmse%3C0.08&sensors=mono",
    "runs/run-001/trajectory?points=2000&evaluation=sim3",
    "runs/run-001/usage",
    "runs/run-002",
)


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Say nothing."""


def made(url: str, folder: Path, wish: SiteWish | None = None) -> BuiltSite:
    """Build a site of an archive in a home."""
    home = Path(url.removeprefix("sqlite:///")).parent
    return asyncio.run(build(folder, Workstation(url, home), wish or SiteWish(title=MARKUP, base_url=BASE)))


@pytest.fixture(scope="session")
def folder(archive_url: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site of the archive, below a folder that is served."""
    path = tmp_path_factory.mktemp("public") / "below" / "slam"
    made(archive_url, path)
    return path


@pytest.fixture(scope="session")
def published(folder: Path) -> Iterator[str]:
    """The address of the site, at a sub-path of Python's own file server."""
    handler = functools.partial(_Quiet, directory=folder.parents[1])
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/below/slam/"
        server.shutdown()
        thread.join()


def index_of(folder: Path) -> dict[str, Any]:
    """Return the index of a site's answers."""
    return read(folder, json.loads((folder / "site.json").read_text())["index"])


def read(folder: Path, name: str) -> Any:
    """Return the content of a file of a site."""
    return json.loads(gzip.decompress((folder / "data" / name[:2] / f"{name}.json.gz").read_bytes()))


def plain(value: Any) -> Any:
    """Return an answer without what no two servers share: its revision, and the server."""
    if isinstance(value, dict):
        return {
            name: plain(one)
            for name, one in value.items()
            if name not in {"revision", "source", "links", "next"}
        }
    return [plain(one) for one in value] if isinstance(value, list) else value


@pytest.mark.browser
@pytest.mark.parametrize("width", [1280, 390])
def test_pages_show_all_without_a_server(browser: Browser, published: str, width: int) -> None:
    unanswered = {}
    for page in PAGES if width > 1000 else PAGES[:NARROW]:
        browser.call("Page.navigate", url="about:blank")
        browser.open(f"{published}#{page}", width=width)
        browser.wait("!document.body.innerText.includes('Loading…')")
        text = browser.text()
        said = browser.run(
            "[...document.querySelectorAll('[role=alert], [role=note]')].map((e) => e.innerText)"
        )
        if said or "could not be loaded" in text:
            unanswered[page] = said or text[:300]
        assert browser.run("document.documentElement.scrollWidth") <= width, page
        if page in PAGES[:NARROW:3]:
            browser.run(AXE.read_text())
            assert browser.run(FAULTS) == [], page
    assert unanswered == {}
    assert MARKUP in text


@pytest.mark.browser
def test_tables_and_points_are_those_of_the_api(
    browser: Browser, published: str, site: str, folder: Path
) -> None:
    browser.open(f"{published}#/")
    (code,) = (folder / "pages").iterdir()
    for question in OF_THE_TABLE:
        url = f"/api/v1/{question}"
        expected = plain(httpx.get(site + url, timeout=60).json())
        script = f"import('./pages/{code.name}/core/site.js').then((one) => one.answer({json.dumps(url)}))"
        found = plain(browser.run(script))
        for one in (expected, found):  # titles tell columns apart that stand beside each other
            for heading in one.get("columns", []):
                heading.pop("label", None), heading.pop("title", None)
            for axis in one.get("axes", {}).values() if isinstance(one.get("axes"), dict) else ():
                axis.pop("label", None), axis.pop("title", None)
            one.pop("notes", None), one.pop("mixed", None)
        assert found == expected, question


def test_answers_are_those_of_the_api(site: str, folder: Path) -> None:
    answers = index_of(folder)["answers"]
    assert len(answers) > 150
    for question in sorted(answers)[::9]:
        expected = plain(httpx.get(site + question, timeout=60).json())
        assert plain(read(folder, answers[question])) == expected, question


def test_choices_that_need_a_server_say_so(browser: Browser, published: str) -> None:
    browser.open(f"{published}#/leaderboard?where=coverage%20%3E%200.5")
    assert "no server to read that condition" in browser.text()
    for page in ("sweep", "algorithm", "dataset"):
        browser.open(f"{published}#/{page}s/nothing")
        assert f"This site has no page of the {page} 'nothing'." in browser.text()
    browser.open(f"{published}#/runs")
    assert "Condition" not in browser.text()
    assert "earlier versions too" not in browser.text()
    browser.open(f"{published}#/")
    assert "running now" not in browser.text()


def test_boards_are_told_apart_where_that_was_computed(browser: Browser, published: str) -> None:
    browser.open(f"{published}#/leaderboard")
    browser.click("main a", "tell them apart")
    browser.wait("document.querySelector('main table')?.innerText.includes('sensors, nFeatures')")
    assert "no figures for that choice" not in browser.text()
    browser.open(f"{published}#/leaderboard?metric=coverage")
    browser.wait("document.body.innerText.includes('values of nFeatures.')")
    assert "tell them apart" not in browser.text()


def test_an_update_adds_and_addresses_stay(
    archive_url: str, tmp_path: Path, make_run: Callable[[int], RunRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "home"
    first_home = Path(archive_url.removeprefix("sqlite:///")).parent
    shutil.copytree(first_home, home, ignore=shutil.ignore_patterns("archive.sqlite*"))
    url = f"sqlite:///{home / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="study", name="study", spec={}))
        archive.put_runs(map(make_run, range(16)))
    site = tmp_path / "site"

    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(RunPages, "written", interrupt)
        with pytest.raises(KeyboardInterrupt):
            made(url, site)
    assert made(url, site).runs == 16
    first = {path: path.read_bytes() for path in site.rglob("*") if path.is_file()}
    with Archive.open(url) as archive:
        archive.put_run(make_run(4))  # the same content: only times of files differ
    again = made(url, site)
    assert (again.same, again.runs, again.added) == (True, 16, 0)
    before = read(site, index_of(site)["runs"])
    with Archive.open(url) as archive:
        archive.put_runs(map(make_run, range(16, 18)))
        archive.remove_run("run-003")
    assert made(url, site).runs == 17
    changed = {str(path.relative_to(site)) for path, content in first.items() if path.read_bytes() != content}
    assert {name for name in changed if not name.startswith("badges/")} <= {"site.json", "feed.xml"}
    after = read(site, index_of(site)["runs"])
    assert len(after["uids"]) == 18
    place = after["uids"].index("run-003")
    assert read(site, after["files"][after["at"][place]])["run-003"][""]["uid"] == "run-003"
    assert before["files"][0] in after["files"]
    pages = json.dumps([read(site, name) for name in after["files"]])
    path = re.findall(r'{"file": "(\w+)"}', pages)[0]
    names = [f"data/{name[:2]}/{name}.json.gz" for name in (after["files"][-1], path)]
    kept = {name: (site / name).read_bytes() for name in (*names, "index.html")}
    for lost in (*names, "index.html"):
        (site / lost).unlink()
        assert not made(url, site).same
        assert {name: (site / name).read_bytes() for name in kept} == kept
    assert made(url, site).same


def test_a_folder_of_something_else_stays_as_it_is(tmp_path: Path, archive_url: str) -> None:
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="holds something else than a site"):
        made(archive_url, tmp_path)
    (tmp_path / "site.json").write_text('{"kind": "other"}')
    with pytest.raises(InputError, match="another program's"):
        made(archive_url, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["site.json", "thesis.tex"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sweep", "nothing"], "unknown sweep 'nothing'"),
        (["--title", ""], "expected 1 to 200 characters"),
        (["--title", "a\nb"], "expected 1 to 200 characters"),
        (["--base-url", "javascript:alert(1)"], "expected an address such as"),
    ],
)
def test_wishes_that_cannot_be(
    options: list[str], said: str, archive_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(Path(archive_url.removeprefix("sqlite:///")).parent))
    with pytest.raises(InputError, match=re.escape(said)):
        CliRunner().invoke(app, ["site", str(tmp_path / "new"), *options], catch_exceptions=False)
    assert not (tmp_path / "new").exists()


def test_title_policy_feed_and_badges_are_as_others_read_them(folder: Path) -> None:
    home = (folder / "index.html").read_text()
    assert "<title>Lab&#x27;s &lt;b&gt;runs&lt;/b&gt; &amp; &quot;more&quot;</title>" in home
    assert "default-src 'none'; script-src 'self'" in home
    assert not re.search(r'(src|href)="(/|http(?!s://lab\.example/slam/"))', home)
    space = "{http://www.w3.org/2005/Atom}"
    feed = ET.parse(folder / "feed.xml").getroot()  # noqa: S314 - our own
    assert feed.findtext(f"{space}title") == MARKUP
    known = [one.text for one in feed.iter(f"{space}id")]
    assert len(known) == len(set(known)) > 3
    links = [str(one.get("href")) for one in feed.iter(f"{space}link")]
    assert all(one.startswith(f"{BASE}/") for one in links)
    badges = sorted((folder / "badges").rglob("*.svg"))
    assert len(badges) == 4
    for badge in badges:
        title = ET.parse(badge).getroot().findtext("{http://www.w3.org/2000/svg}title")  # noqa: S314
        assert re.fullmatch(r"\w+ \w+ on \w+: #\d of \d · ATE [\d.]+ ± [\d.e-]+ m · 2026-01-01", str(title))
