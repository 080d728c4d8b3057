# SPDX-License-Identifier: Apache-2.0
"""Questions that a site has answers to: what its pages ask by themselves, and by choices that can be counted.

Points, runs and their orders aren't among them: those are taken of ``dashboard/publishing/table.py``.
``tests/dashboard_pages/test_publishing.py`` walks the pages, so that what one asks anew is missed there.
"""

from __future__ import annotations

import json
import re
from importlib.resources import files
from itertools import product
from typing import TYPE_CHECKING, Any

from slamhive.dashboard.publishing.asking import address, escaped

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    View = tuple[tuple[str, str], ...]

_DEFAULTS: dict[str, Any] = json.loads(
    files("slamhive.dashboard").joinpath("static", "core", "defaults.json").read_bytes()
)
"""Choices that pages begin with, as they read them themselves."""

API = "/api/v1"
ANALYSIS = f"{API}/analysis"
*COMPETITORS, VERSIONS = (by for by, _ in _DEFAULTS["competitors"])
ERROR = "ate.rmse"
_LOADS = (_DEFAULTS["cpu"]["unpaced"], _DEFAULTS["cpu"]["paced"])
MEASURES = (
    *(ERROR, "usage.memory.peakBytes", "rpe[0].rmse", "coverage"),
    *("beside.online.ate.rmse", "metrics.latencySeconds.p95"),
)
MOST_VIEWS = 60
"""Sweeps, datasets and algorithms that have leaderboards and studies of their own."""

MANY = 3000
"""Rows up to which every configuration is a group where nobody says by what: of more there are too many."""

MOST_SETTINGS = 6
MOST_VALUES = 40
MOST_GROUPED = 3
"""Figures over groups by each setting: an error and two costs."""

MOST_TOLD = 3
"""Settings that leaderboards are over and link to, as pages/leaderboard.js does it."""

MOST_CROSSED = 3
"""Settings that are crossed with algorithms and datasets: such groups are many."""

_SETTINGS = frozenset({"parameters", "input", "resources"})
_NUMBERS = frozenset({"number", "integer"})
_SUBJECTS: list[str] = _DEFAULTS["subject"]
_FEATURES = re.compile(_DEFAULTS["features"], re.IGNORECASE)


class AskedColumns:
    """Columns of some runs, by what is asked of them.

    Attributes:
        measures: figures that drawings are made of.
        axis: what Explore draws over by itself, as a list of one, if groups can be told by it.
        settings: settings that vary over few values, the most varied first.
        rows: how many there are.
        features: the parameter that is a number of features, if one varies.
        tags: of runs.
        superseded: whether there are runs of earlier versions.

    Args:
        answer: of /api/v1/columns.
    """

    def __init__(self, answer: Mapping[str, Any]) -> None:
        self._items = {one["name"]: one for one in answer["items"]}
        known = [name for name in MEASURES if self._count(name)]
        played = "Realtime" in self.names("input.pace")  # as cpuColumn of core/format.js
        cpu = next((name for name in _LOADS[played:] if self._count(name)), None)
        self.measures = [*known[:1], *([cpu] if cpu else []), *known[1:]]
        self.varied = [
            name
            for name in answer["varied"]
            if self._items[name]["kind"] in _NUMBERS and self._items[name]["distinct"] > 1
        ]
        # As pages/explore.js begins: a setting that some runs lack would leave those out.
        whole = [name for name in self._items if name in self.varied and self._count(name) == answer["rows"]]
        whole.sort(key=lambda name: -self._items[name]["distinct"])
        axis = [*whole, *([cpu] if cpu and self.varies(cpu) else [])][:1]
        self.axis = [name for name in axis if self._items[name]["distinct"] <= MOST_VALUES]
        asked = [one for one in answer["items"] if one["group"] in _SETTINGS]
        asked = [one for one in asked if 1 < one["distinct"] <= MOST_VALUES]
        asked.sort(key=lambda one: (one["name"] not in self.varied, -one["distinct"]))
        self.settings = [one["name"] for one in asked[:MOST_SETTINGS]]
        self.features = [name for name in self._items if _FEATURES.fullmatch(name) and self.varies(name)][:1]
        self.tags = sorted(
            {str(tag) for one in self._items.get("tags", {}).get("values") or [] for tag in one["value"]}
        )
        self.rows = int(answer["rows"])
        self.superseded = bool(self._count("superseded"))

    def _count(self, name: str) -> int:
        return int(self._items.get(name, {}).get("count", 0))

    def varies(self, name: str) -> bool:
        """Tell whether a column has several values."""
        return bool(self._items.get(name, {}).get("distinct", 0) > 1)

    def names(self, name: str) -> list[str]:
        """Return the values of a column of few values, those of most runs first."""
        values = sorted(self._items.get(name, {}).get("values") or [], key=lambda one: -one["count"])
        return [str(one["value"]) for one in values]


def general(names: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Go through what is asked of all that there is.

    Args:
        names: of algorithms, datasets and sweeps, by what the API calls them.
    """
    yield from (API, f"{API}/columns")
    for kind, known in names.items():
        yield f"{API}/{kind}"
        for name in known:
            yield f"{API}/{kind}/{escaped(name)}"
            if kind == "datasets":
                yield f"{API}/{kind}/{escaped(name)}/overview"
            if kind == "sweeps":
                yield address(f"{API}/{kind}/{escaped(name)}/search")
    yield f"{API}/evaluations"


def views(columns: AskedColumns, sweeps: Sequence[str]) -> list[View]:
    """Return the filters that pages lead to: none, each sweep, each dataset, each algorithm."""
    each = [("sweep", name) for name in sweeps]
    each += [(name, value) for name in ("dataset", "algorithm") for value in columns.names(name)]
    return [(), *((one,) for one in each[:MOST_VIEWS])]


def of_view(view: View, columns: AskedColumns) -> Iterator[str]:
    """Go through what is asked of the runs that some filters mean, by the pages themselves."""
    tracked = ("outcomes", "tracked")
    yield address(f"{ANALYSIS}/published", *view)
    for by in COMPETITORS if not view else COMPETITORS[:1]:
        yield address(f"{ANALYSIS}/leaderboard", *view, ("metric", ERROR), ("by", by), tracked)
        yield address(f"{ANALYSIS}/compare", *view, ("metric", ERROR), ("by", by), tracked)
        yield address(f"{ANALYSIS}/common", *view, ("by", by), ("outcomes", "all"))
    for name in ("importance", "repeatability"):
        yield address(f"{ANALYSIS}/{name}", *view, ("metric", ERROR))
    of_sweep = bool(view) and view[0][0] == "sweep"
    suspects = ("suspects", "suspects/nodes", "suspects/truth")
    for name in ("robustness", *suspects, *(["timeline"] if of_sweep or not view else [])):
        yield address(f"{ANALYSIS}/{name}", *view)
    yield address(f"{ANALYSIS}/versions", *view, ("metric", ERROR), tracked)
    if columns.rows <= MANY:
        yield address(f"{ANALYSIS}/aggregate", *view, ("metrics", ERROR), tracked)
    apart = columns.varies("dataset")
    for by in ("algorithm", *columns.axis):
        joined = ",".join(dict.fromkeys([by, "algorithm"]))
        yield address(f"{ANALYSIS}/aggregate", *view, ("by", joined), ("metrics", ERROR), tracked)
    if of_sweep:
        for setting, metric in product(columns.varied[:4], columns.measures[:4]):
            by = f"{setting},dataset" if apart else setting
            yield address(f"{ANALYSIS}/aggregate", *view, ("by", by), ("metrics", metric), tracked)


def of_all(columns: AskedColumns) -> Iterator[str]:
    """Go through what is asked of all runs, by the choices that pages offer."""
    for metric in columns.measures:
        yield from _of_metric(columns, metric, ("outcomes", "tracked"))
        yield address(f"{ANALYSIS}/importance", ("metric", metric))
        yield address(f"{ANALYSIS}/repeatability", ("metric", metric))
    for metric in columns.measures[:MOST_GROUPED]:
        for by in _groups(columns, metric):
            asked_by = ("by", ",".join(by))
            yield address(f"{ANALYSIS}/aggregate", asked_by, ("metrics", metric), ("outcomes", "tracked"))
    yield from _of_metric(columns, ERROR, ("outcomes", "all"))
    for cost in columns.measures[1:]:
        yield address(f"{ANALYSIS}/pareto", ("x", cost), ("y", ERROR), ("by", "algorithm,sensors"))
    if columns.superseded:
        yield address(f"{API}/columns", ("superseded", "1"))
        asked = ("superseded", "1"), ("metric", ERROR), ("by", VERSIONS), ("outcomes", "tracked")
        yield address(f"{ANALYSIS}/leaderboard", *asked)
        yield address(f"{ANALYSIS}/compare", *asked)
    yield from _with_conditions(columns)


def told_apart(ranks: Mapping[str, Any] | None) -> Iterator[str]:
    """Go through what the first leaderboard leads to: a setting that its rows are over tells them apart.

    Args:
        ranks: that leaderboard; None where it is refused.
    """
    for name in list((ranks or {}).get("pooled") or ())[:MOST_TOLD]:
        asked = ("metric", ERROR), ("by", f"{COMPETITORS[0]},{name}"), ("outcomes", "tracked")
        yield address(f"{ANALYSIS}/leaderboard", *asked)
        yield address(f"{ANALYSIS}/compare", *asked)


def _of_metric(columns: AskedColumns, metric: str, outcomes: tuple[str, str]) -> Iterator[str]:
    asked = ("metric", metric)
    yield address(f"{ANALYSIS}/leaderboard", asked, ("by", COMPETITORS[0]), outcomes)
    yield address(f"{ANALYSIS}/compare", asked, ("by", COMPETITORS[0]), outcomes)
    yield address(f"{ANALYSIS}/slices", asked, outcomes)
    if columns.rows <= MANY:
        yield address(f"{ANALYSIS}/aggregate", ("metrics", metric), outcomes)
    for by in ("algorithm", "sensors", "algorithm,dataset"):
        yield address(f"{ANALYSIS}/ecdf", ("by", by), asked, outcomes)
    yield address(f"{ANALYSIS}/ecdf", ("by", "algorithm"), ("over", "dataset"), asked, outcomes)
    for setting, other in product(columns.settings[:3], [*columns.settings[:3], "algorithm"]):
        if setting != other:
            yield address(f"{ANALYSIS}/surface", ("x", setting), ("y", other), asked, outcomes)


def _with_conditions(columns: AskedColumns) -> Iterator[str]:
    """Go through what ready questions and the paper's tables ask under conditions of their own."""
    for name, apart in product(columns.features, (True, False)):
        by = f"{name},dataset" if apart and columns.varies("dataset") else name
        loads = [*columns.measures[1:2], "usage.memory.peakBytes"]
        asked = ("where", f"{_quoted(name)} is not null"), ("by", by)
        for metrics in (ERROR, ",".join([ERROR, *loads])):
            yield address(f"{ANALYSIS}/aggregate", *asked, ("metrics", metrics), ("outcomes", "tracked"))
    if "slam-hive" in columns.names("label.source"):
        for names in (one["settings"] for one in _DEFAULTS["papersTables"]):
            chosen = ((name, names[name]) for name in ("where", "by", "metrics", "outcomes"))
            yield address(f"{ANALYSIS}/aggregate", *chosen)


def conditions(columns: AskedColumns) -> list[str]:
    """Return the conditions that pages put by themselves, as they put them."""
    found = [one["settings"]["where"] for one in _DEFAULTS["papersTables"]]
    found += ["superseded is not null", *_DEFAULTS["played"]]
    found += [f"{_quoted(name)} is not null" for name in columns.features]
    return found + [f"tags contains '{tag}'" for tag in columns.tags]


def _quoted(name: str) -> str:
    """Return a column's name as it stands in a condition, as core/questions.js does it."""
    return name if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.]*", name) else f"`{name}`"


def _groups(columns: AskedColumns, metric: str) -> Iterator[tuple[str, ...]]:
    """Go through the columns that lines, boxes, heat maps and small multiples tell groups apart by."""
    subjects = [name for name in _SUBJECTS if columns.varies(name)] or ["algorithm"]
    for name in dict.fromkeys([*subjects, "algorithm"]):
        yield (name,)
        for other in subjects:
            if other != name:
                yield (name, other)
    for setting in columns.settings:
        yield (setting,)
        for name in ("algorithm", "dataset"):
            yield (setting, name)
    for setting in columns.settings[:MOST_CROSSED] if metric == ERROR else ():
        yield (setting, "algorithm", "dataset")
