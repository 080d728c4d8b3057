# SPDX-License-Identifier: Apache-2.0
"""Measuring many runs on all processors, each in a process whose end or greed stops no other."""

from __future__ import annotations

import hashlib
import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.beside import with_others
from slamhive.analysis.measuring import CPU_SECONDS, SEGMENTS, measure, read_estimate
from slamhive.contract.files import compression_problem, open_below
from slamhive.contract.lines import LIMIT_BYTES
from slamhive.contract.trajectory import TRAJECTORY
from slamhive.jobs.machine import free_memory, usable_cores
from slamhive.jobs.opening import opened
from slamhive.jobs.program import parse
from slamhive.jobs.requests import RunItem
from slamhive.model.errors import DataError, SlamHiveError
from slamhive.monitor.measuring.bounded import BoundedProcess, LimitError
from slamhive_eval import (
    ControlPoints,
    EvaluationError,
    Relations,
    TableFormat,
    Trajectory,
    read_columns,
    read_relations,
    read_segments,
    read_tum,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from slamhive.model.evaluation import EvaluationSettings
    from slamhive_eval import Piece

_SEGMENTS_BYTES = 1 << 20
_WORKER_BYTES = 192 << 20
_SPARE = 0.9

Truth = Trajectory | Relations | ControlPoints
_POSITIONS = TableFormat(("t", "tx", "ty", "tz"))


@dataclass(frozen=True)
class Bench:
    """Inputs of measuring that all runs of a batch share: settings, ground truth, folder of results.

    Attributes:
        results: folder of the results volume.
        settings: how to measure.
        evaluation: name of the evaluation; None: the alignment's.
        truths: ground truth by dataset, or the sentence that says why there is none.
    """

    results: Path
    settings: EvaluationSettings
    evaluation: str | None
    truths: Mapping[str, Truth | str]

    def measure(self, item: Mapping[str, Any]) -> dict[str, Any]:
        """Return a run's line: its result, or the sentence that says why there is none."""
        line = identity(item)
        try:
            run = parse(RunItem, dict(item), f"run {line['name']}")
            truth = self.truths.get(run.dataset, f"dataset {run.dataset!r} has no ground truth")
            if isinstance(truth, str):
                return line | {"error": truth}
            estimate = self._estimate(run)
            pieces = None if estimate is None else self._pieces(run)
            subject = run.subject()
            result = measure(truth, estimate, self.settings, subject, self.evaluation, pieces=pieces)
            beside = partial(self._open, run)
            result = with_others(
                result, beside, truth, self.settings, subject, estimate=estimate, pieces=pieces
            )
            line |= {"result": result.as_json()}
            json.dumps(line, allow_nan=False)
            return line  # noqa: TRY300 - what JSON can't say is an error of this run
        except MemoryError:
            return line | {"error": "measuring it needs more memory than the evaluator has"}
        except (SlamHiveError, EvaluationError) as error:
            return line | {"error": str(error)}
        except Exception as error:  # noqa: BLE001 - one bad run must not stop the rest
            return line | {"error": f"unforeseen: {type(error).__name__}: {' '.join(str(error).split())}"}

    def _estimate(self, run: RunItem) -> Trajectory | None:
        """Read a run's trajectory; None where the file holds no pose.

        Raises:
            DataError: it isn't there, or not what the run wrote.
            EvaluationError: it is no trajectory.
        """
        path = f"{run.folder}/{TRAJECTORY}"
        with opened(self.results, path, LIMIT_BYTES) as descriptor:
            _require_plain(descriptor, path)
            with open(descriptor, "rb", closefd=False) as file:
                found = hashlib.file_digest(file, "sha256").hexdigest()
            if run.sha256 is not None and found != run.sha256:
                raise DataError(f"{path} has sha256 {found}, the run wrote one of {run.sha256}")
            link = f"/proc/self/fd/{descriptor}"
            try:
                return read_estimate(link)
            except EvaluationError as error:
                raise DataError(str(error).replace(link, path)) from None

    def _open(self, run: RunItem, name: str) -> AbstractContextManager[int]:
        """Open a file of a run's output folder; errors as of `open_below`."""
        return open_below(self.results, f"{run.folder}/output/{name}", follow=True)

    def _pieces(self, run: RunItem) -> list[Piece] | None:
        """Read what a run says of its restarts and maps; None when it says nothing.

        Raises:
            DataError: it says it wrongly.
        """
        path = f"{run.folder}/output/{SEGMENTS}"
        if not os.path.lexists(self.results / path):
            return None
        with opened(self.results, path, _SEGMENTS_BYTES) as descriptor:
            _require_plain(descriptor, f"output/{SEGMENTS}")  # the sentence that a workstation has
            link = f"/proc/self/fd/{descriptor}"
            try:
                return read_segments(link)
            except EvaluationError as error:
                raise DataError(str(error).replace(link, path)) from None


def _require_plain(descriptor: int, path: str) -> None:
    problem = compression_problem(descriptor, path)
    if problem:
        raise DataError(problem)


def identity(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields that every line begins with."""
    return {"uid": item.get("uid"), "name": item.get("name")}


def measure_all(
    bench: Bench, items: Sequence[Mapping[str, Any]], cores: int | None = None, memory: int | None = None
) -> Iterator[dict[str, Any]]:
    """Measure runs, and return their lines in the order of the runs, as soon as they are there.

    Args:
        bench: what measuring needs.
        items: the runs as requested.
        cores: processes at a time; None: as many as there are processors.
        memory: bytes that all processes may take together; None: what the cgroup leaves.
    """
    memory = free_memory() if memory is None else memory
    workers = min(cores or usable_cores(), max(1, len(items)))
    if memory is not None:
        workers = max(1, min(workers, memory // _WORKER_BYTES))
    share = None if memory is None else int(memory * _SPARE) // workers
    # A fork shares the ground truth with all of them.
    idle: SimpleQueue[BoundedProcess] = SimpleQueue()
    for _ in range(workers):
        idle.put(BoundedProcess(lambda item, _: bench.measure(item), CPU_SECONDS, share))

    def measured(item: Mapping[str, Any]) -> dict[str, Any]:
        process = idle.get()
        try:
            line: dict[str, Any] = process.ask(item)
        except (LimitError, RuntimeError) as error:
            return identity(item) | {"error": f"can't be measured: {error}"}
        else:
            return line
        finally:
            idle.put(process)

    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(measured, items)


def read_truths(folder: Path, datasets: Iterable[str]) -> dict[str, Truth | str]:
    """Read the ground truth of datasets, each once.

    Returns:
        For each dataset its ground truth, or the sentence that says why there is none.
    """
    return {name: _read_truth(folder, name) for name in dict.fromkeys(datasets)}


def _read_truth(folder: Path, name: str) -> Truth | str:
    poses, relations = folder / f"{name}.txt", folder / f"{name}.relations"
    matrices = folder / f"{name}.rotations.npy"
    try:
        if relations.is_file():
            return read_relations(relations)
        for ending in ("points", "positions"):
            path = folder / f"{name}.{ending}"
            if path.is_file():
                found = read_columns(path, _POSITIONS)
                return ControlPoints.of(found) if ending == "points" else found
        if not poses.is_file():
            return f"dataset {name!r} has no ground truth"
        truth = read_tum(poses)
        if not matrices.is_file():
            return truth
        rotations = np.load(matrices, allow_pickle=False)
        return Trajectory(truth.stamps, truth.positions, truth.quaternions, rotations)
    except (EvaluationError, OSError, ValueError) as error:
        return f"dataset {name!r}: ground truth: {error}".replace(f"{folder}/", "")
