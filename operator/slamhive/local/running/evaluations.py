# SPDX-License-Identifier: Apache-2.0
"""Measuring finished runs again: what an Evaluation asks for."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from slamhive.analysis.measuring import (
    SETTINGS_KEY,
    intended_evaluations,
    is_current,
    outdated_note,
    settings_hash,
)
from slamhive.analysis.subjects import SubjectItem
from slamhive.local.home.removed import absence
from slamhive.local.running.evaluating import TrajectoryEvaluator, UnmeasurableError
from slamhive.model.errors import InputError, SlamHiveError, SystemFault, sentence
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import NOT_EVALUATED, IntendedEvaluation, Phase, RunRecord
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from slamhive.archive import Archive
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.evaluation import Evaluation, RunSelector

_THREADS = 2


class Unmeasured(NamedTuple):
    """A run that could not be measured.

    Attributes:
        sentence: which, and why.
        is_fault: whether the machine or a file is to blame: it would be measured but for that.
    """

    sentence: str
    is_fault: bool = False

    def of(self, run: str) -> Unmeasured:
        """Return the same with the name of the run."""
        return self._replace(sentence=f"{run}: {self.sentence}")


def evaluate_again(bench: Workbench, evaluation: Evaluation) -> tuple[int, list[Unmeasured]]:
    """Measure the runs that an Evaluation selects, and keep the results under its name.

    Returns:
        How many were measured, and what could not be.
    """

    def measured(record: RunRecord) -> Unmeasured | None:
        # Noted first: a run that can't be measured then counts as failed in this Evaluation.
        problem = _intend(bench, record, evaluation.spec, evaluation.name)
        return problem or measure_record(bench, record, evaluation.spec, evaluation.name)

    records = list(select(bench.archive, evaluation.spec.runs))
    problems = _problems(bench, measured, records)
    done = len(records) - len(problems)
    return done, problems or ([] if done else [Unmeasured("no finished run is selected")])


def bring_up_to_date(bench: Workbench, sweep_uid: str, settings: EvaluationSettings) -> list[Unmeasured]:
    """Measure a sweep's finished runs whose results were made otherwise: with other settings, or long ago.

    Results of an earlier version of the evaluation stay where the trajectory is gone.

    Returns:
        The runs that could not be measured.
    """
    wanted = settings_hash(settings)

    def measured(record: RunRecord) -> Unmeasured | None:
        problem = _intend(bench, record, settings)
        if record.phase is not Phase.SUCCEEDED or not record.folder:
            return None
        return problem or measure_record(bench, record, settings)

    asked = [
        record for record in bench.archive.runs({"sweep_uid": sweep_uid}) if record.spec.get("evaluate", True)
    ]
    evaluator = TrajectoryEvaluator(bench)

    def is_stale(record: RunRecord) -> bool:
        same = [result.values for result in record.results if result.values.get(SETTINGS_KEY) == wanted]
        if not same:
            return True
        return (
            not any(is_current(one, wanted) for one in same) and evaluator.trajectory_of(record) is not None
        )

    return _problems(bench, measured, [record for record in asked if is_stale(record)])


def measure_outdated(bench: Workbench, uids: Collection[str]) -> tuple[int, list[Unmeasured]]:
    """Measure those of some runs again that have results of an earlier version of the evaluation.

    Args:
        bench: what runs share.
        uids: of the runs.

    Returns:
        How many have none any more, and what could not be measured.
    """
    known = {settings_hash(one): one for one in (EvaluationSettings(), *_settings_of_sweeps(bench.archive))}

    def measured(record: RunRecord) -> Unmeasured | None:
        problem = None
        for result in record.results:
            if outdated_note(result.values) is None:
                continue
            settings = known.get(result.values[SETTINGS_KEY])
            if settings is None:
                why = "are not known here: run its file, or the import of the run, again"
                problem = Unmeasured(f"the settings of evaluation {result.evaluation!r} {why}")
            else:
                problem = measure_record(bench, record, settings, result.evaluation) or problem
        return problem

    records = [
        record
        for record in bench.archive.runs()
        if record.uid in uids and any(outdated_note(result.values) for result in record.results)
    ]
    problems = _problems(bench, measured, records)
    return len(records) - len(problems), problems


def _settings_of_sweeps(archive: Archive) -> Iterator[EvaluationSettings]:
    for sweep in archive.sweeps():
        with suppress(ValueError):  # as another version may have written them
            yield EvaluationSettings.model_validate(sweep.evaluation or {})


def _problems(
    bench: Workbench, measured: Callable[[RunRecord], Unmeasured | None], records: list[RunRecord]
) -> list[Unmeasured]:
    """Measure runs and return their problems: one is looked up while another is measured."""
    with ThreadPoolExecutor(_THREADS) as pool:
        try:
            found = list(pool.map(measured, records))
        except BaseException:  # Ctrl-C waits for none
            pool.shutdown(wait=False, cancel_futures=True)
            bench.measuring.close()
            raise
    return [problem.of(record.name) for record, problem in zip(records, found, strict=True) if problem]


def measure_record(
    bench: Workbench, record: RunRecord, settings: EvaluationSettings, name: str | None = None
) -> Unmeasured | None:
    """Measure a finished run and keep the result.

    Returns:
        Why it could not be, or None.
    """
    if record.phase is not Phase.SUCCEEDED:
        return Unmeasured(f"{record.phase}, it has no trajectory")
    path = TrajectoryEvaluator(bench).trajectory_of(record)
    if path is None:
        gone = absence(bench.home.path, record.folder)
        return Unmeasured(gone or "its trajectory is not on this machine any more")
    dataset, known = (record.spec.get("datasetRef") or {}).get("name"), record.provenance.dataset_sha256
    try:
        if dataset is None:
            raise InputError("its record names no dataset")
        # Measured against a ground truth of later, an old trajectory would get errors that it doesn't have.
        if known is not None and known != bench.checksum(dataset):
            return Unmeasured(f"dataset {dataset!r} has changed since this run was made")
        subject = None
        if record.origin is not None and record.origin.subject is not None:
            subject = SubjectItem.model_validate(record.origin.subject).subject()
        result = TrajectoryEvaluator(bench).measure_file(
            path, record.spec, settings, name=name, subject=subject
        )
    except (SlamHiveError, OSError) as error:
        if isinstance(error, UnmeasurableError):
            noted = [one.replace(problem=str(error)) for one in _intended(bench, record, settings, name)]
            bench.archive.put_evaluations(record.uid, noted)
        return Unmeasured(sentence(error), is_fault=isinstance(error, SystemFault | OSError))
    if result is None:
        return Unmeasured("its dataset has no ground truth")
    said, why, _ = (record.message or "").partition(NOT_EVALUATED)
    if why:  # it is now
        message = said.removesuffix("; ") or None
        kept = bench.archive.get(record.uid) or record  # as its intended evaluations are by now
        bench.archive.put_run(kept.replace(message=message, results=[result]))
    else:
        bench.archive.put_result(record.uid, result)
    return None


def _intend(
    bench: Workbench, record: RunRecord, settings: EvaluationSettings, name: str | None = None
) -> Unmeasured | None:
    """Note an intended evaluation at a run: if the run failed, it counts as failed there.

    Returns:
        Why it can't be measured so, where that was found out before.
    """
    found = _intended(bench, record, settings, name)
    for noted in record.evaluations:
        if noted.problem is not None and noted.replace(problem=None) in found:
            return Unmeasured(noted.problem)
    if not set(found) <= set(record.evaluations):
        bench.archive.put_evaluations(record.uid, found)
    return None


def _intended(
    bench: Workbench, record: RunRecord, settings: EvaluationSettings, name: str | None
) -> list[IntendedEvaluation]:
    dataset = None
    with suppress(SlamHiveError, KeyError):
        dataset = bench.workshop.dataset(record.spec["datasetRef"]["name"]).dataset.spec
    if record.spec.get("sensors") not in set(SensorMode):  # as of a record of another program
        return []
    return intended_evaluations(settings, SensorMode(record.spec["sensors"]), dataset, name)


def select(archive: Archive, selector: RunSelector) -> Iterator[RunRecord]:
    """Return the finished runs that a selector names; several conditions must all hold.

    Of a sweep, those of its current version are meant.
    """
    where: dict[str, str] = {}
    name = selector.sweep_ref.name if selector.sweep_ref else None
    if name is not None:
        sweep = archive.sweep(name)
        where = {"sweep_uid": sweep.uid} if sweep else {"sweep": name}
    for record in archive.runs(where):
        if selector.selects(record.name, record.sweep, record.labels):
            yield record
