# SPDX-License-Identifier: Apache-2.0
"""Contents of a bundle: who makes one and who reads one agree here.

::

    study.zip
        ro-crate-metadata.json      what everything is, for machines: RO-Crate 1.1, Process Run Crate 0.5
        README.md                   the same in words, and the checksum of study.json
        study.json                  `BundledStudy`: checksums of all files, datasets, how runs are measured
        manifests/sweep.yaml        what was asked for
        manifests/algorithms/NAME-DIGITS.yaml, manifests/datasets/NAME-DIGITS.yaml
                                    what runs used, as it was
        environments/DIGITS.json    `StudyEnvironment`: what programs were made of
        runs/RUN/run.json           `BundledRun`: record with results, and how its trajectory is measured
        runs/RUN/trajectory.txt     what its errors come from, and what else lay beside it

Of recordings and ground truth there are checksums and names alone.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from slamhive.analysis.measuring import SEGMENTS
from slamhive.analysis.subjects import SubjectItem
from slamhive.contract.output import KEYFRAMES, ONLINE
from slamhive.contract.trajectory import FILE
from slamhive.model.base import Model, Sha256
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import RunRecord
from slamhive_eval import Relations
from slamhive_eval.formats.healthfiles import COVARIANCES, HEALTH

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive_eval import ControlPoints, Trajectory

FORM = "slamhive-study/1"
STUDY, METADATA, README = "study.json", "ro-crate-metadata.json", "README.md"
STATED = "Checksum of study.json without that of this file: sha256:"
"""Beginning of the last line of README.md."""
RUN = "run.json"
SWEEP = "manifests/sweep.yaml"
TRAJECTORY = FILE
MEASURED = (TRAJECTORY, SEGMENTS, ONLINE, KEYFRAMES, HEALTH, COVARIANCES)
"""Files of a run that its figures come from."""


def run_file(run: str, name: str) -> str:
    """Return the name that a run's file has in a bundle."""
    return f"runs/{run}/{name}"


class StudyDataset(Model):
    """Dataset of a study: its name, by which it is fetched, and checksums of what is behind it.

    Attributes:
        name: of the dataset.
        manifest: its file in the bundle.
        recordings: checksums that runs had of it, with calibration and ground truth.
        truth: checksum of its ground truth as runs are measured against it; None where it has none.
        license, citation: of the data.
    """

    name: str
    manifest: str
    recordings: list[Sha256] = Field(default_factory=list)
    truth: Sha256 | None = None
    license: str | None = None
    citation: str | None = None


class StudyAlgorithm(Model):
    """Algorithm of a study, as its runs used it.

    Attributes:
        name: of the algorithm.
        manifest: its file in the bundle.
        license, homepage: of the program.
    """

    name: str
    manifest: str
    license: str | None = None
    homepage: str | None = None


class StudyEnvironment(Model):
    """Environment that runs had: its digest, and the files and versions that it was made of.

    Attributes:
        algorithm: whose it is.
        digest: of all of it, or of the image.
        image_id: digest of the image, where it ran in a container.
        parts: checksums and versions by name; None where nobody noted them.
    """

    algorithm: str
    digest: str
    image_id: str | None = Field(default=None, alias="imageID")
    parts: dict[str, str] | None = None


class BundledStudy(Model):
    """The study of a bundle.

    Attributes:
        form: version of the contents.
        name, title: of the sweep, and for people.
        slamhive: version that made the bundle.
        is_anonymous: whether names, places and times were taken out.
        authors, license: as they were given.
        sweep: the sweep's spec.
        evaluation: settings that its runs are measured by.
        settings: all settings that results are of, by their hash.
        algorithms, datasets: what runs used.
        files: checksums of all other files.
    """

    form: Literal["slamhive-study/1"] = "slamhive-study/1"
    name: str
    title: str
    slamhive: str
    is_anonymous: bool = False
    authors: list[str] = Field(default_factory=list)
    license: str | None = None
    sweep: dict[str, Any]
    evaluation: dict[str, Any] | None = None
    settings: dict[str, EvaluationSettings] = Field(default_factory=dict)
    algorithms: list[StudyAlgorithm] = Field(default_factory=list)
    datasets: list[StudyDataset] = Field(default_factory=list)
    files: dict[str, Sha256] = Field(default_factory=dict)


class BundledRun(Model):
    """Run of a bundle.

    Attributes:
        record: all that is recorded of it.
        algorithm, dataset: files of their manifests in the bundle.
        subject: how its trajectory is measured; None where there is none, or no ground truth.
    """

    record: RunRecord
    algorithm: str
    dataset: str
    subject: SubjectItem | None = None


def study_sha256(told: Mapping[str, Any]) -> str:
    """Return the checksum of a study's JSON that README.md states, so without the one that it has of that."""
    files = {name: sha256 for name, sha256 in told["files"].items() if name != README}
    return hashlib.sha256(json.dumps({**told, "files": files}, sort_keys=True).encode()).hexdigest()


def truth_sha256(poses: Trajectory | Relations | ControlPoints) -> str:
    """Return the checksum of ground truth as runs are measured against it, whatever file it was read from."""
    parts: tuple[Any, ...] = (poses.stamps, poses.positions) if not isinstance(poses, Relations) else ()
    if isinstance(poses, Relations):
        parts = (poses.begin, poses.end, poses.positions, poses.quaternions)
    elif getattr(poses, "oriented", False):
        # Of quaternions as files have them: normalising rounds otherwise on another processor.
        parts += (np.round(poses.quaternions, 9) + 0.0,)  # type: ignore[union-attr]
    found = hashlib.sha256(type(poses).__name__.encode())
    for part in parts:
        array = np.ascontiguousarray(part, dtype="<f8")
        found.update(repr(array.shape).encode())
        found.update(array.tobytes())
    return found.hexdigest()
