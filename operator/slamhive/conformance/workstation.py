# SPDX-License-Identifier: Apache-2.0
"""Starts on this machine, by the code that runs sweeps, in a home of their own that goes again."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slamhive.archive import Archive
from slamhive.conformance.damaging import Damage, damaged
from slamhive.conformance.executors import CheckEnd, CheckStart, read_poses
from slamhive.conformance.recordings import RECORDINGS, asked_of
from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.data.files.erasing import erase
from slamhive.local.home.catalog import Workshop
from slamhive.local.home.folder import Home
from slamhive.local.housekeeping.collecting import CHECKS
from slamhive.local.programs.cores import CorePool
from slamhive.local.programs.engines import ContainerChoice, find_engine
from slamhive.local.programs.environments import availability
from slamhive.local.programs.unavailable import Unavailable
from slamhive.local.running.attempt import end_left_behind
from slamhive.local.running.execution import RunDriver, RunOrder
from slamhive.local.running.workbench import Workbench
from slamhive.model.errors import InputError
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import Phase
from slamhive.monitor.programs.orphans import ProcessRecord
from slamhive.plan import Plan, whole_cores

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.model.algorithm import Algorithm, Mode
    from slamhive.model.results import RunRecord
    from slamhive.plan import Point

_SHARED = ("environments", "datasets", "variants", "truths", "assets")
"""Folders that are caches: what is made once for a check serves runs too, and the other way round."""
_LOOK_SECONDS = 0.02
_END_SECONDS = 20.0
"""Longest time of an interrupted start to its end: its program has 5 s."""


class CheckBench(Workbench):
    """A workbench on which a recording may lack something.

    Attributes:
        damage: what it lacks; None: nothing.
    """

    damage: Damage | None = None

    def another(self, **options: Any) -> CheckBench:
        """Return a bench for another executor of this machine, in the same home."""
        bench = CheckBench(self.home, self.workshop, self.archive, self.tell, **options)
        bench.making = self.making
        return bench

    def prepare(self, spec: dict[str, Any], algorithm: Algorithm) -> Variant:
        """Return the variant that a run's spec asks for, as damaged as is asked for."""
        variant = super().prepare(spec, algorithm)
        if self.damage is None:
            return variant
        return damaged(variant, self.damage, self.home.path / "damaged")


@contextmanager
def bench_for_checks(
    home: Home, workshop: Workshop, notify: Callable[[str], None] = lambda _: None
) -> Iterator[CheckBench]:
    """Lend a workbench whose runs and archive are removed again; only the home's one runner may ask for it.

    Args:
        home: the user's home, whose caches are used.
        workshop: the catalog.
        notify: told in a sentence of what takes long.
    """
    place = home.path / CHECKS
    _remove(place)  # a slamhive that was killed may have left it
    place.mkdir(parents=True)
    try:
        for name in _SHARED:
            (place / name).symlink_to(home.folder(name).resolve(), target_is_directory=True)
        catalog = Workshop(dict(workshop.algorithm_entries), dict(workshop.dataset_places))
        catalog.add(RECORDINGS, place)
        # Whatever archive $SLAMHIVE_ARCHIVE names: this is none of it.
        own = Home(place, f"sqlite:///{place / 'archive.sqlite'}")
        with Archive.open(own.archive_url) as archive:
            yield CheckBench(own, catalog, archive, notify)
    finally:
        _remove(place)


def _remove(place: Path) -> None:
    end_left_behind(place / "runs")
    if place.exists() and not erase(place):
        raise InputError(f"SLAMHIVE_HOME: {place}: what an earlier check left can't be removed")


class OnWorkstation:
    """Starts on this machine by the code that runs sweeps: as processes, unless the bench says otherwise.

    Args:
        bench: what they share; one for each executor.
        name: the algorithm.
        dataset: a dataset by name; None: the generated one for each mode.
        contained: whether the bench runs it as containers.
    """

    def __init__(
        self, bench: CheckBench, name: str, dataset: str | None = None, *, contained: bool = False
    ) -> None:
        self.name = "container" if contained else "process"
        self._contained = contained
        self._bench = bench
        self._algorithm = name
        self._dataset = dataset
        self._cores = CorePool(bench.home.leases)

    @classmethod
    def contained(
        cls, bench: CheckBench, name: str, dataset: str | None = None, *, pull: bool
    ) -> OnWorkstation:
        """Return the executor that starts an algorithm's image as containers of this machine.

        Args:
            bench: of the check; containers get one of their own.
            name: the algorithm.
            dataset: a dataset by name; None: the generated one for each mode.
            pull: whether an image that isn't here is pulled.

        Raises:
            Unavailable: no engine can be used, or there is no image.
            ImageMissing: the image isn't here, or can't be pulled.
        """
        entry = bench.workshop.algorithm(name)
        if entry.algorithm.spec.image is None:
            raise Unavailable("names no image (spec.image), which a container needs")
        own = bench.another(container=ContainerChoice(find_engine().name))
        if not pull:
            own.programs.containers.image_id(entry)
        own.programs.get(entry, entry.algorithm.spec.paces[0])
        return cls(own, name, dataset, contained=True)

    def unavailable(self) -> str | None:
        """Say why nothing can be started as a process here, None where it can."""
        return availability(self._bench.workshop.algorithm(self._algorithm))

    def objection(self, start: CheckStart) -> str | None:
        """Say why something can't be started like this here, None where it can."""
        if start.damage is None:
            return None
        algorithm = self._bench.workshop.algorithm(self._algorithm).algorithm
        if algorithm.spec.plays(algorithm.spec.paces[0]):
            return "a player gives it nothing of a recording that lacks a topic, or every message"
        variant = self._bench.prepare(self._point(start).spec, algorithm)
        if variant.format.is_folder:
            return f"nothing can be left out of a recording in the form {variant.format}"
        return None

    def run(self, start: CheckStart) -> CheckEnd:
        """Start the algorithm and wait for its end.

        Raises:
            SlamHiveError: it can't be started here at all.
        """
        bench, point = self._bench, self._point(start)
        order = RunOrder(
            uid=f"check-{point.name}",
            point=point,
            sweep="check",
            sweep_uid="check",
            labels={},
            settings=EvaluationSettings(),
            reuse=False,
            take_up=False,
        )
        cores = self._cores.take(whole_cores(point.spec["resources"]["cpu"])) or []
        bench.damage = start.damage
        try:
            return self._driven(order, tuple(cpu for core in cores for cpu in core), start)
        finally:
            bench.damage = None
            erase(bench.home.folder("damaged"))
            self._cores.give_back(cores)

    def _point(self, start: CheckStart) -> Point:
        sweep = asked_of(self._algorithm, start, self._dataset, self._bench.workshop)
        return Plan(sweep, self._bench.workshop).point(0)

    def _driven(self, order: RunOrder, cpus: tuple[int, ...], start: CheckStart) -> CheckEnd:
        driver = RunDriver(order, self._bench, cpus, lambda _: None)
        records: list[RunRecord] = []
        thread = threading.Thread(target=lambda: records.append(driver.drive()), daemon=True)
        folder = self._bench.home.path / "runs" / order.sweep / order.point.name
        thread.start()
        began: float | None = None
        told: float | None = None
        try:
            while thread.is_alive():
                thread.join(_LOOK_SECONDS)
                now = time.monotonic()
                if began is None and start.stop_after is not None and _runs(folder):
                    began = now
                if told is None and began is not None and now - began >= (start.stop_after or 0.0):
                    told = now
                    driver.cancel()
        except BaseException:
            driver.cancel()
            thread.join(_END_SECONDS)  # what it makes for later runs, as an environment, may take minutes
            raise
        took = None if told is None else time.monotonic() - told
        ended = _ended(records[0], driver, folder, took)
        if self._contained:
            # They are mounted read-only, where the kernel notes no reading.
            return replace(ended, settings=dict.fromkeys(ended.settings))
        return ended


def _runs(folder: Path) -> bool:
    """Tell whether the program of an attempt was started."""
    with suppress(ValueError, OSError):
        record = ProcessRecord.read(str(folder / "process.json"))
        return record is not None and record.algorithm is not None
    return False


def _ended(record: RunRecord, driver: RunDriver, folder: Path, took: float | None) -> CheckEnd:
    """Return the outcome of a start; its folder may be removed then."""
    end = driver.attempt_end()
    text, trajectory = b"", None
    if record.trajectory is not None:
        text, trajectory = read_poses(folder / "run" / "output" / "trajectory.txt")
    return CheckEnd(
        record=record,
        text=text,
        trajectory=trajectory,
        exit_code=end.exit_code if end else None,
        signal=end.signal if end else None,
        settings=opened_files(folder / "run" / SETTINGS_FOLDER),
        stop_seconds=took if record.phase is Phase.CANCELLED else None,
    )


def opened_files(folder: Path) -> dict[str, bool | None]:
    """Return the files of a folder, and whether someone has read each since it was written.

    The kernel notes the first reading of a file after it was written, unless its file system is mounted
    without that.
    """
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    if not files:
        return {}
    probe = folder.with_name("probe")
    probe.write_bytes(b"x")
    written = probe.stat()
    noted = False
    deadline = time.monotonic() + 1.0
    while not noted and time.monotonic() < deadline:  # its clock ticks a hundred times a second
        probe.read_bytes()
        noted = probe.stat().st_atime_ns > written.st_atime_ns
    probe.unlink()
    found = {}
    for path in files:
        seen = path.stat()
        found[str(path.relative_to(folder))] = seen.st_atime_ns > seen.st_mtime_ns if noted else None
    return found


def variant_of(bench: CheckBench, algorithm: str, mode: Mode, dataset: str | None) -> Variant:
    """Return the prepared recording of a mode, whole."""
    sweep = asked_of(algorithm, CheckStart(mode, timeout=1.0), dataset, bench.workshop)
    point = Plan(sweep, bench.workshop).point(0)
    return bench.prepare(point.spec, bench.workshop.algorithm(algorithm).algorithm)
