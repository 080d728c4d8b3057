# SPDX-License-Identifier: Apache-2.0
"""Charts and tables under the hands of a reader: what is chosen, dragged, turned, kept and taken away."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree as ET

import pytest

pytestmark = pytest.mark.browser

DRAWN = "document.querySelectorAll('.canvas[data-drawn=yes] canvas').length"
SPACE = "document.querySelector('canvas.space')"
BLUE = """(() => {
    const canvas = document.querySelector('.canvas canvas');
    const { width, height } = canvas;
    const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
    for (let at = 0; at < data.length; at += 4)
        if (data[at] < 60 && data[at + 1] > 90 && data[at + 2] > 150)
            return [(at / 4 % width) / width, (Math.floor(at / 4 / width) + 3) / height];
    return null;
})()"""
LINES = """import('/vendor/echarts.mjs').then((echarts) => [...document.querySelectorAll('.canvas')]
.flatMap((box) => {
    const { xAxis, series } = echarts.getInstanceByDom(box).getOption();
    if (!xAxis[0].name.includes('since')) return [];
    const title = box.closest('figure').querySelector('figcaption strong').innerText;
    return [[title, xAxis[0].name, series.map((one) => one.data[0][0])]];
}))"""
KEEP = """window.kept = []; window.texts = [];
    const make = URL.createObjectURL;
    URL.createObjectURL = (blob) => { blob.text().then((text) => texts.push(text)); return make(blob); };
    HTMLAnchorElement.prototype.click = function () { kept.push([this.download, this.href]); };"""


def picture_of(selector: str) -> str:
    """Return an expression for a number that differs with what is drawn on a canvas."""
    drawn = f"document.querySelector({selector!r}).toDataURL()"
    return f"[...{drawn}].reduce((sum, one) => (sum * 31 + one.charCodeAt(0)) % 1000003, 7)"


def test_choices_are_kept_in_the_address(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore")
    browser.choose("Draw", "line")
    browser.choose("x", "parameters.nFeatures")
    browser.choose("Condition", "coverage >= 0.9")
    browser.wait(f"{DRAWN} > 0 && location.search.includes('where')")
    browser.choose("Filter by", "algorithm")
    browser.choose("is", "first")
    browser.wait("location.search.includes('algorithm=first')")
    address = browser.run("location.href")
    browser.open(address)
    assert browser.run("document.querySelector('.chip').innerText").startswith("algorithm = first")
    chosen = browser.run("[...document.querySelectorAll('select')].map((one) => one.value)")
    assert chosen[:2] == ["line", "parameters.nFeatures"]
    browser.click(".chip button")
    browser.wait("!location.search.includes('algorithm=first')")


def test_runs_are_sorted_paged_and_compared(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs?limit=20")
    browser.click("th button", "ATE")
    browser.wait(
        "location.search.includes('sort=ate.rmse') && !!document.querySelector('[aria-sort=ascending]')"
    )
    browser.click("a", "Next page")
    browser.wait("location.search.includes('after=') && document.body.innerText.includes('First page')")
    browser.click("td input")
    browser.click("a", "Compare 1 run")
    browser.wait("location.pathname === '/compare' && document.querySelectorAll('tbody tr').length === 1")


@pytest.mark.parametrize("width", [1280, 390])
def test_who_a_row_is_about_is_seen_however_far_a_table_goes(browser: Any, site: str, width: int) -> None:
    names = "run,algorithm,dataset,ate.rmse,ate.max,usage.cpu.meanCores,usage.memory.peakBytes,finished"
    browser.open(f"{site}/runs?columns={names}", width=width)
    browser.wait("document.querySelector('.beyond')?.innerText.includes('to the right')")
    browser.run("document.querySelector('.scroll').scrollLeft = 1e6")
    browser.wait("document.querySelector('.beyond').innerText === ''")
    seen = "(one) => one.getBoundingClientRect().left >= 0"
    assert browser.run(f"[...document.querySelectorAll('td.stays0, th.stays0')].every({seen})")


def test_columns_are_chosen(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs")
    browser.click("summary", "Columns")
    browser.click("label.tick", "peak memory")
    browser.wait(
        "![...document.querySelectorAll('th')].some((one) => one.innerText.startsWith('peak memory'))"
    )
    browser.click("label.tick", "seed")
    browser.wait("[...document.querySelectorAll('th')].some((one) => one.innerText === 'seed')")
    assert "seed" in browser.run("location.search")


def test_runs_are_added_to_the_compared_and_taken_away(browser: Any, site: str) -> None:
    browser.open(f"{site}/compare?uid=run-000")
    browser.choose("Add a run", "FIRST nFeatures=1000 hall front")
    browser.click(".offers button", "<b>run</b> 18")
    browser.wait("document.querySelectorAll('.chip').length === 2")
    browser.wait("document.querySelectorAll('.chip')[1].innerText.startsWith('nFeatures 1000')")
    browser.wait("document.querySelector('main').innerText.includes('parameters.nFeatures')")
    browser.click(".chip button")
    browser.wait("document.querySelectorAll('.chip').length === 1 && location.search === '?uid=run-018'")


@pytest.mark.parametrize(
    ("uids", "since", "begins"),
    [
        ((0, 1), "time since the ground truth began [s]", {"Error over time": [0, 4]}),
        # The third run knows when the recording began, 2 s before the ground truth, and when it was played.
        (
            (0, 1, 2),
            "time since the recording began [s]",
            {"Error over time": [2, 6, 2], "CPU over time": [-3], "Memory over time": [-3]},
        ),
    ],
)
def test_runs_of_a_dataset_are_drawn_on_one_clock(
    browser: Any, site: str, uids: tuple[int, ...], since: str, begins: dict[str, list[int]]
) -> None:
    browser.open(f"{site}/compare?{'&'.join(f'uid=run-{number:03d}' for number in uids)}")
    on_dataset = len(begins)
    browser.wait(f"document.querySelectorAll('.canvas[data-drawn=yes]').length === {3 + on_dataset + 2}")
    drawn = browser.run(LINES)
    assert drawn[: len(begins)] == [[title, since, starts] for title, starts in begins.items()]
    programs = [0] * len([number for number in uids if number < 2])
    after = "time since the program’s start [s]"
    assert drawn[len(begins) :] == [
        [f"{what} since the program’s start", after, programs] for what in ("CPU", "Memory")
    ]


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("{'algorithm': 'my-icp', 'sensors': 'lidar', 'dataset': 'hall'}", "my-icp, lidar, hall"),
        ("{'usage.includesReader': false, 'evaluation': 'se3'}", "reader not included, evaluation se3"),
        ("{'usage.includesReader': true, 'input.pace': 'Realtime'}", "reader included, pace Realtime"),
        ("{'usage.includesReader': null, 'input.frameRate': null}", "reader unknown, frame rate –"),
        ("{'input.frameRate': 7.5, 'parameters.loop': true}", "frame rate 7.5 Hz, loop yes"),
    ],
)
def test_titles_say_what_their_values_are(browser: Any, site: str, keys: str, expected: str) -> None:
    browser.open(f"{site}/studies?kind=pairs")
    assert browser.run(f"import('/core/format.js').then(({{ keysText }}) => keysText({keys}))") == expected


def test_what_all_charts_share_is_in_no_title(browser: Any, site: str) -> None:
    shared = (
        "{'usage.includesReader': false, algorithm: 'a'}, {'usage.includesReader': false, algorithm: 'b'}"
    )
    told = "import('/core/format.js').then(({ tellingKeys }) => tellingKeys([%s]))"
    browser.open(f"{site}/studies?kind=pairs")
    assert browser.run(told % shared) == ["algorithm"]
    differ = "{'usage.includesReader': false, algorithm: 'a'}, {'usage.includesReader': true, algorithm: 'a'}"
    assert browser.run(told % differ) == ["usage.includesReader", "algorithm"]


def test_studies_keep_their_filters(browser: Any, site: str) -> None:
    browser.open(f"{site}/leaderboard?dataset=hall")
    browser.click("a", "Tests of pairs")
    browser.wait("location.pathname === '/studies' && location.search.includes('dataset=hall')")
    browser.choose("Measured by", "usage.cpu.meanCores")
    browser.wait("document.body.innerText.includes('Who is better than whom: CPU')")
    browser.click(".tabs a", "Repeatability")
    browser.wait("document.body.innerText.includes('Repetitions over their median: CPU')")
    heads = browser.run("[...document.querySelectorAll('th')].map((one) => one.innerText.trim())")
    assert heads.index("in words") < heads.index("runs"), "what the page is about isn't cut off"
    assert "different results" in heads
    assert browser.run("document.querySelector('.chip').innerText").startswith("dataset = hall")


def test_dragging_over_points_filters_the_table(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?kind=scatter&x=parameters.nFeatures&y=ate.rmse")
    browser.wait(f"{DRAWN} === 1 && document.body.innerText.includes('Runs 48')")
    browser.click("label.tick", "Select by dragging")
    browser.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    browser.drag(".canvas", (0.3, 0.8), (0.03, 0.02))
    browser.wait("document.body.innerText.includes('Selected runs 10')")
    browser.click("button", "All runs again")
    browser.wait("document.body.innerText.includes('Runs 48')")


def test_a_point_opens_its_run(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?kind=scatter&x=parameters.nFeatures&y=ate.rmse&uid=run-008")
    browser.wait(f"{DRAWN} === 1 && document.body.innerText.includes('Runs 1')")
    place = browser.wait(BLUE)
    browser.click_at(".canvas", place)
    browser.wait("location.pathname === '/runs/run-008'")


def test_runs_that_no_point_stands_for_are_counted(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?x=ate.rmse&y=coverage")
    browser.wait("document.body.innerText.includes('8 of 48 have no ATE [m] and are not drawn')")


def test_a_chart_has_its_table_and_csv(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?kind=scatter&x=parameters.nFeatures&y=ate.rmse")
    browser.wait(f"{DRAWN} === 1")
    browser.click("figure button", "Table")
    browser.wait("document.querySelectorAll('figure tbody tr').length === 48")
    rows = browser.run("fetch(document.querySelector('figure a').href).then((answer) => answer.text())")
    assert len(rows.strip().splitlines()) == 49


@pytest.mark.parametrize(
    ("path", "figure"),
    [
        ("/explore?kind=line&x=parameters.nFeatures", "figure"),
        ("/studies?kind=common&uid=run-000&uid=run-001", "figure"),
        ("/compare?uid=run-000&uid=run-001", "figure:has(.space)"),
    ],
)
def test_pictures_are_given(browser: Any, site: str, path: str, figure: str) -> None:
    browser.open(f"{site}{path}")
    browser.wait(f"{DRAWN} >= 1 && !!document.querySelector({figure!r})")
    browser.run(KEEP)
    for name in ("PNG", "SVG"):
        browser.click(f"{figure} button", name)
    browser.wait("kept.length === 2 && texts.length === 1")
    kept = dict(browser.run("kept.map(([name, href]) => [name.split('.').at(-1), href])"))
    assert kept["png"].startswith("data:image/png")
    svg = browser.run("texts[0]")
    assert ET.fromstring(svg).tag.endswith("svg")  # noqa: S314 - made by our own page
    assert len(svg) > 2000


def test_compared_runs_have_their_csv(browser: Any, site: str) -> None:
    browser.open(f"{site}/compare?uid=run-000&uid=run-001")
    browser.wait(f"!!{SPACE}")
    browser.run(KEEP)
    browser.click("figure:has(.space) button", "CSV")
    browser.wait("texts.length === 1")
    lines = browser.run("texts[0].split('\\n')")
    assert lines[0] == "run,t,x,y,z,error"
    assert len(lines) == 1 + 200 + 160


def test_compared_runs_are_measured_over_their_common_support(browser: Any, site: str) -> None:
    browser.open(f"{site}/compare?uid=run-000&uid=run-001&uid=run-002")
    browser.click("a", "Measure these over their common support")
    browser.wait(f"location.pathname === '/studies' && {DRAWN} === 1")
    assert browser.run("document.querySelectorAll('.chip').length") == 3
    assert "15.9 s" in browser.run("document.querySelector('.counts').innerText")
    changes = "[...document.querySelector('table').querySelectorAll('.status')].map((one) => one.innerText)"
    assert browser.run(changes) == ["↑ up 1", "↑ up 1", "↓ down 2"]
    assert browser.run("document.querySelectorAll('main td b').length") == 0
    browser.click("td a", "<b>run</b> 0")
    browser.wait("location.pathname === '/runs/run-000'")
    browser.run("history.back()")
    browser.wait(f"location.pathname === '/studies' && {DRAWN} === 1")
    browser.run(KEEP)
    browser.click("figure button", "CSV")
    browser.wait("texts.length === 1")
    lines = browser.run("texts[0].split('\\n')")
    assert lines[0] == "algorithm,sensors,run,rank,gained,ownRank,common,own,n,runs"
    assert [line.rsplit(",", 7)[1:4] for line in lines[1:]] == [
        ["1", "1", "2"],
        ["2", "1", "3"],
        ["3", "-2", "1"],
    ]


def test_a_view_in_space_is_turned_by_keys_and_dragging_and_kept(browser: Any, site: str) -> None:
    browser.open(f"{site}/runs/run-000")
    browser.wait(f"{SPACE}?.dataset.drawn > 0")
    first = browser.run(picture_of("canvas.space"))
    browser.run(f"{SPACE}.focus()")
    browser.press("ArrowRight", "ArrowUp", "+")
    browser.wait("location.search.includes('view=-50%2C40%2C1.25')")
    assert "azimuth -50°, elevation 40°" in browser.text()
    turned = browser.run(picture_of("canvas.space"))
    assert turned != first
    browser.drag("canvas.space", (0.4, 0.5), (0.6, 0.5))
    browser.wait("!location.search.includes('view=-50%2C40')")
    assert browser.run(picture_of("canvas.space")) not in {first, turned}
    address, seen = browser.run("[location.href, document.querySelector('.key span').innerText]")
    browser.open(address)
    browser.wait(f"{SPACE}?.dataset.drawn > 0")
    assert browser.run("document.querySelector('.key span').innerText") == seen
    browser.run(f"{SPACE}.focus()")
    browser.press("Home")
    browser.wait("!location.search.includes('view')")
    assert "azimuth -60°, elevation 30°" in browser.text()


def test_dragging_along_an_axis_selects_runs(browser: Any, site: str) -> None:
    browser.open(f"{site}/explore?kind=parallel&axes=parameters.nFeatures,ate.rmse")
    browser.wait(f"{DRAWN} === 1 && document.body.innerText.includes('Runs 48')")
    left = browser.run("60 / document.querySelector('.canvas').clientWidth")
    browser.drag(".canvas", (left, 0.98), (left, 0.8))
    browser.wait("document.body.innerText.includes('Selected runs 12')")


def test_load_over_time_shares_its_cursor(browser: Any, site: str) -> None:
    browser.open(f"{site}/compare?uid=run-000&uid=run-001")
    browser.wait(f"{DRAWN} === 6")
    browser.run("document.querySelectorAll('.canvas').forEach((one, at) => { one.id = `chart${at}`; })")
    before = browser.run(picture_of("#chart5 canvas"))
    browser.drag("#chart4", (0.5, 0.5), (0.5, 0.5))
    browser.wait(f"{picture_of('#chart5 canvas')} !== {before!r}")


def test_colours_tell_the_error_where_they_are_asked_to(browser: Any, site: str) -> None:
    browser.open(f"{site}/compare?uid=run-000&uid=run-001")
    browser.choose("Colours tell", "error")
    browser.wait(
        "location.search.includes('colour=error') && document.body.innerText.includes('coloured by error')"
    )
    assert "m error" in browser.text()
