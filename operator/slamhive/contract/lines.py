# SPDX-License-Identifier: Apache-2.0
"""Lines of a text that an algorithm wrote, in blocks, with little memory and faults that name the line."""

from __future__ import annotations

import os
import re
from contextlib import contextmanager
from itertools import islice
from typing import IO, TYPE_CHECKING

from slamhive.contract.files import compression_problem, open_below, open_folder

if TYPE_CHECKING:
    from collections.abc import Iterator

LIMIT_BYTES = 512 << 20
"""Of a file with poses."""
BLOCK_BYTES = 128 << 10
_LONGEST_LINE = 64 << 10
_SHOWN_CHARACTERS = 30
_LOOKED_AT, _NAMED = 1000, 3
"""Files of an output folder that are looked at for one that is missing, and that are named."""
_TRACEBACK = re.compile(
    r"(Traceback|Current thread|Thread)\b.*\(most recent call (last|first)\)|Extension modules: |"
    r"During handling of the above exception, another|The above exception was the direct cause"
)
# What a C++ program ends with: "terminate called after throwing an instance of 'E'", and beneath it
# "  what():  …", which is the reason.
_WHAT = re.compile(r"\s+what\(\): ")
# "[ WARN] [1600000000.5]: …" of roscpp, "[WARN] [1600000000.500000]: …" of rospy, and ROS 2's
# "[WARN] [1600000000.500000000] [node]: …".
_REPORT = re.compile(r"\[ *(DEBUG|INFO|WARN|WARNING)\] ?\[[^\]]*\]")
_KNOWN = {
    *("trajectory.txt", "trajectory.online.txt", "trajectory.keyframes.txt"),
    *("metrics.json", "segments.csv", "health.csv", "covariances.csv"),
}


class TextFault(Exception):  # noqa: N818 - never seen outside
    """Fault in a text that an algorithm wrote, as a sentence that names the text."""

    @classmethod
    def at(cls, name: str, message: str, line: int | None = None) -> TextFault:
        """Return the fault of a file, or of a line of it."""
        return cls(f"{name if line is None else f'{name}, line {line}'}: {message}")


def named(relative: str) -> str:
    """Return the name of a file of the output folder in sentences."""
    return f"output/{relative}"


def missing(relative: str) -> str:
    """Return the sentence on a file of the output folder that isn't there."""
    return f"{named(relative)} is missing or not a regular file"


def absent(output_directory: str, relative: str) -> str:
    """Return the sentence on missing poses: a program may have written them to another name.

    Args:
        output_directory: Where the program wrote.
        relative: The file's path there.
    """
    sentence = missing(relative)
    others = _files(output_directory)
    if not others:
        return sentence
    some = ", ".join(shown(os.fsencode(name)) for name in others[:_NAMED])
    more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
    return f"{sentence}; beside it: {some}{more} (an Algorithm says in output.trajectory where its poses are)"


def _files(folder: str) -> list[str]:
    """Return the files of a folder that have none of the contract's names, some of very many."""
    try:
        descriptor = open_folder(folder)
        try:
            with os.scandir(descriptor) as entries:
                some = islice(entries, _LOOKED_AT)
                return sorted(
                    one.name for one in some if one.name not in _KNOWN and one.is_file(follow_symlinks=False)
                )
        finally:
            os.close(descriptor)
    except OSError:  # it may be gone, or closed to us
        return []


def telling_line(text: str) -> str:
    """Return the last line of a log that says something, empty if none does.

    Lines of source that a traceback ends with where its program was killed say nothing by themselves, even
    where there is nothing else. Other lines that are set in, and a ROS node's reports, which tell of what it
    met before, count where there is nothing else.
    """
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    telling = [line for line in lines if _tells(line)]
    words = [line for line in telling if not is_report(line)]
    rest = [] if any(map(_TRACEBACK.match, lines)) else lines
    return (words or telling or rest or [""])[-1].strip()


def _tells(line: str) -> bool:
    return not (line[0].isspace() or _TRACEBACK.match(line)) or _WHAT.match(line) is not None


def is_report(line: str) -> bool:
    """Tell whether a line is a ROS node's, of a level below error: of its work, not of its end."""
    return _REPORT.match(line) is not None


@contextmanager
def opened_text(output_directory: str, relative: str, limit: int = LIMIT_BYTES) -> Iterator[IO[bytes]]:
    """Open a text that an algorithm wrote.

    Args:
        output_directory: Where it wrote.
        relative: The file's path there.
        limit: Bytes it may have.

    Yields:
        The file.

    Raises:
        FileNotFoundError: There is nothing.
        NotRegularError: It is something else than a file, or a link leads there.
        TextFault: It is too large, or compressed.
        OSError: It can't be read.
    """
    name = named(relative)
    with open_below(output_directory, relative) as descriptor:
        if os.fstat(descriptor).st_size > limit:
            raise TextFault(f"{name} is larger than {limit >> 20} MiB")
        if problem := compression_problem(descriptor, name):
            raise TextFault(problem)
        with open(descriptor, "rb", closefd=False) as file:
            yield file


def blocks(text: IO[bytes], name: str, meaning: str, limit: int = LIMIT_BYTES) -> Iterator[list[bytes]]:
    """Give a text's lines in blocks; lines end as they do on any system.

    Args:
        text: Where it begins.
        name: What sentences call it.
        meaning: What a line holds.
        limit: Bytes it may have.

    Raises:
        TextFault: It is no text, too large, or a line has no end.
    """
    rest = text.read(3).removeprefix(b"\xef\xbb\xbf")
    total = line = 0
    while block := text.read(BLOCK_BYTES):
        total += len(block)
        if total > limit:
            raise TextFault.at(name, f"is larger than {limit >> 20} MiB")
        data = rest + block
        if b"\0" in data:
            raise TextFault.at(name, "is no text file (it holds zero bytes)")
        if b"\r" in data:
            # A carriage return at the end may be half of a line's end.
            data, half = (data[:-1], b"\r") if data.endswith(b"\r") else (data, b"")
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") + half
        *lines, rest = data.split(b"\n")
        line += len(lines)
        if len(rest) > _LONGEST_LINE:
            raise TextFault.at(name, f"is longer than {_LONGEST_LINE >> 10} KiB; {meaning}", line + 1)
        yield lines
    if b"\0" in rest:
        raise TextFault.at(name, "is no text file (it holds zero bytes)")
    yield rest.replace(b"\r", b"\n").split(b"\n")


def number(word: bytes) -> float | None:
    """Return the number that a word writes, None where it writes none."""
    try:
        return None if b"_" in word else float(word)
    except ValueError:
        return None


def printable(text: str) -> str:
    """Return a text as one line that moves no terminal's cursor and turns no line around.

    It may come from a server, a program or somebody else's archive.
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() else " " if letter.isspace() else "\N{REPLACEMENT CHARACTER}"
        for letter in text
    )


def shown(word: bytes) -> str:
    """Return a word as a sentence shows it."""
    text = word[:200].decode("utf-8", "replace")
    return repr(text if len(text) <= _SHOWN_CHARACTERS else text[:_SHOWN_CHARACTERS] + "…")
