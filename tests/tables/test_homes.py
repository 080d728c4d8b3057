# SPDX-License-Identifier: Apache-2.0
"""Runs of other homes beside one's own: told apart by what they are, never by their names."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from matplotlib.legend import Legend
from sqlalchemy import update

import slamhive
from slamhive.analysis.selection import Selection, choose
from slamhive.archive import schema
from slamhive.archive.connection import open_engine, parse, writing
from slamhive.figures.making import numbers_file
from slamhive.model.errors import InputError
from slamhive.tables.homes import homes_beside, read_homes, uid_in

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

NAMES = ("home", "algorithm", "dataset", "uid")


def rows(mine: Any, *others: Any) -> list[tuple[Any, ...]]:
    found = read_homes(mine.home, homes_beside(mine.home, [str(one.path) for one in others]))
    return [tuple(row.values()) for row in found.records(NAMES)]


def test_rows_of_another_home_stand_beside_ones_own(keep: Callable[[str], Any]) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("b", content="c2")
    assert rows(mine, anna) == [("here", "icp", "hall", "a"), ("anna", "icp", "hall", "b")]


def test_a_run_that_stands_in_both_is_there_once(keep: Callable[[str], Any]) -> None:
    mine, anna = keep("mine"), keep("anna")
    for one in (mine, anna):
        one.run("a")
    assert rows(mine, anna) == [("here", "icp", "hall", "a")]


def test_equal_content_counts_once(keep: Callable[[str], Any]) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("b")
    found = choose(read_homes(mine.home, homes_beside(mine.home, [str(anna.path)])), Selection())
    assert (len(found.frame), found.repeated) == (1, 1)


@pytest.mark.parametrize(
    ("fields", "name"),
    [({"version": "v2"}, ("icp @anna", "hall")), ({"dataset_version": "d2"}, ("icp", "hall @anna"))],
)
def test_what_has_one_name_and_other_content_is_told_apart(
    keep: Callable[[str], Any], fields: dict[str, str], name: tuple[str, str]
) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("a", content="c2", **fields)
    assert rows(mine, anna) == [("here", "icp", "hall", "a"), ("anna", *name, "a~anna")]


def test_what_is_current_there_and_superseded_here_is_not_mixed(keep: Callable[[str], Any]) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    mine.run("b", content="c2", version="v2")
    anna.run("c", content="c3")
    frame = read_homes(mine.home, homes_beside(mine.home, [str(anna.path)]))
    counted = choose(frame, Selection()).frame
    assert [row["algorithm"] for row in counted.records(["algorithm"])] == ["icp", "icp @anna"]


def test_three_homes_and_their_uids(keep: Callable[[str], Any]) -> None:
    mine, anna, ben = keep("mine"), keep("anna"), keep("ben")
    for number, one in enumerate((mine, anna, ben)):
        one.run("a", content=f"c{number}")
    assert [uid for *_, uid in rows(mine, anna, ben)] == ["a", "a~anna", "a~ben"]
    assert uid_in("a~ben", {"here", "anna", "ben"}) == ("a", "ben")
    assert uid_in("a~carl", {"here", "anna", "ben"}) == ("a~carl", None)


def test_labels_tell_homes_of_one_folder_name_apart(keep: Callable[[str], Any], tmp_path: Path) -> None:
    mine, anna = keep("mine"), keep("anna")
    anna.run("a")
    shutil.copytree(anna.path, tmp_path / "copy" / "anna")
    places = [str(anna.path), str(tmp_path / "copy" / "anna")]
    with pytest.raises(InputError, match="another home is called 'anna' already: name it by LABEL=PATH"):
        homes_beside(mine.home, places)
    found = homes_beside(mine.home, [places[0], f"lab={places[1]}"])
    assert [one.label for one in found] == ["anna", "lab"]


def test_homes_of_the_environment_are_read_unless_others_are_named(
    keep: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, anna, ben = keep("mine"), keep("anna"), keep("ben")
    for one in (anna, ben):
        one.run("a")
    monkeypatch.setenv("SLAMHIVE_ALSO", f"{anna.path},{mine.path}")
    assert [one.label for one in homes_beside(mine.home, None)] == ["anna"]
    assert [one.label for one in homes_beside(mine.home, [str(ben.path)])] == ["ben"]


def test_what_is_no_home_is_refused(keep: Callable[[str], Any], tmp_path: Path) -> None:
    mine = keep("mine").home
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"^also: .*empty: is no home: it holds no archive\.sqlite"):
        homes_beside(mine, [str(tmp_path / "empty")])
    for name in ("d", "b", "c", "a"):
        (tmp_path / "empty" / name).mkdir()
    with pytest.raises(InputError, match=r"holds no archive\.sqlite, but a, b, c, …$"):
        homes_beside(mine, [str(tmp_path / "empty")])
    with pytest.raises(InputError, match=r"^also: /nowhere: no such folder or file"):
        homes_beside(mine, ["/nowhere"])


@pytest.mark.parametrize(("version", "words"), [(99, "newer slamhive"), (1, "earlier slamhive")])
def test_a_home_of_another_version_is_refused_by_its_label(
    keep: Callable[[str], Any], version: int, words: str
) -> None:
    mine, anna = keep("mine"), keep("anna")
    anna.run("a")
    engine = open_engine(parse(anna.home.archive_url))
    with writing(engine) as connection:
        connection.execute(update(schema.schema_version).values(version=version))
    engine.dispose()
    with pytest.raises(InputError, match=f"home anna: .*{words}"):
        rows(mine, anna)


def test_a_home_that_cannot_be_written_is_read_while_its_owner_writes(
    keep: Callable[[str], Any], tmp_path: Path
) -> None:
    mine, anna = keep("mine"), keep("anna")
    anna.run("a")
    there = tmp_path / "mounted"
    there.mkdir()
    if subprocess.run(["mount", "--bind", anna.path, there], capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount")
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", there], check=True, capture_output=True)
        before = sorted(path.name for path in anna.path.iterdir())
        found = read_homes(mine.home, homes_beside(mine.home, [str(there)]))
        assert [row["home"] for row in found.records(["home"])] == ["mounted"]
        assert sorted(path.name for path in anna.path.iterdir()) == before
    finally:
        subprocess.run(["umount", there], check=True)


def test_tables_say_whose_a_row_is(keep: Callable[[str], Any], run_command: Callable[..., Any]) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("a", content="c2", version="v2", error=0.3)
    also = f"--also={anna.path}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLAMHIVE_ALSO", str(anna.path))
        _, out, _ = run_command("results", "export", "--columns", "home,algorithm")
    assert out.splitlines() == ["home,algorithm", "here,icp", "anna,icp @anna"]
    _, out, _ = run_command("results", "table", "--format", "json", also)
    assert {row["algorithm"]: row["ate.rmse.mean"] for row in json.loads(out)} == {
        "icp": 0.1,
        "icp @anna": 0.3,
    }
    _, out, _ = run_command("results", "list", "--format", "csv", "--where", "home == 'anna'", also)
    assert out.splitlines()[1].startswith("s-a,anna,s,icp @anna")
    _, out, _ = run_command("paper-table", "--style", "csv", also)
    assert "icp @anna" in out
    _, out, _ = run_command("report", "-o", "-", also)
    assert "icp @anna" in out


def test_a_figure_has_the_runs_of_both(
    keep: Callable[[str], Any], run_command: Callable[..., Any], tmp_path: Path
) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("a", content="c2", version="v2", error=0.3)
    code, _, err = run_command(
        "figure", "box", "-y", "ate.rmse", f"--also={anna.path}", "-o", tmp_path / "box.svg"
    )
    assert code == 0, err
    assert "icp @anna" in numbers_file(tmp_path / "box.svg").read_text()


def test_a_data_frame_has_the_runs_of_both(
    keep: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("a", content="c2", version="v2", error=0.3)
    both = [("here", "icp", 0.1), ("anna", "icp @anna", 0.3)]

    def found(*place: Path, **also: Any) -> list[tuple[Any, ...]]:
        columns = ["home", "algorithm", "ate.rmse"]
        return [*slamhive.results(*place, columns=columns, frame="polars", **also).iter_rows()]

    assert found(mine.path, also=anna.path) == found(mine.path, also=[f"anna={anna.path}"]) == both
    monkeypatch.setenv("SLAMHIVE_HOME", str(mine.path))
    monkeypatch.setenv("SLAMHIVE_ALSO", str(anna.path))
    assert found() == both
    assert "home" not in slamhive.results(mine.path).columns  # a home that is named stands alone
    assert not (anna.path / "cache").exists()
    with pytest.raises(InputError, match=r"^also: /nowhere: no such folder or file"):
        slamhive.results(mine.path, also="/nowhere")


def test_a_figure_of_a_data_frame_finds_the_files_of_both(keep: Callable[[str], Any]) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("b", content="c2", version="v2")
    drawn = slamhive.results(mine.path, also=anna.path).figure("error-over-time")
    assert "its folder is not here" not in drawn.caption
    labels = {text.get_text() for legend in drawn.findobj(Legend) for text in legend.get_texts()}
    assert labels >= {"icp", "icp @anna"}


def test_a_run_of_another_home_is_shown_by_name_and_by_uid(
    keep: Callable[[str], Any], run_command: Callable[..., Any]
) -> None:
    mine, anna = keep("mine"), keep("anna")
    mine.run("a")
    anna.run("a", content="c2", error=0.3)
    also = f"--also={anna.path}"
    _, out, _ = run_command("results", "show", "a~anna", "--json", also)
    assert [(row["home"], row["ate.rmse"]) for row in json.loads(out)] == [("anna", 0.3)]
    _, out, _ = run_command("results", "show", "s-a", also)
    assert out.count("provenance.contentHash") == 2
    code, _, err = run_command("results", "show", "b~anna", also)
    assert (code, "b" in err) == (2, True)
