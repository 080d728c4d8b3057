# SPDX-License-Identifier: Apache-2.0
"""Folders of images through ``slamhive dataset add``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from typer.testing import CliRunner

from slamhive.cli.datasets import app

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_what_was_left_out_is_printed(euroc: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    folder = euroc(tmp_path / "V2_03")
    next((folder / "mav0" / "cam1" / "data").iterdir()).unlink()
    found = CliRunner().invoke(app, ["add", str(folder), "--name", "v203"])
    assert found.exit_code == 0, found.output
    words = " ".join(found.output.split())
    assert "1 of 8 images do not exist and are left out" in words
    assert "left and right have 8 and 7 images; 1 and 0 of them have no partner" in words
    assert CliRunner().invoke(app, ["check", "v203"]).exit_code == 0
