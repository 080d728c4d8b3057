# SPDX-License-Identifier: Apache-2.0
"""Ground truth for plots: found as soon as it is there, and what it is now."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.dashboard.ground_truth import Truths

if TYPE_CHECKING:
    from pathlib import Path


def write(path: Path, x: float) -> None:
    path.write_text("".join(f"{k} {x} {k} 0 0 0 0 1\n" for k in range(3)))


def test_what_comes_later_is_found_and_what_changes_is_read_again(tmp_path: Path) -> None:
    now = [0.0]
    truths = Truths(tmp_path, clock=lambda: now[0])
    assert truths.find("hall") is None
    write(tmp_path / "Hall.txt", 1.0)
    found = truths.find("hall")
    assert found is not None
    assert truths.find("hall") is found
    write(tmp_path / "Hall.txt", 2.0)
    now[0] = 120.0
    again = truths.find("hall")
    assert again is not None
    assert again.poses.positions[:, 0].tolist() == [2.0] * 3


def test_names_lead_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    write(tmp_path / "secret.txt", 1.0)
    assert Truths(tmp_path / "folder").find("../secret") is None
