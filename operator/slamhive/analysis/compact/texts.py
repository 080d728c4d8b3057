# SPDX-License-Identifier: Apache-2.0
"""Many different texts as one array of bytes: a UUID takes 36 bytes of it, and 93 as a text of Python's."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from slamhive.analysis.compact.growing import joined

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    Bytes = npt.NDArray[np.bytes_]
    Numbers = npt.NDArray[np.uint64]

FACTOR = 0x9E3779B97F4A7C15
"""Odd number by which values are turned to be added to marks."""

MARKS = 2**64
"""Number of different marks."""

LONG = 256
"""Bytes of a text beyond which its mark is that of its hash."""
_OVERHEAD = 57
"""Bytes that a text takes as an object beside its characters, and its place in a tuple."""
_AT_ONCE = 4096


class PackedTexts(Sequence[str]):
    """Texts of ASCII characters, each once.

    Args:
        data: the texts, (n,), none of which ends with a character 0.
    """

    def __init__(self, data: Bytes) -> None:
        self.data = data

    @classmethod
    def of(cls, texts: Sequence[str]) -> PackedTexts | None:
        """Return different texts as one array; None where they don't fit in one or take more room in it."""
        lengths = set(map(len, texts))
        longest = max(lengths, default=0)
        whole = "".join(texts)
        if not whole.isascii() or "\0" in whole or longest * len(texts) > len(whole) + _OVERHEAD * len(texts):
            return None
        if len(lengths) == 1 and longest:
            return cls(np.frombuffer(whole.encode(), dtype=f"S{longest}"))
        return cls(np.array(texts, dtype=f"S{longest or 1}"))

    def __len__(self) -> int:
        """Return the number of texts."""
        return len(self.data)

    @overload
    def __getitem__(self, place: int) -> str: ...
    @overload
    def __getitem__(self, place: slice) -> PackedTexts: ...
    def __getitem__(self, place: int | slice) -> str | PackedTexts:
        """Return the text at a place, or several."""
        found = self.data[place]
        return PackedTexts(found) if isinstance(place, slice) else bytes(found).decode()

    def __iter__(self) -> Iterator[str]:
        """Go through the texts."""
        for start in range(0, len(self.data), _AT_ONCE):
            yield from map(bytes.decode, self.data[start : start + _AT_ONCE].tolist())

    def __contains__(self, value: object) -> bool:
        """Tell whether a text is among them."""
        return bool(len(self.places(value)))

    def index(self, value: Any, start: int = 0, stop: int | None = None) -> int:
        """Return the place of a text.

        Raises:
            ValueError: it is none of them.
        """
        found = [place for place in self.places(value).tolist() if start <= place < (stop or len(self))]
        if not found:
            raise ValueError(f"{value!r} is none of the texts")
        return int(found[0])

    def order(self) -> npt.NDArray[np.intp]:
        """Return the places of the texts in their order, (n,): that of bytes is that of characters."""
        return np.argsort(self.data)

    def places(self, value: object) -> npt.NDArray[np.intp]:
        """Return the place of a text, (1,), or nothing, (0,), where it is none of them."""
        is_one = isinstance(value, str) and value.isascii() and "\0" not in value
        return np.flatnonzero(self.data == str(value).encode()) if is_one else np.empty(0, dtype=np.intp)


def fit_together(parts: Sequence[PackedTexts]) -> bool:
    """Tell whether the texts of several take no more room in one array than as objects."""
    count = sum(map(len, parts))
    longest = max((one.data.itemsize for one in parts), default=0)
    return longest * count <= sum(one.data.nbytes for one in parts) + _OVERHEAD * count


def merged(parts: Sequence[PackedTexts]) -> tuple[PackedTexts, npt.NDArray[np.int32]]:
    """Return the different texts of several, in the order of being met first, and the place of each, (n,)."""
    data = joined([one.data for one in parts])
    numbers = numbers_of_texts(data)
    ordered = np.sort(numbers)
    if not (ordered[1:] == ordered[:-1]).any():
        return PackedTexts(data), np.arange(len(data), dtype=np.int32)
    _, firsts, places = np.unique(numbers, return_index=True, return_inverse=True)
    if (data[firsts][places] != data).any():  # two texts of one number are as good as impossible
        _, firsts, places = np.unique(data, return_index=True, return_inverse=True)
    ranks = np.empty(len(firsts), dtype=np.int32)
    ranks[np.argsort(firsts)] = np.arange(len(firsts), dtype=np.int32)
    return PackedTexts(data[np.sort(firsts)]), ranks[places]


def short(text: bytes) -> bytes:
    """Return a text, or the hash of a long one: all of them are laid out as long as the longest."""
    return text if len(text) <= LONG else hashlib.sha256(text).digest()


def numbers_of_texts(texts: Bytes) -> Numbers:
    """Return a number for each text, the same in every process, of its words of 8 bytes: of many at once."""
    width = -(-texts.dtype.itemsize // 8) or 1
    padded = np.ascontiguousarray(texts.astype(f"S{8 * width}", copy=False))
    words = padded.view(np.uint64).reshape(len(texts), width)
    total = np.char.str_len(texts).astype(np.uint64)
    for place in range(width):
        turned = (words[:, place] ^ (words[:, place] >> np.uint64(31))) * np.uint64(FACTOR)
        total += turned * np.uint64(pow(FACTOR, 2 * place + 1, MARKS))
    found: Numbers = total ^ (total >> np.uint64(29))
    return found
