# SPDX-License-Identifier: Apache-2.0
"""Every page in a browser: what it shows, on a desk and on a phone, light and dark, and for whom."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import pytest

from slamhive.archive import Archive

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import RunRecord

pytestmark = pytest.mark.browser

PAGES = {
    "/": "Features vs ATE, CPU and RAM",
    "/sweeps": "48 of 60 runs finished",
    "/sweeps/study": "Smallest ATE on each dataset",
    "/runs": "OutOfMemory",
    "/runs/run-000": "poses are drawn",
    "/runs/run-005": "Nothing was measured",
    "/explore?kind=scatter&x=parameters.nFeatures&colour=algorithm": "Behind it",
    "/explore?kind=line&x=parameters.nFeatures&y=ate.rmse,usage.cpu.meanCores": "CPU [cores] over",
    "/explore?kind=box&x=algorithm&colour=dataset": "Behind it",
    "/explore?kind=heat&x=parameters.nFeatures": "Runs",
    "/explore?kind=parallel": "over",
    "/explore?kind=contour&x=parameters.nFeatures&colour=label.camera": "failed ones ranked last",
    "/explore?kind=slices": "the middle half of the runs",
    "/explore?kind=ecdf": "never reach one",
    "/explore?kind=multiples&x=parameters.nFeatures&down=sensors&across=dataset": "the same axes",
    "/explore?kind=pareto&x=usage.cpu.meanCores": "nobody is better in both",
    "/leaderboard": "values of nFeatures (tell them apart)",
    "/studies": "p after Holm",
    "/studies?kind=importance": "rank correlation",
    "/studies?kind=repeatability": "around the mean",
    "/studies?kind=common": "seconds in common",
    "/studies?kind=suspects": "calibration suspect: in",
    "/table?by=algorithm&figures=mean": "failures",
    "/compare?uid=run-000&uid=run-001": "Memory since the program",
    "/timeline": "48 runs, 8 failed",
    "/paths?of=run-000": "All repetitions of a run",
    "/algorithms": "first",
    "/algorithms/first": "Leaderboard",
    "/datasets": "Datasets",
    "/nowhere": "There is no such page",
}


@pytest.mark.parametrize("path", PAGES)
def test_page_shows_its_content_to_everyone(browser: Any, site: str, path: str) -> None:
    browser.open(site + path)
    browser.wait(f"document.body.innerText.includes({PAGES[path]!r})")
    assert browser.run("document.querySelector('.fault')?.innerText ?? null") is None
    assert browser.run("document.querySelectorAll('h1').length") == 1
    assert browser.run("document.querySelector('main').querySelector('h1, h2, h3, table').tagName") == "H1"
    for width, dark in ((1280, False), (390, True)):
        browser.look(width=width, dark=dark)
        browser.wait(f"matchMedia('(prefers-color-scheme: dark)').matches === {str(dark).lower()}")
        browser.wait("document.documentElement.scrollWidth <= innerWidth")
        assert browser.barriers() == []


@pytest.mark.parametrize(
    "path", ["/runs/run-005", "/runs/run-002", "/runs", "/sweeps/study", "/compare?uid=run-000&uid=run-002"]
)
def test_markup_in_names_is_text(browser: Any, site: str, path: str) -> None:
    browser.open(f"{site}{path}")
    browser.wait("document.querySelectorAll('td, dd').length > 4")
    assert browser.run("document.querySelectorAll('main img, main b b, h1 b, td b').length") == 0
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")
    if path == "/runs/run-005":
        assert "<b>run</b> 5" in browser.text()
        assert "<img src=x" in browser.text()


def test_numbers_that_are_none_have_a_dash(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs/run-000")
    facts = browser.run(
        "Object.fromEntries([...document.querySelectorAll('dt')].map((one) =>"
        " [one.innerText, one.nextElementSibling.innerText]))"
    )
    assert (facts["ratio"], facts["largest"], facts["keyframes"]) == ("–", "–", "12")
    assert not {"NaN", "null", "undefined", "Infinity"} & set(facts.values())


def test_poses_beside_a_trajectory_have_rows_of_their_own(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs/run-012")
    rows = browser.run(
        "[...document.querySelector('table').rows].map((row) =>"
        " [...row.cells].map((cell) => cell.innerText.trim()))"
    )
    found = {row["poses"]: row for row in (dict(zip(rows[0], row, strict=True)) for row in rows[1:])}
    assert [*found] == ["final", "keyframes", "causal"]
    assert found["keyframes"]["ATE rmse [m]"] == "0.125"
    assert found["causal"]["outcome"] == "Partial"
    assert found["causal"]["remark"] == "the estimate covers 40%"
    browser.open(f"{site}/runs/run-004")
    assert "poses" not in browser.run("document.querySelector('table').rows[0].innerText")


def test_settings_files_stand_on_the_page_of_a_run_as_they_are(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs/run-000")
    browser.wait(
        "[...document.querySelectorAll('summary')].some((one) => one.innerText === 'config/vins.yaml')"
    )
    shown = browser.run(
        "[...document.querySelectorAll('summary')].find((one) => one.innerText === 'config/vins.yaml')"
        ".parentElement.querySelector('pre').textContent"
    )
    assert shown == '%YAML:1.0\n---\ntopic: "<b>imu</b>"\n   data: [1.0]\n'


@pytest.mark.parametrize(
    ("path", "sentence", "place"),
    [
        ("/explore?x=parameters.nFeaturs", "did you mean 'parameters.nFeatures'", "label.wrong select"),
        ("/explore?kind=pie", "There is no drawing pie", "label.wrong select"),
        ("/studies?metric=ate.rmsee", "did you mean 'ate.rmse'", "label.wrong select"),
        ("/studies?kind=suspects&where=" + quote("run == a ?"), "unexpected", ".filters .wrong input"),
        ("/studies?kind=common&by=algorithn", "did you mean 'algorithm'", "label.wrong select"),
        ("/table?by=algorithn", "did you mean 'algorithm'", "label.wrong input"),
        ("/runs?algorithn=first", "did you mean 'algorithm'", ".chip.wrong"),
        ("/runs?after=tampered", "page", ".fault"),
        ("/runs/no-such-run", "no-such-run", ".fault"),
        ("/runs/run-000?evaluation=sim4", "did you mean 'sim3'", "label.wrong select"),
        ("/compare?uid=no-such-run", "no-such-run", ".chip.wrong"),
        ("/sweeps/studi", "did you mean 'study'", ".fault"),
    ],
)
def test_mistakes_are_shown_where_they_are(
    browser: Any, site: str, path: str, sentence: str, place: str
) -> None:
    browser.open(site + path)
    browser.wait(f"!!document.querySelector({place!r})")
    browser.wait(f"document.querySelector('.fault')?.innerText.includes({sentence!r})")
    assert browser.barriers() == []
    browser.complaints[:] = [one for one in browser.complaints if "status of 40" not in one]


def test_too_many_for_common_support_are_narrowed_by_dataset(
    browser: Any, empty_site: tuple[str, str], make_run: Callable[[int], RunRecord]
) -> None:
    address, url = empty_site
    with Archive.open(url) as archive:
        archive.put_runs(map(make_run, range(80)))
    browser.open(f"{address}/studies?kind=common")
    browser.wait("document.querySelector('.filters .fault')?.innerText.includes('at most 60')")
    assert browser.run("document.querySelector('.filters .wrong').innerText").startswith("Filter by")
    assert browser.barriers() == []
    browser.click(".filters a", "hall (40)")
    browser.wait("document.body.innerText.includes('the ground truth of this dataset is not at hand')")
    assert "0 of 33 measured" in browser.text()
    assert browser.run("document.querySelectorAll('.fault, .canvas, .counts').length") == 0
    browser.choose("Runs", "tracked")
    browser.wait("document.body.innerText.includes('Partial: only tracked runs count here')")
    browser.choose("Condition", "coverage > 2")
    browser.wait("document.querySelector('.empty')?.innerText.startsWith('No evaluated run')")
    browser.call("Page.navigate", url="about:blank")
    browser.complaints[:] = [one for one in browser.complaints if "status of 40" not in one]


def test_errors_on_a_sweep_s_card_are_on_one_axis_whatever_failed(browser: Any, site: str) -> None:
    browser.open(f"{site}/sweeps/study", width=390)
    browser.wait("document.querySelectorAll('.spread li').length > 1")
    rows = browser.run(
        """[...document.querySelectorAll('.spread li')].map((one) => {
            const {left, width} = one.querySelector('span[role]').getBoundingClientRect();
            return [left, width, one.lastElementChild.innerText];
        })"""
    )
    assert len({failed for *_, failed in rows}) > 1  # what failed takes room in some rows alone
    assert len({(left, width) for left, width, _ in rows}) == 1


def test_questions_lead_to_their_answer_or_say_what_they_need(browser: Any, site: str) -> None:
    browser.open(f"{site}/")
    asked = browser.run(
        """Object.fromEntries([...document.querySelectorAll('.questions li')].map((one) =>
            [one.innerText.split('\\n')[0], one.querySelector('small, a:not(:has(small))').outerHTML]))"""
    )
    needing = {"Image resolution vs ATE", "Frame rate vs CPU", "LiDAR against RGB-D", "Latency vs causal ATE"}
    assert {title for title, what in asked.items() if ">needs" in what} == needing
    assert "x=metrics.loops" in asked["Loops vs ATE"]
    assert "x=label.camera" in asked["Front against back camera"]
    assert "x=sensors" in asked["Sensor mode against sensor mode"]
    browser.click(".questions a", "Features vs")
    browser.wait("document.querySelectorAll('.canvas[data-drawn=yes]').length === 6")
    assert "peak memory [MiB] over nFeatures: yard" in browser.text()


@pytest.mark.parametrize(
    "path", ["/explore", "/leaderboard", "/studies", "/table", "/compare?uid=run-000", "/runs"]
)
def test_embedded_page_is_the_content_alone(browser: Any, site: str, path: str) -> None:
    browser.open(f"{site}{path}{'&' if '?' in path else '?'}embed=1")
    browser.wait("!!document.querySelector('main table, main .canvas[data-drawn=yes]')")
    assert browser.run("document.querySelectorAll('header, .filters, .controls, .tabs').length") == 0


@pytest.mark.parametrize("width", [1280, 390])
def test_a_long_title_cuts_no_menu(browser: Any, site: str, width: int) -> None:
    browser.open(f"{site}/", width=width)
    title = "Results of the robotics laboratory at the University of Somewhere, spring 2026"
    browser.run(f"document.querySelector('header .brand').lastChild.data = {title!r}")
    room = "(({scrollWidth, clientWidth}) => scrollWidth - clientWidth)(document.querySelector('header nav'))"
    # On a phone no menu has room, whatever the title: it is moved by a finger.
    assert (browser.run(room) > 0) == (width == 390)
    tops = "['.brand', 'button'].map((one) => document.querySelector(`header ${one}`).offsetTop)"
    if width == 390:
        brand, button = browser.run(tops)
        assert button - brand < 60
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")


def test_theme_is_turned_and_kept(browser: Any, site: str) -> None:
    browser.open(f"{site}/")
    before = browser.run("getComputedStyle(document.body).backgroundColor")
    browser.click("header button", "Dark")
    assert browser.run("getComputedStyle(document.body).backgroundColor") != before
    browser.open(f"{site}/explore")
    assert browser.run("document.documentElement.dataset.theme") == "dark"
    browser.run("localStorage.clear()")


def test_keys_alone_reach_the_content(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs")
    browser.press("Tab")
    assert browser.run("document.activeElement.innerText") == "To the content"
    browser.press("Enter")
    browser.wait("document.activeElement.id === 'main'")


def test_new_runs_come_by_themselves(
    browser: Any, empty_site: tuple[str, str], make_run: Callable[[int], RunRecord]
) -> None:
    address, url = empty_site
    browser.open(f"{address}/")
    browser.wait("document.body.innerText.includes('slamhive import')")
    assert browser.barriers() == []
    with Archive.open(url) as archive:
        archive.put_run(make_run(0))
    browser.wait("document.body.innerText.includes('1 of 1 runs finished')")
    browser.click("article a", "study")
    browser.wait("location.pathname === '/sweeps/study' && document.body.innerText.includes('Points 1')")
    with Archive.open(url) as archive:
        archive.put_run(make_run(1))
    browser.wait("document.body.innerText.includes('2 of 2 runs finished')")
    browser.wait("document.body.innerText.includes('Points 2')")
    browser.call("Page.navigate", url="about:blank")


def test_on_a_phone_the_figure_stands_beside_the_name(browser: Any, site: str) -> None:
    heads = "[...document.querySelectorAll('th')].slice(0, 4).map((one) => one.innerText)"
    browser.open(f"{site}/leaderboard", width=390)
    browser.wait("document.querySelectorAll('th').length > 4")
    assert browser.run(heads)[:3] == ["rank", "algorithm, sensors", "over the best"]
    # It begins within the window, and so does the picture above it.
    assert browser.run("document.querySelectorAll('th')[2].getBoundingClientRect().left") < 390 - 60
    assert browser.run("document.querySelector('.chart, table').tagName") == "FIGURE"
    browser.look(width=1280)
    browser.wait(f"{heads}[2] === 'datasets'")


def test_runs_stand_newest_first_with_their_date_and_error_in_sight(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs")
    heads = browser.run("[...document.querySelectorAll('th')].map((one) => one.innerText.trim())")
    assert heads[1:6] == ["run", "finished ↓", "status", "ATE, final [m]", "ATE, causal [m]"]
    assert "dataset" in heads[: heads.index("nFeatures")]
    assert "sweep" not in heads
    assert "All of them: sweep study" in browser.text()
    first = browser.run("[...document.querySelector('tbody tr').cells].map((one) => one.innerText.trim())")
    assert first[1] == "<b>run</b> 47"
    browser.look(width=390)
    browser.wait("document.querySelector('th').innerText.trim() === 'algorithm'")
    heads = browser.run("[...document.querySelectorAll('th')].map((one) => one.innerText.trim())")
    assert heads[1:4] == ["nFeatures", "ATE, final [m]", "CPU [cores]"]
    browser.look(width=1280)


def test_a_run_is_called_by_what_it_is_of_and_how_it_was_set_not_by_a_hash(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs/run-000")
    browser.wait("document.body.innerText.includes('poses are drawn')")
    assert browser.run("document.querySelector('h1').innerText") == "first on hall"
    assert browser.run("document.querySelector('.settings').innerText").startswith("mono, nFeatures 500")
    assert "contentHash" not in browser.text(), "hashes are folded"
    assert "What the cameras saw" in browser.text()
    browser.click("main a", "Does the truth hold?")
    browser.wait("location.search.includes('dataset=hall') && location.pathname === '/studies'")
