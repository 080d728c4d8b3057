# SPDX-License-Identifier: Apache-2.0
"""``slamhive view``: a run in Rerun's viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamhive.cli.onerun import find_run
from slamhive.cli.parts.console import out, remark
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError


def view(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Name, UID or label run of a run.")],
    *,
    save: Annotated[
        Path | None, typer.Option("--save", metavar="FILE.rrd", help="Write a file, open no viewer.")
    ] = None,
) -> None:
    """Show a run in Rerun's viewer: truth, estimate, error, images and usage over time.

    Example: slamhive view demo-3f2a --save run.rrd
    """
    from slamhive.bridges.places import Here
    from slamhive.bridges.view import view as show

    home = Home.from_environment()
    if save is not None and (save.exists() or not save.absolute().parent.is_dir()):
        why = "is there already; nothing is overwritten" if save.exists() else "its folder is not there"
        raise InputError(f"--save: {save}: {why}")
    with Here.open(home.archive_url, home.path) as here:
        notes = show(find_run(here.archive, run, "RUN"), here, save)
    for note in notes:
        remark(note)
    if save is not None:
        out.print(f"wrote {save}\nNext:  rerun {save}", soft_wrap=True, markup=False)
