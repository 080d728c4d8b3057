# SPDX-License-Identifier: Apache-2.0
"""``slamhive status``: Sweeps, runs and Evaluations of a cluster as tables, once or as they change."""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from typing import TYPE_CHECKING, Any

import typer
from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from slamhive.cli.cluster.work import ClusterPlace
from slamhive.cli.parts.console import bytes_text, out, remark
from slamhive.kube.api.errors import ApiError
from slamhive.kube.api.kinds import Kind, labels_of
from slamhive.kube.status import metres, moment, phase_of
from slamhive.kube.user.queries import (
    NamespacePicture,
    extent,
    look_around,
    look_at,
    name_of,
    status_of,
    troubles,
)
from slamhive.model.base import plural
from slamhive.model.errors import InputError, SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from slamhive.kube.user.connecting import ConnectedCluster

    Object = Mapping[str, Any]

_BAR = 16
_FAILURES = 20
_RUNS = 20
_CONDITION = 120
_GOOD = {"Succeeded": "green", "Complete": "green", "Failed": "red", "TooManyFailures": "red"}
_FIGURES = ("ate", "cpu", "memory")
_SWEEP = (
    "sweep",
    "phase",
    "",
    "done",
    "in flight",
    "line",
    "ends",
    "failed",
    "evaluated",
    "best",
    "ATE",
    "age",
)
_RUN = ("run", "phase", "algorithm", "dataset", "outcome", "ATE", "cores", "memory", "age")
_ROOMY = 120
_SPARED = frozenset({"best", "evaluated", "age", "dataset", "memory", "line"})
"""Columns that a narrow terminal does without while it watches."""
_EVALUATION = ("evaluation", "evaluated", "failed", "age")

LOOK_SECONDS = 2.0
_WIDEST = 10_000


def render(
    cluster: ConnectedCluster, picture: NamespacePicture, most: int | None = _RUNS, width: int | None = None
) -> RenderableType:
    """Return tables of what there is, with sentences about what is wrong.

    Args:
        cluster: where it is.
        picture: what there is.
        most: runs to show at most.
        width: characters that there is room for; None: as many as it takes.
    """
    parts: list[RenderableType] = []
    spared = _SPARED if width is not None and width < _ROOMY else frozenset()
    if picture.sweeps:
        parts.append(_table(_SWEEP, map(_sweep_line, picture.sweeps), spared))
    if picture.runs:
        recent = picture.runs[-most:] if most else picture.runs
        parts.append(_table(_RUN, map(_run_line, recent), spared))
        if len(recent) < len(picture.runs):
            parts.append(Text(f"… and {plural(len(picture.runs) - len(recent), 'earlier run')}"))
    if picture.evaluations:
        parts.append(_table(_EVALUATION, map(_evaluation_line, picture.evaluations)))
    now = time.time()
    for kind, body in picture.objects:
        parts += [_warning(f"{name_of(body)}: {text}") for text in troubles(kind, body, now)]
    for runs in picture.failed.values():
        parts += _failures(runs)
    return Group(*parts) if parts else Text(f"nothing in namespace {cluster.namespace}")


def details(picture: NamespacePicture) -> list[RenderableType]:
    """Return all that is to be said of what was asked for by name."""
    now = time.time()
    parts: list[RenderableType] = []
    for kind, body in picture.objects:
        lines = {Kind.SWEEP: _of_sweep, Kind.MAPPING_RUN: _of_run}.get(kind, _of_evaluation)(body)
        inside: list[RenderableType] = [Text(f"{kind} {name_of(body)}", style="bold")]
        inside.append(_pairs((label, text) for label, text in lines if text))
        best = status_of(body).get("best") if kind is Kind.SWEEP else None
        if best:
            inside.append(_table(("best", "algorithm", "dataset", "ATE", "coverage"), map(_best_line, best)))
        inside += [_warning(text) for text in troubles(kind, body, now)]
        if kind is Kind.SWEEP:
            inside += _failures(picture.failed.get(name_of(body), []), status_of(body).get("failed", 0))
        elif kind is Kind.MAPPING_RUN:
            inside += _conditions(body)
        parts.append(Group(*inside))
    return parts


def _of_sweep(body: Object) -> list[tuple[str, str]]:
    found = status_of(body)
    # Those in flight are prepared, wait for a node, or run.
    counts = [f"{found.get('running', 0):,} in flight"]
    counts += [f"{found.get(word, 0):,} {word}" for word in ("pending", "succeeded", "failed")]
    counts += [f"{found[word]:,} {word}" for word in ("reused", "evaluated") if found.get(word)]
    return [
        ("phase", str(found.get("phase", "Pending"))),
        ("runs", f"{_bar(found)} {found.get('progress', '')}  {', '.join(counts)}"),
        *_share(found.get("share") or {}),
        ("settings", _settings(found.get("search") or {})),
        ("CPU time", f"{found['cpuSeconds']:,.1f} s" if found.get("cpuSeconds") else ""),
        ("started", str(found.get("startTime") or "")),
        ("completed", str(found.get("completionTime") or "")),
    ]


def _share(share: Object) -> list[tuple[str, str]]:
    """Return the lines on a Sweep's share of the cluster, its place in the line, and its forecast."""
    if not share:
        return []
    slots = f"{share['of']} slots" if share.get("of") else "the cluster"
    others = plural(share.get("sweeps") or 1, "Sweep"), plural(share.get("namespaces") or 1, "namespace")
    times = [f"{word}s {share[word]}" for word in ("begin", "end") if share.get(word)]
    return [
        ("share", f"{share.get('fair', 0):g} runs of {slots}, with {others[0]} of {others[1]}"),
        ("priority", str(share.get("priority") or "")),
        ("in line", f"place {share['place']}" if share.get("place") else ""),
        ("forecast", "; ".join(filter(None, (", ".join(times), str(share.get("forecast") or ""))))),
        ("limited by", str(share.get("limit") or "")),
        ("sooner by", str(share.get("sooner") or "")),
    ]


def _settings(search: Object) -> str:
    """Return the number of settings that a search has tried, and the best one; empty where it is none."""
    if not search:
        return ""
    parts = [f"{search.get('asked', 0):,} of {search.get('most', 0):,} tried"]
    for best in (search.get("best") or ())[:1]:
        figures = ", ".join(f"{figure:.4g}" for figure in best.get("figures") or ())
        parts.append(f"best: {json.dumps(best['values'])[1:-1]} ({figures})")
    return ", ".join(parts)


def _of_run(body: Object) -> list[tuple[str, str]]:
    found, spec = status_of(body), body["spec"]
    usage, provenance = found.get("usage") or {}, found.get("provenance") or {}
    cpu, memory = usage.get("cpu") or {}, usage.get("memory") or {}
    trajectory = found.get("trajectory") or {}
    return [
        ("phase", " ".join(str(found.get(key) or "") for key in ("phase", "reason")).strip() or "Pending"),
        ("message", str(found.get("message") or "")),
        ("algorithm", spec["algorithmRef"]["name"]),
        ("dataset", spec["datasetRef"]["name"]),
        ("parameters", json.dumps(spec["parameters"]) if spec.get("parameters") else ""),
        ("attempts", str(found.get("attempts") or "")),
        ("started", str(found.get("startTime") or "")),
        ("completed", str(found.get("completionTime") or "")),
        *[(f"result {item['evaluation']}", _result(item)) for item in found.get("results") or ()],
        (
            "CPU",
            f"{cpu['seconds']:.1f} s, {cpu.get('meanCores') or 0:.2f} cores" if cpu.get("seconds") else "",
        ),
        ("memory", bytes_text(memory["peakBytes"]) if memory.get("peakBytes") else ""),
        ("wall time", f"{usage['wallSeconds']:.1f} s" if usage.get("wallSeconds") else ""),
        ("trajectory", plural(trajectory["poses"], "pose") if trajectory else ""),
        ("node", str(provenance.get("node") or "")),
        ("reused from", str(provenance.get("reusedFrom") or "")),
        ("folder", str(found.get("folder") or "")),
    ]


def _of_evaluation(body: Object) -> list[tuple[str, str]]:
    found = status_of(body)
    outcomes = (found.get("summary") or {}).get("outcomes") or {}
    return [
        ("runs", str(found.get("runs", 0))),
        ("evaluated", str(found.get("evaluated", 0))),
        ("failed", str(found.get("failed", 0))),
        ("outcomes", ", ".join(f"{count} {word}" for word, count in sorted(outcomes.items()))),
    ]


def _result(item: Object) -> str:
    error = (item.get("ate") or {}).get("rmse")
    parts = [str(item["outcome"])]
    parts += [f"ATE {metres(error)}"] if error is not None else []
    parts += [f"coverage {item['coverage']:.3f}"] if item.get("coverage") is not None else []
    return ", ".join(parts)


def _sweep_line(body: Object) -> list[RenderableType]:
    found = status_of(body)
    best, share = found.get("best") or [{}], found.get("share") or {}
    failed = found.get("failed", 0)
    return [
        Text(name_of(body)),
        _phase(str(found.get("phase", "Pending"))),
        Text(_bar(found)),
        Text(str(found.get("progress", "–"))),
        Text(str(found.get("running", 0))),
        Text(str(share.get("place") or "–")),
        Text(str(share.get("end") or "–")),
        Text(str(failed), style="red" if failed else ""),
        Text(str(found.get("evaluated", 0))),
        Text(str(best[0].get("name", "–"))),
        Text(metres(best[0]["ate"]) if "ate" in best[0] else "–"),
        Text(_age(body)),
    ]


def _run_line(body: Object) -> list[RenderableType]:
    found, spec = status_of(body), body["spec"]
    shown, results = found.get("display") or {}, found.get("results") or [{}]
    words = (str(results[0].get("outcome", "–")), *(str(shown.get(key, "–")) for key in _FIGURES), _age(body))
    where = (spec["algorithmRef"]["name"], spec["datasetRef"]["name"])
    return [Text(name_of(body)), _phase(str(phase_of(found))), *map(Text, (*where, *words))]


def _evaluation_line(body: Object) -> list[RenderableType]:
    found = status_of(body)
    done = f"{found.get('evaluated', 0)}/{found.get('runs', 0)}"
    return [*map(Text, (name_of(body), done, str(found.get("failed", 0)), _age(body)))]


def _best_line(entry: Object) -> list[RenderableType]:
    covered = f"{entry['coverage']:.3f}" if "coverage" in entry else "–"
    words = (entry["name"], entry.get("algorithm", "–"), entry.get("dataset", "–"), metres(entry["ate"]))
    return [*map(Text, (*words, covered))]


def _failures(runs: Sequence[Object], count: int | None = None) -> list[RenderableType]:
    """Return a table of failed runs, and how many there are for which reason."""
    if not runs:
        return [Text("failed runs: none is in the cluster any more")] if count else []
    reasons = Counter(str(status_of(run).get("reason") or phase_of(status_of(run))) for run in runs)
    told = ", ".join(f"{number} {reason}" for reason, number in reasons.most_common())
    lines = [
        [
            Text(name_of(run)),
            Text(str(status_of(run).get("reason") or phase_of(status_of(run))), style="red"),
            Text(run["spec"]["algorithmRef"]["name"]),
            Text(run["spec"]["datasetRef"]["name"]),
            Text(_first(str(status_of(run).get("message") or ""))),
        ]
        for run in runs[:_FAILURES]
    ]
    parts: list[RenderableType] = [Text(f"failed runs: {told}")]
    parts.append(_table(("run", "reason", "algorithm", "dataset", "message"), lines))
    if len(runs) > _FAILURES:
        parts.append(Text(f"… and {len(runs) - _FAILURES} more (--json has all)"))
    return parts


def _conditions(body: Object) -> list[RenderableType]:
    conditions = status_of(body).get("conditions") or ()
    lines = [
        [*map(Text, (item["type"], item["status"], item.get("reason", ""), _first(item.get("message", ""))))]
        for item in conditions
    ]
    return [_table(("condition", "", "reason", "message"), lines)] if lines else []


def _first(text: str) -> str:
    line = next(iter(text.splitlines()), "")
    return line if len(line) <= _CONDITION else line[: _CONDITION - 1] + "…"


def _table(
    headings: Sequence[str], lines: Iterable[Sequence[RenderableType]], spared: Container[str] = ()
) -> Table:
    table = Table(header_style="bold", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for heading in headings:
        if heading not in spared:
            table.add_column(heading, no_wrap=heading != "message")
    for line in lines:
        table.add_row(*(cell for heading, cell in zip(headings, line, strict=True) if heading not in spared))
    return table


def _pairs(lines: Iterable[tuple[str, str]]) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for label, text in lines:
        table.add_row(label, Text(text))
    return table


def _warning(text: str) -> Text:
    return Text(text, style="yellow")


def _phase(word: str) -> Text:
    return Text(word, style=_GOOD.get(word, ""))


def _bar(found: Object) -> str:
    """Return the share of runs that are done, or of settings that are decided, as a bar of characters."""
    total, done = extent(found)
    filled = _BAR * done // total if total else 0
    return "█" * filled + "░" * (_BAR - filled)


def _age(body: Object) -> str:
    """Return the age of an object as kubectl shows it, in its largest unit."""
    seconds = max(0.0, time.time() - (moment(body["metadata"].get("creationTimestamp")) or time.time()))
    for size, unit in ((86400, "d"), (3600, "h"), (60, "m")):
        if seconds >= size:
            return f"{int(seconds // size)}{unit}"
    return f"{int(seconds)}s"


def status(names: Sequence[str], place: ClusterPlace, *, watch: bool, as_json: bool) -> None:
    """Show what is known by some names, or all that there is; stay as long as that changes if asked."""

    async def work() -> None:
        async with place.connect() as cluster:
            picture = await _look(cluster, names, None)
            if not watch:
                _print(cluster, picture, as_json=as_json, named=bool(names))
            elif as_json or not out.is_terminal:
                await _lines(cluster, names, picture, as_json=as_json)
            else:
                await _live(cluster, names, picture)

    try:
        asyncio.run(work())
    except KeyboardInterrupt:
        raise typer.Exit from None


async def _look(
    cluster: ConnectedCluster, names: Sequence[str], before: NamespacePicture | None
) -> NamespacePicture:
    return await look_at(cluster, names, before) if names else await look_around(cluster)


async def _next(
    cluster: ConnectedCluster, names: Sequence[str], before: NamespacePicture
) -> NamespacePicture:
    """Look again after a while; faults that pass leave the picture as it was."""
    await asyncio.sleep(LOOK_SECONDS)
    try:
        return await _look(cluster, names, before)
    except InputError as error:
        raise SlamHiveError(f"what is watched is gone meanwhile: {error}") from None
    except ApiError as error:
        if not error.retryable:
            raise
        return before


async def _live(cluster: ConnectedCluster, names: Sequence[str], picture: NamespacePicture) -> None:
    with Live(render(cluster, picture, width=out.width), console=out, auto_refresh=False) as live:
        while not (names and picture.is_over):
            picture = await _next(cluster, names, picture)
            live.update(render(cluster, picture, width=out.width), refresh=True)


async def _lines(
    cluster: ConnectedCluster, names: Sequence[str], picture: NamespacePicture, *, as_json: bool
) -> None:
    """Print a line of what changes where no terminal can show it in place."""
    shown: dict[str, str] = {}
    while True:
        if as_json:
            lines = {"": json.dumps(as_plain(picture), ensure_ascii=False)}
        else:
            lines = {f"{kind} {name_of(body)}": _line(kind, body) for kind, body in picture.objects}
        for key, line in lines.items():
            if shown.get(key) != line:
                typer.echo(line)
        shown = lines
        if names and picture.is_over:
            return
        picture = await _next(cluster, names, picture)


def _line(kind: Kind, body: Object) -> str:
    found, name = status_of(body), f"{kind} {name_of(body)}"
    bad = troubles(kind, body, time.time())
    if kind is Kind.MAPPING_RUN:
        text = f"{phase_of(found)} {found.get('message') or ''}".strip()
    elif kind is Kind.SWEEP:
        text = f"{found.get('phase', 'Pending')} {found.get('progress', '')}, {found.get('failed', 0)} failed"
    else:
        text = f"{found.get('evaluated', 0)} of {plural(found.get('runs', 0), 'run')} evaluated"
    return "; ".join([f"{name}: {text}", *(sentence.splitlines()[0] for sentence in bad)])


def _print(cluster: ConnectedCluster, picture: NamespacePicture, *, as_json: bool, named: bool) -> None:
    if as_json:
        typer.echo(json.dumps(as_plain(picture), indent=2, ensure_ascii=False))
        return
    # A name or number is better wrapped by the terminal than cut.
    terminal = out.is_terminal or None
    wide = Console(file=out.file, width=_WIDEST, highlight=False, force_terminal=terminal)
    if named:
        for number, part in enumerate(details(picture)):
            if number:
                wide.print()
            wide.print(part)
    elif picture.objects:
        wide.print(render(cluster, picture, most=None))
    else:
        remark(f"nothing in namespace {cluster.namespace}; slamhive submit sends something there")


def as_plain(picture: NamespacePicture) -> dict[str, Any]:
    """Return a picture as plain JSON values."""

    def plain(body: Object) -> dict[str, Any]:
        meta = body["metadata"]
        shown = {key: value for key, value in status_of(body).items() if key != "points"}
        return {
            "name": meta["name"],
            "namespace": meta.get("namespace"),
            "uid": meta["uid"],
            "created": meta.get("creationTimestamp"),
            "labels": dict(labels_of(body)),
            "status": shown,
        }

    return {
        "sweeps": [
            plain(body) | {"failedRuns": [plain(run) for run in picture.failed.get(name_of(body), [])]}
            for body in picture.sweeps
        ],
        "runs": [plain(body) for body in picture.runs],
        "evaluations": [plain(body) for body in picture.evaluations],
    }
