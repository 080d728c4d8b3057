# SPDX-License-Identifier: Apache-2.0
"""Measures: the one table of what is known of each column, behind rankings, tables, pages, figures, reports.

A column such as ``ate.rmse`` is what people type. Its measure says what they call it where they read it, its
unit, whether small or large is good, and whether failed runs rank behind all others by it. Of a figure that
stands in no row here, as of somebody else's evaluator or in an algorithm's own ``metrics.json``, nothing of
that is known: it is shown, averaged and sorted under its own name, and nothing calls one value of it better.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from slamhive.model.sensors import Role
from slamhive_eval.statistics import STATISTICS

if TYPE_CHECKING:
    from collections.abc import Iterable

CAUSAL = "beside.online."
"""Beginning of the names of figures of the poses as they were first published."""

LATE_SECONDS = "lateSeconds"
"""Column of how late poses came in real time, where that is more than a few frames."""
UNDISTURBED = "usage.undisturbedSeconds"
"""Column of the wall time without the wait for processors that others used."""

CONFIGURATION = ("parameters.", "input.", "dataset.attributes.", "resources.")
"""Beginnings of the names of settings."""


class Better(StrEnum):
    """Direction in which a measure is better; none where nobody has said so."""

    LOWER = "lower"
    HIGHER = "higher"
    NONE = ""


@dataclass(frozen=True)
class Measure:
    """A column, or in the table several of one kind.

    Attributes:
        name: of the column. In the table ``[]`` stands for any number of a list, and ``.*`` for the
            statistics of an error, whose names and units follow from its own.
        text: what people call it, where there is room; empty for its name. In the table ``{0}`` is the number
            in a list, ``{1}`` that from 1 on with a space before it, nothing for the first.
        unit: of its numbers as they are stored; empty for a plain number, and for what isn't one.
        better: whether small or large is good.
        is_error: whether it is measured against the ground truth: an error, or if large is good an accuracy.
            A run that failed is worse than any number, and runs with the same trajectory have the same one.
        short: its name in the head of a table, where that is shorter.
        meaning: of its numbers, for the line beneath a table; ``{aligned}``, ``{over}`` and ``{reader}`` are
            what holds in that table's rows, with a space or comma in front. In the table ``{statistic}`` is
            that of an error.
    """

    name: str
    text: str = ""
    unit: str = ""
    better: Better = Better.NONE
    is_error: bool = False
    short: str = ""
    meaning: str = ""

    @property
    def sign(self) -> float:
        """Factor that makes a cost of a number, small is good: -1 where large is good, else 1."""
        return -1.0 if self.better is Better.HIGHER else 1.0


_PERTURBATIONS = (
    ("lidar.rangeNoise", "range noise", "m"),
    ("lidar.dropPoints", "share of points dropped", ""),
    ("lidar.sector", "sector without points", "°"),
    ("lidar.rain", "share of returns of rain", ""),
    ("lidar.dropScans", "share of scans dropped", ""),
    ("images.blur", "motion blur", "px"),
    ("images.motionBlur", "exposure that blurs", "ms"),
    ("images.noise", "image noise", "of 255"),
    ("images.gamma", "gamma", ""),
    ("images.exposureStep", "exposure step", "stops"),
    ("images.jpegQuality", "JPEG quality", ""),
    ("images.dropFrames", "share of frames dropped", ""),
    ("images.duplicateFrames", "share of frames duplicated", ""),
    ("images.occlusion", "share of image covered", ""),
    ("imu.accelerometerBias", "accelerometer bias", "m/s²"),
    ("imu.gyroscopeBias", "gyroscope bias", "rad/s"),
    ("imu.accelerometerNoise", "accelerometer noise", "m/s²"),
    ("imu.gyroscopeNoise", "gyroscope noise", "rad/s"),
    ("imu.accelerometerRange", "accelerometer range", "m/s²"),
    ("imu.gyroscopeRange", "gyroscope range", "rad/s"),
    ("imu.rate", "IMU rate", "Hz"),
    *((f"timeOffset.{role}", f"time offset of {role}", "s") for role in Role),
    *((f"drift.{role}", f"clock drift of {role}", "s/s") for role in Role),
    *((f"jitter.{role}", f"stamp jitter of {role}", "s") for role in Role),
    *((f"late.{role}", f"delay of delivery of {role}", "s") for role in Role),
    *((f"swapped.{role}", f"share of {role} out of order", "") for role in Role),
    *((f"rotation.{role}", f"told rotation of {role}", "°") for role in Role),
    *((f"translation.{role}", f"told translation of {role}", "m") for role in Role),
)
"""Perturbations below ``input.perturb``: column, text, unit."""

_NEES = (
    ("mean", "NEES of {} mean"),
    ("low", "NEES of {}, lower bound of its mean"),
    ("high", "NEES of {}, upper bound of its mean"),
    ("within95", "share of {}s within 95 %"),
    ("count", "poses with a covariance of {}"),
    ("withoutCovariance", "poses without a covariance of {}"),
)
"""Figures below ``health.nees.position``: name and text."""

_LOWER, _HIGHER = Better.LOWER, Better.HIGHER
_error = partial(Measure, better=_LOWER, is_error=True)
_POSITIONS, _TURNS = "{statistic} of position errors{aligned}", "{statistic} of rotation errors{aligned}"
_STEPS, _STEP_TURNS = "{statistic} of translation errors{over}", "{statistic} of rotation errors{over}"
_RELATIONS = "{statistic} of errors over the given relative poses, nothing aligned"
_TABLE = (
    Measure("algorithm", "algorithm"),
    Measure("algorithm.version", "version of the algorithm", short="algorithm.version"),
    Measure("sensors", "sensors"),
    Measure("dataset", "dataset"),
    Measure("dataset.version", "version of the dataset", short="dataset.version"),
    Measure("repetition", "repetition"),
    Measure("evaluation", "evaluation"),
    Measure("alignment", "alignment"),
    Measure("settings", "evaluation settings", short="settings"),
    Measure("evaluationVersion", "version of the evaluation", short="evaluationVersion"),
    Measure("outcome", "outcome"),
    Measure("status", "outcome or reason", short="status"),
    # What the evaluator finds.
    Measure("coverage", "coverage", "", _HIGHER, meaning="share of the true path that has poses"),
    Measure("scale", "scale"),
    Measure("poses"),
    Measure("referencePoses"),
    Measure("estimatePoses"),
    Measure("nanRows", "rows of NaN", "", _LOWER),
    Measure("pathLength", "", "m"),
    Measure("coveredLength", "", "m"),
    _error("ate.*", "ATE", "m", meaning=_POSITIONS),
    _error("ate.rmse", "ATE RMSE", "m", short="ATE", meaning=_POSITIONS),
    _error("ate.extended", "extended ATE RMSE", "m", short="extended ATE"),
    _error("ateRotationDeg.*", "ATE of rotation", "°", meaning=_TURNS),
    _error("rpe[].*", "RPE{1}", "m", meaning=_STEPS),
    _error("rpe[0].rmse", "RPE RMSE", "m", short="RPE", meaning=_STEPS),
    _error("rpe[].rotationDeg.*", "RPE{1} of rotation", "°", meaning=_STEP_TURNS),
    *(Measure(f"rpe[].{name}") for name in ("delta", "relTolerance", "count")),
    Measure("clock.offsetSeconds", "", "s"),
    Measure("clock.origin", "", "s"),
    Measure("clock.drift"),
    Measure("clock.correlation"),
    # Of one map among several: nothing is said of the run by it.
    *(Measure(name) for name in ("mainSegment", "segmentsLeftOut", "posesOutside")),
    *(Measure(f"segments[].{name}") for name in ("segment", "poses", "scale")),
    Measure("segments[].begin", "", "s"),
    Measure("segments[].end", "", "s"),
    Measure("segments[].metres", "", "m"),
    Measure("segments[].coverage", "", "", _HIGHER),
    Measure("segments[].ate.*", "", "m", _LOWER),
    Measure("segments[].ateInMainFrame.*", "", "m", _LOWER),
    Measure("points.count", "control points"),
    Measure("points.met", "control points met", "", _HIGHER),
    Measure("points.missing", "control points missed", "", _LOWER),
    Measure("points.share", "share of control points met", "", _HIGHER),
    Measure("points.medianSpacingSeconds", "median time between control points", "s"),
    Measure("points.longestSpacingSeconds", "longest time between control points", "s"),
    Measure("points.rmseStandardError", "standard error of the RMSE at control points", "m"),
    _error("relations.translation.*", "error over relations", "m"),
    _error(
        "relations.translation.mean", "error over relations mean", "m", short="relations", meaning=_RELATIONS
    ),
    _error("relations.rotationDeg.*", "error over relations of rotation", "°"),
    _error("relations.rotationDeg.mean", "error over relations of rotation mean", "°", short="relations"),
    _error("relations.byTime[].translation.*", "error over relations {0}", "m"),
    _error("relations.byTime[].rotationDeg.*", "error over relations {0} of rotation", "°"),
    Measure("relations.relations"),
    Measure("relations.count"),
    Measure("relations.missing", "", "", _LOWER),
    Measure("relations.byTime[].fromSeconds", "", "s"),
    Measure("relations.byTime[].toSeconds", "", "s"),
    Measure("relations.byTime[].count"),
    # What the system said of itself. None is an error: those of lost runs are what it is all about, and they
    # are not to stand behind all others.
    Measure("health.rows", "rows of health"),
    Measure("health.seconds", "time judged", "s"),
    Measure("health.lostSeconds", "time lost", "s", _LOWER),
    Measure("health.losses", "losses", "", _LOWER),
    Measure("health.warning.seconds", "time warned", "s"),
    Measure("health.warning.losses", "losses warned of"),
    Measure(
        "health.warning.lead",
        "warning ahead of a loss",
        "s",
        _HIGHER,
        short="lead",
        meaning="mean over a run's losses that were warned of; below 0 the warning came after",
    ),
    Measure("health.warning.leadMin", "least warning ahead of a loss", "s", _HIGHER, short="least lead"),
    Measure(
        "health.false.share",
        "false share of warnings",
        "",
        _LOWER,
        short="false",
        meaning="share of the time warned that was neither lost nor just before a loss",
    ),
    Measure(
        "health.missed.share",
        "share of lost time without a warning",
        "",
        _LOWER,
        short="missed",
        meaning="share of the time lost without a warning",
    ),
    Measure("health.missed.losses", "losses not warned of", "", _LOWER),
    Measure(
        "health.auc",
        "AUC of health",
        "",
        _HIGHER,
        meaning="probability that a value given while off is below one given while not; 0.5 is a guess",
    ),
    Measure("health.values", "values of health"),
    *(
        Measure(f"health.nees.{part}.{name}", text.format(part))
        for part in ("position", "rotation")
        for name, text in _NEES
    ),
    # What a run was given, and what it took.
    Measure("input.pace", "pace"),
    Measure("input.frameRate", "frame rate", "Hz"),
    Measure("input.resolution", "resolution"),
    Measure("input.start", "start", "s"),
    Measure("input.duration", "duration", "s"),
    Measure("input.lidar.minRange", "shortest range kept", "m"),
    Measure("input.lidar.maxRange", "longest range kept", "m"),
    Measure("input.lidar.rings", "rings kept"),
    *(Measure(f"input.perturb.{name}", text, unit) for name, text, unit in _PERTURBATIONS),
    Measure("prepared.frameRate", "prepared frame rate", "Hz"),
    Measure("prepared.recordedFrameRate", "recorded frame rate", "Hz"),
    Measure(
        "usage.cpu.meanCores",
        "mean CPU load",
        "cores",
        _LOWER,
        short="CPU",
        meaning="cores busy on average{reader}",
    ),
    Measure("usage.cpu.maxCores", "maximum CPU load", "cores", _LOWER, short="CPU max"),
    Measure("usage.cpu.seconds", "CPU time", "s", _LOWER, meaning="CPU seconds of a run{reader}"),
    Measure("usage.cpu.totalSeconds", "CPU time with the reader", "s", _LOWER, short="CPU time, total"),
    Measure(
        "usage.cpu.secondsPerDataSecond",
        "CPU time per second of data",
        "s/s",
        _LOWER,
        short="CPU",
        meaning="CPU seconds a second of recording{reader}",
    ),
    Measure("usage.readerCpuSeconds", "CPU time of the reader", "s", _LOWER, short="reader"),
    Measure("usage.readerShare", "share of the reader", "", _LOWER),
    Measure("usage.wallSeconds", "wall time", "s", _LOWER),
    Measure(UNDISTURBED, "undisturbed wall time", "s", _LOWER),
    Measure("usage.throttledSeconds", "", "s", _LOWER),
    Measure("usage.contendedSeconds", "", "s", _LOWER),
    Measure("usage.includesReader", "reader included"),
    Measure("usage.memory.peakBytes", "peak memory", "B", _LOWER),
    Measure("usage.memory.meanBytes", "mean memory", "B", _LOWER),
    Measure("usage.memory.anonymousPeakBytes", "peak anonymous memory", "B", _LOWER),
    Measure("usage.memory.workingSetPeakBytes", "peak working set", "B", _LOWER),
    Measure("usage.memory.kernelPeakBytes", "peak memory by the kernel", "B", _LOWER),
    Measure("usage.memory.kind", "kind of memory"),
    Measure("frames.offered", "frames offered"),
    Measure("frames.processed", "frames processed", "", _HIGHER),
    Measure("frames.dropped", "frames dropped", "", _LOWER),
    # What adapters note.
    Measure("metrics.timePerFrame.mean", "mean time per frame", "s", _LOWER),
    Measure("metrics.timePerFrame.max", "maximum time per frame", "s", _LOWER),
    # What a player notes of a node.
    Measure("metrics.latencySeconds.mean", "mean latency", "s", _LOWER),
    Measure(
        "metrics.latencySeconds.median",
        "latency p50",
        "s",
        _LOWER,
        meaning="time from a frame to its first pose, of half of the frames at most (p95: of 95 %)",
    ),
    Measure("metrics.latencySeconds.p95", "latency p95", "s", _LOWER),
    Measure("metrics.latencySeconds.p99", "latency p99", "s", _LOWER),
    Measure("metrics.latencySeconds.max", "latency max", "s", _LOWER),
    Measure(
        "metrics.realTimeFactor",
        "real-time factor",
        "",
        _LOWER,
        meaning="time that a node took over the time it had; clearly above 1 it was behind",
    ),
    Measure("metrics.playSeconds", "time of playing", "s"),
    Measure("metrics.posesPublished", "poses published"),
    Measure(LATE_SECONDS, "poses late by up to", "s", _LOWER),
    Measure("trajectory.poses", "poses"),
    Measure("trajectory.durationSeconds", "duration of the trajectory", "s"),
    Measure("provenance.node", "node"),
    Measure("provenance.cpuModel", "processor"),
    Measure("provenance.machine.cores", "cores of the machine"),
    Measure("provenance.machine.smt", "SMT"),
    Measure("provenance.machine.governor", "governor"),
    Measure("provenance.machine.turbo", "turbo"),
    Measure("provenance.machine.exclusiveCores", "exclusive cores"),
)
_BY_NAME = {measure.name: measure for measure in _TABLE}

ERRORS = frozenset(re.split(r"[.\[]", measure.name)[0] for measure in _TABLE if measure.is_error)
"""Fields of a result that hold errors."""

KEPT_BESIDE = ERRORS | {"scale", "estimatePoses", "poses", "points"}
"""Fields of a result that are kept of a trajectory beside the run's own, with its outcome and coverage."""

_STATISTICS = {
    "rmse": "RMSE",
    "std": "standard deviation",
    "min": "minimum",
    "max": "maximum",
    "sse": "sum of squares",
}
"""Names of the statistics for people, where they aren't those of the evaluator."""

_NUMBER = re.compile(r"\[(\d+)\]")
BESIDE = re.compile(r"beside\.(\w+)\.(.+)")
"""Names of figures of a trajectory beside the run's own."""


@lru_cache(maxsize=4096)
def measure_of(column: str) -> Measure:
    """Return the measure of a column; of one without a row, its name and the unit that its name tells."""
    if column.startswith(CAUSAL) and (found := _listed(column.removeprefix(CAUSAL))):
        causal = found.meaning and f"{found.meaning}, of the poses as first published"
        text, short = f"{found.text}, causal", f"{found.short}, causal"
        return replace(found, name=column, text=text, short=short, meaning=causal)
    beside = BESIDE.fullmatch(column)
    if beside and (found := _listed(beside[2])):
        text = f"{found.text} of {beside[1]}"
        return replace(found, name=column, text=text, short=text)
    if found := _listed(column):
        return found
    unit = "s" if column.endswith(("Seconds", ".seconds")) else "B" if column.endswith("Bytes") else ""
    return Measure(column, column, unit, short=column)


def figures(rpe: int) -> list[str]:
    """Return the columns of figures of which small or large is good, for an evaluation with so many RPEs."""
    found: list[str] = []
    for measure in _TABLE:
        if measure.better is Better.NONE or measure.name.startswith(("segments", "relations.byTime")):
            continue
        names = [measure.name]
        if "[]" in measure.name:
            names = [measure.name.replace("[]", f"[{number}]") for number in range(rpe)]
        for name in names:
            stem = name.removesuffix("*")
            found += [name] if stem == name else [f"{stem}{statistic}" for statistic in STATISTICS]
    return list(dict.fromkeys(found))


def _listed(column: str) -> Measure | None:
    """Return the measure of a column that has a row, of its own or of its kind; None where it has none."""
    kind = _NUMBER.sub("[]", column)
    found = _BY_NAME.get(column) or _BY_NAME.get(kind)
    text, unit = (found.text, found.unit) if found else ("", "")
    stem, _, statistic = kind.rpartition(".")
    if found is None and statistic in STATISTICS and (found := _BY_NAME.get(f"{stem}.*")):
        text = found.text and f"{found.text} {_STATISTICS.get(statistic, statistic)}"
        unit = f"{found.unit}²" if statistic == "sse" else found.unit
    if found is None:
        return None
    number = int(match[1]) if (match := _NUMBER.search(column)) else 0
    text = text.format(number, f" {number + 1}" if number else "") or column
    named = _STATISTICS.get(statistic, statistic)
    meaning = found.meaning.replace("{statistic}", named)
    return replace(found, name=column, text=text, unit=unit, short=found.short or text, meaning=meaning)


def is_listed(column: str) -> bool:
    """Tell whether a column, or one of its kind, is a measure; others may be of somebody's own."""
    beside = BESIDE.fullmatch(column)
    return _listed(beside[2] if beside else column.removeprefix(CAUSAL)) is not None


def is_error(column: str) -> bool:
    """Tell whether a column is an error, of a run's trajectory or of one beside it: failed runs rank last."""
    return measure_of(column).is_error


def follows_trajectory(column: str) -> bool:
    """Tell whether runs with equal trajectories have equal figures: errors that are of none beside it."""
    return is_error(column) and not BESIDE.fullmatch(column)


def columns_ending_in(name: str, columns: Iterable[str]) -> list[str]:
    """Return the columns whose last part is a name: of several the only setting, else all of them, sorted.

    >>> columns_ending_in("k", ["parameters.k", "metrics.k"]), columns_ending_in("x", ["b.x", "a.x", "y"])
    (['parameters.k'], ['a.x', 'b.x'])
    """
    ending = sorted(column for column in columns if column.endswith(f".{name}"))
    settings = [column for column in ending if column.startswith(CONFIGURATION)]
    return settings if len(settings) == 1 else ending
