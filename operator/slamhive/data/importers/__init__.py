# SPDX-License-Identifier: Apache-2.0
"""Importers of recordings in foreign layouts: each finds what there is, one conversion makes datasets of it.

A module for each layout has a function that reads it into `Contents`; `LAYOUTS` names them. Modules are
loaded when they are needed, as they bring OpenCV along.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

from slamhive.data.importers import conversion
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from slamhive.data.importers.contents import Contents
    from slamhive.model.dataset import Dataset


class ImportOptions(NamedTuple):
    """Options of an import that the folder itself doesn't tell: the sequence, a file of relations.

    Attributes:
        sequence: Which of several sequences in one folder.
        relations: File of relations, as ground truth of a CARMEN log.
    """

    sequence: str | None = None
    relations: Path | None = None


class LayoutModule(Protocol):
    """Interface of a layout's module: it recognises a folder or file, and reads its contents."""

    TITLE: str
    """Name of what is imported, for lists: "a folder in EuRoC's layout (mav0/)"."""

    def recognises(self, source: Path) -> bool:
        """Tell by the names of files alone whether something is in this layout."""

    def read(self, source: Path, options: ImportOptions) -> Contents:
        """Read what there is.

        Raises:
            DataError: Something is missing or damaged; names the file.
        """


LAYOUTS = {
    "Euroc": "euroc",
    "TumRgbd": "tum_rgbd",
    "Kitti": "kitti",
    "KittiRaw": "kitti_raw",
    "MulRan": "mulran",
    "HeLiPR": "helipr",
    "Boreas": "boreas",
    "TartanAir": "tartanair",
    "Replica": "replica",
    "Nclt": "nclt",
    "Carmen": "carmen",
}
"""Modules by the names of their layouts, as catalogues name them, in the order in which they are tried."""


def layout_module(layout: str) -> LayoutModule:
    """Return the module of a layout.

    Raises:
        InputError: There is none of that name.
    """
    if layout not in LAYOUTS:
        raise InputError(f"unknown layout {layout!r}; known: {', '.join(LAYOUTS)}")
    return cast("LayoutModule", import_module(f"{__name__}.{LAYOUTS[layout]}"))


def layout_of(source: Path) -> str | None:
    """Return the layout that a folder or file is in, None where none is known."""
    return next((layout for layout in LAYOUTS if layout_module(layout).recognises(source)), None)


def import_recording(
    source: Path,
    out: Path,
    name: str,
    layout: str,
    *,
    options: ImportOptions | None = None,
    progress: Callable[[float], None] | None = None,
    also: Mapping[str, Any] | None = None,
) -> tuple[Dataset, list[str]]:
    """Turn a recording in a foreign layout into a dataset.

    Args:
        source: The folder or file.
        out: Folder to make: dataset.yaml, recording.bag and the file of the ground truth.
        name: Name of the dataset.
        layout: One of `LAYOUTS`.
        options: What isn't in the folder itself.
        progress: Called with the share that is done, 0 to 1, now and then.
        also: What the manifest's spec has beside what is found, plain values; it comes first.

    Returns:
        The dataset that is in the folder now, and sentences about what was assumed or left out.

    Raises:
        DataError: Something in the source is missing or damaged.
        InputError: The folder to make exists, or the layout is unknown.
    """
    contents = layout_module(layout).read(source, options or ImportOptions())
    return conversion.convert(contents, out, name, progress, also), contents.notes
