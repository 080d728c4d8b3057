# SPDX-License-Identifier: Apache-2.0
"""Reuse: what a run takes over from a finished one of equal content, on a workstation and on a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.model.results import Machine

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from slamhive.model.results import Provenance, RunRecord


class LoadConditions(NamedTuple):
    """Conditions under which load was measured: they say what a CPU second is; None: not known.

    Attributes:
        processor: its model.
        smt, governor, turbo, exclusive_cores: as in `model.results.Machine`.
    """

    processor: str | None
    smt: bool | None = None
    governor: str | None = None
    turbo: bool | None = None
    exclusive_cores: bool | None = None

    @classmethod
    def of(cls, provenance: Provenance) -> LoadConditions:
        """Return the conditions of a run."""
        return cls.on(provenance.cpu_model, provenance.machine)

    @classmethod
    def on(cls, processor: str | None, machine: Machine | None) -> LoadConditions:
        """Return the conditions on a machine with this model of processor."""
        known = machine or Machine()
        return cls(processor, known.smt, known.governor, known.turbo, known.exclusive_cores)

    @classmethod
    def common(cls, many: Iterable[LoadConditions]) -> LoadConditions | None:
        """Return the conditions as far as any of several knows them; None where two contradict."""
        values = [{value for value in column if value is not None} for column in zip(*many, strict=True)]
        if any(len(known) > 1 for known in values):
            return None
        return cls(*(next(iter(known), None) for known in values)) if values else cls(None)

    @property
    def machine(self) -> Machine | None:
        """Return them as they stand in a record, beside the processor; None where nothing is known."""
        found = Machine(
            smt=self.smt, governor=self.governor, turbo=self.turbo, exclusive_cores=self.exclusive_cores
        )
        return found if found.as_json() else None

    def differences(self, other: LoadConditions) -> list[str]:
        """Return the differences of what both know, in words, theirs second; none: loads compare."""
        words = ("processor", "SMT", "governor", "turbo", "exclusive cores")
        return [
            f"{word} {_text(mine)} and {_text(theirs)}"
            for word, mine, theirs in zip(words, self, other, strict=True)
            if None not in {mine, theirs} and mine != theirs
        ]


def _text(value: str | bool | None) -> str:
    return str(value) if not isinstance(value, bool) else "on" if value else "off"


def taken_over(
    equal: RunRecord, recording: Mapping[str, Any], conditions: Collection[LoadConditions]
) -> dict[str, Any]:
    """Return the fields of a run's record that it has from an equal run; results are not among them.

    Args:
        equal: the finished run of the same content.
        recording: fields of the provenance that are the run's own: what it asked of its recording.
        conditions: those that the run could have been measured under. CPU and memory that were measured
            under others are left out: they would stand beside figures that can't be compared.
    """
    measured = LoadConditions.of(equal.provenance)
    compares = measured.processor and any(
        one.processor and not measured.differences(one) for one in conditions
    )
    return {
        "usage": equal.usage if compares else None,
        "frames": equal.frames,
        "metrics": equal.metrics,
        "trajectory": equal.trajectory,
        "folder": equal.folder,
        "log_tail": equal.log_tail,
        "started": equal.started,
        "finished": equal.finished,
        "provenance": equal.provenance.replace(
            reused_from=equal.provenance.reused_from or equal.name, **recording
        ),
    }
