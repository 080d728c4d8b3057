# SPDX-License-Identifier: Apache-2.0
"""Run folders to object storage, beside a plain copy by the store's own client, and back on a page.

Run: python tests/bench/bench_offload.py
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import uuid
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "storage"))

import boto3
from buckets import KEYS

from slamhive.jobs.moving import copy_folder
from slamhive.runfiles.stored import Shelf
from slamhive.storage.store import ObjectStorage, StoreSettings

if TYPE_CHECKING:
    from collections.abc import Callable

FOLDERS = 60
FILES = {
    "output/trajectory.txt": 1 << 20,
    "usage.csv": 1 << 19,
    **{f"files/{k}.yaml": 2000 for k in range(6)},
}
AT_ONCE = 16
ROUNDS = 3
SERVER = """
import sys, threading
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
sys.stdin.read()
"""


def make_folders(results: Path) -> list[str]:
    """Make run folders and return their UIDs."""
    uids = [str(uuid.UUID(int=number)) for number in range(FOLDERS)]
    for uid in uids:
        for name, size in FILES.items():
            path = results / "runs" / uid / "pod" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(os.urandom(size))
    return uids


def plain_copy(client: Any, bucket: str, results: Path) -> None:
    """Copy all files as `aws s3 cp --recursive` does, by the library that it is made of."""
    files = [path for path in (results / "runs").rglob("*") if path.is_file()]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for _ in pool.map(
            lambda path: client.upload_file(str(path), bucket, path.relative_to(results).as_posix()), files
        ):
            pass


def copy_all(settings: StoreSettings, results: Path, uids: list[str]) -> None:
    """Copy all folders as the offloader does."""
    store = ObjectStorage(settings)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for _ in pool.map(lambda uid: copy_folder(results, uid, store), uids):
            pass


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Return wall and CPU seconds of this process."""
    before, began = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    work()
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_SELF)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def shown(name: str, measured: list[tuple[float, float]]) -> str:
    """Return a rate and what it cost: of the fastest and the cheapest round."""
    wall, cpu = (min(column) for column in zip(*measured, strict=True))
    return f"{name}: {FOLDERS / wall:.1f} folders/s, {1000 * cpu / FOLDERS:.0f} ms of CPU each"


def main() -> None:
    """Measure."""
    with tempfile.TemporaryDirectory() as name:
        results = Path(name) / "results"
        uids = make_folders(results)
        megabytes = sum(FILES.values()) / 1e6
        words = [sys.executable, "-c", SERVER]
        with subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as server:
            assert server.stdout is not None
            endpoint = f"http://127.0.0.1:{server.stdout.readline().strip()}"
            client = boto3.client("s3", endpoint_url=endpoint, **KEYS)
            options = {"key": "k", "secret": "s", "endpoint_url": endpoint}
            ours: list[tuple[float, float]] = []
            theirs: list[tuple[float, float]] = []
            for number in range(ROUNDS):
                for bucket in (f"plain-{number}", f"ours-{number}"):
                    client.create_bucket(Bucket=bucket)
                theirs.append(timed(lambda at=number: plain_copy(client, f"plain-{at}", results)))
                settings = StoreSettings(url=f"s3://ours-{number}/lab", options=options)
                ours.append(timed(lambda given=settings: copy_all(given, results, uids)))
            what = f"{FOLDERS} run folders of {len(FILES)} files, {megabytes:.1f} MB, to S3"
            print(f"{what} · {shown('offloader', ours)} · {shown('boto3, plain', theirs)}")
            print(f"{what}, cold page · {page(settings, Path(name), uids):.2f} s · 1 s over the volume's")
            server.kill()
        folder = Path(name) / "bucket"
        ours, theirs = [], []
        for _ in range(ROUNDS):
            for place in (folder, Path(name) / "plain"):
                shutil.rmtree(place, ignore_errors=True)
            folder.mkdir()
            plain = Path(name) / "plain"
            theirs.append(timed(lambda to=plain: shutil.copytree(results, to)))
            ours.append(timed(lambda: copy_all(StoreSettings(url=f"file://{folder}"), results, uids)))
        print(f"the same, to a folder · {shown('offloader', ours)} · {shown('shutil.copytree', theirs)}")


def page(settings: StoreSettings, folder: Path, uids: list[str]) -> float:
    """Return the median of the seconds that the files of a run's page take, with nothing kept before."""
    shelf = Shelf(ObjectStorage(settings), folder / "cache", 1 << 30)
    taken = []
    for uid in uids[:15]:
        began = time.perf_counter()
        place = shelf.place(("runs", uid, "pod"))
        assert place is not None
        place.bring(FILES)
        taken.append(time.perf_counter() - began)
    return sorted(taken)[len(taken) // 2]


if __name__ == "__main__":
    main()
