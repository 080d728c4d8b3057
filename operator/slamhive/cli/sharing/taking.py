# SPDX-License-Identifier: Apache-2.0
"""``slamhive import bundle`` and ``trajectories``: runs of somebody else, listed beside own ones."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from slamhive.archive import CatalogEntry
from slamhive.bridges.bundles.opening import opened_bundle
from slamhive.bridges.bundles.taking import foreign_name, take_bundle
from slamhive.bridges.foreign import (
    SWEEP,
    TrajectoriesTaken,
    TrajectoryOrder,
    label_of,
    require_source,
    sensors_of,
    take_trajectories,
)
from slamhive.cli.parts.console import command_name, complain, open_archive, open_workbench, out, remark
from slamhive.cli.parts.exits import FAILED
from slamhive.cli.parts.waiting import Work
from slamhive.data.store.groundtruth import GroundTruthPoses
from slamhive.data.store.truthfolders import catalog_name
from slamhive.local.home.folder import Home
from slamhive.model.base import plain_name, plural, require_name
from slamhive.model.errors import InputError
from slamhive.model.evaluation import Alignment, EvaluationSettings
from slamhive.model.sensors import SensorMode
from slamhive_eval import EvaluationError, read_trajectory

if TYPE_CHECKING:
    from slamhive.local.running.workbench import Workbench

Label = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="What their algorithms are told apart by, as in kiss-icp @NAME."),
]


class TrajectoryFormat(StrEnum):
    """Formats of files of poses."""

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    CSV = "csv"


def import_bundle(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file that slamhive bundle wrote.")],
    *,
    label: Label = None,
) -> None:
    """Bring the runs of a bundle into the archive, with their trajectories, as somebody else's.

    They are listed beside own runs and never averaged with them. `slamhive verify` says whether their
    figures are right.

    Example: slamhive import bundle study.zip, or slamhive import study.zip
    """
    home = Home.from_environment()
    home.folder(".")
    with opened_bundle(file) as opened, open_archive(home) as archive, home.sharing("slamhive import"):
        label = label or plain_name(file.stem) or "study"
        with Work(f"importing {file.name}") as work:
            taken = take_bundle(home, archive, opened, label, work.count)
        name = foreign_name(opened.study.name, label)
    out.print(
        f"{opened.study.title}: {plural(taken.added, 'run')} imported, {taken.known} here already, as the "
        f"sweep {name!r}",
        markup=False,
        soft_wrap=True,
    )
    out.print(f"More:  {command_name()} results table --sweep {name!r}", markup=False, soft_wrap=True)


def import_trajectories(
    files: Annotated[list[Path], typer.Argument(metavar="FILES", help="Files of poses, one a repetition.")],
    *,
    dataset: Annotated[str, typer.Option(metavar="NAME", help="The dataset that they are of.")],
    algorithm: Annotated[str, typer.Option(metavar="NAME", help="What made them.")],
    source: Annotated[str, typer.Option(metavar="URL", help="Where they are from: https://… or doi:…")],
    label: Label = None,
    sensors: Annotated[
        SensorMode | None, typer.Option(help="Sensors of the algorithm; default: by what is known of it.")
    ] = None,
    alignment: Annotated[
        Alignment, typer.Option(help="Auto: Sim3 for mono, SE3 for all others.", case_sensitive=False)
    ] = Alignment.AUTO,
    frame: Annotated[
        str | None,
        typer.Option(
            metavar="SENSOR",
            help="Sensor of the dataset, or body, whose poses they are; default: the truth's.",
        ),
    ] = None,
    offset: Annotated[float, typer.Option(metavar="SECONDS", help="Added to their time stamps.")] = 0.0,
    form: Annotated[
        TrajectoryFormat | None, typer.Option("--format", help="Default: by the first line of each.")
    ] = None,
    times: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Stamps of KITTI poses, one a line.", exists=True, dir_okay=False),
    ] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="A setting that they were made with; may be repeated."),
    ] = None,
    ground_truth: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Ground truth of a dataset that isn't known here.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
) -> None:
    """Bring trajectories that somebody else made into the archive, measured as own runs are.

    They are listed as not run here, without load, and never averaged with own runs.

    Example: slamhive import trajectories poses.txt --dataset mh-01 --algorithm vins-mono --source https://…
    """
    require_source(source)
    require_name(algorithm, "algorithm")
    require_name(dataset, "dataset")
    if not np.isfinite(offset):
        raise InputError(f"expected a number of seconds, found {offset}", "offset")
    missing = [path for path in files if not path.is_file()]
    if missing:
        problem = "a folder; name the files in it" if missing[0].is_dir() else "no such file"
        raise InputError(f"{missing[0]}: {problem}")
    home = Home.from_environment()
    with Work("importing") as work:
        bench = open_workbench(home)
        work.follow(bench.making)
        with bench.archive, home.sharing("slamhive import"):
            order = TrajectoryOrder(
                dataset,
                algorithm,
                source,
                sensors_of(algorithm, bench.workshop, sensors),
                label or label_of(source),
                EvaluationSettings(alignment=alignment),
                frame,
                offset,
                form.value if form else None,
                times,
                _parameters(parameter or []),
            )
            truth, entry = _truth(bench, home, order, ground_truth)
            taken = take_trajectories(bench, order, files, truth, dataset=entry, step=work.count)
    _tell(taken, order, len(files))


def _truth(
    bench: Workbench, home: Home, order: TrajectoryOrder, file: Path | None
) -> tuple[GroundTruthPoses, CatalogEntry]:
    """Return the ground truth that is measured against, and the dataset as it is kept."""
    name = order.dataset
    if file is None:
        if name not in bench.workshop.datasets:
            bench.workshop.dataset(name)  # says what is known
        truth = bench.truth(name)
        if truth is None:
            raise InputError(f"dataset {name!r} has no ground truth: --ground-truth FILE names one")
        return truth, CatalogEntry.of(bench.workshop.dataset(name).dataset)
    try:
        poses = read_trajectory(file)
    except EvaluationError as error:
        raise InputError(f"{error}", "ground-truth") from None
    place = home.folder("groundtruth") / f"{catalog_name(name)}{file.suffix}"
    if not place.exists():
        place.write_bytes(file.read_bytes())
    elif place.read_bytes() != file.read_bytes():
        raise InputError(f"{place} is another ground truth of {name!r}, which stays", "ground-truth")
    spec = {
        "description": f"{name}, of which there is ground truth alone",
        "groundTruth": {"file": file.name},
    }
    return GroundTruthPoses(poses, np.eye(4)), CatalogEntry(
        kind="Dataset", name=name, labels={"source": SWEEP}, spec=spec
    )


def _parameters(words: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or not name:
            raise InputError(f"expected NAME=VALUE, found {word!r}", "parameter")
        found[name] = _value(text)
    return found


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        return number if math.isfinite(number) else text  # nan and inf are no JSON
    return {"true": True, "false": False}.get(text, text)


def _tell(taken: TrajectoriesTaken, order: TrajectoryOrder, count: int) -> None:
    if taken.problems and len(taken.problems) == count:
        raise InputError("\n".join(taken.problems))
    for sentence in taken.problems:
        complain(sentence)
    outcomes = ", ".join(f"{number} {outcome}" for outcome, number in sorted(taken.outcomes.items()))
    out.print(
        f"{foreign_name(order.algorithm, order.label)} on {order.dataset}, not run here: "
        f"{plural(taken.added, 'run')} imported, {taken.evaluated} evaluated, {taken.unchanged} there "
        f"already: {outcomes}",
        markup=False,
        soft_wrap=True,
    )
    remark(f"from {order.source}; slamhive results table shows them beside own runs")
    if taken.problems:
        raise typer.Exit(FAILED)
