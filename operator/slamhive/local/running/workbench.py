# SPDX-License-Identifier: Apache-2.0
"""Context that the runs of a workstation share: catalog, datasets, programs and archive."""

from __future__ import annotations

import os
import platform
import threading
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive import __version__
from slamhive.data.inspecting.known import FINDINGS, looked_at, require_possible, sensors_used
from slamhive.data.making.preparation import evict_variants, prepare, variant_folder
from slamhive.data.making.programmed import folder_by_program, prepare_by_program
from slamhive.data.recordings.entries import remember
from slamhive.data.recordings.version import VERSION
from slamhive.data.store.datasets import DatasetEntry, dataset_sha256, made_from, materialise
from slamhive.data.store.groundtruth import ground_truth
from slamhive.local.programs.environments import digest_of
from slamhive.local.programs.executors import Programs
from slamhive.local.programs.preparing import Preparer
from slamhive.local.programs.unavailable import GivenUp
from slamhive.local.programs.versions import Versions
from slamhive.local.running.measuring_apart import measuring_process
from slamhive.model.base import quantity
from slamhive.model.errors import InputError, SlamHiveError
from slamhive.model.results import Machine, Provenance
from slamhive.model.run import InputOptions
from slamhive.model.sensors import SensorMode
from slamhive.model.variant import suspicion
from slamhive.monitor.measuring.machine import cpu_model, machine_report
from slamhive.plan import algorithm_hash, content_hash

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from slamhive.archive import Archive
    from slamhive.data.making.preparation import Variant
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import ContainerChoice
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.variant import OpenFinding

_VARIANTS_LIMIT = "100Gi"
_HASHES = ".hashes"


class ProgramHashes(NamedTuple):
    """Hashes that identify an algorithm with its program: of its Algorithm, environment and image.

    Attributes:
        algorithm_hash: hash of its Algorithm.
        environment: digest of its environment and adapter, or of its image.
        image_id: identity of its image, None where it runs as a process.
    """

    algorithm_hash: str
    environment: str
    image_id: str | None = None


class Workbench:
    """The tools that all runs use.

    Args:
        home: where things are kept.
        workshop: algorithms and datasets by name.
        archive: where finished runs go.
        notify: told in a sentence of what takes long.
        container: what the user says of containers; None: they are for algorithms that have nothing else.
    """

    def __init__(
        self,
        home: Home,
        workshop: Workshop,
        archive: Archive,
        notify: Callable[[str], None] = lambda _: None,
        container: ContainerChoice | None = None,
    ) -> None:
        self.home = home
        self.workshop = workshop
        self.archive = archive
        self.making: dict[str, float] = {}
        """Things being made that runs wait for, in words, each with the share of it that is done."""
        self.gives_up = False
        """Datasets, recordings and environments that are being made are wanted no more."""
        self.programs = Programs(home, container, notify, self.making, lambda: self.gives_up)
        self.versions = Versions(home.path / "versions")
        self.measuring = measuring_process()
        self._notify = notify
        self._datasets: dict[str, DatasetEntry] = {}
        self._checksums: dict[str, str] = {}
        self._truths: dict[str, GroundTruthPoses | None] = {}
        self._findings: dict[str, list[OpenFinding]] = {}
        self._failed: dict[str, str] = {}
        self._locks: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()

    def dataset(self, name: str) -> DatasetEntry:
        """Return a dataset ready for use; a synthetic one is generated if need be.

        Raises:
            InputError: it can't be used.
            SystemFault: it can't be generated right now.
        """
        place = self.workshop.dataset(name)
        # One lock a dataset: parallel runs generate or hash it once, and runs of other datasets need not
        # wait.
        with self.lock(name):
            if name not in self._datasets:
                verb = "fetching" if place.dataset.spec.is_to_fetch else "generating"
                with self._making(f"{verb} the dataset {name} (once)", self._notify) as progress:
                    self._datasets[name] = materialise(
                        place.dataset, place.folder, self.home.folder("datasets"), progress
                    )
            return self._datasets[name]

    def checksum(self, name: str) -> str:
        """Return the hash of all of a dataset that results depend on.

        Raises:
            InputError: a file of it can't be read.
        """
        entry = self.dataset(name)
        with self.lock(name):
            if name not in self._checksums:
                hashes = self.home.folder("variants") / _HASHES
                self._checksums[name] = found = dataset_sha256(entry, hashes)
                recipe = self.recipe(name)
                if recipe is not None and self.recipe_of(found) != recipe:
                    remember(hashes / found, recipe)
            return self._checksums[name]

    def recipe(self, name: str) -> str | None:
        """Return the hash of what a dataset is generated or fetched by; None where its files are its own."""
        return made_from(self.workshop.dataset(name).dataset, self.home.path / "datasets")

    def recipe_of(self, checksum: str) -> str | None:
        """Return the `recipe` of the dataset that had a checksum here; None where nobody noted one."""
        with suppress(OSError, UnicodeDecodeError):
            return (self.home.path / "variants" / _HASHES / checksum).read_text(encoding="ascii").strip()
        return None

    def truth(self, name: str) -> GroundTruthPoses | None:
        """Return a dataset's ground truth, read once; None where it has none.

        Raises:
            InputError: it can't be read.
        """
        entry = self.dataset(name)
        with self.lock(name):
            if name not in self._truths:
                self._truths[name] = ground_truth(entry, self.home.folder("truths"))
            return self._truths[name]

    def findings(self, name: str) -> list[OpenFinding]:
        """Return the findings of a dataset: those known before, or those of a quick look.

        Raises:
            InputError: it can't be used.
        """
        entry = self.dataset(name)
        with self.lock(name):
            if name not in self._findings:
                self._findings[name] = looked_at(entry, self.home.path / FINDINGS)
            return self._findings[name]

    def lock(self, name: str) -> threading.Lock:
        """Return the lock on what is known of a dataset: finding it out may take minutes, for it alone."""
        with self._lock:
            return self._locks.setdefault(name, threading.Lock())

    def tell(self, sentence: str) -> None:
        """Pass a sentence to the caller's `notify`."""
        self._notify(sentence)

    def program(self, name: str) -> ProgramHashes:
        """Return the program of an algorithm on this machine right now.

        Raises:
            SlamHiveError: it isn't known, or can't be run here.
        """
        entry = self.workshop.algorithm(name)
        hashed = algorithm_hash(entry.algorithm.spec)
        parts = self.programs.parts(entry)
        if parts is None:
            return ProgramHashes(hashed, self.programs.digest(entry), self.programs.image_id(entry))
        digest = digest_of(parts)
        # Kept so that after an edit `slamhive run` can tell which files differ from those that ran.
        self.versions.keep(digest, parts)
        return ProgramHashes(hashed, digest)

    def provenance(self, spec: dict[str, Any], spec_hash: str, program: ProgramHashes) -> Provenance:
        """Return the provenance of a run's result.

        Args:
            spec: the run's resolved spec.
            spec_hash: its hash.
            program: its algorithm.

        Raises:
            InputError: the dataset can't be used.
        """
        checksum = self.checksum(spec["datasetRef"]["name"])
        preparer = self.preparer(spec)
        by = preparer.digest if preparer else None
        parts = (program.algorithm_hash, checksum, str(VERSION), program.environment, by)
        hashed = content_hash(spec_hash, *parts)
        return self.circumstances(spec_hash).replace(
            content_hash=hashed,
            algorithm_hash=program.algorithm_hash,
            environment=program.environment,
            image_id=program.image_id,
            dataset_sha256=checksum,
            preparation=str(VERSION),
            prepared_by=by,
        )

    def circumstances(self, spec_hash: str) -> Provenance:
        """Return the circumstances of any run on this machine."""
        return Provenance(
            spec_hash=spec_hash,
            node=platform.node(),
            cpu_model=cpu_model(),
            # No kubelet is here to keep others off a run's processors.
            machine=Machine.model_validate(machine_report(exclusive=False)),
            slamhive_version=__version__,
        )

    def tidy(self) -> None:
        """Remove variants that nothing has used for longest while they take more room than is allowed."""
        limit = os.environ.get("SLAMHIVE_VARIANTS_LIMIT", _VARIANTS_LIMIT)
        try:
            size = quantity(limit)
        except ValueError as error:
            raise InputError(f"SLAMHIVE_VARIANTS_LIMIT: {error}") from None
        evict_variants(self.home.folder("variants"), int(size))

    def attributes(self, name: str) -> dict[str, Any]:
        """Return a dataset's free attributes."""
        entry = self._datasets.get(name)
        dataset = entry.dataset if entry else self.workshop.dataset(name).dataset
        return dict(dataset.spec.known_attributes)

    @contextmanager
    def _making(self, what: str, notify: Callable[[str], None]) -> Iterator[Callable[[float], None]]:
        """Note in `making` how far something is while it is made; what is there already is not told of.

        Raises:
            GivenUp: nobody waits for it any more.
        """

        def progress(share: float) -> None:
            if self.gives_up:
                raise GivenUp(what)
            # Told when it is really made: what is there already calls nobody.
            if what not in self.making:
                notify(what)
            self.making[what] = share

        try:
            yield progress
        finally:
            self.making.pop(what, None)

    def prepare(self, spec: dict[str, Any], algorithm: Algorithm) -> Variant:
        """Return the variant of the dataset that a run's spec asks for, made when it isn't there.

        Raises:
            InputError: the dataset can't be prepared like this.
        """
        mode = algorithm.spec.mode(SensorMode(spec["sensors"]))
        name = spec["datasetRef"]["name"]
        entry = self.dataset(name)
        found = self.findings(name)
        options = InputOptions.model_validate(spec["input"])
        wanted = (entry, mode.needs, options, algorithm.spec.formats(mode), self.home.folder("variants"))
        preparer, topics = self.preparer(spec), mode.topics or ()
        what = f"preparing a recording of {name}{f' by {preparer.name}' if preparer else ''} (once)"
        with self._making(what, lambda _: None) as progress:
            if preparer is None:
                variant = prepare(*wanted, progress, topics=topics)
            else:
                variant = prepare_by_program(*wanted, preparer, progress, topics=topics)
        return replace(variant, findings=tuple(found))

    def preparer(self, spec: dict[str, Any]) -> Preparer | None:
        """Return the program that prepares the recording of a run; None where none does.

        Raises:
            InputError: the dataset has none of that name, or it can't run here.
        """
        asked = InputOptions.model_validate(spec["input"]).program
        if asked is None:
            return None
        place = self.workshop.dataset(spec["datasetRef"]["name"])
        return Preparer.of(self.home, self.programs, place, asked, self._failed)

    def require_possible(self, spec: dict[str, Any], algorithm: Algorithm) -> None:
        """Refuse a run that a finding of its dataset makes impossible.

        Raises:
            InputError: with the finding.
        """
        name = spec["datasetRef"]["name"]
        require_possible(self.dataset(name), self.findings(name), self._sensors(spec, algorithm))

    def suspicion(self, spec: dict[str, Any], algorithm: Algorithm) -> str | None:
        """Return the findings of a run's recording that its program may fail of."""
        with suppress(SlamHiveError):  # whoever prepares it says what is wrong
            return suspicion(self.findings(spec["datasetRef"]["name"]), self._sensors(spec, algorithm))
        return None

    def _sensors(self, spec: dict[str, Any], algorithm: Algorithm) -> list[str]:
        roles = algorithm.spec.mode(SensorMode(spec["sensors"])).needs
        options = InputOptions.model_validate(spec["input"])
        dataset = self.dataset(spec["datasetRef"]["name"]).dataset.spec
        return sensors_used(dataset, dataset.recorded_roles(roles, options.program), options.remap)

    def variant(self, spec: dict[str, Any], algorithm: Algorithm) -> Path:
        """Return the folder of the variant that a run's spec asks for, made or not; its dataset is there.

        Raises:
            InputError: the dataset can't be prepared like this.
        """
        mode = algorithm.spec.mode(SensorMode(spec["sensors"]))
        wanted = (
            self.dataset(spec["datasetRef"]["name"]),
            mode.needs,
            InputOptions.model_validate(spec["input"]),
            algorithm.spec.formats(mode),
            self.home.path / "variants",
        )
        preparer, topics = self.preparer(spec), mode.topics or ()
        if preparer is not None:
            return folder_by_program(*wanted, preparer, topics=topics)
        return variant_folder(*wanted, topics=topics)
