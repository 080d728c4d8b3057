# SPDX-License-Identifier: Apache-2.0
"""``slamhive published``: numbers of papers and leaderboards that tables and charts show beside own runs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.cli.parts.console import out, remark
from slamhive.cli.parts.tables import show
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import InputError, SystemFault
from slamhive.tables.published import BUNDLED, FOLDER, check_names, published_files, read_published, table_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.analysis.metrics import Metric
    from slamhive.tables.published import Published

app = typer.Typer(no_args_is_help=True, help="Numbers of papers and leaderboards, shown beside own runs.")


@app.command("list")
def list_published(
    *, as_json: Annotated[bool, typer.Option("--json", help="Print JSON, every row.")] = False
) -> None:
    """List the published numbers that are known here.

    Example: slamhive published list
    """
    found = [(path, read_published(path)) for path in published_files(Home.from_environment().path)]
    if as_json:
        typer.echo(json.dumps([{"file": str(path)} | one.as_json() for path, one in found], indent=2))
        return
    lines = [
        [
            path.name,
            " ".join(str(part) for part in (one.source.title, one.source.venue, one.source.year) if part),
            table.place,
            str(len(table.rows)),
            _in_short(list(dict.fromkeys(row.dataset for row in table.rows))),
            "comes with slamhive" if path.parent == BUNDLED else "added",
        ]
        for path, one in found
        for table in one.tables
    ]
    show(out, ["file", "source", "place", "rows", "datasets", ""], lines)
    remark("beside own runs: slamhive results table --published")


def _in_short(names: Sequence[str]) -> str:
    """Return names, of many the first and the last one."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}, {len(names)}"


@app.command("add")
def add_published(
    source: Annotated[Path, typer.Argument(metavar="FILE", help="A YAML file of published numbers.")],
) -> None:
    """Make published numbers known: they are checked, and copied into the home.

    Example: slamhive published add leaderboard.yaml
    """
    numbers = read_published(source)
    remarks = check_names(numbers, source)
    target = Home.from_environment().folder(FOLDER) / f"{source.stem}.yaml"
    if target.exists() and target.read_bytes() != source.read_bytes():
        raise InputError(f"{target} is there and differs: remove it first, or give the file another name")
    try:
        shutil.copyfile(source, target)
    except OSError as error:
        raise SystemFault(f"{target}: {error.strerror or error}") from error
    rows = sum(len(table.rows) for table in numbers.tables)
    out.print(f"known now: {target}, {plural(rows, 'row')}", markup=False, soft_wrap=True)
    for sentence in remarks:
        remark(sentence)


def found_for(frame: Frame) -> list[Published]:
    """Return the published rows on the datasets of some runs."""
    from slamhive.tables.published import load_published, published_on

    return published_on(frame, load_published(Home.from_environment().path))


def print_published(
    found: Sequence[Published],
    metrics: Sequence[Metric],
    headed: Callable[[list[str], list[list[str]]], None],
) -> None:
    """Print published rows below a table of own runs, and why own numbers may differ.

    Args:
        found: the rows.
        metrics: what is shown.
        headed: function that prints headings and lines in the form that was asked for.
    """
    from slamhive.tables.published import differences_of
    from slamhive.tables.verdicts import RULE

    headings, lines = table_of(found, metrics)
    if not lines:
        remark("no published number is known for these datasets and metrics: slamhive published list")
        return
    out.print("\npublished, never averaged or ranked with own runs", style="bold")
    headed(headings, lines)
    remark(RULE)
    remark("why may mine differ?")
    for sentence in differences_of(found):
        remark(f"- {sentence}")
