# SPDX-License-Identifier: Apache-2.0
"""A home that can't be used is refused in a sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.cli import main as command
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path


def test_a_home_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runner.lock").symlink_to(tmp_path / "missing" / "lock")
    with (
        pytest.raises(InputError, match=r"SLAMHIVE_HOME: .*runner\.lock: No such"),
        Home.at(tmp_path).exclusive(),
    ):
        pass


def test_a_home_whose_path_a_database_url_cannot_hold_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", "/data/what?")
    with pytest.raises(InputError, match="question mark"):
        Home.from_environment()


def test_a_relative_data_folder_makes_an_absolute_home(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SLAMHIVE_HOME", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", "data")
    assert Home.from_environment().path == tmp_path / "data" / "slamhive"


def test_what_the_system_refuses_ends_in_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse() -> None:
        raise PermissionError(13, "Permission denied", "/data/recording.bag")

    monkeypatch.setattr(command, "app", refuse)
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 1
    assert "/data/recording.bag: Permission denied" in capsys.readouterr().err.replace("\n", "")
