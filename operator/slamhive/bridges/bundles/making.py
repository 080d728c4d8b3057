# SPDX-License-Identifier: Apache-2.0
"""Making of a bundle from the runs of a sweep of this home; equal studies give equal bytes."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive import __version__
from slamhive.analysis.measuring import SETTINGS_KEY, settings_hash
from slamhive.analysis.subjects import SubjectItem
from slamhive.archive import CatalogEntry
from slamhive.bridges.bundles import contents
from slamhive.bridges.bundles.anonymity import (
    anonymous_record,
    anonymous_spec,
    require_silence,
    words_that_tell,
)
from slamhive.bridges.bundles.contents import (
    BundledRun,
    BundledStudy,
    StudyAlgorithm,
    StudyDataset,
    StudyEnvironment,
    study_sha256,
    truth_sha256,
)
from slamhive.bridges.bundles.crate import make_crate
from slamhive.contract.files import NotRegularError, open_below
from slamhive.data.files.once import flush
from slamhive.data.recordings.entries import file_sha256
from slamhive.local.home.catalog import bundled
from slamhive.local.home.changes import current_uid
from slamhive.local.home.sweeping import sweeps_meant
from slamhive.local.running.evaluating import TrajectoryEvaluator
from slamhive.model.algorithm import Algorithm
from slamhive.model.catalogue import find_sequence
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, SlamHiveError
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.extras import library
from slamhive.model.results import IMPORTED, Phase
from slamhive.tables.manifests import manifest, without_nothing
from slamhive.tables.searches import most_runs, sweep_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.archive import SweepRecord
    from slamhive.local.home.catalog import DatasetPlace
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import RunRecord

_DIGITS = 8
_ENVIRONMENT_DIGITS = 16


@dataclass(frozen=True)
class BundleOrder:
    """Wishes of who bundles a study.

    Attributes:
        sweep: name of the sweep.
        title: for people; default: the sweep's name.
        authors, license: of the study.
        anonymous: whether everything is taken out that tells whose it is.
        settings: of Evaluations beside the sweep's own settings.
        datasets: with files of their own that stood beside the sweep, each with the folder its paths start
            from.
    """

    sweep: str
    title: str | None = None
    authors: tuple[str, ...] = ()
    license: str | None = None
    anonymous: bool = False
    settings: tuple[EvaluationSettings, ...] = ()
    datasets: tuple[DatasetPlace, ...] = ()


@dataclass
class BundleReport:
    """Counts of what went into a bundle, and what others can't recompute of it.

    Attributes:
        runs, trajectories: their numbers.
        size: bytes of the file.
        notes: sentences.
    """

    runs: int = 0
    trajectories: int = 0
    size: int = 0
    notes: list[str] = field(default_factory=list)


def bundle(
    bench: Workbench, order: BundleOrder, output: Path, step: Callable[[int, int], None] = lambda *_: None
) -> BundleReport:
    """Write the bundle of a sweep's runs.

    Args:
        bench: the home.
        order: what is wanted.
        output: the file; it must not exist.
        step: called with the number of runs done, and of all.

    Raises:
        InputError: there is no such sweep, it has no finished runs of this home, or the bundle would tell
            whose it is.
        OSError: the disk refuses.
    """
    library("rocrate.rocrate", "bundle", "slamhive bundle")
    sweep = sweeps_meant(bench.archive.sweeps(), order.sweep)[-1]
    records = _records(bench, sweep)
    with tempfile.TemporaryDirectory(prefix="slamhive-bundle-") as folder:
        made = _BundleMaking(bench, order, sweep, Path(folder))
        for number, record in enumerate(records):
            step(number, len(records))
            made.take(record)
        made.write(output, records)
    asked = most_runs(sweep)
    if asked is not None and len(records) < asked and not sweep_of(sweep).spec.search.is_search:
        left = f"the other {asked - len(records)} of the {asked} that were asked for"
        made.report.notes.append(f"sweep {sweep.name!r}: {left} have not finished and are not in it")
    made.report.size = output.stat().st_size
    return made.report


def _records(bench: Workbench, sweep: SweepRecord) -> list[RunRecord]:
    found = list(bench.archive.runs({"sweep_uid": sweep.uid}))
    if any(record.origin for record in found):
        raise InputError(f"sweep {sweep.name!r} is somebody else's: pass on the bundle that it came in")
    if any(record.labels.get("source") == IMPORTED for record in found):
        raise InputError(
            f"sweep {sweep.name!r} came from the original SLAM Hive, which has no manifests of what ran, and "
            "nobody could verify a bundle without: pass on its folders, which slamhive import takes"
        )
    records = [one for one in found if one.phase.is_finished and current_uid(one.uid) == one.uid]
    if not records:
        raise InputError(f"sweep {sweep.name!r} has no finished run here: slamhive run it first")
    return sorted(records, key=lambda one: (one.index or 0, one.name))


class _BundleMaking:
    """A bundle on its way.

    Attributes:
        report: what went in.
    """

    def __init__(self, bench: Workbench, order: BundleOrder, sweep: SweepRecord, folder: Path) -> None:
        self._bench, self._order, self._sweep, self._folder = bench, order, sweep, folder
        self._evaluator = TrajectoryEvaluator(bench)
        self._files: dict[str, Path] = {}
        self._runs: list[BundledRun] = []
        self._algorithms: dict[str, StudyAlgorithm] = {}
        self._datasets: dict[str, StudyDataset] = {}
        self._truths: dict[str, str | None] = {}
        # Somebody else's of the same content has another name.
        self._catalog: dict[str, dict[tuple[str, str], CatalogEntry]] = {
            kind: {(entry.name, entry.content_hash): entry for entry in bench.archive.catalog(kind)}
            for kind in ("Algorithm", "Dataset")
        }
        own = EvaluationSettings.model_validate(sweep.evaluation or {})
        known = (EvaluationSettings(), own, *order.settings)
        self._known = {settings_hash(one): one for one in known}
        self._used: dict[str, EvaluationSettings] = {}
        self._unknown: set[str] = set()
        self._gone: list[str] = []
        self.report = BundleReport()

    def take(self, record: RunRecord) -> None:
        """Take in a run with the files that its figures come from."""
        algorithm, dataset = self._manifests(record)
        for result in record.results:
            settings = self._known.get(str(result.values.get(SETTINGS_KEY)))
            if settings is None:
                self._unknown.add(result.evaluation)
            else:
                self._used[settings_hash(settings)] = settings
        subject = None
        if record.phase is Phase.SUCCEEDED:
            path = self._evaluator.trajectory_of(record)
            if path is None:
                self._gone.append(record.name)
            else:
                subject = self._subject(record) if record.results else None
                self._take_files(record.name, path.parent)
                self.report.trajectories += 1
        self._take_environment(record)
        kept = record.replace(folder=None, log_tail=None, note=None, tags=[], noted=None)
        if kept.trajectory is not None:
            kept = kept.replace(trajectory=kept.trajectory.replace(path=contents.TRAJECTORY))
        if self._order.anonymous:
            kept = anonymous_record(kept)
        run = BundledRun(record=kept, algorithm=algorithm, dataset=dataset, subject=subject)
        self._runs.append(run)
        self._write_json(contents.run_file(record.name, contents.RUN), run.as_json())
        self.report.runs += 1

    def write(self, output: Path, records: Sequence[RunRecord]) -> None:
        """Write the file, whole or not at all."""
        spec = without_nothing(self._sweep.spec)
        labels = {} if self._order.anonymous else self._sweep.labels
        self._write_text(contents.SWEEP, manifest("Sweep", self._sweep.name, labels, spec))
        study = self._study(spec)
        # The crate names both, which have its checksum and each other's: their content is not part of it.
        places = {name: self._folder / name for name in (contents.STUDY, contents.README)}
        crate = make_crate(study, self._runs, {**self._files, **places})
        self._write_bytes(contents.METADATA, b"".join(chunk for _, chunk in crate.metadata.stream()))
        sums = {name: file_sha256(path) for name, path in self._files.items()}
        told = study.replace(files=sums).as_json()
        self._write_text(contents.README, _readme(study, len(self._runs), study_sha256(told)))
        told["files"][contents.README] = file_sha256(places[contents.README])
        self._write_json(contents.STUDY, told)
        if self._order.anonymous:
            nodes = {record.provenance.node for record in records}
            require_silence(self._files, words_that_tell(self._bench.home.path, nodes))
        aside = output.with_name(f".{output.name}.{os.getpid()}")
        try:
            crate.write_zip(aside)
            flush(aside)
            aside.replace(output)
        finally:
            aside.unlink(missing_ok=True)
        self._tell()

    def _study(self, spec: dict[str, Any]) -> BundledStudy:
        order = self._order
        return BundledStudy(
            name=self._sweep.name,
            title=order.title or f"Study {self._sweep.name}",
            slamhive=__version__,
            is_anonymous=order.anonymous,
            authors=[] if order.anonymous else list(order.authors),
            license=order.license,
            sweep=spec,
            evaluation=self._sweep.evaluation,
            settings=dict(sorted(self._used.items())),
            algorithms=[self._algorithms[name] for name in sorted(self._algorithms)],
            datasets=[
                one.replace(recordings=sorted(one.recordings)) for _, one in sorted(self._datasets.items())
            ],
        )

    def _tell(self) -> None:
        if self._gone:
            self.report.notes.append(
                f"trajectories are gone here of {', '.join(self._gone[:5])}"
                f"{', …' if len(self._gone) > 5 else ''}: nobody can recompute their figures"
            )
        for name in sorted(self._unknown):
            self.report.notes.append(
                f"the settings of evaluation {name!r} aren't known here, and nobody can recompute it: "
                "--evaluation FILE names its manifest"
            )

    def _subject(self, record: RunRecord) -> SubjectItem | None:
        name = record.spec["datasetRef"]["name"]
        try:
            truth = self._bench.truth(name)
            if truth is None:
                return None
            return SubjectItem.of(self._evaluator.subject(record.spec, truth))
        except SlamHiveError as error:
            raise InputError(
                f"run {record.name}: its dataset {name} is needed for how it is measured: {error}"
            ) from None

    def _truth(self, name: str) -> str | None:
        if name not in self._truths:
            self._truths[name] = None
            truth = self._bench.truth(name)
            if truth is not None:
                self._truths[name] = truth_sha256(truth.poses)
        return self._truths[name]

    def _manifests(self, record: RunRecord) -> tuple[str, str]:
        """Write the manifests of what a run used, and return their names."""
        hashes = self._bench.archive.used([record.uid]).get(record.uid, (None, None))
        names = record.spec["algorithmRef"]["name"], record.spec["datasetRef"]["name"]
        found = []
        for kind, name, hashed in zip(("Algorithm", "Dataset"), names, hashes, strict=True):
            entry = self._catalog[kind].get((name, hashed or ""))
            if entry is None:
                raise InputError(f"run {record.name}: the archive has no {kind} {name!r} as the run used it")
            path = f"manifests/{kind.lower()}s/{name}-{entry.content_hash[:_DIGITS]}.yaml"
            found.append(path)
            if path not in self._files:
                self._write_manifest(path, entry)
        algorithm, dataset = found
        sha256 = record.provenance.dataset_sha256
        known = self._datasets[dataset]
        if sha256 is not None and sha256 not in known.recordings:
            self._datasets[dataset] = known.replace(recordings=[*known.recordings, sha256])
        return algorithm, dataset

    def _write_manifest(self, path: str, entry: CatalogEntry) -> None:
        spec, labels = entry.spec, entry.labels
        if self._order.anonymous:
            spec, labels = anonymous_spec(spec, is_public=_is_public(entry)), {}
        spec = without_nothing(spec)
        self._write_text(path, manifest(entry.kind, entry.name, labels, spec))
        license_, homepage = spec.get("license"), spec.get("homepage")
        self._make_known(entry)
        if entry.kind == "Algorithm":
            self._algorithms[path] = StudyAlgorithm(
                name=entry.name, manifest=path, license=license_, homepage=homepage
            )
            return
        citation = None
        if entry.spec.get("catalogue"):
            with suppress(SlamHiveError):
                head = find_sequence(entry.spec["catalogue"]).family
                license_, citation = license_ or head.license, head.cite
        self._datasets[path] = StudyDataset(
            name=entry.name, manifest=path, truth=self._truth(entry.name), license=license_, citation=citation
        )

    def _make_known(self, entry: CatalogEntry) -> None:
        """Take in what stood in a file beside the sweep, and is known here by the archive alone.

        How runs are measured follows from an Algorithm's manifest, and from that of a dataset which is
        generated or fetched; files of a dataset's own are found from the folder of its manifest.

        Raises:
            InputError: nobody says where a dataset's files are, or its manifest has changed since.
        """
        workshop, folder = self._bench.workshop, self._bench.home.path
        named = [one for one in self._order.datasets if one.dataset.name == entry.name]
        if entry.kind == "Dataset" and named:
            hashed = (one for one in named if CatalogEntry.of(one.dataset).content_hash == entry.content_hash)
            given = next(hashed, None)
            if given is None:
                raise InputError(
                    f"{entry.name!r} is not as the runs used it: {self._order.sweep!r} is over another "
                    "recording of that name, or its manifest was edited since",
                    "dataset",
                )
            workshop.add([given.dataset], given.folder)
            return
        if entry.name in (workshop.datasets if entry.kind == "Dataset" else workshop.algorithms):
            return
        kind = Dataset if entry.kind == "Dataset" else Algorithm
        made = kind.model_validate({"metadata": {"name": entry.name}, "spec": entry.spec})
        if isinstance(made, Dataset) and made.spec.recording.files:
            raise InputError(
                f"dataset {entry.name!r} has files of its own and is not known here: it stood in a file of "
                "its sweep's, and paths start from there; name that file: --dataset FILE"
            )
        workshop.add([made], folder)

    def _take_environment(self, record: RunRecord) -> None:
        digest = record.provenance.environment
        if digest is None:
            return
        name = f"environments/{digest.removeprefix('sha256:')[:_ENVIRONMENT_DIGITS]}.json"
        if name not in self._files:
            one = StudyEnvironment(
                algorithm=record.spec["algorithmRef"]["name"],
                digest=digest,
                image_id=record.provenance.image_id,
                parts=self._bench.versions.parts(digest),
            )
            self._write_json(name, one.as_json())

    def _take_files(self, run: str, output: Path) -> None:
        for name in contents.MEASURED:
            try:
                with open_below(str(output), name) as descriptor, os.fdopen(os.dup(descriptor), "rb") as file:
                    target = self._place(contents.run_file(run, name))
                    with target.open("wb") as copy:
                        shutil.copyfileobj(file, copy)
            except (FileNotFoundError, NotRegularError):
                continue

    def _place(self, name: str) -> Path:
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        self._files[name] = path
        return path

    def _write_bytes(self, name: str, content: bytes) -> None:
        self._place(name).write_bytes(content)

    def _write_text(self, name: str, text: str) -> None:
        self._write_bytes(name, text.encode())

    def _write_json(self, name: str, value: Any) -> None:
        self._write_text(name, json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n")


def _is_public(entry: CatalogEntry) -> bool:
    """Tell whether a manifest is one that comes with slamhive, or of its catalogue of public datasets."""
    if entry.kind == "Dataset":
        folder = bundled("examples") / "datasets"
        return bool(entry.spec.get("catalogue")) or (folder / f"{entry.name}.yaml").is_file()
    return (bundled("algorithms") / entry.name / "algorithm.yaml").is_file()


_README = """\
# {title}

{runs} runs of the sweep `{name}` with results and trajectories, made by SLAM Hive {slamhive}. Recordings and
ground truth are not part of it: they are fetched or made by name.

```bash
slamhive verify study.zip                # recomputes every figure from the trajectories
slamhive verify study.zip --repeat 5     # does five of the runs again
slamhive import study.zip                # into one's own archive, marked as somebody else's
```

{authors}Licence of the study: {license}.

| what | licence | cite |
|---|---|---|
"""


def _readme(study: BundledStudy, runs: int, sha256: str) -> str:
    """Return the description of a bundle in words, with licences, citations and the study's checksum."""
    head = _README.format(
        title=study.title,
        runs=runs,
        name=study.name,
        slamhive=study.slamhive,
        authors=f"Authors: {', '.join(study.authors)}\n\n" if study.authors else "",
        license=study.license or "none was stated",
    )
    cells = [(f"algorithm {one.name}", one.license, one.homepage) for one in study.algorithms]
    cells += [(f"dataset {one.name}", one.license, one.citation) for one in study.datasets]
    table = "".join(f"| {what} | {terms or 'not stated'} | {cite or ''} |\n" for what, terms, cite in cells)
    return f"{head}{table}\n{contents.STATED}{sha256}\n"
