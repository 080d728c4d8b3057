# SPDX-License-Identifier: Apache-2.0
"""Executor of one run on this machine: observes, decides and acts until the run is finished."""

from __future__ import annotations

import os
import threading
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Protocol

from slamhive.analysis.measuring import intended_evaluations
from slamhive.archive.remarks import Remarks
from slamhive.engine import (
    AttemptEnd,
    AttemptState,
    Decision,
    Evaluate,
    Finish,
    LoadConditions,
    Prepare,
    RunObserved,
    RunState,
    Start,
    Stop,
    VariantState,
    decide_run,
    taken_over,
)
from slamhive.local.home.linking import link_to_earlier
from slamhive.local.programs.prepared import AttemptOrder
from slamhive.local.programs.unavailable import ImageMissing, Unavailable
from slamhive.local.running.attempt import Attempt
from slamhive.local.running.configuring import configured
from slamhive.local.running.evaluating import TrajectoryEvaluator, UnmeasurableError
from slamhive.model.base import Choice
from slamhive.model.errors import InputError, SettingsError, SlamHiveError, sentence
from slamhive.model.results import (
    NOT_EVALUATED,
    IntendedEvaluation,
    Outcome,
    Phase,
    Provenance,
    Reason,
    Result,
    RunRecord,
)
from slamhive.model.sensors import SensorMode
from slamhive.plan import recording_fields

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.data.making.preparation import Variant
    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.local.programs.prepared import PreparedProgram
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.configuration import RunConfiguration
    from slamhive.model.evaluation import EvaluationSettings


class AtWorkElsewhere(Exception):  # noqa: N818 - no error: the run waits
    """Another runner is at work on an equal run: this one waits for it, without cores.

    Attributes:
        content: what both have in common: the content hash.
    """

    def __init__(self, content: str) -> None:
        super().__init__(f"another runner computes an equal run ({content[:8]})")
        self.content = content


class RunStep(Choice):
    """Steps of a run that it waits for or works at."""

    CORES = "waiting for a core"
    DATASET = "waiting for its dataset"
    PROGRAM = "making its program ready"
    RECORDING = "preparing its recording"
    RUNNING = "running"
    MEASURING = "measuring"


class PlannedPoint(Protocol):
    """Run of a plan: its name, place in the sweep and spec."""

    @property
    def name(self) -> str:
        """Return the run's name."""

    @property
    def index(self) -> int:
        """Return its place in the sweep."""

    @property
    def spec(self) -> dict[str, Any]:
        """Return the resolved spec, all defaults filled in."""

    @property
    def short_spec(self) -> dict[str, str | None]:
        """Return the names in the spec: algorithm, dataset and sensors."""

    @property
    def spec_hash(self) -> str:
        """Return the hash of the spec."""

    @property
    def asked(self) -> dict[str, Any]:
        """Return the input options that are asked for and have no effect."""


@dataclass(frozen=True)
class RunOrder:
    """A run to be done.

    Attributes:
        uid: its identity in the archive.
        point: what the plan says of it.
        sweep, sweep_uid: name and identity of the sweep it belongs to.
        labels: labels that it carries.
        settings: how it is measured.
        reuse: whether an equal run's result may be taken.
        take_up: whether its own attempt may be taken up that ended while slamhive was not there to keep it.
        twin: identity of the run of the same sweep that asks for the same and was done before, if any.
        holding: open files that the run's supervisor holds as long as it lives.
        remarks: note and tags that it begins with.
    """

    uid: str
    point: PlannedPoint
    sweep: str
    sweep_uid: str
    labels: dict[str, str]
    settings: EvaluationSettings
    reuse: bool
    take_up: bool
    twin: str | None = None
    holding: tuple[int, ...] = ()
    remarks: Remarks = field(default_factory=Remarks)


@dataclass
class _Progress:
    """State of a run as far as it was found out: its program, prepared recording, attempt and results."""

    program: PreparedProgram | None = None
    variant: Variant | None = None
    variant_state: VariantState = VariantState.ABSENT
    variant_problem: tuple[Reason, str] | None = None
    attempt_state: AttemptState = AttemptState.NONE
    twin: RunRecord | None = None
    results: list[Result] = field(default_factory=list)
    remark: str | None = None
    unmeasurable: str | None = None
    provenance: Provenance = field(default_factory=Provenance)


class RunDriver:
    """Brings one run to its end.

    Args:
        order: the run.
        bench: what runs share.
        cpus: logical processors it is pinned to.
        tell: told of each phase.
        step: told of each step.
        claim: called with the content hash before an equal run is looked for; tells whether nobody else is
            at work on one, and keeps others from beginning one.
    """

    def __init__(
        self,
        order: RunOrder,
        bench: Workbench,
        cpus: tuple[int, ...],
        tell: Callable[[Phase], None],
        step: Callable[[RunStep], None] = lambda _: None,
        *,
        claim: Callable[[str], bool] = lambda _: True,
    ) -> None:
        self._claim = claim
        self._order = order
        self._bench = bench
        self._cpus = cpus
        self._tell = tell
        self._step = step
        self._spec = order.point.spec
        self._attempt = Attempt(bench.home.path / "runs" / order.sweep / order.point.name)
        self._cancelled = threading.Event()
        self._progress = _Progress()
        self._remarks = order.remarks

    def cancel(self) -> None:
        """End the run; its thread comes back soon after."""
        self._cancelled.set()
        self._attempt.stop()

    def attempt_end(self) -> AttemptEnd | None:
        """Return the end of the last attempt, None where there was none."""
        return self._attempt.end() if self._progress.attempt_state is AttemptState.ENDED else None

    def drive(self) -> RunRecord:
        """Execute the run until it finishes, and return its record.

        An error that nobody foresaw is this run's own end, never that of the others.

        Raises:
            AtWorkElsewhere: another runner is at work on an equal run, whose result this one may take.
        """
        created = datetime.now(UTC)
        try:
            return self._lead(created)
        except AtWorkElsewhere:
            raise
        except Exception as error:  # noqa: BLE001
            self._attempt.stop()
            self._attempt.wait()
            return self._broken(error, created)

    def _lead(self, created: datetime) -> RunRecord:
        os.sched_setaffinity(0, self._cpus)  # of this thread: what prepares and measures shares its cores
        self._step(RunStep.DATASET)
        with suppress(SlamHiveError, OSError):  # preparing meets it again and gives it its reason
            self._look_up()
        # The folder is the truth: a slamhive that was killed may have left a finished attempt there, not yet
        # archived.
        taken_up = self._progress.attempt_state is AttemptState.ENDED
        state = RunState(attempts=1 if taken_up else 0)
        while not state.phase.is_finished:
            decision = decide_run(state, self._observe(), time.monotonic())
            if decision.state.phase is not state.phase:
                self._tell(decision.state.phase)
            state = decision.state
            for action in decision.actions:
                self._act(action)
            self._pause(decision)
        return self._record(state, created)

    def _broken(self, error: Exception, created: datetime) -> RunRecord:
        message = str(error)
        if not isinstance(error, SlamHiveError):
            message = f"{type(error).__name__}: {error}; see {self._attempt.folder / 'error.txt'}"
            with suppress(OSError):
                self._attempt.folder.mkdir(parents=True, exist_ok=True)
                (self._attempt.folder / "error.txt").write_text("".join(traceback.format_exception(error)))
        return self._finished(
            created,
            phase=Phase.FAILED,
            reason=Reason.SYSTEM_FAULT,
            message=message,
            provenance=self._progress.provenance,
        )

    def _finished(self, created: datetime, **fields: Any) -> RunRecord:
        """Return a record that ends now, with what is known of a run however it ends."""
        order = self._order
        return RunRecord(
            uid=order.uid,
            name=order.point.name,
            sweep=order.sweep,
            sweep_uid=order.sweep_uid,
            index=order.point.index,
            labels=order.labels,
            note=self._remarks.note,
            tags=list(self._remarks.tags),
            noted=self._remarks.noted,
            spec=self._spec,
            evaluations=self._intended(),
            created=created,
            finished=datetime.now(UTC),
            **fields,
        )

    def _pause(self, decision: Decision) -> None:
        if not decision.actions and decision.look_again_at is not None:
            self._cancelled.wait(max(0.0, decision.look_again_at - time.monotonic()))
            self._progress.attempt_state = AttemptState.NONE
            if self._progress.variant_state is VariantState.FAILED:
                self._progress.variant_state = VariantState.ABSENT

    def _look_up(self) -> None:
        """Find out what makes the result what it is, and whether it is there already.

        Raises:
            SlamHiveError: it can't be found out.
            OSError: the disk refuses.
            AtWorkElsewhere: an equal run is being made.
        """
        progress, order, bench = self._progress, self._order, self._bench
        progress.provenance = known = bench.circumstances(order.point.spec_hash)
        program = bench.program(self._spec["algorithmRef"]["name"])
        progress.provenance = known.replace(
            algorithm_hash=program.algorithm_hash, environment=program.environment, image_id=program.image_id
        )
        progress.provenance = bench.provenance(self._spec, order.point.spec_hash, program)
        hashed = progress.provenance.content_hash or ""
        if order.take_up and self._attempt.finished(order.uid, hashed):
            progress.attempt_state = AttemptState.ENDED
        else:
            # Claimed before an equal run is looked for: another runner might finish one in between, and both
            # would have computed it.
            if order.reuse and not self._claim(hashed):
                raise AtWorkElsewhere(hashed)
            twin = self._equal(hashed)
            progress.twin = (
                twin if twin and self._evaluator.can_serve(twin, self._spec, order.settings) else None
            )

    def _equal(self, content_hash: str) -> RunRecord | None:
        """Return a finished run of the same content whose result may be taken."""
        order, archive = self._order, self._bench.archive
        twin = archive.get(order.twin) if order.twin else None
        # Points of one sweep that come out equal run once even where reuse is off: `order.twin` is the
        # earlier one.
        if twin and twin.phase is Phase.SUCCEEDED and twin.provenance.content_hash == content_hash:
            return twin
        return archive.find_reusable(content_hash) if order.reuse else None

    def _observe(self) -> RunObserved:
        progress = self._progress
        ended = progress.attempt_state is AttemptState.ENDED
        return RunObserved(
            retries=self._spec["retries"],
            cancel=self._cancelled.is_set(),
            reusable=progress.twin is not None,
            variant=progress.variant_state,
            variant_problem=progress.variant_problem,
            attempt=progress.attempt_state,
            end=self._attempt.end() if ended else None,
            wants_evaluation=self._spec["evaluate"],
            suspicion=self._bench.suspicion(self._spec, self._algorithm.algorithm) if ended else None,
        )

    def _act(self, action: Prepare | Start | Stop | Evaluate | Finish) -> None:
        match action:
            case Prepare():
                self._prepare()
            case Start():
                self._start()
            case Evaluate():
                self._evaluate()
            case Stop():
                self._attempt.stop()
            case Finish():
                pass

    def _evaluate(self) -> None:
        progress, bench = self._progress, self._bench
        self._step(RunStep.MEASURING)
        try:
            if progress.variant is None:
                progress.variant = bench.prepare(self._spec, self._algorithm.algorithm)
            path, settings = self._attempt.output / "trajectory.txt", self._order.settings
            result = self._evaluator.measure_file(path, self._spec, settings, progress.variant)
            progress.results = [result] if result else []
            if result is not None and result.outcome is Outcome.LOST:
                progress.remark = bench.suspicion(self._spec, self._algorithm.algorithm)
        except (SlamHiveError, OSError) as error:
            progress.unmeasurable = str(error) if isinstance(error, UnmeasurableError) else None
            progress.remark = f"{NOT_EVALUATED}{sentence(error)}"

    def _prepare(self) -> None:
        progress, bench = self._progress, self._bench
        try:
            # Before a program is made ready, which may take minutes.
            bench.require_possible(self._spec, self._algorithm.algorithm)
            self._step(RunStep.PROGRAM)
            progress.program = bench.programs.get(self._algorithm, self._spec["input"]["pace"])
            if progress.provenance.content_hash is None:
                # The disk may have refused before: no run is made without saying of what, nor one that is
                # there already. What is wrong with the data stays so; who prepares or measures says it.
                with suppress(InputError):
                    self._look_up()
                if progress.twin is not None or progress.attempt_state is AttemptState.ENDED:
                    return
            self._step(RunStep.RECORDING)
            progress.variant = bench.prepare(self._spec, self._algorithm.algorithm)
            progress.variant_state = VariantState.READY
        except (SlamHiveError, OSError) as error:
            progress.variant_state = VariantState.FAILED
            progress.variant_problem = _problem(error)

    def _start(self) -> None:
        progress = self._progress
        if progress.variant is None or progress.program is None:
            raise RuntimeError("an attempt was started before its recording was prepared")
        order = AttemptOrder(
            uid=self._order.uid,
            content_hash=progress.provenance.content_hash or "",
            configuration=self._configuration(progress.variant),
            entry=self._algorithm,
            program=progress.program,
            dataset=progress.variant.folder,
            frames=progress.variant.frames,
            spec=self._spec,
            cpus=self._cpus,
            holding=self._order.holding,
        )
        try:
            with progress.variant.in_use():
                if not self._order.take_up:
                    # What is done again isn't finished: its files go now, so does what was measured on them;
                    # what somebody wrote of it is of what it does, not of those files.
                    had = self._bench.archive.get(self._order.uid)
                    self._remarks = Remarks.of(had) if had is not None else self._remarks
                    self._bench.archive.remove_run(self._order.uid)
                self._attempt.start(order)
                self._step(RunStep.RUNNING)
                # Cancelled while the attempt was starting: `cancel` found nothing to stop then.
                if self._cancelled.is_set():
                    self._attempt.stop()
                self._attempt.wait()
        except (SlamHiveError, OSError) as error:
            progress.variant_state = VariantState.FAILED
            progress.variant_problem = _problem(error)
        else:
            progress.attempt_state = AttemptState.ENDED

    def _configuration(self, variant: Variant) -> RunConfiguration:
        dataset = self._bench.dataset(self._spec["datasetRef"]["name"]).dataset
        return configured(self._order.point.name, self._spec, dataset, variant, len(self._cpus))

    def _record(self, state: RunState, created: datetime) -> RunRecord:
        progress, order, attempt = self._progress, self._order, self._attempt
        ended = progress.attempt_state is AttemptState.ENDED
        kept = attempt.collect() if ended else None
        if ended:
            link_to_earlier(attempt.folder)
        base = self._finished(
            created,
            attributes=self._bench.attributes(self._spec["datasetRef"]["name"]),
            phase=state.phase,
            reason=state.reason,
            message="; ".join(filter(None, (state.message, kept, progress.remark))) or None,
            attempts=max(state.attempts, int(ended)),
            provenance=self._provenance(),
        )
        if progress.twin is not None and state.phase is Phase.SUCCEEDED:
            try:
                results = self._evaluator.results_of_twin(progress.twin, self._spec, order.settings)
            except (SlamHiveError, OSError) as error:
                base, results = base.replace(message=f"{NOT_EVALUATED}{sentence(error)}"), []
                if isinstance(error, UnmeasurableError):
                    noted = [one.replace(problem=str(error)) for one in base.evaluations]
                    base = base.replace(evaluations=noted)
            here = LoadConditions.of(progress.provenance)
            taken = taken_over(progress.twin, self._recording(), [here])
            return base.replace(**taken, results=results)
        if not ended:
            return base
        started, finished = attempt.times()
        return base.replace(
            started=datetime.fromisoformat(started) if started else None,
            finished=datetime.fromisoformat(finished) if finished else base.finished,
            usage=attempt.usage(),
            frames=attempt.frames(self._progress.variant.frames if self._progress.variant else None),
            metrics=attempt.metrics(),
            trajectory=attempt.trajectory(),
            results=progress.results,
            folder=str(attempt.folder),
            log_tail=attempt.log_tail(),
        )

    def _intended(self) -> list[IntendedEvaluation]:
        """Return the run's intended evaluations, whether it comes to them or not."""
        if not self._spec["evaluate"]:
            return []
        dataset = None
        # A dataset that can't be read is told of by whoever prepares it; the record only lacks its evaluation
        # then.
        with suppress(SlamHiveError):
            dataset = self._bench.workshop.dataset(self._spec["datasetRef"]["name"]).dataset.spec
        found = intended_evaluations(self._order.settings, SensorMode(self._spec["sensors"]), dataset)
        return [one.replace(problem=self._progress.unmeasurable) for one in found]

    def _provenance(self) -> Provenance:
        """Return the provenance of the result, with what the recording gave of what was asked of it."""
        return self._progress.provenance.replace(**self._recording())

    def _recording(self) -> dict[str, Any]:
        """Return the fields of the provenance that say what the run was given of its recording."""
        progress, spec = self._progress, self._spec
        prepared = progress.variant.told if progress.variant else None
        if progress.twin is not None:
            prepared = progress.twin.provenance.prepared
        mode = self._algorithm.algorithm.spec.mode(SensorMode(spec["sensors"]))
        dataset = self._bench.workshop.dataset(spec["datasetRef"]["name"]).dataset
        return recording_fields(spec["input"], self._order.point.asked, dataset, mode, prepared)

    @property
    def _evaluator(self) -> TrajectoryEvaluator:
        return TrajectoryEvaluator(self._bench)

    @property
    def _algorithm(self) -> AlgorithmEntry:
        return self._bench.workshop.algorithm(self._spec["algorithmRef"]["name"])


def _problem(error: Exception) -> tuple[Reason, str]:
    if isinstance(error, Unavailable):
        return Reason.ALGORITHM_UNAVAILABLE, str(error)
    if isinstance(error, ImageMissing):
        return Reason.IMAGE_PULL_FAILED, str(error)
    if isinstance(error, SettingsError):
        return Reason.INVALID_PARAMETERS, str(error)
    if isinstance(error, InputError):
        return Reason.PREPARATION_FAILED, str(error)
    return Reason.SYSTEM_FAULT, sentence(error)
