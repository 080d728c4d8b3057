# SPDX-License-Identifier: Apache-2.0
"""Unpack made-up archives: ``python tests/fuzz/archives.py --seconds 600``.

Each case draws a tree of rooms with files, and links: chains, many side by side, to whole rooms, through
other links, hard ones; names that are deep or long; and packs it as zip or tar of any kind, in any order,
perhaps in a zip again. A sound one must come out as its own definition has it, links as copies. Most are
spoiled then: by members and links that lead outside, circles, devices, a file that is a folder too, odd
headers of pax, broken bytes; such a one is unpacked or refused by one sentence. Either way nothing is beside
its folder, nothing in there is a link, no more than the limit is written, and time and memory stay bounded.
"""

from __future__ import annotations

import io
import os
import stat
import sys
import tarfile
import time
import warnings
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

from typing import TYPE_CHECKING

from drawing import FaultError, require_sentence, run_cases

from slamhive.data.files import unpacking
from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    import random

CPU_SECONDS = 10.0
MEMORY_BYTES = 1 << 30
FREE_BYTES = 4 << 20
MOST_FILES = 2000
MOST_LINKS = (3, 3, 10, 10, 60, 500)
"""Links of a sort at most, one of these."""
FORMATS = (tarfile.PAX_FORMAT, tarfile.GNU_FORMAT, tarfile.USTAR_FORMAT)
AWAY = (
    "../x",
    "/tmp/x",
    "s/../../x",
    "..",
    "..\\x",
    "s/" + "../" * 40 + "x",
    "",
    ".",
    "./",
    "//x",
    "a\nb",
    "\x1b[2J",
)
HEADERS = (
    *({"size": "-1"}, {"size": "9" * 30}, {"path": "../x"}, {"linkpath": "/x"}, {"mtime": "nan"}, {"": ""}),
    *({"GNU.sparse.map": "0,1", "GNU.sparse.size": "9"}, {"GNU.sparse.major": "1", "GNU.sparse.minor": "0"}),
    *({"comment": "c" * 5000}, {"hdrcharset": "BINARY", "path": "é"}, {"uid": "x"}),
)


@dataclass
class Tree:
    """Members of an archive.

    Attributes:
        rooms: Folders that lie in no other, each with its files and links by name: content, or a path.
        hard: Paths of links that are hard ones.
    """

    rooms: dict[str, dict[str, bytes | str]] = field(default_factory=dict)
    hard: set[str] = field(default_factory=set)

    def files(self, path: str, most: int) -> dict[str, bytes]:
        """Return the files at a path, by their paths from there: of a file itself, the empty path.

        Raises:
            OverflowError: There are more than some.
        """
        if path in self.rooms:
            found: dict[str, bytes] = {}
            for name in self.rooms[path]:
                inner = self.files(f"{path}/{name}", most - len(found))
                found |= {f"{name}/{key}".rstrip("/"): data for key, data in inner.items()}
                if len(found) > most:
                    raise OverflowError
            return found
        value, rest = self.leading(path)
        for _ in range(5000):
            if isinstance(value, bytes) or rest:
                break
            if value in self.rooms:
                return self.files(value, most)
            value, rest = self.leading(value)
        if isinstance(value, str):
            return self.files(f"{value}/{rest}", most)
        return {"": value}

    def leading(self, path: str) -> tuple[bytes | str, str]:
        """Return the member that a path begins with, and the rest of the path."""
        room = next(room for room in self.rooms if path.startswith(f"{room}/"))
        name, _, rest = path[len(room) + 1 :].partition("/")
        return self.rooms[room][name], rest


def several(rng: random.Random) -> int:
    """Return a number, seldom a large one."""
    return rng.randrange(1, rng.choice(MOST_LINKS))


def tree(rng: random.Random) -> Tree:
    """Draw a tree."""
    made = Tree()
    for number in range(rng.choice((1, 2, 3, 6))):
        depth = rng.choice((0, 0, 1, 3, 40))
        room = "/".join([f"r{number}", *(rng.choice("ab") for _ in range(depth))])
        content = made.rooms[room] = {"f": rng.randbytes(rng.choice((0, 10, 3000)))}
        content |= {f"f{k}": b"%d" % k for k in range(rng.choice((0, 1, 8)))}
        if rng.random() < 0.2:
            content["n" * rng.choice((100, 101, 200, 255))] = b"long"
        links(rng, made, room)
    return made


def links(rng: random.Random, made: Tree, room: str) -> None:
    """Draw links of a room, to what was drawn before."""
    content = made.rooms[room]
    others = [other for other in made.rooms if other != room]
    for kind in rng.sample(("chain", "flat", "room", "through", "hard"), rng.choice((0, 1, 2))):
        many = several(rng)
        if kind == "chain":
            content |= {f"c{k}": f"{room}/c{k + 1}" for k in range(many)} | {f"c{many}": f"{room}/f"}
        elif kind in {"flat", "hard"}:
            content |= {f"{kind}{k}": f"{rng.choice([*others, room])}/f" for k in range(many)}
            made.hard |= {f"{room}/{kind}{k}" for k in range(many) if kind == "hard"}
        elif others:
            to = rng.choice(others)
            content |= {f"{kind}{k}": to for k in range(min(many, 4))}
            if kind == "through":
                content["in"] = f"{room}/through0/{rng.choice(list(made.rooms[to]))}"


@dataclass(frozen=True)
class Member:
    """A member of an archive, of a kind as tar has it."""

    name: str
    content: bytes = b""
    kind: bytes = tarfile.REGTYPE
    linked: str = ""


def members(made: Tree) -> list[Member]:
    """Return the members of a tree."""
    found = []
    for room, content in made.rooms.items():
        found.append(Member(room, kind=tarfile.DIRTYPE))
        for name, value in content.items():
            path = f"{room}/{name}"
            if isinstance(value, bytes):
                found.append(Member(path, value))
            elif path in made.hard:
                found.append(Member(path, kind=tarfile.LNKTYPE, linked=value))
            else:
                found.append(Member(path, kind=tarfile.SYMTYPE, linked=os.path.relpath(value, room)))
    return found


def spoil(rng: random.Random, found: list[Member]) -> None:
    """Add what no archive of data holds, or what is at its limit."""
    some = rng.choice(found).name
    many = several(rng)
    to = rng.choice((*AWAY, some, f"{some}/x", f"../{some}", "loop", "x" * 5000, "é\udcff", "\x00"))
    named = rng.choice(
        (*AWAY, some, f"{some}/x", "x" * 256, "a/" * rng.choice((300, 1500)) + "x", "é\udcff\x00")
    )
    kinds = (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.REGTYPE, tarfile.DIRTYPE)
    odd = (tarfile.CHRTYPE, tarfile.FIFOTYPE, tarfile.CONTTYPE, b"Z")
    found += rng.choice(
        (
            [Member(named, b"" if rng.random() < 0.5 else b"x", rng.choice((*kinds, *odd)), to)],
            [Member("r0/loop", kind=tarfile.SYMTYPE, linked=to)],
            [Member(f"r0/o{k}", kind=tarfile.SYMTYPE, linked=f"o{(k + 1) % many}") for k in range(many)],
            [Member(f"r0/d{k}", kind=tarfile.SYMTYPE, linked=f"../r0/d{k + 1}/x") for k in range(many)],
            [Member(f"w{k}/in", kind=tarfile.SYMTYPE, linked=f"../w{k + 1}") for k in range(many)],
            [
                Member(f"t{k}/{name}", kind=tarfile.SYMTYPE, linked=f"../t{k + 1}")
                for k in range(many)
                for name in "ab"
            ]
            + [Member(f"t{many}/f", b"x")],
        )
    )


def packed_tar(rng: random.Random, path: Path, found: list[Member], *, odd: bool) -> None:
    """Write a tar archive."""
    mode = rng.choice(("w", "w:gz", "w:bz2", "w:xz"))
    with tarfile.open(path, mode, format=rng.choice(FORMATS if odd else FORMATS[:2])) as archive:
        for one in found:
            info = tarfile.TarInfo(one.name)
            info.type, info.linkname = one.kind, one.linked
            info.size = len(one.content) if info.isreg() else 0
            if odd and rng.random() < 0.1:
                info.pax_headers = dict(rng.choice(HEADERS))
            archive.addfile(info, io.BytesIO(one.content))


def packed_zip(rng: random.Random, path: Path, found: list[Member]) -> None:
    """Write a zip archive; its links are symbolic ones."""
    with zipfile.ZipFile(path, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for one in found:
            info, content = zipfile.ZipInfo(one.name + "/" * (one.kind == tarfile.DIRTYPE)), one.content
            if one.kind in {tarfile.SYMTYPE, tarfile.LNKTYPE}:
                info.external_attr = (stat.S_IFLNK | 0o777) << 16
                up = "../" * one.name.count("/") if one.kind == tarfile.LNKTYPE else ""
                content = (up + one.linked).encode("utf-8", "replace")
            archive.writestr(info, content)


def broken(rng: random.Random, path: Path) -> None:
    """Break bytes of a file."""
    data = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 1, 5))):
        at = rng.choice((rng.randrange(len(data)), rng.randrange(-min(len(data), 200), 0) % len(data)))
        if rng.random() < 0.2:
            del data[at:]
        else:
            data[at : at + rng.choice((1, 1, 4))] = rng.randbytes(rng.choice((1, 1, 4)))
        if not data:
            break
    path.write_bytes(data)


def run(rng: random.Random, folder: Path) -> str:
    """Pack and unpack one."""
    made = tree(rng)
    found = members(made)
    is_sound = rng.random() < 0.4
    for _ in range(0 if is_sound else rng.choice((0, 1, 1, 3))):
        spoil(rng, found)
    rng.shuffle(found)
    archive, out = folder / "a.bin", folder / "in" / "out"
    try:
        if rng.random() < 0.4:
            packed_zip(rng, archive, found)
        else:
            packed_tar(rng, archive, found, odd=not is_sound)
    except (ValueError, UnicodeError, tarfile.TarError):
        return "archives that nobody can write"
    if not is_sound and rng.random() < 0.5:
        broken(rng, archive)
    wanted = [""]
    if is_nested := rng.random() < 0.2:
        with zipfile.ZipFile(folder / "b.zip", "w") as outer:
            outer.write(archive, "inner/a")
        archive, wanted = folder / "b.zip", ["inner/a!"]
    (folder / "in").mkdir()
    began = time.process_time()
    problem = ""
    try:
        unpacking.unpack(archive, wanted, out, title="hall")
    except SlamHiveError as error:
        problem = str(error)
        require_sentence(problem)
    if (took := time.process_time() - began) > CPU_SECONDS:
        raise FaultError(f"{took:.0f} s of CPU time for {len(found)} members")
    require_inside(folder, out)
    if not is_sound:
        return "refused" if problem else "unpacked though spoiled"
    return require_same(made, out, problem, is_nested=is_nested)


def require_inside(folder: Path, out: Path) -> None:
    """Check that nothing is beside a folder, and nothing in it leads anywhere.

    Raises:
        FaultError: Something is.
    """
    if {path.name for path in folder.iterdir()} - {"a.bin", "b.zip", "in"} or {*out.parent.iterdir()} - {out}:
        raise FaultError("files beside its folder")
    size = 0
    for above, folders, names in os.walk(out):
        for name in (*folders, *names):
            known = (Path(above) / name).lstat()
            if not stat.S_ISREG(known.st_mode) and not stat.S_ISDIR(known.st_mode):
                raise FaultError(f"{name} is no file")
            size += known.st_size if stat.S_ISREG(known.st_mode) else 0
    if size > FREE_BYTES * 2:
        raise FaultError(f"{size} bytes")


def require_same(made: Tree, out: Path, problem: str, *, is_nested: bool) -> str:
    """Check that a sound archive came out as it is defined, or was refused for its size alone."""
    expected: dict[str, bytes] = {}
    try:
        for room in made.rooms:
            inner = made.files(room, MOST_FILES)
            expected |= {f"{room}/{name}": data for name, data in inner.items()}
    except OverflowError:
        expected = {}
    if problem:
        size = sum(map(len, expected.values()))
        if expected and len(expected) < MOST_FILES // 2 and size < FREE_BYTES // (1 + is_nested) - (1 << 19):
            raise FaultError(f"a sound archive is refused: {problem}")
        return "refused for its size"
    found = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    if found != expected:
        odd = [name for name in {*found, *expected} if found.get(name) != expected.get(name)]
        raise FaultError(f"{len(odd)} files are not as they should be, such as {odd[0]}")
    return "sound"


def main() -> int:
    """Unpack for a while, or a number of them; returns the exit code."""
    vars(unpacking).update(FREE_BYTES=FREE_BYTES, MOST_FILES=MOST_FILES)
    warnings.simplefilter("ignore")  # of zipfile, at names that are there twice
    return run_cases((__doc__ or "").splitlines()[0], run, MEMORY_BYTES)


if __name__ == "__main__":
    sys.exit(main())
