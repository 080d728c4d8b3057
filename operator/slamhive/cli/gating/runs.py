# SPDX-License-Identifier: Apache-2.0
"""Runs of a gate: its sweeps, rounds of what is asked for, and what came of them."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.analysis.derived import with_derived
from slamhive.analysis.gating.figures import (
    COVERAGE,
    FAILURES,
    MARGINS,
    GateFigure,
)
from slamhive.analysis.grouping import CONDITIONS
from slamhive.analysis.measuring import SETTINGS_KEY, settings_hash
from slamhive.analysis.searches.seen import records_frame
from slamhive.cli.parts.checked import check_files
from slamhive.cli.parts.exits import INTERRUPTED
from slamhive.cli.parts.planning import planned
from slamhive.cli.parts.progress import Naming
from slamhive.cli.running import drive, measure_all
from slamhive.engine import LoadConditions
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job
from slamhive.model.base import NAME_LIMIT, plural
from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome, Phase, Reason
from slamhive.model.run import essential
from slamhive.model.sweep import Sweep
from slamhive.plan import local_uid
from slamhive.reporting.gate.baseline import BaselineCell

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from datetime import datetime

    from slamhive.analysis.frame import Frame
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.running.workbench import Workbench
    from slamhive.plan import Plan

USUAL_REPETITIONS = 10
"""Repetitions of a setting, recorded and at most tried, of a sweep that has none of its own."""

BESIDE_OTHERS = "disturbed"
"""Column that says which runs had other work beside them, kept of each run in a baseline."""

TIER = "tier"
"""Label of sweeps by which ``--tier`` chooses."""

_SUFFIX = "-gate"


@dataclass(frozen=True)
class GateWish:
    """Options of a gate's runs.

    Attributes:
        repetitions: of a setting at most; None for the sweep's own.
        budget: seconds after which none is started.
        parallelism: runs at the same time at most.
        since: runs that began earlier are done again; None: finished ones are taken.
        figures: what is looked at.
        chosen: whether the figures were named.
    """

    repetitions: int | None
    budget: float | None
    parallelism: int | None
    since: datetime | None
    figures: Sequence[GateFigure]
    chosen: bool


@dataclass
class GateSweep:
    """A sweep under test.

    Attributes:
        named: its own name; that of its runs is another, as they are no version of it.
        sweep, points: with as many repetitions as may be done.
        asked: repetitions of each row of the plan that were asked for so far.
        batch: numbers of the runs that are asked for now.
    """

    named: str
    sweep: Sweep
    points: Plan
    asked: dict[int, int] = field(default_factory=dict)
    batch: set[int] = field(default_factory=set)

    def ask(self, row: int, count: int) -> None:
        """Ask for more repetitions of a setting."""
        known = self.asked.get(row, 0)
        self.asked[row] = known + count
        self.batch |= {self.index(row, known + k) for k in range(count)}

    @property
    def uid(self) -> str:
        """Identity of the sweep of its runs."""
        return local_uid(self.sweep)

    def begun_since(self, bench: Workbench, time: datetime) -> set[int]:
        """Return the numbers of its finished runs that began since a time."""
        numbers = {Job(self.sweep, self.uid, self.points).run_uid(k): k for k in range(len(self.points))}
        records = bench.archive.runs({"sweep_uid": self.uid})
        return {
            numbers[one.uid] for one in records if one.uid in numbers and one.started and one.started >= time
        }

    @property
    def rows(self) -> range:
        """Numbers of the settings."""
        return range(len(self.points) // self.points.repetitions)

    def index(self, row: int, repetition: int = 0) -> int:
        """Return the number of a run."""
        return row * self.points.repetitions + repetition

    def settings(self, row: int) -> tuple[dict[str, Any], str | None]:
        """Return the value on each axis, and the dataset."""
        point = self.points.point(self.index(row))
        found = normalize(dict(point.coordinates))
        return dict(found), point.short_spec["dataset"]

    def input(self, row: int) -> dict[str, Any]:
        """Input of a setting as its hash has it: the part of the recording, its pace."""
        return essential(self.points.point(self.index(row)).spec["input"])

    def words(self, row: int) -> str:
        """Return the words that tell a setting from the others."""
        found = Naming(self.points).settings(self.index(row))
        parts = [f"{name.removeprefix('parameters.')} {value}" for name, value in found.items()]
        return ", ".join(parts) or str(self.settings(row)[1])


def sweeps_under_test(
    files: Sequence[Path], workshop: Workshop, tier: str | None, wish: GateWish
) -> list[GateSweep]:
    """Return the sweeps of manifests, with as many repetitions as may be done.

    Raises:
        InputError: something is wrong in them, there is none, or one is a search.
    """
    checked = check_files(files, workshop)
    checked.refuse()
    sweeps = [sweep for sweep, _ in checked.plans]
    if not sweeps:
        raise InputError(f"{files[0]}: no Sweep or MappingRun in it")
    if tier is not None:
        labels = sorted(
            {str(sweep.metadata.labels[TIER]) for sweep in sweeps if TIER in sweep.metadata.labels}
        )
        sweeps = [sweep for sweep in sweeps if sweep.metadata.labels.get(TIER) == tier]
        if not sweeps:
            known = f"those here have {', '.join(labels)}" if labels else "none here has a label tier"
            raise InputError(f"--tier {tier}: no sweep has it; {known}")
    found = []
    for sweep in sweeps:
        if sweep.spec.search.is_search:
            raise InputError(
                f"Sweep {sweep.name}: a search tries other settings each time: no gate has those"
            )
        own = sweep.spec.repetitions if sweep.spec.repetitions > 1 else USUAL_REPETITIONS
        name = f"{sweep.name[: NAME_LIMIT - len(_SUFFIX)]}{_SUFFIX}"
        longer = sweep.replace(
            metadata=sweep.metadata.replace(name=name),
            spec=sweep.spec.replace(repetitions=wish.repetitions or own),
        )
        found.append(GateSweep(sweep.name, longer, planned(longer, workshop, strict=False)))
    return found


def do_round(
    tests: Sequence[GateSweep], bench: Workbench, wish: GateWish, left: float | None
) -> tuple[int, bool]:
    """Do the runs that are asked for now; returns the exit code and whether a file was in the way."""
    jobs = []
    for test in tests:
        if not test.batch:
            continue
        sweep = test.sweep
        if left is not None:
            text = f"{max(1, math.ceil(left))}s"
            sweep = sweep.replace(spec=sweep.spec.replace(budget=sweep.spec.budget.replace(wall_time=text)))
        job = Job(sweep, test.uid, test.points)
        job.asked, test.batch = test.batch, set()
        if wish.since is not None:
            job.again = job.asked - test.begun_since(bench, wish.since)
        jobs.append(job)
    code = drive(jobs, bench, RunChoice(), wish.parallelism)
    return code, code != INTERRUPTED and measure_all(bench, jobs, [])


@dataclass(frozen=True)
class GateRows:
    """Finished runs of a test by row, with what is said of them.

    Attributes:
        cells: by row of the plan.
        faults: sentences on runs in whose way the machine was.
        conditions: those that load was measured under.
        reused: number of results that were taken over.
        disturbed: number of runs beside other work.
    """

    cells: dict[int, BaselineCell]
    faults: list[str]
    conditions: set[LoadConditions]
    reused: int
    disturbed: int


def collect(test: GateSweep, bench: Workbench, columns: Iterable[str]) -> GateRows:
    """Return the finished ones of the runs that were asked for, row by row."""
    wanted = settings_hash(test.sweep.spec.evaluation)
    frame = _own_runs(test, bench, wanted)
    uids = Job(test.sweep, test.uid, test.points)
    places = {
        uids.run_uid(test.index(row, k)): (row, k) for row, count in test.asked.items() for k in range(count)
    }
    names = (
        "uid",
        "status",
        "phase",
        "reason",
        "settings",
        "alignment",
        "dataset",
        "provenance.datasetSha256",
        *CONDITIONS,
        "provenance.reusedFrom",
        "usage.memory.kind",
        BESIDE_OTHERS,
    )
    about = {name: frame.column(name).tolist() for name in names}
    numbers = {name: frame.column(name).floats().tolist() for name in columns if name != FAILURES}
    found: dict[int, list[tuple[int, int]]] = defaultdict(list)
    faults, reused, disturbed = [], 0, 0
    for line, uid in enumerate(about["uid"]):
        if uid not in places:
            continue
        row, repetition = places[uid]
        reason = about["reason"][line]
        if reason in set(Reason) and Reason(reason).is_infrastructure:
            faults.append(f"{test.words(row)}, repetition {repetition}: {reason}: not counted")
            continue
        if about["phase"][line] == Phase.SUCCEEDED and about["settings"][line] is None:
            faults.append(f"{test.words(row)}, repetition {repetition}: not measured: not counted")
            continue
        reused += about["provenance.reusedFrom"][line] is not None
        disturbed += about[BESIDE_OTHERS][line] is True
        found[row].append((repetition, line))
    cells = {}
    for row, pairs in sorted(found.items()):
        lines = [line for _, line in sorted(pairs)]
        tracked = [about["status"][line] == Outcome.TRACKED for line in lines]
        settings, dataset = test.settings(row)

        def one(name: str, lines: Sequence[int] = lines) -> str | None:
            return next((value for line in lines if (value := about[name][line]) is not None), None)

        cells[row] = BaselineCell(
            sweep=test.named,
            settings=settings,
            dataset=dataset,
            dataset_sha256=one("provenance.datasetSha256"),
            input=test.input(row),
            alignment=one("alignment"),
            evaluation=wanted,
            memory=one("usage.memory.kind"),
            tracked=tracked,
            values={
                name: [
                    number_or_none(of[line]) if good or name == COVERAGE else None
                    for line, good in zip(lines, tracked, strict=True)
                ]
                for name, of in numbers.items()
                if not all(math.isnan(of[line]) for line in lines)
            },
        )
    conditions = {LoadConditions(*row) for row in zip(*(about[name] for name in CONDITIONS), strict=True)}
    return GateRows(cells, faults, conditions - {LoadConditions(None)}, reused, disturbed)


def _own_runs(test: GateSweep, bench: Workbench, wanted: str) -> Frame:
    """Return the table of a test's own runs alone, with the results of its settings."""
    found = [
        record.replace(results=[one for one in record.results if one.values.get(SETTINGS_KEY) == wanted])
        for record in bench.archive.runs({"sweep_uid": test.uid})
    ]
    frame = records_frame(found)
    return with_derived({name: frame.column(name) for name in frame.stored}, len(frame))


def number_or_none(value: float) -> float | None:
    """Return a number as JSON has it: None for what isn't finite."""
    return value if math.isfinite(value) else None


def recorded_columns(wish: GateWish) -> list[str]:
    """Return the columns that are kept of runs."""
    return list(dict.fromkeys([*MARGINS, *(one.name for one in wish.figures), BESIDE_OTHERS]))


def few_repetitions(cells: Sequence[BaselineCell]) -> list[str]:
    """Return the sentences on settings of a baseline that have one repetition alone."""
    alone = sum(len(cell.tracked) == 1 for cell in cells)
    if not alone:
        return []
    which = "all settings" if alone == len(cells) else plural(alone, "setting")
    sentence = (
        f"{which} of the baseline ran once: how much they varied can't be told, nor whether a run that fails "
        "now would have failed then; the spread of the new runs is taken for both"
    )
    return [sentence]


def tell_disturbed(rows: GateRows, tell: Callable[[str], None]) -> None:
    """Tell of runs beside which other work went on."""
    if rows.disturbed:
        tell(f"{plural(rows.disturbed, 'run')} shared cores with other work: mind that in CPU and time")
