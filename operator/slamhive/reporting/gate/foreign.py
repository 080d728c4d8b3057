# SPDX-License-Identifier: Apache-2.0
"""Baselines of slam-regression-ci (versions 1 and 2 of its file), as far as they mean the same here.

Its ATE is ours. Its RPE is over poses, ours over metres: that can't be compared and is left out.
"""

from __future__ import annotations

from typing import Any

from slamhive.model.errors import InputError

_SCHEMAS = ("slam-regression-baseline/v1", "slam-regression-baseline/v2")


def foreign_baseline(body: Any, where: str) -> dict[str, Any] | None:
    """Return somebody else's baseline as the JSON of one of ours; None where it is none.

    Its one cell has neither sweep nor dataset: it stands for the only setting of a gate.

    Raises:
        InputError: it lacks what its version has.
    """
    if not isinstance(body, dict) or body.get("schema") not in _SCHEMAS:
        return None
    runs = body.get("runs") if body["schema"] == _SCHEMAS[1] else body.get("metrics")
    errors = runs.get("ate_rmse") if isinstance(runs, dict) else None
    errors = errors if isinstance(errors, list) else [errors]
    if not errors or not all(isinstance(one, int | float) and one >= 0 for one in errors):
        field = "runs.ate_rmse" if body["schema"] == _SCHEMAS[1] else "metrics.ate_rmse"
        raise InputError(f"{where}: {field}: expected errors in m, found {str(errors)[:60]}")
    settings = body.get("settings")
    aligned = settings.get("alignment") if isinstance(settings, dict) else None
    alignment = None
    if isinstance(aligned, dict):
        alignment = ("sim3" if aligned.get("correct_scale") else "se3") if aligned.get("enabled") else "none"
    cell = {
        "sweep": None,
        "settings": {},
        "dataset": None,
        "alignment": alignment,
        "tracked": [True] * len(errors),
        "values": {"ate.rmse": errors},
    }
    return {"baseline": "slamhive-baseline/v1", "recorded": str(body.get("created_utc", "")), "cells": [cell]}
