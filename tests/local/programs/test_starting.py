# SPDX-License-Identifier: Apache-2.0
"""Tests of folders to start an algorithm from: what is in them, under which names, and what is refused."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.parameters import parameter_uses
from slamhive.local.programs import starting
from slamhive.local.programs.environments import availability
from slamhive.local.programs.starting import ExampleKind, start_algorithm
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.local.home.folder import Home


@pytest.mark.parametrize("kind", ExampleKind)
def test_a_folder_is_known_by_its_name_and_says_nothing_of_the_example(
    kind: ExampleKind, home: Home, tmp_path: Path
) -> None:
    folder, left = start_algorithm("stone-slam", kind, home, load_workshop(home), tmp_path)
    entry = load_workshop(home).algorithm("stone-slam")
    assert entry.algorithm.spec.image == "stone-slam:1"
    assert entry.folder.resolve() == folder
    assert {"algorithm.yaml", "Dockerfile", "README.md"} <= {path.name for path in folder.iterdir()}
    assert all(f"my-{kind}" not in path.read_text(errors="replace") for path in folder.iterdir())
    assert parameter_uses(entry).unused == []
    assert (folder.stat().st_mode & 0o777) == 0o755
    for path in folder.iterdir():
        assert os.access(path, os.X_OK) == (path.read_bytes()[:2] in {b"#!", b"\x7fE"})
    assert [path for path in tmp_path.iterdir() if path.name.startswith(".")] == []
    assert left == "" or kind is ExampleKind.PROGRAM


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Rolling_Stone", "digits, - and ., found 'Rolling_Stone'; try rolling-stone"),
        ("../stone", "expected a name of lower-case letters"),
        ("stone-", "expected a name of lower-case letters"),
        ("", "at least 1 character"),
        ("s" * 64, "NAME: 64 characters are too many, at most 63 are allowed"),
        ("kiss-icp", "the algorithm 'kiss-icp' is known already"),
        ("taken", "nothing is overwritten"),
    ],
)
def test_what_can_not_be_a_folder_of_an_algorithm_is_refused(
    name: str, words: str, home: Home, tmp_path: Path
) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "thesis.tex").write_text("years of work")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as error:
        start_algorithm(name, ExampleKind.PROGRAM, home, load_workshop(home), tmp_path)
    assert words in str(error.value)
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "taken" / "thesis.tex").read_text() == "years of work"


def test_without_a_compiler_the_next_step_is_to_build(
    home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(starting.shutil, "which", lambda _: None)
    folder, left = start_algorithm("stone-slam", ExampleKind.PROGRAM, home, load_workshop(home), tmp_path)
    assert left.startswith("make -C stone-slam")
    assert not (folder / "odometry").exists()
    problem = availability(load_workshop(home).algorithm("stone-slam"))
    assert problem is not None
    assert problem.endswith("odometry is not there: build it first")


def test_a_folder_that_can_not_be_written_is_a_sentence(home: Home, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file or directory"):
        start_algorithm("stone-slam", ExampleKind.PROGRAM, home, load_workshop(home), tmp_path / "gone")
