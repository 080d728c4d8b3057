# SPDX-License-Identifier: Apache-2.0
"""Remedies for a recording that can't be read, by what its first and last bytes say of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_BAG, _MCAP, _SQLITE = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\x00"
_ENDS = 64
"""Bytes to look at."""


def remedy(path: Path, *, indexed: bool = False) -> str:
    """Say what helps with a recording that can't be read.

    Args:
        path: A file, or the folder of a ROS 2 bag.
        indexed: Whether its index could be read, so that what is damaged are messages.
    """
    if path.is_dir():
        return _folder_remedy(path)
    begin, end = _ends(path)
    if begin.startswith(_BAG) and indexed:
        return (
            "messages in it are damaged: copy it again; `rosbag reindex` on a copy keeps no more than what "
            "comes before the damage"
        )
    if begin.startswith(_BAG):
        return (
            "it is a bag whose end is damaged or cut off, or that was not closed: `rosbag reindex` on a copy "
            "keeps what is whole"
        )
    if begin.startswith(_MCAP):
        whole = end.endswith(_MCAP)
        why = "is damaged" if whole else "is cut off or was not closed"
        return (
            f"it is an MCAP file that {why}: `mcap recover {path.name} -o recovered.mcap` keeps what is whole"
        )
    if begin and not any(begin):
        return "it holds zeros, as after a copy that broke off: copy it again"
    return "it doesn't begin as a recording of this format does: copy it again, or record it anew"


def _folder_remedy(folder: Path) -> str:
    for file in sorted(folder.glob("*.mcap")):
        if _ends(file)[0].startswith(_MCAP):
            return (
                f"`mcap recover {file.name} -o recovered.mcap` keeps what is whole of its file, then "
                f"`ros2 bag reindex {folder.name}` writes metadata.yaml anew"
            )
    for file in sorted(folder.glob("*.db3")):
        if not _ends(file)[0].startswith(_SQLITE):
            return f"{file.name} in it is no SQLite database: copy it again"
        return (
            f"`ros2 bag reindex {folder.name}` writes metadata.yaml anew; if {file.name} itself is damaged, "
            f"`sqlite3 {file.name} .recover` keeps what is whole"
        )
    return "there is neither a .db3 nor an .mcap file in it: copy it again"


def _ends(path: Path) -> tuple[bytes, bytes]:
    """Return the first and the last bytes of a file; none where it can't be read."""
    try:
        with path.open("rb") as file:
            begin = file.read(_ENDS)
            file.seek(max(path.stat().st_size - _ENDS, 0))
            return begin, file.read(_ENDS)
    except OSError:
        return b"", b""
