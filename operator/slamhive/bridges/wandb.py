# SPDX-License-Identifier: Apache-2.0
"""Weights & Biases: offline runs, which ``wandb sync`` sends."""

from __future__ import annotations

import json
import os
import re
import shutil
from typing import TYPE_CHECKING, Any

from slamhive.archive.remarks import split
from slamhive.bridges.gathering import FittedNames
from slamhive.model.canonical import digest as digest_of
from slamhive.model.extras import library

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.bridges.gathering import Handed
    from slamhive.bridges.places import Here

NEXT = "wandb sync {folder}/wandb/offline-run-*"
MARK = "slamhive.json"
_MOST_TAG = 64


class Writer:
    """Writes runs into one folder; those that are there as they are now stay.

    Args:
        folder: where wandb makes its folder ``wandb``.

    Attributes:
        names: wandb takes all.
    """

    names = FittedNames(str)

    def __init__(self, folder: Path, _source: Here) -> None:
        os.environ.setdefault("WANDB_ERROR_REPORTING", "false")
        self._wandb = library("wandb", "wandb", "--to wandb")
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def write(self, run: Handed) -> bool:
        """Write a run; tell whether anything was new."""
        number = digest_of(run.uid)[:16]
        digest = run.digest()
        there = sorted((self._folder / "wandb").glob(f"offline-run-*-{number}"))
        if [_written(path) for path in there] == [digest]:
            return False
        for path in there:
            shutil.rmtree(path)
        made = self._wandb.init(
            mode="offline",
            dir=str(self._folder),
            id=number,
            name=run.name,
            project=re.sub(r"[/\\#?%:]+", "-", run.sweep)[:128],
            group=run.sweep,
            job_type=run.tags.get("algorithm"),
            notes=run.tags.get("note"),
            tags=_tags(run),
            config={"settings": run.settings, "tags": run.tags, "files": run.files},
            reinit="create_new",
            # Nothing of this machine goes along.
            settings=self._wandb.Settings(
                silent=True,
                console="off",
                disable_code=True,
                disable_git=True,
                save_code=False,
                x_disable_meta=True,
                x_disable_stats=True,
                x_save_requirements=False,
            ),
        )
        try:
            for row in range(len(run.series.get("t", ()))):
                t = run.series["t"][row]
                usage = {"cpu_cores": run.series["cpu"][row], "memory_bytes": run.series["memory"][row]}
                made.log({"t": t, "usage": usage}, step=round(t * 1000))
            for name, value in run.figures.items():
                made.summary[name] = value
            folder = self._folder / "wandb" / re.sub(r"/files$", "", made.dir).rpartition("/")[2]
        finally:
            made.finish(exit_code=int(run.failed))
        mark = json.dumps({"uid": run.uid, "digest": digest})
        (folder / MARK).write_text(mark, encoding="utf-8")
        return True

    def close(self) -> None:
        """End wandb's own service."""
        self._wandb.teardown()


def _tags(run: Handed) -> list[str]:
    words = ("sweep", "dataset", "repetition", "uid")
    own = [f"{word}:{run.tags[word]}"[:_MOST_TAG] for word in words if word in run.tags]
    return [*own, *split(run.tags.get("tags"))]


def _written(folder: Path) -> Any:
    try:
        return json.loads((folder / MARK).read_text(encoding="utf-8"))["digest"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
