# SPDX-License-Identifier: Apache-2.0
"""Note of what of a run lies in object storage, written last, so that what it names is there.

::

    runs/UID/POD/output/trajectory.txt     one object a file, under the same name
    runs/UID/by-sum/SHA256                 a file whose name is none that every store takes
    runs/UID/offloaded.json                names, sizes and checksums of all of them
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field, ValidationError

from slamhive.model.base import Model, RelativePath, Sha256
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from slamhive.storage.store import ObjectStorage

NOTE = "offloaded.json"
NOTE_BYTES = 64 << 20

_BY_SUM = "by-sum"
_PLAIN = re.compile(r"[A-Za-z0-9._+=@,-][A-Za-z0-9._+=@, /-]*")
_PLAIN_LENGTH = 700


def _without_nul(path: str) -> str:
    if "\0" in path:
        raise ValueError("expected a path without a NUL character")
    return path


class StoredFile(Model):
    """A file of a run in object storage.

    Attributes:
        path: its path below ``runs/UID/``.
        size: its size in bytes.
        sha256: the checksum of all of it.
        modified: when it was written, seconds since 1970.
    """

    path: Annotated[RelativePath, AfterValidator(_without_nul)]
    size: int = Field(ge=0)
    sha256: Sha256
    modified: float = 0.0

    @property
    def object(self) -> str:
        """Return the name of its object below ``runs/UID/``: its path where every store takes that."""
        return f"{_BY_SUM}/{self.sha256}" if self.needs_sum(self.path) else self.path

    @staticmethod
    def needs_sum(path: str) -> bool:
        """Tell whether a path can't be an object's name everywhere: algorithms choose them."""
        # Some stores take no line break, none takes a kilobyte.
        return len(path) > _PLAIN_LENGTH or _PLAIN.fullmatch(path) is None


class Offloaded(Model):
    """Contents of a run's folder in object storage.

    Attributes:
        v: version of the form.
        uid: the run.
        files: its regular files, by path.
        left: what was no regular file, and why it was left out.
    """

    v: Literal[1] = 1
    uid: str
    files: list[StoredFile]
    left: list[tuple[str, str]] = Field(default_factory=list)

    def text(self) -> bytes:
        """Return it as it is written."""
        return self.model_dump_json(by_alias=True).encode()


def folder_of(uid: str) -> str:
    """Return the path of a run's files, on the volume as in the store."""
    return f"runs/{uid}"


def look_up(store: ObjectStorage, uid: str) -> Offloaded | None:
    """Return the files of a run in a store; None where it was not, or not wholly, moved there.

    Raises:
        StorageUnavailable: the store doesn't say.
        DataError: what it says can't be read.
    """
    name = f"{folder_of(uid)}/{NOTE}"
    try:
        # A range is one request; for a whole object some clients ask for its size first.
        text = store.read(name, 0, NOTE_BYTES + 1)
    except FileNotFoundError:
        return None
    try:
        found = Offloaded.model_validate_json(text)
    except ValidationError:
        found = None
    if found is None or found.uid != uid or len(text) > NOTE_BYTES:
        raise DataError(f"storage {store.url}: {name} is not what was written there")
    return found
