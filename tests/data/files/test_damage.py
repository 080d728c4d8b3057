# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.data.files.damage import remedy

if TYPE_CHECKING:
    from pathlib import Path

BAG, MCAP, SQLITE = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\x00"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bag", BAG + b"rest", "`rosbag reindex` on a copy keeps what is whole"),
        ("a.mcap", MCAP + b"rest", "cut off or was not closed: `mcap recover a.mcap -o recovered.mcap`"),
        ("a.mcap", MCAP + b"rest" + MCAP, "is damaged: `mcap recover a.mcap -o recovered.mcap`"),
        ("a.bag", bytes(500), "zeros"),
        ("a.bag", b"hello", "copy it again, or record it anew"),
        ("a.bag", MCAP + b"rest", "it is an MCAP file"),
        ("a.bag", None, "copy it again"),
    ],
)
def test_what_helps_depends_on_what_the_file_is(
    tmp_path: Path, name: str, content: bytes | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert words in remedy(tmp_path / name)


def test_where_the_index_is_whole_a_new_one_helps_little(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(BAG)
    assert "messages in it are damaged: copy it again" in remedy(tmp_path / "a.bag", indexed=True)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.db3", SQLITE, "`ros2 bag reindex folder` writes metadata.yaml anew; if a.db3 itself is damaged"),
        ("a.db3", b"hello", "a.db3 in it is no SQLite database"),
        ("a.mcap", MCAP, "`mcap recover a.mcap -o recovered.mcap`"),
        ("a.txt", b"", "neither a .db3 nor an .mcap"),
    ],
)
def test_what_helps_with_the_folder_of_a_ros_2_bag(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / name).write_bytes(content)
    assert words in remedy(tmp_path / "folder")
