# SPDX-License-Identifier: Apache-2.0
"""Compare every view with the definition over made-up archives: ``python tests/honest/check.py``.

Every other archive has runs beside that can't be read, of which no view may show anything.
Each archive is made up from a number and asked a few questions in some of the views, so that a failure can
be had again by its number alone. The first archive that a view shows wrongly is kept as JSON, with the
question and what differs, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections import Counter
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import archives
import reckoning
from breaking import BREAKS, broken
from comparing import ONE_SWEEP, VIEWS, problems
from odd import spoil
from reckoning import Question
from sqlalchemy import create_engine
from views import Views

from slamhive.model.leftout import LeftOutWarning

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from archives import Tables
    from reckoning import Row

QUESTIONS = 2
"""Questions that an archive is asked."""

ODD = 0.5
"""Share of the archives with runs that can't be read."""

VIEWS_AT_ONCE = 6
"""Views that a question is asked in, chosen by chance."""

ERRORS = ("ate.rmse", "rpe[0].rmse", "ate.mean")
LOADS = ("usage.cpu.meanCores", "usage.cpu.seconds", "usage.wallSeconds", "usage.memory.peakBytes")
BY = (
    None,
    None,
    None,
    ("algorithm",),
    ("algorithm", "sensors", "dataset"),
    ("dataset", "algorithm"),
    ("evaluation", "algorithm"),
    ("alignment",),
    ("repetition",),
    ("parameters.n",),
    ("algorithm", "input.pace"),
    ("sweep", "algorithm"),
)
COMPETITORS = (
    *(("algorithm", "sensors"), ("algorithm", "sensors"), ("algorithm",), ("algorithm", "parameters.n")),
    ("sensors", "repetition"),
)
CONDITIONS: tuple[tuple[str, str, Any], ...] = (
    ("outcome", "==", "Tracked"),
    ("outcome", "!=", "Tracked"),
    ("outcome", "is null", None),
    ("phase", "==", "Succeeded"),
    ("reason", "is not null", None),
    ("coverage", ">=", 0.5),
    ("ate.rmse", "<", 0.5),
    ("repetition", "in", (0, 1)),
    ("evaluation", "==", "se3"),
    ("evaluation", "!=", "sim3"),
    ("alignment", "==", "sim3"),
    ("algorithm", "in", ("orb", "kiss")),
    ("sensors", "!=", "mono"),
    ("usage.includesReader", "==", True),
    ("input.pace", "is null", None),
)


def question(random: Random, rows: Sequence[Row]) -> Question:
    """Make a question up that fits the rows of an archive."""
    # A name that is used in several namespaces must be told apart by them.
    places = {(str(row["sweep"]), row["namespace"]) for row in rows if row["sweep"] is not None}
    names = [name for name, _ in places]
    sweeps = sorted(name for name in names if names.count(name) == 1)
    asked = tuple(random.sample(sweeps, min(random.choice((0, 0, 0, 1, 1, 2)), len(sweeps))))
    inside = [row for row in rows if not asked or row["sweep"] in asked]
    evaluations = sorted({str(row["evaluation"]) for row in inside if row.get("evaluation") is not None})
    evaluation = random.choice(evaluations) if evaluations and random.random() < 0.3 else None
    metrics = [random.choice(ERRORS if random.random() < 0.7 else LOADS)]
    metrics += random.sample(
        [name for name in (*ERRORS, *LOADS) if name not in metrics], random.randint(0, 2)
    )
    known = {name for row in inside for name, value in row.items() if value is not None}
    by, competitors = random.choice(BY), random.choice(COMPETITORS)
    return Question(
        sweeps=asked,
        evaluation=evaluation,
        condition=random.choice(CONDITIONS) if random.random() < 0.4 else None,
        superseded=random.random() < 0.3,
        reused=random.random() < 0.2,
        outcomes=random.choice(("tracked", "tracked", "all")),
        metrics=tuple(metrics),
        by=by if by is None or known.issuperset(by) else None,
        competitors=competitors if known.issuperset(competitors) else ("algorithm", "sensors"),
    )


def check(
    views: Views, tables: Tables, random: Random, names: Sequence[str] = ()
) -> Iterator[tuple[Question, str]]:
    """Put an archive into a home and ask it questions; go through what is shown wrongly."""
    views.write(tables)
    rows = reckoned(views.home)
    warnings.simplefilter("ignore", LeftOutWarning)
    if random.random() < ODD:
        spoil(views.home / "archive.sqlite", random)
    for _ in range(QUESTIONS):
        asked = question(random, rows)
        fitting = [name for name in VIEWS if len(asked.sweeps) < 2 or name not in ONE_SWEEP]
        chosen = names or random.sample(fitting, VIEWS_AT_ONCE)
        for problem in problems(views, asked, rows, [name for name in chosen if name in fitting]):
            yield asked, problem


def reckoned(home: Path) -> list[Row]:
    """Return the rows of a home's archive by the definition."""
    engine = create_engine(f"sqlite:///{home / 'archive.sqlite'}")
    try:
        return reckoning.all_rows(reckoning.read(engine))
    finally:
        engine.dispose()


def main() -> int:
    """Check archives; returns the exit code."""
    parser = argparse.ArgumentParser(description="Compare every view with the definition.")
    parser.add_argument("--archives", type=int, default=100, help="how many archives")
    parser.add_argument("--seed", type=int, default=0, help="number of the first")
    parser.add_argument("--view", action="append", choices=sorted(VIEWS), help="only this one; several times")
    parser.add_argument("--keep", type=Path, help="folder for archives that are shown wrongly")
    parser.add_argument(
        "--break", type=int, choices=range(1, len(BREAKS) + 1), dest="mistake", help="break a line first"
    )
    parser.add_argument("--go-on", action="store_true", help="don't stop at the first, count by view")
    options = parser.parse_args()
    start, wrong = time.monotonic(), Counter[str]()
    with ExitStack() as stack:
        views = stack.enter_context(Views(Path(stack.enter_context(TemporaryDirectory()))))
        if options.mistake:
            print(f"broken: {BREAKS[options.mistake - 1].what}")
            stack.enter_context(broken(BREAKS[options.mistake - 1]))
        for number in range(options.seed, options.seed + options.archives):
            tables = archives.made_up(Random(number))
            found = list(check(views, tables, Random(-1 - number), options.view or ()))
            if found:
                _say(number, tables, found, options.keep)
                wrong.update({problem.partition(":")[0] for _, problem in found})
                if not options.go_on:
                    return 1
            if (done := number - options.seed + 1) % 100 == 0:
                print(f"{done:,} archives, {time.monotonic() - start:.0f} s", flush=True)
    print(f"{options.archives:,} archives of {options.seed}: {dict(wrong) or 'all views agree'}")
    return 1 if wrong else 0


def _say(number: int, tables: Tables, found: Sequence[tuple[Question, str]], keep: Path | None) -> None:
    for asked, problem in found[:5]:
        print(f"archive {number}, {asked}:\n  {problem}")
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        content = {"seed": number, "question": asdict(found[0][0]), "problem": found[0][1], **tables}
        (keep / f"{number}.json").write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    sys.exit(main())
