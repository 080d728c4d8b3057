# SPDX-License-Identifier: Apache-2.0
"""Many estimates at once, on all processors, each ground truth read once.

Pairs go to processes in groups with one ground truth. What several pairs share is read before the processes
are forked and lies in their common memory. One pair's failure, even the death of its process, is a result
with a sentence.
"""

from __future__ import annotations

import contextlib
import functools
import json
import multiprocessing
import os
import shlex
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.errors import EvaluationError, FileError, OptionError, TrajectoryError
from slamhive_eval.evaluation import Options, evaluate
from slamhive_eval.formats.column_tables import read_columns
from slamhive_eval.formats.files import Unsorted, read_estimate, read_text, read_trajectory
from slamhive_eval.measures.points import ControlPoints, evaluate_points, require_point_options
from slamhive_eval.measures.segments import NAME, beside, evaluate_pieces, read_segments
from slamhive_eval.measures.support import find_support
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive_eval.formats.columns import TableFormat

TRUTH_NAMES = ("groundtruth", "gt", "stamped_groundtruth")
"""Names, without their ending, of a folder's ground truth; the last is that of rpg_trajectory_evaluation."""
_POSES_IN_COMMON = 10_000_000
"""Poses of ground truth that are read beforehand, some 700 MB; more is read by the processes."""
_LARGEST_GROUP = 16
_FEWEST_FOR_PROCESSES = 8

_SOME = Trajectory(np.arange(3.0), np.eye(3), np.tile((0.0, 0.0, 0.0, 1.0), (3, 1)))
"""Poses to try options on."""

_shared: dict[str, Trajectory | str] = {}
"""Ground truth by path, or the sentence why it can't be read; filled before processes are forked."""


@dataclass(frozen=True)
class Pair:
    """An estimate and its ground truth.

    Attributes:
        reference: File, or FILE:TOPIC, of the ground truth.
        estimate: That of the estimate.
    """

    reference: str
    estimate: str


@dataclass(frozen=True)
class Truths:
    """Format of the ground-truth files that a batch of estimates is compared with.

    Attributes:
        table: Their columns; None: they say it themselves.
        are_points: Whether they hold control points.
    """

    table: TableFormat | None = None
    are_points: bool = False

    def read(self, path: str) -> Trajectory:
        """Read one; of control points the positions.

        Raises:
            EvaluationError: It can't be read.
        """
        return read_trajectory(path) if self.table is None else read_columns(path, self.table)


def read_pairs(path: str | Path) -> list[Pair]:
    """Read a list of pairs, one a line: ``GT EST``, in quotes where they have blanks, or JSON.

    A line of JSON is an object with ``reference`` and ``estimate``. Paths start from the list's folder.

    Raises:
        FileError: The list can't be read, a line is neither, or there is none.
    """
    folder = Path(path).parent
    pairs = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            words = _words(line)
        except ValueError as error:
            message = f"expected GT EST, or JSON with reference and estimate ({error})"
            raise FileError(path, message, number) from None
        pairs.append(Pair(*(str(folder / word) for word in words)))
    if not pairs:
        raise FileError(path, "names no pairs; a line of it has GT EST")
    return pairs


def find_pairs(folder: str | Path, reference: str | Path | None = None, pattern: str = "*.txt") -> list[Pair]:
    """The estimates in a folder and all folders in it.

    Args:
        folder: Where to look.
        reference: Ground truth of all of them; None for the file with one of `TRUTH_NAMES`, with any
            ending, in the estimate's folder or the nearest one above, not above ``folder``.
        pattern: What estimates are called, as in ``trajectory*.txt``.

    Returns:
        The pairs in the order of their paths.

    Raises:
        FileError: The folder can't be read, or there is no estimate with a ground truth in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileError(folder, "is no folder")

    @functools.cache
    def truth_of(place: Path) -> Path | None:
        found = sorted(one for one in place.iterdir() if _is_truth(one))
        if found:
            return found[0]
        return None if place == folder else truth_of(place.parent)

    pairs = []
    for estimate in sorted(folder.rglob(pattern)):
        passed_over = _is_truth(estimate) or estimate.name == NAME or _same(estimate, reference)
        if passed_over or not estimate.is_file():
            continue
        truth = reference or truth_of(estimate.parent)
        if truth is not None:
            pairs.append(Pair(str(truth), str(estimate)))
    if not pairs:
        names = ", ".join(f"{name}.*" for name in TRUTH_NAMES)
        truth = "" if reference else f" with a ground truth ({names}) beside or above it"
        raise FileError(folder, f"has no estimate {pattern}{truth}")
    return pairs


def evaluate_pairs(
    pairs: Sequence[Pair],
    options: Sequence[Options],
    *,
    unsorted: Unsorted = "error",
    by_index: bool = False,
    processes: int | None = None,
    with_segments: bool = True,
    truths: Truths | None = None,
) -> Iterator[dict[str, Any]]:
    """Evaluate pairs, in any order.

    Args:
        pairs: What to evaluate.
        options: How, one or more; every pair is evaluated by each.
        unsorted: What to do with decreasing stamps of estimates, see `read_trajectory`.
        by_index: Whether to pair KITTI files of unequal length as far as both go, with a note.
        processes: How many; None for as many as there are processors.
        with_segments: Whether to measure an estimate map by map where a ``segments.csv`` lies beside it.
        truths: What the files of ground truth are, where they don't say it themselves. Against control
            points all of an estimate is measured at once, and there is no support.

    Yields:
        For each pair and option, as they finish: ``reference``, ``estimate`` and `Evaluation.as_dict`, or
        `PointErrors.as_dict`, or what `evaluate_pieces` returns, and `Support.as_dict` as ``support``; for
        a pair that can't be evaluated ``reference``, ``estimate`` and ``error``, a sentence.

    Raises:
        OptionError: An option that isn't allowed, whatever the pairs, or fewer than one process.
    """
    truths = truths or Truths()
    for one in options:
        with contextlib.suppress(TrajectoryError):  # three poses don't determine everything
            evaluate(_SOME, _SOME, one)
        if truths.are_points:
            require_point_options(one)
    if processes is not None and processes < 1:
        raise OptionError(f"there must be at least one process, not {processes}")
    processes = min(processes or len(os.sched_getaffinity(0)), len(pairs))
    work = functools.partial(
        _evaluate_group,
        options=tuple(options),
        unsorted=unsorted,
        by_index=by_index,
        with_segments=with_segments and not truths.are_points,
        truths=truths,
    )
    try:
        _read_in_common(pairs, truths)
        if processes == 1 or len(pairs) < _FEWEST_FOR_PROCESSES:
            for pair in pairs:
                yield from work([pair])
        else:
            yield from _in_processes(_groups(pairs, processes), work, processes)
    finally:
        _shared.clear()


def _words(line: str) -> tuple[str, str]:
    if line.lstrip().startswith("{"):
        found = json.loads(line)
        words = [found.get("reference"), found.get("estimate")]
    else:
        words = shlex.split(line, comments=True)
    if len(words) != 2 or not all(isinstance(word, str) and word for word in words):
        raise ValueError(f"found {len([word for word in words if word])} names")
    return words[0], words[1]


def _is_truth(path: Path) -> bool:
    return path.name.split(".", 1)[0].lower() in TRUTH_NAMES and path.is_file()


def _same(path: Path, other: str | Path | None) -> bool:
    return other is not None and Path(other).exists() and path.samefile(other)


def _groups(pairs: Sequence[Pair], processes: int) -> list[list[Pair]]:
    """Pairs with one ground truth together, in groups small enough to keep all processes busy."""
    size = max(1, min(_LARGEST_GROUP, len(pairs) // (4 * processes)))
    by_reference: dict[str, list[Pair]] = {}
    for pair in pairs:
        by_reference.setdefault(pair.reference, []).append(pair)
    return [some[k : k + size] for some in by_reference.values() for k in range(0, len(some), size)]


def _read_in_common(pairs: Sequence[Pair], truths: Truths) -> None:
    poses = 0
    for path, count in Counter(pair.reference for pair in pairs).items():
        if count < 2 or poses > _POSES_IN_COMMON:
            continue
        try:
            _shared[path] = found = truths.read(path)
            poses += len(found)
        except EvaluationError as error:
            _shared[path] = str(error)


@functools.lru_cache(maxsize=1)
def _read_alone(path: str, truths: Truths) -> Trajectory:
    return truths.read(path)


def _reference(path: str, truths: Truths) -> Trajectory:
    found = _shared.get(path)
    if isinstance(found, str):
        raise TrajectoryError(found)
    return _read_alone(path, truths) if found is None else found


def _evaluate_group(
    group: Sequence[Pair],
    *,
    options: tuple[Options, ...],
    unsorted: Unsorted,
    by_index: bool,
    with_segments: bool,
    truths: Truths,
) -> list[dict[str, Any]]:
    results = []
    for pair in group:
        names = {"reference": pair.reference, "estimate": pair.estimate}
        try:
            reference = _reference(pair.reference, truths)
            if truths.are_points:
                points = ControlPoints.of(reference)
                estimate = read_trajectory(pair.estimate, unsorted=unsorted)
                results += [{**names, **evaluate_points(points, estimate, one).as_dict()} for one in options]
                continue
            estimate = read_estimate(
                pair.estimate, reference, pair.reference, unsorted=unsorted, by_index=by_index
            )
            path = beside(pair.estimate) if with_segments else None
            if path is None:
                found = [evaluate(reference, estimate, one).as_dict() for one in options]
            else:
                pieces = read_segments(path)
                found = [evaluate_pieces(reference, estimate, pieces, one) for one in options]
            support = find_support(reference, estimate.shifted(options[0].offset_seconds)).as_dict()
            results += [{**names, **one, "support": support} for one in found]
        except EvaluationError as error:
            results.append({**names, "error": str(error)})
        except Exception as error:  # noqa: BLE001 - the others must go on
            results.append({**names, "error": f"{type(error).__name__}: {error}"})
    return results


def _in_processes(groups: list[list[Pair]], work: Any, processes: int) -> Iterator[dict[str, Any]]:
    unfinished = []
    with _pool(processes) as pool:
        futures = {pool.submit(work, group): group for group in groups}
        for future in as_completed(futures):
            try:
                yield from future.result()
            except BrokenProcessPool:
                unfinished += futures[future]
    # A process died, killed for its memory perhaps, and took the pool along: the rest, one by one.
    for pair in unfinished:
        with _pool(1) as pool:
            try:
                yield from pool.submit(work, [pair]).result()
            except BrokenProcessPool:
                names = {"reference": pair.reference, "estimate": pair.estimate}
                yield {**names, "error": "the process that evaluated it died, for lack of memory perhaps"}


def _pool(processes: int) -> ProcessPoolExecutor:
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else None
    return ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context(method))
