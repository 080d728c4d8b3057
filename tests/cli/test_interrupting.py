# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C: every command ends with a sentence and 130, and what it writes is whole or as it was."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest

from slamhive.cli import main

if TYPE_CHECKING:
    from pathlib import Path


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("words", "place"),
    [
        ("figure box -o FILE", "slamhive.cli.figure.choose_runs"),
        ("results export -o FILE", "slamhive.cli.results.csv_blocks"),
        ("report -o FILE", "slamhive.cli.report.choose_runs"),
        ("dataset add euroc/mh-01-easy", "slamhive.cli.datasets._add_sequence"),
        ("dataset check synthetic-lidar", "slamhive.cli.datasets.open_workbench"),
        ("dataset list", "slamhive.cli.datasets.load_workshop"),
        ("results list", "slamhive.cli.main.load"),
        ("--version", "slamhive.cli.main._print_version"),
    ],
)
def test_a_sentence_and_130(
    words: str,
    place: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    file = tmp_path / "file.pdf" if "figure" in words else tmp_path / "file.csv"
    file.write_text("before")
    monkeypatch.setattr(sys, "argv", ["slamhive", *words.replace("FILE", str(file)).split()])
    monkeypatch.setattr(main.signal, "signal", lambda *_: None)
    monkeypatch.setattr(place, interrupt)
    with pytest.raises(SystemExit) as ended:
        main.main()
    said = capsys.readouterr().err
    assert (ended.value.code, said.count("\n"), "interrupted" in said) == (130, 1, True)
    assert (file.read_text(), {one.name for one in tmp_path.iterdir()} - {"home"}) == ("before", {file.name})
