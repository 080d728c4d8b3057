# SPDX-License-Identifier: Apache-2.0
"""``slamhive import``: what others ran becomes runs of the archive; here what the original SLAM Hive did."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from slamhive.analysis.measuring import Subject, intended_evaluations, measure, method
from slamhive.archive import CatalogEntry, SweepRecord
from slamhive.bridges import slamhive1
from slamhive.cli.parts.console import complain, open_archive, out
from slamhive.cli.parts.exits import FAILED
from slamhive.cli.parts.waiting import Work
from slamhive.cli.sharing.taking import import_bundle, import_trajectories
from slamhive.data.store.truthfolders import GroundTruthFolder
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import DataError, InputError
from slamhive.model.evaluation import Alignment, EvaluationSettings
from slamhive.model.results import IntendedEvaluation, Phase, Reason, RunRecord, TrajectoryInfo
from slamhive.model.sensors import SensorMode
from slamhive_eval import EvaluationError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from slamhive.archive import Archive
    from slamhive_eval import Trajectory


class _Systems(TyperGroup):
    """Kinds of runs to be taken in; a folder alone is one of the original SLAM Hive, a .zip a bundle."""

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> tuple[str | None, Any, list[str]]:  # type: ignore[override]
        """Find the command that the words name."""
        if args and args[0] not in self.commands and Path(args[0]).is_dir():
            args = ["slam-hive", *args]
        elif args and args[0] not in self.commands and args[0].lower().endswith(".zip"):
            args = ["bundle", *args]
        elif args and args[0] not in self.commands and Path(args[0]).is_file():
            told = f"{args[0]}: a file of poses, it seems: slamhive import trajectories FILE --dataset NAME …"
            raise InputError(f"{told}; allowed here are a .zip and a folder")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=_Systems, no_args_is_help=True, help="Bring runs of other people and other systems into the archive."
)
app.command("bundle")(import_bundle)
app.command("trajectories")(import_trajectories)


@app.callback()
def _imports() -> None:
    """Bring runs of other people and other systems into the archive."""


@app.command("slam-hive")
def import_slam_hive(
    directory: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder with a folder for each run, or with those in `runs`.", exists=True
        ),
    ],
    ground_truth: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder with the ground truth, by dataset name; else `groundtruth` in DIR or beside it.",
            exists=True,
        ),
    ] = None,
    *,
    alignment: Annotated[
        Alignment, typer.Option(help="Auto: Sim3 for mono, SE3 for all others.", case_sensitive=False)
    ] = Alignment.AUTO,
) -> None:
    """Import results of the original SLAM Hive (config.yaml, traj.txt and profiling.csv in each folder).

    Runs that are there already stay as they are; another alignment adds an evaluation of that name.

    Example: slamhive import slam-hive results --ground-truth groundtruth --alignment sim3
    """
    beside = next(filter(Path.is_dir, (directory / "groundtruth", directory.parent / "groundtruth")), None)
    if (ground_truth := ground_truth or beside) is None:
        raise InputError(
            f"{directory}: no folder groundtruth in it or beside it; --ground-truth DIR names the one with "
            "a file for each dataset"
        )
    runs = directory / "runs"
    folders = slamhive1.find_runs(runs if runs.is_dir() else directory)
    settings = EvaluationSettings(alignment=alignment, frame="None")
    method(settings, Subject(SensorMode.STEREO))  # refuses what no run could be measured by
    home = Home.from_environment()
    with open_archive(home) as archive:
        truth = GroundTruthFolder(ground_truth)
        importer = SlamHiveImporter(archive, truth, settings)
        with Work("importing") as work:
            report = importer.take(_counted(folders, work))
        location = archive.location
    for sentence in (*report.sentences(), *keep_ground_truth(truth, report.datasets, home)):
        complain(sentence)
    out.print(
        f"{plural(report.added, 'run')} imported, {plural(report.evaluated, 'run')} evaluated, "
        f"{plural(report.unchanged, 'run')} there already; archive: {location}",
        markup=False,
    )
    if report.outcomes:
        counts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(report.outcomes.items()))
        out.print(f"outcomes: {counts}", markup=False)
    if report.problems:
        raise typer.Exit(FAILED)


@dataclass
class ImportReport:
    """Counts of imported runs and their outcomes, with the problems found, for the summary of an import.

    Attributes:
        added: runs that were new.
        evaluated: runs that got the evaluation asked for.
        unchanged: runs that had both.
        outcomes: outcomes of all runs under the evaluation asked for.
        problems: folders by what is wrong with them.
        datasets: names of the datasets of all runs, as the original has them.
    """

    added: int = 0
    evaluated: int = 0
    unchanged: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    problems: dict[str, list[str]] = field(default_factory=dict)
    datasets: set[str] = field(default_factory=set)

    def sentences(self) -> list[str]:
        """Return one sentence for each kind of problem, with the folders that have it."""
        return [f"{', '.join(folders)}: {problem}" for problem, folders in self.problems.items()]


class SlamHiveImporter:
    """Takes run folders of the original system into an archive.

    Nothing is merged: each folder is a run of its own, and runs of equal configuration become numbered
    repetitions. A run without a usable trajectory is kept as a failed one; a folder that doesn't say what
    was run, or whose ground truth is missing, is left out.
    """

    def __init__(self, archive: Archive, truth: GroundTruthFolder, settings: EvaluationSettings) -> None:
        self._archive = archive
        self._truth = truth
        self._settings = settings
        self._known = {record.uid: record for record in archive.runs({"sweep_uid": slamhive1.SOURCE})}
        self._repetitions: dict[str, set[int]] = {}
        for record in self._known.values():
            taken = self._repetitions.setdefault(record.provenance.spec_hash or "", set())
            taken.add(int(record.spec.get("repetition", 0)))

    def take(self, folders: Iterable[Path]) -> ImportReport:
        """Import folders and return what was done; a problem with one doesn't keep the others out."""
        report = ImportReport()
        for folder in folders:
            try:
                problem = self._take(folder, report)
            except (InputError, EvaluationError) as error:
                problem = str(error)
            except OSError as error:
                problem = f"{error.filename}: {error.strerror}"
            if problem:
                report.problems.setdefault(problem, []).append(folder.name)
        if report.added:
            self._archive.put_sweep(
                SweepRecord(uid=slamhive1.SOURCE, name=slamhive1.SOURCE, spec={}, evaluation=None)
            )
        return report

    def _take(self, folder: Path, report: ImportReport) -> str | None:
        """Import a folder; return what is wrong with its run, if anything."""
        run = slamhive1.read_run(folder)
        report.datasets.add(run.dataset_name)
        subject = Subject(run.sensors)
        evaluation = method(self._settings, subject)
        known = self._known.get(run.uid)
        intended = intended_evaluations(self._settings, run.sensors, None)
        if known is not None:
            self._archive.put_evaluations(run.uid, intended)
            done = [result for result in known.results if result.evaluation == evaluation]
            if known.phase is not Phase.SUCCEEDED or done:
                report.unchanged += 1
                report.outcomes.update(result.outcome.value for result in done)
                return known.message
        reference = self._truth.read(run.dataset_name)
        try:
            estimate = run.read_trajectory()
        except EvaluationError as error:
            return self._keep_failed(run, intended, str(error), report)
        result = measure(reference, estimate, self._settings, subject)
        report.outcomes[result.outcome.value] += 1
        report.evaluated += 1
        if known is not None:
            self._archive.put_result(run.uid, result)
            return None
        record = self._new_record(run)
        info = _trajectory_info(estimate, run.trajectory_sha256 or "")
        self._put(run, record.replace(trajectory=info, evaluations=intended, results=[result]), report)
        return None

    def _keep_failed(
        self,
        run: slamhive1.OriginalRun,
        intended: list[IntendedEvaluation],
        problem: str,
        report: ImportReport,
    ) -> str:
        reason = Reason.NO_TRAJECTORY if run.trajectory_is_empty else Reason.INVALID_TRAJECTORY
        message = f"{problem}; kept as a failed run ({reason})"
        ended = {"phase": Phase.FAILED, "reason": reason, "message": message}
        record = self._new_record(run).replace(**ended, evaluations=intended)
        self._put(run, record, report)
        return message

    def _new_record(self, run: slamhive1.OriginalRun) -> RunRecord:
        taken = self._repetitions.setdefault(run.configuration_hash, set())
        repetition = next(number for number in range(len(taken) + 1) if number not in taken)
        record = run.record(repetition)
        taken.add(repetition)
        return record

    def _put(self, run: slamhive1.OriginalRun, record: RunRecord, report: ImportReport) -> None:
        self._archive.put_run(record, _algorithm_entry(run), _dataset_entry(run, self._truth))
        self._known[run.uid] = record
        report.added += 1


def keep_ground_truth(truth: GroundTruthFolder, datasets: Iterable[str], home: Home) -> list[str]:
    """Copy ground truth into the home, for the dashboard's plots; return remarks.

    Args:
        truth: where it is.
        datasets: their names; one without ground truth is passed over, as its runs have been told of.
        home: gets ``groundtruth/DATASET.txt`` or ``.csv``.
    """
    sentences = []
    try:
        folder = home.folder("groundtruth")
    except InputError as error:
        return [f"ground truth is not kept for the dashboard: {error}"]
    for dataset in sorted(datasets):
        try:
            if not truth.copy(dataset, folder):
                sentences.append(
                    f"{folder}: has another ground truth of {dataset}, which stays: paths are drawn over it"
                )
        except DataError:
            continue
        except OSError as error:
            sentences.append(f"{folder}: ground truth of {dataset} is not kept: {error.strerror}")
    return sentences


def _counted(folders: Sequence[Path], work: Work) -> Iterator[Path]:
    """Yield folders, and say how many are done."""
    for done, folder in enumerate(folders):
        work.count(done, len(folders))
        yield folder


def _trajectory_info(estimate: Trajectory, sha256: str) -> TrajectoryInfo:
    length = float(estimate.stamps[-1] - estimate.stamps[0])
    return TrajectoryInfo(poses=len(estimate), duration_seconds=length, sha256=sha256, path="traj.txt")


def _algorithm_entry(run: slamhive1.OriginalRun) -> CatalogEntry:
    return CatalogEntry(
        kind="Algorithm",
        name=run.algorithm,
        labels={"source": slamhive1.SOURCE, "algorithm": run.algorithm_name},
        spec={
            "description": f"{run.algorithm_name} as the original SLAM Hive ran it",
            "modes": [{"name": run.sensors.value}],
        },
    )


def _dataset_entry(run: slamhive1.OriginalRun, truth: GroundTruthFolder) -> CatalogEntry:
    return CatalogEntry(
        kind="Dataset",
        name=run.dataset,
        labels={"source": slamhive1.SOURCE, "dataset": run.dataset_name},
        spec={
            "description": f"{run.dataset_name} as the original SLAM Hive played it",
            "groundTruth": {"file": truth.path(run.dataset_name).name},
        },
    )
