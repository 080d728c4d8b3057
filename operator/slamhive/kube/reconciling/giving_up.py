# SPDX-License-Identifier: Apache-2.0
"""What is remembered of runs that could not be measured, so that a new operator doesn't try again: pure.

It stands in an annotation of the run, by the Evaluation's name, which is empty for a run's or Sweep's own::

    slamhive.io/not-evaluable: {"NAME": {"of": UID, "settings": HASH, "why": "sentence"}}

It holds for that very Evaluation or Sweep and those settings. Whoever removes it has the run measured again.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from slamhive.model.base import GROUP
from slamhive.model.crd_status import MOST_RESULTS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.kube.reconciling.groups import Group

ANNOTATION = f"{GROUP}/not-evaluable"

_MOST = 16
_SENTENCE = 500


def problem_of(group: Group, run: Mapping[str, Any]) -> str | None:
    """Return why a run can't be measured by a group; None when that is not known."""
    if group.has_result(run):
        return None
    if is_full(run, group.name):
        return f"it has results of {MOST_RESULTS} evaluations, the most that are kept of a run"
    found = _noted(run).get(group.name or "")
    if not isinstance(found, dict):
        return None
    same = found.get("of") == group.owner["uid"] and found.get("settings") == group.hash
    return str(found.get("why")) if same else None


def is_full(run: Mapping[str, Any], evaluation: str | None) -> bool:
    """Tell whether a run's status has no room for another evaluation's result.

    Args:
        run: the run.
        evaluation: name of the evaluation, whose earlier result is replaced; None: not known.
    """
    names = {result["evaluation"] for result in run["status"].get("results") or ()}
    return len(names) >= MOST_RESULTS and evaluation is not None and evaluation not in names


def with_problem(group: Group, run: Mapping[str, Any], problem: str) -> dict[str, str]:
    """Return the annotation that notes why a run can't be measured by a group."""
    name = group.name or ""
    others = {key: value for key, value in _noted(run).items() if key != name}
    kept = dict([*others.items()][1 - _MOST :])
    kept[name] = {"of": group.owner["uid"], "settings": group.hash, "why": problem[:_SENTENCE]}
    return {ANNOTATION: json.dumps(kept, ensure_ascii=False, separators=(",", ":"))}


def _noted(run: Mapping[str, Any]) -> dict[str, Any]:
    try:
        found = json.loads((run["metadata"].get("annotations") or {}).get(ANNOTATION, "{}"))
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
