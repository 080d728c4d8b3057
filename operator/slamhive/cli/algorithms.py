# SPDX-License-Identifier: Apache-2.0
"""``slamhive algorithm``: what is known, and whether what it declares is true."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from slamhive.cli.checking import check
from slamhive.cli.parts.console import command_name, listing, open_workbench, out, remark
from slamhive.cli.parts.listing import show_catalog
from slamhive.cli.unlisting import remove_algorithm
from slamhive.cli.vocabulary import train
from slamhive.local.home.catalog import link_algorithm, load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.programs.executors import unavailable
from slamhive.local.programs.starting import ExampleKind, start_algorithm
from slamhive.model.algorithm import ParameterType
from slamhive.model.errors import InputError
from slamhive.model.loading import parse
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.model.algorithm import Algorithm, AlgorithmSpec, Parameter
    from slamhive.model.base import Scalar

app = typer.Typer(no_args_is_help=True, help="Algorithms: list, add and check them.")

Name = Annotated[str, typer.Argument(metavar="NAME", help="Name in the catalog.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@app.command("list")
def list_algorithms(*, as_json: AsJson = False) -> None:
    """List the algorithms that are known here.

    Example: slamhive algorithm list
    """
    workshop = load_workshop(Home.from_environment())
    rows = [(entry.algorithm, unavailable(entry)) for _, entry in sorted(workshop.algorithm_entries.items())]
    if as_json:
        typer.echo(json.dumps([_summary(algorithm, problem) for algorithm, problem in rows], indent=2))
        return
    lines = [
        (
            algorithm.name,
            listing([mode.name for mode in algorithm.spec.modes]),
            algorithm.spec.version or "",
            algorithm.spec.license or "",
            "yes" if problem is None else "no",
            algorithm.spec.description,
        )
        for algorithm, problem in rows
    ]
    headings = ("algorithm", "sensors", "version", "licence", "here", "what it is")
    complete = show_catalog(headings, lines, prose=(5,))
    for algorithm, problem in rows:
        if problem is not None:
            out.print(f"[yellow]{escape(algorithm.name)}: unavailable here: {escape(problem)}[/]")
    if not complete:
        remark("more of each: slamhive algorithm show NAME")


@app.command("add")
def add_algorithm(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder with algorithm.yaml, adapter and requirements.")
    ],
) -> None:
    """Make an algorithm known by name: its folder is linked into the home, and stays yours to edit.

    Example: slamhive algorithm add my-slam
    """
    home = Home.from_environment()
    name = link_algorithm(folder, home)
    out.print(f"known now as {escape(name)}: {folder.absolute()}", soft_wrap=True)
    remark(f"try it: {command_name()} algorithm check {name}")


@app.command("show")
def show_algorithm(name: Name, *, as_json: AsJson = False) -> None:
    """Show an algorithm: its sensors, its parameters, what its poses mean.

    Example: slamhive algorithm show kiss-icp
    """
    entry = load_workshop(Home.from_environment()).algorithm(name)
    algorithm = entry.algorithm
    if as_json:
        typer.echo(json.dumps(algorithm.as_json(), indent=2))
        return
    spec = algorithm.spec
    out.print(f"[bold]{escape(name)}[/] {escape(spec.version or '')}: {escape(spec.description)}")
    out.print(f"{spec.homepage or ''}  {spec.license or ''}", style="dim")
    for mode in spec.modes:
        output = spec.output_of(mode)
        scale = "metric" if output.scale else "without scale"
        out.print(
            f"{mode.name}: takes {', '.join(mode.needs)}; "
            f"writes {output.poses.lower()} of the {output.frame}, stamped {output.stamp}, {scale}"
        )
        for what, file in (("trajectory", output.trajectory), ("keyframes", output.keyframes)):
            if file is not None:
                told = f"{file.format}, stamps in {file.told.stamps}{', inverted' if file.inverted else ''}"
                out.print(f"  {what}: output/{escape(file.path)} ({told})")
    out.print(
        f"paces: {', '.join(spec.paces)}; deterministic: {spec.deterministic}; seed: {spec.seed.lower()}"
    )
    for line in _surroundings(spec):
        out.print(escape(line))
    table = Table("parameter", "default", "allowed", "what it does")
    for key, parameter in sorted(spec.parameters.items()):
        table.add_row(key, json.dumps(parameter.default), _allowed(parameter), escape(parameter.description))
    out.print(table)
    problem = unavailable(entry)
    if problem:
        out.print(f"[yellow]unavailable here: {escape(problem)}[/]")


@app.command("new")
def new_algorithm(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the algorithm and of its folder.")],
    *,
    kind: Annotated[
        ExampleKind, typer.Option("--from", help="A Python program, a ROS 1 node, or a program in C.")
    ] = ExampleKind.LIDAR_PYTHON,
) -> None:
    """Make a folder to start an algorithm from, which runs as it is, and make it known by its name.

    Example: slamhive algorithm new my-slam --from lidar-python
    """
    home = Home.from_environment()
    folder, left = start_algorithm(name, kind, home, load_workshop(home), Path.cwd())
    out.print(f"made {folder}, known now as {name}", soft_wrap=True, markup=False)
    command = command_name()
    steps = [left, f"{command} algorithm check {name}", f"edit {name}/, beginning with README.md"]
    for number, step in enumerate(filter(None, steps)):
        out.print(f"{'Next:' if number == 0 else '     '}  {step}", soft_wrap=True, markup=False)


app.command("remove")(remove_algorithm)
app.command("check")(check)


@app.command("render")
def render_files(
    name: Name,
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="Dataset by name.")],
    *,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            "-p", "--parameter", metavar="NAME=VALUE", help="Value of a parameter; may be repeated."
        ),
    ] = None,
    mode: Annotated[
        SensorMode | None, typer.Option("--mode", help="Sensor mode; default: the only one.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Write the files below this folder.")
    ] = None,
) -> None:
    """Print the settings files that a run of an algorithm on a dataset would read.

    Example: slamhive algorithm render my-vins mh01 -p maxFeatures=200
    """
    from slamhive.local.running.configuring import rendered_for
    from slamhive.model.errors import sentence
    from slamhive.templating import place_files

    bench = open_workbench(Home.from_environment())
    with bench.archive:
        given = _given(parameter or [], bench.workshop.algorithm(name).algorithm)
        files = rendered_for(bench, name, dataset, given, mode)
    if output is not None:
        try:
            place_files(files, output, read_only=False)
        except OSError as error:
            raise InputError(f"--output: {sentence(error)}") from None
        for file in files:
            out.print(escape(str(output / file.path)), soft_wrap=True)
        return
    for file in files:
        if len(files) > 1:
            typer.echo(f"==> {file.path} <==")
        typer.echo(file.text, nl=not file.text.endswith("\n"))


def _given(parameters: list[str], algorithm: Algorithm) -> dict[str, Scalar]:
    """Return values of parameters as they were written; a text is what its parameter is declared to take."""
    found: dict[str, Scalar] = {}
    for item in parameters:
        name, equals, text = item.partition("=")
        if not equals:
            raise InputError(f"-p {item}: expected NAME=VALUE")
        if name in found:
            raise InputError(f"-p {item}: {name!r} was given before")
        declared = algorithm.spec.parameters.get(name)
        if declared is not None and declared.type is ParameterType.STRING:
            found[name] = text
            continue
        documents = parse(text, f"-p {name}")
        value = documents[0].value if documents else None
        if isinstance(value, dict | list):
            raise InputError(f"-p {item}: expected a single value")
        found[name] = value
    return found


app.command("train-vocabulary")(train)


def _surroundings(spec: AlgorithmSpec) -> Iterator[str]:
    """Yield the surroundings of an algorithm: topics of its poses, image, settings files."""
    node = spec.node
    if node is not None:
        for what, source in (("poses", node.poses), ("keyframes", node.keyframes)):
            if source is not None:
                yield f"as a ROS {node.ros} node: {what} on {source.topic} ({source.type})"
    if spec.image is not None:
        yield f"image: {spec.image}"
    if spec.files:
        yield f"settings files: {', '.join(file.path for file in spec.files)}"


def _summary(algorithm: Algorithm, problem: str | None) -> dict[str, Any]:
    return {
        "name": algorithm.name,
        "sensors": [mode.name for mode in algorithm.spec.modes],
        "version": algorithm.spec.version,
        "license": algorithm.spec.license,
        "available": problem is None,
        "unavailable": problem,
        "labels": algorithm.metadata.labels,
    }


def _allowed(parameter: Parameter) -> str:
    if parameter.values is not None:
        return ", ".join(json.dumps(value) for value in parameter.values)
    low = "" if parameter.minimum is None else f"{parameter.minimum:g}"
    high = "" if parameter.maximum is None else f"{parameter.maximum:g}"
    bounds = f" {low} … {high}" if low or high else ""
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.type.lower()}{bounds}{unit}{' or null' if parameter.nullable else ''}"
