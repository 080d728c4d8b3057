# SPDX-License-Identifier: Apache-2.0
"""Figures for papers: the numbers in them, what is left out, their axes, and the files that they are."""

from __future__ import annotations

import csv
import re
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis import Outcomes, Selection, choose
from slamhive.analysis.measures import Better
from slamhive.figures.asking import FigureKind, Log, Wish
from slamhive.figures.making import picture
from slamhive.figures.paper import Paper
from slamhive.figures.pictures import Box, Dots, Line, MissingMark, Panel, Picture, PictureAxis, Tiles
from slamhive.figures.styles import SCALE, Face, Style, settings
from slamhive.figures.widths import WIDTHS, parse_width
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError
from slamhive.model.extras import how_to_install
from slamhive.model.results import Outcome
from slamhive.reporting.papertables import Statistic
from slamhive.tables.reading import archive_url, read_archive
from thinning import thinned

if TYPE_CHECKING:
    from collections.abc import Callable

    Slamhive = Callable[..., tuple[int, str, str]]
    Fill = Callable[..., Path]

ROOT = Path(__file__).parents[2]
KINDS = [kind.value for kind in FigureKind if kind is not FigureKind.SEARCH]


def made(home: Path, kind: FigureKind, where: str | None = None, **wish: Any) -> Picture:
    frame = choose(read_archive(archive_url(home)), Selection(where=where)).frame
    return picture(frame, Wish(kind, **wish), Home.at(home))


def marks(found: Picture, kind: Any, panel: int = 0) -> list[Any]:
    return [mark for mark in found.panels[panel].marks if isinstance(mark, kind)]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture
def study(records: Any, fill: Fill) -> Path:
    """24 tracked runs, and on dataset-2 two more of the better algorithm that were not."""
    lost = [records.run(28, results=[records.result(outcome=Outcome.LOST)]), records.failed(34)]
    return fill([*(records.run(number) for number in range(24)), *lost])


@pytest.fixture
def forty(records: Any, fill: Fill) -> Path:
    """Forty runs within a few millimetres, and two that went metres astray."""

    def error(number: int) -> float:
        return 4.0 + number if number >= 40 else 0.01 + 0.0001 * number

    return fill(
        records.run(
            number,
            spec={"datasetRef": {"name": "one"}, "algorithmRef": {"name": "a"}, "repetition": number},
            parameters={"nFeatures": 500},
            results=[records.result(ate={"rmse": error(number)})],
        )
        for number in range(42)
    )


@pytest.mark.parametrize("kind", thinned(KINDS))
def test_every_kind_of_the_published_runs(
    kind: str, published: Path, slamhive: Slamhive, tmp_path: Path
) -> None:
    file = tmp_path / f"{kind}.pdf"
    # Two axes were varied: which threshold is meant nobody can guess.
    axis = ("--x", "parameters.nFeatures") if kind == "robustness" else ()
    code, out, err = slamhive(published, "figure", kind, "-o", file, *axis)
    assert (code, out) == (0, ""), err
    content = file.read_bytes()
    assert content.startswith(b"%PDF-")
    # Fonts stand in the file, as outlines that can be edited: nothing of type 3, which journals refuse.
    assert b"/FontFile2" in content
    assert b"/Type3" not in content
    assert re.search(rb"/MediaBox \[ 0 0 252 ", content)
    assert f"slamhive figure {kind} -o".encode() in content
    assert rows(tmp_path / f"{kind}.data.csv")
    said = " ".join(err.split())
    assert "runs; numbers in" in said
    assert "run" in said.split("data.csv", 1)[1]  # a caption: what each mark is


def test_lines_are_the_medians_of_the_runs_and_say_so(
    published: Path, slamhive: Slamhive, tmp_path: Path
) -> None:
    found = made(published, FigureKind.LINES, x="nFeatures", y="ate.rmse:cm")
    assert (found.x.label, found.y.label) == ("nFeatures", "ATE RMSE [cm]")
    assert [panel.title for panel in found.panels] == ["rgbd-dataset-freiburg2-desk"]
    (line,) = marks(found, Line)
    code, out, _ = slamhive(
        published,
        "paper-table",
        "--rows",
        "parameters.nFeatures",
        "--columns",
        "",
        "--statistic",
        "median",
        "--where",
        "sensors == 'rgbd' and `dataset.attributes.DepthMapFactor` == 1",
        "--format",
        "csv",
    )
    assert code == 0
    table = {
        float(row["parameters.nFeatures"]): float(row["ate.rmse [m]"])
        for row in csv.DictReader(out.split("\n"))
    }
    # Without failures a figure's median is the table's; with some, these rank behind all others.
    assert line.x.tolist() == sorted(table)
    assert line.y[0] / 100 == pytest.approx(table[500.0])
    assert [mark.count for mark in marks(found, MissingMark)] == [1, 1, 2, 1]
    caption = ". ".join(found.notes)
    assert (
        "each mark is the median of 3 to 7 results, runs that failed behind all others; bars are the range"
        in caption
    )
    assert "n = 43 tracked runs of 48; left out: 1 Diverged, 4 Partial" in caption


def test_means_have_their_standard_deviation(study: Path) -> None:
    found = made(
        study,
        FigureKind.LINES,
        x="nFeatures",
        by="algorithm",
        statistic=Statistic.MEAN,
        where="dataset == 'dataset-0'",
    )
    line = marks(found, Line)[0]
    assert line.y.tolist() == pytest.approx([0.0205, 0.0205])
    assert (line.high - line.y).tolist() == pytest.approx([np.std([0.02, 0.021], ddof=1)] * 2)
    assert "mean of 2 results, bars are the standard deviation (n − 1)" in found.notes[0]


def test_two_diverged_runs_flatten_nothing(forty: Path) -> None:
    found = made(forty, FigureKind.SCATTER, x="coverage")
    assert found.y.limits is not None
    assert found.y.limits.high == pytest.approx(0.0139)
    assert "ATE RMSE [m]: 44, 45 lie outside of the axis and are told by arrows at its edge" in found.notes
    whole = made(forty, FigureKind.SCATTER, x="coverage", robust=False, log=Log.NONE)
    assert whole.y.limits is not None
    assert whole.y.limits.high == 45
    assert not any("outside" in note for note in whole.notes)


def test_what_lies_outside_is_marked_at_the_edge(forty: Path) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(forty, FigureKind.SCATTER, x="coverage")
    axes = Drawing(found, WIDTHS["ieee-column"]).draw().axes[0]
    edge = [line for line in axes.lines if not line.get_clip_on()]
    # Two side by side: one arrow with both numbers, and no mark that looks like a run.
    assert [(line.get_marker() == Style(0).mark, line.get_ydata()[0]) for line in edge] == [(False, 1.0)]
    assert [text.get_text() for text in axes.texts] == ["44, 45"]
    assert axes.get_ylim()[1] < 0.02


@pytest.fixture
def tried(records: Any, fill: Fill) -> Path:
    """Three runs of each voxel size: a size with errors of 88 cm beside some of 6, one astray, two lost."""
    errors = {
        0.5: (0.06, 0.061, 9.0),
        1.0: (0.87, 0.88, 0.89),
        1.5: (0.11, 0.12, 0.13),
        2.0: (0.2, None, None),
    }

    def one(number: int, size: float, error: float | None) -> Any:
        lost = {"outcome": Outcome.LOST} if error is None else {"ate": {"rmse": error}}
        spec = {"datasetRef": {"name": "hall"}, "algorithmRef": {"name": "a"}, "repetition": number}
        parameters = {"voxelSize": size}
        return records.run(number, spec=spec, parameters=parameters, results=[records.result(**lost)])

    each = [(size, error) for size, found in errors.items() for error in found]
    return fill(one(number, size, error) for number, (size, error) in enumerate(each))


def test_no_median_lies_outside_and_the_values_that_were_tried_have_ticks(tried: Path) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(tried, FigureKind.LINES)
    (line,) = marks(found, Line)
    assert line.y[:3].tolist() == pytest.approx([0.061, 0.88, 0.12])
    axes = Drawing(found, WIDTHS["ieee-column"]).draw().axes[0]
    low, high = axes.get_ylim()
    assert low <= 0.06
    assert 0.89 <= high < 9.0
    assert [text.get_text() for text in axes.get_xticklabels()] == ["0.5", "1", "1.5", "2"]
    # The run astray is the end of a bar: an arrow has its number.
    assert "9" in [text.get_text() for text in axes.texts]
    assert "ATE RMSE [m]: 9 lies outside of the axis and is told by arrows at its edge" in found.notes


@pytest.mark.parametrize("kind", [FigureKind.SCATTER, FigureKind.LINES, FigureKind.BOX, FigureKind.PARETO])
def test_failures_stand_in_a_field_of_their_own_never_among_the_values(tried: Path, kind: FigureKind) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(tried, kind, **({"by": "voxelSize"} if kind is FigureKind.PARETO else {}))
    axes = Drawing(found, WIDTHS["ieee-column"]).draw().axes[0]
    axes.figure.draw_without_rendering()
    top = axes.get_window_extent().y1
    failed = [text for text in axes.texts if text.get_text() in {"failed", "2"}]
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    assert failed
    assert len(crosses) == {FigureKind.SCATTER: 2, FigureKind.PARETO: 1}.get(kind, 0)
    places = [one.get_transform().transform((0, one.get_ydata()[0]))[1] for one in crosses]
    assert min([text.get_window_extent().y0 for text in failed] + places) > top


def test_numbers_from_a_billionth_to_a_billion_stand_on_an_axis_that_can_be_read(
    records: Any, fill: Fill
) -> None:
    from slamhive.figures.drawing import Drawing

    home = fill(
        records.run(
            number,
            spec={"datasetRef": {"name": "hall"}, "algorithmRef": {"name": "a"}},
            parameters={"voxelSize": 10.0 ** (number - 9)},
            results=[records.result(ate={"rmse": 10.0 ** (9 - number)})],
        )
        for number in range(19)
    )
    axes = Drawing(made(home, FigureKind.LINES), WIDTHS["ieee-column"]).draw().axes[0]
    axes.figure.draw_without_rendering()
    low, high = axes.get_xlim()
    shown = [text for text in axes.get_xticklabels() if low <= text.get_position()[0] <= high]
    assert {"10⁻⁹", "10⁹"} <= {text.get_text() for text in shown}
    ends = [text.get_window_extent() for text in shown if text.get_text()]
    assert all(left.x1 < right.x0 for left, right in pairwise(ends))


@pytest.mark.parametrize("word", ["a-very-long-name-of-an-algorithm-", "m"])
def test_long_names_in_a_legend_fit_and_stay_apart(records: Any, fill: Fill, word: str) -> None:
    import matplotlib as mpl

    from slamhive.figures.drawing import Drawing

    names = [f"{word * 62}{end}"[-63:] for end in "1234"]
    home = fill(
        records.run(number, spec={"algorithmRef": {"name": f"{name}{middle}{'x' * 40}"[-63:]}})
        for number, (name, middle) in enumerate((name, middle) for name in names for middle in "ab")
    )
    width = WIDTHS["ieee-column"]
    style: Any = settings(width.points, Face.SANS)
    with mpl.rc_context(style):
        figure = Drawing(made(home, FigureKind.SCATTER, x="coverage"), width).draw()
        figure.draw_without_rendering()
    (legend,) = figure.legends
    assert len({text.get_text() for text in legend.get_texts()}) == 8
    assert legend.get_window_extent().width <= figure.bbox.width


@pytest.fixture
def walked(records: Any, fill: Fill, tmp_path: Path) -> Path:
    """Two algorithms at two frame rates, three equal runs each, with their trajectories and usage."""

    def one(number: int) -> Any:
        folder = tmp_path / "runs" / "study" / f"run-{number:03d}"
        output = folder / "run" / "output"
        output.mkdir(parents=True)
        poses = "".join(f"{time} {time} {number // 3} 0 0 0 0 1\n" for time in range(5))
        (output / "trajectory.txt").write_text(poses)
        (output / "usage.csv").write_text("seconds,cores,resident_bytes\n0,1,1\n1,1,1\n")
        spec = {
            "datasetRef": {"name": "hall"},
            "algorithmRef": {"name": f"algorithm-{number // 6}"},
            "input": {"pace": "Lockstep", "frameRate": 5 * (1 + number // 3 % 2)},
            "repetition": number % 3,
        }
        values = {"trajectory": {"sha256": str(number // 3) * 64}}
        results = [records.result(ate={"rmse": 0.1 + number // 3}, **values)]
        own = {"voxelSize": 0.5 + number // 6}  # the default of each algorithm
        return records.run(number, spec=spec, parameters=own, folder=str(folder), results=results)

    return fill(one(number) for number in range(12))


@pytest.mark.parametrize("kind", [FigureKind.TRAJECTORIES, FigureKind.USAGE])
def test_a_figure_of_one_run_a_series_says_at_what_setting_and_takes_the_same_for_all(
    walked: Path, kind: FigureKind
) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(walked, kind)
    assert set(found.columns["input.frameRate"]) == {5}
    assert "median error of each series and panel with frame rate 5 Hz, one of 2 settings" in found.notes[0]
    legend = Drawing(found, WIDTHS["ieee-column"]).draw().legends[0]
    assert legend.get_title().get_text() == "frame rate 5 Hz"
    unequal = made(walked, kind, where="not (algorithm == 'algorithm-0' and input.frameRate == 5)")
    assert unequal.series == ("algorithm-0", "algorithm-1")
    one_each = made(
        walked,
        kind,
        where="algorithm == 'algorithm-0' and input.frameRate == 5"
        " or algorithm == 'algorithm-1' and input.frameRate == 10",
    )
    assert one_each.series == ("algorithm-0, frame rate 5 Hz", "algorithm-1, frame rate 10 Hz")
    assert "hall, algorithm-1, frame rate 10 Hz" in one_each.notes[1]


def test_each_line_differs_and_copies_are_left_out(walked: Path) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(walked, FigureKind.TRAJECTORIES, each=True)
    assert len(found.series) == len(marks(found, Line)) == 4
    assert "8 more have the same trajectory as one of them" in found.notes
    figure = Drawing(found, WIDTHS["ieee-column"]).draw()
    assert [text.get_text() for text in figure.legends[0].get_texts()][-2:] == ["start", "end"]
    rings = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert [line.get_xdata()[0] for line in rings] == [0.0] * 4


def test_panels_share_their_axes_and_name_them(published: Path) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(published, FigureKind.SCATTER)
    drawn = list(Drawing(found, WIDTHS["ieee-page"]).draw().axes)
    assert len(drawn) == len(found.panels) == 4
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in drawn}) == 1
    assert drawn[0].get_ylabel() == "ATE RMSE [m]"
    assert drawn[-1].get_xlabel() == "mean CPU load [cores]"


def test_boxes_hold_every_run_that_counts(study: Path) -> None:
    found = made(study, FigureKind.BOX, by="algorithm")
    assert found.x.categories == ("dataset-0", "dataset-1", "dataset-2")
    dots = [mark for mark in marks(found, Dots) if mark.series == 0]
    assert sorted(dots[0].y.tolist()) == pytest.approx([0.02, 0.02, 0.021, 0.021])
    assert [mark.count for mark in marks(found, MissingMark)] == [2]
    assert sum(row for row in found.columns["drawn"]) == 24
    assert len(found.columns["run"]) == 26


def test_many_runs_are_a_box(forty: Path) -> None:
    found = made(forty, FigureKind.BOX)
    (box,) = marks(found, Box)
    assert len(box.values) == 42
    (outside,) = marks(found, Dots)
    assert sorted(outside.y.tolist()) == [44.0, 45.0]


def test_tiles_are_medians_and_failures_are_crosses(study: Path) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(
        study, FigureKind.HEAT, x="dataset", y="algorithm", where="dataset != 'dataset-2' or coverage is null"
    )
    (tiles,) = marks(found, Tiles)
    assert tiles.values[0, :2].tolist() == pytest.approx([0.0205, 0.0305])
    assert tiles.texts[0][2] == "×"
    assert tiles.texts[1][2] == ""
    assert found.colour is not None
    assert found.colour.label == "ATE RMSE [m]"
    figure = Drawing(found, WIDTHS["ieee-page"]).draw()
    image = figure.axes[0].images[0]
    low, high = (sum(image.cmap(end)[:3]) for end in (0.0, 1.0))
    assert low > high  # large errors are dark, to be seen on white
    more = replace(found, colour=replace(found.colour, better=Better.HIGHER))
    image = Drawing(more, WIDTHS["ieee-page"]).draw().axes[0].images[0]
    assert sum(image.cmap(1.0)[:3]) == low


def test_a_number_has_the_same_colour_in_figures_on_pages_and_in_reports() -> None:
    def colours(script: str) -> list[str]:
        text = (ROOT / script).read_text(encoding="utf-8")
        return [
            "#" + "".join(f"{int(part):02x}" for part in found)
            for found in re.findall(r"\[(\d+), (\d+), (\d+)\],", text)
        ]

    assert colours("operator/slamhive/dashboard/static/core/scale.js") == list(SCALE)
    assert colours("evaluator/slamhive_eval/assets/report.js")[::2] == list(SCALE)


@pytest.mark.parametrize(
    ("file", "part"),
    [
        ("operator/slamhive/dashboard/static/core/chart.js", "COLOURS = "),
        ("operator/slamhive/reporting/report.css", "@media print"),
        ("evaluator/slamhive_eval/assets/report.css", "--line"),
        ("evaluator/slamhive_eval/reports/figures.py", "COLOURS = "),
    ],
)
def test_the_second_series_of_a_figure_has_its_colour_on_pages_and_in_reports_too(
    file: str, part: str
) -> None:
    text = (ROOT / file).read_text(encoding="utf-8").partition(part)[2]
    series = re.findall(r"(?:'|\"|--c\d: )(#[0-9a-f]{6})", text)[:6]
    assert series == [Style(number).colour for number in range(6)]


def test_an_ecdf_ends_where_runs_failed(study: Path) -> None:
    found = made(study, FigureKind.ECDF, by="algorithm", where="dataset == 'dataset-2'", facet="dataset")
    better, worse = marks(found, Line)
    assert better.y[-1] == pytest.approx(4 / 6)
    assert worse.y[-1] == 1.0
    assert better.x[1:5].tolist() == pytest.approx([0.04, 0.04, 0.041, 0.041])
    assert "a line may end below 1" in found.notes[0]


def test_every_line_of_an_ecdf_goes_on_to_the_end_of_the_axis(study: Path) -> None:
    from slamhive.figures.drawing import Drawing

    found = made(study, FigureKind.ECDF, by="algorithm", where="dataset == 'dataset-2'", facet="dataset")
    axes = Drawing(found, WIDTHS["ieee-column"]).draw().axes[0]
    assert [line.get_xdata()[-1] for line in axes.lines if len(line.get_xdata()) > 2] == [
        axes.get_xlim()[1]
    ] * 2


def test_a_front_says_who_has_no_mark_as_none_of_its_runs_counts(records: Any, fill: Fill) -> None:
    home = fill([records.run(0), records.run(1, results=[records.result(outcome=Outcome.LOST)])])
    caption = ". ".join(made(home, FigureKind.PARETO, x="usage.cpu.meanCores", by="algorithm").notes)
    assert "without a mark, as no run that counts has a cost: " in caption
    assert "crossed above" not in caption
    assert "n = 1 tracked run of 2; left out: 1 Lost" in caption


def test_lines_have_ticks_at_the_values_that_are_drawn_alone(records: Any, fill: Fill) -> None:
    def run(number: int, dataset: str, size: float) -> Any:
        spec = {"datasetRef": {"name": dataset}, "parameters": {"voxelSize": size}}
        return records.run(number, spec=spec)

    home = fill([run(0, "hall", 1.0), run(2, "hall", 2.0), run(4, "yard", 1.5)])
    found = made(home, FigureKind.LINES, x="voxelSize")
    assert [panel.title for panel in found.panels] == ["hall"]
    assert found.x.ticks == (1.0, 2.0)


def test_runs_that_the_machine_ended_are_in_no_ecdf(records: Any, fill: Fill) -> None:
    home = fill([*(records.run(2 * number) for number in range(6)), records.failed(12, reason="SystemFault")])
    found = made(home, FigureKind.ECDF, by="algorithm", facet="")
    assert all(line.y[-1] == 1.0 for panel in range(len(found.panels)) for line in marks(found, Line, panel))


def test_a_front_goes_through_what_none_beats(study: Path) -> None:
    found = made(
        study, FigureKind.PARETO, x="usage.cpu.meanCores", y="ate.rmse", where="dataset == 'dataset-0'"
    )
    way = next(mark for mark in marks(found, Line) if mark.series < 0)
    assert (way.x.tolist(), way.y.tolist()) == ([1.5], pytest.approx([0.0205]))
    filled = [mark.series for mark in marks(found, Dots) if not mark.hollow[0]]
    assert filled == [0]


def test_where_large_is_good_shares_and_fronts_turn_round(records: Any, fill: Fill) -> None:
    shares = [0.5, 0.9, 0.6, 0.8, 0.7, 0.7]
    runs = [
        records.run(
            number,
            spec={"datasetRef": {"name": "hall"}},
            results=[records.result(points={"share": share})],
            usage={"cpu": {"seconds": 1.0 + number % 2}},
        )
        for number, share in enumerate(shares)
    ]
    home = fill([*runs, records.failed(6, spec={"datasetRef": {"name": "hall"}})])
    found = made(home, FigureKind.ECDF, x="points.share", by="algorithm")
    first, _ = marks(found, Line)
    assert first.x.tolist() == pytest.approx([0.7, 0.7, 0.6, 0.5])
    assert first.y.tolist() == pytest.approx([0, 0.25, 0.5, 0.75])
    assert first.onward == -1
    assert "have at least this share of control points met" in found.notes[0]
    front = made(home, FigureKind.PARETO, x="usage.cpu.seconds", y="points.share")
    way = next(mark for mark in marks(front, Line) if mark.series < 0)
    assert (way.x.tolist(), way.y.tolist()) == ([1.0, 2.0], pytest.approx([0.55, 0.8]))
    back = made(home, FigureKind.PARETO, x="points.share", y="usage.cpu.seconds")
    way = next(mark for mark in marks(back, Line) if mark.series < 0)
    assert (way.x.tolist(), way.y.tolist()) == (pytest.approx([0.8, 0.6]), [2.0, 1.0])


def test_repetitions_are_those_of_one_configuration(study: Path) -> None:
    found = made(study, FigureKind.REPETITIONS, where="dataset == 'dataset-0'")
    assert len(found.y.categories) == 4
    assert all(sorted(mark.x.tolist()) in ([0.02, 0.021], [0.04, 0.041]) for mark in marks(found, Dots))


def test_errors_over_time_are_those_of_the_evaluation(published: Path) -> None:
    found = made(published, FigureKind.ERROR_OVER_TIME, where="run == 126 or run == 1")
    frame = choose(read_archive(archive_url(published)), Selection(where="run == 126 or run == 1")).frame
    whole = dict(zip(frame.column("run").tolist(), frame.column("ate.rmse").tolist(), strict=True))
    for run in set(found.columns["run"]):
        errors = [
            error
            for error, one in zip(found.columns["error"], found.columns["run"], strict=True)
            if one == run
        ]
        # Of at most a thousand of its poses.
        assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(whole[run], rel=0.1)
    assert min(found.columns["t"]) >= 0


def test_paths_lie_over_their_ground_truth(published: Path) -> None:
    found = made(published, FigureKind.TRAJECTORIES, where="algorithm == 'orb-slam3'")
    assert found.truth
    assert found.equal
    assert [panel.title for panel in found.panels] == ["mh-01-easy", "mh-02-easy", "mh-03-medium"]
    assert all(panel.marks[0].series == -1 for panel in found.panels if isinstance(panel.marks[0], Line))
    each = made(published, FigureKind.TRAJECTORIES, where="algorithm == 'orb-slam3'", each=True)
    assert each.runs >= found.runs
    side = made(published, FigureKind.TRAJECTORIES, where="run == 126", y="z")
    assert side.y.label == "z [m]"


def test_a_run_that_took_over_a_result_has_the_files_of_the_other(
    records: Any, fill: Fill, tmp_path: Path
) -> None:
    folder = tmp_path / "runs" / "study" / "run-000"
    (folder / "run" / "output").mkdir(parents=True)
    (folder / "run" / "output" / "usage.csv").write_text(
        "seconds,cores,resident_bytes\n" + "".join(f"{time / 10},1.5,1048576\n" for time in range(20))
    )
    first = records.run(0, folder=str(folder), sweep="first", finished="2026-01-01T00:00:00Z")
    taken = records.run(12, sweep="study", provenance={"reusedFrom": first.uid})
    home = fill([first, taken])
    found = made(home, FigureKind.USAGE, where="sweep == 'study'")
    assert found.columns["memory"][0] == 1.0
    assert set(found.columns["cpu"]) == {1.5}


def test_greys_tell_series_apart() -> None:
    styles = [Style(number) for number in range(12)]
    assert len({(style.colour, style.mark, str(style.dashes)) for style in styles}) == 12
    assert len({style.mark for style in styles}) == 12
    greys = [
        sum(w * int(one.colour[at : at + 2], 16) for w, at in ((0.3, 1), (0.59, 3), (0.11, 5)))
        for one in styles[:7]
    ]
    assert all(abs(a - b) > 15 for a, b in pairwise(greys))


def test_the_same_data_give_the_same_file(study: Path, slamhive: Slamhive, tmp_path: Path) -> None:
    contents = []
    for form in ("pdf", "svg", "png", "pdf", "svg", "png"):
        code, _, err = slamhive(study, "figure", "box", "-o", tmp_path / f"same.{form}")
        assert code == 0, err
        contents.append((tmp_path / f"same.{form}").read_bytes())
    assert contents[:3] == contents[3:]
    assert b"slamhive figure box -o" in contents[1]
    assert b"data revision" in contents[1]
    assert b"slamhive figure box -o" in contents[2]


@pytest.mark.parametrize("font", ["sans", "serif"])
def test_names_are_no_formulas(assorted: Path, slamhive: Slamhive, tmp_path: Path, font: str) -> None:
    words = ["figure", "scatter", "-o", tmp_path / "odd.pdf", "--by", "algorithm", "--font", font]
    code, _, err = slamhive(assorted, *words, "--where", "dataset == 'dataset-0' or dataset == 'dataset-1'")
    assert code == 0, err


@pytest.mark.parametrize("name", ["$x^2$", "_hidden", "\\frac{", "%s {0}", "日本", "a\nb\x00"])
def test_any_name_can_be_drawn(
    records: Any, fill: Fill, slamhive: Slamhive, tmp_path: Path, name: str
) -> None:
    home = fill(
        records.run(number, spec={"algorithmRef": {"name": f"{name}{number % 2}"}}) for number in range(6)
    )
    code, _, err = slamhive(home, "figure", "box", "-o", tmp_path / "name.svg", "--by", "algorithm")
    assert code == 0, err


@pytest.mark.parametrize("form", ["pdf", "svg", "png"])
def test_each_figure_is_drawn_once(study: Path, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = pytest.importorskip("matplotlib.figure")
    from slamhive.figures.rendering import rendered

    drawn, draw = [], figures.Figure.draw
    monkeypatch.setattr(figures.Figure, "draw", lambda *given: (drawn.append(1), draw(*given)))
    paper = Paper(parse_width("ieee-column"), None)
    assert rendered(made(study, FigureKind.BOX).settled(), paper, form, {})
    assert len(drawn) == 1


def test_widths_are_those_of_columns() -> None:
    assert parse_width("ieee-column").inches == pytest.approx(3.5)
    assert parse_width("88mm").millimetres == 88
    assert parse_width("8.8cm") == parse_width("88mm")
    assert parse_width("3.5in").inches == pytest.approx(3.5)
    assert parse_width("slide").points > parse_width("springer").points


@pytest.fixture
def in_folder(slamhive: Slamhive, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Slamhive:
    """The command in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    return slamhive


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["scatter", "--where", "coverage > 2"], "no run is meant: there is nothing to draw"),
        (["scatter", "-x", "usage.cpu.meanCors"], "--x: unknown column 'usage.cpu.meanCors'; did you mean"),
        (["scatter", "-y", "algorithm"], "--y: algorithm: a column of numbers is needed"),
        (["scatter", "-y", "relations.translation.rmse"], "--y: unknown column"),
        (["scatter", "-y", "ate.rmse:km"], "ate.rmse:km: 'km' is neither a unit"),
        (["lines", "--facet", "seed"], "--facet: seed has 26 values, and a figure has at most 12 panels"),
        (["lines", "--by", "seed"], "--by: seed: 26 series, and at most 12 can be told apart"),
        (["scatter", "--by", "colour"], "--by: unknown column 'colour'"),
        (["scatter", "-o", "/nowhere/fig.pdf"], "--output: /nowhere/fig.pdf: there is no folder /nowhere"),
        (
            ["scatter", "-o", "fig.jpg"],
            "--output: fig.jpg: a figure's name ends in .pdf, .svg, .png, not in '.jpg'",
        ),
        (
            ["scatter", "-o", "fig"],
            "--output: fig: a figure's name ends in .pdf, .svg, .png, and this name has no",
        ),
        (
            ["scatter", "--width", "ieee"],
            "--width: 'ieee' is neither a measure such as 88mm, 3.5in nor a name; did",
        ),
        (["scatter", "--width", "9m"], "--width: '9m' is neither a measure"),
        (["scatter", "--width", "9mm"], "--width: 9mm: a figure is 40 to 1000 mm wide"),
        (["scatter", "--height", "1e3mm"], "--height: '1e3mm': expected 20mm to 1000mm"),
        (["heat", "-x", "dataset", "-y", "dataset"], "--y: dataset stands along x already"),
        (["ecdf", "-y", "ate.rmse"], "--y: an ECDF has the share of runs along y; --x names what it is of"),
        (["pareto", "--facet", "dataset"], "--facet: a front has a panel for each dataset"),
        (["repetitions", "--where", "repetition == 0"], "no configuration has more than one run that counts"),
        (["trajectories", "-x", "w"], "--x: 'w': a path is drawn along x, y or z"),
        (["trajectories"], "no run has files here to draw: run-000: its folder is not here"),
        (["usage", "-y", "disk"], "--y: 'disk': usage over time is cpu or memory"),
        (["box", "--each"], "--each: every run is drawn by trajectories, error-over-time and usage"),
        (["scatter", "--sweep", "x"], "--sweep: unknown sweep 'x'; known: later, study"),
    ],
)
def test_mistakes(study: Path, in_folder: Slamhive, tmp_path: Path, words: list[str], sentence: str) -> None:
    code, out, err = in_folder(study, "figure", *words)
    assert (code, out) == (2, "")
    assert " ".join(err.split()).startswith(f"error: {sentence}")
    assert not [path for path in tmp_path.iterdir() if path.suffix in {".pdf", ".csv"}]


def test_a_figure_over_runs_that_all_failed(
    records: Any, fill: Fill, slamhive: Slamhive, tmp_path: Path
) -> None:
    home = fill(
        [
            records.run(0),
            *(records.run(number, results=[records.result(outcome=Outcome.LOST)]) for number in (1, 3)),
        ]
    )
    for kind in ("scatter", "lines", "box", "heat", "pareto", "ecdf"):
        words = ["figure", kind, "--where", "outcome == 'Lost'", "-o", tmp_path / "x.pdf"]
        code, _, err = slamhive(home, *words)
        assert code == 2
        assert "there is nothing to draw; --outcomes all takes all runs that were evaluated" in " ".join(
            err.split()
        )
        assert slamhive(home, *words, "--outcomes", "all")[0] == 0


def test_without_matplotlib_a_sentence(
    study: Path, slamhive: Slamhive, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, _, err = slamhive(study, "figure", "box", "-o", tmp_path / "x.pdf")
    assert code == 2
    told = f"a figure needs the package matplotlib, of the extra plot: {how_to_install('plot')}"
    assert told in " ".join(err.split())


def test_limits_are_settled_over_all_panels() -> None:
    def panel(*numbers: float) -> Panel:
        return Panel("", (Dots(0, np.array(numbers), np.array(numbers)),))

    whole = Picture(
        PictureAxis("x"), PictureAxis("y"), (panel(1, 2), panel(3, 900)), ("",), (), {}, 4
    ).settled()
    assert whole.x.log
    assert whole.x.limits is not None
    assert (whole.x.limits.low, whole.x.limits.high) == pytest.approx((1, 900))


def test_outcomes_all_draws_them_hollow(study: Path) -> None:
    found = made(study, FigureKind.SCATTER, x="coverage", by="algorithm", outcomes=Outcomes.ALL)
    assert sum(sum(mark.hollow) for number in range(3) for mark in marks(found, Dots, number)) == 1
    with pytest.raises(InputError, match=r"^outcomes: the spread of repetitions"):
        made(study, FigureKind.REPETITIONS, outcomes=Outcomes.ALL)


def test_one_path_has_its_name_and_matplotlib_says_nothing(caplog: pytest.LogCaptureFixture) -> None:
    from slamhive.figures.drawing import Drawing
    from slamhive.figures.rendering import rendered

    path = np.linspace(0.0, 9.0, 20)
    axis = PictureAxis("x [m]", log=False, robust=False)
    found = Picture(
        axis,
        axis,
        (Panel("", (Line(-1, path, path**2), Line(0, path, path**2))),),
        ("",),
        (),
        {},
        1,
        equal=True,
        truth=True,
    ).settled()
    legend = Drawing(found, WIDTHS["ieee-column"]).draw().legends[0]
    assert [text.get_text() for text in legend.get_texts()] == ["ground truth", "estimate", "start", "end"]
    assert rendered(found, Paper(WIDTHS["ieee-column"]), "pdf", {}).startswith(b"%PDF")
    assert not caplog.records


def test_systems_that_differ_in_the_middle_of_their_names_are_told_apart() -> None:
    from slamhive.figures.drawing import told_apart

    texts = [
        "icp, rgbd, evaluation se3",
        *(f"orb-slam3-smallvoc, {one}, evaluation se3" for one in ("rgbd", "stereo")),
    ]
    assert told_apart(texts, 24) == [
        "icp, rgbd, e…luation se3",
        "orb-slam3-smallvoc…rgbd…",
        "orb-slam3-smallv…stereo…",
    ]
    assert told_apart(texts, 60) == texts
