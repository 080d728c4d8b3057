# SPDX-License-Identifier: Apache-2.0
"""Files of runs in object storage, read by ranges, checked by their sums, and kept for a while."""

from __future__ import annotations

import hashlib
import os
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.model.errors import DataError, InputError
from slamhive.storage.offloaded import folder_of, look_up
from slamhive.storage.store import StorageUnavailable

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from slamhive.storage.offloaded import Offloaded, StoredFile
    from slamhive.storage.store import ObjectStorage

_ABSENT_SECONDS = 30.0
_KNOWN_SECONDS = 600.0
_MOST_KNOWN = 50_000
"""Files, and runs, that are remembered: some 50 MB."""
_AWAY_SECONDS = 10.0
_LOCKS = 16


class Bucket:
    """Run folders in a store, for readers.

    Args:
        store: where they are.
    """

    def __init__(self, store: ObjectStorage) -> None:
        self._store = store
        self._known: dict[str, tuple[float, Offloaded | None]] = {}
        self._away: tuple[float, str] | None = None
        self._lock = threading.Lock()

    def run(self, uid: str) -> Offloaded | None:
        """Return the files of a run in the store; None where it was not moved there. It is asked rarely.

        Raises:
            StorageUnavailable: the store doesn't say.
            DataError: what it says can't be read.
        """
        now = time.monotonic()
        with self._lock:
            until, found = self._known.get(uid, (0.0, None))
        if now < until:
            return found
        self._refuse_while_away(now)
        try:
            found = look_up(self._store, uid)
        except StorageUnavailable as error:
            self._note(error)
            raise
        with self._lock:
            self._known.pop(uid, None)
            while self._known and _weight(*self._known.values()) + _weight((0.0, found)) > _MOST_KNOWN:
                self._known.pop(next(iter(self._known)))
            self._known[uid] = now + (_ABSENT_SECONDS if found is None else _KNOWN_SECONDS), found
        return found

    def pieces(self, uid: str, file: StoredFile, begin: int = 0) -> Iterator[bytes]:
        """Read a file from a byte on: exactly as many bytes as the note says, or an error.

        Raises:
            DataError: it is not what was written, which is known at its end, and only if all of it was read.
            StorageUnavailable: it can't be had.
        """
        name = f"{folder_of(uid)}/{file.object}"
        digest, size = hashlib.sha256(), begin
        self._refuse_while_away(time.monotonic())
        try:
            for data in self._store.pieces(name, begin, file.size):
                digest.update(data)
                size += len(data)
                yield data
        except FileNotFoundError:
            raise DataError(f"storage {self._store.url}: {name} is gone") from None
        except StorageUnavailable as error:
            self._note(error)
            raise
        if size != file.size or (begin == 0 and digest.hexdigest() != file.sha256):
            raise DataError(
                f"storage {self._store.url}: {name} was changed: its checksum is not the one that was "
                "written when it was moved there"
            )

    def _note(self, error: StorageUnavailable) -> None:
        if not error.answered:
            self._away = time.monotonic() + _AWAY_SECONDS, str(error)

    def _refuse_while_away(self, now: float) -> None:
        # A page asks for several files: one wait for a store that is away is enough.
        away = self._away
        if away is not None and now < away[0]:
            raise StorageUnavailable(away[1])


def _weight(*known: tuple[float, Offloaded | None]) -> int:
    return sum(1 if found is None else 1 + len(found.files) for _, found in known)


class Cache:
    """Files on this machine by their checksums, the longest unused of which go.

    Args:
        folder: where they are; nobody else writes there.
        limit: bytes that all of them may have.
    """

    def __init__(self, folder: Path, limit: int) -> None:
        self._folder = folder
        self.limit = limit
        self._locks = [threading.Lock() for _ in range(_LOCKS)]
        self._room = threading.Lock()

    def held(self, file: StoredFile) -> Path | None:
        """Return the path of a file here, None where it is not here."""
        path = self._folder / file.sha256
        try:
            os.utime(path)
        except OSError:
            return None
        return path

    def bring(self, bucket: Bucket, uid: str, file: StoredFile) -> Path:
        """Have a file here, whole and checked.

        Raises:
            DataError: it is not what was written.
            InputError: it is larger than the cache.
            StorageUnavailable: it can't be had.
            OSError: the disk refuses.
        """
        if file.size > self.limit:
            raise InputError(
                f"{file.path}: {file.size / 2**20:.0f} MiB lie in object storage, of which files up to "
                f"{self.limit / 2**20:.0f} MiB are shown here: slamhive fetch --files brings it"
            )
        with self._locks[int(file.sha256[:8], 16) % _LOCKS]:
            found = self.held(file)
            if found is not None:
                return found
            self._folder.mkdir(parents=True, exist_ok=True)
            with self._room:
                self._make_room(file.size)
            target = self._folder / file.sha256
            aside = self._folder / f".{file.sha256}.{os.urandom(4).hex()}"
            try:
                with aside.open("wb") as stream:
                    for data in bucket.pieces(uid, file):
                        stream.write(data)
                aside.replace(target)
            finally:
                aside.unlink(missing_ok=True)
            return target

    def _make_room(self, size: int) -> None:
        held = []
        for path in self._folder.iterdir():
            with suppress(OSError):
                status = path.stat()
                held.append((status.st_mtime, status.st_size, path))
        used = sum(one for _, one, _ in held)
        for _, one, path in sorted(held):
            if used + size <= self.limit:
                return
            path.unlink(missing_ok=True)
            used -= one
