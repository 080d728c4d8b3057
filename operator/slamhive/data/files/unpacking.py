# SPDX-License-Identifier: Apache-2.0
"""Unpacking of archives that strangers made: what is wanted of them alone, and never outside of a folder.

Zip and tar, compressed or not, and archives in archives. 7z is read by ``bsdtar`` (libarchive), where that is
installed. Nothing that a member says of itself is believed: bytes are counted as they come, links become
copies of what they lead to, or are refused.
"""

from __future__ import annotations

import errno
import gzip
import lzma
import os
import shutil
import stat
import subprocess
import tarfile
import tempfile
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from math import inf
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Any, NamedTuple, NoReturn

from slamhive.contract.lines import printable
from slamhive.data.files.fetching import LEFT_BYTES
from slamhive.data.files.partial import disk_words
from slamhive.model.errors import DataError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

MOST_FILES = 2_000_000
"""Files of the largest sequence that is unpacked."""
MOST_RATIO = 200
"""Most times its size that an archive may grow to; images and clouds grow to a few times theirs."""
FREE_BYTES = 64 << 20
"""Bytes that any archive may grow to."""
_BLOCK = 1 << 20
GROWS_BOUNDED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Packings of a zip's members of which Python unpacks no more at a time than is asked for.

40 bytes of bzip2 may be 45 MB, and are unpacked at once.
"""
_HEADER_BYTES = 1 << 20
"""Bytes that all headers of a member of a tar may take together."""
DIRECTORY_BYTES = 128 << 20
"""Bytes that the directory of a zip may take: that of a million files."""
_NAME_LENGTH = 4096
_DEPTH = 64
"""Folders of a path, each of which may be what a link leads to."""
_COPY_BYTES = 4096
"""Bytes that a link's copy counts at least: a few links to folders of links are millions of small files."""
_OF_NAMES = {errno.ENAMETOOLONG, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.EINVAL, errno.EILSEQ}
"""Errors of a disk at a member's name or place, and no fault of the disk."""
_SHOWN = 5
_MAGIC_ZIP = b"PK\x03\x04"
_MAGIC_7Z = b"7z\xbc\xaf\x27\x1c"
_PASSED_OVER = ("__MACOSX", ".DS_Store")


ARCHIVE_DAMAGES = (
    *(zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, EOFError),
    *(NotImplementedError, ValueError, RecursionError, MemoryError),
)
"""Errors of the libraries at an archive that they can't read."""


class DamagedArchiveError(DataError):
    """An archive that is broken: fetched again it may be whole."""


class MeteredFile:
    """An opened archive of which no more is read than is left: libraries hold headers of any length.

    Attributes:
        left: Bytes that may be read.
    """

    def __init__(self, file: IO[bytes], left: float) -> None:
        self._file, self.left = file, left

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def read(self, size: int = -1) -> bytes:
        """Return so many bytes; a ValueError where they are more than are left."""
        if size > self.left:
            raise ValueError("its headers take more memory than those of an archive of data")
        data = self._file.read(size)
        self.left -= len(data)
        return data


class _Tar(tarfile.TarFile):
    """A tar whose headers are bounded, of which nothing is kept of a member that is over.

    Args:
        name, mode, fileobj: As its base has them.
        most: Bytes that all of it may unpack to.
    """

    def __init__(self, name: Any, mode: Any, fileobj: IO[bytes], *, most: int) -> None:
        self._source, self._most = MeteredFile(fileobj, 0), most
        super().__init__(name, mode, self._source)

    def next(self) -> tarfile.TarInfo | None:
        if self.offset > self._most:
            raise ValueError(f"it grows to more than {self._most >> 20} MiB, {MOST_RATIO} times its size")
        self._source.left = _HEADER_BYTES
        try:
            return super().next()
        finally:
            self._source.left = inf
            self.members.clear()  # type: ignore[attr-defined]
            self.pax_headers = {}


@dataclass
class _Unpacking:
    """One unpacking: where to, how much so far, whom to tell.

    Attributes:
        out: The folder.
        limit: Bytes that may come.
        progress: Called with the bytes that have come.
        links: What each link leads to, by its name.
    """

    out: Path
    limit: int
    progress: Callable[[int], None]
    written: int = 0
    files: int = 0
    links: dict[str, str] = field(default_factory=dict)


def unpack(
    archive: Path,
    wanted: Sequence[str],
    out: Path,
    progress: Callable[[int], None] = lambda _: None,
    *,
    title: str | None = None,
) -> None:
    """Unpack what is wanted of an archive.

    Args:
        archive: The file.
        wanted: Members: a file, or a folder with all in it; `a/b.zip!c` is the member c of the archive
            a/b.zip inside. An empty name is all of an archive.
        out: The folder that they go to, under the names that they have in the innermost archive.
        progress: Called with the bytes that are unpacked so far, now and then.
        title: What it is, for messages; None: its name.

    Raises:
        DataError: It is damaged, holds not what is wanted, or what no archive of data holds: names outside of
            its folder, devices, much more than its size.
        SystemFault: The disk refuses, or a program for such archives is not installed.
    """
    out.mkdir(parents=True, exist_ok=True)
    room = shutil.disk_usage(out).free - LEFT_BYTES
    limit = min(most_bytes(archive), max(room, 0))
    work = _Unpacking(out, limit, progress)
    title = title or archive.name
    with disk_words(title, out):
        _unpack(archive, title, [name.split("!") for name in wanted], work)
        _follow_links(title, work)


def most_bytes(archive: Path) -> int:
    """Return the bytes that an archive may grow to."""
    known = archive.stat()
    # Of its space on the disk: one that was fetched in parts has holes.
    return max(FREE_BYTES, MOST_RATIO * min(known.st_size, known.st_blocks * 512))


def _unpack(archive: Path, title: str, wanted: Iterable[Sequence[str]], work: _Unpacking) -> None:
    """Unpack members; archives among them are unpacked in turn, one at a time."""
    here = [names[0] for names in wanted if len(names) == 1]
    inner: dict[str, list[Sequence[str]]] = {}
    for names in wanted:
        if len(names) > 1:
            inner.setdefault(names[0], []).append(names[1:])
    missing = {*here, *inner}
    seen: dict[str, None] = {}
    try:
        with _opened(archive, title) as members:
            for member in members:
                name = checked_name(member.name, title)
                if len(seen) <= _SHOWN:
                    seen.setdefault("/".join(PurePosixPath(name).parts[:2]))
                if name in inner:
                    if member.kind != "file":
                        _refuse_kind(member, title)
                    nested = tempfile.TemporaryDirectory(prefix=".nested-", dir=work.out)
                    with _named(name, title), nested as folder:
                        aside = Path(folder) / PurePosixPath(name).name
                        _write(member, title, aside, work)
                        _unpack(aside, f"{title}: {name}", inner[name], work)
                    missing.discard(name)
                matching = next((prefix for prefix in here if is_in(name, prefix)), None)
                if matching is not None:
                    missing.discard(matching)
                    with _named(name, title):
                        _place(member, name, title, work)
    except ARCHIVE_DAMAGES as error:
        raise DamagedArchiveError(f"{title}: {_damage(archive, error)}") from None
    if missing:
        some = printable(", ".join(list(seen)[:_SHOWN])) + (", …" if len(seen) > _SHOWN else "")
        names = ", ".join(sorted(missing)) or "file"
        raise DataError(f"{title}: has no {names}; it has: {some or 'nothing'}")


def _damage(archive: Path, error: Exception) -> str:
    """Say in one line what is wrong with an archive that can't be read."""
    with archive.open("rb") as file:
        begin = file.read(len(_MAGIC_ZIP))
    if begin == _MAGIC_ZIP and not zipfile.is_zipfile(archive):
        return "is a zip archive whose end is missing"
    if isinstance(error, tarfile.ReadError) and "\n" in str(error):
        return "is damaged, or no archive: none of zip, tar, tgz, tar.bz2, tar.xz, 7z"
    return f"is damaged, or no archive that can be read: {printable(str(error)) or type(error).__name__}"


class ArchiveMember(NamedTuple):
    """A member of an archive, as it says of itself.

    Attributes:
        name: Its path.
        kind: "file", "folder", "link", or anything else, which is refused.
        open: Opens its content.
        linked: What a link leads to, from its own folder; from the archive's with a leading slash.
    """

    name: str
    kind: str
    open: Callable[[], IO[bytes]]
    linked: str = ""


@contextmanager
def _opened(archive: Path, title: str) -> Iterator[Iterator[ArchiveMember]]:
    """Yield the members of an archive, in its order."""
    with archive.open("rb") as file:
        begin = file.read(len(_MAGIC_7Z))
    if begin == _MAGIC_7Z:
        with _by_bsdtar(archive, title) as members:
            yield members
    elif zipfile.is_zipfile(archive):
        with archive.open("rb") as file:
            source = MeteredFile(file, DIRECTORY_BYTES)
            with zipfile.ZipFile(source) as opened:
                source.left = inf
                yield (_of_zip(opened, info) for info in opened.infolist())
    else:
        with archive.open("rb") as file, _tar("r:*", file, archive) as tar:
            yield (_of_tar(tar, info) for info in tar)


@contextmanager
def _by_bsdtar(archive: Path, title: str) -> Iterator[Iterator[ArchiveMember]]:
    program = shutil.which("bsdtar")
    if program is None:
        raise SystemFault(
            f"{title}: a 7z archive is read by bsdtar, which is missing: apt-get install libarchive-tools"
        )
    with subprocess.Popen(
        [program, "--format=pax", "-cf", "-", f"@{archive}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as process:
        try:
            with _tar("r|", process.stdout, archive) as tar:
                yield (_of_tar(tar, info) for info in tar)
        finally:
            process.kill()


def _tar(mode: str, file: Any, archive: Path) -> tarfile.TarFile:
    found: tarfile.TarFile = _Tar.open(None, mode, file, most=most_bytes(archive))  # type: ignore[call-overload]
    return found


def _of_zip(opened: zipfile.ZipFile, info: zipfile.ZipInfo) -> ArchiveMember:
    mode = info.external_attr >> 16
    if info.flag_bits & 1:
        return ArchiveMember(info.filename, "encrypted file", lambda: opened.open(info))
    if info.compress_type not in GROWS_BOUNDED:
        rare = "file packed in a rare way, which may grow without bounds (pack it as zip -r or tar do)"
        return ArchiveMember(info.filename, rare, lambda: opened.open(info))
    if stat.S_ISLNK(mode):
        linked = opened.read(info)[:4096].decode("utf-8", "replace") if info.file_size <= 4096 else "/"
        return ArchiveMember(info.filename, "link", lambda: opened.open(info), linked)
    kind = "folder" if info.filename.endswith("/") else "file"
    return ArchiveMember(info.filename, kind, lambda: opened.open(info))


def _of_tar(tar: tarfile.TarFile, info: tarfile.TarInfo) -> ArchiveMember:
    def content() -> IO[bytes]:
        opened = tar.extractfile(info)
        if opened is None:
            raise tarfile.ReadError(f"{info.name} can't be read")
        return opened

    if info.isfile():
        return ArchiveMember(info.name, "file", content)
    if info.isdir():
        return ArchiveMember(info.name, "folder", content)
    if info.issym():
        return ArchiveMember(info.name, "link", content, info.linkname)
    if info.islnk():
        depth = len(PurePosixPath(info.name).parts) - 1
        return ArchiveMember(info.name, "link", content, "../" * depth + info.linkname)
    return ArchiveMember(info.name, "device", content)


def checked_name(name: str, title: str) -> str:
    """Return a member's name without a leading ``./``; one that leads outside is refused."""
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or "\0" in name:
        raise DataError(f"{title}: the member {name[:200]!r} leads outside of its folder: refused")
    if len(name) > _NAME_LENGTH or len(path.parts) > _DEPTH:
        most = f"{_NAME_LENGTH:,} characters or {_DEPTH} folders"
        raise DataError(f"{title}: the name of the member {name[:200]!r} has more than {most}: refused")
    return str(path)


def is_in(name: str, prefix: str) -> bool:
    """Tell whether a member is a file or in a folder; an empty name is all but what some systems add."""
    if any(part in _PASSED_OVER for part in PurePosixPath(name).parts):
        return False
    return not prefix or name == prefix or name.startswith(prefix.rstrip("/") + "/")


@contextmanager
def _named(name: str, title: str) -> Iterator[None]:
    """Turn what a disk says of a member's name or place into a complaint about the member."""
    try:
        yield
    except OSError as error:
        if error.errno not in _OF_NAMES:
            raise
        raise DataError(f"{title}: the member {name[:200]!r} can't be put there: {error.strerror}") from None


def _place(member: ArchiveMember, name: str, title: str, work: _Unpacking) -> None:
    target = work.out / name
    _count(title, work)
    if member.kind == "folder":
        target.mkdir(parents=True, exist_ok=True)
    elif member.kind == "link":
        work.links[name] = member.linked
    elif member.kind == "file":
        target.parent.mkdir(parents=True, exist_ok=True)
        _write(member, title, target, work)
    else:
        _refuse_kind(member, title)


def _refuse_kind(member: ArchiveMember, title: str) -> NoReturn:
    raise DataError(f"{title}: the member {member.name[:200]!r} is a {member.kind}: refused")


def _count(title: str, work: _Unpacking) -> None:
    work.files += 1
    if work.files > MOST_FILES:
        raise DataError(f"{title}: has more than {MOST_FILES:,} files: refused")


def _write(member: ArchiveMember, title: str, target: Path, work: _Unpacking) -> None:
    _refuse_folder(target, member.name, title)
    with member.open() as source, target.open("wb") as out:
        while block := source.read(_BLOCK):
            work.written += len(block)
            if work.written > work.limit:
                _refuse_size(title, work)
            out.write(block)
            work.progress(work.written)


def _refuse_folder(target: Path, name: str, title: str) -> None:
    if target.is_dir():
        raise DataError(f"{title}: has {name!r} as file and as folder: refused")


def _refuse_size(title: str, work: _Unpacking) -> None:
    if shutil.disk_usage(work.out).free < 2 * LEFT_BYTES:
        raise SystemFault(f"{title}: the disk has no room for more than {work.limit >> 20} MiB of it")
    raise DataError(growth_problem(title, work.limit))


def growth_problem(title: str, limit: int) -> str:
    """Return the complaint about an archive that unpacks to more bytes than the limit."""
    return (
        f"{title}: grows to more than {limit >> 20} MiB, {MOST_RATIO} times its size: refused as no archive "
        "of data does"
    )


def _follow_links(title: str, work: _Unpacking) -> None:
    """Put copies in the place of links; what leads outside, to itself, or to nothing, is refused."""
    # Names alone decide: no link is ever made that a later one could lead through.
    links = {
        name: os.path.normpath(PurePosixPath(name).parent / linked) for name, linked in work.links.items()
    }
    order: TopologicalSorter[str] = TopologicalSorter()
    for name, path in links.items():
        if path.startswith(("/", "..")):
            raise DataError(f"{title}: the link {name!r} leads outside of its folder: refused")
        if path.count("/") >= _DEPTH:
            _refuse_link(name, title, work)
        if path in (".", name) or name.startswith(f"{path}/"):
            linked = work.links[name]
            raise DataError(f"{title}: the link {name!r} leads to {linked!r}, in which it is itself: refused")
        # A name is a link's copy, with a slash all that lies under it: whole, and there, before it is copied.
        order.add(name, f"{path}/")
        order.add(f"{path}/", *(above for above in _above(path) if above in links))
        for above in (name, *_above(name)):
            order.add(f"{above}/", name)
    try:
        for name in order.static_order():
            if name in links:
                _copy(name, links[name], title, work)
    except CycleError as error:
        circle = set(error.args[1])
        _refuse_link(next(name for name in links if name in circle), title, work)


def _above(path: str) -> list[str]:
    """Return the folders that a path lies in, but the archive's own."""
    return [str(folder) for folder in PurePosixPath(path).parents][:-1]


def _refuse_link(name: str, title: str, work: _Unpacking) -> NoReturn:
    raise DataError(f"{title}: the link {name!r} leads to {work.links[name]!r}, which isn't in it: refused")


def _copy(name: str, path: str, title: str, work: _Unpacking) -> None:
    """Put a copy of what a link leads to, all links in which are copies by now, in its place."""
    source, target = work.out / path, work.out / name
    if source.is_dir():
        found: Iterable[Path] = source.rglob("*")
    elif source.is_file():
        found = [source]
    else:
        _refuse_link(name, title, work)
    for file in found:
        place = target / file.relative_to(source)
        _count(title, work)
        if file.is_dir():
            continue
        checked_name(str(place.relative_to(work.out)), title)
        work.written += max(file.stat().st_size, _COPY_BYTES)
        if work.written > work.limit:
            _refuse_size(title, work)
        _refuse_folder(place, name, title)
        with _named(name, title):
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, place)
