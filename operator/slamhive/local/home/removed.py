# SPDX-License-Identifier: Apache-2.0
"""Run folders in a home, and those whose files were removed: a note stays in the place of the files.

::

    runs/SWEEP/RUN/removed.json     when its files were removed, and what they took

The note is written before the first file goes. So a removal that is killed leaves a folder that says what
became of it, and the next one goes on; and whoever looks for a file is told why it isn't there, whatever
archive the run stands in.
"""

from __future__ import annotations

import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from slamhive.contract.files import read_regular
from slamhive.data.files.erasing import erase
from slamhive.data.files.once import flush
from slamhive.model.errors import SystemFault

NOTE = "removed.json"
_MOST = 4096


class Removed(NamedTuple):
    """The files of a run that are there no more.

    Attributes:
        when: they were removed.
        size: bytes that they took.
    """

    when: datetime
    size: int

    @property
    def sentence(self) -> str:
        """Return the fact that they are gone, as part of a sentence."""
        return f"its files were removed on {self.when:%Y-%m-%d}"


def run_parts(folder: str | None) -> tuple[str, str] | None:
    """Return the way from ``runs`` to a run's folder, SWEEP and RUN; None where that is no such folder.

    The home may have moved since the folder was noted.
    """
    parts = Path(folder or "").parts[-2:]
    if len(parts) != 2 or any(part in {"/", ".", ".."} for part in parts):
        return None
    return parts[0], parts[1]


def removed_from(folder: Path) -> Removed | None:
    """Return the note on a run folder's removed files; None where nothing was removed."""
    try:
        found = json.loads(read_regular(str(folder / NOTE), _MOST))
        return Removed(datetime.fromisoformat(found["removed"]), int(found["bytes"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def absence(home: Path | None, folder: str | None) -> str | None:
    """Return the reason that a run's files are not in a home, as part of a sentence; None without a note.

    Args:
        home: the home; None for none.
        folder: of the run, as its record has it.
    """
    parts = run_parts(folder)
    found = removed_from(home.joinpath("runs", *parts)) if home is not None and parts is not None else None
    return found.sentence if found else None


def remove_files(folder: Path, size: int) -> None:
    """Remove all files of a run's folder but the note; that of a removal that was interrupted stays.

    Args:
        folder: the run's.
        size: bytes that the files take.

    Raises:
        SystemFault: the disk refuses.
    """
    try:
        # Of a removal that was interrupted the first note stays: it knows the size of what is half gone.
        if removed_from(folder) is None:
            write_whole(folder / NOTE, json.dumps({"removed": datetime.now(UTC).isoformat(), "bytes": size}))
        for entry in list(folder.iterdir()):
            if entry.name != NOTE:
                remove(entry)
    except OSError as error:
        raise SystemFault(f"{folder}: {error.strerror or error}") from error


def leftovers_in(folder: Path) -> list[Path]:
    """Return the files that an interrupted removal left beside its note."""
    if removed_from(folder) is None:
        return []
    return [entry for entry in folder.iterdir() if entry.name != NOTE]


def remove(path: Path) -> None:
    """Remove a file or a tree, whatever an algorithm made of it.

    Raises:
        OSError: it can't be removed.
    """
    if path.is_symlink() or not path.is_dir():
        path.unlink(missing_ok=True)
        return
    try:
        shutil.rmtree(path)
    except (OSError, RecursionError):  # locked, or nested thousands deep: programs of the system get along
        if not erase(path):
            raise


def write_whole(path: Path, text: str) -> None:
    """Write a small file that is there whole or not at all.

    Raises:
        OSError: the disk refuses.
    """
    aside = path.with_name(f".{path.name.lstrip('.')}.{os.getpid()}")
    try:
        aside.write_text(text, encoding="utf-8")
        flush(aside)
        aside.replace(path)
        flush(path.parent)
    finally:
        aside.unlink(missing_ok=True)
