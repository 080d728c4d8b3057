# SPDX-License-Identifier: Apache-2.0
"""Public datasets by their names: ``slamhive dataset search``, ``list --available`` and ``add``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamhive.cli.parts.console import bytes_text, out, remark
from slamhive.cli.parts.tables import show
from slamhive.model.base import plural
from slamhive.model.sensors import ROLES, SensorMode

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from slamhive.local.home.folder import Home
    from slamhive.model.catalogue import Family
    from slamhive.model.dataset import Dataset

_GAP = 3
"""Characters between columns."""
_LEAST = 24
"""Characters below which attributes say nothing."""


def search(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="WORD…", help="Words that an entry must contain, all of them; without words, all entries."
        ),
    ] = None,
    *,
    sensors: Annotated[
        SensorMode | None, typer.Option("--sensors", help="Only entries with the sensors of this mode.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Search the catalogue of public datasets: families, sequences, sensors, attributes.

    Example: slamhive dataset search euroc machine --sensors stereo-inertial
    """
    rows = [row for row in _rows(sensors) if _is_met(row, words or [])]
    if as_json:
        typer.echo(json.dumps([row | {"sensors": list(row["sensors"])} for row in rows], indent=2))
        return
    _show(rows)
    if not rows:
        remark("the families: slamhive dataset list --available")
        return
    unverified = sorted({(str(row["family"]), str(row["unverified"])) for row in rows if row["unverified"]})
    if len(unverified) < 4:
        for family, sentence in unverified:
            remark(f"{family}: {sentence}")
    remark(f"{plural(len(rows), 'sequence')}; to have one: slamhive dataset add {rows[0]['sequence']}")


def show_available(known: Sequence[Dataset], *, as_json: bool) -> None:
    """Print all sequences of the catalogue, and as what those are known that are here.

    Args:
        known: The datasets of the home.
        as_json: Whether to print JSON.
    """
    here = {dataset.spec.catalogue: dataset.name for dataset in known if dataset.spec.catalogue}
    rows = [row | {"known": here.get(str(row["sequence"]))} for row in _rows(None)]
    if as_json:
        typer.echo(json.dumps([row | {"sensors": list(row["sensors"])} for row in rows], indent=2))
        return
    _show(rows)
    remark(f"{plural(len(rows), 'sequence')}; narrower: slamhive dataset search WORD…")


def add_sequence(title: str, name: str | None, home: Home, *, keep_archive: bool) -> tuple[Path, Dataset]:
    """Fetch a sequence of the catalogue into a home.

    Args:
        title: FAMILY/SEQUENCE.
        name: Of the dataset; None for the usual one.
        home: The home.
        keep_archive: Whether what was fetched stays.

    Returns:
        Its manifest in the home, and the dataset.
    """
    from slamhive.cli.parts.waiting import Work
    from slamhive.data.store.obtaining import Listener, obtain
    from slamhive.model.catalogue import dataset_name, find_sequence

    sequence = find_sequence(title)
    family = sequence.family
    chosen = name or dataset_name(family.name, sequence.name)
    folder = home.folder("datasets") / chosen
    remark(f"{family.title}; licence: {family.license}; {family.homepage}")
    if family.unverified:
        remark(f"not verified: {family.unverified}")
    with Work(f"fetching {title}") as work:
        listener = Listener(work.at, work.share, remark)
        downloads = home.folder("downloads")
        dataset = obtain(sequence, folder, chosen, downloads, keep_archive=keep_archive, listener=listener)
    remark(f"where results are published, cite: {family.cite}")
    return folder / "dataset.yaml", dataset


def is_title(text: str) -> bool:
    """Tell whether a text may be FAMILY/SEQUENCE."""
    family, slash, sequence = text.partition("/")
    return bool(family and slash and sequence) and "/" not in sequence and family not in {".", "..", "~"}


def _rows(mode: SensorMode | None) -> Iterator[dict[str, Any]]:
    from slamhive.model.catalogue import load_catalogue

    for name, family in sorted(load_catalogue().items()):
        if mode is None or _serves(family, mode):
            head = family.head
            shared = {
                "family": name,
                "title": head.title,
                "layout": head.layout,
                "sensors": head.sensors,
                "license": head.license,
                "homepage": head.homepage,
                "cite": head.cite,
                "unverified": head.unverified,
            }
            for sequence in family.rows:
                yield {
                    "sequence": f"{name}/{sequence}",
                    **shared,
                    "attributes": family.attributes(sequence),
                    "bytes": family.size(sequence),
                }


def _serves(family: Family, mode: SensorMode) -> bool:
    from slamhive.model.dataset import fills

    return all(fills(role, family.head.sensors) for role in ROLES[mode])


def _is_met(row: dict[str, Any], words: Sequence[str]) -> bool:
    attributes = (f"{key}: {_word(value)}" for key, value in row["attributes"].items())
    text = " ".join([row["sequence"], row["title"], *row["sensors"], *attributes]).casefold()
    return all(word.casefold() in text for word in words)


def _show(rows: Sequence[dict[str, Any]]) -> None:
    """Print a line for each sequence; on a terminal attributes are cut to what there is room for."""
    lines = [
        [
            row["sequence"],
            row.get("known") or "",
            ", ".join(row["sensors"]),
            bytes_text(row["bytes"]) if row["bytes"] else "",
            row["title"],
            ", ".join(f"{key}: {_word(value)}" for key, value in row["attributes"].items()),
        ]
        for row in rows
    ]
    headings = ["sequence", "known as", "sensors", "size", "what it is", "attributes"]
    kept = [at for at in range(len(headings)) if any(line[at] for line in lines)]
    if out.is_terminal and lines:
        taken = sum(max(len(line[at]) for line in lines) + _GAP for at in kept[:-1])
        most = max(out.width - taken, _LEAST)
        for line in lines:
            line[-1] = line[-1] if len(line[-1]) <= most else line[-1][: most - 1] + "…"
    # Rich takes half a second for a thousand lines.
    show(out, [headings[at] for at in kept], [[line[at] for at in kept] for line in lines])


def _word(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
