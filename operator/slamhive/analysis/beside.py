# SPDX-License-Identifier: Apache-2.0
"""Files beside a run's final estimate: other trajectories, and what the system said of itself.

Keyframes, and poses as first published, are measured as the estimate is. Their figures are part of the run's
result, under ``beside``: the column ``beside.online.ate.rmse`` is the ATE of the poses as they were when they
were published. Confidence and covariances are held against the poses as first published where there are
such, else against the estimate: their figures are under ``health``. What is wrong with such a file costs no
result and stands in its ``message``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.measures import KEPT_BESIDE
from slamhive.analysis.measuring import SEGMENTS, measure, options, read_estimate
from slamhive.contract.files import NotRegularError, compression_problem
from slamhive.contract.lines import LIMIT_BYTES, named
from slamhive.contract.output import KEYFRAMES, ONLINE
from slamhive.contract.trajectory import FILE
from slamhive.model.errors import InputError
from slamhive_eval import (
    ControlPoints,
    EvaluationError,
    Relations,
    Trajectory,
    TrajectoryError,
    evaluate_health,
    number_poses,
    read_covariances,
    read_health,
    read_segments,
)
from slamhive_eval.evaluation import NO_POSE
from slamhive_eval.formats.healthfiles import COVARIANCES, HEALTH
from slamhive_eval.measures.health import describe

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.measuring import Subject
    from slamhive.model.evaluation import EvaluationSettings
    from slamhive.model.results import Result
    from slamhive_eval import Piece

BESIDE = "beside"
_FILES = {"keyframes": KEYFRAMES, "online": ONLINE}
_KEPT = KEPT_BESIDE | {"message"}


HEALTH_BYTES = 64 << 20
"""Of health.csv and of covariances.csv."""

Truth = Trajectory | Relations | ControlPoints
Opened = Callable[[str], AbstractContextManager[int]]
_WANTED: dict[str, Callable[[str], Any]] = {HEALTH: read_health, COVARIANCES: read_covariances}


def measure_opened(
    opened: Opened, reference: Truth, settings: EvaluationSettings, subject: Subject, name: str | None = None
) -> Result:
    """Return the result of a run by the files in its output folder.

    Args:
        opened: as `with_others` has it.
        reference: as `measure` has it, and so are the rest.
        settings: how to measure.
        subject: what is known of the run.
        name: the evaluation's name.

    Raises:
        InputError: a file can't be read, is no trajectory, or doesn't fit the settings.
        EvaluationError: no pose is in a piece.
        OSError: the trajectory can't be opened.
    """
    with opened(FILE) as descriptor:
        estimate = _read(descriptor, FILE, read_estimate, LIMIT_BYTES)
    pieces = None
    # A system that lost track and began another map says so there: such maps have no common frame.
    with suppress(FileNotFoundError):
        if estimate is not None:
            with opened(SEGMENTS) as descriptor:
                pieces = _read(descriptor, SEGMENTS, read_segments, LIMIT_BYTES)
    result = measure(reference, estimate, settings, subject, name, pieces=pieces)
    return with_others(result, opened, reference, settings, subject, estimate=estimate, pieces=pieces)


def with_others(
    result: Result,
    opened: Opened,
    reference: Truth,
    settings: EvaluationSettings,
    subject: Subject,
    *,
    estimate: Trajectory | None,
    pieces: Sequence[Piece] | None = None,
) -> Result:
    """Return a run's result with the figures of what lies beside its trajectory.

    Args:
        result: of its trajectory.
        opened: opens a file of its output folder by name; as `open_below` of `slamhive.contract.files`.
        reference: as `measure` has it, and so are the rest.
        settings: how to measure.
        subject: what is known of the run.
        estimate: the run's trajectory, None where it holds no pose.
        pieces: what the algorithm says of its restarts and maps.
    """
    found: dict[str, Any] = {}
    known = {"final": estimate}  # trajectories that could be measured
    for word, name in _FILES.items():
        of_file = replace(subject, keyframes=True) if word == "keyframes" else subject
        try:
            with opened(name) as descriptor:
                other = _read(descriptor, name, read_estimate, LIMIT_BYTES)
            own = measure(reference, other, settings, of_file, pieces=pieces)
        except FileNotFoundError:
            continue
        except (NotRegularError, InputError, EvaluationError) as error:
            why = "is no regular file" if isinstance(error, NotRegularError) else str(error)
            found[word] = {"message": why if name in why else f"{named(name)}: {why}"}
        except OSError as error:
            found[word] = {"message": f"{named(name)}: can't be read: {error.strerror or error}"}
        else:
            figures = {k: value for k, value in own.values.items() if k in _KEPT and value not in (None, "")}
            found[word] = {"outcome": str(own.outcome), "coverage": own.coverage, **figures}
            known[word] = other
    values = result.values | ({BESIDE: found} if found else {})
    of = "online" if known.get("online") is not None else "final"
    health = _health(known[of], opened, reference, settings, subject, pieces=pieces)
    if health:
        health["health"]["of"] = of
        if sentence := describe(health["health"]):
            values["notes"] = [*values.get("notes", []), sentence]
    return result.replace(values=values | health) if found or health else result


def _health(
    estimate: Trajectory | None,
    opened: Opened,
    reference: Truth,
    settings: EvaluationSettings,
    subject: Subject,
    *,
    pieces: Sequence[Piece] | None,
) -> dict[str, Any]:
    """Return the figures of a run's confidence and covariances; nothing where it told none."""
    files: dict[str, Any] = {}
    wrong: list[str] = []
    for name, read in _WANTED.items():
        try:
            with opened(name) as descriptor:
                files[name] = _read(descriptor, name, read, HEALTH_BYTES)
        except FileNotFoundError:
            continue
        except NotRegularError:
            wrong.append(f"{named(name)}: is no regular file")
        except InputError as error:
            wrong.append(str(error))
        except OSError as error:
            wrong.append(f"{named(name)}: can't be read: {error.strerror or error}")
    told: dict[str, Any] = {"health": {}}
    try:
        if files:
            told = _measured(estimate, reference, settings, subject, files, pieces=pieces)
    except (InputError, EvaluationError) as error:
        wrong.append(f"{' and '.join(files)}: {error}")
    if wrong:
        told["health"]["message"] = "; ".join(wrong)
    return told if files or wrong else {}


def _measured(
    estimate: Trajectory | None,
    reference: Truth,
    settings: EvaluationSettings,
    subject: Subject,
    files: Mapping[str, Any],
    *,
    pieces: Sequence[Piece] | None,
) -> dict[str, Any]:
    if not isinstance(reference, Trajectory):
        raise TrajectoryError("held against poses over time, of which this ground truth has none")
    if estimate is None:
        raise TrajectoryError(NO_POSE)
    asked = options(settings, subject)
    maps = None
    if pieces is not None:
        numbers, _ = number_poses(estimate, pieces)
        kept = np.flatnonzero(numbers >= 0)
        estimate, maps = estimate.select(kept), numbers[kept]
    return evaluate_health(
        reference,
        estimate,
        asked.preparation,
        said=files.get(HEALTH),
        covariances=files.get(COVARIANCES),
        keyframes=asked.keyframes,
        window=asked.window,
        maps=maps,
    )


def _read(descriptor: int, name: str, read: Callable[[str], Any], limit: int) -> Any:
    if os.fstat(descriptor).st_size > limit:
        raise InputError(f"{named(name)} is larger than {limit >> 20} MiB")
    if problem := compression_problem(descriptor, named(name)):
        raise InputError(problem)
    link = f"/proc/self/fd/{descriptor}"
    try:
        return read(link)
    except EvaluationError as error:
        raise InputError(str(error).replace(link, named(name))) from None
