# SPDX-License-Identifier: Apache-2.0
"""``slamhive submission``: runs as the archive that a public challenge wants."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from slamhive.analysis.selection import Selection
from slamhive.cli.parts.choosing import Sweeps, Where, choose_runs
from slamhive.cli.parts.console import open_workbench, out, remark
from slamhive.cli.parts.tables import show, write_json
from slamhive.cli.parts.waiting import Work
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.reporting.submission import (
    Challenge,
    Pick,
    SubmissionFile,
    by_sequence,
    find_challenge,
    make_entry,
    missing_sequences,
    write_archive,
)


def submission(
    challenge: Annotated[str, typer.Argument(metavar="CHALLENGE", help="kitti, hilti2022 or hilti2023.")],
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Archive to write, .zip.")],
    sweep: Sweeps = None,
    algorithm: Annotated[
        str | None, typer.Option(metavar="NAME", help="Only runs of this algorithm.")
    ] = None,
    where: Where = None,
    repetition: Annotated[
        Pick, typer.Option(help="Which repetition: the first, the one of least or of median ATE.")
    ] = Pick.FIRST,
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="DATASET=SEQUENCE", help="Name of a dataset in the challenge; may be repeated."),
    ] = None,
    partial: Annotated[
        bool, typer.Option("--partial", help="Write it although sequences are missing.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write the ZIP archive for a challenge: one run for each sequence, checked, in the right format.

    Example: slamhive submission kitti --sweep odometry --algorithm kiss-icp -o kiss-icp.zip
    """
    wanted = find_challenge(challenge)
    if output.exists():
        raise InputError(f"--output: {output}: exists already")
    names = _names(name or [])
    home = Home.from_environment()
    uids = _uids(sweep, algorithm, where)
    with Work(f"submission to {challenge}") as work:
        bench = open_workbench(home)
        work.follow(bench.making)
        with bench.archive:
            records = [record for uid in uids if (record := bench.archive.get(uid)) and record.trajectory]
            found = by_sequence(wanted, records, names)
            missing = _require_all(wanted, list(found), partial=partial)
            entries = [make_entry(bench, wanted, one, runs, repetition) for one, runs in found.items()]
    write_archive(output, entries)
    _tell(entries, missing, output, as_json=as_json)


def _uids(sweep: list[str] | None, algorithm: str | None, where: str | None) -> list[str]:
    """Return the runs that are meant, each once.

    Raises:
        InputError: there are none.
    """
    selection = Selection(tuple(sweep or ()), None, where)
    frame, notes = choose_runs(selection, "give another --sweep or --where")
    for note in notes:
        remark(note)
    rows = frame.records(["uid", "algorithm", "phase"])
    chosen = [row for row in rows if algorithm is None or row["algorithm"] == algorithm]
    uids = [str(row["uid"]) for row in chosen if row["phase"] == "Succeeded"]
    if not uids:
        has = ", ".join(sorted({str(row["algorithm"]) for row in rows}))
        raise InputError(f"no finished run is meant; there are runs of: {has}")
    return list(dict.fromkeys(uids))


def _names(words: list[str]) -> dict[str, str]:
    pairs = [word.partition("=") for word in words]
    for dataset, _, sequence in pairs:
        if not dataset or not sequence or "/" in sequence:
            raise InputError(f"--name: expected DATASET=SEQUENCE, not {dataset}={sequence}")
    return {dataset: sequence for dataset, _, sequence in pairs}


def _require_all(challenge: Challenge, found: list[str], *, partial: bool) -> list[str]:
    missing = missing_sequences(challenge, found)
    if missing and not partial:
        raise InputError(
            f"no finished run of {plural(len(missing), 'sequence')}: {', '.join(missing)}; --partial leaves "
            "them out"
        )
    return missing


def _tell(entries: list[SubmissionFile], missing: list[str], output: Path, *, as_json: bool) -> None:
    lines = [
        {
            "sequence": entry.sequence,
            "dataset": str(entry.record.spec["datasetRef"]["name"]),
            "run": entry.record.name,
            "chosen": entry.why,
            "poses": entry.poses,
        }
        for entry in entries
    ]
    if as_json:
        write_json(sys.stdout, lines)
    else:
        show(out, list(lines[0]), [[str(value) for value in line.values()] for line in lines])
    if missing:
        remark(f"left out: {', '.join(missing)}")
    remark(f"{output}: {plural(len(entries), 'file')}")
