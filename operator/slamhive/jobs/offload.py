# SPDX-License-Identifier: Apache-2.0
"""Offloader: moves run folders that are archived from the results volume to object storage.

The chart's CronJob runs it.

``python3 -P -m slamhive.jobs.offload --namespace NAME --archive-url-file FILE --store FILE``: run folders
that the archive knows and no object refers to any more, older than ``--after``, the oldest first. A folder is
copied, the copy confirmed, and the folder thrown into the trash. Each of these may be done twice: who is
killed leaves nothing half done, and the next one begins with what is missing.

Where the volume is fuller than ``--full``, nothing waits: neither folders that are younger nor the trash.
``.offload.json`` on the volume says how the last one ended; the dashboard shows what it says.
"""

from __future__ import annotations

import json
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice
from typing import TYPE_CHECKING

from slamhive.data.files.erasing import erase
from slamhive.jobs.collect import (
    UID,
    duration_of,
    entries_of,
    is_untouched,
    known_now,
    read_url,
    say,
    tell_owner,
    volume_arguments,
)
from slamhive.jobs.known import archived
from slamhive.jobs.moving import copy_folder
from slamhive.jobs.program import add_store, run_program, write_aside
from slamhive.jobs.trash import OFFLOADED, outdated, throw_away
from slamhive.model.errors import DataError, SlamHiveError, sentence
from slamhive.storage.state import STATE, OffloadState, read_state
from slamhive.storage.store import ObjectStorage, StorageUnavailable, StoreSettings

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path


NOTHING_MOVED = "NothingMoved"
"""Reason where something else than the storage is in the way."""

_AT_ONCE = 16
_BATCH = 128


def main(argv: Sequence[str] | None = None) -> int:
    """Offload."""
    parser = volume_arguments("Move archived run folders to object storage.", "moved", archive=True)
    add_store(parser, required=True)
    parser.add_argument("--after", default="24h", help="what is younger stays (default: %(default)s)")
    parser.add_argument(
        "--trash", default="24h", help="how long moved folders lie in the trash (default: %(default)s)"
    )
    parser.add_argument(
        "--full",
        type=int,
        default=85,
        metavar="PERCENT",
        help="on a fuller volume younger folders go too, and the trash at once (default: %(default)s)",
    )
    options = parser.parse_args(argv)
    return run_program(lambda: _work(options))


def _work(options: argparse.Namespace) -> str:
    offloading = Offloading(options)
    try:
        offloading.run()
    except (SlamHiveError, OSError) as error:
        reason = error.reason if isinstance(error, StorageUnavailable) else NOTHING_MOVED
        told = sentence(error)
        offloading.note(told, reason)
        tell_owner(options, told, reason)
        raise
    offloading.note(None)
    return json.dumps({"v": 1, **offloading.count.as_json(), "dryRun": options.dry_run})


@dataclass
class Count:
    """Number of run folders and what became of them.

    Attributes:
        found: folders that are old enough to go.
        moved: folders that went; on a full volume younger ones among them.
        size: their bytes.
        stays: folders that can't be copied, with a sentence each in the log.
    """

    found: int = 0
    moved: int = 0
    size: int = 0
    stays: int = 0

    def as_json(self) -> dict[str, int]:
        """Return it as plain values."""
        return {"found": self.found, "moved": self.moved, "bytes": self.size, "stays": self.stays}


@dataclass
class _Batch:
    """Results of copying some folders: the sizes of those that are in the store, by UID."""

    copied: dict[str, int] = field(default_factory=dict)
    trouble: StorageUnavailable | None = None


class Offloading:
    """One walk over a results volume.

    Args:
        options: as on the command line.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self._options = options
        self._results: Path = options.root / "results"
        self._now = time.time()
        self._url = ""
        self.count = Count()

    def run(self) -> None:
        """Move what may go.

        Raises:
            InputError: settings or options can't be used.
            SystemFault: API, archive or store don't answer; what was moved until then is moved.
        """
        options = self._options
        after, rest = (duration_of(name, getattr(options, name)) for name in ("after", "trash"))
        store = ObjectStorage(StoreSettings.read(options.store, options.secret))
        self._url = store.url
        if not options.dry_run:
            self._erase_trash(0.0 if self._is_full() else rest)
        old, young = self._going(after)
        self.count.found = len(old)
        store.check()
        self._move(iter(old), store, rest, lambda: True)
        if young and self._is_full():
            say(f"the volume is more than {options.full} % full: folders younger than --after go too")
            self._move(iter(young), store, rest, self._is_full)

    def _move(
        self, uids: Iterator[str], store: ObjectStorage, rest: float, goes_on: Callable[[], bool]
    ) -> None:
        while goes_on() and (batch := list(islice(uids, _BATCH))):
            if self._options.dry_run:
                for uid in batch:
                    say(f"would move runs/{uid}")
                continue
            done = self._copy(batch, store)
            self._throw_away(done.copied, rest)
            if done.trouble is not None:
                raise done.trouble

    def note(self, problem: str | None, reason: str = NOTHING_MOVED) -> None:
        """Leave word on the volume of how it ended."""
        if self._options.dry_run:
            return
        count, before = self.count, read_state(self._results)
        goes_on = before is not None and before.problem is not None and problem is not None
        state = OffloadState(
            since=before.since if before is not None and goes_on else datetime.now(UTC),
            url=self._url,
            reason=reason,
            problem=problem,
            moved=count.moved,
            waiting=max(0, count.found - count.moved - count.stays),
            stays=count.stays,
        )
        text = state.model_dump_json(by_alias=True)
        try:
            write_aside(self._results / STATE, lambda path: path.write_text(text, encoding="utf-8"))
        except OSError as error:
            say(f"{self._results / STATE}: {error.strerror}")

    def _going(self, after: float) -> tuple[list[str], list[str]]:
        """Return the UIDs of the runs whose folders may go: those old enough and the others, oldest first."""
        entries = [
            entry
            for entry in entries_of(self._results / "runs")
            if UID.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False)
        ]
        known = known_now(self._options)
        free = [entry for entry in entries if entry.name not in known.runs | known.released]
        kept = archived(read_url(self._options.archive_url_file), [entry.name for entry in free]).kept
        aged = sorted(
            (entry.stat(follow_symlinks=False).st_mtime, entry.name) for entry in free if entry.name in kept
        )
        old: list[str] = []
        young: list[str] = []
        for _, name in aged:
            is_old = is_untouched(self._results / "runs" / name, self._now, after)
            (old if is_old else young).append(name)
        return old, young

    def _is_full(self) -> bool:
        found = os.statvfs(self._results)
        return found.f_blocks > 0 and 100 * (1 - found.f_bavail / found.f_blocks) > self._options.full

    def _copy(self, uids: Sequence[str], store: ObjectStorage) -> _Batch:
        """Copy some folders, several at a time; the first trouble with the store ends it."""
        done = _Batch()

        def copy(uid: str) -> int | SlamHiveError | None:
            if done.trouble is not None:
                return None
            try:
                return sum(file.size for file in copy_folder(self._results, uid, store).files)
            except StorageUnavailable as error:
                done.trouble = error
                return None
            except DataError as error:
                return error

        pool = ThreadPoolExecutor(_AT_ONCE)
        try:
            for uid, told in zip(uids, pool.map(copy, uids), strict=True):
                if isinstance(told, int):
                    done.copied[uid] = told
                elif told is not None:
                    self.count.stays += 1
                    say(str(told))
        finally:
            pool.shutdown(cancel_futures=True)
        return done

    def _throw_away(self, copied: dict[str, int], rest: float) -> None:
        # A run may have taken over a result meanwhile: its evaluation needs the folder on the volume.
        known = known_now(self._options).runs if copied else frozenset()
        for uid, size in copied.items():
            path = self._results / "runs" / uid
            if uid in known:
                say(f"runs/{uid} is in the storage and stays on the volume, as a run refers to it")
                self.count.found -= 1
                continue
            try:
                if rest > 0 and not self._is_full():
                    throw_away(path, self._results, self._now, OFFLOADED)
                else:
                    erase(path.rename(path.with_name(f".{uid}.removing")))
            except OSError as error:
                say(f"{path}: {error.strerror or error}")
                continue
            self.count.moved += 1
            self.count.size += size
            say(f"moved runs/{uid} ({size} bytes)")

    def _erase_trash(self, rest: float) -> None:
        for folder in outdated(self._results, self._now, rest, OFFLOADED):
            if not erase(folder):
                say(f"{folder}: can't be removed")


if __name__ == "__main__":
    sys.exit(main())
