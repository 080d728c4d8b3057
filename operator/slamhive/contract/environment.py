# SPDX-License-Identifier: Apache-2.0
"""Variables that an algorithm's program is started with, on a workstation and in a pod."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "TBB_NUM_THREADS",
)
"""Variables that tell numerical libraries the number of their threads."""

SETTINGS_FOLDER = "files"
"""Folder of the run folder with the settings files that were rendered for an algorithm."""

LIBRARY_PATH = "LD_LIBRARY_PATH"
_OF_OPENCV = "/cv2/../../lib64"
"""End of what importing OpenCV's Python package puts in front of `LIBRARY_PATH`."""


def own_variables(names: Iterable[str]) -> dict[str, str]:
    """Return those of our variables that are passed on, as they were before our libraries were imported.

    An empty entry of `LIBRARY_PATH`, which stands for the working folder, goes as well: a program's working
    folder is its run folder, where what it writes itself would be taken for a library.
    """
    kept = {name: os.environ[name] for name in names if name in os.environ}
    entries = kept.pop(LIBRARY_PATH, "").split(os.pathsep)
    libraries = [entry for entry in entries if entry and not entry.endswith(_OF_OPENCV)]
    return kept | ({LIBRARY_PATH: os.pathsep.join(libraries)} if libraries else {})


def program_variables(
    *, run: str, seed: int, cores: int, home: str, scratch: str, settings_files: bool = False
) -> dict[str, str]:
    """Return the variables that every algorithm has.

    Args:
        run: its run folder.
        seed: of the run.
        cores: processors that it may use.
        home: an empty folder of its own.
        scratch: another one, for temporary files.
        settings_files: whether the algorithm has settings files.
    """
    files = {"SLAMHIVE_FILES": f"{run}/{SETTINGS_FOLDER}"} if settings_files else {}
    return {
        "SLAMHIVE_RUN": run,
        **files,
        "SLAMHIVE_SEED": str(seed),
        **dict.fromkeys(THREAD_VARIABLES, str(max(1, cores))),
        "OMP_WAIT_POLICY": "PASSIVE",  # threads that wait would count as the algorithm's CPU time
        "HOME": home,
        "TMPDIR": scratch,
        "LANG": "C.UTF-8",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONNOUSERSITE": "1",
    }
