# SPDX-License-Identifier: Apache-2.0
"""Searches in words: how much they may try, how far they are, and what is best so far."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.analysis.metrics import name_of
from slamhive.analysis.searches.seen import objective_problems
from slamhive.archive import Archive
from slamhive.engine import TrialStanding, decide_search
from slamhive.local.home.folder import Home
from slamhive.local.running.runner import Job
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.model.search import Goal, SettingAggregate, Trial
from slamhive.plan import SearchPlan, local_uid
from slamhive.tables.reading import read_archive
from slamhive.tables.text import number_text, short_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.local.running.searching import SearchUnderWay
    from slamhive.model.sweep import Sweep
    from slamhive.plan import Plan

_MOST_BEST = 5
"""Settings of a front that are shown."""


def refuse_choice(plans: Iterable[tuple[Sweep, Plan]], given: Sequence[str]) -> None:
    """Refuse to leave out runs of a search: which are done follows from the results of those before.

    Raises:
        InputError: options are given, and there is a search.
    """
    found = next((sweep.name for sweep, points in plans if isinstance(points, SearchPlan)), None)
    if found is not None and given:
        raise InputError(
            f"{', '.join(given)}: {found} is a search, which chooses its runs by what those before gave; for "
            "fewer lower spec.search.trials, which may be raised later, or its matrix, or set a budget"
        )


def recall(plans: Iterable[tuple[Sweep, Plan]], home: Home) -> None:
    """Take into the plans of searches what a home's archive knows they tried."""
    searching = [(sweep, points) for sweep, points in plans if isinstance(points, SearchPlan)]
    if not searching or home.missing_archive:
        return
    with Archive.open(home.archive_url, read_only=True) as archive:
        for sweep, points in searching:
            job = Job(sweep, local_uid(sweep), points)
            if job.search is not None:
                job.search.recall(archive)


def fewest_runs(plan: SearchPlan) -> int | None:
    """Return the number of runs at least, if none fails; None for a threshold, where nobody knows it."""
    search = plan.sweep.spec.search
    if not search.method.is_sampled:
        return None
    first = decide_search(search, plan.space, [Trial(values=[])], {}, 1).wanted
    return plan.most_trials * len(first)


def extent_text(plan: Plan) -> str:
    """Return the number of runs; of a search, how much it may try and run."""
    if not isinstance(plan, SearchPlan):
        return plural(len(plan), "run")
    space, search = plan.space, plan.sweep.spec.search
    fewest, most = fewest_runs(plan), plural(plan.most_runs, "run")
    runs = f"at most {most}" if fewest is None else f"at least {fewest:,} and at most {most}"
    if not search.method.is_sampled:
        values = f"up to {plan.space.values_at_most} values of {search.axis} each"
        return f"search {search.method}, {plural(len(plan.space.series), 'threshold')}, {values}, {runs}"
    size = "any number of settings" if space.size is None else plural(space.size, "setting")
    told = f"search {search.method}, tries {plan.most_trials:,} of {size}, {runs}"
    return told if plan.surplus is None else f"{told}; {plan.surplus}"


def objective_faults(sweep: Sweep) -> list[str]:
    """Return a sentence for each objective that neither an evaluation yields nor any run here has."""
    search, settings = sweep.spec.search, sweep.spec.evaluation
    if not search.is_search or not objective_problems(search, settings):
        return []
    home = Home.from_environment()
    seen = () if home.missing_archive else read_archive(home.archive_url, home.path / "cache").names
    return objective_problems(search, settings, seen)


def progress_text(search: SearchUnderWay) -> str:
    """Return the progress of a search, and the best setting so far."""
    tried, most = len(search.plan.trials), search.plan.most_trials
    what = "trial" if search.search.method.is_sampled else "value"
    of = f"of {most:,}" if search.search.method.is_sampled else f"of at most {most:,}"
    parts = [f"{what} {tried:,} {of}", plural(len(search.seen), "run")]
    best = [f"best {setting_text(search, one)}{_so_far(one)}" for one in search.best[:1]]
    return ", ".join([*parts, *best])


def setting_text(search: SearchUnderWay, standing: TrialStanding) -> str:
    """Return the figures of a setting, and its values."""
    values = _values(search, standing)
    at = ", ".join(f"{short_name(label, list(values))} {_plain(value)}" for label, value in values.items())
    figures = ", ".join(_figure(name, value) for name, value in _figures(search, standing).items())
    return f"{figures} at {at}"


def _so_far(standing: TrialStanding) -> str:
    """Return a word where figures are of fewer runs than those of settings that have all theirs."""
    return "" if standing.is_complete else f" (after {plural(standing.runs, 'run')}, not all)"


def end_lines(search: SearchUnderWay) -> list[str]:
    """Return the lines on the results of a search so far."""
    decision, plan = search.decision, search.plan
    lines = [
        f"Best:       {setting_text(search, one)} ({_runs_of(search, one)})"
        for one in search.best[:_MOST_BEST]
    ]
    more = len(search.best) - _MOST_BEST
    lines += (
        [f"            … and {plural(more, 'more setting')}, none of them worse in all"] if more > 0 else []
    )
    size, spared = plan.space.size, len(search.spared)
    whole = size * plan.space.block if size is not None else None
    done = f"Search:     {plural(len(search.seen), 'run')}"
    done += f" of the {whole:,} of a grid" if whole is not None else ""
    done += f", {spared:,} of them spared by equal results" if spared else ""
    dropped = sum(one.dropped is not None for one in decision.standings)
    tried = plural(len(plan.trials), "setting" if search.search.method.is_sampled else "value")
    kept = f", {dropped:,} of them dropped before all runs" if dropped else ""
    lines.append(f"{done}; {tried} tried{kept}")
    return lines


def search_values(search: SearchUnderWay) -> dict[str, Any]:
    """Return the progress of a search, for a line of JSON."""
    return {
        "trials": len(search.plan.trials),
        "mostTrials": search.plan.most_trials,
        "mostRuns": search.plan.most_runs,
        "decided": sum(one.is_decided for one in search.decision.standings),
        "dropped": sum(one.dropped is not None for one in search.decision.standings),
        "done": len(search.seen),
        "spared": len(search.spared),
        "isOver": search.decision.is_over,
        "best": [
            {
                "trial": one.number,
                "settings": _values(search, one),
                "figures": _figures(search, one),
                "runs": one.runs,
                "failedShare": one.score.failed if one.score is not None else None,
            }
            for one in search.best
        ],
    }


def _values(search: SearchUnderWay, standing: TrialStanding) -> dict[str, Any]:
    trial = search.plan.trials[standing.number]
    return search.plan.space.setting(trial.values).coordinates


def _figures(search: SearchUnderWay, standing: TrialStanding) -> dict[str, float]:
    """Return the figures of a setting by objective, the sign as it was measured."""
    values = standing.score.values if standing.score is not None else ()
    return {
        objective.metric: -value if objective.goal is Goal.MAXIMIZE else value
        for objective, value in zip(search.search.objectives, values, strict=False)
    }


def _figure(name: str, value: float) -> str:
    unit = name_of(name).unit
    return f"{name} {number_text(value)}{f' {unit}' if unit else ''}"


def _runs_of(search: SearchUnderWay, standing: TrialStanding) -> str:
    """Return the runs that the figures of a setting are the mean of, in words."""
    failed = round(standing.score.failed * standing.runs) if standing.score is not None else 0
    some = f", {failed} of them failed" if failed else ""
    is_worst = search.search.aggregate is SettingAggregate.WORST
    mean = "mean of the worst dataset, of" if is_worst else "mean of"
    return f"{mean} {plural(standing.runs, 'run')}{some}"


def _plain(value: Any) -> str:
    return number_text(value, ".4g") if isinstance(value, float) else str(value)
