# SPDX-License-Identifier: Apache-2.0
"""``slamhive plan --estimate``: what sweeps will cost, from what was measured of such runs."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from slamhive.analysis.design import Nearness, Quantity
from slamhive.analysis.predicting import COVERED
from slamhive.archive import Archive
from slamhive.cli.parts import tables
from slamhive.cli.parts.console import bytes_text, command_name, listing, out
from slamhive.cli.parts.searches import extent_text
from slamhive.cli.parts.waiting import time_text
from slamhive.local.programs.cores import cores_here
from slamhive.local.running.costs import Knowledge
from slamhive.local.running.forecast import Recordings, WantedSweep, forecast, recordings_needed
from slamhive.local.running.likely import likely_runs
from slamhive.local.running.outlook import MOST_LOOKED_UP, Looking, Outlook, RunStanding
from slamhive.local.running.runner import run_uid
from slamhive.local.running.workbench import Workbench
from slamhive.model.base import plural
from slamhive.model.errors import InputError, SlamHiveError, sentence
from slamhive.monitor.measuring.machine import cpu_model
from slamhive.plan import SearchPlan, local_uid
from slamhive.tables.homes import OWN, costs_together, homes_beside

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.archive import Cost
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.running.forecast import Forecast, Told
    from slamhive.model.sweep import Sweep
    from slamhive.plan import Plan

_DAY = 86_400
_MIB = 1 << 20
_SHARE = f"{COVERED:.0%}".replace("%", " %")


@dataclass
class _RunsToDo:
    """Runs of sweeps that a cost forecast is made for, and those that need no computing: finished or reused.

    Attributes:
        wanted: the runs that are to be done.
        done: runs that are finished already.
        recordings: prepared recordings that those need; None where they weren't looked for.
        equal: runs that take over an equal result, or that of a run of the same plan.
        notes: what could not be found out.
    """

    wanted: list[WantedSweep] = field(default_factory=list)
    done: int = 0
    equal: int = 0
    recordings: Recordings | None = None
    notes: list[str] = field(default_factory=list)


def estimate(
    plans: Sequence[tuple[Sweep, Plan]],
    workshop: Workshop,
    home: Home,
    *,
    parallelism: int | None,
    also: Sequence[str] | None,
    as_json: bool,
) -> None:
    """Print what sweeps will cost.

    Args:
        plans: the sweeps.
        workshop: the catalog.
        home: whose archive tells of earlier runs.
        parallelism: runs at the same time, wherever that is; None: as `slamhive run` does here.
        also: other homes and archives that tell of runs.
        as_json: print JSON.

    Raises:
        InputError: there is no archive, or none of its runs has figures of these algorithms.
    """
    names = sorted({name for _, points in plans for name in points.algorithm_names()})
    datasets = sorted({name for _, points in plans for name in points.dataset_names()})
    knowledge = Knowledge.of(_costs(home, also, names, datasets))
    here = cores_here()
    found = _found(plans, workshop, home, parallelism)
    beyond = parallelism is not None and parallelism > here
    told = forecast(found.wanted, knowledge, cpu_model(), None if beyond else here)
    if sum(len(one.indices) for one in found.wanted) and not told.told:
        raise InputError(_nothing_known(names, knowledge))
    if as_json:
        tables.write_json(sys.stdout, [_document(told, found, knowledge)])
        return
    total = sum(len(points) for _, points in plans if not isinstance(points, SearchPlan))
    names_of = ", ".join(sweep.name for sweep, points in plans if not isinstance(points, SearchPlan))
    if names_of:
        out.print(f"{names_of}: {plural(total, 'run')}", markup=False)
    for sweep, points in plans:
        if isinstance(points, SearchPlan):
            out.print(f"{sweep.name}: {extent_text(points)}", markup=False)
    if told.told:
        headings = ["what", "estimate", f"in {_SHARE} of cases", "from"]
        tables.show(out, headings, [_line(one, told) for one in told.told.values()])
    for line in _sentences(told, found, knowledge, here if not beyond else None):
        out.print(line, markup=False, soft_wrap=True)


def _nothing_known(names: Sequence[str], knowledge: Knowledge) -> str:
    some = f"{plural(knowledge.failed, 'failed run')} tell nothing" if knowledge.failed else "none is known"
    return (
        f"--estimate: no finished run of {listing(names)} has figures of CPU, wall time or memory ({some}); "
        f"{command_name()} run FILE --first 3 makes some, --also names homes that have them"
    )


def _costs(home: Home, also: Sequence[str] | None, names: list[str], datasets: list[str]) -> list[Cost]:
    """Return the costs of runs, of one's own home and of others.

    Raises:
        InputError: an archive is not there, or is of another version.
    """
    others = homes_beside(home, also)
    places = [(OWN, home.archive_url), *((one.label, one.url) for one in others)]
    file = home.missing_archive
    if file is not None:
        if not others:
            raise InputError(f"--estimate: nothing has run here yet: there is no {file}; --also names homes")
        del places[0]
    found = []
    for label, url in places:
        try:
            with Archive.open(url, read_only=True) as archive:
                found.append((label, archive.costs(names, datasets)))
        except SlamHiveError as error:
            raise type(error)(str(error) if label == OWN else f"home {label}: {error}") from None
    return costs_together(found)


def _found(
    plans: Sequence[tuple[Sweep, Plan]], workshop: Workshop, home: Home, parallelism: int | None
) -> _RunsToDo:
    """Return the runs to do: those that `slamhive run` would begin."""
    found = _RunsToDo()
    orders: list[list[int] | None] = []
    laid: list[tuple[Sweep, Plan]] = []
    for sweep, points in plans:
        plan, order = likely_runs(points) if isinstance(points, SearchPlan) else (points, None)
        laid.append((sweep, plan))
        orders.append(order)
        if order is not None:
            found.notes.append(
                f"{sweep.name}: a search, of which {plural(len(order), 'run')} are likely; settings at "
                "random stand for those that it will try"
            )
    outlooks = _outlooks(laid, workshop, home, found)
    for (sweep, points), outlook, order in zip(laid, outlooks, orders, strict=True):
        standing = outlook.standing if outlook is not None else bytearray(len(points))
        twins = points.twins
        indices = []
        # Of very many runs it hardly matters which begins when, and to order them takes seconds.
        many = len(points) > MOST_LOOKED_UP
        wanted = order if order is not None else None if many else points.start_order(look_first=True)
        for index in range(len(points)) if wanted is None else wanted:
            if standing[index] in {RunStanding.DONE, RunStanding.FAILED}:
                found.done += 1
            elif standing[index] == RunStanding.EQUAL or index in twins:
                found.equal += 1
            else:
                indices.append(index)
        found.wanted.append(WantedSweep(points, indices, parallelism or sweep.spec.parallelism))
    found.recordings = _recordings(found.wanted, workshop, home)
    return found


def _recordings(wanted: Sequence[WantedSweep], workshop: Workshop, home: Home) -> Recordings | None:
    if home.missing_archive:
        return None
    with Archive.open(home.archive_url, read_only=True) as archive:
        return recordings_needed(Workbench(home, workshop, archive), wanted)


def _outlooks(
    plans: Sequence[tuple[Sweep, Plan]], workshop: Workshop, home: Home, found: _RunsToDo
) -> list[Outlook | None]:
    if home.missing_archive:
        return [None] * len(plans)
    try:
        with Archive.open(home.archive_url, read_only=True) as archive:
            looking = Looking(Workbench(home, workshop, archive), making=False)
            outlooks: list[Outlook | None] = []
            for sweep, points in plans:
                uid = local_uid(sweep)
                outlook = looking.look(sweep.name, uid, points, partial(run_uid, uid))
                if len(points) > MOST_LOOKED_UP and not outlook.seen:
                    found.notes.append(
                        f"{sweep.name}: equal results were not looked for, as it has more than "
                        f"{MOST_LOOKED_UP:,} runs: those that it takes over cost nothing"
                    )
                outlooks.append(outlook)
            return outlooks
    except SlamHiveError as error:
        found.notes.append(f"what is done already can't be told: {sentence(error)}")
        return [None] * len(plans)


def _line(one: Told, told: Forecast) -> list[str]:
    words, text = {
        Quantity.CPU: ("CPU time", _hours),
        Quantity.WALL: (f"wall time, {told.at_a_time:,} at a time", _days),
        Quantity.MEMORY: ("memory of the largest run", _size),
        Quantity.DISK: ("results on disk", _size),
    }[one.quantity]
    span = one.interval
    names = listing([str(name) for name, _ in told.algorithms.most_common()], 3)
    return [
        words,
        text(span.middle),
        f"{text(span.low)} to {text(span.high)}",
        f"{plural(one.runs, 'run')} of {names}",
    ]


def _hours(seconds: float) -> str:
    """Return CPU time as people say it: budgets are in CPU hours.

    >>> _hours(42), _hours(5400)
    ('42 s', '1.5 h')
    """
    hours = seconds / 3600
    if seconds < 600:
        return f"{seconds:.0f} s"
    return f"{hours:,.0f} h" if hours >= 100 else f"{hours:.3g} h"


def _size(count: float) -> str:
    """Return a size as people read it, small ones with a digit more than elsewhere.

    >>> _size(1_500_000), _size(82_000_000)
    ('1.4 MiB', '78 MiB')
    """
    return f"{count / _MIB:.1f} MiB" if _MIB <= count < 10 * _MIB else bytes_text(count)


def _days(seconds: float) -> str:
    """Return a wall time as people say it.

    >>> _days(90), _days(200_000)
    ('1 min 30 s', '2.3 days')
    """
    return f"{seconds / _DAY:,.1f} days" if seconds >= 2 * _DAY else time_text(seconds)


def _sentences(told: Forecast, found: _RunsToDo, knowledge: Knowledge, cores: int | None) -> Iterator[str]:
    if told.runs:
        near = ", ".join(f"{told.nearness[one]:,} from {one}" for one in Nearness if told.nearness[one])
        yield f"{plural(told.runs, 'run')} to be done, predicted by the nearest finished ones: {near}"
    else:
        yield "no run to be done is counted"
    if found.done:
        yield f"{plural(found.done, 'run')} finished already: not counted"
    if found.equal:
        yield f"{plural(found.equal, 'run')} with an equal result to take over: not counted"
    for name, count in sorted(told.unknown.items()):
        yield (
            f"{plural(count, 'run')} of {name} not counted: no run of it is known; "
            f"{command_name()} run FILE --first 3 does some"
        )
    yield from _prepared(found.recordings)
    if told.unmeasured:
        yield (
            f"the length of the recording isn't known of {listing(told.unmeasured)}: taken for that of the "
            "others, within wide limits"
        )
    yield from _processors(told)
    if knowledge.failed or knowledge.limited:
        limited = (
            f"; {knowledge.limited:,} that hit the time limit count as that" if knowledge.limited else ""
        )
        yield f"{plural(knowledge.failed, 'failed run')} of the archive left out{limited}"
    if Quantity.DISK not in told.told and told.told:
        yield "results on disk: not known, as no files of such runs are here"
    if Quantity.WALL in told.told:
        room = "as if there were room for them" if cores is None else f"on {plural(cores, 'core')}"
        yield (
            f"wall time {room}: programs, and {time_text(told.idle)} a run until they begin; without making "
            "prepared recordings and environments, and without measuring trajectories"
        )
    yield from found.notes


def _prepared(needed: Recordings | None) -> Iterator[str]:
    if needed is None:
        return
    if needed.missing:
        what = plural(needed.missing, "prepared recording")
        yield f"{what} to be made first, up to about {_size(needed.size)}; {needed.there:,} there already"
    if needed.unknown:
        names = listing(sorted(needed.unknown))
        yield f"prepared recordings of {names} aren't counted: the dataset is not here yet"


def _processors(told: Forecast) -> Iterator[str]:
    here = cpu_model()
    others = {name: count for name, count in told.processors.items() if name != here}
    if not others:
        return
    same = told.processors.get(here, 0)
    places = listing([f"{count:,} on {name or 'an unknown one'}" for name, count in others.items()], 3)
    if same:
        yield f"measured on this processor: {plural(same, 'run')}; on others: {places}"
    else:
        yield f"measured on another processor than this one ({here}), so within wider limits: {places}"


def _document(told: Forecast, found: _RunsToDo, knowledge: Knowledge) -> dict[str, Any]:
    """Return a forecast as JSON."""
    return {
        "runs": told.runs,
        "finished": found.done,
        "reused": found.equal,
        "unknown": dict(sorted(told.unknown.items())),
        "interval": COVERED,
        **{
            str(quantity): {
                "estimate": one.interval.middle,
                "low": one.interval.low,
                "high": one.interval.high,
                "fromRuns": one.runs,
            }
            for quantity, one in told.told.items()
        },
        "atATime": told.at_a_time,
        "startingSeconds": told.idle,
        "nearest": {str(one): told.nearness[one] for one in Nearness if told.nearness[one]},
        "processors": {name or "": count for name, count in told.processors.items()},
        "unmeasuredDatasets": told.unmeasured,
        "failedLeftOut": knowledge.failed,
        "atTimeLimit": knowledge.limited,
        "recordings": None
        if found.recordings is None
        else {
            "made": found.recordings.there,
            "toMake": found.recordings.missing,
            "bytes": found.recordings.size,
            "unknown": sorted(found.recordings.unknown),
        },
        "notes": found.notes,
    }
