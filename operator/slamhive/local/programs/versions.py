# SPDX-License-Identifier: Apache-2.0
"""Notes of what each version of a program was made of, so that a later one can say which file changed.

One small file a version in the home, ``versions/DIGEST.json``: names and checksums, no contents. Where one is
missing, a sentence says "its program" instead of the file's name; nothing else depends on them.
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.contract.files import read_regular

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from slamhive.local.programs.environments import ProgramPart

_DIGITS = 32
_LIMIT = 1 << 20


class Versions:
    """The notes of a home.

    Args:
        folder: where they are.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def keep(self, digest: str, parts: Iterable[ProgramPart]) -> None:
        """Note what a version is made of, unless that is noted; a disk that refuses costs a name later."""
        path = self._path(digest)
        if path.exists():
            return
        # Runners may note the same version at once: each writes its own file, and either may be the one that
        # stays.
        aside = path.with_suffix(f".{os.getpid()}")
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            try:
                aside.write_text(json.dumps({part.name: part.value for part in parts}), encoding="utf-8")
                aside.replace(path)
            finally:
                aside.unlink(missing_ok=True)

    def parts(self, digest: str | None) -> dict[str, str] | None:
        """Return the parts of a version, by name; None where nobody noted them."""
        if digest is None:
            return None
        try:
            found = json.loads(read_regular(str(self._path(digest)), _LIMIT))
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) else None

    def changed(self, before: str | None, after: str | None) -> list[str]:
        """Return the names of the parts that two versions differ in; none where that isn't known."""
        old, new = self.parts(before), self.parts(after)
        if old is None or new is None:
            return []
        return [name for name in dict.fromkeys((*old, *new)) if old.get(name) != new.get(name)]

    def _path(self, digest: str) -> Path:
        return self._folder / f"{digest.removeprefix('sha256:')[:_DIGITS]}.json"
