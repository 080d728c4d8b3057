# SPDX-License-Identifier: Apache-2.0
"""Course of a comparison: settings that both sides have, rounds of runs, and a look after each."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.analysis.gating.cells import GateCell, GateRuns
from slamhive.analysis.gating.deciding import Gate
from slamhive.analysis.gating.figures import (
    FAILURES,
    LATENCY,
    MEMORY,
    TIME,
    GateFigure,
)
from slamhive.analysis.gating.ordering import next_runs
from slamhive.analysis.measures import measure_of
from slamhive.cli.gating.runs import (
    BESIDE_OTHERS,
    GateRows,
    GateSweep,
    GateWish,
    collect,
    do_round,
    few_repetitions,
    recorded_columns,
    tell_disturbed,
)
from slamhive.cli.parts.console import listing
from slamhive.cli.parts.exits import INTERRUPTED
from slamhive.engine import LoadConditions
from slamhive.model.base import plural
from slamhive.model.canonical import digest, normalize
from slamhive.model.errors import InputError
from slamhive.reporting.gate.baseline import Baseline, BaselineCell, columns_of
from slamhive.reporting.gate.summaries import GateReport

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.local.running.workbench import Workbench

_MOST_TOLD = 3
"""Settings that are named where none is common to both sides."""


@dataclass(frozen=True)
class Comparing:
    """Baseline of a comparison, and the files that tell it.

    Attributes:
        known, path: the baseline and its file.
        summary, junit: files to write.
    """

    known: Baseline
    path: Path
    summary: Path | None
    junit: Path | None


@dataclass
class _SettingPair:
    """A setting that both sides have.

    Attributes:
        test, row: where it is run.
        before: as it was recorded.
    """

    test: GateSweep
    row: int
    before: BaselineCell


def _pairs(tests: Sequence[GateSweep], comparing: Comparing, notes: list[str]) -> list[_SettingPair]:
    """Return the settings that both sides have; what one of them lacks is noted.

    Raises:
        InputError: they have none in common, or were given something else of a recording.
    """
    cells = list(comparing.known.cells)
    rows = [(test, row) for test in tests for row in test.rows]
    if len(cells) == 1 and cells[0].dataset is None:
        if len(rows) != 1:
            raise InputError(
                f"{comparing.path}: of one trajectory of a dataset that it doesn't name: it stands for one "
                f"setting; the sweep has {len(rows)}"
            )
        return [_SettingPair(*rows[0], cells[0])]
    with_name = len(tests) > 1 or len({cell.sweep for cell in cells}) > 1

    def key(sweep: str | None, settings: Any, dataset: str | None) -> str:
        return digest(normalize([sweep if with_name else None, settings, dataset]))

    known = {key(cell.sweep, cell.settings, cell.dataset): cell for cell in cells}
    pairs, new = [], []
    for test, row in rows:
        cell = known.pop(key(test.named, *test.settings(row)), None)
        if cell is None:
            new.append(test.words(row))
        else:
            _check_input(cell, test, row, comparing.path)
            pairs.append(_SettingPair(test, row, cell))
    if not pairs:
        raise InputError(
            f"{comparing.path}: none of its settings is one of the sweep: recorded are "
            f"{_settings_text([(cell.settings, cell.dataset) for cell in cells])}; the sweep has "
            f"{_settings_text([test.settings(row) for test, row in rows])}; slamhive gate --record makes a "
            "baseline of those"
        )
    if new:
        notes.append(f"not in the baseline, and neither run nor compared: {listing(new)}")
    if known:
        notes.append(f"of the baseline, but not asked for here: {plural(len(known), 'setting')}")
    return pairs


def _check_input(cell: BaselineCell, test: GateSweep, row: int, path: Path) -> None:
    """Compare what a setting takes of its recording with what it took as it was recorded.

    Raises:
        InputError: it is something else.
    """
    now = test.input(row)
    before = now if cell.input is None else cell.input
    for name in sorted(before.keys() | now.keys()):
        values = before.get(name), now.get(name)
        if values[0] != values[1]:
            where = f"{path}: {test.words(row)}: input.{name}"
            raise _other(where, *("none" if one is None else json.dumps(one) for one in values))


def _other(where: str, before: str, now: str) -> InputError:
    return InputError(
        f"{where}: recorded with {before}, here {now}: they can't be compared; slamhive gate --record makes "
        "a new baseline"
    )


def _settings_text(found: Sequence[tuple[dict[str, Any], str | None]]) -> str:
    """Return the first few of some settings, each with its dataset."""
    texts = [
        " ".join(
            [str(dataset), *(f"{name} {value}" for name, value in settings.items() if name != "dataset")]
        )
        for settings, dataset in found[:_MOST_TOLD]
    ]
    return "; ".join(texts) + ("; …" if len(found) > _MOST_TOLD else "")


def compare(
    tests: Sequence[GateSweep], bench: Workbench, wish: GateWish, comparing: Comparing
) -> tuple[GateReport | None, bool]:
    """Run until it is known whether something is worse; returns the answers, and whether there were faults.

    No report: it was interrupted.

    Raises:
        InputError: the baseline is of something else.
    """
    begun = time.monotonic()
    notes: list[str] = []
    pairs = _pairs(tests, comparing, notes)
    notes += few_repetitions([pair.before for pair in pairs])
    course = _Course(pairs, bench, wish, comparing)
    why = ""
    while not why:
        left = None if wish.budget is None else wish.budget - (time.monotonic() - begun)
        if left is not None and left <= 0:
            why = f"the budget of {wish.budget:.0f} s is used up"
            break
        wanted = course.wanted()
        if not wanted:
            why = course.ended
            break
        code, course.fault = course.run(wanted, left)
        if code == INTERRUPTED:
            return None, False
        spent = wish.budget is not None and time.monotonic() - begun >= wish.budget
        course.look(last=spent or not course.has_more)
        if spent and not course.gate.is_sure:
            why = f"the budget of {wish.budget:.0f} s is used up"
    report = GateReport(
        ", ".join(test.named for test in tests),
        comparing.path.name,
        course.gate.answer,
        course.gate.findings,
        course.cells,
        time.monotonic() - begun,
        why,
        [*notes, *course.notes()],
    )
    return report, course.fault or bool(course.faults)


class _Course:
    """A comparison under way: pairs of settings, the gate, and what was done so far."""

    def __init__(
        self, pairs: Sequence[_SettingPair], bench: Workbench, wish: GateWish, comparing: Comparing
    ) -> None:
        self._pairs, self._bench, self._wish, self._comparing = pairs, bench, wish, comparing
        self._tests = list({id(pair.test): pair.test for pair in pairs}.values())
        self._most = min(test.points.repetitions for test in self._tests)
        self._columns = columns_of([pair.before for pair in pairs])
        self._rows: list[GateRows] = []
        self._left_out: list[str] = []
        self.cells = [GateCell(self._name(pair), pair.before.runs, GateRuns()) for pair in pairs]
        self.gate = Gate(self._figures())
        self.fault = False

    def _name(self, pair: _SettingPair) -> str:
        words = pair.test.words(pair.row)
        return f"{pair.test.named}: {words}" if len(self._tests) > 1 else words

    def _figures(self) -> list[GateFigure]:
        """Return the figures that can be looked at: of those not asked for by name only what was recorded."""
        found = list(self._wish.figures)
        if not self._wish.chosen:
            here = self._columns | {FAILURES}
            found = [one for one in found if one.name in here]
            if all(LATENCY in columns_of([pair.before]) for pair in self._pairs):
                found = [one for one in found if one.name != TIME]
        if not any(measure_of(one.name).is_error for one in found) and not self._wish.chosen:
            self._left_out.append("the baseline has no error")
        return found

    @property
    def faults(self) -> list[str]:
        """Sentences on runs in whose way the machine was."""
        return [sentence for one in self._rows for sentence in one.faults]

    @property
    def has_more(self) -> bool:
        """Tell whether a setting may be repeated once more."""
        return any(pair.test.asked.get(pair.row, 0) < self._most for pair in self._pairs)

    @property
    def ended(self) -> str:
        """Sentence on why no run is wanted."""
        if self.gate.is_sure:
            return f"sure after {plural(self.gate.looks, 'look')}"
        return f"{plural(self._most, 'repetition')} of each setting at most"

    def wanted(self) -> dict[int, int]:
        """Return the number of runs of each pair that are to be done next."""
        done = [pair.test.asked.get(pair.row, 0) for pair in self._pairs]
        if self.gate.is_sure:
            return {}
        return next_runs(self.cells, self.gate.findings, self._most, done)

    def run(self, wanted: dict[int, int], left: float | None) -> tuple[int, bool]:
        """Do runs; returns the exit code and whether a file was in the way."""
        wish = self._wish
        for number, count in wanted.items():
            self._pairs[number].test.ask(self._pairs[number].row, count)
        found = do_round(self._tests, self._bench, wish, left)
        self._rows = [collect(test, self._bench, recorded_columns(wish)) for test in self._tests]
        self._check_same()
        return found

    def _check_same(self) -> None:
        """Compare recordings and evaluations with those of the baseline.

        Raises:
            InputError: one is another.
        """
        rows = dict(zip(map(id, self._tests), self._rows, strict=True))
        for number, pair in enumerate(self._pairs):
            now = rows[id(pair.test)].cells.get(pair.row)
            if now is None:
                continue
            for what, before, here in (
                (f"dataset {now.dataset}", pair.before.dataset_sha256, now.dataset_sha256),
                ("evaluation settings", pair.before.evaluation, now.evaluation),
                ("alignment", pair.before.alignment, now.alignment),
            ):
                if before is not None and here is not None and before != here:
                    where = f"{self._comparing.path}: {self.cells[number].name}: {what}"
                    raise _other(where, before[:16], here[:16])
            self.cells[number] = GateCell(self.cells[number].name, pair.before.runs, now.runs)

    def look(self, *, last: bool) -> None:
        """Decide by what there is."""
        if why := self._unlike_machines():
            self._leave_out([one for one in self.gate.figures if one.is_load], why)
        kinds = {pair.before.memory for pair in self._pairs}
        kinds |= {cell.memory for one in self._rows for cell in one.cells.values()}
        if len(kinds - {None}) > 1:
            two = " and ".join(sorted(str(kind) for kind in kinds if kind))
            self._leave_out([one for one in self.gate.figures if one.name == MEMORY], f"measured as {two}")
        self.gate.is_beside_others = self._may_be_beside_others()
        self.gate.look(self.cells, last=last)

    def _may_be_beside_others(self) -> bool:
        """Tell whether runs of either side had other work beside them; a baseline that is silent may have."""
        recorded = [pair.before.values.get(BESIDE_OTHERS) for pair in self._pairs]
        return any(of is None or any(of) for of in recorded) or any(one.disturbed for one in self._rows)

    def _unlike_machines(self) -> str | None:
        """Return the reason why loads can't be compared; None where nothing says so."""
        conditions = set().union(*(one.conditions for one in self._rows))
        recorded = self._comparing.known
        models = {one.processor for one in conditions if one.processor is not None}
        if models and models != {recorded.processor}:
            here = ", ".join(sorted(models))
            return f"recorded on {recorded.processor or 'unlike machines, or unknown ones'}, this is {here}"
        before = LoadConditions.on(recorded.processor, recorded.machine)
        unlike = {words for one in conditions for words in before.differences(one)}
        return f"recorded and measured with {', '.join(sorted(unlike))}" if unlike else None

    def _leave_out(self, figures: Sequence[GateFigure], why: str) -> None:
        """Compare figures no more; what was asked for by name is told as what nobody can tell."""
        if not figures:
            return
        if self._wish.chosen:
            self.gate.refused |= dict.fromkeys((one.name for one in figures), why)
            return
        self._left_out.append(f"not compared: {', '.join(one.title for one in figures)}: {why}")
        self.gate.figures = [one for one in self.gate.figures if one not in figures]

    def notes(self) -> list[str]:
        """Return further sentences for the report."""
        found = [*self._left_out, *self.faults]
        reused = sum(one.reused for one in self._rows)
        if reused:
            found.append(f"{plural(reused, 'result')} of equal runs were taken over; --rerun does them again")
        for one in self._rows:
            tell_disturbed(one, found.append)
        return found
