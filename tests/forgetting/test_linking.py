# SPDX-License-Identifier: Apache-2.0
"""Large files that two versions of a run have in common stand once on the disk."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from slamhive.local.home.linking import LEAST_BYTES, link_to_earlier

if TYPE_CHECKING:
    from pathlib import Path

MAP = b"m" * (LEAST_BYTES + 1)


def output(folder: Path, name: str = "map.bin", content: bytes = MAP) -> Path:
    path = folder / "run" / "output" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def test_an_equal_map_of_an_earlier_version_is_kept_once(tmp_path: Path) -> None:
    earlier, now = tmp_path / "a@11111111", tmp_path / "a"
    for folder in (earlier, now):
        output(folder)
        output(folder, "deep/part.bin")
        output(folder, "small.txt", b"x")
    output(tmp_path / "another")
    assert link_to_earlier(now) > 0
    same = {
        name: (earlier / "run" / "output" / name).samefile(now / "run" / "output" / name)
        for name in ("map.bin", "deep/part.bin", "small.txt")
    }
    assert same == {"map.bin": True, "deep/part.bin": True, "small.txt": False}
    (earlier / "run" / "output" / "map.bin").unlink()
    assert (now / "run" / "output" / "map.bin").read_bytes() == MAP
    assert len(list((now / "run" / "output").iterdir())) == 3


@pytest.mark.parametrize("content", [MAP[:-1] + b"x", MAP + b"x"])
def test_another_map_stays_its_own(tmp_path: Path, content: bytes) -> None:
    output(tmp_path / "a@11111111", content=content)
    mine = output(tmp_path / "a")
    assert link_to_earlier(tmp_path / "a") == 0
    assert (mine.stat().st_nlink, mine.read_bytes()) == (1, MAP)


def test_holes_are_not_read_for_what_little_room_they_take(tmp_path: Path) -> None:
    for folder in ("a", "a@11111111"):
        os.truncate(output(tmp_path / folder), 64 << 20)
    assert link_to_earlier(tmp_path / "a") == 0


def test_links_are_never_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(MAP)
    mine, theirs = output(tmp_path / "a"), output(tmp_path / "a@11111111")
    theirs.unlink()
    theirs.symlink_to(secret)
    assert link_to_earlier(tmp_path / "a") == 0
    assert secret.stat().st_nlink == mine.stat().st_nlink == 1


def test_a_disk_that_refuses_costs_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine, theirs = output(tmp_path / "a"), output(tmp_path / "a@11111111")

    def refuse(*_: object, **__: object) -> None:
        raise OSError(31, "Too many links")

    monkeypatch.setattr(os, "link", refuse)
    assert link_to_earlier(tmp_path / "a") == 0
    assert mine.read_bytes() == theirs.read_bytes() == MAP
