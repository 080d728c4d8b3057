# SPDX-License-Identifier: Apache-2.0
"""The process of a workstation that reads and measures what algorithms wrote, within limits."""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from slamhive.analysis.beside import measure_opened
from slamhive.analysis.measuring import CPU_SECONDS
from slamhive.contract.files import open_below
from slamhive.contract.lines import named
from slamhive.contract.trajectory import FILE
from slamhive.model.errors import InputError
from slamhive.monitor.measuring.bounded import BoundedProcess
from slamhive.monitor.measuring.hierarchy import memory_limit
from slamhive_eval import EvaluationError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager
    from pathlib import Path

    from slamhive.model.results import Result

_MEMORY_BYTES = 2 << 30
"""Memory that measuring a run may take, where the machine has twice that."""


def measure_output(question: tuple[Any, ...], truths: dict[str, Any]) -> Result | Exception:
    """Return the result of a run, or what was wrong with what it wrote.

    Args:
        question: path of the trajectory, name of the dataset, settings, subject, name of the evaluation.
        truths: ground truth by dataset.
    """
    path, dataset, settings, subject, name = question

    def opened(file: str) -> AbstractContextManager[int]:
        # Trajectories of others that stayed where they were may be links.
        return _open_at(path) if file == FILE else open_below(path.parent, file)

    return measured(partial(measure_opened, opened, truths[dataset], settings, subject, name))


def measured(measure: Callable[[], Result]) -> Result | Exception:
    """Return a result, or the error of what the run wrote, which a pipe can take."""
    try:
        return measure()
    except EvaluationError as error:
        return InputError(str(error))
    except (InputError, OSError) as error:
        return error


def measuring_process(answer: Callable[[Any, dict[str, Any]], Any] = measure_output) -> BoundedProcess:
    """Return a process in which what algorithms wrote is read and measured, one run after another.

    Args:
        answer: called there, see `BoundedProcess`.
    """
    return BoundedProcess(answer, CPU_SECONDS, min(_MEMORY_BYTES, memory_limit() // 2))


@contextmanager
def _open_at(path: Path) -> Iterator[int]:
    try:
        file = path.open("rb")
    except OSError as error:
        raise InputError(f"{named(path.name)}: can't be read: {error.strerror or error}") from None
    with file:
        yield file.fileno()
