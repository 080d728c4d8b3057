# SPDX-License-Identifier: Apache-2.0
"""Program of the file pod: sends files of run folders to `slamhive fetch --files`, by exec.

::

    asked   {"folder": "runs/UID/POD", "have": {PATH: BYTES}}                  a line each
    told    {"path": PATH, "size": BYTES, "offset": BYTES}                     then size - offset bytes, then
            {"sha256": of the whole file} or {"problem": "sentence"}           for each regular file, by name
            {"end": true, "left": [[NAME, why], …]}                            or {"end": true, "problem": …}

With ``--wait`` it hands out nothing but keeps the pod there for as long as somebody asks for something.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from slamhive.jobs.opening import opened
from slamhive.jobs.program import arguments
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Sequence

COMMAND = ("python3", "-P", "-m", "slamhive.jobs.send")

_FOLDER = re.compile(r"runs/[A-Za-z0-9-]+/[A-Za-z0-9-]+")
_CHUNK = 1 << 18
_MOST_BYTES = 1 << 50
_MOST_FILES = 20_000
_MOST_LEFT = 20
_DEPTH = 16
_ALIVE_SECONDS = 5.0
_LOOK_SECONDS = 1.0
_FLAGS = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_DIRECTORY


def main(argv: Sequence[str] | None = None) -> int:
    """Answer what is asked on standard input until that ends, or wait."""
    parser = arguments("Hand out files of run folders.")
    parser.add_argument(
        "--wait", type=float, metavar="SECONDS", help="do nothing until nobody has asked for so long"
    )
    parser.add_argument("--sign", type=Path, default=Path("/tmp/asked"), help="touched when somebody asks")  # noqa: S108
    options = parser.parse_args(argv)
    sign = Sign(options.sign)
    if options.wait is not None:
        sign.wait(options.wait)
        return 0
    return Sender(options.root / "results", sys.stdout.buffer, sign).serve(sys.stdin.buffer)


class Sign:
    """A file by whose age it is known when somebody last asked.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._given = -_ALIVE_SECONDS

    def give(self) -> None:
        """Note that somebody asks."""
        now = time.monotonic()
        if now - self._given >= _ALIVE_SECONDS:
            self._given = now
            self._path.touch()

    def wait(self, seconds: float) -> None:
        """Return when no request came for some seconds."""
        begun = time.time()
        while True:
            given = begun
            with suppress(FileNotFoundError):
                given = max(begun, self._path.stat().st_mtime)
            if time.time() - given >= seconds:
                return
            time.sleep(_LOOK_SECONDS)


class Sender:
    """Answers requests for run folders.

    Args:
        root: the results volume.
        out: where answers go.
        sign: given while somebody takes what is sent.
    """

    def __init__(self, root: Path, out: BinaryIO, sign: Sign) -> None:
        self._root = root
        self._out = out
        self._sign = sign

    def serve(self, requests: BinaryIO) -> int:
        """Answer until the requests end; returns the exit code."""
        try:
            for line in requests:
                self._sign.give()
                self._answer(line)
        except BrokenPipeError:  # whoever asked has gone
            return 1
        return 0

    def _answer(self, line: bytes) -> None:
        try:
            request = json.loads(line)
            folder, have = str(request["folder"]), dict(request.get("have") or {})
        except (ValueError, TypeError, KeyError, RecursionError):
            self._tell({"end": True, "problem": "what was asked is no request"})
            return
        self._send(folder, have)

    def _send(self, folder: str, have: dict[str, Any]) -> None:
        if not _FOLDER.fullmatch(folder):
            self._tell({"end": True, "problem": f"{folder!r} is not like runs/UID/POD"})
            return
        found = _Found()
        try:
            found.look(self._root, folder)
        except OSError as error:
            self._tell({"end": True, "problem": f"{folder}: {error.strerror}"})
            return
        for path in sorted(found.files):
            held = have.get(path)
            try:
                self._file(folder, path, held if isinstance(held, int) else 0)
            except DataError as error:  # gone, or made a link, since it was listed
                found.leave(path, str(error))
        self._tell({"end": True, "left": found.left})

    def _file(self, folder: str, path: str, held: int) -> None:
        with opened(self._root, f"{folder}/{path}", _MOST_BYTES) as descriptor:
            size = os.fstat(descriptor).st_size
            offset = held if 0 <= held <= size else 0
            self._tell({"path": path, "size": size, "offset": offset})
            told = self._bytes(descriptor, offset, size)
            self._tell(told)

    def _bytes(self, descriptor: int, offset: int, size: int) -> dict[str, str]:
        """Send a file from an offset on, and return what is to be said of the whole of it."""
        digest, place, problem = hashlib.sha256(), 0, ""
        while place < size:
            want = min(_CHUNK, (offset if place < offset else size) - place)
            try:
                data = b"" if problem else os.read(descriptor, want)
            except OSError as error:
                data, problem = b"", error.strerror or str(error)
            if not data:  # what was announced is sent, so that what follows is understood
                problem = problem or "became shorter while it was read"
                data = bytes(want)
            digest.update(data)
            if place >= offset:
                self._out.write(data)
                self._sign.give()
            place += len(data)
        return {"problem": problem} if problem else {"sha256": digest.hexdigest()}

    def _tell(self, message: dict[str, Any]) -> None:
        self._out.write(json.dumps(message, separators=(",", ":")).encode() + b"\n")
        self._out.flush()


class _Found:
    """The regular files below a folder, reached without following a link, and what else there is."""

    def __init__(self) -> None:
        self.files: list[str] = []
        self.left: list[tuple[str, str]] = []

    def look(self, root: Path, folder: str) -> None:
        descriptor = os.open(root, os.O_RDONLY | os.O_CLOEXEC | os.O_DIRECTORY)
        try:
            for part in folder.split("/"):
                below = os.open(part, _FLAGS, dir_fd=descriptor)
                os.close(descriptor)
                descriptor = below
            self._list(descriptor, "", _DEPTH)
        finally:
            os.close(descriptor)

    def leave(self, path: str, why: str) -> None:
        if len(self.left) < _MOST_LEFT:
            self.left.append((path.encode("utf-8", "backslashreplace").decode(), why))

    def _list(self, descriptor: int, prefix: str, depth: int) -> None:
        with os.scandir(descriptor) as entries:
            ordered = sorted(entries, key=lambda entry: entry.name)
        for entry in ordered:
            path = prefix + entry.name
            try:
                path.encode()
            except UnicodeEncodeError:
                self.leave(path, "its name is no UTF-8")
                continue
            if entry.is_dir(follow_symlinks=False):
                self._enter(descriptor, entry.name, path, depth - 1)
            elif not entry.is_file(follow_symlinks=False):
                self.leave(path, "is a symbolic link" if entry.is_symlink() else "is no regular file")
            elif len(self.files) >= _MOST_FILES:
                self.leave(path, f"there are more than {_MOST_FILES} files")
            else:
                self.files.append(path)

    def _enter(self, descriptor: int, name: str, path: str, depth: int) -> None:
        if depth <= 0:
            self.leave(path, "is nested too deeply")
            return
        try:
            below = os.open(name, _FLAGS, dir_fd=descriptor)
        except OSError as error:
            self.leave(path, error.strerror or str(error))
            return
        try:
            self._list(below, f"{path}/", depth)
        finally:
            os.close(below)


if __name__ == "__main__":
    sys.exit(main())
