# SPDX-License-Identifier: Apache-2.0
"""Lists of images in foreign layouts: a stamp and the name of a file in each line.

They stand between commas, semicolons or white space, comments begin with ``#``, and a first line without a
number is a heading. What follows a name in its line, such as an exposure time, is passed over.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.data.importers.tables import nanoseconds, rows
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers.tables import Unit

    Stamps = npt.NDArray[np.int64]

_SHOWN = 3
"""Missing images that a note names."""


class Images(NamedTuple):
    """The images that a list names.

    Attributes:
        stamps: ns, ascending, shape (n,).
        files: The image of each, n.
        notes: Sentences on what is missing or out of order.
    """

    stamps: Stamps
    files: list[Path]
    notes: list[str]


def read_images(path: Path, folder: Path, unit: Unit) -> Images:
    """Read a list of images.

    Args:
        path: The list.
        folder: Where names start from.
        unit: Of its stamps.

    Raises:
        DataError: It is missing, damaged or empty, or more than half of its images don't exist.
    """
    if not path.is_file():
        raise DataError(f"{path} does not exist")
    stamps, files = array("q"), []
    missing: list[tuple[int, Path]] = []
    for line, words in rows(path):
        try:
            stamp = nanoseconds(words[0], unit)
        except ValueError as error:
            if not (stamps or missing):
                continue
            raise DataError(f"{path}, line {line}: {error}") from None
        if stamp < 0 or len(words) < 2:
            raise DataError(f"{path}, line {line}: a stamp and the name of an image are needed")
        image = _image(folder, words[1:])
        if image is not None:
            stamps.append(stamp)
            files.append(image)
        else:
            missing.append((line, folder / " ".join(words[1:])))
    if not stamps and not missing:
        raise DataError(f"{path}: no rows in it")
    if len(missing) > len(files):
        line, image = missing[0]
        raise DataError(
            f"{path}, line {line}: {image} does not exist, nor do {len(missing) - 1} others of the "
            f"{len(missing) + len(files)} images that it lists: is the archive unpacked whole?"
        )
    notes = []
    if missing:
        names = ", ".join(image.name for _, image in missing[:_SHOWN])
        more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        notes.append(
            f"{path}: {len(missing)} of {len(missing) + len(files)} images do not exist and are left out: "
            f"{names}{more}"
        )
    times, order, unsorted = _in_order(np.frombuffer(stamps, dtype=np.int64), path)
    return Images(times, files if order is None else [files[k] for k in order.tolist()], notes + unsorted)


def _image(folder: Path, words: list[str]) -> Path | None:
    """Return the file that the words after a stamp begin with: names may have spaces, lines more columns."""
    paths = (folder / " ".join(words[:count]) for count in range(len(words), 0, -1))
    return next((path for path in paths if path.is_file()), None)


def _in_order(stamps: Stamps, path: Path) -> tuple[Stamps, npt.NDArray[np.intp] | None, list[str]]:
    """Return stamps in the order of time; where each was, and a note, if they weren't."""
    back = int(np.count_nonzero(np.diff(stamps) < 0))
    if not back:
        return stamps, None, []
    order = np.argsort(stamps, kind="stable")
    return (
        stamps[order],
        order,
        [f"{path}: {back} rows are stamped before the one above them; sorted by time"],
    )
