# SPDX-License-Identifier: Apache-2.0
"""The report: complete in itself, strict, with the figures of the analyses, whatever the runs are called."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import re
from datetime import UTC, datetime
from html.parser import HTMLParser
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis import Outcomes, Selection, choose
from slamhive.analysis.comparing import compare
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.pareto import pareto
from slamhive.reporting.page import ReportContents, report_html
from slamhive.reporting.questions import parse_question, usual_questions
from slamhive.tables.reading import archive_url, read_archive

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.analysis.frame import Frame

VOID = {"meta", "link", "br"}
NOW = datetime(2026, 3, 4, tzinfo=UTC)


class Page(HTMLParser):
    """A page taken to pieces; elements must close as they opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.files: dict[str, list[dict[str, str]]] = {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append((tag, found))
        if tag not in VOID:
            self.open.append(tag)
        address = found.get("href") or ""
        if address.startswith("data:text/csv"):
            text = base64.b64decode(address.partition("base64,")[2]).decode()
            self.files[str(found["download"])] = list(csv.DictReader(io.StringIO(text)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.texts)


def rows(home: Path, where: str | None = None) -> Frame:
    return choose(read_archive(archive_url(home)), Selection(where=where)).frame


def page(frame: Frame, **contents: Any) -> Page:
    return Page(report_html(frame, ReportContents(**contents), NOW))


@pytest.fixture
def study(records: Any, fill: Callable[..., Path]) -> Path:
    return fill([*(records.run(number) for number in range(24)), records.failed(28), records.failed(34)])


def test_it_asks_for_nothing_and_runs_nothing(assorted: Path) -> None:
    text = report_html(rows(assorted), ReportContents(), NOW)
    found = Page(text)
    assert {tag for tag, _ in found.tags} & {
        "script",
        "iframe",
        "object",
        "embed",
        "img",
        "base",
        "form",
    } == set()
    for tag, attributes in found.tags:
        assert not any(name.startswith("on") or name in {"src", "style"} for name in attributes), tag
        assert (attributes.get("href") or "#").startswith(("#", "data:"))
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL)
    assert style is not None
    assert "url(" not in style[1]
    assert "@import" not in style[1]
    digest = base64.b64encode(hashlib.sha256(style[1].encode()).digest()).decode()
    policy = next(a["content"] for t, a in found.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert policy.startswith(f"default-src 'none'; style-src 'sha256-{digest}'")
    assert not re.search(r"https?://", re.sub(r'href="data:[^"]*"', "", text))


def test_links_lead_to_sections_and_names_are_told_once(study: Path) -> None:
    found = page(rows(study), questions=())
    ids = [attributes["id"] for _, attributes in found.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = [a["href"] for t, a in found.tags if t == "a" and (a.get("href") or "").startswith("#")]
    assert [f"#{name}" for name in ids] == links
    assert all(a.get("aria-label") for t, a in found.tags if t == "svg" and a.get("role") == "img")


def test_names_are_never_markup(assorted: Path, records: Any) -> None:
    frame = rows(assorted)
    found = page(
        frame,
        title=records.HTML + records.LONG,
        questions=tuple(usual_questions(frame, "ate.rmse", Outcomes.TRACKED)),
    )
    assert records.HTML in found.text
    assert records.LONG not in found.text
    assert any(row["dataset"] == records.LONG for row in found.files["runs.csv"])
    assert all(len(value or "") < 2000 for tag, a in found.tags if tag != "a" for value in a.values())


def test_the_leaderboard_is_that_of_the_analysis(study: Path) -> None:
    frame = rows(study)
    (board,) = leaderboard(frame).boards
    lines = page(frame).files["leaderboard-1.csv"]
    expected = [(entry, standing) for entry in board.entries for standing in entry.standings]
    assert len(lines) == len(expected) == 6
    for line, (entry, standing) in zip(lines, expected, strict=True):
        assert (line["algorithm"], line["dataset"]) == (entry.keys["algorithm"], standing.dataset)
        assert (float(line["rank"]), float(line["score"])) == (entry.rank, entry.score)
        assert float(line["median.censored"]) == standing.median
        assert (int(line["runs"]), int(line["figure.n"])) == (standing.runs, standing.n)
        assert json.loads(line["failures"]) == standing.failures


def test_pairs_and_fronts_are_those_of_the_analyses(study: Path) -> None:
    frame = rows(study)
    files = page(frame, costs=("usage.cpu.meanCores",)).files
    (pair,) = compare(frame)[0][0].pairs
    (line,) = files["comparison-1.csv"]
    assert float(line["p.holm"]) == pair.p_holm == 0.25
    assert (float(line["ratio"]), int(line["wins.a"])) == (pair.ratio, 3)
    spots = [spot for front in pareto(frame, "usage.cpu.meanCores")[0] for spot in front.spots]
    found = files["pareto-usage.cpu.meanCores.csv"]
    assert [float(line["ate.rmse"]) for line in found] == [spot.y for spot in spots]
    assert [line["front"] == "true" for line in found] == [spot.front for spot in spots]


def test_costs_begin_at_0_and_have_ranges_and_no_field_tells_of_failures_that_were_none(
    records: Any, fill: Callable[..., Path]
) -> None:
    home = fill([records.run(number) for number in range(24)])
    text = report_html(rows(home), ReportContents(costs=("usage.memory.peakBytes",)), NOW)
    part = text.partition('id="pareto-1"')[2].partition("</section>")[0]
    lines = re.findall(r'<line x1="([\d.]+)" y1="([\d.]+)" x2="([\d.]+)" y2="([\d.]+)" class="range', part)
    assert sum(y1 == y2 and float(x1) < float(x2) for x1, y1, x2, y2 in lines) == 6
    assert re.search(r'y="[\d.]+" text-anchor="middle">0</text>', part)
    assert 'class="failed"' not in text


def test_what_failed_is_counted_and_shown(study: Path) -> None:
    found = page(rows(study))
    outcomes = {row["algorithm"]: row for row in found.files["outcomes.csv"]}
    assert (outcomes["algorithm-0"]["runs"], outcomes["algorithm-0"]["OutOfMemory"]) == ("14", "2")
    statuses = [row["status"] for row in found.files["runs.csv"]]
    assert (statuses.count("Tracked"), statuses.count("OutOfMemory")) == (24, 2)
    assert "2 OutOfMemory" in found.text
    assert "26 runs" in found.text


def test_charts_share_axes_with_ticks_at_the_values_that_were_tried_and_a_field_for_failures(
    study: Path,
) -> None:
    frame = rows(study)
    question = parse_question("nFeatures:ate", frame, Outcomes.TRACKED)
    text = report_html(frame, ReportContents(questions=(question,)), NOW)
    charts = re.findall(r"<svg .*?</svg>", text.partition('id="analysis-1"')[2].partition("</section>")[0])
    drawn = [chart for chart in charts if 'role="img"' in chart]
    assert len(drawn) == 3
    # The numbers beside the axes: the same in each chart, though errors differ by dataset.
    ticks = [
        re.findall(r">([\d.]+)</text>", re.sub(r'<text [^>]*class="small".*?</text>', "", one))
        for one in drawn
    ]
    assert ticks[0] == ticks[1] == ticks[2]
    assert ticks[0][:2] == ["500", "1000"]
    # A field in each of them; of dataset-2 it counts the two that failed, above all that is drawn.
    assert all('class="failed"' in one for one in drawn)
    crosses = [float(y) for one in drawn for y in re.findall(r'd="M[\d.]+ ([\d.]+)l8 8m0 -8l-8 8"', one)]
    marks = [float(y) for one in drawn for y in re.findall(r'd="M[\d.]+ ([\d.]+)a', one)]
    assert len(crosses) == 2
    assert max(crosses) + 8 < min(marks)


def test_failed_runs_are_listed_once_an_evaluation(records: Any, fill: Callable[..., Path]) -> None:
    both = [records.result(), records.result("sim3")]
    lost = records.failed(2, evaluations=records.meant("se3", "sim3"))
    frame = rows(fill([records.run(0, results=both), records.run(1, results=both), lost]))
    found = page(frame)
    assert "3 runs" in found.text
    assert len(found.files["runs.csv"]) == 6
    only = page(rows(fill([]), "evaluation == 'sim3'"))
    assert [row["status"] for row in only.files["runs.csv"]] == ["Tracked", "OutOfMemory", "Tracked"]


@pytest.mark.parametrize(
    "kind",
    ["failed", "unevaluated", "single", "zero", "strange"],
)
def test_odd_archives(records: Any, fill: Callable[..., Path], kind: str) -> None:
    made = {
        "failed": [records.failed(number) for number in range(4)],
        "unevaluated": [records.run(0, results=[])],
        "single": [records.run(0)],
        "zero": [records.run(number, results=[records.result(ate={"rmse": 0.0})]) for number in range(6)],
        "strange": [
            records.run(0, results=[records.result(ate={"rmse": 1e30})]),
            records.run(1, results=[records.result(ate={"rmse": 1e-30})]),
            records.run(2, results=[records.result(ate={"rmse": float("nan")}, scale=float("inf"))]),
            records.run(3, results=[records.result(ate={"rmse": -1.0})], usage=None),
        ],
    }[kind]
    frame = rows(fill(made))
    questions = [
        parse_question(text, frame, Outcomes.ALL)
        for text in ("nFeatures:ate.rmse", "algorithm:ate.rmse", "x=seed&y=ate.rmse&kind=scatter")
    ]
    text = report_html(frame, ReportContents(questions=tuple(questions)), NOW)
    found = Page(text)
    assert len(found.files["runs.csv"]) == len(made)
    assert not re.search(r"\b(nan|inf)\b", re.sub(r'href="data:[^"]*"', "", text), re.IGNORECASE)


def test_an_evaluation_without_the_figure_is_said_not_failed(records: Any, fill: Callable[..., Path]) -> None:
    relations = records.result("relations", ate=None)
    found = page(rows(fill([records.run(0), records.run(1), records.run(2, results=[relations])])))
    assert "Evaluation relations has no ate.rmse" in found.text
    assert {row["dataset"] for row in found.files["leaderboard-1.csv"]} == {"dataset-0"}
    assert "leaderboard-2.csv" not in found.files


def test_equal_runs_make_equal_pages_and_others_another_revision(
    records: Any, fill: Callable[..., Path]
) -> None:
    home = fill([records.run(number) for number in range(4)])
    first = report_html(rows(home), ReportContents(), NOW)
    assert report_html(rows(home), ReportContents(), NOW) == first
    changed = fill([records.run(3, results=[records.result(ate={"rmse": 0.5})])])
    revision = re.compile(r"data ([0-9a-f]{16})")
    again = revision.search(report_html(rows(changed), ReportContents(), NOW))
    before = revision.search(first)
    assert before is not None
    assert again is not None
    assert before[1] != again[1]


@pytest.mark.parametrize(
    "selection",
    [Selection(evaluation="sim3"), Selection(sweeps=("later",)), Selection(where="evaluation != 'se3'")],
)
def test_a_part_without_one_of_the_evaluations(
    records: Any, fill: Callable[..., Path], selection: Selection
) -> None:
    other = [records.run(number, results=[records.result("sim3")]) for number in (24, 25)]
    home = fill([records.run(0), *other, records.failed(26, evaluations=records.meant("sim3"))])
    frame = choose(read_archive(archive_url(home)), selection).frame
    found = page(frame)
    board = found.files["leaderboard-1.csv"]
    assert {row["algorithm"]: row["runs"] for row in board} == {"algorithm-0": "1", "algorithm-1": "1"}
    statuses = sorted(row["status"] for row in found.files["runs.csv"])
    assert "OutOfMemory" in statuses
    assert statuses.count("Tracked") == 2


@pytest.mark.parametrize("by", [(), ("dataset",), ("algorithm",), ("parameters.nFeatures", "sensors")])
def test_other_competitors(study: Path, by: tuple[str, ...]) -> None:
    found = page(rows(study), by=by)
    assert all(name in row for row in found.files["leaderboard-1.csv"] for name in by)


def test_a_setting_is_drawn_as_groups_and_a_measurement_as_points(study: Path) -> None:
    frame = rows(study)
    groups = parse_question("nFeatures:ate", frame, Outcomes.TRACKED)
    points = parse_question(
        "http://127.0.0.1:8323/explore?kind=scatter&x=usage.cpu.secondsPerDataSecond&y=ate.rmse&colour=algorithm"
        "&dataset=dataset-0&coverage>=0.9",
        frame,
        Outcomes.TRACKED,
    )
    assert (groups.x, groups.y, groups.points) == ("parameters.nFeatures", "ate.rmse", False)
    assert (points.points, points.by, len(points.frame)) == (True, ("algorithm",), 8)
    found = page(frame, questions=(groups, points))
    sheet = found.files["analysis-1.csv"]
    assert len(sheet) == 12
    assert {row["ate.rmse.n"] for row in sheet} == {"2"}
    (line,) = [row for row in sheet if row["failures"] != "{}" and row["parameters.nFeatures"] == "500"]
    assert json.loads(line["failures"]) == {"OutOfMemory": 1}
    marks = [a["class"] or "" for _, a in found.tags if "mark" in (a.get("class") or "")]
    assert len(marks) > 12 + 8


def test_what_varies_is_drawn_unless_told(study: Path, slamhive: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    code, out, err = slamhive(study, "report", "-o", file)
    assert (code, out) == (0, "")
    assert "26 runs" in err
    written = Page(file.read_text()).text
    assert "ATE [m] over nFeatures" in written
    # Who won stands before anything else, and what was varied beside the algorithm.
    assert written.index("algorithm-0 with") < written.index("What was compared")
    heads = file.read_text().partition('id="runs"')[2].partition("</thead>")[0]
    assert heads.index(">algorithm<") < heads.index(">nFeatures<") < heads.index(">sensors<")
    code, out, _ = slamhive(study, "report", "--analysis", "none", "-o", "-", "--where", "repetition == 0")
    assert code == 0
    assert "analysis-1" not in out
    assert "where repetition == 0" in Page(out).text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--analysis", "bogus"], "--analysis: 'bogus' is neither X:Y, X:Y:COLOUR nor an address"),
        (["--analysis", "nFeatures:"], "--analysis: 'nFeatures:' is neither"),
        (["--analysis", "nFeaturs:ate.rmse"], "--analysis: unknown column 'nFeaturs'"),
        (["--analysis", "nFeatures:algorithm"], "--analysis: algorithm: a column of numbers is needed"),
        (["--analysis", "frames.offered:ate"], "--analysis: no run has frames.offered"),
        (["--analysis", "x=seed"], "--analysis: 'x=seed' says no y="),
        (["--analysis", "x=seed&y=ate.rmse&kind=heat"], "--analysis: kind=heat: a report draws scatter"),
        (["--analysis", "x=seed&y=ate.rmse&datset=a"], "--analysis: unknown parameter or column 'datset'"),
        (["--analysis", "x=seed&y=ate.rmse&where=a>"], "--analysis: condition, character 1"),
        (["-m", "outcome"], "--metric: outcome: a column of numbers is needed"),
        (["--cost", "cpu"], "--cost: unknown column 'cpu'"),
        (["--by", "algo"], "--by: unknown column 'algo'"),
        (["--where", "coverage > 2"], "no run is meant"),
        (["--sweep", "x"], "--sweep: unknown sweep 'x'"),
        (["-o", "/nowhere/r.html"], "--output: /nowhere/r.html: No such file"),
    ],
)
def test_mistakes(study: Path, slamhive: Callable[..., Any], words: list[str], sentence: str) -> None:
    code, out, err = slamhive(study, "report", *words)
    assert (code, out) == (2, "")
    assert " ".join(err.split()).startswith(f"error: {sentence}")


def test_no_archive(tmp_path: Path, slamhive: Callable[..., Any]) -> None:
    code, _, err = slamhive(tmp_path / "none", "report")
    assert code == 2
    assert "no archive at" in err


def test_the_published_runs(published: Path) -> None:
    found = page(rows(published))
    board = {
        (row["algorithm"], row["sensors"], row["dataset"]): row for row in found.files["leaderboard-1.csv"]
    }
    hidden = board["orb-slam3", "stereo", "mh-03-medium"]
    assert (hidden["runs"], hidden["figure.n"], hidden["failures"]) == ("2", "0", '{"Partial": 2}')
    assert "calibration suspect: in 43 runs the scale is 0.957" in found.text
    runs = {row["run"]: row for row in found.files["runs.csv"]}
    assert runs["63"]["status"] == "Lost"
    assert float(runs["103"]["ate.rmse"]) == pytest.approx(0.446, abs=5e-4)
