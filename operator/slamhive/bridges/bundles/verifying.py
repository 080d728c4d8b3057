# SPDX-License-Identifier: Apache-2.0
"""Verifying of a bundle: every figure that comes from a trajectory is computed once more, and compared.

The code is that of evaluation itself, in processes of their own within the same limits, one a processor. Each
reads the files of a run from the bundle, holds them against their checksums and compares the figures. The
ground truth is this home's, or fetched or made by its name, if its checksum is the one that the study has.
"""

from __future__ import annotations

import errno
import os
import queue
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from slamhive.analysis.beside import measure_opened
from slamhive.analysis.measuring import SETTINGS_KEY, VERSION_KEY, version_of
from slamhive.archive.records import clean
from slamhive.bridges.bundles.contents import MEASURED, TRAJECTORY, run_file, truth_sha256
from slamhive.bridges.bundles.opening import require_unchanged
from slamhive.bridges.bundles.zipfiles import BundleFile
from slamhive.data.store.truthfolders import GroundTruthFolder
from slamhive.local.running.measuring_apart import measured, measuring_process
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, SlamHiveError, sentence
from slamhive.monitor.measuring.bounded import LimitError
from slamhive_eval import EvaluationError
from slamhive_eval.evaluation import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from slamhive.analysis.measuring import Subject
    from slamhive.bridges.bundles.contents import BundledRun, StudyDataset
    from slamhive.bridges.bundles.opening import OpenedBundle
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.evaluation import EvaluationSettings
    from slamhive.model.results import Result
    from slamhive.monitor.measuring.bounded import BoundedProcess

_DIGITS = 8
_LARGEST_GROUP, _GROUPS = 8, 8
"""Most runs that a process is asked for at once, and fewest times that it is asked: so that none is idle."""


class Mismatch(NamedTuple):
    """Figure of a run that comes out otherwise here.

    Attributes:
        run, evaluation: of which run, in which evaluation.
        figure: its name.
        bundled, recomputed: as the bundle has it, and as it comes out; None where it has none.
    """

    run: str
    evaluation: str
    figure: str
    bundled: Any
    recomputed: Any

    @property
    def difference(self) -> float | None:
        """Relative difference of two numbers; None where one is something else."""
        both = (self.bundled, self.recomputed)
        if any(isinstance(one, bool) or not isinstance(one, int | float) for one in both):
            return None
        largest = max(abs(self.bundled), abs(self.recomputed))
        return abs(self.bundled - self.recomputed) / largest if largest else 0.0


@dataclass
class Verification:
    """Outcome of verifying a bundle.

    Attributes:
        runs: number of runs with figures that were computed again.
        results: number of their results.
        figures: number of figures that agree to the last digit.
        mismatches: those that don't.
        absent: why figures of datasets can't be computed here, by dataset.
        notes: sentences on what else was not computed.
    """

    runs: int = 0
    results: int = 0
    figures: int = 0
    mismatches: list[Mismatch] = field(default_factory=list)
    absent: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


class _Task(NamedTuple):
    """A run whose files are hashed, and of which results are computed again: all that can be, or none.

    Attributes:
        run: its name.
        dataset: of it.
        subject: how its trajectory is measured; None where nothing is computed.
        asked: results, each with its settings.
    """

    run: str
    dataset: str
    subject: Subject | None
    asked: list[tuple[Result, EvaluationSettings]]


class _Recomputed(NamedTuple):
    """Outcome of a task.

    Attributes:
        sums: SHA-256 of the files by their names in the bundle.
        figures: number of figures that agree.
        mismatches: those that don't.
    """

    sums: dict[str, str]
    figures: int
    mismatches: list[Mismatch]


class Recomputing:
    """Work of a process of its own: it reads files of runs from the bundle, measures, compares.

    Args:
        path: the bundle's file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BundleFile | None = None

    def __call__(self, tasks: list[_Task], truths: dict[str, Any]) -> list[_Recomputed] | DataError:
        """Return the outcome of each run, or the error of a bundle that is damaged."""
        try:
            return [self._recomputed(task, truths) for task in tasks]
        except DataError as error:
            return error

    def _recomputed(self, task: _Task, truths: dict[str, Any]) -> _Recomputed:
        self._file = file = self._file or BundleFile(self._path)
        figures, mismatches = 0, []
        sums, held = {}, {}
        with ExitStack() as stack:
            for name in file.names_of(task.run):
                # Memory that is read like a file; no disk has to take what is read once.
                out = stack.enter_context(open(os.memfd_create(name), "wb", buffering=0))  # noqa: PTH123
                sums[run_file(task.run, name)] = file.copy(run_file(task.run, name), out)
                held[name] = out.fileno()

            def opened(name: str) -> AbstractContextManager[int]:
                if name not in held:
                    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), name)
                return nullcontext(held[name])

            for told, settings in task.asked:
                truth, name = truths[task.dataset], told.evaluation
                # Where there are results to compute there is a subject.
                subject = cast("Subject", task.subject)
                answer = measured(partial(measure_opened, opened, truth, settings, subject, name))
                agree, others = _compare(task.run, told, answer)
                figures += agree
                mismatches += others
        return _Recomputed(sums, figures, mismatches)


def verify(
    bench: Workbench,
    bundle: OpenedBundle,
    ground_truth: Path | None = None,
    step: Callable[[int, int], None] = lambda *_: None,
    *,
    processes: int | None = None,
) -> Verification:
    """Compute all figures of a bundle's trajectories again, and check the checksums of what they come from.

    Args:
        bench: the home that has the ground truth, or gets it.
        bundle: the bundle.
        ground_truth: a folder with files named after datasets that is looked into first.
        step: called with the number of runs done, and of all.
        processes: how many compute; default: one a processor.

    Raises:
        DataError: a file of a run was changed or is damaged.
    """
    found = Verification()
    truths = _truths(bench, bundle, ground_truth, found)
    tasks = list(_tasks(bundle, truths, found))
    found.results = sum(len(task.asked) for task in tasks)
    found.runs = sum(bool(task.asked) for task in tasks)
    sums: dict[str, str] = {}
    count = min(processes or len(os.sched_getaffinity(0)), max(len(tasks), 1))
    with _pool(Recomputing(bundle.file.path), count, truths) as compute:
        for number, (task, answer) in enumerate(zip(tasks, compute(tasks), strict=True)):
            step(number, len(tasks))
            if isinstance(answer, _Recomputed):
                sums |= answer.sums
                found.figures += answer.figures
                found.mismatches += answer.mismatches
            else:
                for told, _ in task.asked:
                    found.mismatches += _compare(task.run, told, answer)[1]
    require_unchanged(bundle.file.title, bundle.study, sums)
    return found


@contextmanager
def _pool(
    work: Recomputing, processes: int, truths: Mapping[str, Any]
) -> Iterator[Callable[[list[_Task]], Iterator[_Recomputed | Exception]]]:
    """Yield a function that does tasks in processes, in their order, or says why one can't be done."""
    workers = [measuring_process(work) for _ in range(processes)]
    free: queue.SimpleQueue[BoundedProcess] = queue.SimpleQueue()
    for worker in workers:
        free.put(worker)

    def compute(some: Sequence[_Task]) -> Sequence[_Recomputed | Exception]:
        known = {task.dataset: truths[task.dataset] for task in some if task.dataset in truths}
        worker = free.get()
        try:
            answer: list[_Recomputed] | DataError = worker.ask(some, **known)
        except (LimitError, RuntimeError) as error:
            failed: Exception = error
        else:
            if isinstance(answer, DataError):
                raise answer
            return answer
        finally:
            free.put(worker)
        return [failed] if len(some) == 1 else [one for task in some for one in compute([task])]

    def all_of(tasks: list[_Task]) -> Iterator[_Recomputed | Exception]:
        size = max(1, min(_LARGEST_GROUP, len(tasks) // (_GROUPS * processes)))
        groups = [tasks[k : k + size] for k in range(0, len(tasks), size)]
        return chain.from_iterable(pool.map(compute, groups))

    try:
        with ThreadPoolExecutor(processes) as pool:
            yield all_of
    finally:
        for worker in workers:
            worker.close()


def _truths(
    bench: Workbench, bundle: OpenedBundle, ground_truth: Path | None, found: Verification
) -> dict[str, Any]:
    """Return the ground truth of each dataset that is what the study has; why others aren't is noted."""
    truths = {}
    for dataset in bundle.study.datasets:
        if dataset.truth is None:
            continue
        try:
            poses, where = _truth_here(bench, bundle, dataset, ground_truth)
        except (SlamHiveError, EvaluationError, OSError) as error:
            found.absent[dataset.name] = f"its ground truth isn't here: {sentence(error)}"
            continue
        digest = truth_sha256(poses)
        if digest == dataset.truth:
            truths[dataset.name] = poses
        else:
            found.absent[dataset.name] = (
                f"its ground truth in {where} is another one: checksum {digest[:_DIGITS]}…, and runs of the "
                f"bundle were measured against {dataset.truth[:_DIGITS]}…"
            )
    return truths


def _truth_here(
    bench: Workbench, bundle: OpenedBundle, dataset: StudyDataset, ground_truth: Path | None
) -> tuple[Any, str]:
    if ground_truth is not None:
        folder = GroundTruthFolder(ground_truth)
        return folder.read(dataset.name), str(folder.path(dataset.name))
    if dataset.name not in bench.workshop.datasets:
        manifest = bundle.manifest(dataset.manifest)
        # What is generated follows from its manifest; nothing else is fetched because a stranger names it.
        if isinstance(manifest, Dataset) and manifest.spec.recording.synthetic is not None:
            bench.workshop.add([manifest], bundle.file.path.parent)
    truth = bench.truth(dataset.name)
    if truth is None:
        raise EvaluationError(f"dataset {dataset.name!r} has none in this home")
    return truth.poses, f"the dataset {dataset.name} of this home"


def _tasks(bundle: OpenedBundle, truths: Mapping[str, Any], found: Verification) -> Iterator[_Task]:
    """Yield the runs with files, and the results of them that can be computed again; others are noted."""
    foreign: dict[str, int] = {}
    without = old = 0
    for run in bundle.runs.values():
        record = run.record
        dataset = record.spec["datasetRef"]["name"]
        actual = bundle.study.files.get(run_file(record.name, TRAJECTORY))
        asked: list[tuple[Result, EvaluationSettings]] = []
        if record.results and dataset not in found.absent:
            if run.subject is None or actual is None:
                without += 1
            else:
                _compare_sum(run, actual, found)
                for result in record.results if dataset in truths else []:
                    settings = bundle.study.settings.get(str(result.values.get(SETTINGS_KEY)))
                    if settings is None:
                        foreign[result.evaluation] = foreign.get(result.evaluation, 0) + 1
                    else:
                        asked.append((result, settings))
                        old += version_of(result.values) != VERSION
        if any(run_file(record.name, name) in bundle.study.files for name in MEASURED):
            yield _Task(record.name, dataset, run.subject.subject() if run.subject else None, asked)
    for name, count in sorted(foreign.items()):
        found.notes.append(
            f"evaluation {name!r} of {count} runs isn't computed again: its settings aren't in the bundle"
        )
    if without:
        found.notes.append(f"{without} runs with results have no trajectory in the bundle")
    if old:
        found.notes.append(
            f"{old} results are of another version of the evaluation than this slamhive's, {VERSION}: where "
            "that computes otherwise, they don't agree"
        )


def _compare_sum(run: BundledRun, actual: str, found: Verification) -> None:
    """Compare the checksum of a trajectory, which the bundle was held against, with the record's."""
    info = run.record.trajectory
    if info is not None and info.sha256 == actual:
        found.figures += 1
        return
    bundled = None if info is None else info.sha256
    found.mismatches.append(Mismatch(run.record.name, "", "trajectory.sha256", bundled, actual))


def _compare(run: str, told: Result, answer: Result | Exception) -> tuple[int, list[Mismatch]]:
    """Return the number of figures that agree, and those that don't."""
    if isinstance(answer, Exception):
        return 0, [Mismatch(run, told.evaluation, "outcome", str(told.outcome), str(answer))]
    others: list[Mismatch] = []
    agree = _count_equal(
        "", _figures(told), _figures(answer), partial(Mismatch, run, told.evaluation), others
    )
    return agree, others


def _figures(result: Result) -> Any:
    """Return all that a result says, as archives have it."""
    values = {name: value for name, value in result.values.items() if name not in {SETTINGS_KEY, VERSION_KEY}}
    return clean({"outcome": str(result.outcome), "coverage": result.coverage, **values})


def _count_equal(
    name: str, told: Any, answer: Any, mismatch: Callable[[str, Any, Any], Mismatch], others: list[Mismatch]
) -> int:
    """Return the number of equal figures in two values, and note the others by joined names."""
    match told, answer:
        case None, None:
            return 0
        case ((dict() | None), (dict() | None)):
            theirs, mine = told or {}, answer or {}
            pairs = [
                (f"{name}.{key}" if name else key, theirs.get(key), mine.get(key)) for key in theirs | mine
            ]
        case ((list() | None), (list() | None)):
            both = zip_longest(told or [], answer or [])
            pairs = [(f"{name}[{number}]", *two) for number, two in enumerate(both)]
        # A whole number is one however it was written, and no truth value.
        case _ if told == answer and isinstance(told, bool) is isinstance(answer, bool):
            return 1
        case _:
            others.append(mismatch(name, told, answer))
            return 0
    return sum(_count_equal(*pair, mismatch, others) for pair in pairs)
