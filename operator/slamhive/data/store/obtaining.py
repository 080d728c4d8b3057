# SPDX-License-Identifier: Apache-2.0
"""Sequences of the catalogue as datasets: fetched, unpacked, imported, whole or not at all.

What is fetched waits in a folder of downloads until its dataset is there, so that the same call goes on after
any end. The command and the preparation of a cluster use it.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import shutil
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from slamhive.data.files.fetching import FetchProgress, WantedFile, fetch_file, one_at_a_time, require_sha256
from slamhive.data.files.https import OfflineError
from slamhive.data.files.partial import Partial, disk_words
from slamhive.data.files.publishing import publish
from slamhive.data.files.remotezip import fetch_members
from slamhive.data.files.unpacking import DamagedArchiveError, unpack
from slamhive.model.canonical import digest
from slamhive.model.catalogue import BAG
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError, SystemFault
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from slamhive.model.catalogue import CatalogueSequence, Part

SUMS = "known-sums.json"
"""File of what was fetched without a known checksum: a later fetch that differs is refused."""
_NOT_ZIP = (".tar", ".tgz", ".tar.gz", ".tar.bz2", ".tar.xz", ".7z")


@dataclass(frozen=True)
class Listener:
    """Callbacks that obtaining a sequence reports to: steps, their progress, sentences for the user.

    Attributes:
        step: Called with what is being done from now on.
        share: Called with the share of that that is done, 0 to 1.
        notify: Called with sentences for the user.
    """

    step: Callable[[str], None] = lambda _: None
    share: Callable[[float], None] = lambda _: None
    notify: Callable[[str], None] = lambda _: None


def obtain(
    sequence: CatalogueSequence,
    out: Path,
    name: str,
    downloads: Path,
    *,
    keep_archive: bool = False,
    listener: Listener | None = None,
) -> Dataset:
    """Have a sequence of the catalogue as a dataset.

    Args:
        sequence: The sequence.
        out: Folder to make: dataset.yaml, the recording, the ground truth. If it is there, it is taken.
        name: Name of the dataset.
        downloads: Folder of what is fetched, on the same disk.
        keep_archive: Whether what was fetched stays.
        listener: Who is told.

    Raises:
        InputError: A file is to be fetched by hand; the sentence says where and whereto.
        DataError: What came is damaged, or isn't what the catalogue says.
        SystemFault: The network or the disk refuses; the same call goes on.
    """
    listener = listener or Listener()
    downloads.mkdir(parents=True, exist_ok=True)
    work = downloads / f".unpacked-{digest(str(out))[:16]}"
    with one_at_a_time(work, sequence.title, FetchProgress(notify=listener.notify)):
        if not out.exists():
            shutil.rmtree(work, ignore_errors=True)  # what a killed one left
            shop = _Shop(sequence, downloads, listener)
            shop.require_manual()
            with ExitStack() as stack:
                uses = {
                    title: stack.enter_context(_FileUse(shop.place(part)))
                    for title, part in sequence.parts.items()
                    if not shop.is_by_hand(part)  # what the user put there stays, perhaps on a disk of others
                }
                try:
                    taken = {
                        title: _take(shop, title, part, work, keep_archive=keep_archive)
                        for title, part in sequence.parts.items()
                    }
                    _publish(sequence, work, out, name, listener)
                    shop.remember()
                finally:
                    shutil.rmtree(work, ignore_errors=True)
                for title, path in taken.items():
                    if path is not None and not keep_archive and uses[title].is_last():
                        Partial(path).forget()
        return _described(out)


class _FileUse:
    """Use of a fetched file, which several processes may have at a time: the last one removes it."""

    def __init__(self, place: Path) -> None:
        self._path = place.with_name(f".using-{place.name}.lock")

    def __enter__(self) -> Self:
        with disk_words(self._path.name, self._path):
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            fcntl.flock(self._descriptor, fcntl.LOCK_SH)
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)

    def is_last(self) -> bool:
        """Give it up, and tell whether nobody else has it; then nobody gets it until the end of the block."""
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


def _described(out: Path) -> Dataset:
    found = load_file(out / "dataset.yaml")[0]
    if not isinstance(found, Dataset):
        raise DataError(f"{out}: not a dataset")
    return found


def _take(shop: _Shop, title: str, part: Part, work: Path, *, keep_archive: bool) -> Path | None:
    """Fetch a part and unpack what is wanted of it.

    Returns:
        What may go when the dataset is there; None where it is the user's, or others need it.
    """
    for again in (False, True):
        path = shop.bring(title, part)
        work.mkdir(exist_ok=True)
        try:
            _bring_out(shop, part, path, work)
        except DamagedArchiveError as error:
            if again or shop.is_by_hand(part):
                raise
            shop.listener.notify(f"{error}: fetched again")
            Partial(path).forget()
        except SystemFault:
            # Another process, which found it damaged, has removed it.
            if again or shop.is_by_hand(part) or path.exists():
                raise
        else:
            break
    if shop.is_by_hand(part):
        return None
    if title in shop.sequence.shared and path.suffix != ".part" and not keep_archive:
        megabytes = path.stat().st_size / 1e6
        size = f"{megabytes / 1e3:.1f} GB" if megabytes > 1e3 else f"{megabytes:.0f} MB"
        shop.listener.notify(
            f"{part.name}, {size}, stays, as other sequences come from it; slamhive gc --all removes it"
        )
        return None
    return path


def _bring_out(shop: _Shop, part: Part, path: Path, work: Path) -> None:
    """Put what is wanted of a part's file into a folder.

    Raises:
        DamagedArchiveError: The file isn't whole.
        DataError: It has not what the catalogue says.
        SystemFault: The disk refuses.
    """
    if part.members is None:
        with disk_words(shop.sequence.title, path):
            _link(path, work / part.name)
        _require_readable(path)
        return
    shop.listener.step(f"unpacking {part.name}")
    held = max(path.stat().st_blocks * 512, 1)
    unpack(
        path,
        part.members,
        work,
        lambda done: shop.listener.share(min(done / held, 1.0)),
        title=f"{shop.sequence.title}: {part.name}",
    )


def _require_readable(path: Path) -> None:
    """Look whether a file that came as it is, and is a bag, is one to its end.

    Raises:
        DamagedArchiveError: It isn't.
    """
    if path.suffix in {".bag", ".mcap"}:
        from slamhive.data.recordings.reading import Recording, guess_format  # noqa: PLC0415 - takes a while

        try:
            Recording([path], guess_format(path)).close()
        except DataError as error:
            raise DamagedArchiveError(str(error)) from None


def _link(source: Path, target: Path) -> None:
    """Put a file, or a folder with all in it, to another place without copying what it holds.

    What lies on another disk, to which the user put a link, is linked to.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, copy_function=_link_file, dirs_exist_ok=True)
    else:
        target.unlink(missing_ok=True)
        _link_file(source, target)


def _link_file(source: str | Path, target: str | Path) -> None:
    real = Path(source).resolve()
    try:
        Path(target).hardlink_to(real)
    except OSError as error:
        if error.errno not in {errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP}:
            raise
        Path(target).symlink_to(real)


class _Shop:
    """Brings the parts of a sequence here."""

    def __init__(self, sequence: CatalogueSequence, downloads: Path, listener: Listener) -> None:
        self.sequence, self.listener = sequence, listener
        self._downloads = downloads
        self._learned: dict[str, tuple[str, int]] = {}

    def remember(self) -> None:
        """Note the checksums of what was fetched without a known one, once a dataset was made of it."""
        for url, (sha256, size) in self._learned.items():
            _KnownSums(self._downloads / SUMS).add(url, sha256, size)

    def require_manual(self) -> None:
        """Check that what is to be fetched by hand is there, before anything else is fetched.

        Raises:
            InputError: It isn't; the sentence says where to get it and where to put it.
        """
        folder = self._downloads / self.sequence.family.name
        by_hand = [part for part in self.sequence.parts.values() if part.manual is not None]
        missing = [part for part in by_hand if not (folder / part.name).exists()]
        if not missing:
            return
        for part in missing:
            (folder / part.name).parent.mkdir(parents=True, exist_ok=True)
        first, names = missing[0], ", ".join(part.name for part in missing)
        are = "are" if len(missing) > 1 else "is"
        them = "them" if len(missing) > 1 else "it" if first.how else "the file"
        how = first.how or f"log in or accept the licence at {first.manual}"
        raise InputError(
            f"{self.sequence.title}: {names} {are} to be fetched by hand: {how}, put {them} into {folder}, "
            "then give the same command again"
        )

    def is_by_hand(self, part: Part) -> bool:
        """Tell whether a part's file has to be put here by hand, or was: then it is the user's."""
        return part.url is None or self._hand_place(part).exists()

    def _hand_place(self, part: Part) -> Path:
        return self._downloads / self.sequence.family.name / part.name

    def place(self, part: Part) -> Path:
        """Return the path of a part's file once it is here."""
        if self.is_by_hand(part):
            return self._hand_place(part)
        return self._downloads / f"{digest(part.url)[:16]}-{part.name.rpartition('/')[2]}"

    def bring(self, title: str, part: Part) -> Path:
        """Return a part's file, fetched if it isn't here.

        Raises:
            DataError: It isn't what the catalogue says.
            SystemFault: It can't be had right now.
        """
        if self.is_by_hand(part):
            return self._by_hand(part)
        what = f"{self.sequence.title}: {part.name}"
        urls = [str(part.url), *part.mirrors]
        place = self.place(part)
        if place.is_file():
            return place
        known = _KnownSums(self._downloads / SUMS).get(urls[0])
        wanted = WantedFile(
            urls, what, part.sha256 or known, part.size, piece_bytes=part.piece_bytes, pieces=part.pieces
        )
        self.listener.step(f"fetching {what}")
        progress = FetchProgress(self._count, self.listener.notify)
        if part.members and title in self.sequence.shared and not part.name.lower().endswith(_NOT_ZIP):
            outer = [member.split("!")[0] for member in part.members]
            partly = fetch_members(wanted, outer, self._downloads, progress)
            if partly is not None:
                return partly
        try:
            found = fetch_file(wanted, place, progress)
        except OfflineError as error:
            raise OfflineError(
                f"{error}; where a browser gets it, put {part.name} into {self._hand_place(part).parent} and "
                "give the same command again"
            ) from None
        except DataError as error:
            if known is not None and part.sha256 is None and known in str(error):
                raise DataError(
                    f"{error}, which it had when it was fetched first: if its publisher changed it, remove "
                    f"its line from {self._downloads / SUMS}"
                ) from None
            raise
        if part.sha256 is None and known is None:
            self._learned[urls[0]] = found, place.stat().st_size
        return place

    def _count(self, held: int, total: int | None) -> None:
        if total:
            self.listener.share(held / total)

    def _by_hand(self, part: Part) -> Path:
        path = self.place(part)
        if path.is_dir():
            return path
        size = path.stat().st_size
        if part.size is not None and size != part.size:
            raise DataError(
                f"{path}: has {size:,} bytes, expected {part.size:,}: fetch it again at "
                f"{part.manual or part.url}"
            )
        if part.sha256 is not None:
            require_sha256(path, part.sha256, str(path))
        return path


def _publish(sequence: CatalogueSequence, work: Path, out: Path, name: str, listener: Listener) -> None:
    """Make the dataset of what was unpacked."""
    listener.step(f"importing {name}")
    also = {
        "catalogue": sequence.title,
        "homepage": sequence.family.homepage,
        "license": sequence.family.license,
        "attributes": dict(sequence.attributes),
        **sequence.dataset,
    }
    source = work / sequence.folder
    if sequence.family.layout != BAG:
        # OpenCV comes with importers.
        from slamhive.data.importers import ImportOptions, import_recording  # noqa: PLC0415

        if not source.exists():
            raise DataError(f"{sequence.title}: has no {sequence.folder}; it has: {_names(work)}")
        _, notes = import_recording(
            source,
            out,
            name,
            sequence.family.layout,
            options=ImportOptions(sequence=sequence.choice),
            progress=listener.share,
            also=also,
        )
        for note in notes:
            listener.notify(note)
        return
    also.setdefault("description", f"{sequence.family.title}: {sequence.name}")
    manifest = {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Dataset",
        "metadata": {"name": name},
        "spec": also,
    }
    publish(out, manifest, lambda aside: _move(sequence, also, source, aside))


def _move(sequence: CatalogueSequence, spec: Mapping[str, Any], source: Path, aside: Path) -> None:
    """Put the files that a manifest names into a folder."""
    truth = spec.get("groundTruth") or {}
    paths = [file["path"] for file in spec["recording"]["files"]] + [truth.get("file"), truth.get("times")]
    for path in filter(None, paths):
        if not (source / path).exists():
            raise DataError(f"{sequence.title}: has no {path}; it has: {_names(source)}")
        (aside / path).parent.mkdir(parents=True, exist_ok=True)
        with disk_words(sequence.title, aside / path):
            (source / path).rename(aside / path)


def _names(folder: Path) -> str:
    if not folder.is_dir():
        return "nothing"
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    return ", ".join(names[:8]) + (", …" if len(names) > 8 else "") or "nothing"


class _KnownSums:
    """Checksums of what was fetched without a known one, by address."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def get(self, url: str) -> str | None:
        """Return the checksum that an address had when it was fetched first."""
        found = self._read().get(url)
        return None if found is None else str(found["sha256"])

    def add(self, url: str, sha256: str, size: int) -> None:
        """Note what an address has."""
        with _locked(self._path):
            known = self._read()
            known[url] = {"sha256": sha256, "bytes": size, "fetched": time.strftime("%Y-%m-%d")}
            lines = ",\n".join(
                f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in sorted(known.items())
            )
            aside = self._path.with_suffix(".json~")
            aside.write_text("{\n" + lines + "\n}\n", encoding="utf-8")
            aside.replace(self._path)

    def _read(self) -> dict[str, Any]:
        try:
            known = json.loads(self._path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except ValueError as error:
            raise DataError(f"{self._path}: can't be read: {error}") from None
        return dict(known)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    descriptor = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
