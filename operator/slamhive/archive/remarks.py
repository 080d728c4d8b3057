# SPDX-License-Identifier: Apache-2.0
"""Notes and tags that people put on runs, beside what was measured, which they never change.

They belong to a run by its identity. Whoever writes them later replaces what was written earlier, by the
time; what an object's annotations say has none and is the earliest.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Self

from slamhive.contract.lines import printable
from slamhive.model.base import GROUP
from slamhive.model.errors import InputError
from slamhive.model.results import TAG_SEPARATOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.model.results import RunRecord

NOTE = f"{GROUP}/note"
"""Annotation of a MappingRun, or of a Sweep's template: a note."""

TAGS = f"{GROUP}/tags"
"""Annotation likewise: tags, with commas between them."""

MOST_LETTERS = 2_000
"""Letters of a note."""

MOST_TAGS = 32
"""Tags that a run is given; merged archives may make more of them."""

_TAG = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._/:-]{0,61}[A-Za-z0-9])?")
_SHOWN = 40


@dataclass(frozen=True)
class Remarks:
    """Note and tags of a run.

    Attributes:
        note: a sentence or some, in one line.
        tags: words, sorted.
        noted: when somebody wrote them here; None where they are an object's annotations, or nobody's.
    """

    note: str | None = None
    tags: tuple[str, ...] = ()
    noted: datetime | None = None

    @classmethod
    def of(cls, record: RunRecord) -> Self:
        """Return a run's."""
        return cls(record.note, tuple(record.tags), record.noted)

    @classmethod
    def of_annotations(cls, annotations: Mapping[str, str]) -> Self:
        """Return those that an object's annotations say; what they can't be is cut or left out."""
        note, tags = annotations.get(NOTE, ""), annotations.get(TAGS, "").split(",")
        line = _line(note[: 2 * MOST_LETTERS])
        if len(line) > MOST_LETTERS or len(note) > 2 * MOST_LETTERS:
            line = f"{line[: MOST_LETTERS - 1]}…"
        sound = {tag.strip() for tag in tags if _TAG.fullmatch(tag.strip())}
        return cls(line or None, tuple(sorted(sound)[:MOST_TAGS]))

    @classmethod
    def of_row(cls, row: Mapping[str, Any]) -> Self:
        """Return those of a row of ``runs``."""
        return cls(row["note"], tuple(split(row["tags"])), row["noted"])

    @property
    def row(self) -> dict[str, Any]:
        """Return them as columns of ``runs``."""
        return {"note": self.note, "tags": TAG_SEPARATOR.join(self.tags) or None, "noted": self.noted}

    @property
    def sentence(self) -> str:
        """Return them in words, as the end of a sentence."""
        told = [f"“{self.note}”"] if self.note else []
        if self.tags:
            told.append(f"{'tag' if len(self.tags) == 1 else 'tags'} {TAG_SEPARATOR.join(self.tags)}")
        return "; ".join(told) or "no note, no tags"

    def changed(
        self, note: str | None, add: Iterable[str], remove: Iterable[str], *, clear: bool = False
    ) -> Remarks:
        """Return them as somebody changes them now.

        Args:
            note: in the place of the note; None to keep it.
            add: tags that come.
            remove: tags that go.
            clear: whether what was there goes first.

        Raises:
            InputError: there would be too many tags.
        """
        before = Remarks() if clear else self
        tags = ({*before.tags} - {*remove}) | {*add}
        if len(tags) > max(MOST_TAGS, len(self.tags)):
            raise InputError(f"a run has {MOST_TAGS} tags at most, this one would have {len(tags)}", "tag")
        return Remarks(before.note if note is None else note, tuple(sorted(tags)), datetime.now(UTC))

    def merged(self, other: Remarks) -> Remarks:
        """Return them with those that another archive has of the same run: all tags, and the newer note."""
        later, earlier = (other, self) if _moment(other) > _moment(self) else (self, other)
        tags = {*self.tags, *other.tags}
        return replace(later, note=later.note or earlier.note, tags=tuple(sorted(tags)))

    def covers(self, annotations: Mapping[str, str]) -> bool:
        """Tell whether what an object's annotations say would change nothing."""
        return self.noted is not None or self.says_same(Remarks.of_annotations(annotations))

    def says_same(self, other: Remarks) -> bool:
        """Tell whether others say the same, whenever they were written."""
        return (self.note, self.tags) == (other.note, other.tags)


def _moment(remarks: Remarks) -> float:
    return remarks.noted.timestamp() if remarks.noted else 0.0


def split(text: str | None) -> list[str]:
    """Return the tags of a column's text."""
    return text.split(TAG_SEPARATOR) if text else []


def checked_note(text: str) -> str:
    """Return a note in one line, without what moves a terminal's cursor.

    Raises:
        InputError: it is empty or too long.
    """
    if len(text) > MOST_LETTERS:
        raise InputError(f"has {len(text):,} characters, at most {MOST_LETTERS:,} are allowed", "text")
    line = _line(text)
    if not line:
        raise InputError("an empty one; --clear removes a note and its tags", "text")
    return line


def checked_tags(texts: Iterable[str], argument: str) -> list[str]:
    """Return tags, of which a text may hold several with commas between them.

    Raises:
        InputError: one is none.
    """
    found = [tag.strip() for text in texts for tag in text.split(",")]
    for tag in found:
        if not _TAG.fullmatch(tag):
            told = printable(tag[:_SHOWN]) + ("…" if len(tag) > _SHOWN else "")
            raise InputError(
                f"{told!r}: a tag is one word of at most 63 letters from A to Z, digits and . _ / : -, which "
                "begins and ends with a letter or digit",
                argument,
            )
    return found


def _line(text: str) -> str:
    return " ".join(printable(text).split())
