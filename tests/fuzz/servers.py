# SPDX-License-Identifier: Apache-2.0
"""Fetch from https servers that lie: ``python tests/fuzz/servers.py --seconds 600``.

Each case draws a server's states of a file and its habits: marks of the file (ETag, weak, time, none, others
each time), lengths that are wrong or missing, parts that are refused or are others than those asked for,
answers that end early, come in records of a byte, change in the middle, lead elsewhere or are pages, words
that no server says. A file, members of a zip, or a dataset is fetched from it, up to three times as by one
process after another. Whatever the server does, each ends after a bounded number of requests by one error of
one sentence, or with a file that is what its checksum says; without a known checksum, of answers alone that
contradict each other nowhere, by mark or size, and that is as long as they say. A checksum is remembered only
of what became a dataset. No case waits: the clock is the server's.
"""

from __future__ import annotations

import contextlib
import hashlib
import http.server
import io
import itertools
import json
import os
import re
import socket
import struct
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[1] / "data" / "datalab")]

from drawing import FaultError, require_sentence, run_cases
from serving import Site, make_certificate, serving

from slamhive.data.files import fetching, https
from slamhive.data.files.fetching import FetchProgress, WantedFile, fetch_file
from slamhive.data.files.remotezip import fetch_members
from slamhive.data.files.unpacking import unpack
from slamhive.data.store.obtaining import SUMS, Listener, obtain
from slamhive.model.catalogue import FOLDERS, find_sequence
from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Sequence

PAUSES = (0.5, 1.0, 2.0)
STALL_BYTES = 1 << 12
FAULTS = (
    *("change", "deaf", "other part", "total", "length", "markless", "cut", "mixed", "records", "slow"),
    *("status", "away", "page", "odd words"),
)
STATUSES = (100, 204, 206, 304, 400, 401, 403, 404, 408, 416, 429, 500, 503, 599, 999)
ODD = ("\x1b[31mred", "a\r\n b", "é\x00", "x" * 300, "\u202e", "9" * 5000, "-1", "", '"', "W/")
AWAY = (
    *("/a.bin", "/other.bin", "//localhost:1/a.bin", "http://localhost/a.bin", "file:///nowhere", "data:,x"),
    *("https://[", "https://localhost:x/", f"https://{'a' * 70}.test/", "https:"),
)
FAMILY = """
name: test
title: A test
homepage: https://localhost/
license: CC0-1.0
cite: Nobody
layout: Bag
sensors: {lidar: Lidar}
dataset: {recording: {files: [{path: s.bag}]}, sensors: {lidar: {type: Lidar, topic: /points}}}
"""


@dataclass(frozen=True)
class Sent:
    """An answer as its client must take it.

    Attributes:
        start: Number of its first byte.
        data: Bytes of content, all that left at most.
        marks: ETag and Last-Modified.
        total: Size of the file that it told.
        ends: Whether its end was told, by its length or chunks.
    """

    start: int
    data: bytes
    marks: tuple[str | None, str | None]
    total: int | None
    ends: bool

    def covers(self, first: int, end: int, wanted: bytes) -> bool:
        """Tell whether a span of a file may be of it."""
        found = self.data[first - self.start : end - self.start]
        return self.start <= first and found == wanted[first:end]

    def contradicts(self, other: Sent) -> bool:
        """Tell whether two answers can't be of one file."""
        pairs = (*zip(self.marks, other.marks, strict=True), (self.total, other.total))
        return any(mine != theirs for mine, theirs in pairs if mine and theirs)


class Liar:
    """A server's states of a file, and its habits.

    Args:
        rng: What they are drawn from.
        versions: The file's states.
    """

    def __init__(self, rng: random.Random, versions: Sequence[bytes]) -> None:
        self.rng, self.versions = rng, versions
        self.at = self.asked = 0
        self.now = 0.0
        self.sent: list[Sent] = []
        self.known_by = rng.choice(("tag", "weak", "time", "both", "nothing", "others each time"))
        self.heeds = rng.random() < 0.7
        lies = rng.sample(FAULTS, rng.choice((0, 1, 1, 2, 3, 5)))
        lies += rng.choice(((), ("change", "cut"), ("change", "cut", "markless")))
        self.odds = {fault: rng.choice((0.1, 0.4, 0.4, 0.9)) for fault in lies}
        pages = ("", "<title>Log in\x1b</title>", "<![x[", *(page(where) for where in (*AWAY, "", "/b")))
        self.page = rng.choice(pages)

    def does(self, fault: str) -> bool:
        """Tell whether a fault is an answer's."""
        return self.rng.random() < self.odds.get(fault, 0.0)

    def marks(self) -> tuple[str | None, str | None]:
        """Return the marks of an answer, ETag and Last-Modified."""
        state = self.asked if self.known_by == "others each time" else self.at
        if self.does("markless"):
            return None, None
        if self.does("odd words"):
            return self.rng.choice(ODD), self.rng.choice((None, *ODD))
        tag, time = f'"v{state}"', f"Mon, {state % 28 + 1:02} Jan 2024 00:00:{state % 60:02} GMT"
        return {
            "weak": (f"W/{tag}", None),
            "time": (None, time),
            "both": (tag, time),
            "nothing": (None, None),
        }.get(self.known_by, (tag, None))

    def answer(self, handler: http.server.BaseHTTPRequestHandler) -> None:
        """Answer one request."""
        rng = self.rng
        is_led = "?" in handler.path
        self.asked += not is_led
        reason = rng.choice(ODD[:5]).replace("\r\n", "") if self.does("odd words") else "Well"
        if self.does("change"):
            self.at = (self.at + 1) % len(self.versions)
        if self.does("status"):
            self.head(handler, rng.choice(STATUSES), reason, {"Content-Length": "0"})
            return
        if self.does("away"):
            where = f"{rng.choice(AWAY)}?led={rng.randrange(9)}"
            status = rng.choice((301, 302, 303, 307, 308))
            self.head(handler, status, reason, {"Location": where, "Content-Length": "0"})
            return
        if not is_led and self.does("page"):
            text = self.page.encode()
            self.head(handler, 200, reason, {"Content-Type": "text/html", "Content-Length": str(len(text))})
            self.body(handler, text)
            return
        self.file(handler, reason)

    def file(self, handler: http.server.BaseHTTPRequestHandler, reason: str) -> None:
        """Answer with the file or a part of it."""
        rng, data = self.rng, self.versions[self.at]
        marks = self.marks()
        headers = {"ETag": marks[0], "Last-Modified": marks[1]}
        asked = re.fullmatch(r"bytes=(\d+)-(\d*)", handler.headers.get("Range", ""))
        condition = handler.headers.get("If-Range")
        if self.does("deaf") or (self.heeds and condition not in {None, *marks}):
            asked = None
        start, end, told = 0, len(data), 0
        if asked:
            start = told = int(asked[1])
            end = min(int(asked[2] or end) + 1, end)
            if start >= len(data):
                self.head(handler, 416, reason, {"Content-Length": "0"})
                return
            if self.does("other part"):
                start, end = sorted(rng.sample(range(len(data) + 1), 2))
                told = rng.choice((start, told))
        body = data[start:end]
        if self.does("mixed"):
            cut = rng.randrange(len(body) + 1)
            body = body[:cut] + rng.choice(self.versions)[start + cut : end]
        total, length = self.sizes(headers, told, body, is_part=asked is not None)
        if rng.random() < 0.7:
            headers["Accept-Ranges"] = "bytes"
        cuts = (0, 1, len(body) // 2, max(len(body) - 1, 0), 5000)
        cut = rng.choice(cuts) if self.does("cut") else len(body)
        is_whole = cut >= len(body)
        ends = total is not None or (length == "chunked" and is_whole)
        self.sent.append(Sent(told, body[:cut], marks, total, ends))
        self.head(handler, 206 if asked else 200, reason, headers)
        self.body(handler, body[:cut], chunked=length == "chunked", is_whole=is_whole)

    def sizes(
        self, headers: dict[str, str | None], told: int, body: bytes, *, is_part: bool
    ) -> tuple[int | None, str | None]:
        """Put sizes into an answer's headers, and return that of the file as it is told, and the length."""
        rng = self.rng
        size = len(self.versions[self.at])
        if self.does("total"):
            size = rng.choice((0, 1, size // 2, size + 1, size + 9000))
        length: str | None = str(len(body) if is_part else size)
        if self.does("length"):
            more = str(len(body) + 9)
            length = rng.choice((None, "chunked", "chunked", "-5", "", "1_0", "5, 5", "9" * 5000, more))
        if length == "chunked":
            headers["Transfer-Encoding"] = "chunked"
        else:
            headers["Content-Length"] = length
        words = length or ""
        if is_part:
            words = "*" if self.does("total") else str(size)
            if self.does("odd words"):
                words = rng.choice(("9" * 5000, "x", "-1"))
            headers["Content-Range"] = f"bytes {told}-{told + len(body) - 1}/{words}"
        return int(words) if words.isdecimal() and len(words) < 99 else None, length

    def head(self, handler: Any, status: int, reason: str, headers: dict[str, str | None]) -> None:
        """Send the head of an answer."""
        if self.does("odd words"):
            headers |= {f"X-{k}": "y" for k in range(self.rng.choice((1, 300)))}
        lines = [
            f"HTTP/1.1 {status} {reason}",
            *(f"{name}: {value}" for name, value in headers.items() if value is not None),
        ]
        handler.wfile.write("\r\n".join([*lines, "", ""]).encode("utf-8"))

    def body(self, handler: Any, data: bytes, *, chunked: bool = False, is_whole: bool = True) -> None:
        """Send content in records, and end as drawn."""
        sizes = (1, 7, 60, 1000) if self.does("records") else (1 << 14,)
        at = 0
        while at < len(data):
            size = max(self.rng.choice(sizes), len(data) // 50)
            block = data[at : at + size]
            at += size
            if self.does("slow"):
                self.now += self.rng.choice((1.0, 61.0, 4000.0))
            handler.wfile.write(b"%x\r\n%b\r\n" % (len(block), block) if chunked else block)
        if chunked and is_whole:
            handler.wfile.write(b"0\r\n\r\n")
        if not is_whole and self.rng.random() < 0.3:
            with contextlib.suppress(OSError):  # a reset instead of an end
                handler.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    @property
    def most_asked(self) -> int:
        """Return the requests that one fetch from an address may take."""
        most = max(len(sent.data) + sent.start for sent in self.sent) if self.sent else 0
        return 4 * (most // STALL_BYTES + 2) * (len(PAUSES) + 1)

    def judge(self, data: bytes, said: Sequence[str]) -> None:
        """Check a file that came without a known checksum.

        Raises:
            FaultError: It is none of this server's, or of answers that contradict each other.
        """
        cuts = sorted(
            {0, len(data)}.union(*({sent.start, sent.start + len(sent.data)} for sent in self.sent))
        )
        cuts = [cut for cut in cuts if cut <= len(data)]
        runs = [
            [sent for sent in self.sent if sent.covers(first, end, data)]
            for first, end in itertools.pairwise(cuts)
        ]
        if not data:
            runs = [[sent for sent in self.sent if not sent.total]]
        for run in runs:
            if not run:
                raise FaultError("bytes that no answer had")
            if all(sent.total not in {None, len(data)} for sent in run):
                raise FaultError(f"{len(data)} bytes, and {run[0].total} were told")
        told = [
            sent for run in runs for sent in run if sent.total is not None or (run is runs[-1] and sent.ends)
        ]
        if not told and not any("no end was told" in words for words in said):
            raise FaultError("an end that nobody told, without a word")
        for one, other in itertools.combinations(runs, 2):
            if all(mine.contradicts(theirs) for mine in one for theirs in other):
                raise FaultError(f"halves of two files: {one[0].marks}, {other[0].marks}")


class Handler(http.server.BaseHTTPRequestHandler):
    """Hands each request to the server of the case."""

    liar: ClassVar[Liar]

    def do_GET(self) -> None:
        self.close_connection = True
        with contextlib.suppress(OSError):  # who asked may be gone
            self.liar.answer(self)

    def log_message(self, *_: object) -> None:
        pass


def page(action: str) -> str:
    """Return a page that wants a confirmation."""
    field = '<input type="hidden" name="confirm" value="t">'
    return f'<title>Sure?</title>{" " * 99}<form id="download-form" action="{action}">{field}</form>'


def bag(rng: random.Random, folder: Path) -> bytes:
    """Return a small bag of random points."""
    store, path = get_typestore(Stores.ROS1_NOETIC), folder / "made.bag"
    kind = "std_msgs/msg/ByteMultiArray"
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    with Writer(path) as writer:
        connection = writer.add_connection("/points", kind, typestore=store)
        for k in range(3):
            content = np.frombuffer(rng.randbytes(rng.choice((10, 2000))), np.int8)
            message = store.types[kind](layout, content)
            writer.write(connection, k, store.serialize_ros1(message, kind))
    data = path.read_bytes()
    path.unlink()
    return data


def zipped(rng: random.Random, members: dict[str, bytes]) -> bytes:
    """Return a zip archive, now and then a broken one."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    data = bytearray(made.getvalue())
    for _ in range(rng.choice((0, 0, 0, 0, 0, 1, 3))):
        data[rng.randrange(-120, 0)] = rng.choice((0, 1, 255, rng.randrange(256)))
    return bytes(data)


def check_file(rng: random.Random, folder: Path, url: str) -> str:
    """Fetch a file, up to three times."""
    size = rng.choice((0, 1, 300, 6000, 40_000))
    sizes = [max(size + rng.choice((0, 0, 0, 1, -1, 3000)), 0) for _ in range(rng.choice((1, 2, 2, 3)))]
    liar = Handler.liar = Liar(rng, [rng.randbytes(size) for size in sizes])
    right = rng.choice(liar.versions)
    has_sum, has_size = rng.random() < 0.3, rng.random() < 0.3
    sha256 = hashlib.sha256(right).hexdigest()
    piece = rng.choice((100, 5000))
    pieces = [hashlib.sha256(right[k : k + piece]).hexdigest() for k in range(0, len(right), piece)]
    has_pieces = rng.random() < 0.2 and bool(pieces)
    urls = [f"{url}/{name}.bin" for name in rng.choice(("a", "a", "ab"))]
    wanted = WantedFile(
        *(urls, "hall", sha256 if has_sum else None, (len(right) or None) if has_size else None),
        **({"piece_bytes": piece, "pieces": pieces} if has_pieces else {}),
    )
    place, said = folder / "there", list[str]()

    def fetch() -> None:
        found = fetch_file(wanted, place, FetchProgress(notify=said.append))
        if found != hashlib.sha256(place.read_bytes()).hexdigest():
            raise FaultError("the checksum is another file's")

    if not repeated(liar, fetch, said, rng, len(urls)):
        return require_nothing(place)
    data = place.read_bytes()
    if has_sum or has_pieces:
        if data != right:
            raise FaultError("another file than its checksum's")
        return "files by their checksums"
    if wanted.size not in {None, len(data)}:
        raise FaultError(f"{len(data)} bytes, not {wanted.size}")
    liar.judge(data, ["no end was told"] if wanted.size else said)
    return "files" if data in liar.versions else "files of what nobody can tell apart"


def check_members(rng: random.Random, folder: Path, url: str) -> str:
    """Fetch members of a zip archive without the rest of it, up to three times."""
    contents = [
        {name: rng.randbytes(rng.choice((0, 50, 9000))) for name in ("s/a", "b", "s/c")} for _ in "123"
    ]
    liar = Handler.liar = Liar(rng, [zipped(rng, members) for members in contents])
    wanted, said = WantedFile([f"{url}/a.bin"], "hall"), list[str]()
    out = folder / "out"

    def fetch() -> None:
        path = fetch_members(wanted, ["s"], folder / "downloads", FetchProgress(notify=said.append))
        if path is not None:
            unpack(path, ["s"], out)

    if not repeated(liar, fetch, said, rng) or not out.exists():
        return "errors"
    known = {data for members in contents for data in members.values()}
    if other := [path for path in out.rglob("*") if path.is_file() and path.read_bytes() not in known]:
        raise FaultError(f"{other} are no version's")
    return "members"


def check_dataset(rng: random.Random, folder: Path, url: str) -> str:
    """Have a dataset of a bag, which comes as it is or in an archive of several, up to three times."""
    is_zip = rng.random() < 0.5
    bags = [bag(rng, folder) for _ in range(rng.choice((1, 2)))]
    files = [zipped(rng, {"s.bag": data, "t.bag": rng.randbytes(9000)}) for data in bags] if is_zip else bags
    liar = Handler.liar = Liar(rng, files)
    (folder / "families").mkdir()
    members = ", shared: true, members: [s.bag]" if is_zip else ""
    name = "s.zip" if is_zip else "s.bag"
    part = f'parts: {{a: {{url: "{url}/a.bin", file: {name}{members}}}}}\nsequences: {{s: }}\n'
    (folder / "families" / "test.yaml").write_text(FAMILY + part)
    os.environ[FOLDERS] = str(folder / "families")
    out, said, sums = folder / "out", list[str](), folder / "downloads" / SUMS

    def fetch() -> None:
        listener = Listener(notify=said.append)
        obtain(find_sequence("test/s"), out, "s", folder / "downloads", listener=listener)

    done = repeated(liar, fetch, said, rng, 4)
    known = [entry["sha256"] for entry in json.loads(sums.read_text()).values()] if sums.exists() else []
    if not done:
        if known:
            raise FaultError("the checksum of what became no dataset is remembered")
        return require_nothing(out)
    data = (out / "s.bag").read_bytes()
    if is_zip:
        if data not in bags:
            raise FaultError("the bag is no version's")
    else:
        liar.judge(data, said)
        if known != [hashlib.sha256(data).hexdigest()]:
            raise FaultError(f"{known} is remembered")
    return "datasets"


def repeated(
    liar: Liar, fetch: Callable[[], None], said: list[str], rng: random.Random, addresses: int = 1
) -> bool:
    """Try a few times, as by one process after another, and tell whether it was done.

    Raises:
        FaultError: Words are no sentence, or too many requests were sent.
    """
    for _ in range(rng.choice((1, 1, 2, 3))):
        before = liar.asked
        try:
            fetch()
        except SlamHiveError as error:
            require_sentence(str(error))
        else:
            return True
        finally:
            for words in said:
                require_sentence(words)
            if liar.asked - before > addresses * liar.most_asked:
                raise FaultError(f"{liar.asked - before} requests")
        if rng.random() < 0.3:
            liar.odds.clear()
    return False


def require_nothing(place: Path) -> str:
    """Check that an error has left no file behind."""
    if place.exists():
        raise FaultError(f"an error, and {place.name} is there")
    return "errors"


class Clock:
    """The time of the server of a case, in the place of the module ``time``."""

    @staticmethod
    def monotonic() -> float:
        return Handler.liar.now

    @staticmethod
    def sleep(seconds: float) -> None:
        Handler.liar.now += seconds


def main() -> int:
    """Fetch for a while, or a number of times; returns the exit code."""
    for name in ("https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY"):
        os.environ.pop(name, None)
    vars(fetching).update(PAUSES=PAUSES, STALL_BYTES=STALL_BYTES, BLOCK=1 << 12, time=Clock)
    vars(https).update(STALL_BYTES=STALL_BYTES, time=Clock)
    with tempfile.TemporaryDirectory() as folder:
        certificate, key = make_certificate(Path(folder))
        os.environ["SSL_CERT_FILE"] = str(certificate)
        with serving(Site(Path(folder)), certificate, key, handler=Handler) as site:

            def run(rng: random.Random, case: Path) -> str:
                check = rng.choice((check_file,) * 4 + (check_members, check_dataset))
                return check(rng, case, site.url)

            return run_cases((__doc__ or "").splitlines()[0], run)


if __name__ == "__main__":
    sys.exit(main())
