# SPDX-License-Identifier: Apache-2.0
"""The algorithm's own numbers in output/metrics.json: how the file is read, and which values are kept.

The supervisor and the sidecar read the file with `read_metrics`. What they kept travels in a message that the
algorithm's user could have written, so the operator applies `keep_values` to it once more.
"""

from __future__ import annotations

import json
import math
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.contract.files import memory_bounded, open_regular
from slamhive.contract.lines import printable

if TYPE_CHECKING:
    from collections.abc import Mapping

FILE_BYTES = 4 << 20
"""Of metrics.json."""
MOST_VALUES = 64
MOST_BYTES = 2048
"""Of all that is kept, as JSON: it goes into the monitor's termination message beside all else."""
LONGEST_NAME = 100
LONGEST_TEXT = 200
DEEPEST = 8
LARGEST_INTEGER = 1 << 53
"""Beyond, a reader of JSON may take another number for it."""

_NAME = "output/metrics.json"
_READING_MEMORY = 32 << 20
_FRAMES = {"offered": "framesOffered", "processed": "framesProcessed", "dropped": "framesDropped"}
# What a number counts, however many digits it has: which values fit must not depend on their digits, or the
# repetitions of a run would have different columns.
_NUMBER_BYTES = 24
_SHOWN_NAMES = 3
_SHOWN_CHARACTERS = 40


class AlgorithmMetrics(NamedTuple):
    """Contents of an algorithm's metrics.json, with a note where the file can't be used.

    Attributes:
        values: Its object, empty if there is none.
        note: What was wrong with the file, None if nothing was.
    """

    values: Mapping[str, Any]
    note: str | None = None


class Kept(NamedTuple):
    """Values of metrics.json that are recorded, with a note on those that were left out.

    Attributes:
        values: Numbers, flags and texts, also in objects.
        note: A sentence about what was left out, None if nothing was.
    """

    values: dict[str, Any]
    note: str | None = None


def read_metrics(output_directory: str, *, bounded: bool = True) -> AlgorithmMetrics:
    """Read metrics.json; whatever is there, this neither fails nor waits.

    Args:
        output_directory: Where it is.
        bounded: Whether reading it may not take more than its share of memory. The bound holds for all of the
            process, so that one with threads does without.
    """
    bound = memory_bounded(_READING_MEMORY) if bounded else nullcontext()
    try:
        with open_regular(f"{output_directory}/metrics.json") as descriptor, bound:
            with open(descriptor, "rb", closefd=False) as file:
                data = file.read(FILE_BYTES + 1)
            values = json.loads(data) if len(data) <= FILE_BYTES else None
    except FileNotFoundError:
        return AlgorithmMetrics({})
    except (OSError, ValueError, RecursionError, MemoryError):
        values = None
    if not isinstance(values, dict):
        return AlgorithmMetrics(
            {}, f"{_NAME} is no JSON object of at most {FILE_BYTES >> 20} MiB and was ignored"
        )
    return AlgorithmMetrics(values)


def frame_counts(metrics: AlgorithmMetrics, offered: int | None) -> dict[str, int | None]:
    """Return the numbers of frames offered, processed and dropped, as the algorithm counted.

    Args:
        metrics: What metrics.json holds.
        offered: Frames of its recording, for an algorithm that doesn't count them; None: nobody knows.
    """
    found = {name: metrics.values.get(key) for name, key in _FRAMES.items()}
    counts = {name: count if _is_count(count) else None for name, count in found.items()}
    return {**counts, "offered": counts["offered"] or offered}


def keep_values(values: Mapping[str, Any]) -> Kept:
    """Return the values of an algorithm's that are recorded; those that are kept are kept again as they are.

    Kept are finite numbers, flags and texts of one line, also in objects in objects, in the order of the file
    as long as they fit. A value of null says nothing and is passed over.
    """
    keeping = _Keeping()
    return Kept(keeping.object(values, "", 0, 0), keeping.note())


def is_number(value: Any) -> bool:
    """Tell whether a value of JSON is a number that everyone who reads it takes for the same."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= LARGEST_INTEGER if isinstance(value, int) else math.isfinite(value)


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and is_number(value) and value >= 0


class _Keeping:
    """The values kept so far, as far as what comes next depends on them."""

    def __init__(self) -> None:
        self._count = 0
        self._bytes = 2  # the braces around everything
        self._left_out: list[str] = []
        self._more = 0

    def object(self, values: Mapping[str, Any], prefix: str, depth: int, waiting: int) -> dict[str, Any]:
        """Return the values of an object that are kept.

        Args:
            values: The object.
            prefix: What its names follow in a sentence.
            depth: How many objects it is in.
            waiting: Bytes that its first value adds to its own: names and braces of the objects around it.
        """
        kept: dict[str, Any] = {}
        for name, value in values.items():
            if value is None:
                continue
            shown = f"{prefix}{name}"
            problem = _problem(name, value, depth)
            if problem is not None:
                self._leave_out(shown, problem)
                continue
            size = _size(name) + 2
            if isinstance(value, dict):
                inner = self.object(value, f"{shown[:_SHOWN_CHARACTERS]}.", depth + 1, waiting + size + 2)
                if not inner:
                    continue
                kept[name] = inner
            else:
                size += waiting + (_size(value) if isinstance(value, str | bool) else _NUMBER_BYTES)
                if self._count >= MOST_VALUES:
                    self._leave_out(shown, f"more than {MOST_VALUES} values")
                    continue
                if self._bytes + size > MOST_BYTES:
                    self._leave_out(shown, f"more than {MOST_BYTES >> 10} KiB")
                    continue
                kept[name] = value
                self._count += 1
                self._bytes += size
            waiting = 0
        return kept

    def note(self) -> str | None:
        """Return the sentence about what was left out."""
        if not self._left_out:
            return None
        more = f" and {self._more} more" if self._more else ""
        return f"{_NAME}: left out {', '.join(self._left_out)}{more}"

    def _leave_out(self, name: str, problem: str) -> None:
        if len(self._left_out) < _SHOWN_NAMES:
            shown = printable(name[:_SHOWN_CHARACTERS]) + "…" * (len(name) > _SHOWN_CHARACTERS)
            self._left_out.append(f"{shown} ({problem})")
        else:
            self._more += 1


def _problem(name: str, value: Any, depth: int) -> str | None:
    """Return the reason not to keep a value, wherever it stands, None where it can be kept."""
    if not 0 < len(name) <= LONGEST_NAME or not name.isprintable():
        return f"a name must have 1 to {LONGEST_NAME} printable characters"
    if isinstance(value, dict):
        return None if depth < DEEPEST else f"nested deeper than {DEEPEST}"
    if isinstance(value, str):
        sound = len(value) <= LONGEST_TEXT and value.isprintable()
        return None if sound else f"a text must have one line of at most {LONGEST_TEXT} printable characters"
    if isinstance(value, bool) or is_number(value):
        return None
    if isinstance(value, int):
        return "beyond 2^53"
    return "no finite number" if isinstance(value, float) else "a list"


def _size(value: Any) -> int:
    return len(json.dumps(value, ensure_ascii=False).encode())
