# SPDX-License-Identifier: Apache-2.0
"""Options by which reports, tables and figures choose runs, and the runs that they mean."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.analysis import Selection, choose
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError
from slamhive.tables.homes import read_homes
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.reporting.presets import Preset
    from slamhive.tables.homes import Beside

Where = Annotated[
    str | None,
    typer.Option(metavar="EXPR", help='Only rows that meet it, as in "run in (126, 141) and scale < 1".'),
]
Sweeps = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="Only runs of this sweep; may be repeated.")
]
EvaluationName = Annotated[
    str | None, typer.Option(metavar="NAME", help="Only this evaluation, such as se3 or sim3.")
]
Superseded = Annotated[
    bool, typer.Option("--superseded", help="Results of earlier versions too: of an edited algorithm, …")
]
Output = Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write to a file.")]

Also = Annotated[
    list[str] | None,
    typer.Option(
        "--also",
        metavar="[LABEL=]PATH",
        help="Add the runs of another home, under its label; may be repeated. Default: what "
        "$SLAMHIVE_ALSO names.",
    ),
]


def select(
    sweep: list[str] | None,
    evaluation: str | None,
    where: str | None,
    given: Preset | None = None,
    *,
    superseded: bool,
) -> Selection:
    """Return the selection of a command's options, together with that of a published table."""
    conditions = [text for text in (given.where if given else None, where) if text and text.strip()]
    both = " and ".join(f"({text})" for text in conditions) if len(conditions) > 1 else "".join(conditions)
    chosen = evaluation if evaluation is not None else given.evaluation if given else None
    return Selection(tuple(sweep or ()), chosen, both or None, superseded=superseded)


def choose_runs(
    selection: Selection, otherwise: str, also: Sequence[Beside] = ()
) -> tuple[Frame, tuple[str, ...]]:
    """Return the selected rows, and sentences on what is left out.

    Args:
        selection: what is meant.
        otherwise: what can't be done where there is none.
        also: other homes.

    Raises:
        InputError: there are none.
    """
    home = Home.from_environment()
    found = read_homes(home, also) if also else read_archive(home.archive_url, home.path / "cache")
    chosen = choose(found, selection)
    if not len(chosen.frame):
        raise InputError("; ".join(chosen.notes) or f"no run is meant: {otherwise}")
    return chosen.frame, chosen.notes
