# SPDX-License-Identifier: Apache-2.0
"""Collection of what nothing in a home refers to: caches that no run and no catalog needs, and leftovers.

Nothing goes because something else is missing. A run folder without a record stays unless it is asked for:
its record may be in another archive, or in a backup. Where a folder of an algorithm or of runs is not where
it should be, what it may refer to stays. A folder of the home that is a link may be used by other homes, and
all in it stays. Whoever calls this is at work in the home alone; what
commands use beside that, they lock, or have used in the last ten minutes.
"""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from slamhive.data.files.fetching import is_busy
from slamhive.data.files.once import GRACE_SECONDS, last_use, leftovers, remove_free, remove_leftover
from slamhive.data.store.datasets import MANIFEST, made_folder
from slamhive.local.home.extent import DiskTally, Extent
from slamhive.local.home.removed import NOTE, leftovers_in, remove, remove_files, removed_from, run_parts
from slamhive.local.housekeeping.forgetting import is_left_behind, remove_empty
from slamhive.local.housekeeping.merging import ASIDE
from slamhive.local.programs.assets import remove_asset
from slamhive.local.programs.environments import Environments, is_whole, remove_environment
from slamhive.local.programs.unavailable import Unavailable
from slamhive.local.running.attempt import end_left_behind
from slamhive.model.base import Choice, plural
from slamhive.model.errors import SystemFault
from slamhive.model.results import IMPORTED

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator
    from pathlib import Path

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.housekeeping.forgetting import ArchivedRun

CHECKS = "check"
"""Folder of ``slamhive algorithm check``, which removes it itself unless it is killed."""
MADE = re.compile(r"(?P<name>.+)-[0-9a-f]{16}")
"""Names of folders of recordings that were generated or fetched."""
REMOVING = ".removing"
"""End of the name of what is being removed from the catalog."""

_KEY = re.compile(r"[0-9a-f]{16,64}")
_ARCHIVE = re.compile(r"[0-9a-f]{16}-.+|[0-9a-f]{64}")
_PARTIAL = re.compile(r"\.fetching-.+\.(part|at|state~?)|\.unpacked-[0-9a-f]+|\.known-sums.*~")
_ENVIRONMENT = re.compile(rb"/environments/([0-9a-f]{16})/")
_MOST = 4 << 20
_AGAIN = "made again when it is needed"


class HomeFindKind(Choice):
    """Sorts of things that are collected."""

    RUNS = "runs"
    VARIANTS = "variants"
    RECORDINGS = "recordings"
    TRUTHS = "truths"
    ENVIRONMENTS = "environments"
    ASSETS = "assets"
    CACHE = "cache"
    DOWNLOADS = "downloads"
    LEFTOVERS = "leftovers"


class HomeFind(NamedTuple):
    """Something in a home.

    Attributes:
        kind: what it is.
        path: where it is.
        goes: whether it is to go.
        why: why it goes, or stays.
        extent: what it takes, or what removing it gives back.
    """

    kind: HomeFindKind
    path: Path
    goes: bool
    why: str
    extent: Extent


@dataclass(frozen=True)
class CollectOptions:
    """Options of ``slamhive gc``: what may be removed beyond what nothing refers to.

    Attributes:
        made_again: caches that something refers to, too: they are made again when they are needed.
        unrecorded: folders of runs that no record refers to.
    """

    made_again: bool = False
    unrecorded: bool = False


@dataclass
class _Referred:
    """Prepared recordings, assets and environments that the runs of a home refer to."""

    variants: set[str] = field(default_factory=set)
    assets: set[str] = field(default_factory=set)
    environments: set[str] = field(default_factory=set)
    missing: int = 0


def survey(
    home: Home,
    workshop: Workshop,
    runs: Iterable[ArchivedRun],
    datasets: Collection[str],
    asked: CollectOptions,
) -> list[HomeFind]:
    """Return the finds beside a home's run files, datasets and archive, each with whether it may go.

    Args:
        home: the home.
        workshop: its catalog.
        runs: all runs that the archive knows.
        datasets: names of the datasets that their records refer to.
        asked: what may go beside what nothing refers to.
    """
    surveyor = _Surveyor(home, workshop, asked, time.time())
    known = {
        parts
        for run in runs
        # A relative one is a path on a cluster's volume.
        if run.source != IMPORTED and str(run.folder).startswith("/") and (parts := run_parts(run.folder))
    }
    return [
        *surveyor.runs(known),
        *surveyor.caches(HomeFindKind.VARIANTS, "a run was made from it", surveyor.referred.variants),
        *surveyor.recordings(datasets),
        *surveyor.caches(HomeFindKind.TRUTHS, "a dataset may need it", None),
        *surveyor.environments(),
        *surveyor.assets(),
        *surveyor.cache(),
        *surveyor.downloads(),
        *surveyor.leftovers(),
    ]


def collect(
    home: Home, finds: Iterable[HomeFind], step: Callable[[int], None] = lambda _: None
) -> tuple[list[HomeFind], list[HomeFind]]:
    """Remove what is to go.

    Args:
        home: the home, in which the caller is alone.
        finds: what was found.
        step: called with the number of things done so far.

    Returns:
        What was removed, and what was not as somebody works with it.

    Raises:
        SystemFault: the disk refuses.
    """
    gone: list[HomeFind] = []
    kept: list[HomeFind] = []
    for number, find in enumerate((find for find in finds if find.goes), 1):
        try:
            (gone if _remove(find) else kept).append(find)
        except OSError as error:
            raise SystemFault(f"{find.path}: {error.strerror or error}") from error
        step(number)
    remove_empty(home.path / "runs")
    return gone, kept


def _remove(find: HomeFind) -> bool:
    match find.kind:
        case HomeFindKind.VARIANTS | HomeFindKind.RECORDINGS | HomeFindKind.TRUTHS:
            return remove_free(find.path)
        case HomeFindKind.ENVIRONMENTS:
            return remove_environment(find.path)
        case HomeFindKind.ASSETS:
            return remove_asset(find.path)
        case HomeFindKind.RUNS:
            # First its files, with a note: a half of it must not pass for a run that nobody has kept yet.
            remove_files(find.path, find.extent.size)
            remove(find.path)
        case _ if find.path.name.endswith(".making") and find.path.is_dir():
            return remove_leftover(find.path)
        case _ if (find.path / NOTE).exists():
            remove_files(find.path, find.extent.size)
        case _:
            # A check that was killed may have left programs at work in it.
            if find.path.name == CHECKS:
                end_left_behind(find.path / "runs")
            remove(find.path)
    return True


class _Surveyor:
    """Looks through one home."""

    def __init__(self, home: Home, workshop: Workshop, asked: CollectOptions, now: float) -> None:
        self._home = home
        self._workshop = workshop
        self._asked = asked
        self._now = now
        self._taken, self._freed = DiskTally(), DiskTally(freed=True)
        self.referred = _Referred()

    def runs(self, known: Collection[tuple[str, str]]) -> Iterator[HomeFind]:
        """Yield run folders that no record refers to, or that a removal left half removed."""
        root = self._home.path / "runs"
        there = set()
        for folder in sorted(path for path in root.glob("*/*") if path.is_dir() and not path.is_symlink()):
            parts = folder.parts[-2], folder.parts[-1]
            there.add(parts)
            if removed_from(folder) is not None:
                if parts not in known:
                    yield self._find(HomeFindKind.RUNS, folder, "its record was removed", goes=True)
                elif leftovers_in(folder):
                    yield self._find(HomeFindKind.LEFTOVERS, folder, "a removal was interrupted", goes=True)
                continue
            # What it was made from stays with it, whether or not a record refers to it.
            self._refer(folder)
            if parts not in known:
                busy = is_left_behind(folder)
                why = "a killed slamhive may have left programs at work" if busy else "no record refers to it"
                yield self._find(HomeFindKind.RUNS, folder, why, goes=self._asked.unrecorded and not busy)
        self.referred.missing = sum(parts not in there for parts in known)

    def caches(self, kind: HomeFindKind, why: str, referred: Collection[str] | None) -> Iterator[HomeFind]:
        """Yield folders that are made once; None: nobody knows what refers to them."""
        for folder in self._folders(self._home.path / kind):
            used = referred is None or folder.name in referred
            # What can't be seen may refer to it: nothing is removed because something else is missing.
            if referred is not None and not used and self.referred.missing:
                runs = plural(self.referred.missing, "run")
                used, why = True, f"folders of {runs} are missing that may refer to it"
            yield self._made(kind, folder, why if used else None)

    def recordings(self, datasets: Collection[str]) -> Iterator[HomeFind]:
        """Yield recordings that were generated or fetched."""
        root = self._home.path / "datasets"
        current = {
            made_folder(place.dataset, root).name: place.dataset.name
            for place in self._workshop.dataset_places.values()
        }
        for folder in self._folders(root):
            match = MADE.fullmatch(folder.name)
            if match is None or (folder / MANIFEST).exists():
                continue
            why = None
            if folder.name in current:
                why = "its dataset is in the catalog"
            elif match["name"] in datasets and match["name"] not in self._workshop.dataset_places:
                why = "records refer to its dataset, which is not in the catalog"
            yield self._made(HomeFindKind.RECORDINGS, folder, why)

    def environments(self) -> Iterator[HomeFind]:
        """Yield environments of algorithms, and those that were not made to their end."""
        root = self._home.path / "environments"
        needed, doubt = self._needed_environments(root)
        for folder in self._folders(root):
            if not _KEY.fullmatch(folder.name.removesuffix(".making")):
                continue
            if not is_whole(folder):
                linked = self._linked(folder)
                yield self._find(
                    HomeFindKind.ENVIRONMENTS, folder, linked or "it was left half made", goes=not linked
                )
                continue
            why = doubt
            if folder.name in needed:
                why = "an algorithm of the catalog needs it"
            elif folder.name in self.referred.environments:
                why = "a run was made in it"
            yield self._made(HomeFindKind.ENVIRONMENTS, folder, why, recent=False)

    def assets(self) -> Iterator[HomeFind]:
        """Yield files that were fetched for algorithms."""
        named = {
            asset.sha256
            for entry in self._workshop.algorithm_entries.values()
            for asset in entry.algorithm.spec.assets
            if asset.url
        }
        doubt = self._doubt()
        for path in sorted((self._home.path / "assets").glob("*")):
            if not _KEY.fullmatch(path.name):
                continue
            why = doubt
            if path.name in named:
                why = "an algorithm of the catalog names it"
            elif path.name in self.referred.assets:
                why = "a run was made with it"
            yield self._made(HomeFindKind.ASSETS, path, why, recent=False)

    def cache(self) -> Iterator[HomeFind]:
        """Yield the files kept to start faster: large tables, and findings of recordings."""
        for pattern, why in (
            ("cache/*.npz", "it makes large tables load faster"),
            ("findings/*.json", "it says what is wrong with a recording without reading it again"),
        ):
            for path in sorted(self._home.path.glob(pattern)):
                if not path.name.startswith("."):
                    yield self._made(HomeFindKind.CACHE, path, why, recent=False)

    def downloads(self) -> Iterator[HomeFind]:
        """Yield archives of datasets that were kept, and parts of others; what users put there is theirs."""
        for path in sorted((self._home.path / "downloads").glob("*")):
            if path.is_file() and _ARCHIVE.fullmatch(path.name):
                if self._now - path.lstat().st_mtime < GRACE_SECONDS:
                    yield self._find(
                        HomeFindKind.DOWNLOADS, path, "it was fetched in the last 10 minutes", goes=False
                    )
                else:
                    why = "it was kept: dataset add takes other sequences from it"
                    yield self._made(HomeFindKind.DOWNLOADS, path, why, recent=False)
            elif _PARTIAL.fullmatch(path.name) and not is_busy(path):
                recent = self._now - path.lstat().st_mtime < GRACE_SECONDS
                stays = self._linked(path) or ("it was fetched in the last 10 minutes" if recent else "")
                why = stays or "its fetch was interrupted"
                yield self._find(HomeFindKind.LEFTOVERS, path, why, goes=not stays)

    def leftovers(self) -> Iterator[HomeFind]:
        """Yield the finds that killed work left half made."""
        path = self._home.path
        for name in ("variants", "datasets", "truths"):
            for folder in leftovers(path / name):
                linked = self._linked(folder)
                yield self._find(
                    HomeFindKind.LEFTOVERS, folder, linked or "it was left half made", goes=not linked
                )
        patterns = (
            ".*.sqlite.*.making*",
            "cache/.dashboard-*",
            "findings/.*",
            "assets/.fetching-*",
            "datasets/*/.dataset.*",
        )
        for folder in (*path.glob(f"datasets/.*{REMOVING}"), *path.glob(f"algorithms/.*{REMOVING}")):
            yield self._find(HomeFindKind.LEFTOVERS, folder, "a removal was interrupted", goes=True)
        for file in (file for pattern in patterns for file in sorted(path.glob(pattern))):
            linked = self._linked(file)
            if file.suffix == ".lock" or is_busy(file):  # one that waits for a lock must not lose it
                continue
            if self._now - file.lstat().st_mtime >= GRACE_SECONDS:
                yield self._find(
                    HomeFindKind.LEFTOVERS, file, linked or "it was left half made", goes=not linked
                )
        if (path / ASIDE).is_dir():
            yield self._find(HomeFindKind.LEFTOVERS, path / ASIDE, "a merge was interrupted", goes=True)
        if (path / CHECKS).is_dir():
            yield self._find(HomeFindKind.LEFTOVERS, path / CHECKS, "a check was killed", goes=True)

    def _made(self, kind: HomeFindKind, path: Path, referred: str | None, *, recent: bool = True) -> HomeFind:
        """Return a find that is made again when it is needed.

        Args:
            kind: what it is.
            path: where it is.
            referred: why it is needed; None where nothing refers to it.
            recent: whether it stays when it was used just now.
        """
        if linked := self._linked(path):
            return self._find(kind, path, linked, goes=False)
        if recent and self._now - last_use(path) < GRACE_SECONDS:
            return self._find(kind, path, "it was used in the last 10 minutes", goes=False)
        if referred is None:
            return self._find(kind, path, "nothing refers to it", goes=True)
        if self._asked.made_again:
            return self._find(kind, path, f"{referred}; {_AGAIN}", goes=True)
        return self._find(kind, path, referred, goes=False)

    def _find(self, kind: HomeFindKind, path: Path, why: str, *, goes: bool) -> HomeFind:
        return HomeFind(kind, path, goes, why, (self._freed if goes else self._taken).of(path))

    def _linked(self, path: Path) -> str | None:
        """Return the reason that things in a folder of the home stay: it is a link."""
        top = self._home.path / path.relative_to(self._home.path).parts[0]
        return f"{top.name} is a link: other homes may use it" if top.is_symlink() else None

    def _folders(self, root: Path) -> list[Path]:
        if not root.is_dir():
            return []
        return sorted(path for path in root.iterdir() if path.is_dir() and not path.name.startswith("."))

    def _refer(self, folder: Path) -> None:
        """Note what a run's folder refers to."""
        run = folder / "run"
        with suppress(OSError):
            self.referred.variants.add(os.readlink(run / "dataset").rpartition("/")[2])  # noqa: PTH115
        for link in run.glob("assets/*"):
            with suppress(OSError):
                self.referred.assets.add(os.readlink(link).rpartition("/")[2])  # noqa: PTH115
        with suppress(OSError), (folder / "supervisor.json").open("rb") as file:
            self.referred.environments.update(
                found.decode() for found in _ENVIRONMENT.findall(file.read(_MOST))
            )

    def _doubt(self) -> str | None:
        """Return the reason that the catalog may lack algorithms; None where it lacks none."""
        lost = [
            entry.name
            for entry in sorted((self._home.path / "algorithms").glob("*"))
            if not (entry / "algorithm.yaml").is_file()
        ]
        if lost:
            return f"the folder of algorithm {lost[0]} is missing, which may need it"
        missing = self.referred.missing
        return f"folders of {plural(missing, 'run')} are missing that may refer to it" if missing else None

    def _needed_environments(self, root: Path) -> tuple[set[str], str | None]:
        """Return the environments that the catalog needs, and why it may need others."""
        environments, doubt = Environments(root), self._doubt()
        needed: set[str] = set()
        for entry in self._workshop.algorithm_entries.values():
            program = entry.algorithm.spec.local
            if program is None:
                continue
            if program.command is None and not (entry.folder / program.requirements).is_file():
                doubt = doubt or f"{program.requirements} of algorithm {entry.name} is missing"
                continue
            with suppress(Unavailable):  # no interpreter here: what it was made for can't be run
                needed.update(folder.name for folder in environments.folders_of(entry))
        return needed, doubt
