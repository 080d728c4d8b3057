# SPDX-License-Identifier: Apache-2.0
"""The order of a check: what is started, and what is looked at after each start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from slamhive.conformance import noderows, rows
from slamhive.conformance.damaging import Damage
from slamhive.conformance.executors import CheckExecutor, CheckStart
from slamhive.conformance.findings import Finding, failed, passed, skipped, warned
from slamhive.conformance.readings import Declared, misread_stamps, readings
from slamhive.conformance.recordings import recording_for
from slamhive.conformance.workstation import variant_of
from slamhive.contract.posefiles import FRAMES
from slamhive.local.home.parameters import parameter_uses
from slamhive.model.algorithm import Pace
from slamhive.model.errors import SlamHiveError
from slamhive.model.results import Phase
from slamhive_eval import Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.conformance.executors import CheckEnd
    from slamhive.conformance.workstation import CheckBench
    from slamhive.data.making.preparation import Variant
    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.model.algorithm import AlgorithmSpec, Mode

_EQUAL_STARTS, _STEPPED_STARTS = 3, 2
_WHEN = (0.4, 0.2, 0.1, 0.0)
"""Shares of its usual time after which the program is told to end; earlier if it had ended by itself."""
_WAIT_SECONDS, _WAIT_TIMES = 30.0, 3.0
"""Longest time of a program over a recording that lacks something: so long, and so many usual times."""


class CheckWatcher(Protocol):
    """Is told how far a check is."""

    def begin(self, steps: int) -> None:
        """So many starts are to come."""

    def step(self, what: str) -> None:
        """One of them begins."""

    def found(self, finding: Finding) -> None:
        """Something was found."""


@dataclass(frozen=True)
class CheckRequest:
    """Request for a conformance check: the algorithm, the dataset, and the time limit of a start.

    Attributes:
        name: the algorithm.
        dataset: a dataset by name; None: the generated one for each mode.
        timeout: how long one start may take, s.
    """

    name: str
    dataset: str | None = None
    timeout: float = 300.0


def check_algorithm(
    bench: CheckBench, executors: Sequence[CheckExecutor], asked: CheckRequest, watcher: CheckWatcher
) -> list[Finding]:
    """Start an algorithm in each of its modes, in each executor, and hold what it does against the contract.

    Raises:
        InputError: there is no algorithm or dataset of that name.
    """
    entry = bench.workshop.algorithm(asked.name)
    if asked.dataset is not None:
        bench.workshop.dataset(asked.dataset)
    modes = entry.algorithm.spec.modes
    equal = _EQUAL_STARTS + (_STEPPED_STARTS if _is_stepped_too(entry.algorithm.spec) else 0)
    watcher.begin(len(executors) * sum(equal + len(mode.needs) + 2 for mode in modes))
    found: list[Finding] = []

    def take(findings: Iterator[Finding]) -> None:
        for finding in findings:
            found.append(finding)
            watcher.found(finding)

    take(parameters(entry))
    for executor in executors:
        for mode in modes:
            examination = _Examination(bench, executor, asked, mode, watcher)
            take(one.at(executor.name, mode.name.value) for one in examination.findings())
    return found


def _is_stepped_too(spec: AlgorithmSpec) -> bool:
    """Tell whether it can be played to frame by frame, beside what it is checked in."""
    return Pace.STEPPED in spec.paces[1:]


def parameters(entry: AlgorithmEntry) -> Iterator[Finding]:
    """Tell whether something reads each parameter that is declared."""
    if not entry.algorithm.spec.parameters:
        return
    check, did = "parameters", "looked for their names in templates and programs"
    unused, why = parameter_uses(entry)
    if not unused:
        yield passed(check, "each is named by a template or a program of its folder", did=did)
        return
    text = f"no template and no program in {entry.folder} names {', '.join(unused)}"
    if why:
        yield warned(check, f"{text}; {why}", did=did)
    else:
        yield failed(check, text, "use it, or leave it out: to vary it changes nothing", did=did)


class _Examination:
    """The check of one mode in one executor."""

    def __init__(
        self,
        bench: CheckBench,
        executor: CheckExecutor,
        asked: CheckRequest,
        mode: Mode,
        watcher: CheckWatcher,
    ) -> None:
        self._bench = bench
        self._executor = executor
        self._asked = asked
        self._mode = mode
        self._watcher = watcher

    @property
    def _spec(self) -> AlgorithmSpec:
        return self._bench.workshop.algorithm(self._asked.name).algorithm.spec

    def findings(self) -> Iterator[Finding]:
        """Start and look."""
        asked, mode = self._asked, self._mode
        try:
            variant = variant_of(self._bench, asked.name, mode, asked.dataset)
            ended = []
            for number in range(_EQUAL_STARTS):
                ended.append(self._start(CheckStart(mode, asked.timeout, number), f"run {number + 1}"))
                if ended[-1].record.phase is not Phase.SUCCEEDED:
                    break
            often = "once" if len(ended) == 1 else f"{len(ended)} times"
            did = f"started {often} on {asked.dataset or recording_for(mode)}"
            verdict = rows.ran(ended)
            yield verdict.at("", "", did)
            for finding in self._of_sound(ended, variant) if verdict.answer != "fail" else ():
                yield finding.at("", "", did)
            if verdict.answer != "fail":
                yield from self._stepped(asked.dataset or recording_for(mode))
                yield from self._of_unsound(ended[-1])
        except SlamHiveError as error:
            yield failed("runs", str(error), "have what it names at hand, or give another --dataset")

    def _start(self, start: CheckStart, what: str) -> CheckEnd:
        self._watcher.step(f"{self._executor.name}, {self._mode.name}: {what}")
        return self._executor.run(start)

    def _of_sound(self, ended: list[CheckEnd], variant: Variant) -> Iterator[Finding]:
        """Look at what starts on a sound recording gave."""
        last, output = ended[-1], self._spec.output_of(self._mode)
        verdict = rows.settings(self._spec, last)
        if verdict is not None:
            yield verdict
        end = variant.start_time + variant.duration_seconds
        truth = self._bench.truth(last.record.spec["datasetRef"]["name"])
        moved = truth.poses if truth is not None else None
        rest = rows.rest_before(end, moved) if isinstance(moved, Trajectory) else 0.0
        yield rows.data(variant.frames, end, variant.duration_seconds, output, last, rest=rest)
        yield from self._poses(last, variant)
        yield rows.repeatable(self._spec.deterministic, ended)
        yield rows.cost(variant.duration_seconds, ended)

        if self._spec.paces[0] is Pace.REALTIME and self._spec.plays(Pace.REALTIME) is not None:
            yield noderows.latency(ended)

    def _stepped(self, dataset: str) -> Iterator[Finding]:
        """Start it frame by frame, and compare."""
        node = self._spec.plays(Pace.STEPPED)
        if node is None or not _is_stepped_too(self._spec):
            return
        ended = []
        for number in range(_EQUAL_STARTS, _EQUAL_STARTS + _STEPPED_STARTS):
            start = CheckStart(self._mode, self._asked.timeout, number, pace=Pace.STEPPED)
            ended.append(self._start(start, f"stepped, run {number + 1 - _EQUAL_STARTS}"))
        did = f"started {_STEPPED_STARTS} times on {dataset} in the pace Stepped"
        yield noderows.stepped(self._spec, node, ended).at("", "", did)

    def _poses(self, ended: CheckEnd, variant: Variant) -> Iterator[Finding]:
        """Tell whether poses fit the ground truth, and as declared better than in any other reading."""
        record = ended.record
        truth = self._bench.truth(record.spec["datasetRef"]["name"])
        result = record.results[0] if record.results else None
        if truth is None or result is None:
            yield skipped("accuracy", record.message or "the dataset has no ground truth")
            return
        if ended.absent:
            yield skipped("accuracy", f"its trajectory is not here: {ended.absent}")
            return
        if ended.trajectory is None:
            how = "a short recording may be too little for it: try one of yours by --dataset"
            yield failed("accuracy", f"{result.outcome}: it wrote no pose", how)
            return
        frames = {"body": np.eye(4)}
        frames |= {role.value: np.array(view.T_body_sensor) for role, view in variant.sensors.items()}
        stamps = np.loadtxt(variant.folder / FRAMES, dtype=np.int64, ndmin=1) / 1e9
        output = self._spec.output_of(self._mode)
        # A player doesn't wait, so that it drops frames on a busy machine; who reads by itself has no excuse.
        is_played = self._spec.plays(self._spec.paces[0]) is not None
        dropped = (record.frames.dropped or 0) if is_played and record.frames is not None else 0
        declared = Declared(self._mode.name, output, frames, variant.duration_seconds, stamps, dropped)
        if result.values.get("ate"):
            yield from readings(declared, truth.poses, ended.trajectory, result)
            return
        yield failed("accuracy", f"{result.outcome}: {result.values.get('message')}", "see the stamp below")
        yield misread_stamps(declared, truth.poses, ended.trajectory)

    def _of_unsound(self, usual: CheckEnd) -> Iterator[Finding]:
        """Start it on recordings that lack something, and tell it to end."""
        wall = usual.record.usage.wall_seconds if usual.record.usage else None
        wall = wall or 0.0
        patience = min(self._asked.timeout, _WAIT_SECONDS + _WAIT_TIMES * wall)
        for role in self._mode.needs:
            start = CheckStart(self._mode, patience, damage=Damage(role))
            yield self._refusal(start, f"without {role}", f"started without the topic of {role}")
        start = CheckStart(self._mode, patience, damage=Damage())
        yield self._refusal(start, "no data", "started on a recording without a message")
        yield self._sigterm(wall)

    def _refusal(self, start: CheckStart, check: str, did: str) -> Finding:
        objection = self._executor.objection(start)
        if objection is not None:
            self._watcher.step(f"{self._executor.name}, {self._mode.name}: {check}")
            return skipped(check, objection)
        return rows.refusal(check, self._start(start, check), start.timeout).at("", "", did)

    def _sigterm(self, wall: float) -> Finding:
        check = "SIGTERM"
        objection = self._executor.objection(CheckStart(self._mode, self._asked.timeout, stop_after=0.0))
        if objection is not None:
            self._watcher.step(f"{self._executor.name}, {self._mode.name}: {check}")
            return skipped(check, objection)
        self._watcher.step(f"{self._executor.name}, {self._mode.name}: {check}")
        for share in _WHEN:
            after = share * wall
            ended = self._executor.run(CheckStart(self._mode, self._asked.timeout, stop_after=after))
            finding = rows.stopped(ended)
            if finding is not None:
                return finding.at("", "", f"sent SIGTERM {after:.1f} s after its start")
        return skipped(check, "it had ended each time before it could be told to")
