# SPDX-License-Identifier: Apache-2.0
"""Outlook on a sweep: which of its runs are as before, which an edit made stale and why, which are new.

Nothing is changed by looking. `slamhive plan` shows it, `slamhive run` does what it says.
"""

from __future__ import annotations

import enum
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from slamhive.data.recordings.version import VERSION
from slamhive.data.store.datasets import is_made
from slamhive.local.running.execution import PlannedPoint
from slamhive.model.base import plural
from slamhive.model.errors import SlamHiveError
from slamhive.model.results import Phase
from slamhive.plan import content_hash

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from slamhive.archive import EarlierRun
    from slamhive.local.running.workbench import ProgramHashes, Workbench

MOST_LOOKED_UP = 20_000
"""Runs of a sweep that equal results are looked for, before it begins; beyond, they are found on the way."""

_MOST_NAMED = 4
_REPETITION = "repetition"


class RunStanding(enum.IntEnum):
    """States of a run of a sweep before anything is done: whether it is new, finished, stale and so on."""

    NEW = 0
    DONE = 1
    FAILED = 2
    FAULT = 3
    STALE = 4
    EQUAL = 5


class Planned(PlannedPoint, Protocol):
    """A run of a plan, with what tells it from the others."""

    @property
    def coordinates(self) -> dict[str, Any]:
        """Return the value on each axis by its label."""

    @property
    def repetition(self) -> int:
        """Return the number of the repetition, from 0."""


class Points(Protocol):
    """The runs of a sweep, made when they are asked for."""

    @property
    def twins(self) -> Mapping[int, int]:
        """Return the runs that come out as an earlier one does, with its index."""

    @property
    def repetitions(self) -> int:
        """Return the number of times that each setting comes, one after the other."""

    def __len__(self) -> int:
        """Return the number of points."""

    def point(self, index: int) -> Planned:
        """Return one of them."""

    def start_order(self, *, look_first: bool = False) -> Sequence[int]:
        """Return the indices in the order in which they are to be started."""

    def algorithm_names(self) -> Sequence[str]:
        """Return the names of all algorithms that it runs."""

    def dataset_names(self) -> Sequence[str]:
        """Return the names of all datasets that it reads."""


class Now(NamedTuple):
    """Content hash that a run would have today, and what it is made from.

    Attributes:
        content: its content hash.
        origin: what that is made from, by the names of the fields of the provenance.
    """

    content: str
    origin: dict[str, str | None]


@dataclass
class Outlook:
    """State of each run of a sweep before anything is done, with the earlier runs and why some are stale.

    Attributes:
        standing: of each, by index.
        replaced: the earlier run of other content in the place of each that is done again, by index.
        edited: what changed since, of each that was made otherwise before: the files and such that are part
            of ``algorithm``, of ``dataset``, or of its ``settings``.
        finished: the earlier runs that are still current.
        aside: those whose earlier run has their identity still: it goes aside when they begin.
        seen: when the runs of all versions that were in the archive had finished, by identity.
    """

    standing: bytearray
    replaced: dict[int, EarlierRun] = field(default_factory=dict)
    edited: dict[int, dict[str, tuple[str, ...]]] = field(default_factory=dict)
    finished: dict[int, EarlierRun] = field(default_factory=dict)
    aside: set[int] = field(default_factory=set)
    seen: dict[str, datetime | None] = field(default_factory=dict)

    def count(self, *kinds: RunStanding) -> int:
        """Return the number of runs that stand so."""
        return sum(self.standing.count(kind) for kind in kinds)

    def of(self, kind: RunStanding) -> list[int]:
        """Return the runs that stand so."""
        return [index for index, found in enumerate(self.standing) if found == kind]


class Looking:
    """Finds out how the runs of sweeps stand.

    Args:
        bench: what runs share.
        making: whether a dataset may be generated or fetched to know its checksum.
    """

    def __init__(self, bench: Workbench, *, making: bool) -> None:
        self._bench = bench
        self._making = making
        self._programs: dict[str, ProgramHashes | None] = {}
        self._checksums: dict[str, str | None] = {}
        self._preparers: dict[tuple[str, str | None], str | None] = {}
        self._edits: dict[tuple[Any, ...], dict[str, tuple[str, ...]]] = {}
        self._recipes: dict[str, str | None] = {}
        self._recipes_before: dict[str, str | None] = {}

    def look(self, sweep: str, sweep_uid: str, points: Points, uids: Callable[[int], str]) -> Outlook:
        """Return the outlook of a sweep's runs.

        Args:
            sweep: its name.
            sweep_uid: its identity.
            points: its runs.
            uids: returns the identity of each.
        """
        archive = self._bench.archive
        earlier = archive.earlier(sweep)
        outlook = Outlook(bytearray(len(points)))
        own = {run.uid: run for run in earlier}
        outlook.seen = {run.uid: run.finished for run in earlier}
        # What was set aside, and what an earlier version of the sweep had: the latest one stands for all.
        by_place = {run.index: run for run in earlier if run.sweep_uid == sweep_uid}
        by_spec = {run.origin["specHash"]: run for run in earlier if run.origin["specHash"]}
        reusable = self._reusable(points, len(earlier))
        # A sweep's first run: hashing each of 80,000 specs would find nothing.
        if not earlier and not reusable:
            return outlook
        for index in range(len(points)):
            point = points.point(index)
            run = own.get(uids(index))
            if run is not None and run.content_hash is None:
                # It failed before anything was made from its inputs: nothing of it could have changed.
                self._note(outlook, index, run)
                continue
            previous = run or by_place.get(index) or by_spec.get(point.spec_hash)
            if previous is None and not reusable:
                continue
            now = self._now(point, previous)
            if now is None:  # it can't be run today, or nobody knows: what is there stays
                if run is not None:
                    self._note(outlook, index, run)
            elif run is not None and run.content_hash == now.content:
                self._note(outlook, index, run)
            else:
                self._differ(outlook, point, previous, now, is_equal=now.content in reusable)
                if run is not None:
                    outlook.aside.add(index)
        return outlook

    def content(self, point: PlannedPoint) -> str | None:
        """Return the content hash that a run would have today; None where that can't be known."""
        now = self._now(point)
        return now.content if now is not None else None

    def _differ(
        self, outlook: Outlook, point: PlannedPoint, previous: EarlierRun | None, now: Now, *, is_equal: bool
    ) -> None:
        if previous is not None and previous.content_hash not in {None, now.content}:
            outlook.replaced[point.index] = previous
            outlook.edited[point.index] = self._edited(point, previous.origin, now.origin)
        if is_equal:
            outlook.standing[point.index] = RunStanding.EQUAL
        elif point.index in outlook.replaced:
            outlook.standing[point.index] = RunStanding.STALE

    @staticmethod
    def _note(outlook: Outlook, index: int, run: EarlierRun) -> None:
        if run.phase is Phase.SUCCEEDED:
            kind = RunStanding.DONE
        elif run.phase is Phase.FAILED and not (run.reason and run.reason.is_infrastructure):
            kind = RunStanding.FAILED
        else:
            kind = RunStanding.FAULT
        outlook.standing[index] = kind
        outlook.finished[index] = run

    def _reusable(self, points: Points, earlier: int) -> set[str]:
        if len(points) > MOST_LOOKED_UP and not earlier:
            return set()
        return self._bench.archive.reusable(points.algorithm_names(), points.dataset_names())

    def _now(self, point: PlannedPoint, previous: EarlierRun | None = None) -> Now | None:
        """Return the parts that a run would be made from now; None where they can't be known."""
        names = point.short_spec
        program = self._program(names["algorithm"] or "")
        checksum = self._checksum(names["dataset"] or "")
        if checksum is None and previous is not None:
            checksum = self._unmade(names["dataset"] or "", previous.origin["datasetSha256"])
        if program is None or checksum is None:
            return None
        try:
            by = self._preparer(names["dataset"] or "", point)
        except (SlamHiveError, OSError):
            return None
        parts = (program.algorithm_hash, checksum, str(VERSION), program.environment, by)
        return Now(
            content_hash(point.spec_hash, *parts),
            {
                "specHash": point.spec_hash,
                "algorithmHash": program.algorithm_hash,
                "environment": program.environment,
                "imageID": program.image_id,
                "datasetSha256": checksum,
                "preparation": str(VERSION),
                "preparedBy": by,
            },
        )

    def _preparer(self, dataset: str, point: PlannedPoint) -> str | None:
        """Return the digest of the program that prepares a run's recording; None where none does.

        Raises:
            SlamHiveError: it can't be run today.
        """
        if not self._bench.workshop.dataset(dataset).dataset.spec.preparations:
            return None
        spec = point.spec
        key = (dataset, spec["input"].get("preparedBy"))
        if key not in self._preparers:
            found = self._bench.preparer(spec)
            self._preparers[key] = found.digest if found else None
        return self._preparers[key]

    def _program(self, name: str) -> ProgramHashes | None:
        if name not in self._programs:
            try:
                self._programs[name] = self._bench.program(name)
            except (SlamHiveError, OSError):
                self._programs[name] = None
        return self._programs[name]

    def _checksum(self, name: str) -> str | None:
        if name not in self._checksums:
            self._checksums[name] = None
            try:
                place = self._bench.workshop.dataset(name)
                if self._making or is_made(place.dataset, place.folder, self._bench.home.path / "datasets"):
                    self._checksums[name] = self._bench.checksum(name)
                else:
                    self._recipes[name] = self._bench.recipe(name)
            except (SlamHiveError, OSError):
                pass
        return self._checksums[name]

    def _unmade(self, name: str, before: str | None) -> str | None:
        """Return the checksum of a dataset that is still to be made, as far as it takes to compare it.

        Args:
            name: of the dataset.
            before: its checksum when an earlier run used it. It still is where the dataset is made by the
                same recipe; something stands for another one where it isn't; None where nobody noted that.
        """
        recipe = self._recipes.get(name)
        if recipe is None or before is None:
            return None
        if before not in self._recipes_before:
            self._recipes_before[before] = self._bench.recipe_of(before)
        noted = self._recipes_before[before]
        return before if noted == recipe else noted and f"of {recipe}"

    def _edited(
        self, point: PlannedPoint, before: dict[str, str | None], after: dict[str, str | None]
    ) -> dict[str, tuple[str, ...]]:
        """Return the parts that have changed, in words, by what they are part of."""
        changed = {name for name in after if before.get(name) != after[name]}
        names = point.short_spec
        # Most runs of a sweep share this, and to compare files takes time.
        key = (names["algorithm"], names["dataset"], before.get("environment"), *sorted(changed))
        if key in self._edits:
            return self._edits[key]
        words: list[str] = []
        if "environment" in changed or "imageID" in changed:
            files = self._bench.versions.changed(before.get("environment"), after["environment"])
            image = "its image" if after["imageID"] else "its program"
            words += files[:_MOST_NAMED] or [image]
            words += [f"{len(files) - _MOST_NAMED} more"] if len(files) > _MOST_NAMED else []
        words += ["algorithm.yaml"] if "algorithmHash" in changed else []
        recording = [f"the dataset {names['dataset']}"] if "datasetSha256" in changed else []
        recording += ["how slamhive prepares recordings"] if "preparation" in changed else []
        recording += ["the program that prepares it"] if "preparedBy" in changed else []
        found = {"algorithm": tuple(words), "dataset": tuple(recording)}
        self._edits[key] = {part: told for part, told in found.items() if told} or {
            "settings": ("its settings",)
        }
        return self._edits[key]


def sentences(
    outlook: Outlook, points: Points, *, again: Iterable[int] = (), left_out: int = 0, tells_new: bool = True
) -> list[str]:
    """Return the standing of a sweep's runs, in sentences.

    Args:
        outlook: how they stand.
        points: the runs.
        again: those that are done again as someone asked for it.
        left_out: runs that nobody asked for this time.
        tells_new: whether to say which are new; of a search it is not known which of them are done.
    """
    asked = set(again)
    found = _stale(outlook, points, asked)
    found += [f"{plural(len(asked), 'run')} done again, as asked"] if asked else []
    found += _new(outlook, points) if tells_new else []
    equal = len(set(outlook.of(RunStanding.EQUAL)) - asked)
    found += [f"{equal:,} {'takes' if equal == 1 else 'take'} over an equal result"] if equal else []
    kept = [index for index in outlook.finished if index not in asked]
    failed = sum(outlook.standing[index] == RunStanding.FAILED for index in kept)
    faults = sum(outlook.standing[index] == RunStanding.FAULT for index in kept)
    as_before = len(kept) - faults
    if as_before:
        told = f" ({failed:,} of them failed)" if failed else ""
        noun = f"{as_before:,}" if found else plural(as_before, "run")
        found.append(f"{noun} {_are(as_before)} as before{told}")
    found += [f"{faults:,} that the machine failed {_are(faults)} tried again"] if faults else []
    found += [f"{left_out:,} {_are(left_out)} left out this time"] if left_out else []
    return found


def _stale(outlook: Outlook, points: Points, asked: set[int]) -> list[str]:
    """Return one sentence for each algorithm and cause."""
    groups: dict[tuple[str, tuple[str, ...]], list[int]] = defaultdict(list)
    for index in outlook.of(RunStanding.STALE):
        if index not in asked:
            why = tuple(word for words in outlook.edited[index].values() for word in words)
            groups[points.point(index).spec["algorithmRef"]["name"], why].append(index)
    found = []
    for (algorithm, why), indices in groups.items():
        times = [run.finished for index in indices if (run := outlook.replaced[index]).finished is not None]
        since = f" since {moment_text(max(times))}" if times else ""
        # What a dataset or slamhive changed concerns every algorithm; a file is one algorithm's.
        named = " and ".join([", ".join(why[:-1]), why[-1]] if len(why) > 1 else why)
        count = len(indices)
        found.append(f"{plural(count, 'run')} of {algorithm} {_are(count)} stale: {named} changed{since}")
    return found


def _new(outlook: Outlook, points: Points) -> list[str]:
    """Return the sentences on new runs: by the values that only they have, as far as that tells them."""
    new = outlook.of(RunStanding.NEW)
    if not new:
        return []
    if len(new) == len(points):
        return [f"{plural(len(new), 'run')}, all new" if len(new) > 1 else "1 new run"]
    of_new: Counter[tuple[str, Any]] = Counter(
        pair for index in new for pair in _settings(points.point(index))
    )
    of_all: Counter[tuple[str, Any]] = Counter(
        pair for index in range(len(points)) for pair in _settings(points.point(index)) if pair in of_new
    )
    alone = [pair for pair, count in of_new.items() if count == of_all[pair]]
    left = set(new)
    values: dict[str, list[Any]] = {}
    counts: Counter[str] = Counter()
    for label, value in sorted(alone, key=lambda pair: -of_new[pair])[:_MOST_NAMED]:
        meant = {index for index in left if (label, value) in set(_settings(points.point(index)))}
        if meant:
            values.setdefault(label, []).append(value)
            counts[label] += len(meant)
            left -= meant
    found = [
        f"{counts[label]:,} of {label} {', '.join(named)} {_are(counts[label])} new"
        for label, named in values.items()
    ]
    found += [f"{len(left):,}{' more' if found else ''} {_are(len(left))} new"] if left else []
    return found


def _settings(point: Planned) -> list[tuple[str, Any]]:
    named = [(label, str(value)) for label, value in point.coordinates.items()]
    return [*named, (_REPETITION, str(point.repetition))]


def moment_text(moment: datetime, now: datetime | None = None) -> str:
    """Return a moment in words: the time of day, with the day unless it was today."""
    here = moment.astimezone()
    today = (now or datetime.now().astimezone()).date()
    return here.strftime("%H:%M" if here.date() == today else "%Y-%m-%d %H:%M")


def _are(count: int) -> str:
    return "is" if count == 1 else "are"
