# SPDX-License-Identifier: Apache-2.0
"""Tests of the pod that sends files of run folders: regular files alone, whole or from an offset on."""

from __future__ import annotations

import hashlib
import io
import json
import os
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.jobs.send import Sender, Sign, main

if TYPE_CHECKING:
    from pathlib import Path

FOLDER = "runs/u-1/p-1"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "results" / FOLDER
    (path / "output").mkdir(parents=True)
    (path / "summary.json").write_text("{}")
    (path / "output" / "trajectory.txt").write_text("0 1 2 3\n" * 100)
    return path


def asked(root: Path, *requests: Any) -> list[dict[str, Any]]:
    """Return the messages that are told, the bytes of each file under ``data``."""
    out = io.BytesIO()
    lines = b"".join((json.dumps(one) if isinstance(one, dict) else one).encode() + b"\n" for one in requests)
    assert Sender(root / "results", out, Sign(root / "sign")).serve(io.BytesIO(lines)) == 0
    out.seek(0)
    told = []
    while line := out.readline():
        message = json.loads(line)
        if "path" in message:
            message["data"] = out.read(message["size"] - message["offset"])
            message |= json.loads(out.readline())
        told.append(message)
    return told


def test_files_come_whole_with_their_checksum(tmp_path: Path, folder: Path) -> None:
    trajectory, summary, end = asked(tmp_path, {"folder": FOLDER})
    assert (trajectory["path"], summary["path"]) == ("output/trajectory.txt", "summary.json")
    content = (folder / "output" / "trajectory.txt").read_bytes()
    assert trajectory["data"] == content
    assert trajectory["sha256"] == hashlib.sha256(content).hexdigest()
    assert end == {"end": True, "left": []}
    assert (tmp_path / "sign").exists()


@pytest.mark.parametrize(("held", "offset"), [(300, 300), (800, 800), (801, 0), (-1, 0), ("x", 0)])
def test_what_is_held_is_not_sent_again(tmp_path: Path, folder: Path, held: Any, offset: int) -> None:
    trajectory = asked(tmp_path, {"folder": FOLDER, "have": {"output/trajectory.txt": held}})[0]
    content = (folder / "output" / "trajectory.txt").read_bytes()
    assert (trajectory["offset"], trajectory["data"]) == (offset, content[offset:])
    assert trajectory["sha256"] == hashlib.sha256(content).hexdigest()


def test_nothing_but_plain_files_is_sent(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    (folder / "output" / "link").symlink_to(tmp_path / "secret")
    (folder / "output" / "way").symlink_to(tmp_path)
    os.mkfifo(folder / "output" / "fifo")
    deep = folder / "output" / "/".join("d" * 17)
    deep.mkdir(parents=True)
    (deep / "file").write_text("")
    (folder / "output" / os.fsdecode(b"\xff")).write_text("")
    with (folder / "output" / "hollow").open("wb") as file:
        file.truncate(1 << 40)
    *files, end = asked(tmp_path, {"folder": FOLDER})
    assert [one["path"] for one in files] == ["output/trajectory.txt", "summary.json"]
    assert {name.rpartition("/")[2]: why for name, why in end["left"]} == {
        "link": "is a symbolic link",
        "way": "is a symbolic link",
        "fifo": "is no regular file",
        "d": "is nested too deeply",
        "\\udcff": "its name is no UTF-8",
        "hollow": "is larger than an output may be, and most of it are holes",
    }


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ({"folder": "runs/u-1/p-2"}, "No such file"),
        ({"folder": "runs/u-1/link"}, "Not a directory"),
        ({"folder": "runs/../u-1"}, "is not like"),
        ({"folder": "evaluations/one"}, "is not like"),
        ({"folder": FOLDER + "/output"}, "is not like"),
        ({}, "no request"),
        ("[1]", "no request"),
        ("nonsense", "no request"),
    ],
)
def test_what_cannot_be_had_is_said_and_the_next_is_answered(
    tmp_path: Path, folder: Path, request_: Any, said: str
) -> None:
    (folder.parent / "link").symlink_to(folder)
    refused, *rest = asked(tmp_path, request_, {"folder": FOLDER})
    assert said in refused["problem"]
    assert len(rest) == 3


def test_a_file_that_shrinks_spoils_nothing_that_follows(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = os.read

    def shrinking(descriptor: int, count: int) -> bytes:
        return b"" if os.fstat(descriptor).st_size == 800 else read(descriptor, count)

    monkeypatch.setattr(os, "read", shrinking)
    trajectory, summary, end = asked(tmp_path, {"folder": FOLDER})
    assert "shorter" in trajectory["problem"]
    assert (summary["data"], end["end"]) == (b"{}", True)


def test_the_pod_waits_as_long_as_somebody_asks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sign, now = tmp_path / "sign", [1000.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds
        if now[0] < 1010:
            sign.touch()
            os.utime(sign, (now[0], now[0]))

    monkeypatch.setattr(
        "slamhive.jobs.send.time", SimpleNamespace(time=lambda: now[0], sleep=sleep, monotonic=time.monotonic)
    )
    assert main([f"--sign={sign}", "--wait=5"]) == 0
    assert now[0] == pytest.approx(1014, abs=1.5)
