# SPDX-License-Identifier: Apache-2.0
"""Verifying of a bundle: every figure that comes from a trajectory is computed once more, and compared.

The code is that of evaluation itself, in processes of their own within the same limits, one a processor. The
ground truth is this home's, or fetched or made by its name, if its checksum is the one that the study has.
"""

from __future__ import annotations

import math
import os
import queue
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.analysis.measuring import SETTINGS_KEY, VERSION_KEY, version_of
from slamhive.archive.records import clean
from slamhive.bridges.bundles.contents import TRAJECTORY, truth_sha256
from slamhive.data.store.truthfolders import GroundTruthFolder
from slamhive.local.running.measuring_apart import measuring_process
from slamhive.model.dataset import Dataset
from slamhive.model.errors import SlamHiveError, sentence
from slamhive.monitor.measuring.bounded import LimitError
from slamhive_eval import EvaluationError
from slamhive_eval.evaluation import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from slamhive.analysis.measuring import Subject
    from slamhive.bridges.bundles.contents import BundledRun, StudyDataset
    from slamhive.bridges.bundles.opening import OpenedBundle
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import Result
    from slamhive.monitor.measuring.bounded import BoundedProcess

_DIGITS = 8


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
    """A result to be computed again."""

    run: BundledRun
    result: Result
    path: Path
    subject: Subject


def verify(
    bench: Workbench,
    bundle: OpenedBundle,
    ground_truth: Path | None = None,
    step: Callable[[int, int], None] = lambda *_: None,
    *,
    processes: int | None = None,
) -> Verification:
    """Compute all figures of a bundle's trajectories again.

    Args:
        bench: the home that has the ground truth, or gets it.
        bundle: the bundle.
        ground_truth: a folder with files named after datasets that is looked into first.
        step: called with the number of results done, and of all.
        processes: how many compute; default: one a processor.
    """
    found = Verification()
    truths = _truths(bench, bundle, ground_truth, found)
    tasks = list(_tasks(bundle, truths, found))
    found.results, found.runs = len(tasks), len({task.run.record.uid for task in tasks})
    processes = min(processes or len(os.sched_getaffinity(0)), max(len(tasks), 1))
    free: queue.SimpleQueue[BoundedProcess] = queue.SimpleQueue()
    workers = [measuring_process() for _ in range(processes)]
    for worker in workers:
        free.put(worker)

    def compute(task: _Task) -> Result | Exception:
        worker, name = free.get(), task.run.record.spec["datasetRef"]["name"]
        try:
            settings = bundle.study.settings[task.result.values[SETTINGS_KEY]]
            question = (task.path, name, settings, task.subject, task.result.evaluation)
            answer: Result | Exception = worker.ask(question, **{name: truths[name]})
        except (LimitError, RuntimeError) as error:
            return error
        finally:
            free.put(worker)
        return answer

    try:
        with ThreadPoolExecutor(processes) as pool:
            for number, (task, answer) in enumerate(zip(tasks, pool.map(compute, tasks), strict=True)):
                step(number, len(tasks))
                _compare(task, answer, found)
    finally:
        for worker in workers:
            worker.close()
    return found


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
            bench.workshop.add([manifest], bundle.folder)
    truth = bench.truth(dataset.name)
    if truth is None:
        raise EvaluationError(f"dataset {dataset.name!r} has none in this home")
    return truth.poses, f"the dataset {dataset.name} of this home"


def _tasks(bundle: OpenedBundle, truths: Mapping[str, Any], found: Verification) -> Iterator[_Task]:
    """Yield the results that can be computed again, and note the others."""
    foreign: dict[str, int] = {}
    without = old = 0
    for run in bundle.runs.values():
        record = run.record
        dataset, path = record.spec["datasetRef"]["name"], bundle.file(record.name, TRAJECTORY)
        if not record.results or dataset in found.absent:
            continue
        if run.subject is None or not path.is_file():
            without += 1
            continue
        _compare_file(run, bundle.study.files[f"runs/{record.name}/{TRAJECTORY}"], found)
        if dataset not in truths:
            continue
        for result in record.results:
            if result.values.get(SETTINGS_KEY) not in bundle.study.settings:
                foreign[result.evaluation] = foreign.get(result.evaluation, 0) + 1
                continue
            old += version_of(result.values) != VERSION
            yield _Task(run, result, path, run.subject.subject())
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


def _compare_file(run: BundledRun, actual: str, found: Verification) -> None:
    """Compare the checksum of a trajectory, which the bundle was held against, with the record's."""
    info = run.record.trajectory
    if info is not None and info.sha256 == actual:
        found.figures += 1
        return
    bundled = None if info is None else info.sha256
    found.mismatches.append(Mismatch(run.record.name, "", "trajectory.sha256", bundled, actual))


def _compare(task: _Task, answer: Result | Exception, found: Verification) -> None:
    name, told = task.run.record.name, task.result
    if isinstance(answer, Exception):
        found.mismatches.append(Mismatch(name, told.evaluation, "outcome", str(told.outcome), str(answer)))
        return
    mine, theirs = (_figures(one) for one in (answer, told))
    for figure in [*theirs, *(one for one in mine if one not in theirs)]:
        bundled, recomputed = theirs.get(figure), mine.get(figure)
        if bundled == recomputed and type(bundled) is type(recomputed):
            found.figures += 1
        else:
            found.mismatches.append(Mismatch(name, told.evaluation, figure, bundled, recomputed))


def _figures(result: Result) -> dict[str, Any]:
    """Return all that a result says, by joined names, as archives have it."""
    values = {name: value for name, value in result.values.items() if name not in {SETTINGS_KEY, VERSION_KEY}}
    found: dict[str, Any] = {}
    _flatten("", clean({"outcome": str(result.outcome), "coverage": result.coverage, **values}), found)
    return found


def _flatten(prefix: str, value: Any, found: dict[str, Any]) -> None:
    if isinstance(value, dict):
        for name, item in value.items():
            _flatten(f"{prefix}.{name}" if prefix else name, item, found)
    elif isinstance(value, list):
        for number, item in enumerate(value):
            _flatten(f"{prefix}[{number}]", item, found)
    elif value is not None:
        # A whole number is one however it was written.
        whole = isinstance(value, float) and math.isfinite(value) and value.is_integer()
        found[prefix] = int(value) if whole else value
