# SPDX-License-Identifier: Apache-2.0
"""Engine: decides what happens next to runs and sweeps, without touching the world.

Workstation and operator share it.

``decide_run`` and ``decide_sweep`` take what was observed and the time, and return a new state with
the actions that lead on. The workstation's runner and the operator drive the same functions.
"""

from slamhive.engine.deciding import NextSteps, decide
from slamhive.engine.reuse import LoadConditions, taken_over
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
from slamhive.engine.searching import (
    RunSeen,
    Score,
    SearchDecider,
    SearchDecision,
    TrialStanding,
    asked_next,
    best_of,
    decide_search,
)
from slamhive.engine.sharing import (
    Contender,
    Division,
    NamespaceRule,
    SlotOutlook,
    SlotTurns,
    SlotWork,
    divide,
    foresee,
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
from slamhive.engine.threshold import ValueTally, decide_threshold, tallies

__all__ = [
    "AttemptEnd",
    "AttemptState",
    "Contender",
    "Decision",
    "Division",
    "Evaluate",
    "Finish",
    "LoadConditions",
    "NamespaceRule",
    "NextSteps",
    "PointState",
    "Prepare",
    "RunAction",
    "RunObserved",
    "RunSeen",
    "RunState",
    "Score",
    "SearchDecider",
    "SearchDecision",
    "SlotOutlook",
    "SlotTurns",
    "SlotWork",
    "Start",
    "StartPoints",
    "Stop",
    "StopPoints",
    "SweepDecision",
    "SweepObserved",
    "TrialStanding",
    "ValueTally",
    "VariantState",
    "Verdict",
    "asked_next",
    "best_of",
    "classify",
    "decide",
    "decide_run",
    "decide_search",
    "decide_sweep",
    "decide_threshold",
    "divide",
    "foresee",
    "taken_over",
    "tallies",
]
