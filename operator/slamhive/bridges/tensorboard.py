# SPDX-License-Identifier: Apache-2.0
"""TensorBoard: a folder of event files a run, with its settings and figures in the table HPARAMS."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.bridges.gathering import FittedNames, plain
from slamhive.contract.lines import printable
from slamhive.model.extras import library

if TYPE_CHECKING:
    from slamhive.bridges.gathering import Handed
    from slamhive.bridges.places import Here

MARK = "slamhive.json"
NEXT = "tensorboard --logdir {folder}"


class Writer:
    """Writes runs into one folder; those that are there as they are now stay.

    Args:
        folder: the folder.

    Attributes:
        names: those of figures that TensorBoard would replace, two by one name.
    """

    def __init__(self, folder: Path, _source: Here) -> None:
        self.names = FittedNames(lambda name: re.sub(r"[^-/\w.]", "_", name).lstrip("/"), settings=False)
        self._library = library("tensorboardX", "tensorboard", "--to tensorboard")
        self._folder = folder

    def write(self, run: Handed) -> bool:
        """Write a run; tell whether anything was new."""
        target = self._folder / plain(run.sweep) / run.short
        digest = run.digest()
        if _written(target) == digest:
            return False

        target.parent.mkdir(parents=True, exist_ok=True)
        # Aside, so that a run is there whole or not at all.
        aside = Path(tempfile.mkdtemp(prefix=f".{run.short}.", dir=target.parent))
        try:
            self._fill(aside, self.names.fitted(run))
            (aside / MARK).write_text(json.dumps({"uid": run.uid, "digest": digest}), encoding="utf-8")
            shutil.rmtree(target, ignore_errors=True)
            aside.chmod(0o755)
            aside.rename(target)
        except BaseException:
            shutil.rmtree(aside, ignore_errors=True)
            raise
        return True

    def close(self) -> None:
        """Nothing is open between two runs."""

    def _fill(self, folder: Path, run: Handed) -> None:
        from tensorboardX.summary import hparams  # noqa: PLC0415 - an extra

        with self._library.SummaryWriter(str(folder), flush_secs=3600) as writer:
            end = run.finished or run.began
            settings = {name: value for name, value in run.settings.items() if value != ""}
            experiment, begin, done = hparams(settings, run.figures)
            for summary in (experiment, begin, done):
                writer.file_writer.add_summary(summary, walltime=run.began)
            for name, value in run.figures.items():
                writer.add_scalar(name, value, 0, walltime=end)
            for number, t in enumerate(run.series.get("t", ())):
                # A step is a millisecond since the start.
                step, moment = round(t * 1000), run.began + t
                writer.add_scalar("usage/cpu_cores", run.series["cpu"][number], step, walltime=moment)
                writer.add_scalar("usage/memory_bytes", run.series["memory"][number], step, walltime=moment)
            cells = {name: printable(value).replace("|", "\\|") for name, value in sorted(run.tags.items())}
            tags = "\n".join(f"| {name} | {cell} |" for name, cell in cells.items())
            writer.add_text("tags", f"| tag | |\n|---|---|\n{tags}", 0, walltime=end)
            files = "\n".join(f"- {path}" for path in run.files)
            writer.add_text("files", files or "none here", 0, walltime=end)


def _written(target: Path) -> str | None:
    try:
        return str(json.loads((target / MARK).read_text(encoding="utf-8"))["digest"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
