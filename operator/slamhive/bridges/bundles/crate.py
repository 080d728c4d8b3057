# SPDX-License-Identifier: Apache-2.0
"""The crate of a bundle: what its files are and how they came to be, in the words of RO-Crate.

RO-Crate 1.1 with the profile Process Run Crate 0.5: each run is an action that a program did on a dataset,
whose results are files. Neither the clock nor chance has a say, so that equal studies give equal bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.bridges.bundles.contents import RUN, STUDY
from slamhive.model.extras import library
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from slamhive.bridges.bundles.contents import BundledRun, BundledStudy

PROFILE = "https://w3id.org/ro/wfrun/process/0.5"
NO_DATE = "1980-01-01"
"""Date of a study that is not to tell its own."""
_KINDS = {
    ".json": "application/json",
    ".yaml": "application/yaml",
    ".txt": "text/plain",
    ".csv": "text/csv",
    ".md": "text/markdown",
}
_ENDS = {Phase.SUCCEEDED: "CompletedActionStatus", Phase.FAILED: "FailedActionStatus"}


def make_crate(study: BundledStudy, runs: Sequence[BundledRun], files: Mapping[str, Path]) -> Any:
    """Return the crate of a study.

    Args:
        study: the study.
        runs: its runs.
        files: where the files are, by their names in the bundle.

    Raises:
        InputError: the extra that writes crates isn't installed.
    """
    module = library("rocrate.rocrate", "bundle", "slamhive bundle")
    entity = library("rocrate.model.contextentity", "bundle", "slamhive bundle").ContextEntity
    crate = module.ROCrate(version="1.1")

    def add(identity: str, **fields: Any) -> Any:
        return crate.add(
            entity(crate, identity, {name.replace("at_", "@"): one for name, one in fields.items()})
        )

    root = crate.root_dataset
    root["name"] = study.title
    root["description"] = _description(study, len(runs))
    times = [run.record.finished for run in runs if run.record.finished]
    root["datePublished"] = max(times).date().isoformat() if times else NO_DATE
    root["conformsTo"] = add(PROFILE, at_type="CreativeWork", name="Process Run Crate", version="0.5")
    root["license"] = study.license or "none was stated: ask the authors"
    if study.authors:
        root["author"] = [
            add(f"#author-{number}", at_type="Person", name=name)
            for number, name in enumerate(study.authors, 1)
        ]
    for name in sorted(files):
        kind = _KINDS.get(name[name.rindex(".") :], "application/octet-stream")
        crate.add_file(files[name], name, properties={"name": _title(name), "encodingFormat": kind})
    add(
        "#slamhive",
        at_type="SoftwareApplication",
        name="SLAM Hive",
        softwareVersion=study.slamhive,
        version=study.slamhive,
        url="https://github.com/SLAM-Hive",
    )
    programs = {
        one.manifest: add(
            f"#algorithm-{_stem(one.manifest)}",
            at_type="SoftwareApplication",
            name=one.name,
            softwareVersion=_stem(one.manifest).rpartition("-")[2],
            version=_stem(one.manifest).rpartition("-")[2],
            **({"license": one.license} if one.license else {}),
            **({"url": one.homepage} if one.homepage else {}),
            subjectOf=crate.dereference(one.manifest),
        )
        for one in study.algorithms
    }
    recordings = {
        one.manifest: add(
            f"#dataset-{_stem(one.manifest)}",
            at_type="CreativeWork",
            name=one.name,
            description="Not part of this bundle: slamhive fetches or makes it by its name.",
            identifier=[f"sha256:{sha256}" for sha256 in one.recordings],
            **({"license": one.license} if one.license else {}),
            **({"citation": one.citation} if one.citation else {}),
            subjectOf=crate.dereference(one.manifest),
        )
        for one in study.datasets
    }
    by_run: dict[str, list[str]] = {}
    for name in sorted(files):
        if name.startswith("runs/"):
            by_run.setdefault(name.split("/")[1], []).append(name)
    root["mentions"] = [
        add(
            f"#run-{run.record.name}",
            instrument=programs[run.algorithm],
            object=[recordings[run.dataset]],
            result=[crate.dereference(name) for name in by_run.get(run.record.name, ())],
            **_action(run),
        )
        for run in runs
    ]
    return crate


def _action(run: BundledRun) -> dict[str, Any]:
    """Return the name, end and times of a run."""
    record = run.record
    names = record.spec["algorithmRef"]["name"], record.spec["datasetRef"]["name"]
    fields: dict[str, Any] = {
        "at_type": "CreateAction",
        "name": f"{' on '.join(names)}: {record.name}",
        "actionStatus": f"http://schema.org/{_ENDS.get(record.phase, 'FailedActionStatus')}",
    }
    if record.phase is not Phase.SUCCEEDED:
        fields["error"] = str(record.reason or record.phase)
    if record.started:
        fields["startTime"] = record.started.isoformat()
    if record.finished:
        fields["endTime"] = record.finished.isoformat()
    return fields


def _description(study: BundledStudy, runs: int) -> str:
    algorithms = ", ".join(sorted({one.name for one in study.algorithms}))
    datasets = ", ".join(sorted({one.name for one in study.datasets}))
    return (
        f"{runs} runs of {algorithms} on {datasets} with results and trajectories. "
        "`slamhive verify` recomputes every figure, `slamhive import` takes it into one's own archive."
    )


def _stem(manifest: str) -> str:
    return manifest.rpartition("/")[2].removesuffix(".yaml")


def _title(name: str) -> str:
    folder, _, last = name.rpartition("/")
    run = folder.removeprefix("runs/")
    if last == STUDY:
        return "Checksums of all files, and how runs are measured"
    if last == RUN:
        return f"Record of {run} with its results"
    return f"{last} of {run}" if folder.startswith("runs/") else last
