# SPDX-License-Identifier: Apache-2.0
"""Files of runs that lie in object storage: brought to this machine once, then read like all others.

Workers that compute answers are forked and can't ask a store. What they read is brought before.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import SlamHiveError
from slamhive.runfiles.artifacts import MAX_FILES, ArtifactFolder, split
from slamhive.runfiles.errors import FileAwayError, FileMissingError, FileTooLargeError
from slamhive.storage.reading import Bucket, Cache

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from slamhive.storage.offloaded import Offloaded, StoredFile
    from slamhive.storage.store import ObjectStorage

_AT_ONCE = 8


class Shelf:
    """Run folders in object storage, and the files of them that are here.

    Args:
        store: where they are.
        cache: folder for files.
        limit: bytes that those may have.
    """

    def __init__(self, store: ObjectStorage, cache: Path, limit: int) -> None:
        self.url = store.url
        self.bucket = Bucket(store)
        self.cache = Cache(cache, limit)
        self.folder = cache
        self._process = os.getpid()

    @property
    def is_at_hand(self) -> bool:
        """Tell whether the store may be asked: not in a process that was forked off."""
        return os.getpid() == self._process

    def place(self, parts: tuple[str, ...]) -> StoredPlace | None:
        """Return the folder of a run by its way on the results volume; None where it is not in the store.

        Raises:
            FileAwayError: the store doesn't say.
        """
        _, uid, *rest = parts
        try:
            found = self.bucket.run(uid)
        except SlamHiveError as error:
            raise FileAwayError(str(error)) from error
        if found is None:
            return None
        return StoredPlace(self.folder, parts, shelf=self, run=found, below="/".join(rest))


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredPlace(ArtifactFolder):
    """A run's folder in object storage.

    Attributes:
        shelf: where it is.
        run: what is there of the run.
        below: the folder's way from the run's.
    """

    shelf: Shelf
    run: Offloaded
    below: str

    def files(self) -> list[dict[str, Any]]:
        """Return the files below it, sorted, at most 1,000."""
        found = [
            {
                "path": path,
                "size": file.size,
                "modified": datetime.fromtimestamp(file.modified, UTC).isoformat(),
            }
            for path, file in self._files()
        ]
        return sorted(found, key=lambda item: str(item["path"]))[:MAX_FILES]

    @contextmanager
    def open(self, path: str) -> Iterator[int]:
        """Open a file that is here, or bring it first; errors as of `ArtifactFolder.open`.

        Raises:
            FileAwayError: the store doesn't give it, or not as it was written.
        """
        split(path)
        file = dict(self._files()).get(path)
        if file is None:
            raise FileMissingError(f"there is no file {path[:200]!r} of the run here", "path")
        descriptor = os.open(self._bring(file), os.O_RDONLY | os.O_CLOEXEC)
        try:
            yield descriptor
        finally:
            os.close(descriptor)

    def bring(self, names: Iterable[str]) -> None:
        """Have files here, those of the names that there are; one that is too large is left out.

        Raises:
            FileAwayError: the store doesn't give one, or not as it was written.
        """
        files = dict(self._files())
        wanted = [
            files[name] for name in names if name in files and files[name].size <= self.shelf.cache.limit
        ]
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            for _ in pool.map(self._bring, wanted):
                pass

    def _files(self) -> Iterator[tuple[str, StoredFile]]:
        prefix = f"{self.below}/"
        for file in self.run.files:
            if file.path.startswith(prefix):
                yield file.path.removeprefix(prefix), file

    def _bring(self, file: StoredFile) -> Path:
        cache = self.shelf.cache
        if file.size > cache.limit:
            name = file.path.removeprefix(f"{self.below}/")
            raise FileTooLargeError(
                f"{name}: {file.size / 2**20:.0f} MiB lie in object storage, and files of at most "
                f"{cache.limit / 2**20:.0f} MiB are brought here: slamhive fetch --files has it",
                "path",
            )
        found = cache.held(file)
        if found is not None:
            return found
        if not self.shelf.is_at_hand:
            raise FileAwayError(f"{file.path} lies in object storage and is not here: try again")
        try:
            return cache.bring(self.shelf.bucket, self.run.uid, file)
        except (SlamHiveError, OSError) as error:
            raise FileAwayError(str(error)) from error


def bring_all(places: Mapping[str, ArtifactFolder], names: tuple[str, ...]) -> dict[str, FileAwayError]:
    """Have files of several runs here, some at a time.

    Args:
        places: folders of the runs, by UID.
        names: paths of the files.

    Returns:
        What went wrong, by UID.
    """
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        told = pool.map(partial(_tried, names=names), places.values())
        return {uid: error for uid, error in zip(places, told, strict=True) if error is not None}


def _tried(place: ArtifactFolder, names: tuple[str, ...]) -> FileAwayError | None:
    try:
        place.bring(names)
    except FileAwayError as error:
        return error
    return None
