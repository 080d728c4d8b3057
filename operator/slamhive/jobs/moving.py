# SPDX-License-Identifier: Apache-2.0
"""Copy of a run's folder into object storage: its files first, then the note that names them, read back."""

from __future__ import annotations

import hashlib
import os
from typing import TYPE_CHECKING

from slamhive.jobs.listing import Listing
from slamhive.jobs.opening import opened
from slamhive.model.errors import DataError
from slamhive.storage.offloaded import NOTE, NOTE_BYTES, Offloaded, StoredFile, folder_of, look_up
from slamhive.storage.store import PART_BYTES, StorageUnavailable

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from slamhive.storage.store import ObjectStorage

MOST_FILES = 200_000
_MOST_BYTES = 1 << 50
_LONGEST_PATH = 1024


def copy_folder(results: Path, uid: str, store: ObjectStorage) -> Offloaded:
    """Have a run's folder in a store, whole, and return what is there.

    Args:
        results: the results volume.
        uid: the run.
        store: where it goes.

    Raises:
        DataError: it holds what can't be copied, so that it stays where it is.
        StorageUnavailable: the store does not take it.
    """
    files, left = _files(results, uid)
    try:
        before = look_up(store, uid)
    except DataError:  # not what was written there: written anew
        before = None
    if before is not None and {file.path: (file.size, file.sha256) for file in before.files} == {
        file.path: (file.size, file.sha256) for file in (_described(results, uid, path) for path in files)
    }:
        return before
    made = Offloaded(uid=uid, files=[_copied(results, uid, path, store) for path in files], left=left)
    _confirm(store, made)
    return made


def _files(results: Path, uid: str) -> tuple[list[str], list[tuple[str, str]]]:
    found = Listing(MOST_FILES)
    try:
        found.look(results, folder_of(uid))
    except OSError as error:
        raise DataError(f"{folder_of(uid)}: {error.strerror}") from None
    for path in found.files:
        if len(path) > _LONGEST_PATH:
            found.leave(path[:_LONGEST_PATH], f"its path has more than {_LONGEST_PATH} characters")
        elif path == NOTE:
            found.leave(path, "has the name of the note that is written beside it")
    if found.lost:
        told = "; ".join(f"{path}: {why}" for path, why in found.left[:3])
        raise DataError(f"{folder_of(uid)} stays on the volume, as not all of it can be copied: {told}")
    return found.files, found.left


def _described(results: Path, uid: str, path: str) -> StoredFile:
    """Return a file's size and checksum, read once."""
    with opened(results, f"{folder_of(uid)}/{path}", _MOST_BYTES) as descriptor:
        reading = _FileReading(descriptor, path)
        for _ in reading.pieces():
            pass
        return reading.file()


def _copied(results: Path, uid: str, path: str, store: ObjectStorage) -> StoredFile:
    # Where the object is named by the sum, that has to be known first.
    before = _described(results, uid, path) if StoredFile.needs_sum(path) else None
    with opened(results, f"{folder_of(uid)}/{path}", _MOST_BYTES) as descriptor:
        reading = _FileReading(descriptor, path)
        store.write(f"{folder_of(uid)}/{before.object if before else path}", reading.pieces())
        file = reading.file()
    if before is not None and before != file:
        raise DataError(f"{folder_of(uid)}/{path} changed while it was copied")
    return file


class _FileReading:
    """A file that is read once, and what it was then.

    Args:
        descriptor: the file.
        path: its path below the run's folder.
    """

    def __init__(self, descriptor: int, path: str) -> None:
        self._descriptor = descriptor
        self._path = path
        self._digest = hashlib.sha256()
        self._before = os.fstat(descriptor)
        self._size = 0

    def pieces(self) -> Iterator[bytes]:
        with os.fdopen(os.dup(self._descriptor), "rb", buffering=0) as stream:
            while data := stream.read(PART_BYTES):
                self._digest.update(data)
                self._size += len(data)
                yield data

    def file(self) -> StoredFile:
        """Return the file as it was read.

        Raises:
            DataError: somebody wrote to it meanwhile.
        """
        now = os.fstat(self._descriptor)
        if (now.st_size, now.st_mtime_ns) != (self._size, self._before.st_mtime_ns):
            raise DataError(f"{self._path} changed while it was copied")
        return StoredFile(
            path=self._path, size=self._size, sha256=self._digest.hexdigest(), modified=now.st_mtime
        )


def _confirm(store: ObjectStorage, made: Offloaded) -> None:
    """Write the note behind its files, after a look at them, and read it back."""
    place = folder_of(made.uid)
    sizes = store.sizes(place)
    for file in made.files:
        if sizes.get(file.object) != file.size:
            raise StorageUnavailable(
                f"storage {store.url}: {place}/{file.object} has {sizes.get(file.object)} bytes, "
                f"{file.size} were written"
            )
    text = made.text()
    if len(text) > NOTE_BYTES:
        raise DataError(f"{place} stays on the volume: its {len(made.files)} files have too long names")
    store.write(f"{place}/{NOTE}", [text[at : at + PART_BYTES] for at in range(0, len(text), PART_BYTES)])
    if store.read(f"{place}/{NOTE}", 0, len(text) + 1) != text:
        raise StorageUnavailable(f"storage {store.url}: {place}/{NOTE} is not what was written")
