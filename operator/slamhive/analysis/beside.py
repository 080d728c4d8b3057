# SPDX-License-Identifier: Apache-2.0
"""Trajectories beside a run's final estimate, measured as it is: keyframes, and poses as first published.

Their figures are part of the run's result, under ``beside``: the column ``beside.online.ate.rmse`` is the ATE
of the poses as they were when they were published. What is wrong with such a file costs no result and stands
in its ``message``.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slamhive.analysis.measures import KEPT_BESIDE
from slamhive.analysis.measuring import measure, read_estimate
from slamhive.contract.files import NotRegularError, compression_problem
from slamhive.contract.lines import LIMIT_BYTES, named
from slamhive.contract.output import KEYFRAMES, ONLINE
from slamhive.model.errors import InputError
from slamhive_eval import EvaluationError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from slamhive.analysis.measuring import Subject
    from slamhive.model.evaluation import EvaluationSettings
    from slamhive.model.results import Result
    from slamhive_eval import ControlPoints, Piece, Relations, Trajectory

BESIDE = "beside"
_FILES = {"keyframes": KEYFRAMES, "online": ONLINE}
_KEPT = KEPT_BESIDE | {"message"}


def with_others(
    result: Result,
    opened: Callable[[str], AbstractContextManager[int]],
    reference: Trajectory | Relations | ControlPoints,
    settings: EvaluationSettings,
    subject: Subject,
    *,
    pieces: Sequence[Piece] | None = None,
) -> Result:
    """Return a run's result with the figures of what lies beside its trajectory.

    Args:
        result: of its trajectory.
        opened: opens a file of its output folder by name; as `open_below` of `slamhive.contract.files`.
        reference: as `measure` has it, and so are the rest.
        settings: how to measure.
        subject: what is known of the run.
        pieces: what the algorithm says of its restarts and maps.
    """
    found: dict[str, Any] = {}
    for word, name in _FILES.items():
        of_file = replace(subject, keyframes=True) if word == "keyframes" else subject
        try:
            with opened(name) as descriptor:
                estimate = _read(descriptor, name)
            own = measure(reference, estimate, settings, of_file, pieces=pieces)
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
    return result.replace(values=result.values | {BESIDE: found}) if found else result


def _read(descriptor: int, name: str) -> Trajectory | None:
    if os.fstat(descriptor).st_size > LIMIT_BYTES:
        raise InputError(f"{named(name)} is larger than {LIMIT_BYTES >> 20} MiB")
    if problem := compression_problem(descriptor, named(name)):
        raise InputError(problem)
    link = f"/proc/self/fd/{descriptor}"
    try:
        return read_estimate(link)
    except EvaluationError as error:
        raise InputError(str(error).replace(link, named(name))) from None
