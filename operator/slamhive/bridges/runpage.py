# SPDX-License-Identifier: Apache-2.0
"""One run as a page to share: what it was, its path over the truth, errors, load, and how to repeat it.

The page needs nothing but itself. Its plots are those of the evaluator's report, whose script is the only one
that its content security policy lets run.
"""

from __future__ import annotations

import importlib.resources
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive import __version__
from slamhive.analysis.derived import PACE
from slamhive.analysis.measures import CAUSAL
from slamhive.model.algorithm import Pace
from slamhive.model.base import API_VERSION
from slamhive.reporting.charts import time_chart
from slamhive.reporting.markup import Markup, clip, element, joined, parse_metric
from slamhive.reporting.page import document
from slamhive.reporting.sections import figure
from slamhive.reporting.tables import notes_html
from slamhive.reporting.titles import column_title
from slamhive.runfiles.clocks import configuration_of
from slamhive.runfiles.errors import RunFileError
from slamhive.runfiles.trajectories import drawn, extrinsic_of, read_poses, usage_columns
from slamhive.tables.text import value_text
from slamhive.tables.timeliness import FACTOR, LATENCIES, late_note
from slamhive_eval import Trajectory
from slamhive_eval.reports.report import KINDS, as_script_data, bin_edges, curves, truth_data

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.bridges.places import Here
    from slamhive.model.results import Result, RunRecord

_MOST_POSES = 20_000
_MOST_SAMPLES = 300
_MIB = 2.0**-20
_CORES = "usage.cpu.meanCores"
"""Says little of a run whose pace the clock did not set: the algorithm has as much time as it wants."""

_UNTIMED = {pace.value for pace in Pace if pace is not Pace.REALTIME}
_WHAT = ("algorithm", "sensors", "dataset", "sweep", "repetition", "seed")
_SETTINGS = {name: name for name in ("parameters", "input", "resources")} | {
    "dataset.attributes": "the dataset's",
    "label": "labels",
}
"""Families of settings, whose names say little alone, and what each is called."""
_NUMBERS = (
    *("outcome", "coverage", "alignment", "ate.rmse", f"{CAUSAL}ate.rmse", "ate.max", "rpe[0].rmse"),
    *("rpe[0].rotationDeg.rmse", *LATENCIES, FACTOR),
    *("scale", "usage.cpu.secondsPerDataSecond", _CORES, "usage.memory.peakBytes"),
    *("usage.wallSeconds", "frames.offered", "frames.dropped"),
)
_LEFT_OUT = ("id", "folder", "trajectory.path", "transform")
"""Columns that mean something on this machine alone, and a matrix that nobody reads."""

_SECTIONS = """<section aria-labelledby="h-paths"><h2 id="h-paths">Path over the truth</h2>
<div class="controls"><div id="legend" role="group" aria-label="Show estimates"></div></div>
<p id="scale" hidden></p><div class="grid" id="paths"></div></section>
<section aria-labelledby="h-errors"@HIDDEN@><h2 id="h-errors">Errors</h2>
<div id="kinds" role="group" aria-label="Kind of error"></div>
<p id="readout" aria-live="polite">Point at a curve to read it; the place is marked on the paths.</p>
<div class="grid" id="errors"></div>
<div id="statistics" tabindex="0" role="region" aria-label="Statistics"></div></section>"""


def run_page(
    record: RunRecord, here: Here, rows: Sequence[dict[str, Any]], evaluation: str | None, title: str | None
) -> str:
    """Return the page of a run.

    Args:
        record: the run.
        here: where its files are.
        rows: all that is known of it, by column, one row an evaluation.
        evaluation: which of them is shown; None for the first.
        title: heading of the page; None for the run's name.
    """
    result = next((one for one in record.results if evaluation in {None, one.evaluation}), None)
    row = next((row for row in rows if result is None or row["evaluation"] == result.evaluation), rows[0])
    data, notes = _path(record, here, result)
    load, lost = _load(record, here)
    held = [name for name, value in row.items() if value is not None]
    numbers = [name for name in _NUMBERS if name in held]
    if row.get(PACE) in _UNTIMED:
        numbers = [name for name in numbers if name != _CORES]
    failed = [f"{record.phase}: {record.reason or ''} {record.message or ''}".strip()] if not result else []
    chosen = {kind: [name for name in held if name.startswith(f"{kind}.")] for kind in _SETTINGS}
    rest = [name for name in held if name not in {*_WHAT, *numbers, *chain(*chosen.values()), *_LEFT_OUT}]
    settings = [
        (_SETTINGS[kind], ", ".join(f"{name.removeprefix(f'{kind}.')} {_text(name, row)}" for name in names))
        for kind, names in chosen.items()
        if names
    ]
    header = element(
        "header", element("h1", clip(title or record.name, 300)), element("p", _subject(row), class_="quiet")
    )
    parts: list[Markup | None] = [
        element("h2", "Settings"),
        _facts([*_told(row, [name for name in _WHAT if name in held]), *settings]),
        element("h2", "Results"),
        _facts(_told(row, numbers)),
        notes_html([*failed, *filter(None, [late_note(record)]), *notes, *lost]),
        Markup(_SECTIONS.replace("@HIDDEN@", "" if data["kinds"] else " hidden")) if data else None,
        *load,
        *_again(record),
        element(
            "details", element("summary", "Hashes, machine, all other figures"), _facts(_told(row, rest))
        ),
    ]
    made = f"Made with slamhive {__version__}"
    body = [header, element("main", *parts), element("footer", element("p", made, class_="quiet"))]
    script = ""
    if data:
        body.append(element("script", Markup(as_script_data(data)), type="application/json", id="data"))
        assets = importlib.resources.files("slamhive_eval") / "assets"
        script = (assets / "report.js").read_text(encoding="utf-8")
    return document(title or record.name, joined(body), script)


def _subject(row: dict[str, Any]) -> str:
    on = f"{row.get('algorithm')} on {row.get('dataset')}"
    return f"{on}, sensors {row['sensors']}" if row.get("sensors") else on


def _text(name: str, row: dict[str, Any]) -> str:
    return value_text(parse_metric(name), row[name])


def _told(row: dict[str, Any], names: Iterable[str]) -> list[tuple[str, str]]:
    shown = list(names)
    return [(column_title(name, shown), _text(name, row)) for name in shown]


def _facts(facts: Iterable[tuple[str, str]]) -> Markup:
    both = ((element("dt", clip(name)), element("dd", clip(text, 1200))) for name, text in facts)
    return element("dl", *chain.from_iterable(both))


def _path(record: RunRecord, here: Here, result: Result | None) -> tuple[dict[str, Any], list[str]]:
    """Return the data of the plots, and sentences on what is missing; nothing where there is no path."""
    place = here.place(record)
    if place is None:
        return {}, ["its files are not here: there is no path to draw"]
    try:
        given = read_poses(place)
    except RunFileError as problem:
        return {}, [str(problem)]
    truth = here.truth(record)
    extrinsic = extrinsic_of(record, configuration_of(place), here.algorithms(), truth)
    found = drawn(given, result, truth, extrinsic, _MOST_POSES)
    every, reference = _trajectory(found["estimate"]), found["reference"]
    errors = found["estimate"]["error"]
    known = np.flatnonzero(~np.isnan(errors))
    estimate = every.select(known) if len(known) else every
    truth_path = _trajectory(reference) if reference is not None else None
    start = truth_path.stamps[0] if truth_path is not None else every.stamps[0]
    along = np.zeros(len(estimate))
    if truth_path is not None:
        along = np.interp(estimate.stamps, truth_path.stamps, truth_path.distances)
    measured = {"position": errors[known]} if len(known) else {}
    edges = {kind: bin_edges([one]) for kind, one in measured.items()}
    values = result.values if result is not None else {}
    entry = {
        "name": record.name,
        "outcome": str(result.outcome) if result is not None else "",
        "message": values.get("message"),
        "coverage": result.coverage if result is not None else 0.0,
        "scale": values.get("scale"),
        "notes": [],
        "poses": len(estimate),
        "statistics": {"position": values.get("ate")},
        "rpe": (values.get("rpe") or [])[:1],
        **curves(
            estimate, estimate.stamps - start, along, measured, edges, keyframes=bool(values.get("keyframes"))
        ),
    }
    name = "ground truth" if truth_path is not None else "no ground truth here"
    nothing = {"name": name, "path": [[], [], []], "breaks": []}
    return {
        "title": record.name,
        "kinds": {kind: dict(zip(("name", "unit"), KINDS[kind], strict=True)) for kind in measured},
        "edges": {kind: one.tolist() for kind, one in edges.items()},
        "reference": truth_data(truth_path, name) if truth_path is not None else nothing,
        "estimates": [entry],
    }, found["notes"]


def _trajectory(columns: dict[str, Any]) -> Trajectory:
    positions = np.stack([columns[axis] for axis in "xyz"], axis=1)
    still = np.tile((0.0, 0.0, 0.0, 1.0), (len(positions), 1))
    return Trajectory(columns["t"], positions, still, oriented=False)


def _load(record: RunRecord, here: Here) -> tuple[list[Markup], list[str]]:
    """Return charts of processors and memory over time, and sentences on what is missing."""
    place = here.place(record)
    if place is None:
        return [], []
    try:
        table = usage_columns(place, _MOST_SAMPLES)
    except RunFileError as problem:
        return [], [str(problem)]
    charts = [
        figure(what, time_chart(what, table["t"].tolist(), (table[name] * factor).tolist(), label))
        for what, name, factor, label in (
            ("Processors", "cpu", 1.0, "CPU load [cores]"),
            ("Memory", "memory", _MIB, "memory [MiB]"),
        )
    ]
    return [element("h2", "Load"), element("div", *charts, class_="grid")], []


def _again(record: RunRecord) -> list[Markup]:
    """Return the command that repeats the run, with its manifest."""
    if not {"algorithmRef", "datasetRef"} <= set(record.spec) or record.folder is None:
        return []
    spec = {name: value for name, value in record.spec.items() if value not in (None, {}, False)}
    manifest = {
        "apiVersion": API_VERSION,
        "kind": "MappingRun",
        "metadata": {"name": record.name},
        "spec": spec,
    }
    text = yaml.safe_dump(manifest, sort_keys=False, allow_unicode=True, width=100)
    names = (record.spec["algorithmRef"].get("name"), record.spec["datasetRef"].get("name"))
    needs = (
        f"Where the algorithm {names[0]} and the dataset {names[1]} are known, this as run.yaml, and then:"
    )
    return [
        element("h2", "Run it again"),
        element("p", clip(needs, 400), class_="quiet"),
        element("pre", text, tabindex="0"),
        element("pre", "slamhive run run.yaml --rerun"),
    ]
