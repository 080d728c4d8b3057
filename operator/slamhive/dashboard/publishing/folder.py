# SPDX-License-Identifier: Apache-2.0
"""Folder of a site: files called by their content, which stay for good, and few that change.

::

    index.html, site.json     which pages and which index are shown: all that an update rewrites,
    feed.xml, badges/         beside the feed and the badges
    pages/HASH/               the pages' code, a folder a version
    data/HA/HASH.json.gz      answers, columns of the table, runs; the index that names them
"""

from __future__ import annotations

import gzip
import hashlib
import json
from typing import TYPE_CHECKING, Any

from slamhive.dashboard.answering.encoding import encode_json
from slamhive.data.files.outputs import output_whole
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

KIND = "slamhive-site"
FORMAT = 1
MARK = "site.json"
FOLDERS = ("data", "pages")
"""Folders of files that never change."""

_MOST_MARK = 1 << 20
_LEVEL = 6
_DIGITS = 20


class SiteFolder:
    """Folder that a site is written to.

    Attributes:
        path: the folder.
        before: what MARK said before; {} for a new site, and for one that was never completed.
        written: files and bytes that were added.

    Args:
        path: it is made where there is none.

    Raises:
        InputError: it holds something else, or can't be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.before = _mark_of(path)
        self.written = [0, 0]
        self._there: set[str] = set()

    def begin(self) -> None:
        """Write the mark of a site that isn't complete, so that the next update knows the folder for one."""
        if not self.before:
            self.replace(MARK, encode_json({"kind": KIND, "format": FORMAT}))

    def keep(self, content: Any) -> str:
        """Keep an answer as a packed file called by its content, and return what it is called."""
        return self.keep_text(encode_json(content))

    def keep_text(self, content: bytes) -> str:
        """Keep the bytes of a text in the same way."""
        name = hashlib.sha256(content).hexdigest()[:_DIGITS]
        if name not in self._there:
            self._there.add(name)
            place = self.place(name)
            if not place.exists():
                self._add(place, gzip.compress(content, _LEVEL, mtime=0))
        return name

    def place(self, name: str) -> Path:
        """Return the file of a name that ``keep`` gave."""
        return self.path / "data" / name[:2] / f"{name}.json.gz"

    def read(self, name: str) -> Any:
        """Return the answer that was kept under a name.

        Raises:
            InputError: it is not there any more, or was changed.
        """
        place = self.place(name)
        try:
            return json.loads(gzip.decompress(place.read_bytes()))
        except (OSError, EOFError, ValueError) as error:
            raise InputError(
                f"{place}: a file of this site can't be read: {error}: put it back, or name a new folder"
            ) from None

    def keep_file(self, name: str, content: bytes) -> None:
        """Keep a file under a name that has its content's hash in it."""
        place = self.path / name
        if not place.exists():
            self._add(place, content)

    def bytes_of(self, name: str) -> bytes:
        """Return a file that updates change; nothing where it isn't there yet."""
        place = self.path / name
        return place.read_bytes() if place.exists() else b""

    def replace(self, name: str, content: bytes) -> None:
        """Write a file that updates change, where it differs."""
        if self.bytes_of(name) != content:
            self._add(self.path / name, content)

    def _add(self, place: Path, content: bytes) -> None:
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{place.parent}: {error.strerror}") from None
        with output_whole(place, "") as aside:
            aside.write_bytes(content)
        self.count(1, len(content))

    def count(self, files: int, size: int) -> None:
        """Count files that were added, with their bytes; another process may have added them."""
        self.written[0] += files
        self.written[1] += size

    def kept(self) -> list[int | str]:
        """Return the signs of a folder as an update left it, for the mark; the number of files first."""
        found = hashlib.sha256()
        for name in ("index.html", "feed.xml", *sorted((self.path / "badges").rglob("*.svg"))):
            found.update(self.bytes_of(str(name)))
        return [*self.size(*FOLDERS), found.hexdigest()]

    def size(self, *folders: str) -> tuple[int, int]:
        """Return the number of files in some folders of it and their bytes; of all where none is named."""
        names = folders or ("",)
        places = [place for name in names for place in (self.path / name).rglob("*") if place.is_file()]
        return len(places), sum(place.stat().st_size for place in places)


def _mark_of(path: Path) -> dict[str, Any]:
    """Return the mark of a site, {} where there is nothing yet.

    Raises:
        InputError: there is something else.
    """
    other = f"{path} holds something else than a site of slamhive: name an empty folder or a new one"
    try:
        if not path.exists() or (path.is_dir() and not any(path.iterdir())):
            return {}
        if not path.is_dir():
            raise InputError(f"{path} is no folder")
        mark = path / MARK
        if not mark.is_file():
            raise InputError(f"{other} (no {MARK} in it)")
        if mark.stat().st_size > _MOST_MARK:
            raise InputError(f"{other} ({MARK} is too large)")
        found = json.loads(mark.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except ValueError:
        raise InputError(f"{other} ({MARK} is no JSON)") from None
    if not isinstance(found, dict) or found.get("kind") != KIND:
        raise InputError(f"{other} ({MARK} is another program's)")
    if found.get("format") != FORMAT:
        raise InputError(
            f"{path} is a site in format {found.get('format')!r}, and this slamhive writes {FORMAT}"
        )
    return found if "index" in found else {}
