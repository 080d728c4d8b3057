# SPDX-License-Identifier: Apache-2.0
"""Program of a Job that brings run folders back from object storage, so that they can be evaluated.

``python3 -P -m slamhive.jobs.restore --store FILE``, with the request ``{"folders": ["runs/UID/POD", …]}``. A
folder that is on the volume stays as it is. One that is not is made aside, each file checked by its sum, and
renamed, so that it is whole when it is there.
"""

from __future__ import annotations

import json
import os
import sys
from typing import TYPE_CHECKING

from slamhive.data.files.erasing import erase
from slamhive.jobs.program import add_store, arguments, parse, read_request, run_program
from slamhive.jobs.requests import RestoreRequest
from slamhive.model.errors import DataError
from slamhive.storage.offloaded import folder_of
from slamhive.storage.reading import Bucket
from slamhive.storage.store import ObjectStorage, StoreSettings

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from pathlib import Path

    from slamhive.storage.offloaded import Offloaded


_MOST_TOLD = 10
_SENTENCE = 300


def main(argv: Sequence[str] | None = None) -> int:
    """Bring back what the request names."""
    parser = arguments("Bring run folders back from object storage.")
    add_store(parser, required=True)
    options = parser.parse_args(argv)
    return run_program(lambda: _work(options))


def _work(options: argparse.Namespace) -> str:
    request = parse(RestoreRequest, read_request(options.root), "request")
    bucket = Bucket(ObjectStorage(StoreSettings.read(options.store, options.secret)))
    uids = dict.fromkeys(folder.split("/")[1] for folder in request.folders)
    brought, left = 0, {}
    for uid in uids:
        try:
            brought += _bring(options.root / "results", uid, bucket)
        except DataError as error:  # one that can't be had keeps no other away
            print(error, flush=True)  # noqa: T201
            left[uid] = str(error)[:_SENTENCE]
    told = dict(list(left.items())[:_MOST_TOLD])
    return json.dumps({"v": 1, "runs": len(uids), "brought": brought, "left": told})


def _bring(results: Path, uid: str, bucket: Bucket) -> bool:
    """Have a run's folder on the volume; returns whether it was brought."""
    target = results / folder_of(uid)
    if target.is_dir() and not target.is_symlink():
        return False
    found = bucket.run(uid)
    if found is None:
        raise DataError(f"{folder_of(uid)} is neither on the results volume nor in the object storage")
    aside = target.with_name(f".{uid}.{os.urandom(6).hex()}.making")
    try:
        _fill(aside, found, bucket)
        try:
            aside.rename(target)
        except OSError:
            if not target.is_dir():
                raise
            return False  # another Job was faster
    finally:
        if aside.exists():
            erase(aside)
    print(f"brought {folder_of(uid)} ({len(found.files)} files)", flush=True)  # noqa: T201
    return True


def _fill(folder: Path, found: Offloaded, bucket: Bucket) -> None:
    folder.mkdir(parents=True)
    for file in found.files:
        path = folder / file.path
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as stream:
            for data in bucket.pieces(found.uid, file):
                stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())


if __name__ == "__main__":
    sys.exit(main())
