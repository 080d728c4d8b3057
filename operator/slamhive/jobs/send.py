# SPDX-License-Identifier: Apache-2.0
"""Program of the file pod: sends files of run folders to `slamhive fetch --files`, by exec.

::

    asked   {"folder": "runs/UID/POD", "have": {PATH: BYTES}}                  a line each
    told    {"path": PATH, "size": BYTES, "offset": BYTES}                     then size - offset bytes, then
            {"sha256": of the whole file} or {"problem": "sentence"}           for each regular file, by name
            {"end": true, "left": [[NAME, why], …]}                            or {"end": true, "problem": …}

A folder that is not on the volume is looked for in object storage, where ``--store`` names one.

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

from slamhive.jobs.listing import Listing
from slamhive.jobs.opening import opened
from slamhive.jobs.program import add_store, arguments
from slamhive.model.errors import DataError, SlamHiveError
from slamhive.storage.reading import Bucket
from slamhive.storage.store import ObjectStorage, StoreSettings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.storage.offloaded import StoredFile

COMMAND = ("python3", "-P", "-m", "slamhive.jobs.send")

_FOLDER = re.compile(r"runs/[A-Za-z0-9-]+/[A-Za-z0-9-]+")
_CHUNK = 1 << 18
_MOST_BYTES = 1 << 50
_MOST_FILES = 20_000
_MOST_LEFT = 20
_TOO_MANY = f"there are more than {_MOST_FILES} files"
_ALIVE_SECONDS = 5.0
_LOOK_SECONDS = 1.0


def main(argv: Sequence[str] | None = None) -> int:
    """Answer what is asked on standard input until that ends, or wait."""
    parser = arguments("Hand out files of run folders.")
    parser.add_argument(
        "--wait", type=float, metavar="SECONDS", help="do nothing until nobody has asked for so long"
    )
    parser.add_argument("--sign", type=Path, default=Path("/tmp/asked"), help="touched when somebody asks")  # noqa: S108
    add_store(parser, required=False)
    options = parser.parse_args(argv)
    sign = Sign(options.sign)
    if options.wait is not None:
        sign.wait(options.wait)
        return 0
    bucket = (
        Bucket(ObjectStorage(StoreSettings.read(options.store, options.secret))) if options.store else None
    )
    return Sender(options.root / "results", sys.stdout.buffer, sign, bucket).serve(sys.stdin.buffer)


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
        """Wait until no request came for some seconds."""
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
        bucket: where folders are that are not on the volume; None for none.
    """

    def __init__(self, root: Path, out: BinaryIO, sign: Sign, bucket: Bucket | None = None) -> None:
        self._root = root
        self._out = out
        self._sign = sign
        self._bucket = bucket

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
        found = Listing(_MOST_FILES)
        try:
            found.look(self._root, folder)
        except OSError as error:
            if not isinstance(error, FileNotFoundError) or not self._send_stored(folder, have):
                self._tell({"end": True, "problem": f"{folder}: {error.strerror}"})
            return
        for path in sorted(found.files):
            held = have.get(path)
            try:
                self._file(folder, path, held if isinstance(held, int) else 0)
            except DataError as error:  # gone, or made a link, since it was listed
                found.leave(path, str(error))
        self._tell({"end": True, "left": found.left})

    def _send_stored(self, folder: str, have: dict[str, Any]) -> bool:
        """Send a folder from object storage; returns whether it, or the storage's trouble, was told."""
        if self._bucket is None:
            return False
        _, uid, pod = folder.split("/")
        try:
            found = self._bucket.run(uid)
            files = [file for file in found.files if file.path.startswith(f"{pod}/")] if found else []
            if found is None or not files:
                return False
            for file in files[:_MOST_FILES]:
                self._stored_file(self._bucket, uid, file, have.get(file.path.removeprefix(f"{pod}/")))
        except SlamHiveError as error:
            self._tell({"end": True, "problem": str(error)})
            return True
        left = [[path.removeprefix(f"{pod}/"), why] for path, why in found.left if path.startswith(f"{pod}/")]
        left += [[file.path.removeprefix(f"{pod}/"), _TOO_MANY] for file in files[_MOST_FILES:][:_MOST_LEFT]]
        self._tell({"end": True, "left": left})
        return True

    def _stored_file(self, bucket: Bucket, uid: str, file: StoredFile, held: object) -> None:
        offset = held if isinstance(held, int) and 0 <= held <= file.size else 0
        path = file.path.partition("/")[2]
        self._tell({"path": path, "size": file.size, "offset": offset})
        left, problem = file.size - offset, ""
        try:
            for data in bucket.pieces(uid, file, offset):
                self._out.write(data)
                self._sign.give()
                left -= len(data)
        except SlamHiveError as error:
            problem = str(error)
            while left > 0:  # what was announced is sent, so that what follows is understood
                left -= self._out.write(bytes(min(left, _CHUNK)))
        # The sum that was written down when it was moved: the receiver has all of the bytes.
        self._tell({"problem": problem} if problem else {"sha256": file.sha256})

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


if __name__ == "__main__":
    sys.exit(main())
