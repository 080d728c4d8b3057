# SPDX-License-Identifier: Apache-2.0
"""Port of what runs algorithms, and the outcomes of a sweep as its user reads them."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Mapping

Row = dict[str, Any]
BEHAVIOUR = "parameters.behaviour"
OF_THE_MOMENT = (
    # who and where: names, identities, places, versions of programs
    *("id", "uid", "name", "run", "point", "index", "sweep", "sweep.uid", "namespace", "cluster", "folder"),
    *("algorithm", "algorithm.", "label.", "provenance.", "trajectory.path", "settings"),
    # measured, and told of neither of those that end within milliseconds
    *("usage.", "disturbed", "created", "started", "finished"),
    # what was asked for
    *("dataset", "dataset.", "parameters.", "resources.", "seed", "repetition", "input.", "sensors"),
)
"""Columns that are no outcome of a behaviour; those that end in a dot with all below."""
FOLDER = "RUN"
"""Stands for the run's folder in a message."""
STARVED = "UsageSuspect: the monitor took no sample for more than 5 s"
"""Remark on a run whose node was too busy to measure it; as its figures, no outcome of a behaviour."""
REUSED = "reused"
"""Column that tells whether the result is an earlier run's."""


class Executor(Protocol):
    """Interface of a system that runs algorithms: a workstation's processes or containers, or a cluster."""

    name: str
    """By which table.py names its differences."""

    def program(self, text: str) -> dict[str, Any]:
        """Return the fields of an Algorithm's spec that say how its program, in Python, is run."""

    def run(self, algorithm: Mapping[str, Any], sweep: Mapping[str, Any]) -> str:
        """Run a Sweep of an Algorithm to its end and return the URL of an archive that has all of its runs.

        Args:
            algorithm: the Algorithm.
            sweep: the Sweep; its dataset is that of tests/actor.
        """

    def faults(self, sweep: str) -> Mapping[str, int]:
        """Return the number of attempts that the machine ended, by behaviour, if any.

        A busy node ends some, and each is followed by another attempt.
        """


def outcomes(archive: str, sweep: str, faults: Mapping[str, int] = MappingProxyType({})) -> dict[str, Row]:
    """Return the outcome of each behaviour in a sweep: its columns with a value that are no matter of chance.

    Args:
        archive: URL of an archive.
        sweep: name of the sweep.
        faults: attempts that don't count, by behaviour.
    """
    frame = read_archive(archive)
    found = {}
    for row in frame.records(frame.names):
        if row["sweep"] == sweep:
            kept = {
                name: value for name, value in row.items() if value is not None and not _of_the_moment(name)
            }
            message = kept.pop("message", "").replace(row["folder"] or FOLDER, FOLDER)
            message = message.removeprefix(STARVED).removeprefix("; ")
            kept |= {"message": message} if message else {}
            attempts = kept["attempts"]
            # A fault may have come before there was an attempt, as while the recording was prepared.
            kept["attempts"] = max(min(attempts, 1), attempts - faults.get(row[BEHAVIOUR], 0))
            found[row[BEHAVIOUR]] = kept | {REUSED: row.get("provenance.reusedFrom") is not None}
    return found


def differences(found: Row, wanted: Row) -> list[str]:
    """Return a line for each column that is not as wanted; figures may differ by rounding."""
    return [
        f"{name}: {found.get(name)!r} instead of {wanted.get(name)!r}"
        for name in sorted(found.keys() | wanted.keys())
        if not _equal(found.get(name), wanted.get(name))
    ]


def _equal(one: Any, other: Any) -> bool:
    # An API server writes 1.0 as 1.
    if {type(one), type(other)} <= {int, float}:
        return math.isclose(one, other, rel_tol=1e-6)
    return type(one) is type(other) and bool(one == other)


def _of_the_moment(name: str) -> bool:
    return any(name == one or (one.endswith(".") and name.startswith(one)) for one in OF_THE_MOMENT)
