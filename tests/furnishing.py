# SPDX-License-Identifier: Apache-2.0
"""Homes with the small dataset and the actor."""

from __future__ import annotations

import shutil
from pathlib import Path

ACTOR = Path(__file__).parent / "actor"


def furnish(folder: Path, environments: Path, tiny: Path) -> Path:
    """Make a home with the small dataset and the actor, which knows its ground truth."""
    actor = folder / "algorithms" / "actor"
    actor.mkdir(parents=True)
    (folder / "environments").symlink_to(environments)
    (folder / "datasets").symlink_to(tiny)
    for name in ("algorithm.yaml", "adapter.py", "requirements.txt"):
        shutil.copyfile(ACTOR / name, actor / name)
    truth = next(tiny.glob("tiny-*/groundtruth.txt")).read_text()
    (actor / "truth.txt").write_text("".join(line + "\n" for line in truth.splitlines() if line[0] != "#"))
    return folder
