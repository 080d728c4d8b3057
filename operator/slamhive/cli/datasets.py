# SPDX-License-Identifier: Apache-2.0
"""``slamhive dataset``: what is known, adding more, and looking into it."""

from __future__ import annotations

import json
import os
import signal
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from pydantic import ValidationError
from rich.markup import escape
from rich.table import Table

from slamhive.cli import catalogue
from slamhive.cli.parts.console import bytes_text, complain, listing, open_workbench, out, remark
from slamhive.cli.parts.exits import FAILED, INTERRUPTED
from slamhive.cli.parts.listing import show_catalog
from slamhive.cli.parts.showing import show
from slamhive.cli.parts.waiting import Work
from slamhive.cli.unlisting import remove_dataset, rename
from slamhive.local.home.catalog import editor_line, load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.base import explain, plain_name, plural, require_name
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.formats import DataFormat, holds, misfit
from slamhive.model.run import InputOptions, LidarInput
from slamhive.model.sensors import ROLES, SensorMode

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.inspecting.inspection import DatasetReport, SensorReport
    from slamhive.local.home.catalog import DatasetPlace
    from slamhive.model.dataset import DatasetSpec

app = typer.Typer(no_args_is_help=True, help="Datasets: list, add, check, prepare and export them.")

_MANIFESTS = {".yaml", ".yml"}
_FILES = {".bag", ".mcap", ".db3", *_MANIFESTS}


def _no_file(name: str) -> str:
    """Return the name; a path is none, and what to do with one is said."""
    if ("/" in name or Path(name).suffix in _FILES) and Path(name).exists():
        raise InputError(f"NAME: {name} is a path; make it a dataset first: slamhive dataset add {name}")
    return name


Name = Annotated[str, typer.Argument(metavar="NAME", help="Name in the catalog.", callback=_no_file)]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]

FrameRate = Annotated[float | None, typer.Option("--frame-rate", min=0.001, help="Hz.")]
Resolution = Annotated[float | None, typer.Option("--resolution", min=0.01, max=1, help="Scale of images.")]
Start = Annotated[str | None, typer.Option("--start", help="Time to leave out, such as 10s.")]
Length = Annotated[str | None, typer.Option("--duration", help="Length to keep, such as 1m.")]
MaxRange = Annotated[float | None, typer.Option("--max-range", min=0.01, help="LiDAR range in m.")]
Rings = Annotated[int | None, typer.Option("--rings", min=1, help="LiDAR rings to keep.")]

_TRUTH_NOUNS = {
    "trajectory": "pose",
    "positions": "position",
    "points": "control point",
    "relations": "relation",
}


@app.command("list")
def list_datasets(
    *,
    available: Annotated[
        bool, typer.Option("--available", help="List the sequences of the catalogue instead.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the datasets that are known here.

    Example: slamhive dataset list
    """
    datasets = load_workshop(Home.from_environment()).datasets
    if available:
        catalogue.show_available(list(datasets.values()), as_json=as_json)
        return
    if as_json:
        rows = [
            {"name": name, "source": _source(one.spec), "attributes": one.spec.attributes}
            for name, one in sorted(datasets.items())
        ]
        typer.echo(json.dumps(rows, indent=2))
        return
    lines = [(name, *_catalog_cells(dataset.spec)) for name, dataset in sorted(datasets.items())]
    headings = ("dataset", "source", "sensors", "ground truth", "attributes", "what it is")
    if not show_catalog(headings, lines, prose=(5, 4)):
        remark("more of each: slamhive dataset show NAME")


app.command("show")(show)


@app.command("add")
def add(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...",
            help="A manifest, a bag or the pieces of one, a folder as EuRoC, TUM and others publish it, a "
            "CARMEN log, or FAMILY/SEQUENCE of the catalogue.",
        ),
    ],
    *,
    name: Annotated[str | None, typer.Option("--name", help="Name of the dataset.")] = None,
    sequence: Annotated[
        str | None,
        typer.Option("--sequence", help="Which sequence, drive or LiDAR of a folder that holds several."),
    ] = None,
    relations: Annotated[
        Path | None, typer.Option("--relations", help="Ground truth of a CARMEN log: a .relations file.")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace a dataset of that name.")] = False,
    keep_archive: Annotated[
        bool, typer.Option("--keep-archive", help="Keep the downloaded archive of a sequence.")
    ] = False,
) -> None:
    """Make a dataset known: from its manifest, or from what is found in a recording.

    A bag gets a manifest in this folder, to be completed and added then. Folders and CARMEN logs
    are converted into the home and are known at once. A sequence of the catalogue is fetched first; if that
    is interrupted, the same command goes on.

    Example: slamhive dataset add my.bag --name hall
    """
    home, source = Home.from_environment(), sources[0]
    if len(sources) > 1:
        _require_pieces(sources)
        _suggest(sources, _named(source, name))
        return
    if not source.exists() and catalogue.is_title(str(source)):
        try:
            _add_sequence(str(source), name, home, replace=replace, keep_archive=keep_archive)
        except KeyboardInterrupt:
            remark("interrupted; what was fetched stays, and the same command goes on from here")
            raise typer.Exit(INTERRUPTED) from None
        return
    if not source.exists():
        raise InputError(f"{source}: no such file or folder")
    if source.suffix in _MANIFESTS and source.is_file():
        _add_manifest(source, home, replace=replace)
        return
    from slamhive.data.importers import ImportOptions, import_recording, layout_of

    chosen = _named(source, name)
    layout = layout_of(source)
    if layout is None:
        _suggest([source], chosen)
        return
    folder = home.folder("datasets") / chosen
    with _place(home, chosen, replace=replace), Work(f"importing {chosen}") as work:
        options = ImportOptions(sequence=sequence, relations=relations)
        _, notes = import_recording(source, folder, chosen, layout, options=options, progress=work.share)
    for sentence in notes:
        remark(f"- {sentence}")
    _look_at(home, chosen)
    _added(folder / "dataset.yaml")


app.command("search")(catalogue.search)
app.command("remove")(remove_dataset)
app.command("rename")(rename)


@app.command("make")
def make(name: Name) -> None:
    """Generate a synthetic dataset's recording, and say where it is.

    Example: slamhive dataset make synthetic-lidar
    """
    from slamhive.data.store.datasets import materialise

    home = Home.from_environment()
    place = load_workshop(home).dataset(name)
    if place.dataset.spec.recording.synthetic is None:
        raise InputError(f"dataset {name}: it is not synthetic, there is nothing to generate")
    with Work(f"generating {name}") as work:
        entry = materialise(place.dataset, place.folder, home.folder("datasets"), work.share)
    out.print(str(entry.root), soft_wrap=True)


@app.command("prepare")
def prepare_variant(
    name: Name,
    *,
    sensors: Annotated[SensorMode, typer.Option("--sensors", help="Sensor mode to prepare for.")],
    frame_rate: FrameRate = None,
    resolution: Resolution = None,
    start: Start = None,
    duration: Length = None,
    max_range: MaxRange = None,
    rings: Rings = None,
    by: Annotated[
        str | None, typer.Option("--by", metavar="PROGRAM", help="Program of the dataset's preparations.")
    ] = None,
    form: Annotated[DataFormat | None, typer.Option("--format", help="Format; default: as recorded.")] = None,
) -> None:
    """Make the variant of a dataset that a run would get, and say where it is.

    Example: slamhive dataset prepare synthetic-camera --sensors stereo --resolution 0.5 --frame-rate 7.5
    """
    from slamhive.data.making.preparation import prepare
    from slamhive.data.making.programmed import prepare_by_program

    options = _input(frame_rate, resolution, start, duration, max_range, rings)
    with Work(f"preparing {name}") as work:
        bench = open_workbench(Home.from_environment())
        work.follow(bench.making)
        with bench.archive:
            entry = bench.dataset(name)
            forms = [form or DataFormat(entry.dataset.spec.recording.format)]
            wanted = (entry, ROLES[sensors], options, forms, bench.home.folder("variants"))
            preparer = bench.preparer({"datasetRef": {"name": name}, "input": {"preparedBy": by}})
            if preparer is None:
                variant = prepare(*wanted, work.share)
            else:
                variant = prepare_by_program(*wanted, preparer, work.share)
    _remark_frames(variant.frames, variant.frame_rate, variant.duration_seconds, variant.resolution)
    out.print(str(variant.path), soft_wrap=True)


@app.command("export")
def export(
    name: Name,
    *,
    form: Annotated[DataFormat, typer.Option("--format", help="Form: a bag, or a folder of files.")],
    folder: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to make.")],
    sensors: Annotated[
        SensorMode | None, typer.Option("--sensors", help="Sensor mode; default: all that the form holds.")
    ] = None,
    frame_rate: FrameRate = None,
    resolution: Resolution = None,
    start: Start = None,
    duration: Length = None,
    max_range: MaxRange = None,
    rings: Rings = None,
    ground_truth: Annotated[
        bool, typer.Option("--ground-truth", help="Write groundtruth.txt beside it, in TUM format.")
    ] = False,
) -> None:
    """Write a dataset in the form that a program takes: what a run would be given.

    Example: slamhive dataset export synthetic-camera --format Euroc -o hall --ground-truth
    """
    from slamhive.data.making.exporting import all_roles, export_dataset, require_new

    options = _input(frame_rate, resolution, start, duration, max_range, rings)
    if sensors is not None and not holds(form, ROLES[sensors]):
        raise InputError(f"--sensors: {misfit([form], ROLES[sensors], f'the mode {sensors}')}")
    require_new(folder)
    # Ended like this it would leave the half of a folder behind.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Work(f"exporting {name}") as work:
        bench = open_workbench(Home.from_environment())
        work.follow(bench.making)
        with bench.archive:
            entry = bench.dataset(name)
            truth = bench.truth(name) if ground_truth else None
            if ground_truth and truth is None:
                raise InputError(f"--ground-truth: dataset {name} has none; leave it out")
            made = export_dataset(
                entry,
                ROLES[sensors] if sensors else all_roles(entry, form),
                options,
                form,
                folder,
                truth=truth,
                cache=bench.home.folder("truths"),
                progress=work.share,
            )
    chosen = made.selection
    seconds = (chosen.last - chosen.first) / 1e9
    remark(f"{form} with {listing([str(role) for role in made.views])}")
    _remark_frames(chosen.frames(chosen.primary), chosen.rate(chosen.primary), seconds, options.resolution)
    out.print(str(folder), soft_wrap=True)


@app.command("check")
def check(
    name: Name,
    *,
    repair: Annotated[
        Path | None,
        typer.Option("--repair", metavar="NEW.yaml", help="Manifest to write: repaired of what was found."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Look into a sample of the messages: seconds, whatever its size.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Read a dataset through: topics, rates, gaps, calibration, overlap with its ground truth.

    With --repair, a manifest of it is written that has the repair of each finding, and says why; the
    recording stays as it is.

    Example: slamhive dataset check synthetic-lidar
    """
    from slamhive.data.inspecting.inspection import inspect
    from slamhive.data.inspecting.known import FINDINGS, keep
    from slamhive.data.inspecting.quick import glance

    if repair is not None:
        _require_new_file(repair)
    with Work(f"checking {name}") as work:
        bench = open_workbench(Home.from_environment())
        work.follow(bench.making)
        with bench.archive:
            entry = bench.dataset(name)
            report = glance(entry) if quick else inspect(entry, bench.home.folder("truths"), work.part)
            keep(entry, report.findings, bench.home.path / FINDINGS, is_sample=quick)
    if as_json:
        typer.echo(json.dumps(report.as_json(), indent=2))
    else:
        _print_report(report)
    if repair is not None:
        _write_repaired(bench.workshop.dataset(name), report, repair)
    if not report.is_usable:
        raise typer.Exit(FAILED)


def _require_new_file(target: Path) -> None:
    if target.suffix not in _MANIFESTS:
        raise InputError(f"--repair: {target}: a manifest ends in .yaml")
    if os.path.lexists(target):
        raise InputError(f"--repair: {target} exists already; choose another name or remove it")
    if not target.parent.is_dir():
        raise InputError(f"--repair: {target.parent}: no such folder")


def _write_repaired(place: DatasetPlace, report: DatasetReport, target: Path) -> None:
    """Write the manifest of a dataset with the repairs of what was found, beside links to its files."""
    from slamhive.data.inspecting.remedies import repaired_manifest
    from slamhive.data.store.datasets import files_of

    made = repaired_manifest(place.dataset, report.findings)
    for sentence in made.notes:
        remark(sentence)
    if not made.repaired:
        remark(f"{target} wasn't written: no finding has a repair")
        return
    if not place.dataset.spec.is_to_fetch:
        for path in files_of(place.dataset):
            if (place.folder / path).exists():
                (target.parent / path).parent.mkdir(parents=True, exist_ok=True)
                _link(target.parent / path, (place.folder / path).resolve())
    target.write_text(editor_line("Dataset") + made.text, encoding="utf-8")
    remark(f"wrote {target}: {made.name}, with {plural(len(made.repaired), 'repair')}")
    remark(f"then: slamhive dataset add {target}")
    if made.name != place.dataset.name:
        remark(f"it stands beside {place.dataset.name}; of that name, and with --replace, it takes its place")


def _catalog_cells(spec: DatasetSpec) -> tuple[str, ...]:
    generated, truth = spec.recording.synthetic, spec.ground_truth
    sensors = [str(one).lower() for one in generated.sensors] if generated else sorted(spec.sensors)
    kept_as = "none"
    if truth is not None:
        kept_as = truth.topic or str(truth.format)
    return (
        _source(spec),
        listing(sensors),
        "exact" if generated else kept_as,
        ", ".join(f"{key}: {value}" for key, value in spec.attributes.items()),
        spec.description,
    )


def _source(spec: DatasetSpec) -> str:
    if spec.recording.synthetic is not None:
        return "generated"
    if spec.is_to_fetch:
        return "catalogue"
    return str(spec.recording.format)


def _named(source: Path, name: str | None) -> str:
    """Return the name of a dataset: the one that is given, or one made of its file's.

    Raises:
        InputError: It is none of an object.
    """
    chosen = name or plain_name(source.resolve().name.split(".")[0])
    require_name(chosen, "name")
    return chosen


def _add_manifest(source: Path, home: Home, *, replace: bool) -> None:
    from slamhive.data.inspecting.known import FINDINGS, keep
    from slamhive.data.inspecting.quick import require_usable
    from slamhive.data.store.datasets import HASHES, DatasetEntry, add_dataset
    from slamhive.model.loading import load_file

    datasets = [item for item in load_file(source) if isinstance(item, Dataset)]
    if not datasets:
        raise InputError(f"{source}: no Dataset in it")
    names = [dataset.name for dataset in datasets]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{source}: {names.count(twice)} Datasets of the name {twice!r}; each needs its own")
    root, known = source.parent.absolute(), home.folder("datasets")
    for dataset in datasets:
        findings, warnings = require_usable(dataset, root, known / HASHES)
        if findings:
            keep(DatasetEntry(dataset, root), findings, home.path / FINDINGS, is_sample=True)
        _print_findings(findings, warnings, where=f"dataset {dataset.name!r}: ")
    for dataset in datasets:
        with _place(home, dataset.name, replace=replace):
            manifest = add_dataset(dataset, root, known)
        _added(manifest)


@contextmanager
def _place(home: Home, name: str, *, replace: bool) -> Iterator[None]:
    """Make room for a dataset: the one of its name goes, if it may be replaced, once the new one is there."""
    if not replace:
        yield
        return
    from slamhive.cli.unlisting import referring
    from slamhive.local.housekeeping.forgetting import alone
    from slamhive.local.housekeeping.unlisting import replaced

    count = referring(home, "dataset", name)
    if count:
        remark(
            f"{plural(count, 'run')} of the former {name} stay as they are; what differs in the new one "
            "makes them superseded, and the next slamhive run does them again"
        )
    with alone(home, "slamhive dataset add --replace"), replaced(home, name):
        yield


def _add_sequence(title: str, name: str | None, home: Home, *, replace: bool, keep_archive: bool) -> None:
    from slamhive.model.catalogue import dataset_name, find_sequence

    try:
        find_sequence(title)
    except UnknownNameError as error:
        raise InputError(f"{title}: no such file or folder, and {error}") from None
    chosen = _named(Path(title), name or dataset_name(*title.split("/")))
    folder = home.path / "datasets" / chosen
    if not replace and folder.exists():
        known = load_workshop(home).datasets.get(chosen)
        if known is None or known.spec.catalogue != title:
            raise InputError(
                f"dataset {chosen!r} is known already and is another one; give this one a --name"
            )
    with _place(home, chosen, replace=replace):
        manifest, _ = catalogue.add_sequence(title, chosen, home, keep_archive=keep_archive)
    _look_at(home, chosen)
    _added(manifest)


def _look_at(home: Home, name: str) -> None:
    """Say what a sample of a dataset's messages tells of it."""
    from slamhive.data.inspecting.known import FINDINGS, keep
    from slamhive.data.inspecting.quick import glance
    from slamhive.local.running.impossible import at_hand

    entry = at_hand(load_workshop(home).dataset(name), home)
    if entry is not None:
        report = glance(entry)
        keep(entry, report.findings, home.path / FINDINGS, is_sample=True)
        _print_findings(report.findings, report.warnings, report.errors)


def _added(manifest: Path) -> None:
    out.print(f"known now as {manifest.parent.name}: {manifest}", soft_wrap=True)
    remark(f"look into it: slamhive dataset check {manifest.parent.name}")


def _require_pieces(sources: Sequence[Path]) -> None:
    for source in sources:
        if source.suffix in _MANIFESTS and source.is_file():
            what = "a manifest"
        elif not source.exists() and catalogue.is_title(str(source)) and source.suffix not in _FILES:
            what = "a sequence of the catalogue"
        else:
            continue
        raise InputError(
            f"{source}: {what} is added by itself, one at a time; only the pieces of a bag are added together"
        )


def _suggest(sources: Sequence[Path], name: str) -> None:
    from slamhive.data.inspecting.suggestion import suggest_dataset

    target = Path(f"{name}.yaml")
    if target.exists():
        raise InputError(f"{target} exists already; complete it and add it: slamhive dataset add {target}")
    suggestion = suggest_dataset(sources, name)
    for link, recording in suggestion.elsewhere.items():
        _link(Path(link), recording)
    target.write_text(editor_line("Dataset") + suggestion.text, encoding="utf-8")
    out.print(f"wrote {target}", soft_wrap=True)
    for sentence in suggestion.missing:
        remark(f"- {sentence}")
    remark(f"then: slamhive dataset add {target}")


def _link(link: Path, recording: Path) -> None:
    """Put a link to a recording into this folder: the paths of a manifest start from its own."""
    if link.exists() and link.samefile(recording):
        return
    try:
        link.symlink_to(recording)
    except OSError as error:
        raise InputError(
            f"{link}: cannot be linked to {recording}: {error.strerror}; a manifest's paths start from its "
            "folder"
        ) from None
    remark(f"linked {link} to {recording}")


def _remark_frames(frames: int, rate: float | None, seconds: float, resolution: float) -> None:
    told = f"{rate:.4g} Hz" if rate else "one frame"
    remark(f"{plural(frames, 'frame')}, {told}, {seconds:.1f} s, scale {resolution:g}")


def _input(  # noqa: PLR0917 - one for each option
    frame_rate: float | None,
    resolution: float | None,
    start: str | None,
    duration: str | None,
    max_range: float | None,
    rings: int | None,
) -> InputOptions:
    """Return input options from those of the command line, absent ones left to their defaults."""
    given = {
        "frameRate": frame_rate,
        "resolution": resolution,
        "start": start,
        "duration": duration,
        "lidar": LidarInput(max_range=max_range, rings=rings),
    }
    try:
        return InputOptions.model_validate({key: value for key, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"--{first['loc'][0]}: {explain(first)}, found {first['input']!r}") from None


def _print_report(report: DatasetReport) -> None:
    from slamhive.data.doctor.stamps import GAP_PERIODS

    duration = f"{report.duration_seconds:.1f} s" if report.duration_seconds is not None else "unknown length"
    out.print(f"[bold]{escape(report.name)}[/] {report.format}, {duration}")
    table = Table()
    for heading in ("sensor", "topic", "messages", "rate", "covers", "gaps"):
        table.add_column(heading, overflow="fold", no_wrap=heading != "topic")
    for sensor in report.sensors:
        cells = [*_sensor_cells(sensor)]
        table.add_row(*(cells if report.sampled is None else [*cells[:4], "–", "–"]))
    if report.sensors:
        out.print(table)
        for sensor in report.sensors:
            size = [bytes_text(sensor.size_bytes)] if report.sampled is None else []
            if told := ", ".join(filter(None, [*size, sensor.content])):
                out.print(escape(f"{sensor.name}: {told}"))
        if report.sampled is None:
            remark(f"a gap: more than {GAP_PERIODS:g} periods of a sensor's mean rate without a message")
        else:
            there = sum({sensor.topic: sensor.messages for sensor in report.sensors}.values())
            remark(
                f"a sample of {report.sampled:,} of {there:,} messages: gaps, ends and the ground truth take "
                "all of them, without --quick"
            )
    truth = report.ground_truth
    if truth is not None:
        noun = _TRUTH_NOUNS[truth.kind]
        path = f", path {truth.path_metres:.1f} m" if truth.path_metres is not None else ""
        gap = f", longest gap {truth.longest_gap:.2f} s" if truth.longest_gap is not None else ""
        overlap = f", {truth.overlap_seconds:.1f} s overlap" if report.sensors else ""
        out.print(f"ground truth: {plural(truth.count, noun)}{overlap}{path}{gap}")
    if report.other_topics:
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in report.other_types.items())
        out.print(
            f"other topics, for algorithms that ask for them (modes[].topics): {escape(listed)}", style="dim"
        )
    _print_findings(report.findings, report.warnings, report.errors)


def _print_findings(
    findings: Sequence[Finding], warnings: Iterable[str] = (), errors: Iterable[str] = (), *, where: str = ""
) -> None:
    """Print what is noted, then what may be wrong, then what is, each with its code and its repair.

    Args:
        findings: What has a code.
        warnings: What else may be wrong; sentences of findings among them are printed once.
        errors: What else is wrong, likewise.
        where: What all of it is about, in front of each.
    """

    def text(finding: Finding) -> str:
        repair = f"\n  put into the spec: {finding.repair_line}" if finding.repair else ""
        return f"{where}{finding.message} ({finding.code}){repair}"

    from slamhive.model.variant import Severity

    told = {finding.message for finding in findings}
    said = {weight: [text(one) for one in findings if one.severity == weight] for weight in Severity}
    for note in said[Severity.NOTE]:
        out.print(f"note: {escape(note)}", style="dim")
    for warning in [*(where + one for one in warnings if one not in told), *said[Severity.WARNING]]:
        out.print(f"[yellow]warning:[/] {escape(warning)}")
    for error in [*(where + one for one in errors if one not in told), *said[Severity.ERROR]]:
        complain(error)


def _sensor_cells(sensor: SensorReport) -> Iterator[str]:
    longest = f"{sensor.gap_count}, longest {sensor.gaps[0].seconds:.2f} s" if sensor.gaps else "none"
    yield escape(sensor.name)
    yield escape(sensor.topic)
    yield str(sensor.messages)
    yield f"{sensor.rate:.4g} Hz" if sensor.rate else "–"
    yield f"{sensor.covered:.0%}"
    yield longest
