# SPDX-License-Identifier: Apache-2.0
"""Unpacking of archives that strangers made: what is wanted of them alone, and never outside of a folder.

Zip and tar, compressed or not, and archives in archives. 7z is read by ``bsdtar`` (libarchive), where that is
installed. Nothing that a member says of itself is believed: bytes are counted as they come, links become
copies of what they lead to, or are refused.
"""

from __future__ import annotations

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
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, NamedTuple

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
_MAGIC_ZIP = b"PK\x03\x04"
_MAGIC_7Z = b"7z\xbc\xaf\x27\x1c"
_PASSED_OVER = ("__MACOSX", ".DS_Store")


class DamagedArchiveError(DataError):
    """An archive that is broken: fetched again it may be whole."""


class _Link(NamedTuple):
    name: str
    linked: str


@dataclass
class _Unpacking:
    """One unpacking: where to, how much so far, whom to tell.

    Attributes:
        out: The folder.
        limit: Bytes that may come.
        progress: Called with the bytes that have come.
    """

    out: Path
    limit: int
    progress: Callable[[int], None]
    written: int = 0
    files: int = 0
    links: list[_Link] = field(default_factory=list)


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
    limit = min(max(FREE_BYTES, MOST_RATIO * _held(archive)), max(room, 0))
    work = _Unpacking(out, limit, progress)
    title = title or archive.name
    with disk_words(title, out):
        _unpack(archive, title, [name.split("!") for name in wanted], work)
        _follow_links(title, work)


def _held(archive: Path) -> int:
    """Return the space of an archive on the disk, bytes: one that was fetched in parts has holes."""
    known = archive.stat()
    return min(known.st_size, known.st_blocks * 512)


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
                name = _checked(member.name, title)
                seen.setdefault("/".join(PurePosixPath(name).parts[:2]))
                if name in inner:
                    with tempfile.TemporaryDirectory(prefix=".nested-", dir=work.out) as folder:
                        aside = Path(folder) / PurePosixPath(name).name
                        _write(member, title, aside, work)
                        _unpack(aside, f"{title}: {name}", inner[name], work)
                    missing.discard(name)
                matching = next((prefix for prefix in here if _is_in(name, prefix)), None)
                if matching is not None:
                    missing.discard(matching)
                    _place(member, name, title, work)
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, NotImplementedError) as error:
        raise DamagedArchiveError(f"{title}: {_damage(archive, error)}") from None
    if missing:
        some = ", ".join(list(seen)[:5]) + (", …" if len(seen) > 5 else "")
        raise DataError(f"{title}: has no {', '.join(sorted(missing))}; it has: {some or 'nothing'}")


def _damage(archive: Path, error: Exception) -> str:
    """Say in one line what is wrong with an archive that can't be read."""
    with archive.open("rb") as file:
        begin = file.read(len(_MAGIC_ZIP))
    if begin == _MAGIC_ZIP and not zipfile.is_zipfile(archive):
        return "is a zip archive whose end is missing"
    if isinstance(error, tarfile.ReadError) and "\n" in str(error):
        return "is damaged, or no archive: none of zip, tar, tgz, tar.bz2, tar.xz, 7z"
    return f"is damaged, or no archive that can be read: {error}"


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
        with zipfile.ZipFile(archive) as opened:
            yield (_of_zip(opened, info) for info in opened.infolist())
    else:
        with tarfile.open(archive, "r:*") as tar:
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
            with tarfile.open(fileobj=process.stdout, mode="r|") as tar:
                yield (_of_tar(tar, info) for info in tar)
        finally:
            process.kill()


def _of_zip(opened: zipfile.ZipFile, info: zipfile.ZipInfo) -> ArchiveMember:
    mode = info.external_attr >> 16
    if info.flag_bits & 1:
        return ArchiveMember(info.filename, "encrypted file", lambda: opened.open(info))
    if stat.S_ISLNK(mode):
        linked = opened.read(info)[:4096].decode("utf-8", "replace") if info.file_size <= 4096 else "/"
        return ArchiveMember(info.filename, "link", lambda: opened.open(info), linked)
    return ArchiveMember(info.filename, "folder" if info.is_dir() else "file", lambda: opened.open(info))


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


def _checked(name: str, title: str) -> str:
    """Return a member's name without a leading ``./``; one that leads outside is refused."""
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or "\0" in name:
        raise DataError(f"{title}: the member {name[:200]!r} leads outside of its folder: refused")
    return str(path)


def _is_in(name: str, prefix: str) -> bool:
    if any(part in _PASSED_OVER for part in PurePosixPath(name).parts):
        return False
    return not prefix or name == prefix or name.startswith(prefix.rstrip("/") + "/")


def _place(member: ArchiveMember, name: str, title: str, work: _Unpacking) -> None:
    target = work.out / name
    work.files += 1
    if work.files > MOST_FILES:
        raise DataError(f"{title}: has more than {MOST_FILES:,} files: refused")
    if member.kind == "folder":
        target.mkdir(parents=True, exist_ok=True)
    elif member.kind == "link":
        work.links.append(_Link(name, member.linked))
    elif member.kind == "file":
        target.parent.mkdir(parents=True, exist_ok=True)
        _write(member, title, target, work)
    else:
        raise DataError(f"{title}: the member {name!r} is a {member.kind}: refused")


def _write(member: ArchiveMember, title: str, target: Path, work: _Unpacking) -> None:
    if target.is_dir():
        raise DataError(f"{title}: has {member.name!r} as file and as folder: refused")
    with member.open() as source, target.open("wb") as out:
        while block := source.read(_BLOCK):
            work.written += len(block)
            if work.written > work.limit:
                _refuse_size(title, work)
            out.write(block)
            work.progress(work.written)


def _refuse_size(title: str, work: _Unpacking) -> None:
    if shutil.disk_usage(work.out).free < 2 * LEFT_BYTES:
        raise SystemFault(f"{title}: the disk has no room for more than {work.limit >> 20} MiB of it")
    raise DataError(
        f"{title}: grows to more than {work.limit >> 20} MiB, {MOST_RATIO} times its size: refused as no "
        "archive of data does"
    )


def _follow_links(title: str, work: _Unpacking) -> None:
    """Put copies in the place of links; what leads outside, to itself, or to nothing, is refused."""
    waiting = work.links
    while waiting:
        names = [PurePosixPath(link.name) for link in waiting]
        left = [link for link in waiting if not _copied(link, names, title, work)]
        if len(left) == len(waiting):
            name, linked = left[0]
            raise DataError(f"{title}: the link {name!r} leads to {linked!r}, which isn't in it: refused")
        waiting = left


def _copied(link: _Link, links: Sequence[PurePosixPath], title: str, work: _Unpacking) -> bool:
    """Put a copy in the place of a link; False where what it leads to isn't there, or has links in it."""
    name, linked = link
    # Names alone decide: no link is ever made that a later one could lead through.
    path = os.path.normpath(PurePosixPath(name).parent / linked)
    if path.startswith(("/", "..")):
        raise DataError(f"{title}: the link {name!r} leads outside of its folder: refused")
    source, target = work.out / path, work.out / name
    if target.is_relative_to(source):
        raise DataError(f"{title}: the link {name!r} leads to {linked!r}, in which it is itself: refused")
    if any(other.is_relative_to(path) for other in links):
        return False
    if source.is_dir():
        files = [file for file in sorted(source.rglob("*")) if file.is_file()]
    elif source.is_file():
        files = [source]
    else:
        return False
    work.files += len(files)
    work.written += sum(file.stat().st_size for file in files)
    if work.written > work.limit or work.files > MOST_FILES:
        _refuse_size(title, work)
    for file in files:
        place = target / file.relative_to(source) if source.is_dir() else target
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)
    return True
