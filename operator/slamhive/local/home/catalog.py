# SPDX-License-Identifier: Apache-2.0
"""The algorithms and datasets that a workstation knows.

In the order in which a later one replaces an earlier one: those that come with slamhive, those
added to the home, those in the files of a command.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from slamhive.local.home.folder import Home
    from slamhive.model.loading import Kind


_Known = TypeVar("_Known")


@dataclass(frozen=True)
class AlgorithmEntry:
    """An Algorithm and the folder with its files."""

    algorithm: Algorithm
    folder: Path

    @property
    def name(self) -> str:
        """Return the algorithm's name."""
        return self.algorithm.name


@dataclass(frozen=True)
class DatasetPlace:
    """A Dataset and the folder that its paths start from."""

    dataset: Dataset
    folder: Path


@dataclass
class Workshop:
    """All that is known by name."""

    algorithm_entries: dict[str, AlgorithmEntry] = field(default_factory=dict)
    dataset_places: dict[str, DatasetPlace] = field(default_factory=dict)

    @property
    def algorithms(self) -> Mapping[str, Algorithm]:
        """Return the algorithms by name."""
        return {name: entry.algorithm for name, entry in self.algorithm_entries.items()}

    @property
    def datasets(self) -> Mapping[str, Dataset]:
        """Return the datasets by name."""
        return {name: place.dataset for name, place in self.dataset_places.items()}

    def algorithm(self, name: str) -> AlgorithmEntry:
        """Return an algorithm.

        Raises:
            UnknownNameError: there is none of that name.
        """
        return _named("algorithm", name, self.algorithm_entries)

    def dataset(self, name: str) -> DatasetPlace:
        """Return a dataset.

        Raises:
            UnknownNameError: there is none of that name.
        """
        return _named("dataset", name, self.dataset_places)

    def add(self, objects: Iterable[Kind], folder: Path) -> None:
        """Take in the Algorithms and Datasets among objects; their paths start from the folder."""
        for item in objects:
            if isinstance(item, Algorithm):
                self.algorithm_entries[item.name] = AlgorithmEntry(item, folder)
            elif isinstance(item, Dataset):
                self.dataset_places[item.name] = DatasetPlace(item, folder)


def _named(kind: str, name: str, known: Mapping[str, _Known]) -> _Known:
    if name not in known:
        raise UnknownNameError(kind, name, known)
    return known[name]


@cache
def bundled(name: str) -> Path:
    """Return a folder that comes with slamhive: ``algorithms``, ``examples``, ``crds`` or ``schemas``."""
    package = Path(__file__).resolve().parents[2]
    in_wheel = package / "_bundled" / name
    if in_wheel.is_dir():
        return in_wheel
    checkout = package.parent.parent
    return checkout / ("images/algorithms" if name == "algorithms" else name)


def editor_line(kind: str) -> str:
    """Return the first line of a manifest of a kind, by which an editor finds its schema."""
    from slamhive.model import schemas  # noqa: PLC0415 - for those who write manifests alone

    path = bundled("schemas") / schemas.file_name(kind)
    return schemas.editor_line(str(path)) if path.is_file() else ""


def load_workshop(home: Home | None = None) -> Workshop:
    """Read the catalog that comes with slamhive and the home's own.

    Raises:
        ManifestError: a file of the catalog doesn't follow the language.
    """
    workshop = Workshop()
    # The home's own come last, so that an entry there replaces the one of that name that comes with slamhive.
    _read(workshop, bundled("algorithms"), "algorithm.yaml", load=_load_bundled)
    _read(workshop, bundled("examples") / "datasets", "*.yaml", load=_load_bundled)
    if home is not None:
        _read(workshop, home.path / "algorithms", "algorithm.yaml")
        _read(workshop, home.path / "datasets", "dataset.yaml")
    return workshop


def load_datasets(home: Home) -> Mapping[str, DatasetPlace]:
    """Read the datasets of `load_workshop` alone, which takes a fifth of the time.

    Raises:
        ManifestError: a file of the catalog doesn't follow the language.
    """
    workshop = Workshop()
    _read(workshop, bundled("examples") / "datasets", "*.yaml", load=_load_bundled)
    _read(workshop, home.path / "datasets", "dataset.yaml")
    return workshop.dataset_places


def _read(
    workshop: Workshop, folder: Path, pattern: str, load: Callable[[Path], Iterable[Kind]] = load_file
) -> None:
    """Take in what the manifests of a folder declare: those in it, or one in each folder of it."""
    for path in sorted(folder.glob(pattern if "*" in pattern else f"*/{pattern}")):
        if not path.parent.name.startswith("."):  # half made, or half removed
            workshop.add(load(path), path.parent)


def _load_bundled(path: Path) -> tuple[Kind, ...]:
    """Read a manifest that comes with slamhive, again when it has changed: all take a tenth of a second."""
    found = path.stat()
    return _load_once(path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=1024)
def _load_once(path: Path, _changed: int, _size: int) -> tuple[Kind, ...]:
    return tuple(load_file(path))


def link_algorithm(folder: Path, home: Home, *, built: bool = True) -> str:
    """Link an algorithm's folder into the home, and return the algorithm's name.

    Args:
        folder: the folder.
        home: the home.
        built: whether its own program has to be there yet.

    Raises:
        InputError: it is no such folder, lacks a file, or another folder has that name.
    """
    manifest = folder / "algorithm.yaml"
    if not manifest.is_file():
        raise InputError(f"{folder}: no algorithm.yaml in it")
    algorithms = [item for item in load_file(manifest) if isinstance(item, Algorithm)]
    if len(algorithms) != 1:
        raise InputError(f"{manifest}: {len(algorithms)} Algorithms in it, expected one")
    spec = algorithms[0].spec
    wanted = spec.local.files if spec.local and (built or spec.local.command is None) else []
    wanted += [asset.path for asset in spec.assets if asset.path]
    for name in wanted:
        if not (folder / name).is_file():
            raise InputError(f"{manifest}: {folder / name} is not there")
    link = home.folder("algorithms") / algorithms[0].name
    if link.is_symlink() and link.resolve() == folder.resolve():
        return algorithms[0].name
    if link.exists() or link.is_symlink():
        raise InputError(
            f"algorithm {algorithms[0].name!r} is known already: {link}; forget it first: "
            f"slamhive algorithm remove {algorithms[0].name}"
        )
    # A link, not a copy: the next run takes an edited file as it is.
    link.symlink_to(folder.resolve(), target_is_directory=True)
    return algorithms[0].name
