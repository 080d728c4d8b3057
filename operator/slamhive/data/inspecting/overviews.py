# SPDX-License-Identifier: Apache-2.0
"""Overviews of recordings as they are kept in a home: read without what makes them.

`overview` makes and keeps them; the dashboard reads them, whose workers have no room for OpenCV.
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

FOLDER = "overviews"
"""Of a home's cache."""
VERSION = 1
"""Of the form in which overviews are kept."""
_MOST_BYTES = 2**26


def kept_overview(folder: Path, name: str) -> dict[str, Any] | None:
    """Return the overview of a dataset that was kept last, None where there is none.

    Args:
        folder: Where they are kept, as ``NAME-HASH.json``.
        name: The dataset's name.
    """
    files = [path for path in folder.glob("*.json") if path.stem.rpartition("-")[0] == name]
    for path in sorted(files, key=lambda path: path.stat().st_mtime, reverse=True):
        with suppress(OSError, ValueError, AttributeError):
            with path.open("rb") as file:
                found: dict[str, Any] = json.loads(file.read(_MOST_BYTES))
            if found.get("version") == VERSION:
                return found
    return None
