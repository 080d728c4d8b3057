# SPDX-License-Identifier: Apache-2.0
"""Documents whose common part the archive writes once: they come back as they were, in records and tables."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import create_engine, text

from slamhive.analysis.columns import Column
from slamhive.analysis.compact.shapes import MissingShapeError, divide, join, names_of
from slamhive.analysis.flattening import Spread
from slamhive.archive import Archive, documents, upgrading
from slamhive.archive.keeping import check
from slamhive.archive.upgrading import upgrade
from slamhive.model.leftout import LeftOutWarning
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import Result, RunRecord

    MakeRun = Callable[..., RunRecord]
    MakeResult = Callable[..., Result]
    PutVersion = Callable[[str, int], None]

KEYS = st.sampled_from(["a", "b", "cpu", "parameters", "sha256", "message", "é"])
PLAIN = st.none() | st.booleans() | st.integers(-9, 9) | st.floats(allow_nan=False) | st.text(max_size=4)
VALUES = st.recursive(
    PLAIN, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=12
)
DOCUMENTS = st.dictionaries(KEYS, VALUES, max_size=5)


def held_as(document: Any, shapes: dict[int, Any]) -> Any:
    """Return a document as a row would hold it, and note its shape."""
    found = divide("values", document)
    if found is None:
        return document
    shape, own = found
    shapes[shape.number] = json.loads(shape.text)
    return json.loads(json.dumps([shape.number, *own]))


@given(DOCUMENTS | st.lists(DOCUMENTS, max_size=3))
def test_a_divided_document_comes_back_as_it_was(document: Any) -> None:
    shapes: dict[int, Any] = {}
    back = join(shapes, held_as(document, shapes))
    assert json.dumps(back) == json.dumps(document)


def listed(values: Any) -> list[Any]:
    return (values if isinstance(values, Column) else Column.of(values)).tolist()


@given(st.lists(st.none() | DOCUMENTS, min_size=1, max_size=6))
def test_divided_documents_make_the_same_columns(found: list[Any]) -> None:
    shapes: dict[int, Any] = {}
    held = [held_as(document, shapes) for document in found]
    names = {number: names_of(shape) for number, shape in shapes.items()}
    expected = Spread.of(found, {}).columns
    columns = Spread.of(held, names).columns
    assert {name: listed(values) for name, values in columns.items()} == {
        name: listed(values) for name, values in expected.items()
    }


def test_a_value_too_few_or_too_many_is_damage() -> None:
    found = divide("usage", {"cpu": {"seconds": 1.5}, "samples": 3, "source": "cgroup"})
    assert found is not None
    shapes = {found[0].number: json.loads(found[0].text)}
    for values in ([1.5], [1.5, 3, 4]):
        with pytest.raises(MissingShapeError):
            join(shapes, [found[0].number, *values])


def count(url: str, what: str) -> int:
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with engine.connect() as connection:
        found = int(connection.execute(text(f"SELECT count(*) FROM {what}")).scalar_one())
    engine.dispose()
    return found


def test_what_runs_have_in_common_is_written_once(
    url: str, make_run: MakeRun, make_result: MakeResult
) -> None:
    with Archive.open(url) as archive:
        archive.put_runs(make_run(f"u{k}", results=[make_result(rmse=k / 7)]) for k in range(20))
        shapes = count(url, "shapes")
        archive.put_runs(make_run(f"v{k}", results=[make_result(rmse=k / 9)]) for k in range(20))
        assert count(url, "shapes") == shapes
        assert [run.results[0].values["ate"]["rmse"] for run in archive.runs()] == [
            *(k / 7 for k in range(20)),
            *(k / 9 for k in range(20)),
        ]
    assert check(url).faults == []


def test_what_is_never_alike_is_kept_as_it_is(
    url: str, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(documents, "MOST_SHAPES", 3)
    labels = [{f"run-of-somebody-{k}": "x" * 20} for k in range(9)]
    with Archive.open(url) as archive:
        archive.put_runs(make_run(f"u{k}", labels=one) for k, one in enumerate(labels))
        assert [run.labels for run in archive.runs()] == labels
    assert count(url, "shapes WHERE kind = 'labels'") == 3
    assert check(url).faults == []


@pytest.mark.parametrize("version", [1, 2, 3])
def test_an_upgrade_that_ends_in_the_middle_goes_on(
    url: str, version: int, put_version: PutVersion, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is divided already: records and tables are the same."""
    put_version(url, version)
    monkeypatch.setattr(upgrading, "_RUNS", 2)
    said: list[str] = []

    def stop(sentence: str) -> None:
        said.append(sentence)
        if sentence.endswith("of 6 runs"):
            raise KeyboardInterrupt

    seen = []
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            upgrade(url, stop)
        with Archive.open(url) as archive:
            seen.append(list(archive.runs()))
        frame = read_archive(url)
        seen[-1] += [frame.column(name).tolist() for name in sorted(frame.stored)]
    assert [one for one in said if "of 6" in one] == [
        f"writing once what runs have in common: {k} of 6 runs" for k in (2, 4, 6)
    ]
    assert upgrade(url) is None
    assert count(url, "slamhive_schema WHERE divided_to IS NULL") == 1
    assert seen[0] == seen[1] == seen[2]
    assert check(url).faults == []


def test_an_archive_of_version_3_has_the_runs_of_version_2(
    url: str, tmp_path: Any, put_version: PutVersion
) -> None:
    earlier = f"sqlite:///{tmp_path}/earlier/archive.sqlite"
    put_version(earlier, 2)
    put_version(url, 3)
    upgrade(earlier)
    upgrade(url)
    with Archive.open(earlier) as two, Archive.open(url) as three:
        assert list(two.runs()) == list(three.runs())


def test_a_shape_that_is_lost_is_said(url: str, make_run: MakeRun) -> None:
    with Archive.open(url) as archive:
        archive.put_run(make_run())
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM shapes WHERE kind = 'spec'"))
    engine.dispose()
    assert any("runs: u1: a document needs shape" in fault for fault in check(url).faults)
    said = "run 'u1' can't be read, and is left out: a document needs shape .* `slamhive archive check`"
    with Archive.open(url) as archive, pytest.warns(LeftOutWarning, match=said):
        assert list(archive.runs()) == []
    with pytest.warns(LeftOutWarning, match=said):
        assert len(read_archive(url)) == 0
