# SPDX-License-Identifier: Apache-2.0
"""Algorithms of one's own become known by name."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from slamhive.local.home.catalog import link_algorithm, load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def folder(home: Home, tmp_path: Path) -> Path:
    target = tmp_path / "mine"
    shutil.copytree(home.path / "algorithms/actor", target)
    return target


def test_an_added_algorithm_is_known_and_its_folder_stays_ones_own(folder: Path, tmp_path: Path) -> None:
    home = Home.at(tmp_path / "other")
    assert link_algorithm(folder, home) == "actor"
    assert link_algorithm(folder, home) == "actor"
    entry = load_workshop(home).algorithm("actor")
    (folder / "adapter.py").write_text("# edited")
    assert (entry.folder / "adapter.py").read_text() == "# edited"


@pytest.mark.parametrize("name", ["algorithm.yaml", "adapter.py", "requirements.txt", "truth.txt"])
def test_a_folder_that_lacks_a_file_is_refused(folder: Path, tmp_path: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(InputError, match=name):
        link_algorithm(folder, Home.at(tmp_path / "other"))


def test_another_folder_of_the_same_name_is_refused(folder: Path, home: Home) -> None:
    with pytest.raises(InputError, match="known already"):
        link_algorithm(folder, home)
