# SPDX-License-Identifier: Apache-2.0
"""Story of a search: what it tried, where each setting stands, how the best came about, and what matters.

Commands, pages and figures all tell it from here. Nothing of it is stored: standings follow from the trials
that were written down and from the runs that ended, by the same decisions that led the search.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import where_equal
from slamhive.analysis.importance import explained
from slamhive.analysis.searches.seen import rows_seen
from slamhive.analysis.selection import first_rows
from slamhive.analysis.statistics import average_ranks
from slamhive.archive.archive import FOREIGN
from slamhive.engine import best_of
from slamhive.engine.deciding import decide
from slamhive.model.algorithm import Algorithm
from slamhive.model.base import API_VERSION
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, SlamHiveError
from slamhive.model.results import Phase
from slamhive.model.search import Goal
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, SearchPlan
from slamhive.plan import plan_of as plan_of_sweep

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.analysis.columns import Floats
    from slamhive.analysis.frame import Frame
    from slamhive.archive.records import CatalogEntry, SweepRecord
    from slamhive.engine import Score, SearchDecision, TrialStanding
    from slamhive.model.search import Search, SearchRecord
    from slamhive.plan import Catalog

LEAST_TRIALS = 20
"""Settings with figures from which on it is said which axes matter: of fewer, chance says too much."""

_LEAST_OF_GROUP = 8
_MOST_GROUPS = 8
_LONG_GAP = 10


@dataclass(frozen=True)
class TriedSetting:
    """A setting that a search tried.

    Attributes:
        number: its place among the trials.
        values: value on each searched axis, by label.
        origin: whether it was drawn, or known before.
        told: the sampler knew the results of all trials below this number.
        runs: how many of its runs have ended.
        spared: how many of these took the result of an equal run.
        judged: how many runs its figures are of; the first ones in the order in which they are done.
        figures: its figure for each objective; None where no run of it has one.
        failed: share of these runs that failed; None before it was judged.
        first: its figures after the first step, which all settings have; None before that.
        dropped: why it gets no further runs.
        is_complete: whether all its runs have ended.
        is_best: whether no other one with all runs is better.
        at: how many runs had been computed when the last of its runs ended.
    """

    number: int
    values: dict[str, Any]
    origin: str
    told: int
    runs: int
    spared: int
    judged: int
    figures: tuple[float | None, ...]
    failed: float | None
    first: Score | None
    dropped: str | None
    is_complete: bool
    is_best: bool
    at: int

    @property
    def state(self) -> str:
        """Return in a word where it stands."""
        if self.is_best:
            return "best"
        if self.is_complete:
            return "all runs"
        return "dropped" if self.dropped is not None else "under way"

    def as_json(self) -> dict[str, Any]:
        """Return it as a document."""
        return {
            "number": self.number,
            "values": self.values,
            "state": self.state,
            "origin": self.origin,
            "told": self.told,
            "runs": self.runs,
            "spared": self.spared,
            "judged": self.judged,
            "figures": list(self.figures),
            "failed": self.failed,
            "dropped": self.dropped,
            "at": self.at,
        }


@dataclass(frozen=True)
class SearchStep:
    """Best settings from a run on.

    Attributes:
        runs: how many runs had been computed by then.
        best: numbers of the trials that no other one was better than; with one objective the best first.
    """

    runs: int
    best: tuple[int, ...]


@dataclass(frozen=True)
class AxisInfluence:
    """Share of the order of settings that an axis explains.

    Attributes:
        label: the axis.
        shares: for each objective, the share of the variation of the ranks that it explains alone, 0 … 1.
        groups: in how many groups of near values its settings were compared.
    """

    label: str
    shares: tuple[float, ...]
    groups: int


@dataclass(frozen=True)
class SearchStory:
    """A search as far as it has come.

    Attributes:
        search: what is asked.
        axes: searched axes: label, and whether ratios of its values count rather than differences.
        contexts: coordinates of what each setting is run on.
        block: runs that a setting can have.
        trials: the settings, by number.
        history: how the best came about: what changed, run by run.
        influences: which axes matter, the strongest first; empty of fewer than LEAST_TRIALS settings.
        compared: of how many settings these are.
        most: trials at most.
        ended, computed: runs that ended, and those of them that took no result of an equal run.
        spared: runs whose results the archive had before.
        wanted: runs that are wanted at present.
        to_come: runs that may yet come at most, wanted ones included.
        expected: runs that are to be expected, by what a setting took so far.
        seconds_left: time that these take, by how fast runs ended so far, s; None where that isn't known.
        is_over: whether nothing more is wanted.
        message: a sentence on where it stands.
    """

    search: Search
    axes: tuple[tuple[str, bool], ...]
    contexts: tuple[dict[str, Any], ...]
    block: int
    trials: tuple[TriedSetting, ...] = ()
    history: tuple[SearchStep, ...] = ()
    influences: tuple[AxisInfluence, ...] = ()
    compared: int = 0
    most: int = 0
    ended: int = 0
    computed: int = 0
    spared: int = 0
    wanted: int = 0
    to_come: int = 0
    expected: int = 0
    seconds_left: float | None = None
    is_over: bool = False
    message: str = ""

    @property
    def best(self) -> tuple[int, ...]:
        """Return the numbers of the best settings."""
        return self.history[-1].best if self.history else ()

    @property
    def averaged(self) -> str:
        """Return the make-up of the figure of a setting with all its runs, as part of a sentence."""
        return averaged_text(self.search, self.block, len(self.contexts))

    def as_json(self) -> dict[str, Any]:
        """Return it as a document, for pages and programs."""
        return {
            "method": self.search.method.value,
            "objectives": [{"metric": one.metric, "goal": one.goal.value} for one in self.search.objectives],
            "axes": [{"label": label, "log": is_log} for label, is_log in self.axes],
            "contexts": list(self.contexts),
            "block": self.block,
            "averaged": self.averaged,
            "trials": [trial.as_json() for trial in self.trials],
            "history": [{"runs": step.runs, "best": list(step.best)} for step in self.history],
            "best": list(self.best),
            "influences": [
                {"axis": one.label, "shares": list(one.shares), "groups": one.groups}
                for one in self.influences
            ],
            "compared": self.compared,
            "leastCompared": LEAST_TRIALS,
            "most": self.most,
            "ended": self.ended,
            "computed": self.computed,
            "spared": self.spared,
            "wanted": self.wanted,
            "toCome": self.to_come,
            "expected": self.expected,
            "secondsLeft": self.seconds_left,
            "over": self.is_over,
            "message": self.message,
        }


def averaged_text(search: Search, block: int, contexts: int) -> str:
    """Return the make-up of the figure of a setting with all its runs, as part of a sentence."""
    each = block // max(contexts, 1)
    runs = "one run" if each == 1 else f"the mean of {each} runs"
    if contexts <= 1:
        return runs
    over = " × ".join(search.across or ["dataset"])
    if search.aggregate.value == "Worst":
        return f"the worst of {contexts} values of {over}, of each {runs}"
    return f"the mean over {contexts} values of {over}, of each {runs}"


def catalog_of(entries: Iterable[CatalogEntry]) -> FixedCatalog:
    """Return the catalog as runs used it; of several versions of a name the last one counts."""
    kinds: dict[str, type[Algorithm | Dataset]] = {"Algorithm": Algorithm, "Dataset": Dataset}
    found: list[object] = []
    for entry in entries:
        body = {"apiVersion": API_VERSION, "kind": entry.kind, "spec": entry.spec}
        with suppress(ValueError):  # of another version of slamhive
            metadata = {"name": entry.name, "labels": entry.labels}
            found.append(kinds[entry.kind].model_validate(body | {"metadata": metadata}))
    return FixedCatalog.of(found)


def sweep_of(record: SweepRecord) -> Sweep:
    """Return the Sweep that a record was made of; somebody else's without the label that it has here.

    Raises:
        ValueError: it is none that this version knows.
    """
    name = record.name.partition(FOREIGN)[0]
    body: dict[str, Any] = {"apiVersion": API_VERSION, "kind": "Sweep", "metadata": {"name": name}}
    return Sweep.model_validate(body | {"spec": record.spec})


def most_runs(record: SweepRecord) -> int | None:
    """Return the number of runs that a sweep asks for, a search at most; None where its spec doesn't say."""
    if not record.spec:
        return None
    try:
        return plan_of_sweep(sweep_of(record), FixedCatalog(), strict=False).most_runs
    except (SlamHiveError, ValueError, KeyError, TypeError):
        return None


def plan_of(record: SweepRecord, catalog: Catalog | None = None) -> SearchPlan:
    """Return the plan of a recorded search with the trials so far.

    Args:
        record: the sweep as the archive has it.
        catalog: what its selectors mean, and which parameters take whole numbers.

    Raises:
        InputError: it is no search, or not one that this version can read.
    """
    try:
        sweep = sweep_of(record) if record.spec else None  # trajectories of others have none
        if sweep is None or not sweep.spec.search.is_search:
            raise InputError(f"sweep {record.name}: is no search: it runs every point of its matrix")
        trials = record.search.trials if record.search is not None else []
        return SearchPlan(sweep, catalog or FixedCatalog(), trials, strict=False, uid=record.uid)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"sweep {record.name}: its search can't be read: {error}") from None


def story_of(record: SweepRecord, frame: Frame, catalog: Catalog | None = None) -> SearchStory:
    """Return the story of a recorded search.

    Args:
        record: the sweep as the archive has it.
        frame: the table of runs, with those of other sweeps.
        catalog: as for ``plan_of``.

    Raises:
        InputError: it is no search, or can't be read.
    """
    plan = plan_of(record, catalog)
    return tell(plan, record.search, frame.select(where_equal(frame, "sweep.uid", record.uid)))


def uid_of_run(frame: Frame, sweep: str, index: int) -> str | None:
    """Return the identity of a run of a sweep by its index; None where it isn't there.

    Args:
        frame: the table of runs.
        sweep: identity of the sweep.
        index: the run's.
    """
    found = where_equal(frame, "sweep.uid", sweep) & (frame.column("index").floats() == index)
    return next(iter(frame.select(found).column("uid").tolist()), None)


def tell(plan: SearchPlan, told: SearchRecord | None, frame: Frame) -> SearchStory:
    """Return the story of a search.

    Args:
        plan: its plan, with the trials so far.
        told: what was written down beside the trials.
        frame: its runs.
    """
    search, block = plan.sweep.spec.search, plan.space.block
    runs = frame.select(first_rows(frame))
    done = where_equal(runs, "phase", Phase.SUCCEEDED) | where_equal(runs, "phase", Phase.FAILED)
    ended = _EndedRuns.of(runs.select(done & runs.column("index").present), search, block * len(plan.trials))
    decision = decide(plan, ended.seen)
    best = {one.number for one in best_of(decision.standings)} if search.objectives else set()
    trials = tuple(_tried(plan, standing, ended, standing.number in best) for standing in decision.standings)
    influences, compared = _influences(plan, trials)
    to_come, expected = _to_come(plan, decision, trials)
    return SearchStory(
        search=search,
        axes=tuple((axis.label, axis.is_log) for axis in plan.space.axes),
        contexts=tuple(dict(context.coordinates) for context in plan.space.contexts),
        block=block,
        trials=trials,
        history=tuple(_history(decision.standings, trials)),
        influences=influences,
        compared=compared,
        most=plan.most_trials,
        ended=len(ended.seen),
        computed=ended.computed,
        spared=told.spared if told is not None else 0,
        wanted=len(decision.wanted),
        to_come=to_come,
        expected=expected,
        seconds_left=_seconds(ended.moments, expected),
        is_over=decision.is_over,
        message=decision.message or _under_way(decision, trials, plan.most_trials),
    )


@dataclass(frozen=True)
class _EndedRuns:
    """Runs that ended.

    Attributes:
        seen: as the decisions see them, by index.
        at: how many had been computed when each ended, by index.
        taken: indices of those that took the result of an equal run.
        moments: when the computed ones ended, s, in order.
    """

    seen: Mapping[int, Any]
    at: dict[int, int] = field(default_factory=dict)
    taken: frozenset[int] = frozenset()
    moments: tuple[float, ...] = ()

    @classmethod
    def of(cls, runs: Frame, search: Search, count: int) -> _EndedRuns:
        """Return the runs of a table that are of trials."""
        indices = runs.column("index").floats()
        runs = runs.select(indices < count)
        indices = runs.column("index").floats().astype(np.int64)
        taken = runs.column("provenance.reusedFrom").present
        finished = runs.column("finished").floats()
        order = np.lexsort((indices, np.nan_to_num(finished, nan=np.inf)))
        numbers = np.cumsum(~taken[order])
        return cls(
            dict(zip(indices.tolist(), rows_seen(runs, search), strict=True)),
            dict(zip(indices[order].tolist(), numbers.tolist(), strict=True)),
            frozenset(indices[taken].tolist()),
            tuple(sorted(finished[~taken & np.isfinite(finished)].tolist())),
        )

    @property
    def computed(self) -> int:
        """Return the number of runs that took no result of another one."""
        return len(self.seen) - len(self.taken)


def _tried(plan: SearchPlan, standing: TrialStanding, ended: _EndedRuns, is_best: bool) -> TriedSetting:
    trial, block = plan.trials[standing.number], plan.space.block
    own = [
        index
        for index in range(standing.number * block, (standing.number + 1) * block)
        if index in ended.seen
    ]
    score = standing.score
    return TriedSetting(
        number=standing.number,
        values=dict(zip((axis.label for axis in plan.space.axes), trial.values, strict=True)),
        origin=trial.origin.value,
        told=trial.told,
        runs=len(own),
        spared=sum(index in ended.taken for index in own),
        judged=standing.runs if score is not None else 0,
        figures=figures_of(plan.sweep.spec.search, score),
        failed=None if score is None else score.failed,
        first=standing.scores[0] if standing.scores else None,
        dropped=standing.dropped,
        is_complete=standing.is_complete,
        is_best=is_best,
        at=max((ended.at[index] for index in own), default=0),
    )


def figures_of(search: Search, score: Score | None) -> tuple[float | None, ...]:
    """Return the figures of a score as they were measured; None where there is none."""
    if score is None:
        return tuple(None for _ in search.objectives)
    signs = [-1 if objective.goal is Goal.MAXIMIZE else 1 for objective in search.objectives]
    return tuple(
        sign * value if math.isfinite(value) else None
        for sign, value in zip(signs, score.values, strict=True)
    )


def _history(standings: Sequence[TrialStanding], trials: Sequence[TriedSetting]) -> list[SearchStep]:
    """Return the best settings, each time they changed, as settings got the last of their runs."""
    scored = [
        (trials[one.number].at, one.number, one.score)
        for one in standings
        if one.score is not None and one.score.values and one.is_complete and one.score.failed < 1
    ]
    front: list[tuple[int, Score]] = []
    steps: list[SearchStep] = []
    for at, number, score in sorted(scored, key=lambda one: one[:2]):
        if any(other.dominates(score) for _, other in front):
            continue
        front = [(held, other) for held, other in front if not score.dominates(other)]
        front.append((number, score))
        best = tuple(held for held, _ in sorted(front, key=lambda one: (one[1].values, one[0])))
        if steps and steps[-1].runs == at:
            steps.pop()
        steps.append(SearchStep(at, best))
    return steps


def _influences(plan: SearchPlan, trials: Sequence[TriedSetting]) -> tuple[tuple[AxisInfluence, ...], int]:
    """Return the shares of settings' order that axes explain, largest first, and the number of settings.

    Compared is what all settings have: their figures after the first step, on the same runs. They are put in
    order, failed ones last, as errors of failed runs are worse than any and have no size; the share is ε²
    of these ranks (Kruskal and Wallis 1952, Kelley 1935).
    """
    judged = [trial for trial in trials if trial.first is not None and trial.first.values]
    if len(judged) < LEAST_TRIALS:
        return (), len(judged)
    failed = np.array([trial.first.failed for trial in judged if trial.first is not None])
    ranks = []
    for number in range(len(plan.sweep.spec.search.objectives)):
        values = np.array([trial.first.values[number] for trial in judged if trial.first is not None])
        keys = np.lexsort((values, failed))
        places = np.empty(len(judged))
        pairs = np.stack([failed[keys], values[keys]])
        changed = np.any(pairs[:, 1:] != pairs[:, :-1], axis=0)
        places[keys] = np.concatenate([[0], np.cumsum(changed)])
        ranks.append(average_ranks(places))
    found = []
    for axis in plan.space.axes:
        codes = _groups([trial.values[axis.label] for trial in judged], is_range=axis.ends is not None)
        shares = tuple(explained(codes, one) for one in ranks)
        found.append(AxisInfluence(axis.label, shares, int(codes.max()) + 1))
    found.sort(key=lambda one: -max(one.shares, default=0.0))
    return tuple(found), len(judged)


def _groups(values: Sequence[Any], *, is_range: bool) -> Any:
    """Return the group of each value: equal ones, or of a range near ones, as many in each."""
    if not is_range:
        numbers = {key: number for number, key in enumerate(dict.fromkeys(map(repr, values)))}
        return np.array([numbers[repr(value)] for value in values])
    ranks: Floats = average_ranks(np.array(values, dtype=np.float64))
    count = min(_MOST_GROUPS, max(3, len(values) // _LEAST_OF_GROUP))
    places = np.minimum((ranks - 1) * count / len(values), count - 1).astype(np.int64)
    return np.unique(places, return_inverse=True)[1]


def _to_come(plan: SearchPlan, decision: SearchDecision, trials: Sequence[TriedSetting]) -> tuple[int, int]:
    """Return the number of runs that may yet come at most, and the number to be expected."""
    if decision.is_over:
        return 0, 0
    block = plan.space.block
    decided = [trials[one.number] for one in decision.standings if one.is_decided]
    pending = [trials[one.number] for one in decision.standings if not one.is_decided]
    new = max(0, plan.most_trials - len(trials))
    most = sum(block - one.runs for one in pending) + new * block
    usual = sum(one.runs for one in decided) / len(decided) if decided else block
    expected = len(decision.wanted) + sum(max(0.0, usual - one.runs) for one in pending if one.runs)
    waiting = sum(1 for one in pending if not one.runs)
    expected = max(
        expected, (new + waiting) * usual + sum(max(0.0, usual - one.runs) for one in pending if one.runs)
    )
    return most, min(most, math.ceil(expected))


def _seconds(moments: Sequence[float], expected: int) -> float | None:
    """Return the seconds that the expected runs take, by gaps between ends so far, long pauses cut short."""
    gaps = np.diff(np.array(moments))
    if not expected or len(gaps) < LEAST_TRIALS // 2:
        return None
    return float(np.minimum(gaps, _LONG_GAP * max(float(np.median(gaps)), 1e-3)).mean() * expected)


def _under_way(decision: SearchDecision, trials: Sequence[TriedSetting], most: int) -> str:
    dropped = sum(one.dropped is not None for one in trials)
    complete = sum(one.is_complete for one in decision.standings)
    return (
        f"{len(trials)} of {most} settings are tried so far: {complete} have all runs, {dropped} were dropped"
    )
