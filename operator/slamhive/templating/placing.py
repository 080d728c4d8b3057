# SPDX-License-Identifier: Apache-2.0
"""Settings files on a disk: in the run folder, below a folder of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from slamhive.templating.process import RenderedFile

_WRITING = 0o222


def place_files(rendered: Iterable[RenderedFile], folder: Path, *, read_only: bool = True) -> None:
    """Write settings files below a folder, which is made.

    Args:
        rendered: the files.
        folder: where their paths begin.
        read_only: whether a slip of the algorithm shall be kept out.

    Raises:
        OSError: the disk refuses.
    """
    for file in rendered:
        path = folder / file.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)  # of an earlier life of a pod's container, or of an earlier command
        path.write_text(file.text, encoding="utf-8", newline="")
        if read_only:
            path.chmod(path.stat().st_mode & ~_WRITING)
