# SPDX-License-Identifier: Apache-2.0
"""Effects of an edited Algorithm or Dataset, before against after: setting by setting, and whether by chance.

The unit is the setting: runs of both versions that agree in dataset, evaluation and all that varies give one
pair of medians, failed runs last. From 6 settings on the logarithms of their ratios are tested by flipping
signs; fewer are tested by permuting the repetitions within each setting, by their ranks (the sum of
Wilcoxon's rank sums), as those are exchangeable where the versions are equally good. Equal trajectories are
one result: a system that always writes the same one is not tested, as nothing about it is chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.cells import different
from slamhive.analysis.comparing import LEVEL, signed_differences
from slamhive.analysis.derived import ALGORITHM_CHANGED, DATASET_CHANGED
from slamhive.analysis.grouping import (
    CONDITIONS,
    LOAD,
    SUBJECT,
    Groups,
    Outcomes,
    apart,
    counting,
    direction_notes,
    disturbance_notes,
    failing,
    falling_short,
    ranked_errors,
    sound,
    tally,
    unranked_notes,
    varies,
    varying,
    without_chosen,
)
from slamhive.analysis.measures import CONFIGURATION, Better, follows_trajectory, is_error, measure_of
from slamhive.analysis.statistics import (
    ENOUGH,
    average_ranks,
    holm,
    log_ratios,
    median_of_sorted,
    sign_flip_test,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.analysis.columns import Floats, Indices
    from slamhive.analysis.frame import Frame

ENOUGH_SETTINGS = 6
"""Settings from which on they are what is tested: fewer can't give a p below 0.05."""

MAX_EARLIER = 10
"""Earlier versions that the current one is compared with."""

SIGN_FLIPS = "sign flips over settings"
PERMUTATIONS = "permutations of repetitions within settings"

_VERSIONS = {"algorithm": "algorithm.version", "dataset": "dataset.version"}
_REASONS = {"algorithm": ALGORITHM_CHANGED, "dataset": DATASET_CHANGED}
_RECORDED = (
    *("provenance.algorithmHash", "provenance.environment", "provenance.imageID"),
    *("provenance.datasetSha256", "provenance.preparation", *CONDITIONS),
    "provenance.slamhiveVersion",
)
_MOST_EXACT = 20_000
_MOST_DRAWN = 4_000_000
_LEAST_DRAWS = 500
_SEED = 20230529
_CLOSE = 0.005


@dataclass(frozen=True)
class Version:
    """A version of an algorithm or a dataset.

    Attributes:
        version: its 8 digits.
        runs: number of rows.
        first, last: when its first and last run were asked for, s since 1970; None when that isn't known.
    """

    version: str
    runs: int
    first: float | None
    last: float | None


@dataclass(frozen=True)
class Side:
    """The runs of one version in one setting.

    Attributes:
        runs: number of rows.
        n: number of those that count and have a figure.
        failures: number of the others, by what became of them.
        median: over all that have a rank, failed ones last; infinite, below 0 where large is good, where it
            is a failed one.
        points: the figures, where they are few.
        ranked: costs of different results, sorted, failed ones as +inf; equal trajectories once.
        same: whether several runs all gave one and the same result.
    """

    runs: int
    n: int
    failures: dict[str, int]
    median: float
    points: tuple[float, ...]
    ranked: Floats
    same: bool


@dataclass(frozen=True)
class VersionSetting:
    """Runs of both versions that agree in everything but the version.

    Attributes:
        keys: what they agree in, by column.
        before, after: what they came to.
        sign: -1 where large figures are good, else 1.
    """

    keys: dict[str, Any]
    before: Side
    after: Side
    sign: float

    @property
    def ratio(self) -> float:
        """Median after over median before: infinite or 0 where one failed, NaN where both did."""
        return math.nan if self.failed else float(np.exp(self.sign * _worse([self], self.sign))[0])

    @property
    def failed(self) -> bool:
        """True if the median run failed before and after: there is nothing to compare."""
        return math.isinf(self.before.median) and math.isinf(self.after.median)

    @property
    def deterministic(self) -> bool:
        """True if both versions ran more than once and gave one result each."""
        return self.before.same and self.after.same


@dataclass(frozen=True)
class Difference:
    """A column that has other values after than before.

    Attributes:
        column: its name.
        before, after: values.
    """

    column: str
    before: list[Any]
    after: list[Any]


@dataclass(frozen=True)
class Change:
    """A version against an earlier one.

    Attributes:
        changed: what has versions: ``algorithm`` or ``dataset``.
        metric: the figure.
        keys: what all of these runs share, by column.
        before, after: the versions.
        current: whether the later one is the current one.
        settings: those that ran with both.
        unpaired: number of settings that ran with one of them alone.
        ratio: geometric mean of after over before. NaN where failed runs forbid it.
        wins: settings in which after is better, worse, the same; smaller and larger where nobody knows which
            way is good. Those whose median run failed before and after are none of these.
        test: what was tested; None where nothing was.
        p: that both are equally good, two-sided.
        p_holm: corrected for the number of earlier versions.
        least_p: the smallest p that so few results can give.
        differences: what else is not as before.
    """

    changed: str
    metric: str
    keys: dict[str, Any]
    before: Version
    after: Version
    current: bool
    settings: list[VersionSetting]
    unpaired: int
    ratio: float
    wins: tuple[int, int, int]
    test: str | None
    p: float
    p_holm: float
    least_p: float
    differences: list[Difference]

    @property
    def deterministic(self) -> bool:
        """True if there are settings, each with one result before and one after in all of its runs."""
        return bool(self.settings) and all(setting.deterministic for setting in self.settings)

    @property
    def failed(self) -> int:
        """Number of settings whose median run failed before and after."""
        return sum(setting.failed for setting in self.settings)

    @property
    def sentence(self) -> str:
        """Result in a sentence: by how much the metric changed, and whether that may be chance."""
        if not self.settings:
            return "no setting has results of both versions: run the current one in a setting of before"
        change = self._told()
        if self.deterministic and any(self.wins):
            return f"deterministic: {change}; each is one result, however often it ran"
        return f"{change}: {self.verdict}" if self.verdict else change

    @property
    def verdict(self) -> str:
        """Verdict of the significance test in words; empty where there is nothing to test."""
        if self.deterministic or self.wins[:2] == (0, 0):
            return ""
        return verdict(self.p_holm, self.least_p, " after correction" if self.p_holm != self.p else "")

    def _told(self) -> str:
        failed = "1 setting" if self.failed == 1 else f"{self.failed} settings"
        if not any(self.wins):
            return f"failed before and after in {failed}"
        told = self._told_of_others()
        return f"{told}; failed before and after in {failed}" if self.failed else told

    def _told_of_others(self) -> str:
        """Return the change in the settings that didn't fail on both sides, in words."""
        better, worse, same = self.wins
        count = sum(self.wins)
        settings = "1 setting" if count == 1 else f"{count} settings"
        turned = measure_of(self.metric).sign < 0
        ratio = 1 / self.ratio if turned else self.ratio
        up, down = ("worse", "better")
        if not is_error(self.metric):
            up, down = ("lower", "higher") if turned else ("higher", "lower")
        if not better + worse:
            return f"after is the same in {same} of {settings}"
        if not math.isfinite(ratio):
            return f"after is {up} in {worse} and {down} in {better} of {settings}, some of which failed"
        if abs(math.log(ratio)) < _CLOSE:
            return f"after is the same within 0.5 %, {up} in {worse} of {settings}"
        if ratio > 1:
            return f"after is {ratio:.3g} times {up}, in {worse} of {settings}"
        return f"after is {1 / ratio:.3g} times {down}, in {better} of {settings}"


def verdict(p: float, least_p: float, corrected: str = "") -> str:
    """Return the verdict of a test, in words.

    Args:
        p: that both are equally good.
        least_p: the smallest there could be.
        corrected: what is to say of p beside it.
    """
    if p <= LEVEL:
        return f"more than chance (p = {p:.3g}{corrected})"
    if least_p > LEVEL:
        return f"too few to tell (p can't go below {least_p:.3g})"
    return f"may be chance (p = {p:.3g}{corrected})"


def before_and_after(
    frame: Frame, metric: str = "ate.rmse", outcomes: Outcomes = Outcomes.TRACKED
) -> tuple[list[Change], list[str]]:
    """Compare the latest version of each algorithm and dataset with the ones before it.

    Args:
        frame: one row a run and evaluation, superseded ones too.
        metric: a column of numbers.
        outcomes: which runs have a figure that counts; others that failed of themselves are ranked last.

    Returns:
        What changed: for each algorithm with sensors (and each dataset that was edited) the latest earlier
        version first; and notes.
    """
    frame, left_out = without_chosen(frame)
    changes = []
    notes = [*left_out, *direction_notes([metric]), *disturbance_notes(frame, [metric])]
    notes += unranked_notes(frame, outcomes)
    for changed in _VERSIONS:
        material = _Material(frame, metric, outcomes, changed)
        notes += material.notes
        changes += material.changes()
    return changes, notes


class _Material:
    """The rows by what has versions, with what each row counts for.

    Args:
        frame, metric, outcomes: as for ``before_and_after``.
        changed: what has versions.
    """

    def __init__(self, frame: Frame, metric: str, outcomes: Outcomes, changed: str) -> None:
        self._changed, self._metric, self._sign = changed, metric, measure_of(metric).sign
        self._name = _VERSIONS[changed]
        known = frame.column(self._name).present
        self.notes: list[str] = []
        if known.any() and not known.all():
            count = int((~known).sum())
            rows = "1 row is" if count == 1 else f"{count:,} rows are"
            self.notes.append(f"{rows} of no known {self._name}: left out")
        self._frame, facets = apart(frame.select(known), [*SUBJECT, self._name], [metric])
        other = next(name for name in _VERSIONS.values() if name != self._name)
        shared = ["algorithm", "sensors", *(["dataset"] if changed == "dataset" else [])]
        self._subject = [*shared, *(name for name in facets if name != other)]
        self._setting = ["dataset", *(name for name in facets if name == other)]
        self._numbers = self._frame.column(metric).floats()
        self._counted = counting(self._frame, outcomes) & sound(self._frame, metric, outcomes)
        self._counted &= ~np.isnan(self._numbers)
        if _ranks_failures(metric):
            self._failed = failing(self._frame, outcomes) | falling_short(self._frame, metric)
        else:
            self._failed = np.zeros(len(self._frame), dtype=bool)
        trajectory = self._frame.column("trajectory.sha256")
        self._trajectories = np.full(len(self._frame), -1) if trajectory.kind.is_numeric else trajectory.codes
        self._moments = self._latest()

    def _latest(self) -> dict[tuple[Any, Any], tuple[bool, float, float]]:
        """Return the moment of each version's last run, by (what has it, version), over all of its rows.

        Before it stands whether the version is a current one: one that an undone edit made so is the latest,
        though its runs aren't.
        """
        created = self._frame.column("created").floats()
        moments = zip(
            self._frame.column(self._changed).tolist(),
            self._frame.column(self._name).tolist(),
            (~self._frame.column("superseded").present).tolist(),
            np.where(np.isnan(created), -np.inf, created).tolist(),
            self._frame.column("id").floats().tolist(),
            strict=True,
        )
        latest: dict[tuple[Any, Any], tuple[bool, float, float]] = {}
        for owner, version, *moment in moments:
            last = (moment[0], moment[1], moment[2])
            latest[owner, version] = max(latest.get((owner, version), last), last)
        return latest

    def changes(self) -> list[Change]:
        """Return the changes, the subjects sorted, the latest earlier version of each first."""
        groups = Groups(self._frame, self._subject)
        found = []
        for rows, keys in zip(groups.members(), groups.keys, strict=True):
            versions: dict[Any, Indices] = {}
            inside = Groups(self._frame.select(rows), [self._name])
            for places, key in zip(inside.members(), inside.keys, strict=True):
                versions[key[self._name]] = rows[places]
            if len(versions) > 1:
                found += self._of_subject(keys, versions)
        return sorted(found, key=lambda change: [str(value) for value in change.keys.values()])

    def _of_subject(self, keys: dict[str, Any], versions: dict[Any, Indices]) -> list[Change]:
        owner = keys[self._changed]
        latest_first = sorted(versions, key=lambda one: self._moments[owner, one], reverse=True)
        if len(latest_first) > MAX_EARLIER + 1:
            count = len(latest_first) - 1
            told = f"{count} earlier versions of {owner}: the latest {MAX_EARLIER} are compared"
            if told not in self.notes:
                self.notes.append(told)
        after, *earlier = latest_first[: MAX_EARLIER + 1]
        changes = [self._change(keys, (one, versions[one]), (after, versions[after])) for one in earlier]
        tested = [place for place, change in enumerate(changes) if change.test is not None]
        for place, p_holm in zip(tested, holm([changes[place].p for place in tested]), strict=True):
            changes[place] = replace(changes[place], p_holm=p_holm)
        return [change for change in changes if change.settings or self._ranked_rows(versions, change)]

    def _ranked_rows(self, versions: dict[Any, Indices], change: Change) -> bool:
        """Tell whether both versions have results at all, if in no common setting."""
        ranked = self._counted | self._failed
        return all(bool(ranked[versions[one.version]].any()) for one in (change.before, change.after))

    def _change(
        self, keys: dict[str, Any], before: tuple[Any, Indices], after: tuple[Any, Indices]
    ) -> Change:
        old, new = self._frame.select(before[1]), self._frame.select(after[1])
        # What is always the same within a version but differs between them is part of the change.
        varied = dict.fromkeys([*self._setting, *sorted({*varying(old), *varying(new)})])
        settings, unpaired = self._paired([name for name in varied if name not in keys], before[1], after[1])
        compared = [setting for setting in settings if not setting.failed]
        differences = _worse(compared, self._sign)
        signs = signed_differences(differences)
        test, p, least_p = _tested(compared, signs)
        finite = len(differences) > 0 and bool(np.isfinite(differences).all())
        return Change(
            changed=self._changed,
            metric=self._metric,
            keys=keys,
            before=self._version(*before),
            after=self._version(*after),
            current=_REASONS[self._changed] not in {*new.column("superseded").tolist()},
            settings=settings,
            unpaired=unpaired,
            ratio=math.exp(self._sign * float(differences.mean())) if finite else math.nan,
            wins=(int((signs < 0).sum()), int((signs > 0).sum()), int((signs == 0).sum())),
            test=test,
            p=p,
            p_holm=p,
            least_p=least_p,
            differences=self._other_differences(before[1], after[1]),
        )

    def _paired(
        self, names: Sequence[str], before: Indices, after: Indices
    ) -> tuple[list[VersionSetting], int]:
        """Return the settings with ranks on both sides, and the number of the others."""
        both = np.concatenate([before, after])
        groups = Groups(self._frame.select(both), names)
        settings = []
        for places, keys in zip(groups.members(), groups.keys, strict=True):
            rows = both[places]
            is_before = places < len(before)
            sides = self._side(rows[is_before]), self._side(rows[~is_before])
            if not any(math.isnan(side.median) for side in sides):
                settings.append(VersionSetting(keys, *sides, self._sign))
        return settings, groups.count - len(settings)

    def _side(self, rows: Indices) -> Side:
        counted, failed = self._counted[rows], self._failed[rows]
        status = self._frame.column("status")
        costs = self._sign * self._numbers[rows]
        everything = ranked_errors(costs, counted, failed)
        ranked = everything
        if follows_trajectory(self._metric):
            kept = different(self._trajectories[rows])
            ranked = ranked_errors(costs[kept], counted[kept], failed[kept])
        failures = tally(status.values, status.codes[rows[~counted]])
        return Side(
            runs=len(rows),
            n=int(counted.sum()),
            failures=failures,
            median=self._sign * median_of_sorted(everything) if len(everything) else math.nan,
            points=tuple(self._numbers[rows][counted].tolist()) if counted.sum() < ENOUGH else (),
            ranked=ranked,
            same=len(everything) > 1 and (len(ranked) == 1 or bool(np.isinf(everything).all())),
        )

    def _version(self, version: Any, rows: Indices) -> Version:
        created = self._frame.column("created").floats()[rows]
        known = created[~np.isnan(created)]
        times = (float(known.min()), float(known.max())) if len(known) else (None, None)
        return Version(str(version), len(rows), *times)

    def _other_differences(self, before: Indices, after: Indices) -> list[Difference]:
        """Return the settings and circumstances that share no value between two versions."""
        both = self._frame.select(np.concatenate([before, after]))
        names = [name for name in self._frame.stored if name.startswith(CONFIGURATION) or name in _RECORDED]
        differences = []
        for name in names:
            if not varies(both, name):
                continue
            values = [str(one) if isinstance(one, list | dict) else one for one in both.column(name).tolist()]
            sides = dict.fromkeys(values[: len(before)]), dict.fromkeys(values[len(before) :])
            if not sides[0].keys() & sides[1].keys():
                differences.append(Difference(name, list(sides[0]), list(sides[1])))
        return differences


def _ranks_failures(metric: str) -> bool:
    """Tell whether a failed run is worse than any other by a figure.

    It is by an error or an accuracy. A program that fails at once takes no CPU that would be worse, and of a
    figure whose good direction nobody knows nothing is.
    """
    return not metric.startswith(LOAD) and measure_of(metric).better is not Better.NONE


def _worse(settings: Sequence[VersionSetting], sign: float) -> Floats:
    """Return by how much each setting is worse after than before, as logarithms, (n,)."""
    sides = [[one.before.median for one in settings], [one.after.median for one in settings]]
    before, after = sign * np.array(sides)
    return log_ratios(before, after, sign)


def _tested(settings: Sequence[VersionSetting], signs: Floats) -> tuple[str | None, float, float]:
    """Return the name of the test, p and the least p there could be."""
    if not settings or all(setting.deterministic for setting in settings):
        return None, 1.0, 1.0
    if len(settings) >= ENOUGH_SETTINGS:
        return SIGN_FLIPS, sign_flip_test(signs), 2.0 ** (1 - len(settings))
    pairs = [(setting.before.ranked, setting.after.ranked) for setting in settings]
    return (PERMUTATIONS, *permutation_test(pairs))


def permutation_test(pairs: Sequence[tuple[Floats, Floats]]) -> tuple[float, float]:
    """Return the two-sided p of two versions being equally good in all settings, and the least possible.

    The statistic is the sum of the rank sums of the second within each setting; which results are whose is
    permuted within settings. Exact up to 20,000 arrangements, else by as many drawn ones.

    Args:
        pairs: results of both in each setting, (a,) and (b,), failed ones as +inf.
    """
    strata = [(average_ranks(np.concatenate(pair)), len(pair[1])) for pair in pairs]
    arrangements = math.prod(math.comb(len(ranks), count) for ranks, count in strata)
    middle = sum(float(ranks.mean()) * count for ranks, count in strata)
    seen = abs(sum(float(ranks[len(ranks) - count :].sum()) for ranks, count in strata) - middle)
    least = min(1.0, 2.0 / arrangements)
    if arrangements <= _MOST_EXACT:
        sums = np.zeros(1)
        for ranks, count in strata:
            sums = np.add.outer(sums, [sum(chosen) for chosen in combinations(ranks.tolist(), count)]).ravel()
        return float(np.mean(np.abs(sums - middle) >= seen - 1e-9)), least
    total = sum(len(ranks) for ranks, _ in strata)
    draws = min(_MOST_EXACT, max(_LEAST_DRAWS, _MOST_DRAWN // total))
    generator = np.random.default_rng(_SEED)
    drawn = sum(_drawn_sums(ranks, count, draws, generator) for ranks, count in strata)
    return float((np.sum(np.abs(drawn - middle) >= seen - 1e-9) + 1) / (draws + 1)), 1.0 / (draws + 1)


def _drawn_sums(ranks: Floats, count: int, draws: int, generator: np.random.Generator) -> Floats:
    """Return sums of some of the ranks, chosen by lot without replacement, (draws,)."""
    most = max(1, _MOST_DRAWN // len(ranks))
    parts = [
        ranks[generator.random((size, len(ranks))).argsort(axis=1)[:, :count]].sum(axis=1)
        for size in _portions(draws, most)
    ]
    return np.concatenate(parts)


def _portions(total: int, most: int) -> Iterator[int]:
    while total > 0:
        yield min(total, most)
        total -= most
