# SPDX-License-Identifier: Apache-2.0
"""Removes from the volumes what nobody knows any more.

``python3 -P -m slamhive.jobs.collect --namespace NAME``: run folders that neither the API nor the archive
knows, and variants, ground truth, generated recordings and assets that no Dataset or Algorithm names. Nothing
younger than ``--grace`` goes, nor anything whose name is not of our making. The volumes are looked at first,
then the API, then the archive: what is made meanwhile is not seen, what is archived meanwhile is found.
A list that is not complete ends the program before it removes anything.
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
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.data.erasing import erase
from slamhive.data.once import evict, last_use, remove_free
from slamhive.jobs.known import api_lister, archived, known_by_file, known_to
from slamhive.jobs.program import arguments, run_program
from slamhive.model.base import seconds
from slamhive.model.errors import InputError, SystemFault

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Sequence

    from slamhive.jobs.known import Known

_UID = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")
_KEY = re.compile(r"[0-9a-f]{32}")
_GENERATED = re.compile(r"(?P<name>.+)-[0-9a-f]{16}")
_TRUTH = re.compile(r"(?P<name>[^.].*?)\.(txt|relations|rotations\.npy)")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_ASIDE = re.compile(r"\..+\.making|\.fetching-.+|\..+\.removing")
_EVALUATION = re.compile(r"evaluate-[0-9a-f]{20}")
_OWNER = ".slamhive-namespace"


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
    parser = arguments("Remove what neither the API nor the archive knows.")
    parser.add_argument("--namespace", required=True, help="namespace whose volumes these are")
    parser.add_argument("--archive-url-file", type=Path, help="file with the URL of the archive's database")
    parser.add_argument("--grace", default="1h", help="what is younger stays (default: %(default)s)")
    parser.add_argument("--dry-run", action="store_true", help="print what would be removed")
    parser.add_argument("--kubeconfig", help="how to reach the API (default: the pod's account)")
    parser.add_argument("--known", type=Path, help="JSON file to ask in the place of the API")
    options = parser.parse_args(argv)
    return run_program(lambda: _work(options))


def _work(options: argparse.Namespace) -> str:
    root: Path = options.root
    grace = _grace(options.grace)
    _claim(root / "results", options.namespace, dry=options.dry_run)
    finds = [*_runs(root / "results"), *_data(root / "data")]
    if options.known:
        known = known_by_file(options.known)
    else:
        known = known_to(api_lister(options.namespace, options.kubeconfig))
    if known.assets is None:
        _tell("assets stay: the account is not allowed to list algorithms")
    unknown = [find for find in finds if not _is_known(find, known)]
    now = time.time()
    old = [find for find in unknown if _is_old(find, now, grace)]
    uids = [find.name for find in old if find.kind == "runs"]
    if uids and options.archive_url_file:
        kept = archived(_url(options.archive_url_file), uids)
        old = [find for find in old if find.kind != "runs" or find.name not in kept]
    if not options.dry_run:
        _sweep(root / "data")
    removed = 0
    for find in old:
        _tell(f"{'would remove' if options.dry_run else 'removing'} {find.path}")
        removed += options.dry_run or _remove(find)
    return json.dumps({"v": 1, "found": len(finds), "removed": removed, "dryRun": options.dry_run})


def _sweep(data: Path) -> None:
    """Remove what dead preparations left half made, under their locks."""
    for folder in (data / "variants", data / "generated", data / "generated" / "truths"):
        if folder.is_dir() and not folder.is_symlink():
            evict(folder, sys.maxsize)


def _grace(text: str) -> float:
    if not re.fullmatch(r"([0-9]{1,5}(h|m|s|ms)){1,4}", text):
        raise InputError(f"--grace: {text!r} is not a duration such as 90s, 1h30m or 250ms")
    return seconds(text)


def _url(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise SystemFault(f"{path}: {error.strerror}") from None


def _claim(results: Path, namespace: str, *, dry: bool) -> None:
    """Check that the results volume is this namespace's: another one's runs would all be unknown here.

    A volume that is nobody's yet becomes this namespace's.

    Raises:
        InputError: it is another one's.
    """
    mark = results / _OWNER
    if dry and not mark.exists():
        return
    try:
        descriptor = os.open(mark, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o440)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(namespace)
    except FileExistsError:
        owner = mark.read_text(encoding="utf-8").strip()
        if owner != namespace:
            raise InputError(
                f"{results} belongs to the namespace {owner!r}, not {namespace!r}: nothing is removed. If "
                f"that changed, remove {mark}"
            ) from None


def _runs(results: Path) -> Iterator[Find]:
    for entry in _entries(results / "evaluations"):
        if _EVALUATION.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
            yield Find(Path(entry.path), "evaluations", entry.name)
    for entry in _entries(results / "runs"):
        name = entry.name
        if _UID.fullmatch(name) and entry.is_dir(follow_symlinks=False):
            yield Find(Path(entry.path), "runs", name)
        elif _ASIDE.fullmatch(name):
            yield Find(Path(entry.path), "aside", name)


def _data(data: Path) -> Iterator[Find]:
    patterns = {"variants": _KEY, "generated": _GENERATED, "groundtruth": _TRUTH, "assets": _SHA256}
    for kind, pattern in patterns.items():
        for entry in _entries(data / kind):
            found = pattern.fullmatch(entry.name)
            # What makes folders sweeps its own leftovers, under their locks.
            if kind in {"groundtruth", "assets"} and _ASIDE.fullmatch(entry.name):
                yield Find(Path(entry.path), "aside", entry.name)
            elif found is not None and not entry.is_symlink():
                yield Find(Path(entry.path), kind, found.groupdict().get("name") or entry.name)


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    if folder.is_symlink():
        return []
    try:
        with os.scandir(folder) as entries:
            return sorted(entries, key=lambda entry: entry.name)
    except FileNotFoundError:
        return []


def _is_known(find: Find, known: Known) -> bool:
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
    """Tell whether nothing in it was written lately; a time in the future is none, anybody can set it."""
    if now - last_use(find.path) < grace and find.kind in {"variants", "generated"}:
        return False
    return not any(0 <= now - stamp < grace for stamp in _stamps(find.path))


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


def _remove(find: Find) -> bool:
    """Remove something, and tell whether it is gone; what is in use stays."""
    if find.kind in {"variants", "generated"}:
        return _said(find, lambda: remove_free(find.path))
    if find.kind == "runs":
        aside = find.path.with_name(f".{find.path.name}.removing")
        return _said(find, lambda: erase(find.path.rename(aside)))
    return _said(find, lambda: erase(find.path))


def _said(find: Find, remove: Callable[[], bool]) -> bool:
    """Remove by a function; what refuses to go stops no other."""
    try:
        gone = remove()
    except OSError as error:
        _tell(f"{find.path}: {error.strerror or error}")
        return False
    if not gone:
        _tell(f"{find.path}: is in use or can't be removed")
    return gone


def _tell(sentence: str) -> None:
    print(sentence, flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
