# SPDX-License-Identifier: Apache-2.0
"""``slamhive new``: manifests by questions; each is an option too, and without a terminal none is asked."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from slamhive.cli.parts.checked import check_files
from slamhive.cli.parts.console import command_name, out, remark
from slamhive.local.home.catalog import editor_line, load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.programs.starting import ExampleKind
from slamhive.model.base import API_VERSION, plain_name, plural, seconds
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.loading import parse
from slamhive.model.synthetic import SyntheticSensor
from slamhive.plan.resolution import role_problems

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.local.home.catalog import Workshop
    from slamhive.model.algorithm import Algorithm

app = typer.Typer(
    no_args_is_help=True, help="Write a new sweep, dataset or algorithm by answering questions."
)

Output = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FILE", help="File to write; default: NAME.yaml.")
]
_TRAINING = ("slamhive.io/use", "training")


@app.command("sweep")
def new_sweep(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Name of the sweep.")] = None,
    *,
    algorithm: Annotated[
        str | None, typer.Option("--algorithm", "-a", metavar="NAME,…", help="Algorithms.")
    ] = None,
    dataset: Annotated[
        str | None, typer.Option("--dataset", "-d", metavar="NAME,…", help="Datasets.")
    ] = None,
    sensors: Annotated[
        str | None, typer.Option("--sensors", help="Sensor mode, where an algorithm has several.")
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary", metavar="FIELD=VALUE,…", help="A field and its values, as maxRange=30,100; repeatable."
        ),
    ] = None,
    repetitions: Annotated[
        int | None, typer.Option("--repetitions", "-r", min=1, help="Runs of each combination.")
    ] = None,
    output: Output = None,
) -> None:
    """Write a sweep: which algorithms on which datasets, what varies, how often.

    What is not given is asked; without a terminal the default is taken.

    Example: slamhive new sweep study --algorithm kiss-icp --dataset synthetic-lidar --vary maxRange=30,100
    """
    workshop = load_workshop(Home.from_environment())
    chosen = _answer("name of the sweep", name, "study")
    target = _free(output or Path(f"{chosen}.yaml"))
    algorithms = _listed("algorithms", algorithm, _algorithms(workshop), workshop.algorithms, "algorithm")
    used = [workshop.algorithms[one] for one in algorithms]
    datasets = _listed("datasets", dataset, _datasets(workshop, used), workshop.datasets, "dataset")
    mode = _mode(used, datasets, workshop, sensors)
    parameters = sorted(set.intersection(*(set(one.spec.parameters) for one in used)))
    axes = _axes(vary, parameters)
    count = _answer("runs of each combination", repetitions, 3, _count)
    template: dict[str, Any] = {}
    matrix: list[dict[str, Any]] = []
    for path, field, names in (
        ("algorithm", "algorithmRef", algorithms),
        ("dataset", "datasetRef", datasets),
    ):
        if len(names) == 1:
            template[field] = {"name": names[0]}
        else:
            matrix.append({"path": path, "values": names})
    template |= {"sensors": mode} if mode else {}
    spec = {"template": {"spec": template}, "matrix": [*matrix, *axes], "repetitions": count}
    _write("Sweep", chosen, {key: item for key, item in spec.items() if item}, target, workshop)
    _next(f"validate {target}", f"run {target}")


@app.command("dataset")
def new_dataset(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Name of the dataset.")] = None,
    *,
    recording: Annotated[
        str | None,
        typer.Option(
            "--recording",
            metavar="SOURCE",
            help="An existing recording; without one, a recording is generated.",
        ),
    ] = None,
    sensors: Annotated[
        str | None,
        typer.Option(
            "--sensors", metavar="SENSOR,…", help="Sensors of a generated one: Lidar, Imu, Stereo, Rgbd."
        ),
    ] = None,
    duration: Annotated[
        str | None, typer.Option("--duration", help="Length of a generated one, such as 30s.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Seed of the generated room, path and noise.")
    ] = None,
    output: Output = None,
) -> None:
    """Write a dataset: of a recording that you have (as dataset add does), or one to be generated.

    What is not given is asked; without a terminal the default is taken.

    Example: slamhive new dataset hall --sensors Lidar,Imu --duration 20s
    """
    source = _answer("recording: a bag or folder; empty: a generated one", recording, "")
    if source:
        from slamhive.cli.datasets import add

        given = {"--sensors": sensors, "--duration": duration, "--seed": seed, "--output": output}
        for option, value in given.items():
            if value is not None:
                raise InputError(f"{option}: of a generated recording; --recording names one that is there")
        suggested = plain_name(Path(source).name.split(".")[0])
        add([Path(source)], name=_answer("name of the dataset", name, suggested))
        return
    workshop = load_workshop(Home.from_environment())
    chosen = _answer("name of the dataset", name, "my-hall")
    target = _free(output or Path(f"{chosen}.yaml"))
    known = [str(one) for one in SyntheticSensor]
    found = _listed("sensors", sensors, ["Lidar", "Imu"], known, "sensor")
    length = _answer("length", duration, "30s", _length)
    number = _answer("seed", seed, 1, _seed)
    # A lap takes half a minute; a shorter recording has a part of one, at the usual pace.
    laps = round(min(1.0, max(seconds(length) - 6.0, 1.0) / 24.0), 3)
    spec = {
        "description": f"A generated hall, {length} with {', '.join(found)}",
        "recording": {
            "synthetic": {"seed": number, "sensors": found, "loops": laps, "durationSeconds": seconds(length)}
        },
        "gravityAligned": True,
    }
    _write("Dataset", chosen, spec, target, workshop)
    _next(f"dataset add {target}", f"dataset check {chosen}")


@app.command("algorithm")
def new_algorithm(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Name of the algorithm.")] = None,
    *,
    kind: Annotated[
        ExampleKind | None, typer.Option("--from", help="A Python program, a ROS 1 node, or a program in C.")
    ] = None,
) -> None:
    """Make a folder to start an algorithm from, as algorithm new does.

    What is not given is asked; without a terminal the default is taken.

    Example: slamhive new algorithm my-slam --from lidar-python
    """
    from slamhive.cli.algorithms import new_algorithm as begin

    chosen = _answer("name of the algorithm", name, "my-slam")
    words = ", ".join(ExampleKind)
    begin(chosen, kind=_answer(f"begin with ({words})", kind, ExampleKind.LIDAR_PYTHON, _kind))


def _answer(question: str, given: Any, default: Any, read: Callable[[str], Any] = str.strip) -> Any:
    """Return the value of an option, or else the answer to a question, or else its default.

    An answer that can't be read is asked for again, an option's ends the command.
    """
    if given is not None:
        return read(given) if isinstance(given, str) else given
    if not sys.stdin.isatty():
        return default

    def value(text: Any) -> Any:
        try:
            return read(str(text))
        except InputError as error:
            raise typer.BadParameter(str(error)) from None

    return typer.prompt(
        question, default=str(default), value_proc=value, show_default=bool(str(default)), err=True
    )


def _listed(
    question: str, given: str | None, default: Sequence[str], known: Sequence[str] | Any, noun: str
) -> list[str]:
    """Return names that are known, as they were given or answered."""

    def read(text: str) -> list[str]:
        names = [one.strip() for one in text.split(",") if one.strip()]
        if not names:
            raise InputError(f"--{noun}: name at least one")
        for number, one in enumerate(names):
            if one not in known:
                raise UnknownNameError(noun, one, known)
            if one in names[:number]:
                raise InputError(f"{noun} {one!r} stands twice")
        return names

    if given is None and sys.stdin.isatty():
        remark(f"known: {', '.join(sorted(known))}")
    found: str | list[str] = _answer(question, given, ",".join(default), read)
    return read(found) if isinstance(found, str) else found


def _algorithms(workshop: Workshop) -> list[str]:
    """Return the user's own algorithms, or else one that comes with slamhive."""
    home = Home.from_environment().path
    own = [name for name in workshop.algorithms if (home / "algorithms" / name).exists()]
    return (
        sorted(own)
        or [name for name in ("kiss-icp", *workshop.algorithms) if name in workshop.algorithms][:1]
    )


def _datasets(workshop: Workshop, used: Sequence[Algorithm]) -> list[str]:
    """Return the user's own datasets that the algorithms can read, or else the first one that comes along."""
    home = Home.from_environment().path
    fits = [
        name
        for name, one in sorted(workshop.datasets.items())
        if one.metadata.labels.get(_TRAINING[0]) != _TRAINING[1]
        and all(_modes(algorithm, [name], workshop) for algorithm in used)
    ]
    own = [name for name in fits if (home / "datasets" / name / "dataset.yaml").is_file()]
    return own or fits[:1]


def _modes(algorithm: Algorithm, names: Sequence[str], workshop: Workshop) -> list[str]:
    """Return the modes of an algorithm that all of some datasets have the sensors for."""
    return [
        str(mode.name)
        for mode in algorithm.spec.modes
        if not any([*role_problems(mode, workshop.datasets[name], {})] for name in names)
    ]


def _mode(
    used: Sequence[Algorithm], names: Sequence[str], workshop: Workshop, given: str | None
) -> str | None:
    """Return the sensor mode to write; None where each algorithm has one alone and none is asked for."""
    if given is None and all(len(one.spec.modes) == 1 for one in used):
        return None
    shared = [
        mode
        for mode in _modes(used[0], names, workshop)
        if all(mode in _modes(one, names, workshop) for one in used)
    ]
    if not shared:
        raise InputError(
            f"--algorithm, --dataset: {', '.join(one.name for one in used)} have no sensor mode in common "
            f"for which {', '.join(names)} has the sensors; write a sweep for each"
        )

    def read(text: str) -> str:
        if text not in shared:
            raise UnknownNameError("sensor mode", text, shared, "--sensors")
        return text

    mode: str = _answer(f"sensor mode ({', '.join(shared)})", given, shared[0], read)
    return mode


def _axes(given: Sequence[str] | None, parameters: Sequence[str]) -> list[dict[str, Any]]:
    """Return axes of the matrix, as options give them or asked for one after the other."""

    def read(text: str) -> dict[str, Any] | None:
        if not text.strip():
            return None
        path, equals, values = text.partition("=")
        if not equals or not path.strip() or not values.strip():
            raise InputError(f"--vary: expected FIELD=VALUE,VALUE, found {text!r}")
        path = path.strip()
        path = f"parameters.{path}" if path in parameters else path
        document = parse(f"[{values}]", "--vary")
        return {"path": path, "values": document[0].value}

    if given is not None or not sys.stdin.isatty():
        found = [read(text) for text in given or ()]
        return [axis for axis in found if axis is not None]
    remark(f"what may vary: input.frameRate, input.resolution, parameters {', '.join(parameters)}")
    axes: list[dict[str, Any]] = []
    while (axis := _answer("vary (FIELD=VALUE,…; empty ends)", None, "", read)) is not None:
        axes.append(axis)
    return axes


def _count(text: str) -> int:
    if not text.strip().isdigit() or int(text) < 1:
        raise InputError(f"expected a whole number of at least 1, found {text!r}")
    return int(text)


def _seed(text: str) -> int:
    if not text.strip().isdigit():
        raise InputError(f"expected a whole number, found {text!r}")
    return int(text)


def _length(text: str) -> str:
    if not seconds(text):
        raise InputError(f"--duration: expected a duration such as 30s, found {text!r}")
    return text.strip()


def _kind(text: str) -> ExampleKind:
    if text not in set(ExampleKind):
        raise UnknownNameError("kind", text, ExampleKind, "--from")
    return ExampleKind(text)


def _free(path: Path) -> Path:
    if path.exists() or path.is_symlink():
        raise InputError(f"{path} is there already; nothing is overwritten: name another file by --output")
    return path


def _write(kind: str, name: str, spec: dict[str, Any], target: Path, workshop: Workshop) -> None:
    """Write a manifest that validates; nothing is written otherwise.

    Raises:
        InputError: what was answered makes no right manifest, or the file can't be made.
    """
    body = {"apiVersion": API_VERSION, "kind": kind, "metadata": {"name": name}, "spec": spec}
    text = editor_line(kind) + yaml.safe_dump(
        body, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100
    )
    aside = target.with_name(f".{target.name}.new")
    try:
        aside.write_text(text, encoding="utf-8")
        checked = check_files([aside], workshop)
        if checked.problems:
            raise InputError("\n".join(sentence.partition(": ")[2] for sentence in checked.problems))
        os.link(aside, target)  # unlike a rename it never replaces a file
    except FileExistsError:
        _free(target)
    except OSError as error:
        raise InputError(f"{target}: {error.strerror}") from None
    finally:
        aside.unlink(missing_ok=True)
    runs = sum(plan.most_runs for _, plan in checked.plans)
    out.print(f"wrote {target}" + (f": {plural(runs, 'run')}" if runs else ""), soft_wrap=True, markup=False)


def _next(*steps: str) -> None:
    for number, step in enumerate(steps):
        out.print(
            f"{'Next:' if number == 0 else '     '}  {command_name()} {step}", soft_wrap=True, markup=False
        )
