# SPDX-License-Identifier: Apache-2.0
"""``slamhive results nodes``: nodes beside others of their kind, by the load of equal runs."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import Annotated

import typer
from rich.markup import escape

from slamhive.analysis.machines.nodes import NodeVerdict, compare_nodes, kind_text
from slamhive.cli.parts.choosing import Also, Sweeps, Where, choose_runs, select
from slamhive.cli.parts.console import out, remark
from slamhive.cli.parts.tables import PrintFormat, show, write_json, write_markdown
from slamhive.local.home.folder import Home
from slamhive.tables.homes import homes_beside
from slamhive_eval.formats.csv_writing import write_csv


def show_nodes(
    *,
    where: Where = None,
    sweep: Sweeps = None,
    also: Also = None,
    form: Annotated[PrintFormat, typer.Option("--format", help="How to print.")] = PrintFormat.TABLE,
) -> None:
    """Say which nodes need more CPU time than others of their kind for the same runs.

    Example: slamhive results nodes --where "started > '2026-11-01'"
    """
    # Runs of equal content are what is compared.
    selection = replace(select(sweep, None, where, superseded=False), each=True)
    frame, notes = choose_runs(
        selection, "there is nothing to compare", homes_beside(Home.from_environment(), also)
    )
    found = compare_nodes(frame)
    match form:
        case PrintFormat.JSON:
            write_json(sys.stdout, (one.as_json() for one in found.nodes))
        case PrintFormat.CSV:
            rows = [one.flat() for one in found.nodes]
            names = list(dict.fromkeys(name for row in rows for name in row))
            write_csv(sys.stdout, names, ([row.get(name) for name in names] for row in rows))
        case _:
            headings = ["node", "kind", "settings", "runs", "CPU time by others'", "95 %", "verdict"]
            lines = [
                [
                    one.node,
                    kind_text(one.kind),
                    f"{one.settings:,}",
                    f"{one.runs:,}",
                    f"{one.ratio:.3f}",
                    f"{one.low:.3f} to {one.high:.3f}" if math.isfinite(one.high) else "not known",
                    one.verdict.value,
                ]
                for one in found.nodes
            ]
            if form is PrintFormat.MARKDOWN:
                write_markdown(sys.stdout, headings, lines)
            elif lines:
                show(out, headings, lines)
            for one in found.nodes:
                if one.verdict in {NodeVerdict.SLOWER, NodeVerdict.FASTER}:
                    out.print(f"[bold]{escape(one.sentence)}[/]")
    for note in (*found.notes, *notes):
        remark(note)
