# SPDX-License-Identifier: Apache-2.0
"""Engine: decides what happens next to runs and sweeps, without touching the world.

Workstation and operator share it.

``decide_run`` and ``decide_sweep`` take what was observed and the time, and return a new state with
the actions that lead on. The workstation's runner and the operator drive the same functions.
"""

from slamhive.engine.reuse import taken_over
from slamhive.engine.run import (
    AttemptEnd,
    AttemptState,
    Decision,
    Evaluate,
    Finish,
    Prepare,
    RunAction,
    RunObserved,
    RunState,
    Start,
    Stop,
    VariantState,
    classify,
    decide_run,
)
from slamhive.engine.sweep import (
    PointState,
    StartPoints,
    StopPoints,
    SweepDecision,
    SweepObserved,
    Verdict,
    decide_sweep,
)

__all__ = [
    "AttemptEnd",
    "AttemptState",
    "Decision",
    "Evaluate",
    "Finish",
    "PointState",
    "Prepare",
    "RunAction",
    "RunObserved",
    "RunState",
    "Start",
    "StartPoints",
    "Stop",
    "StopPoints",
    "SweepDecision",
    "SweepObserved",
    "VariantState",
    "Verdict",
    "classify",
    "decide_run",
    "decide_sweep",
    "taken_over",
]
