# SPDX-License-Identifier: Apache-2.0
"""Ownership of a results volume: a file on it names the namespace and the archive that know its runs.

The collector deletes nothing for anybody else.

Names come back when a cluster, a namespace or a database is made anew, what they knew does not: so the
namespace's uid and the archive's identity are compared, which are never the same twice.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from slamhive.jobs.program import write_aside
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

MARK = ".slamhive-namespace"
_AGAIN = (
    "nothing is removed. To make this namespace and this archive the owner of the volume, start the "
    "collector once with --adopt (docs/kubernetes.md, Collector)"
)


@dataclass(frozen=True)
class Owner:
    """Owner of a results volume: the namespace and the archive that know the runs on it.

    Attributes:
        namespace: its name.
        uid: its uid; None where an earlier version wrote it down, or a test.
        archive: the archive's identity; None without one.
    """

    namespace: str
    uid: str | None = None
    archive: str | None = None


def claim(results: Path, owner: Owner, *, adopt: bool = False, dry: bool = False) -> None:
    """Check that a results volume is of those who are asked about its runs; a new one becomes theirs.

    Args:
        results: the volume.
        owner: who is asked.
        adopt: take it over from whoever had it.
        dry: write nothing.

    Raises:
        InputError: it is another one's, so that its runs would all be unknown here.
        OSError: the mark can't be read or written.
    """
    mark = results / MARK
    before = _read(mark)
    if before is not None and not adopt:
        _compare(results, before, owner)
    if owner != before and not dry:
        text = json.dumps(asdict(owner))
        write_aside(mark, lambda path: path.write_text(text, encoding="utf-8"))


def _read(mark: Path) -> Owner | None:
    try:
        text = mark.read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        return None
    try:
        found = json.loads(text)
        return Owner(str(found["namespace"]), found.get("uid"), found.get("archive"))
    except (ValueError, TypeError, KeyError):
        return Owner(text)  # earlier versions wrote the name alone


def _compare(results: Path, before: Owner, now: Owner) -> None:
    if before.namespace != now.namespace:
        raise InputError(
            f"{results} belongs to the namespace {before.namespace!r}, not {now.namespace!r}: {_AGAIN}"
        )
    if before.uid is not None and before.uid != now.uid:
        raise InputError(
            f"{results} belongs to the namespace {now.namespace!r} with the uid {before.uid}; that of this "
            f"name now has the uid {now.uid} and knows none of the earlier one's runs: {_AGAIN}"
        )
    if before.archive is not None and before.archive != now.archive:
        present = f"the one given now is {now.archive}" if now.archive else "now none is given"
        raise InputError(
            f"{results}: its runs were known to the archive {before.archive}; {present}, as after a restore "
            f"or with another database: {_AGAIN}"
        )
