# SPDX-License-Identifier: Apache-2.0
"""Manifests of a command, judged to their end: what they ask for, and all mistakes of all files at once.

An object in which something is wrong is judged further as far as it is right. What would only follow from
another mistake is not told: a name that a broken manifest has counts as known.
"""

from __future__ import annotations

import difflib
import re
import sys
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from slamhive.cli.parts.planning import CANCELLED, sweeps_of
from slamhive.cli.parts.searches import objective_faults
from slamhive.model.errors import InputError
from slamhive.model.loading import KINDS, empty, judge, read_documents, read_text
from slamhive.model.run import MappingRun
from slamhive.model.sweep import Sweep, SweepSpec
from slamhive.plan import FixedCatalog, plan_of, plan_problems, probed
from slamhive.plan.findings import ANY, Findings
from slamhive.plan.paths import bounded

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from slamhive.local.home.catalog import Workshop
    from slamhive.model.loading import Judged, Kind
    from slamhive.plan import Plan

MOST = 100
"""Mistakes that are told one by one."""

_TEMPLATE = "spec.template.spec"
_KIND = {"Algorithm": "algorithm", "Dataset": "dataset"}
_RUNS = ("template", "matrix", "include", "exclude")
_OTHERS = tuple(
    word for name, item in SweepSpec.model_fields.items() if (word := item.alias or name) not in _RUNS
)
_NUMBERED = re.compile(r"spec\.(matrix|include|exclude)\[(\d+)\]")


@dataclass
class Checked:
    """Objects, plans and mistakes that were found in manifest files.

    Attributes:
        objects: their objects without those in which the model of its kind finds a mistake.
        plans: of each sweep and single run, its plan; only those without a mistake.
        problems: a sentence for each mistake, with file, line and field, in the order in which they stand.
        misfits: such sentences on what the catalog here doesn't allow, where that is no mistake yet.
    """

    objects: list[Kind] = field(default_factory=list)
    plans: list[tuple[Sweep, Plan]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    misfits: list[str] = field(default_factory=list)

    def refuse(self) -> None:
        """Raise what is wrong.

        Raises:
            InputError: with the first mistakes and how many more there are, one a line.
        """
        if self.problems:
            raise InputError("\n".join(bounded(self.problems, MOST)))


def check_files(
    paths: Sequence[Path], workshop: Workshop, *, strict: bool = True, misfits: bool = False
) -> Checked:
    """Read manifests, take their catalog kinds into the workshop, and plan their sweeps.

    Args:
        paths: the files.
        workshop: the catalog.
        strict: whether it is a mistake what the catalog doesn't have or allow.
        misfits: whether what it doesn't allow is looked for where it is none.
    """
    files = _JudgedFiles(workshop)
    for path in paths:
        files.read(path)
    checked = Checked([one.item for one in files.judged if one.item is not None and not one.problems])
    for one in files.judged:
        files.plan(one, checked, strict=strict, misfits=misfits)
    checked.problems = [sentence for found in files.problems.values() for sentence in _in_order(found)]
    return checked


class _JudgedFiles:
    """Files under judgement.

    Attributes:
        judged: their objects.
        problems: by file, in the order in which they were given: line and sentence.
    """

    def __init__(self, workshop: Workshop) -> None:
        self.judged: list[Judged] = []
        self.problems: dict[str, list[tuple[int, str]]] = {}
        self._workshop = workshop
        self._seen: dict[tuple[str, str], str] = {}
        self._broken: set[tuple[str, str]] = set()
        self._unread: list[str | None] = []

    def read(self, path: Path) -> None:
        """Read a file and judge each object in it by itself."""
        source = str(path)
        self.problems.setdefault(source, [])
        try:
            text = read_text(path)
        except InputError as error:
            self._tell(source, [str(error)])
            self._unread.append(None)
            return
        documents, problems = read_documents(text, source)
        if problems:
            self._unread.append(text)
        elif not documents:
            problems = [empty(source)]
        self._tell(source, problems)
        for document in documents:
            one = judge(document)
            self._tell(source, one.problems)
            self.judged.append(one)
            self._take(one, path)

    def _take(self, one: Judged, path: Path) -> None:
        """Take an entry of the catalog in, or out if it is wrong; refuse a second object of a name."""
        name, source = one.named, one.document.source
        if name is not None:
            where = one.document.where(("metadata", "name"))
            if name in self._seen:
                known = self._seen[name]
                self._tell(source, [f"{where}: {name[0]} {name[1]!r} stands in {known} already"])
            self._seen[name] = where
        if one.item is None or one.problems:
            value = one.document.value
            kind = value.get("kind") if isinstance(value, dict) else None
            kinds = [_KIND[kind]] if kind in _KIND else [] if kind in KINDS else [*_KIND.values()]
            self._broken |= {(each, name[1] if name else "") for each in kinds}
            return
        self._workshop.add([one.item], path.parent.absolute())

    def _tell(self, source: str, sentences: Sequence[str]) -> None:
        self.problems[source] += [(_line(sentence, source), sentence) for sentence in sentences]

    def plan(self, one: Judged, checked: Checked, *, strict: bool, misfits: bool) -> None:
        """Plan a sweep or single run, and check it against the catalog."""
        item, document = one.item, one.document
        if not isinstance(item, Sweep | MappingRun):
            return
        if isinstance(item, MappingRun) and item.spec.cancel:
            self._tell(document.source, [f"{document.where(('spec', 'cancel'))}: {CANCELLED}"])
            return
        (sweep,) = sweeps_of([item])
        findings = _lost(one)
        findings.hidden = self._hides
        plan: Plan | None = None
        try:
            plan = plan_of(sweep, self._catalog, strict=strict, findings=findings)
        except InputError as error:
            findings.problems += str(error).splitlines()
        found = list(findings.problems)
        if plan is not None and (strict or misfits):
            unfit = [*plan_problems(probed(plan), sys.maxsize), *objective_faults(sweep)]
            if strict:
                found += unfit
            else:
                checked.misfits += [_placed(one, sentence) for sentence in unfit]
        placed = [_placed(one, sentence) for sentence in found]
        unread = {sentence.split(": ")[0] for sentence in document.problems}
        self._tell(document.source, [text for text in placed if text.split(": ")[0] not in unread])
        if plan is not None and not found and not one.problems:
            checked.plans.append((sweep, plan))

    @cached_property
    def _catalog(self) -> FixedCatalog:
        """Return the catalog without what manifests replace by something wrong."""
        algorithms, datasets = self._workshop.algorithms, self._workshop.datasets
        return FixedCatalog(
            {name: algorithms[name] for name in algorithms if ("algorithm", name) not in self._broken},
            {name: datasets[name] for name in datasets if ("dataset", name) not in self._broken},
        )

    def _hides(self, kind: str, name: str) -> bool:
        """Tell whether a manifest that can't be used may hold an entry of the catalog."""
        if not name:
            return bool(self._unread) or any(broken == kind for broken, _ in self._broken)
        return (
            (kind, name) in self._broken
            or (kind, "") in self._broken
            or any(text is None or name in text for text in self._unread)
        )


def _in_order(found: list[tuple[int, str]]) -> list[str]:
    """Return sentences by line; of two that say the same the first."""
    return list(dict.fromkeys(sentence for _, sentence in sorted(found, key=lambda one: one[0])))


def _line(sentence: str, source: str) -> int:
    match = re.match(r":(\d+):", sentence.removeprefix(source))
    return int(match[1]) if match and sentence.startswith(source) else 0


def _lost(one: Judged) -> Findings:
    """Return the fields of a run that may have been meant to be set by what was taken out of an object."""
    findings = Findings()
    for path in one.lost:
        words = [str(part) for part in path]
        if words[0] != "spec":
            findings.lost |= {ANY} if _may_be(words[0], ("spec",), ("metadata", "kind")) else set()
        elif isinstance(one.item, MappingRun):
            findings.lose(".".join(words[1:]))
        elif words[1:2] == ["matrix"] and len(path) > 2:
            axis = one.document.value["spec"]["matrix"][path[2]]
            axis = axis if isinstance(axis, dict) else {}
            findings.lose_axis(str(axis.get("name") or axis.get("path")), axis.get("path"))
        else:
            findings.lost |= {ANY} if len(words) == 1 or _may_be(words[1], _RUNS, _OTHERS) else set()
    return findings


def _may_be(word: str, wanted: Sequence[str], others: Sequence[str]) -> bool:
    """Tell whether a field may be one of some, misspelt; what is near to none may be any."""
    if word in others:
        return False
    close = difflib.get_close_matches(word, [*wanted, *others], n=1, cutoff=0.6)
    return not close or close[0] in wanted


def _placed(one: Judged, sentence: str) -> str:
    """Return a sentence about a field with file and line in front of it, the field as the file has it."""

    def numbered(match: re.Match[str]) -> str:
        kept = one.places.get(("spec", match[1]))
        return f"spec.{match[1]}[{kept[int(match[2])] if kept else match[2]}]"

    sentence = _NUMBERED.sub(numbered, sentence)
    if isinstance(one.item, MappingRun):
        sentence = sentence.replace(_TEMPLATE, "spec", 1)
    return f"{one.document.where(one.document.locate(sentence))}: {sentence}"
