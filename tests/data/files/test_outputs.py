# SPDX-License-Identifier: Apache-2.0
"""Files that a user asked for: whole, or as they were."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from slamhive.data.files.outputs import output_whole
from slamhive.model.errors import InputError


def interrupt(path: Path) -> None:
    with output_whole(path) as aside:
        aside.write_text("half")
        raise KeyboardInterrupt


@pytest.mark.parametrize("before", [None, "all of the earlier one"])
def test_an_interrupted_file_is_as_it_was(tmp_path: Path, before: str | None) -> None:
    path = tmp_path / "table.csv"
    if before is not None:
        path.write_text(before)
    with pytest.raises(KeyboardInterrupt):
        interrupt(path)
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == (
        {} if before is None else {"table.csv": before}
    )


def test_a_link_stays_one_and_a_file_keeps_its_mode(tmp_path: Path) -> None:
    (tmp_path / "real.csv").write_text("before")
    (tmp_path / "real.csv").chmod(0o600)
    (tmp_path / "link.csv").symlink_to("real.csv")
    with output_whole(tmp_path / "link.csv") as aside:
        aside.write_text("after")
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text() == "after"
    assert (tmp_path / "real.csv").stat().st_mode & 0o777 == 0o600


def test_what_is_no_file_is_written_itself() -> None:
    with output_whole(Path(os.devnull)) as aside:
        assert aside == Path(os.devnull)
        aside.write_text("x")
    assert not Path(os.devnull).is_file()


def test_a_folder_that_is_missing_is_said(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match=r"^output: .*none/table\.csv: No such file"),
        output_whole(tmp_path / "none" / "table.csv") as aside,
    ):
        aside.write_text("x")
