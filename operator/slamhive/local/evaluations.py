# SPDX-License-Identifier: Apache-2.0
"""Measuring finished runs again: what an Evaluation asks for."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.analysis.measuring import SETTINGS_KEY, intended_evaluations, settings_hash
from slamhive.model.errors import SlamHiveError
from slamhive.model.results import Phase, RunRecord
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.archive import Archive
    from slamhive.local.workbench import Workbench
    from slamhive.model.evaluation import Evaluation, EvaluationSettings, RunSelector


def evaluate_again(bench: Workbench, evaluation: Evaluation) -> tuple[int, list[str]]:
    """Measure the runs that an Evaluation selects, and keep the results under its name.

    Returns:
        How many were measured, and a sentence for each that could not be.
    """
    done, problems = 0, []
    for record in list(select(bench.archive, evaluation.spec.runs)):
        _intend(bench, record, evaluation.spec, evaluation.name)
        problem = measure_record(bench, record, evaluation.spec, evaluation.name)
        if problem is None:
            done += 1
        else:
            problems.append(f"{record.name}: {problem}")
    if not done and not problems:
        problems.append("no finished run is selected")
    return done, problems


def bring_up_to_date(bench: Workbench, sweep_uid: str, settings: EvaluationSettings) -> list[str]:
    """Measure a sweep's finished runs whose results were made with other settings than these.

    Returns:
        A sentence for each run that could not be measured.
    """
    wanted = settings_hash(settings)
    problems = []
    for record in list(bench.archive.runs({"sweep_uid": sweep_uid})):
        current = any(result.values.get(SETTINGS_KEY) == wanted for result in record.results)
        if not current and record.spec.get("evaluate", True):
            _intend(bench, record, settings)
        if record.phase is not Phase.SUCCEEDED or current or not record.spec.get("evaluate", True):
            continue
        if not record.folder:
            continue
        problem = measure_record(bench, record, settings)
        if problem is not None:
            problems.append(f"{record.name}: {problem}")
    return problems


def measure_record(
    bench: Workbench, record: RunRecord, settings: EvaluationSettings, name: str | None = None
) -> str | None:
    """Measure a finished run and keep the result.

    Returns:
        Why it could not be, or None.
    """
    if record.phase is not Phase.SUCCEEDED:
        return f"{record.phase}, it has no trajectory"
    path = bench.evaluator.trajectory_of(record)
    if path is None:
        return "its trajectory is not on this machine any more"
    dataset, known = record.spec["datasetRef"]["name"], record.provenance.dataset_sha256
    try:
        if known is not None and known != bench.checksum(dataset):
            return f"dataset {dataset!r} is not what it was when this run was made"
        result = bench.evaluator.measure_file(path, record.spec, settings, name=name)
    except SlamHiveError as error:
        return str(error)
    if result is None:
        return "its dataset has no ground truth"
    bench.archive.put_result(record.uid, result)
    return None


def _intend(
    bench: Workbench, record: RunRecord, settings: EvaluationSettings, name: str | None = None
) -> None:
    """Note with a run that it is meant to be measured like this: a failed one counts as failed in it."""
    dataset = None
    with suppress(SlamHiveError):
        dataset = bench.workshop.dataset(record.spec["datasetRef"]["name"]).dataset.spec
    found = intended_evaluations(settings, SensorMode(record.spec["sensors"]), dataset, name)
    if not set(found) <= set(record.evaluations):
        bench.archive.put_evaluations(record.uid, found)


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
        if selector.names and record.name not in selector.names:
            continue
        if any(record.labels.get(key) != value for key, value in selector.match_labels.items()):
            continue
        yield record
