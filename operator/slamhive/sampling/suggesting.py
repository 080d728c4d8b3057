# SPDX-License-Identifier: Apache-2.0
"""Suggestions of the methods, each a function of what it is told and of nothing else.

Optuna's samplers are made anew for each trial, seeded by the search's seed and the trial's number, from a
study of what was told. So there is no state to keep, and what was asked once is answered alike ever after.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import optuna

STARTUP = 5
"""Results before which the methods that learn have nothing to learn from; until then, Sobol's points."""
POPULATION = 20
"""Settings of a generation of NSGA-II."""
_BEST, _REACH = 3, 8
"""Settings that are improved on one axis at a time, and steps to either side of each."""
_APART = 5_000
"""Distance in Sobol's sequence of further tries for a trial, more than a search has trials."""
_GENERATION = "NSGAIISampler:generation"


def suggest(asked: Mapping[str, Any]) -> list[list[float]]:
    """Return suggestions for a trial, so many as ``tries`` says, the first one from ``begin`` on."""
    learnt = [trial for trial in asked["trials"] if trial["state"] == "known"]
    match asked["method"]:
        case "Random":
            return [_placed(asked, _random(asked, number)) for number in _tries(asked)]
        case "TPE" if len(learnt) >= STARTUP and _looks_around(asked):
            return _stars(asked, learnt)
        case "TPE" | "NSGA-II" if len(learnt) >= STARTUP:
            return _learnt(asked)
        case _:
            return [_placed(asked, _sobol(asked, number)) for number in _tries(asked)]


def _tries(asked: Mapping[str, Any]) -> range:
    return range(asked["begin"], asked["begin"] + asked["tries"])


def _looks_around(asked: Mapping[str, Any]) -> bool:
    """Tell whether the next setting is one that differs from one of the best on one axis.

    In seven of eight trials of a grid: an estimate of densities finds the region, but not the best step in
    it. The eighth is that estimate's, so that nothing is stuck where one axis alone makes nothing better.
    """
    steps_alone = all(axis["kind"] != "real" for axis in asked["axes"])
    one = asked["objectives"] == 1 and not asked["conditional"] and asked["begin"] == 0
    return steps_alone and one and bool(asked["number"] % 8)


def _stars(asked: Mapping[str, Any], learnt: Sequence[Mapping[str, Any]]) -> list[list[float]]:
    """Return the best settings, each followed by those that differ from it on one axis, the nearest first.

    Steps that are equally near are in an order by seed.
    """
    worst = _worst(asked)[0]
    ranked = sorted(
        (one["failed"] + one["lacking"], worst if (value := one["figures"][0]) is None else value, number)
        for number, one in enumerate(learnt)
    )
    rng = np.random.default_rng([asked["seed"], asked["number"]])
    found: list[list[float]] = []
    for *_, number in ranked[:_BEST]:
        best = list(learnt[number]["values"])
        near: list[tuple[int, float, list[float]]] = []
        for place, axis in enumerate(asked["axes"]):
            own, is_choice = int(best[place]), axis["kind"] == "choice"
            reach = axis["high"] - axis["low"] if is_choice else _REACH
            for step in range(max(axis["low"], own - reach), min(axis["high"], own + reach) + 1):
                distance = min(abs(step - own), 1) if is_choice else abs(step - own)
                if distance:
                    near.append((distance, rng.random(), [*best[:place], step, *best[place + 1 :]]))
        found += [best, *(setting for *_, setting in sorted(near))]
    return found


def _random(asked: Mapping[str, Any], number: int) -> Sequence[float]:
    return list(np.random.default_rng([asked["seed"], asked["number"], number]).random(len(asked["axes"])))


def _sobol(asked: Mapping[str, Any], number: int) -> Sequence[float]:
    from scipy.stats.qmc import Sobol  # noqa: PLC0415 - takes a second, and Random needs none

    sequence = Sobol(len(asked["axes"]), scramble=True, rng=np.random.default_rng(asked["seed"]))
    place = asked["number"] + number * _APART
    if place:  # which it can't do by nothing
        sequence.fast_forward(place)
    return list(sequence.random(1)[0])


def _placed(asked: Mapping[str, Any], point: Sequence[float]) -> list[float]:
    """Return the values at a point of the unit cube."""
    return [_at(axis, share) for axis, share in zip(asked["axes"], point, strict=True)]


def _at(axis: Mapping[str, Any], share: float) -> float:
    low, high = axis["low"], axis["high"]
    whole = axis["kind"] != "real"
    if not axis["log"]:
        value = low + math.floor(share * (high - low + 1)) if whole else low + share * (high - low)
        return float(min(value, high))
    begin, end = (low - 0.5, high + 0.5) if whole else (low, high)
    value = math.exp(math.log(begin) + share * (math.log(end) - math.log(begin)))
    return float(min(max(round(value) if whole else value, low), high))


def _learnt(asked: Mapping[str, Any]) -> list[list[float]]:
    """Return suggestions of one of Optuna's samplers."""
    import optuna  # noqa: PLC0415 - takes half a second, and two methods need none

    optuna.logging.disable_default_handler()
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    names = [f"{number:03}" for number in range(len(asked["axes"]))]
    space = dict(zip(names, map(_distribution, asked["axes"]), strict=True))
    study = optuna.create_study(directions=["minimize"] * asked["objectives"])
    generations = _generations(asked["trials"]) if asked["method"] == "NSGA-II" else None
    worst = _worst(asked)
    study.add_trials(
        [
            _trial(trial, space, worst, generations[number] if generations else None)
            for number, trial in enumerate(asked["trials"])
            if trial["state"] != "unknown"
        ]
    )
    found = []
    for number in _tries(asked):
        # A try that was no use stays under way in the study, and pushes the next one away.
        study.sampler = _sampler(asked, number)
        params = study.ask(space).params
        found.append([params[name] for name in names])
    return found


def _sampler(asked: Mapping[str, Any], number: int) -> optuna.samplers.BaseSampler:
    import optuna  # noqa: PLC0415

    seed = int(np.random.SeedSequence([asked["seed"], asked["number"], number]).generate_state(1)[0])
    if asked["method"] == "TPE":
        return optuna.samplers.TPESampler(seed=seed, n_startup_trials=STARTUP, group=asked["conditional"])
    return optuna.samplers.NSGAIISampler(seed=seed, population_size=POPULATION)


def _distribution(axis: Mapping[str, Any]) -> optuna.distributions.BaseDistribution:
    import optuna  # noqa: PLC0415

    low, high = axis["low"], axis["high"]
    match axis["kind"]:
        case "choice":
            return optuna.distributions.CategoricalDistribution(range(low, high + 1))
        case "integer":
            return optuna.distributions.IntDistribution(low, high, log=axis["log"])
        case _:
            return optuna.distributions.FloatDistribution(low, high, log=axis["log"])


def _worst(asked: Mapping[str, Any]) -> list[float]:
    """Return the worst figure for each objective that is known, which stands for one that isn't."""
    known = [trial["figures"] for trial in asked["trials"] if trial["state"] == "known"]
    return [
        max((values[number] for values in known if values[number] is not None), default=0.0)
        for number in range(asked["objectives"])
    ]


def _trial(
    trial: Mapping[str, Any],
    space: Mapping[str, optuna.distributions.BaseDistribution],
    worst: Sequence[float],
    generation: int | None,
) -> optuna.trial.FrozenTrial:
    import optuna  # noqa: PLC0415

    given = {name: value for name, value in zip(space, trial["values"], strict=True) if value is not None}
    own = {name: space[name] for name in given}
    if trial["state"] == "running":
        return optuna.trial.create_trial(
            state=optuna.trial.TrialState.RUNNING, params=given, distributions=own
        )
    values = [bad if value is None else value for value, bad in zip(trial["figures"], worst, strict=True)]
    return optuna.trial.create_trial(
        values=values,
        params=given,
        distributions=own,
        constraints={"failed": trial["failed"], "lacking": trial["lacking"]},
        system_attrs=None if generation is None else {_GENERATION: generation},
    )


def _generations(trials: Sequence[Mapping[str, Any]]) -> list[int]:
    """Return the generation of each trial, as Optuna counts: by what was known when it was proposed."""
    found: list[int] = []
    counts: dict[int, int] = {}
    counted = 0
    for trial in trials:
        while counted < trial["told"]:
            if trials[counted]["state"] == "known":
                counts[found[counted]] = counts.get(found[counted], 0) + 1
            counted += 1
        last = max(counts, default=0)
        found.append(last + (counts.get(last, 0) >= POPULATION))
    return found
