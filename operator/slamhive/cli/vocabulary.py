# SPDX-License-Identifier: Apache-2.0
"""``slamhive algorithm train-vocabulary``: the bag of words that ORB-SLAM needs."""

from __future__ import annotations

import hashlib
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from slamhive.cli.parts.console import open_workbench, out, remark
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError, UnknownNameError

TRAINING_LABEL = ("slamhive.io/use", "training")


def train(
    datasets: Annotated[list[str], typer.Argument(metavar="DATASET…", help="Training sequences by name.")],
    *,
    sensor: Annotated[str, typer.Option("--sensor", help="Sensor whose images are taken.")] = "left",
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")] = Path("vocabulary.txt"),
    branching: Annotated[int, typer.Option("--branching", help="Children of a node.")] = 4,
    depth: Annotated[int, typer.Option("--depth", help="Levels of the tree.")] = 6,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the clustering.")] = 0,
) -> None:
    """Train a DBoW2 vocabulary on the images of training sequences.

    Only datasets labelled slamhive.io/use: training are taken: a vocabulary must never have seen what an
    algorithm is tested on.

    Example: slamhive algorithm train-vocabulary synthetic-training -o vocabulary.txt
    """
    from slamhive.data.inspecting.vocabulary import train_vocabulary, training_images
    from slamhive.data.recordings.reading import recording_paths

    key, value = TRAINING_LABEL
    bench = open_workbench(Home.from_environment())
    with bench.archive:
        for name in datasets:
            if bench.workshop.dataset(name).dataset.metadata.labels.get(key) != value:
                raise InputError(
                    f"dataset {name}: not a training sequence; it lacks the label {key}: {value}"
                )
        entries = [bench.dataset(name) for name in datasets]
        sources = []
        for entry in entries:
            known = entry.dataset.spec.sensors
            if sensor not in known:
                raise UnknownNameError("sensor", sensor, known, f"dataset {entry.name}")
            paths = recording_paths(entry.dataset, entry.root)
            sources += [training_images(path, known[sensor].topic) for path in paths]
        words = train_vocabulary(
            chain.from_iterable(sources), output, branching=branching, depth=depth, seed=seed
        )
    checksum = hashlib.sha256(output.read_bytes()).hexdigest()
    remark(f"{words} words")
    out.print(f"{output}  sha256 {checksum}", soft_wrap=True)
