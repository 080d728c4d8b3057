# SPDX-License-Identifier: Apache-2.0
"""Comparison of what the views show with what was computed apart: a sentence for each difference."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import reckoning
from views import PARTS, SHOWN, texts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from reckoning import Board, Figure, Group, Question, Row
    from views import Record, Report, Views

COSTS = ("usage.cpu.seconds", "usage.memory.peakBytes")
_UNITS = {"usage.memory.peakBytes": 2.0**-20}
_LAST_DIGIT = 0.50001e-5


def problems(views: Views, question: Question, rows: Sequence[Row], names: Iterable[str]) -> list[str]:
    """Return the faults of some views, a sentence each.

    Args:
        views: the project, on an archive.
        question: what is asked.
        rows: of the same archive, as ``reckoning.all_rows`` has them.
        names: of the views, as in VIEWS.
    """
    found = []
    for name in names:
        meant = replace(question, reused=True) if name in EACH else question
        if name not in REUSED | EACH:
            meant = replace(meant, reused=False)
        chosen = reckoning.choose(_of_api(rows, meant) if name.startswith("api") else rows, meant)
        try:
            found += [f"{name}: {problem}" for problem in VIEWS[name](views, meant, chosen.rows)]
            if name == "api aggregate json" and chosen.rows:
                said, right = views.left_out(meant), (len(chosen.superseded), len(chosen.reused))
                found += [f"{name}: runs left out are {said}, not {right}"] if said != right else []
        except Exception as error:  # noqa: BLE001 - whatever goes wrong in a view is what is looked for
            found.append(f"{name}: {type(error).__name__}: {error}")
    return found


def _of_api(rows: Sequence[Row], question: Question) -> Sequence[Row]:
    """Return the rows that the API means by an evaluation: to it that is a condition like others."""
    if question.evaluation is None:
        return rows
    return [row for row in rows if row.get("evaluation") == question.evaluation]


# Rows


def _rows(shown: Sequence[Record], expected: Sequence[Row], columns: Sequence[str] = SHOWN) -> list[str]:
    """Compare rows by run and evaluation, texts of CSV or values."""

    def identity(row: Mapping[str, Any]) -> tuple[str, str]:
        return str(row["uid"]), row.get("evaluation") or ""

    mine, theirs = {identity(row): row for row in expected}, Counter(map(identity, shown))
    found = [f"row {key} is missing" for key in mine.keys() - theirs.keys()]
    found += [f"row {key} is there {n} times" for key, n in theirs.items() if n > 1]
    found += [f"row {key} is there and ought not be" for key in theirs.keys() - mine.keys()]
    for row in shown:
        right = mine.get(identity(row), row)
        found += [
            f"row {identity(row)}: {name} is {row[name]!r}, not {right.get(name)!r}"
            for name in (*columns, "status")
            if name in row and not _equal(row[name], right.get(name))
        ]
    return found


def _equal(shown: Any, right: Any) -> bool:
    if isinstance(right, int | float) and not isinstance(right, bool):
        return shown not in (None, "") and _close(float(shown), float(right))
    return shown == right or (isinstance(shown, str) and [shown] == texts([right]))


def _close(one: float | None, other: float | None, size: float = 0.0) -> bool:
    if one is None or other is None:
        return one is other
    return one == other or math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12 + 1e-9 * abs(size))


# Groups


def _groups(shown: Sequence[Record], expected: Sequence[Group]) -> list[str]:
    return _matched(shown, expected, _same_keys, _group)


def _matched(
    shown: Sequence[Record],
    expected: Sequence[Any],
    may_be: Callable[[Record, Any], bool],
    differences: Callable[[Record, Any], list[str]],
) -> list[str]:
    """Pair what is shown with what is expected, each once, and say what differs."""
    left, found, later = list(expected), [], []
    for one in shown:
        like = [other for other in left if may_be(one, other)]
        right = next((other for other in like if not differences(one, other)), None)
        if right is None:
            later.append(one)
        else:
            left = [other for other in left if other is not right]
    for one in later:
        like = [other for other in left if may_be(one, other)]
        if not like:
            found.append(f"{_keys_of(one)} is there and ought not be")
            continue
        left = [other for other in left if other is not like[0]]
        found += [f"{_keys_of(one)}: {difference}" for difference in differences(one, like[0])]
    return found + [f"{_keys_of(other)} is missing" for other in left]


def _keys_of(one: Any) -> str:
    return str(one["keys"] if isinstance(one, dict) else one.keys)


def _same_keys(shown: Record, expected: Any) -> bool:
    """Tell whether a group's keys are those of another, which may have further ones."""
    return all(_equal(value, _shared(expected, name)) for name, value in shown["keys"].items())


def _shared(group: Group, name: str) -> Any:
    """Return a group's key, or the value that its rows share of a column that is no key."""
    if name in group.keys:
        return group.keys[name]
    values = {repr(row.get(name)): row.get(name) for row in group.rows if row.get(name) is not None}
    return next(iter(values.values())) if len(values) == 1 else None if not values else ("several",)


def _group(shown: Record, right: Group) -> list[str]:
    found = []
    for name, value in (
        ("runs", right.runs),
        ("n", right.n),
        ("copies", right.copies),
        ("failures", right.failures),
        ("total", sum(right.failures.values())),
        ("untracked", right.untracked),
        ("deterministic", right.deterministic),
    ):
        if name in shown and shown[name] != value:
            found.append(f"{name} is {shown[name]}, not {value}")
    for name, parts in [*shown.get("figures", {}).items(), ("coverage", shown.get("coverage") or {})]:
        figure = right.coverage if name == "coverage" else right.figures[name]
        found += _figure(name, parts, figure)
    return found


def _figure(name: str, shown: Mapping[str, Any], right: Figure) -> list[str]:
    return [
        f"{name}.{part} is {shown[part]}, not {getattr(right, part)}"
        for part in PARTS
        if part in shown and not _close(_float(shown[part]), getattr(right, part), right.max or 0.0)
    ]


def _float(value: Any) -> float | None:
    return None if value in (None, "") else float(value)


def _printed(shown: Record, right: Group) -> list[str]:
    """Compare a group whose numbers are texts of five decimals."""
    found = [
        f"{name} is {shown[name]}, not {value}"
        for name, value in (
            ("n", right.n),
            ("failures", right.failures),
            ("untracked", right.untracked),
            ("repeating", right.copies > 0),
        )
        if shown[name] != value
    ]
    for name, texts_ in shown["figures"].items():
        figure = right.figures[name]
        for part in ("mean", "std"):
            value = getattr(figure, part)
            if not _rounded(texts_[part], None if value is None else value * _UNITS.get(name, 1.0)):
                found.append(f"{name}.{part} is {texts_[part]}, not {value}")
    return found


def _rounded(text: str | None, value: float | None) -> bool:
    number = re.match(r"-?\d+\.\d+", text or "")
    if number is None or value is None:
        return number is None and value is None
    return abs(float(number[0]) - value) <= _LAST_DIGIT * (1 + 1e-9 * abs(value))


def _latex(shown: Record, right: Group) -> list[str]:
    found = []
    for (name, figure), cell in zip(right.figures.items(), shown["cells"], strict=True):
        mean, _, std = cell.partition("±")
        factor = _UNITS.get(name, 1.0)
        wanted = [None if part is None else part * factor for part in (figure.mean, figure.std)]
        if not _rounded(mean.strip(), wanted[0]) or not _rounded(std.strip(), wanted[1]):
            found.append(f"{name} is {cell!r}, not {wanted[0]} ± {wanted[1]}")
    counted = right.n + right.copies
    of = f" ({counted}/{right.runs})" if right.copies else f"/{right.runs}"
    count = str(right.n) if counted == right.runs else f"{right.n}{of}"
    if shown.get("n", count) != count:
        found.append(f"n is {shown['n']}, not {count}")
    return found


def _latex_keys(shown: Record, right: Group) -> bool:
    """Tell whether all texts that stand before the numbers of a place are keys of a group."""
    held = Counter("--" if value is None else text for value, text in _key_texts(right))
    return not Counter(key or "--" for key in shown["keys"]) - held


def _key_texts(group: Group) -> list[tuple[Any, str]]:
    return list(zip(group.keys.values(), texts(list(group.keys.values())), strict=True))


# Boards


class _Place:
    """A competitor on a dataset, with what its board says of it.

    Args:
        board: the board.
        place: competitor and dataset.
    """

    def __init__(self, board: Board, place: tuple[Any, Any]) -> None:
        self.standing = board.standings[place]
        self.keys = self.standing.group.keys
        self.rank = board.ranks.get(place[0])
        score = board.scores.get(place[0])
        self.score = None if score is None else float(score)


def _places(boards: Iterable[Board]) -> list[_Place]:
    return [_Place(board, place) for board in boards for place in board.standings]


def _shown_places(boards: Iterable[Record]) -> list[Record]:
    return [
        {
            **standing,
            "keys": {**board["facets"], **entry["keys"], "dataset": standing["dataset"]},
            "entry": entry,
        }
        for board in boards
        for entry in board["entries"]
        for standing in entry["standings"]
    ]


def _same_place(shown: Record, right: _Place) -> bool:
    return _same_keys(shown, right.standing.group)


def _place(shown: Record, right: _Place) -> list[str]:
    standing, entry = right.standing, shown["entry"]
    group = standing.group
    metric = next(iter(group.figures))
    found = []
    for name, one, other in (
        ("rank on the dataset", shown["rank"], standing.rank),
        ("coverage", shown["coverage"], group.coverage.mean),
        ("rank", entry["rank"], right.rank),
        ("score", entry["score"], right.score),
        ("runs", shown["runs"], group.runs),
        ("n", shown.get("n", group.n), group.n),
    ):
        if not _close(_float(one), other):
            found.append(f"{name} is {one}, not {other}")
    median = math.inf if shown.get("medianFailed") else _float(shown["median"])
    failed = standing.median == math.inf
    if not (median is None and failed and "medianFailed" not in shown) and not _close(
        median, standing.median
    ):
        found.append(f"median is {median}, not {standing.median}")
    if shown["failures"] != group.failures:
        found.append(f"failures is {shown['failures']}, not {group.failures}")
    return found + _figure(metric, shown["figure"] or {"n": 0}, group.figures[metric])


# One function a view: what differs


def _table_of(form: str) -> Callable[[Views, Question, Sequence[Row]], list[str]]:
    def check(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
        return _groups(views.table(question, form), reckoning.groups(rows, question))

    return check


def _printed_table(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    shown = [one | {"keys": {}} for one in views.printed(question)]
    return _matched(shown, reckoning.groups(rows, question), lambda *_: True, _printed)


def _aggregate(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    return _groups(views.aggregate(question), reckoning.groups(rows, question))


def _aggregate_csv(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    return _groups(views.aggregate(question, flat=True), reckoning.groups(rows, question))


def _repeatability(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    settings = [name for name in reckoning.varying(rows) if not name.startswith("dataset.attributes.")]
    asked = replace(
        question,
        metrics=question.metrics[:1],
        by=("algorithm", "sensors", "dataset", *settings),
        outcomes="tracked",
    )
    expected = [group for group in reckoning.groups(rows, asked) if group.runs > 1]
    return _groups(views.repeated(question), expected)


def _with_figure(rows: Sequence[Row], metric: str) -> list[Row]:
    """Return rows without those of evaluations that measure no such figure, which a report leaves out."""
    kept = []
    for inside in reckoning.split(rows, ["evaluation"]).values():
        tracked = any(row["status"] == "Tracked" for row in inside)
        if not tracked or any(isinstance(row.get(metric), int | float) for row in inside):
            kept += inside
    return kept


def _paper_of(columns: str, *, median: bool = False) -> Callable[[Views, Question, Sequence[Row]], list[str]]:
    def check(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
        if not rows:
            return []
        asked = _paper_question(question, columns)
        expected = reckoning.groups(rows, asked)
        return _groups(views.paper(question, columns=columns, median=median), expected)

    return check


def _paper_question(question: Question, columns: str) -> Question:
    by = question.by or ("algorithm", "sensors")
    return replace(question, by=tuple(dict.fromkeys([*by, *([columns] if columns else [])])))


def _latex_of(columns: str) -> Callable[[Views, Question, Sequence[Row]], list[str]]:
    def check(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
        if not rows:
            return []
        expected = reckoning.groups(rows, _paper_question(question, columns))
        shown = views.latex(question, columns=columns)
        # Where nothing was run stand dashes.
        shown = [one for one in shown if set(one["cells"]) != {"--"} or one.get("n", "--") != "--"]
        found = _matched(shown, expected, _latex_keys, _latex)
        dashes = [group for group in expected if all(figure.n == 0 for figure in group.figures.values())]
        return found if len(found) > len(dashes) else [one for one in found if not one.endswith("is missing")]

    return check


def _leaderboard(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    expected = _places(reckoning.boards(rows, _ranked(question)))
    return _matched(_shown_places(views.leaderboard(question)), expected, _same_place, _place)


def _ranked(question: Question, *metrics: str) -> Question:
    return replace(question, metrics=(question.metrics[0], *metrics))


def _compare(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    expected: Counter[str] = Counter()
    for board in reckoning.boards(rows, _ranked(question)):
        for a in board.scores:
            for b in board.scores:
                pairs = sorted(
                    (texts([dataset])[0], _shown_median(one.median), _shown_median(other.median))
                    for (competitor, dataset), one in board.standings.items()
                    if competitor == a
                    and one.median is not None
                    and (other := board.standings.get((b, dataset))) is not None
                    and other.median is not None
                )
                if pairs and a != b:
                    expected[_pair(board.facets, texts(a), texts(b), pairs)] += 1
    found = []
    for pair in views.compared(question):
        shown = sorted(
            (texts([one["dataset"]])[0], _short(one["a"]), _short(one["b"])) for one in pair["datasets"]
        )
        first, second = texts(list(pair["a"].values())), texts(list(pair["b"].values()))
        for key in (
            _pair(pair["facets"], first, second, shown),
            _pair(pair["facets"], second, first, sorted((name, y, x) for name, x, y in shown)),
        ):
            if not expected[key]:
                found.append(f"pair {key} is there and ought not be")
            expected[key] -= 1
        wins = [sum(_less(x, y) for _, x, y in shown), sum(_less(y, x) for _, x, y in shown)]
        if wins != [pair["wins"]["a"], pair["wins"]["b"]]:
            found.append(f"pair {first} {second}: wins are {pair['wins']}, not {wins}")
    return found + [f"pair {key} is missing" for key, count in expected.items() if count > 0]


def _pair(facets: Mapping[str, Any], a: Sequence[str], b: Sequence[str], pairs: Sequence[Any]) -> str:
    # Facets that others determine may stay away: medians and names tell boards apart.
    return f"{a} {b} {pairs}"


def _shown_median(median: float | None) -> str:
    return _short(None if median == math.inf else median)


def _short(median: float | None) -> str:
    return "failed" if median is None else f"{median:.9g}"


def _less(one: str, other: str) -> bool:
    numbers = [math.inf if text == "failed" else float(text) for text in (one, other)]
    return numbers[0] < numbers[1]


def _fronts(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    cost = COSTS[len(rows) % len(COSTS)]
    expected = _places(reckoning.boards(rows, _ranked(question, cost)))
    shown = []
    for point in views.fronts(question, cost):
        keys = point["facets"] | point["keys"]
        shown.append(point | {"keys": keys})
    return _matched(shown, expected, _same_place, _point)


def _point(shown: Record, right: _Place) -> list[str]:
    group = right.standing.group
    found = [
        f"{name} is {shown[name]}, not {value}"
        for name, value in (("runs", group.runs), ("n", group.n), ("failures", group.failures))
        if shown[name] != value
    ]
    median = math.inf if shown["yFailed"] else shown["y"]
    if not _close(median, right.standing.median):
        found.append(f"median is {median}, not {right.standing.median}")
    if not _close(shown["coverage"], group.coverage.mean):
        found.append(f"coverage is {shown['coverage']}, not {group.coverage.mean}")
    return found


def _importance(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    asked = replace(question, by=("algorithm", "sensors", "dataset"), metrics=question.metrics[:1])
    groups = reckoning.groups(rows, asked)
    found = []
    for subject in views.subjects(question):
        like = [group.runs for group in groups if _same_keys(subject, group)]
        if subject["runs"] not in like:
            found.append(f"{subject['keys']}: runs is {subject['runs']}, not {like}")
    return found


def _report(views: Views, question: Question, rows: Sequence[Row]) -> list[str]:
    if not rows:
        return []
    metric = question.metrics[0]
    known = any(row.get("parameters.n") is not None for row in rows)
    page = views.report(question, f"parameters.n:{metric}:algorithm" if known else "none")
    ranked = _with_figure(rows, metric)
    found = [
        f"runs.csv: {one}" for one in _rows(page.files["runs"], rows, (*SHOWN[:2], "coverage", "reason"))
    ]
    found += [f"outcomes.csv: {one}" for one in _outcomes(page, rows)]
    boards = reckoning.boards(ranked, _ranked(question))
    places = [place for place in _places(boards) if len(boards) <= 12]
    if len(boards) <= 12:
        found += [
            f"leaderboard: {one}"
            for one in _matched(_shown_places(page.boards()), places, _same_place, _place)
        ]
    if known and "analysis-1" in page.files:
        told = ["algorithm"] if len({row["algorithm"] for row in rows}) > 1 else []
        asked = replace(question, by=(*told, "parameters.n"), metrics=(metric,))
        expected = reckoning.groups(ranked, asked)
        found += [f"analysis: {one}" for one in _groups(page.groups(question), expected)]
        found += [f"analysis: {one}" for one in _counts(page.tables["analysis-1"], expected)]
    return found


def _outcomes(page: Report, rows: Sequence[Row]) -> list[str]:
    """Compare the report's counts of what became of the runs."""
    shown: Counter[str] = Counter()
    for row in page.files["outcomes"]:
        keys = {"algorithm", "sensors", "evaluation", "runs"}
        shown.update({name: int(value) for name, value in row.items() if name not in keys})
    right = Counter(row["status"] for row in rows)
    total = sum(int(row["runs"]) for row in page.files["outcomes"])
    found = [] if total == len(rows) else [f"runs are {total}, not {len(rows)}"]
    return found if +shown == right else [*found, f"outcomes are {dict(shown)}, not {dict(right)}"]


def _counts(table: Sequence[Sequence[str]], expected: Sequence[Group]) -> list[str]:
    """Compare the counts in a table that is read, not saved."""
    column = table[0].index("n/runs")
    shown = Counter(line[column].replace(" = / ", "/") for line in table[1:])
    right = Counter(f"{group.n}/{group.runs}" for group in expected)
    return [] if shown == right else [f"n/runs on the page are {dict(shown)}, not {dict(right)}"]


VIEWS: dict[str, Callable[[Views, Question, Sequence[Row]], list[str]]] = {
    "results list": lambda views, question, rows: _rows(views.listed(question), rows),
    "results export json": lambda views, question, rows: _rows(views.exported(question), rows),
    "results export csv": lambda views, question, rows: _rows(views.exported(question, "csv"), rows),
    "pandas": lambda views, question, rows: _rows(views.framed(question, "pandas"), rows),
    "polars": lambda views, question, rows: _rows(views.framed(question, "polars"), rows),
    "api runs": lambda views, question, rows: _rows(views.paged(question), rows),
    "api points": lambda views, question, rows: _rows(views.points(question), rows),
    "results table json": _table_of("json"),
    "results table csv": _table_of("csv"),
    "results table markdown": _printed_table,
    "api aggregate json": _aggregate,
    "api aggregate csv": _aggregate_csv,
    "api repeatability": _repeatability,
    "paper-table csv": _paper_of("dataset"),
    "paper-table csv median": _paper_of("dataset", median=True),
    "latex": _latex_of("dataset"),
    "latex without columns": _latex_of(""),
    "api leaderboard": _leaderboard,
    "api compare": _compare,
    "api pareto": _fronts,
    "api importance": _importance,
    "report": _report,
}
"""By name: what differs between a view and the rows that a question means."""

REUSED = frozenset({"results export json", "results export csv", "pandas", "polars"})
"""Views that can show rows of equal content all."""

EACH = frozenset({"results list", "api runs"})
"""Views that show runs one by one: those of equal content all."""

ONE_SWEEP = frozenset(name for name in VIEWS if name.startswith("results"))
"""Views that can be asked for one sweep at most."""
