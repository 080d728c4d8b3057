# SPDX-License-Identifier: Apache-2.0
"""Statuses as the API holds them: times, conditions, and what the engine remembers of a run. Pure."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from slamhive.engine import RunState
from slamhive.model.results import Phase, Reason, Result
from slamhive.model.status import MESSAGE_LENGTH, DatasetStatus, MappingRunStatus, RunDisplay, VariantEntry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.model.results import Usage

_PHASES = {str(phase): phase for phase in Phase}
_RESULT_FIELDS = ("evaluation", "outcome", "coverage")


def iso(moment: float) -> str:
    """Return a moment in s since 1970 as the API writes times, to the microsecond."""
    return datetime.fromtimestamp(moment, UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def moment(text: object) -> float | None:
    """Return a time of the API in s since 1970, or None where there is none."""
    if not isinstance(text, str):
        return None
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        return None


def condition(kind: str, holds: bool | None, reason: str, message: str = "") -> dict[str, Any]:
    """Return one aspect of a state, still without its times."""
    word = "Unknown" if holds is None else str(holds)
    return {"type": kind, "status": word, "reason": reason, "message": message[:MESSAGE_LENGTH]}


def merged(
    before: Iterable[Mapping[str, Any]], fresh: Iterable[dict[str, Any]], generation: int, now: float
) -> list[dict[str, Any]]:
    """Return conditions with fresh ones taken in; a time changes only when its status does.

    Args:
        before: the conditions so far.
        fresh: as ``condition`` makes them.
        generation: generation of the object that they were found for.
        now: s since 1970.
    """
    known = {str(item["type"]): dict(item) for item in before}
    for item in fresh:
        old = known.get(item["type"], {})
        # As the API conventions have it: people read from this time how long something has lasted.
        since = old.get("lastTransitionTime") if old.get("status") == item["status"] else None
        known[item["type"]] = item | {
            "lastTransitionTime": since or iso(now),
            "observedGeneration": generation,
        }
    return list(known.values())


def holds(status: Mapping[str, Any], kind: str) -> bool | None:
    """Tell whether a condition holds; None when nothing is known of it."""
    for item in status.get("conditions") or ():
        if item.get("type") == kind:
            return {"True": True, "False": False}.get(item.get("status", ""))
    return None


def since(status: Mapping[str, Any], kind: str, *, standing: bool) -> float | None:
    """Return since when a condition has been as it is, s since 1970; None when it isn't so.

    Args:
        status: the status.
        kind: type of the condition.
        standing: whether it is to hold or not to hold.
    """
    for item in status.get("conditions") or ():
        if item["type"] == kind and item.get("status") == str(standing):
            return moment(item.get("lastTransitionTime"))
    return None


def run_state(status: MappingRunStatus) -> RunState:
    """Return the engine's state of a run, as a MappingRun's status remembers it."""
    return RunState(
        phase=status.phase or Phase.PENDING,
        reason=Reason(status.reason) if status.reason in set(Reason) else None,
        message=status.message,
        attempts=status.attempts or 0,
        faults=status.faults or 0,
        judged=status.judged or 0,
        not_before=moment(status.not_before) or 0.0,
    )


def phase_of(status: Mapping[str, Any]) -> Phase:
    """Return a run's phase; one without a status, or in a phase of another version, is pending.

    It is asked for thousands of runs at a time, so only this field is read.
    """
    return _PHASES.get(status.get("phase") or "", Phase.PENDING)


def state_fields(state: RunState) -> MappingRunStatus:
    """Return the fields of a status that keep the engine's state."""
    return MappingRunStatus(
        phase=state.phase,
        reason=state.reason,
        message=(state.message or "")[:MESSAGE_LENGTH] or None,
        attempts=state.attempts,
        faults=state.faults or None,
        judged=state.judged or None,
        not_before=iso(state.not_before) if state.not_before else None,
    )


def result_field(result: Result) -> dict[str, Any]:
    """Return a result as an item of a MappingRun's ``status.results``."""
    values = {key: value for key, value in result.values.items() if key not in _RESULT_FIELDS}
    return values | {
        key: value for key, value in result.as_json().items() if key in _RESULT_FIELDS and value is not None
    }


def result_of(field: Mapping[str, Any]) -> Result:
    """Return the result that an item of ``status.results`` holds."""
    values = {key: value for key, value in field.items() if key not in _RESULT_FIELDS}
    return Result.model_validate({key: field.get(key) for key in _RESULT_FIELDS} | {"values": values})


def display(usage: Usage | None, results: Iterable[Mapping[str, Any]]) -> RunDisplay | None:
    """Return the figures that kubectl prints of a run; None where there are none."""
    shown: dict[str, str] = {}
    first: Mapping[str, Any] = next(iter(results), {})
    rmse = rmse_of(first)
    if rmse is not None:
        shown["ate"] = metres(rmse)
    if usage is not None and usage.cpu.mean_cores is not None:
        shown["cpu"] = f"{usage.cpu.mean_cores:.2f}"
    if usage is not None and usage.memory.peak_bytes is not None:
        shown["memory"] = f"{usage.memory.peak_bytes / 2**20:.0f}Mi"
    return RunDisplay.model_validate(shown) if shown else None


def rmse_of(result: Mapping[str, Any]) -> float | None:
    """Return the RMSE of a result's absolute trajectory error, m; None where it holds no such number."""
    error = result.get("ate")
    found = error.get("rmse") if isinstance(error, dict) else None
    return float(found) if isinstance(found, int | float) and not isinstance(found, bool) else None


def metres(value: float) -> str:
    """Return a length in m as kubectl prints it."""
    return f"{value:.4g} m"


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Return the merge patch that turns the named fields of a status into what they shall be.

    Of a record in it only the fields that change: others may be long.
    """
    patch = {}
    for key, value in after.items():
        known = before.get(key)
        if isinstance(known, dict) and isinstance(value, dict):
            if inner := changes(known, value):
                patch[key] = inner
        elif known != value:
            patch[key] = value
    return patch


def patched(before: Mapping[str, Any], patch: Mapping[str, Any]) -> dict[str, Any]:
    """Return a status after a merge patch, as the API server would make it."""
    after = {key: value for key, value in before.items() if key not in patch}
    for key, value in patch.items():
        if isinstance(value, dict):
            known = before.get(key)
            after[key] = patched(known if isinstance(known, dict) else {}, value)
        elif value is not None:
            after[key] = value
    return after


def status_patch(
    seen: Mapping[str, Any], fields: Mapping[str, Any], conditions: Iterable[dict[str, Any]], now: float
) -> dict[str, Any]:
    """Return the merge patch of an object's status; empty where all is so already.

    Args:
        seen: the object as it was read.
        fields: what named fields shall be; None removes one. Others stay, those of later versions too.
        conditions: as ``condition`` makes them; others stay.
        now: s since 1970.
    """
    before = seen.get("status") or {}
    generation = seen["metadata"].get("generation", 1)
    told = list(conditions)
    # Without news the conditions are left out: their times would make a write of nothing.
    if told:
        after = merged(before.get("conditions") or (), told, generation, now)
        fields = {**fields, "conditions": after}
    return changes(before, fields)


def variant_of(dataset: Mapping[str, Any], name: str) -> VariantEntry | None:
    """Return the entry of one variant in a Dataset's status; the others are not even read."""
    variants = (dataset.get("status") or {}).get("variants") or ()
    same = [item for item in variants if item.get("name") == name]
    return next(iter(DatasetStatus.of({"status": {"variants": same}}).variants), None)
