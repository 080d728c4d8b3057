# SPDX-License-Identifier: Apache-2.0
"""``slamhive schema``: JSON Schemas of manifests, for editors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamhive.cli.parts.console import out
from slamhive.model.errors import InputError, sentence


def schema(
    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="[KIND]",
            help="Algorithm, Dataset, Evaluation, MappingRun or Sweep; without one, a schema for all.",
        ),
    ] = None,
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Write files into this folder; without KIND, all of them."
        ),
    ] = None,
) -> None:
    """Print the JSON Schema of a kind, by which an editor completes and checks manifests.

    Example: slamhive schema -o schemas
    """
    from slamhive.model.schemas import ANY, editor_line, schema_names, text, write
    from slamhive.model.schemas import schema as made

    made(kind or ANY)
    if output is None:
        typer.echo(text(kind or ANY), nl=False)
        return
    try:
        files = write(output, [kind] if kind else schema_names())
    except OSError as error:
        raise InputError(f"--output: {sentence(error)}") from None
    for path in files:
        out.print(str(path), soft_wrap=True, markup=False)
    line = editor_line(str(files[-1].absolute())).strip()
    out.print(f"Next:  {line}   as the first line of a manifest", soft_wrap=True, markup=False)
