# SPDX-License-Identifier: Apache-2.0
"""Zip file of a bundle: its members are read where they lie, within bounds, and hashed as they come."""

from __future__ import annotations

import hashlib
import zipfile
from contextlib import ExitStack, contextmanager
from math import inf
from typing import IO, TYPE_CHECKING

from slamhive.bridges.bundles.contents import MEASURED, run_file
from slamhive.contract.lines import LIMIT_BYTES, printable
from slamhive.data.files.unpacking import (
    ARCHIVE_DAMAGES,
    DIRECTORY_BYTES,
    GROWS_BOUNDED,
    DamagedArchiveError,
    MeteredFile,
    checked_name,
    growth_problem,
    is_in,
    most_bytes,
)
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_BLOCK = 1 << 20


class BundleFile(ExitStack):
    """The file of a bundle, to be closed.

    A name that leads outside, a member that was packed in a way whose growth Python can't bound, and more
    than an archive of data grows to are refused before anything is read.

    Args:
        path: the file.

    Attributes:
        title: its name.
        names: those of its members.

    Raises:
        DataError: it is damaged, or no zip file, or holds what none of data holds.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.title = path, path.name
        with self._damages(), ExitStack() as held:
            source = MeteredFile(held.enter_context(path.open("rb")), DIRECTORY_BYTES)
            self._zip = held.enter_context(zipfile.ZipFile(source))
            source.left = inf
            infos = [info for info in self._zip.infolist() if not info.is_dir()]
            self._members = {checked_name(info.filename, self.title): info for info in infos}
            self._require_bounds()
            self.push(held.pop_all())
        self.names = {name for name in self._members if is_in(name, "")}

    def _require_bounds(self) -> None:
        for name, info in self._members.items():
            if info.flag_bits & 1 or info.compress_type not in GROWS_BOUNDED:
                raise DataError(f"{self.title}: {name}: is encrypted or packed in a rare way: refused")
            if info.file_size > LIMIT_BYTES:
                raise DataError(f"{self.title}: {name}: is larger than {LIMIT_BYTES >> 20} MiB: refused")
        limit = most_bytes(self.path)
        # No more is read of a member than it says here.
        if sum(info.file_size for info in self._members.values()) > limit:
            raise DataError(growth_problem(self.title, limit))

    def read(self, name: str, limit: int) -> bytes:
        """Return a member's content.

        Raises:
            DataError: it isn't there, is damaged, or has more bytes than the limit.
        """
        if name not in self.names:
            raise DataError(f"{self.title}: lacks {name}")
        size = self._members[name].file_size
        if size > limit:
            raise DataError(f"{self.title}: {name}: is larger than {limit >> 20} MiB")
        with self._damages(name), self._zip.open(self._members[name]) as source:
            return source.read(size)

    def copy(self, name: str, out: IO[bytes] | None = None) -> str:
        """Write a member's content to a file, if there is one, and return its SHA-256.

        Raises:
            DataError: it is damaged.
        """
        found = hashlib.sha256()
        with self._damages(name), self._zip.open(self._members[name]) as source:
            while block := source.read(_BLOCK):
                found.update(block)
                if out is not None:
                    out.write(block)
        return found.hexdigest()

    def names_of(self, run: str) -> list[str]:
        """Return the names of the files that a run's figures come from, as far as there are any."""
        return [name for name in MEASURED if run_file(run, name) in self.names]

    def place_run(self, run: str, folder: Path) -> None:
        """Write the files that a run's figures come from into a folder.

        Raises:
            DataError: one is damaged.
            OSError: the disk refuses.
        """
        for name in self.names_of(run):
            with (folder / name).open("wb") as out:
                self.copy(run_file(run, name), out)

    @contextmanager
    def _damages(self, name: str = "") -> Iterator[None]:
        try:
            yield
        # Of what the library doesn't know it says RuntimeError too.
        except (*ARCHIVE_DAMAGES, RuntimeError) as error:
            where = f"{name}: " if name else ""
            raise DamagedArchiveError(
                f"{self.title}: is damaged, or no zip file: {where}{printable(str(error))}"
            ) from None
