# SPDX-License-Identifier: Apache-2.0
"""Collector: removes from the volumes what neither the API nor the archive knows any more.

The chart's CronJob runs it.

``python3 -P -m slamhive.jobs.collect --namespace NAME``: run folders that neither the API nor the archive
knows, and variants, ground truth, generated recordings and assets that no Dataset or Algorithm names. Nothing
younger than ``--grace`` goes, nor anything whose name is not of our making. The volumes are looked at first,
then the API, then the archive: what is made meanwhile is not seen, what is archived meanwhile is found.

That nobody knows a thing may also mean that who knew it is lost. So nothing is removed when a list is not
complete, when namespace or archive are not those that the volume is of (``--adopt``), or when too much would
go at once (``--force``); and run folders that nobody knows lie in the trash for a week. What is known and not
to be kept goes at once.
"""

from __future__ import annotations

import json
import os
import re
import stat
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.data.files.erasing import erase
from slamhive.data.files.once import evict, last_use, remove_free
from slamhive.jobs.known import archived, known_by_file, known_to_api, tell_cronjob
from slamhive.jobs.ownership import Owner, claim
from slamhive.jobs.program import arguments, run_program
from slamhive.jobs.trash import OFFLOADED, outdated, throw_away
from slamhive.model.base import seconds
from slamhive.model.errors import InputError, SlamHiveError, SystemFault

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Sequence

    from slamhive.jobs.known import NamesInUse

UID = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")
_KEY = re.compile(r"[0-9a-f]{32}")
_GENERATED = re.compile(r"(?P<name>.+)-[0-9a-f]{16}")
_TRUTH = re.compile(r"(?P<name>[^.].*?)\.(txt|relations|points|positions|rotations\.npy)")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_ASIDE = re.compile(r"\..+\.making|\.fetching-.+|\..+\.removing")
_EVALUATION = re.compile(r"evaluate-[0-9a-f]{20}")
_BRAKED = ("runs", "variants", "generated", "groundtruth", "assets")


@dataclass(frozen=True)
class Find:
    """Something on a volume whose name is of our making.

    Attributes:
        path: where it is.
        kind: runs, evaluations, variants, generated, groundtruth or assets; aside for what was left half
            made.
        name: what must be known for it to stay.
    """

    path: Path
    kind: str
    name: str


def main(argv: Sequence[str] | None = None) -> int:
    """Collect."""
    parser = volume_arguments("Remove what neither the API nor the archive knows.", "removed")
    parser.add_argument("--grace", default="1h", help="what is younger stays (default: %(default)s)")
    parser.add_argument(
        "--trash", default="168h", help="how long unknown run folders lie in the trash (default: %(default)s)"
    )
    parser.add_argument(
        "--most",
        type=int,
        nargs=2,
        metavar=("COUNT", "PERCENT"),
        default=(20, 20),
        help="more of a kind than so many and so many percent never go at once (default: 20 20)",
    )
    parser.add_argument("--force", action="store_true", help="remove however much is unknown")
    parser.add_argument(
        "--adopt", action="store_true", help="let this namespace and archive decide from now on"
    )
    options = parser.parse_args(argv)
    return run_program(lambda: _work(options))


def volume_arguments(description: str, done: str, *, archive: bool = False) -> argparse.ArgumentParser:
    """Return a parser with the options of programs that clean volumes.

    Args:
        description: what the program does.
        done: what becomes of files, a participle.
        archive: it needs an archive.
    """
    parser = arguments(description)
    parser.add_argument("--namespace", required=True, help="namespace whose volumes these are")
    parser.add_argument(
        "--archive-url-file", type=Path, required=archive, help="file with the URL of the archive's database"
    )
    parser.add_argument("--cronjob", help=f"CronJob that an Event is attached to when nothing is {done}")
    parser.add_argument("--dry-run", action="store_true", help=f"print what would be {done}")
    parser.add_argument("--kubeconfig", help="how to reach the API (default: the pod's account)")
    parser.add_argument("--known", type=Path, help="JSON file to ask in the place of the API")
    return parser


def _work(options: argparse.Namespace) -> str:
    try:
        return _collect(options)
    except SlamHiveError as error:
        tell_owner(options, str(error), "NothingRemoved")
        raise


def _collect(options: argparse.Namespace) -> str:
    root: Path = options.root
    grace, rest = (duration_of(name, getattr(options, name)) for name in ("grace", "trash"))
    finds = [*_runs(root / "results"), *_data(root / "data")]
    known = known_now(options)
    if known.assets is None:
        say("assets stay: the account is not allowed to list algorithms")
    now = time.time()
    old = [find for find in finds if not _is_known(find, known) and _is_old(find, now, grace)]
    released, archive = known.released, None
    if options.archive_url_file:
        uids = [find.name for find in old if find.kind == "runs" and find.name not in released]
        archive = archived(read_url(options.archive_url_file), uids)
        old = [find for find in old if find.kind != "runs" or find.name not in archive.kept]
        released |= archive.released
    owner = Owner(options.namespace, known.namespace_uid, archive.identity if archive else None)
    claim(root / "results", owner, adopt=options.adopt, dry=options.dry_run)
    doubtful = [find for find in old if find.kind != "runs" or find.name not in released]
    problem = None if options.force else _too_much(finds, doubtful, *options.most)
    if problem and not options.dry_run:
        raise InputError(problem)
    if not options.dry_run:
        _sweep(root / "data")
        for ending in ("", OFFLOADED):
            for folder in outdated(root / "results", now, rest, ending):
                _said(folder, partial(erase, folder))
    removed = 0
    for find in old:
        say(f"{'would remove' if options.dry_run else 'removing'} {find.path}")
        keep = rest > 0 and find.kind == "runs" and find.name not in released
        removed += options.dry_run or _remove(find, root / "results" if keep else None, now)
    if problem:
        say(problem)
    return json.dumps({"v": 1, "found": len(finds), "removed": removed, "dryRun": options.dry_run})


def _too_much(finds: list[Find], going: list[Find], most: int, percent: int) -> str | None:
    """Return the reason not to remove so much: the objects or archive that referred to it may be lost."""
    for kind in _BRAKED:
        count, total = (sum(find.kind == kind for find in some) for some in (going, finds))
        if count > most and 100 * count > percent * total:
            return (
                f"no object and no archive refers to {count} of {total} {kind}, more than {most} and "
                f"{percent} %: nothing is removed, as the objects or the archive may be what is missing. "
                "--dry-run lists them; to remove them, start the collector once with --force "
                "(docs/kubernetes.md, Collector)"
            )
    return None


def _sweep(data: Path) -> None:
    """Remove what dead preparations left half made, under their locks."""
    for folder in (data / "variants", data / "generated", data / "generated" / "truths"):
        if folder.is_dir() and not folder.is_symlink():
            evict(folder, sys.maxsize)


def known_now(options: argparse.Namespace) -> NamesInUse:
    """Return the names that are referred to, by the API or by the file that is asked in its place.

    Raises:
        SystemFault: there is no answer.
    """
    if options.known:
        return known_by_file(options.known)
    return known_to_api(options.namespace, options.kubeconfig)


def tell_owner(options: argparse.Namespace, message: str, reason: str) -> None:
    """Attach an Event to the CronJob that the options name, if they name one; a failure to do so is printed.

    Args:
        options: as on the command line.
        message: what happened.
        reason: the same, in one word.
    """
    if options.cronjob:
        try:
            tell_cronjob(options.namespace, options.cronjob, message, options.kubeconfig, reason=reason)
        except SystemFault as trouble:
            say(str(trouble))


def duration_of(name: str, text: str) -> float:
    """Return an option's duration in seconds.

    Raises:
        InputError: it is none.
    """
    if not re.fullmatch(r"([0-9]{1,5}(h|m|s|ms)){1,4}", text):
        raise InputError(f"--{name}: {text!r} is not a duration such as 90s, 1h30m or 250ms")
    return seconds(text)


def read_url(path: Path) -> str:
    """Return the URL of an archive that a file holds.

    Raises:
        SystemFault: the file can't be read.
    """
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise SystemFault(f"{path}: {error.strerror}") from None


def _runs(results: Path) -> Iterator[Find]:
    for entry in entries_of(results / "evaluations"):
        if _EVALUATION.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
            yield Find(Path(entry.path), "evaluations", entry.name)
    for entry in entries_of(results / "runs"):
        name = entry.name
        if UID.fullmatch(name) and entry.is_dir(follow_symlinks=False):
            yield Find(Path(entry.path), "runs", name)
        elif _ASIDE.fullmatch(name):
            yield Find(Path(entry.path), "aside", name)


def _data(data: Path) -> Iterator[Find]:
    patterns = {"variants": _KEY, "generated": _GENERATED, "groundtruth": _TRUTH, "assets": _SHA256}
    for kind, pattern in patterns.items():
        for entry in entries_of(data / kind):
            found = pattern.fullmatch(entry.name)
            # What makes folders sweeps its own leftovers, under their locks.
            if kind in {"groundtruth", "assets"} and _ASIDE.fullmatch(entry.name):
                yield Find(Path(entry.path), "aside", entry.name)
            elif found is not None and not entry.is_symlink():
                yield Find(Path(entry.path), kind, found.groupdict().get("name") or entry.name)


def entries_of(folder: Path) -> list[os.DirEntry[str]]:
    """Return the entries of a folder of a volume, by name; none where there is no such folder."""
    if folder.is_symlink():
        return []
    try:
        with os.scandir(folder) as entries:
            return sorted(entries, key=lambda entry: entry.name)
    except FileNotFoundError:
        return []


def _is_known(find: Find, known: NamesInUse) -> bool:
    match find.kind:
        case "runs":
            return find.name in known.runs
        case "variants":
            return find.name in known.variants
        case "generated" | "groundtruth":
            return find.name in known.datasets
        case "assets":
            return known.assets is None or find.name in known.assets
        case _:
            return False


def _is_old(find: Find, now: float, grace: float) -> bool:
    if now - last_use(find.path) < grace and find.kind in {"variants", "generated"}:
        return False
    return is_untouched(find.path, now, grace)


def is_untouched(path: Path, now: float, grace: float) -> bool:
    """Tell whether nothing in it was written lately; a time in the future is none, anybody can set it."""
    return not any(0 <= now - stamp < grace for stamp in _stamps(path))


def _stamps(path: Path) -> Iterator[float]:
    # Not by recursion: an algorithm may have nested folders a thousand deep.
    waiting = [str(path)]
    while waiting:
        place = waiting.pop()
        with suppress(OSError):  # gone meanwhile, locked, or a path too long to name
            status = os.lstat(place)
            yield status.st_mtime
            if stat.S_ISDIR(status.st_mode):
                with os.scandir(place) as entries:
                    waiting += [entry.path for entry in entries]


def _remove(find: Find, trash: Path | None, now: float) -> bool:
    """Remove something, and tell whether it is gone; what is in use stays.

    Args:
        find: what.
        trash: the volume in whose trash it is to lie; None: it is erased.
        now: the time, s since 1970.
    """
    path = find.path
    if trash is not None:
        return _said(path, lambda: bool(throw_away(path, trash, now)))
    if find.kind in {"variants", "generated"}:
        return _said(path, lambda: remove_free(path))
    if find.kind == "runs":
        aside = path.with_name(f".{path.name}.removing")
        return _said(path, lambda: erase(path.rename(aside)))
    return _said(path, lambda: erase(path))


def _said(path: Path, remove: Callable[[], bool]) -> bool:
    """Remove by a function; what refuses to go stops no other."""
    try:
        gone = remove()
    except OSError as error:
        say(f"{path}: {error.strerror or error}")
        return False
    if not gone:
        say(f"{path}: is in use or can't be removed")
    return gone


def say(sentence: str) -> None:
    """Print a sentence at once."""
    print(sentence, flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
