# SPDX-License-Identifier: Apache-2.0
"""``slamhive search``: what a search tried, where each setting stands, and the YAML of the best one."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamhive.cli.parts.asking import require_archive
from slamhive.cli.parts.console import out, remark
from slamhive.cli.parts.tables import show, write_json
from slamhive.cli.parts.waiting import time_text
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.model.search import Goal, SearchMethod

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from slamhive.analysis.frame import Frame
    from slamhive.archive import Archive, SweepRecord
    from slamhive.tables.searches import SearchStory, TriedSetting

app = typer.Typer(
    no_args_is_help=True, help="Searches in the archive: what they tried, and the best setting."
)

Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Sweep: NAME, NAMESPACE/NAME, or 8 digits of its identity.")
]


@app.command("show")
def show_search(
    name: Name, *, as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False
) -> None:
    """Show what a search tried: settings, their figures, why some were dropped, and the best so far.

    Example: slamhive search show tune
    """
    with told(name) as (record, story, _, _):
        if as_json:
            write_json(sys.stdout, [{"sweep": record.name, "uid": record.uid} | story.as_json()])
            return
        headings, lines = _table(story)
        show(out, headings, lines)
        for sentence in _sentences(record, story):
            out.print(sentence, markup=False, soft_wrap=True)


@app.command("best")
def best(
    name: Name,
    *,
    number: Annotated[
        int | None,
        typer.Option("--number", help="Which setting, by its number; needed where several are best."),
    ] = None,
    sweep: Annotated[
        bool, typer.Option("--sweep", help="A Sweep of it on all that the search went across, repeated.")
    ] = False,
    repetitions: Annotated[
        int | None,
        typer.Option(min=1, max=10_000, help="Repetitions of --sweep [as many as good settings got]."),
    ] = None,
) -> None:
    """Print the YAML of the best setting: its first run, or a sweep of it, and of generated datasets.

    Example: slamhive search best tune > best.yaml && slamhive run best.yaml
    """
    from slamhive.model.evaluation import EvaluationSettings
    from slamhive.tables.manifests import manifest, run_manifest, spec_again
    from slamhive.tables.searches import uid_of_run

    if repetitions is not None and not sweep:
        raise InputError("--repetitions: means nothing without --sweep")
    with told(name) as (record, story, archive, frame):
        trial = _chosen(record, story, number)
        uid = uid_of_run(frame, record.uid, trial.number * story.block)
        run = None if uid is None else archive.get(uid)
        if run is None:
            raise InputError(
                f"sweep {record.name}: the first run of setting {trial.number} is not in the archive"
            )
        # Of one name, the run would stand as a version of the sweep that supersedes the one before.
        title = f"{record.name}-{'best' if number is None else number}{'-sweep' if sweep else ''}"
        names = (
            {str(one) for one in frame.column("dataset").tolist()}
            if sweep
            else {run.spec["datasetRef"]["name"]}
        )
        for text in _datasets(archive, names):
            sys.stdout.write(f"{text}---\n")
        if not sweep:
            sys.stdout.write(run_manifest(run, title))
        else:
            labels = {label for context in story.contexts for label in context}
            across = [axis for axis in record.spec["matrix"] if _label(axis) in labels]
            spec = spec_again(run)
            for axis in across:
                if axis.get("path") == "dataset":
                    spec.pop("datasetRef")
            body: dict[str, Any] = {"template": {"spec": spec}, "matrix": across}
            body["repetitions"] = repetitions or story.search.repetitions.promote
            if record.spec.get("evaluation"):
                body["evaluation"] = record.spec["evaluation"]
            sys.stdout.write(manifest("Sweep", title, {}, body))
    remark(_words(story, trial))
    usual = EvaluationSettings().as_json()
    if not sweep and usual | (record.spec.get("evaluation") or {}) != usual:
        remark(
            "a MappingRun is measured by the default evaluation, the search was by its own: --sweep has it"
        )


def _datasets(archive: Archive, names: Collection[str]) -> Iterator[str]:
    """Yield the manifests of datasets that the catalog here has not, which came in the file of the sweep."""
    from slamhive.tables.manifests import manifest, without_nothing

    strange = set(names) - set(load_workshop().dataset_places)
    latest = {entry.name: entry for entry in archive.catalog("Dataset") if entry.name in strange}
    for name in sorted(strange):
        recording = latest[name].spec.get("recording") or {} if name in latest else {}
        if recording.get("synthetic") is None:
            remark(f"dataset {name}: it lies beside its manifest; give that file to slamhive run, too")
            continue
        yield manifest("Dataset", name, latest[name].labels, without_nothing(latest[name].spec))


@contextmanager
def told(name: str) -> Iterator[tuple[SweepRecord, SearchStory, Archive, Frame]]:
    """Read a search by the name of its sweep.

    Raises:
        InputError: none is called so, several are, or it can't be read.
    """
    from slamhive.archive import Archive
    from slamhive.local.home.sweeping import sweeps_meant
    from slamhive.tables.reading import read_table
    from slamhive.tables.searches import catalog_of, story_of

    home = Home.from_environment()
    require_archive(home, "")
    with Archive.open(home.archive_url, read_only=True) as archive:
        versions = sweeps_meant(archive.sweeps(), name)
        places = {(one.namespace, one.cluster) for one in versions}
        if len(places) > 1:
            found = ", ".join(sorted(f"{one.namespace or ''}/{one.name}" for one in versions))
            raise InputError(f"NAME: several sweeps are called {name!r}: say which ({found})")
        record = max(versions, key=lambda one: (one.created is not None and one.created.timestamp(), one.uid))
        catalog = catalog_of([*archive.catalog("Algorithm"), *archive.catalog("Dataset")])
        frame = read_table(home.archive_url, home.path / "cache").frame
        yield record, story_of(record, frame, catalog), archive, frame


def _chosen(record: SweepRecord, story: SearchStory, number: int | None) -> TriedSetting:
    """Return the setting that is meant.

    Raises:
        InputError: it isn't clear which one, or there is none.
    """
    if story.search.method is SearchMethod.THRESHOLD:
        raise InputError(
            f"sweep {record.name}: seeks a threshold, so no setting of it is the best: {_card(record)}"
        )
    if number is not None:
        if not 0 <= number < len(story.trials):
            least = f"0 to {len(story.trials) - 1}" if story.trials else "none yet"
            raise InputError(f"--number: {number} is no setting of {record.name}, these are: {least}")
        if not story.trials[number].runs:
            raise InputError(f"--number: no run of setting {number} has ended yet")
        return story.trials[number]
    if not story.best:
        raise InputError(f"sweep {record.name}: no setting has all its runs yet: {story.message}")
    if len(story.best) > 1:
        listed = "\n".join(f"  --number {one}: {_figures(story, story.trials[one])}" for one in story.best)
        raise InputError(
            f"sweep {record.name}: of {len(story.best)} settings none is better than another in everything, "
            f"choose one:\n{listed}"
        )
    return story.trials[story.best[0]]


def _label(axis: dict[str, Any]) -> str:
    return str(axis.get("name") or axis.get("path") or "")


def _table(story: SearchStory) -> tuple[list[str], list[list[str]]]:
    from slamhive.analysis.metrics import Metric, label_of
    from slamhive.tables.text import key_text

    labels = [label for label, _ in story.axes]
    metrics = [Metric.parse(one.metric) for one in story.search.objectives]
    headings = ["setting", *(label_of(one, among=labels) for one in labels), "runs"]
    headings += [*(metric.title for metric in metrics), "failed", "stands", "told", "why"]
    lines = []
    for one in story.trials:
        values = [
            _short(value) if isinstance(value, float) else key_text(value) for value in one.values.values()
        ]
        figures = [metric.show(value) for metric, value in zip(metrics, one.figures, strict=True)]
        if not one.is_complete:  # of fewer runs, so beside the others it says little
            figures = [text if text == "–" else f"({text})" for text in figures]
        failed = "–" if one.failed is None else f"{round(one.failed * one.judged)} of {one.judged}"
        stands = f"{one.state}, known" if one.origin == "Known" else one.state
        lines.append(
            [
                str(one.number),
                *values,
                str(one.runs),
                *figures,
                failed,
                stands,
                str(one.told),
                one.dropped or "",
            ]
        )
    return headings, lines


def _short(value: float) -> str:
    return format(value, ".4g")


def _figures(story: SearchStory, trial: TriedSetting) -> str:
    from slamhive.analysis.metrics import Metric

    metrics = [Metric.parse(one.metric) for one in story.search.objectives]
    shown = [
        f"{metric.title} {metric.show(value)}" for metric, value in zip(metrics, trial.figures, strict=True)
    ]
    values = ", ".join(
        f"{label.rpartition('.')[2]} {_short(value) if isinstance(value, float) else value}"
        for label, value in trial.values.items()
    )
    return f"{', '.join(shown)} with {values}"


def _words(story: SearchStory, trial: TriedSetting) -> str:
    if trial.is_complete:
        made = story.averaged
    else:
        made = f"{plural(trial.judged, 'run')} of {story.block} alone; why it has no more: {trial.dropped}"
    failed = (
        f"; {round((trial.failed or 0) * trial.judged)} of {trial.judged} runs failed" if trial.failed else ""
    )
    return f"setting {trial.number}: {_figures(story, trial)} ({made}){failed}"


def _card(record: SweepRecord) -> str:
    """Return the command that says what a search for thresholds found."""
    namespace = f"{record.namespace}/" if record.namespace else ""
    return f"slamhive results robustness --sweep {namespace}{record.name}"


def _sentences(record: SweepRecord, story: SearchStory) -> list[str]:
    goals = " and ".join(
        f"{one.metric} {'large' if one.goal is Goal.MAXIMIZE else 'small'}" for one in story.search.objectives
    )
    told = [f"{record.name}: {story.search.method}{f' to make {goals}' if goals else ''}. {story.message}"]
    told += [f"best: {_words(story, story.trials[number])}" for number in story.best]
    if story.search.method is SearchMethod.THRESHOLD:
        told.append(f"where it breaks: {_card(record)}")
    spared = (
        f", {plural(story.ended - story.computed, 'run')} took an equal result"
        if story.ended > story.computed
        else ""
    )
    told.append(f"{plural(story.computed, 'run')} computed{spared}")
    if story.influences:
        shares = ", ".join(
            f"{one.label.rpartition('.')[2]} {' / '.join(f'{100 * share:.0f} %' for share in one.shares)}"
            for one in story.influences
        )
        told.append(
            f"what matters: {shares} (share of the order of {story.compared} settings after their first runs)"
        )
    elif story.search.objectives:
        from slamhive.tables.searches import LEAST_TRIALS

        told.append(
            f"what matters: not told of {plural(story.compared, 'setting')} with figures, at least "
            f"{LEAST_TRIALS} are needed"
        )
    if not story.is_over:
        left = (
            ""
            if story.seconds_left is None
            else f", about {time_text(story.seconds_left)} at the pace so far"
        )
        told.append(f"to come: about {plural(story.expected, 'run')}, at most {story.to_come:,}{left}")
    return told
