# SPDX-License-Identifier: Apache-2.0
"""Notes and tags in the archive: whatever writes a run again leaves them; the later of two writers wins."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, migrations
from slamhive.archive.keeping import backup, check, restore
from slamhive.archive.remarks import MOST_LETTERS, MOST_TAGS, Remarks, checked_note, checked_tags
from slamhive.archive.upgrading import upgrade
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome, Result

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord

    MakeRun = Callable[..., RunRecord]
    PutVersion = Callable[[str, int], None]

EARLY, LATE = datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 1, 2, tzinfo=UTC)


def noted(archive: Archive, uid: str = "u1") -> tuple[str | None, list[str]]:
    record = archive.get(uid)
    assert record is not None
    return record.note, record.tags


def test_a_note_outlives_all_that_is_written_of_its_run(
    url: str, tmp_path: Path, make_run: MakeRun, archive: Archive
) -> None:
    """Measured again, taken up, renamed, restored from a backup; it goes with the run alone."""
    read_before = make_run()
    archive.put_run(read_before)
    archive.annotate(["u1", "nobody"], lambda had: had.changed("no loop closure", ["b", "a"], []))
    said = ("no loop closure", ["a", "b"])
    result = Result(evaluation="sim3", outcome=Outcome.LOST)
    archive.put_run(read_before.replace(results=[result]))
    archive.put_result("u1", result)
    archive.rewrite_runs([read_before.replace(message="of another dataset")])
    assert noted(archive) == said
    archive.rename_run(read_before.replace(uid="u1@12345678"), "u1")
    archive.put_run(make_run())
    assert noted(archive, "u1@12345678") == said
    assert noted(archive) == (None, [])
    before = list(archive.runs())
    backup(url, tmp_path / "copy.sqlite")
    archive.remove_run("u1@12345678")
    restore(url, tmp_path / "copy.sqlite", force=True)
    assert list(archive.runs()) == before
    assert check(url).faults == []


def test_what_an_object_says_gives_way_to_what_somebody_wrote(archive: Archive, make_run: MakeRun) -> None:
    annotated = make_run(note="as annotated", tags=["cluster"])
    archive.put_run(annotated)
    archive.put_run(annotated.replace(note="annotated anew"))
    assert noted(archive) == ("annotated anew", ["cluster"])
    archive.annotate(["u1"], lambda _: Remarks())
    archive.put_run(annotated)
    archive.annotate(["u1"], lambda had: had.changed(None, [], [], clear=True))
    archive.put_run(annotated)
    assert noted(archive) == (None, [])


@pytest.mark.parametrize("earlier_first", [True, False])
def test_merged_archives_have_all_tags_and_the_newer_note(earlier_first: bool) -> None:
    early, late = Remarks("old", ("a", "b"), EARLY), Remarks("new", ("b", "c"), LATE)
    found = early.merged(late) if earlier_first else late.merged(early)
    assert found == Remarks("new", ("a", "b", "c"), LATE)
    assert found.merged(early) == found.merged(late) == found
    assert replace(late, note=None).merged(early).note == "old"


def test_an_upgrade_that_is_killed_leaves_no_half_of_it(
    url: str, put_version: PutVersion, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_version(url, 4)

    def stop(sentence: str) -> None:
        if sentence.startswith("bringing the archive from schema 4"):
            raise KeyboardInterrupt

    real, steps = migrations.STEPS, []

    def dies(connection: Any) -> None:
        real[4](connection)
        steps.append(4)
        raise KeyboardInterrupt

    for tell, taken in ((stop, real), (lambda _: None, {4: dies})):
        monkeypatch.setattr(migrations, "STEPS", taken)
        with pytest.raises(KeyboardInterrupt):
            upgrade(url, tell)
        with pytest.raises(InputError, match=r"schema 4; this one needs 6"):
            Archive.open(url)
    assert steps == [4]
    monkeypatch.setattr(migrations, "STEPS", real)
    assert upgrade(url) is not None
    with Archive.open(url) as archive:
        uids = [record.uid for record in archive.runs()]
        archive.annotate(uids, lambda had: had.changed("all of them", ["old"], []))
        assert {noted(archive, uid)[0] for uid in uids} == {"all of them"}
    assert check(url).faults == []


@pytest.mark.parametrize(
    ("text", "said"),
    [("x" * 10_000_000, "text: has 10,000,000 characters, at most 2,000"), (" \n\t", "text: an empty one")],
)
def test_notes_that_are_none(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        checked_note(text)


def test_a_note_is_one_line_that_moves_no_cursor() -> None:
    assert checked_note("two\nlines\t of \x1b[31mred\u202e ") == "two lines of \ufffd[31mred\ufffd"


@pytest.mark.parametrize("tag", ["two words", "x" * 200, "", "-x", "a,,b", "<b>", "\x1b[31m", "ä"])
def test_tags_that_are_none(tag: str) -> None:
    with pytest.raises(InputError, match=r"remove-tag: .*: a tag is one word of at most 63") as caught:
        checked_tags([tag], "remove-tag")
    assert len(str(caught.value)) < 250
    assert str(caught.value).isprintable()


def test_a_run_has_so_many_tags() -> None:
    full = Remarks().changed(None, map(str, range(MOST_TAGS)), [])
    with pytest.raises(InputError, match="tag: a run has 32 tags at most, this one would have 33"):
        full.changed(None, ["more"], [])
    assert full.changed(None, ["more"], ["0"]).tags[-1] == "more"


def test_annotations_are_taken_as_far_as_they_can_be() -> None:
    """Nobody would read a refusal: what is too long is cut, what is no tag is left out."""
    found = Remarks.of_annotations(
        {"slamhive.io/note": "a\n" * 90_000, "slamhive.io/tags": "b, two words,a,"}
    )
    assert found.tags == ("a", "b")
    assert found.note is not None
    assert (len(found.note), found.note[:4], found.note[-1]) == (MOST_LETTERS, "a a ", "…")
    assert Remarks.of_annotations({}) == Remarks()
