# SPDX-License-Identifier: Apache-2.0
"""The process of a workstation that reads and measures what algorithms wrote, within limits."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from slamhive.analysis.beside import with_others
from slamhive.analysis.measuring import CPU_SECONDS, SEGMENTS, measure, read_estimate
from slamhive.contract.files import compression_problem, open_below
from slamhive.model.errors import InputError
from slamhive.monitor.measuring.bounded import BoundedProcess
from slamhive.monitor.measuring.hierarchy import memory_limit
from slamhive_eval import EvaluationError, read_segments

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.model.results import Result

_MEMORY_BYTES = 2 << 30
"""Memory that measuring a run may take, where the machine has twice that."""


def measuring_process() -> BoundedProcess:
    """Return the process in which what algorithms wrote is read and measured, one run after another."""
    return BoundedProcess(_measured, CPU_SECONDS, min(_MEMORY_BYTES, memory_limit() // 2))


def _measured(question: tuple[Any, ...], truths: dict[str, Any]) -> Result | Exception:
    path, dataset, settings, subject, name = question
    # A system that lost track and began another map says so there: such maps have no common frame.
    segments = path.with_name(SEGMENTS)
    try:
        _require_plain(path)
        estimate = read_estimate(path)
        pieces = None
        if estimate is not None and segments.is_file():
            _require_plain(segments)
            pieces = read_segments(segments)
        result = measure(truths[dataset], estimate, settings, subject, name, pieces=pieces)
        beside = partial(open_below, path.parent)
        return with_others(
            result, beside, truths[dataset], settings, subject, estimate=estimate, pieces=pieces
        )
    except EvaluationError as error:
        return InputError(str(error))
    except (InputError, OSError) as error:
        return error


def _require_plain(path: Path) -> None:
    try:
        with path.open("rb") as file:
            problem = compression_problem(file.fileno(), f"output/{path.name}")
    except OSError as error:
        raise InputError(f"output/{path.name}: can't be read: {error.strerror or error}") from None
    if problem:
        raise InputError(problem)
