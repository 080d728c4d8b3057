# SPDX-License-Identifier: Apache-2.0
"""Import of folders of scans and of images with depth, in MB and files per second beside a copy, and memory.

Run: python tests/bench/bench_importing_lidar.py [GB]

With a number, KITTI scans of so many GB are imported, to see that memory doesn't grow with them.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from bench_import import copied, imported

from slamhive.data.importers.helipr import DEVICES
from slamhive.data.importers.nclt import RECORD

SCANS, IMAGES, KINDS, ROUNDS = 150, 60, 4, 2
START = 1_600_000_000 * 10**9
P = "7.1e+02 0 6.0e+02 0 0 7.1e+02 1.8e+02 0 0 0 1 0"


def scans(folder: Path, names: list[str], contents: list[bytes]) -> None:
    """Write files of a few kinds; of one kind they are links, which take no room on the disk."""
    folder.mkdir(parents=True)
    for k, name in enumerate(names):
        if k < len(contents):
            (folder / name).write_bytes(contents[k])
        else:
            os.link(folder / names[k % len(contents)], folder / name)


def clouds(points: int) -> list[bytes]:
    """Return some clouds of x, y, z, intensity."""
    random = np.random.default_rng(1)
    return [random.normal(0, 20, (points, 4)).astype("<f4").tobytes() for _ in range(KINDS)]


def nanoseconds(count: int = SCANS) -> list[str]:
    """Return names of files at 10 Hz."""
    return [f"{START + k * 10**8}.bin" for k in range(count)]


def kitti(folder: Path, count: int = SCANS) -> None:
    """Write a sequence of scans as KITTI's, of 120,000 points."""
    scans(folder / "velodyne", [f"{k:06}.bin" for k in range(count)], clouds(120_000))
    (folder / "calib.txt").write_text(f"P0: {P}\nTr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")
    (folder / "times.txt").write_text("".join(f"{0.1 * k:.6e}\n" for k in range(count)))


def mulran(folder: Path) -> None:
    """Write a sequence as MulRan's."""
    scans(folder / "Ouster", nanoseconds(), clouds(64 * 1024))
    rows = (f"{START + k * 10**7},1,0,0,0,0,1,0,0,0,0,1,0\n" for k in range(10 * SCANS))
    (folder / "global_pose.csv").write_text("".join(rows))


def helipr(folder: Path) -> None:
    """Write a sequence as HeLiPR's, of its Ouster."""
    size = DEVICES["Ouster"].dtype.itemsize
    whole = [content[: size * 80_000] * 2 for content in clouds(130_000)]
    scans(folder / "LiDAR" / "Ouster", nanoseconds(), [content[: size * 131_072] for content in whole])


def boreas(folder: Path) -> None:
    """Write a sequence as Boreas'."""
    whole = [content[: 24 * 200_000] for content in clouds(300_000)]
    scans(folder / "lidar", [f"{START // 1000 + k * 10**5}.bin" for k in range(SCANS)], whole)
    (folder / "applanix").mkdir()


def nclt(folder: Path) -> None:
    """Write a session as NCLT's."""
    whole = [content[: RECORD.itemsize * 35_000] for content in clouds(20_000)]
    scans(folder / "velodyne_sync", [f"{START // 1000 + k * 10**5}.bin" for k in range(SCANS)], whole)


def replica(folder: Path) -> None:
    """Write a scene as Replica's."""
    random = np.random.default_rng(1)
    (folder / "results").mkdir(parents=True)
    view = cv2.GaussianBlur(random.normal(110, 200, (680, 1200, 3)), (0, 0), 4).clip(0, 255).astype(np.uint8)
    depth = cv2.GaussianBlur(random.normal(20_000, 30_000, (680, 1200)), (0, 0), 9).clip(0).astype(np.uint16)
    files = {"frame{:06}.jpg": view, "depth{:06}.png": depth}
    for name, pixels in files.items():
        data = cv2.imencode(name[-4:], pixels)[1].tobytes()
        for k in range(IMAGES):
            (folder / "results" / name.format(k)).write_bytes(data)
    (folder / "traj.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" * IMAGES)


def tartanair(folder: Path) -> None:
    """Write a trajectory as TartanAir's."""
    random = np.random.default_rng(1)
    view = cv2.GaussianBlur(random.normal(110, 200, (480, 640, 3)), (0, 0), 4).clip(0, 255).astype(np.uint8)
    for place in ("image_left", "image_right", "depth_left"):
        (folder / place).mkdir(parents=True)
    for k in range(IMAGES):
        for side in ("left", "right"):
            cv2.imwrite(str(folder / f"image_{side}" / f"{k:06}_{side}.png"), view)
        np.save(folder / "depth_left" / f"{k:06}_left_depth.npy", view[:, :, 0].astype(np.float32))
    (folder / "pose_left.txt").write_text("0 0 0 0 0 0 1\n" * IMAGES)


CASES = {
    "Kitti": kitti,
    "MulRan": mulran,
    "HeLiPR": helipr,
    "Boreas": boreas,
    "Nclt": nclt,
    "Replica": replica,
    "TartanAir": tartanair,
}
"""Writers of a folder, by its layout."""


def measure(folder: Path, layout: str, rounds: int, *, with_copy: bool = True) -> None:
    """Import and copy a folder, and print the best of each."""
    files = [path for path in folder.rglob("*") if path.suffix in {".bin", ".png", ".jpg", ".npy"}]
    size = sum(path.stat().st_size for path in files) / 1e6
    copies, times, peaks = [], [], []
    context = multiprocessing.get_context("spawn")
    for number in range(rounds):
        if with_copy:
            copies.append(copied(folder, folder.parent / "copy"))
        out = folder.parent / f"out-{number}"
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            elapsed, peak = pool.submit(imported, folder, out, layout).result()
        times.append(elapsed)
        peaks.append(peak)
        shutil.rmtree(out)
    copy = f"a copy {_speed(size, len(files), copies)}, " if copies else ""
    print(
        f"{layout} · {_speed(size, len(files), times)}; peak memory {max(peaks):.0f} MB · {copy}"
        f"{size:.0f} MB in {len(files)} files, best of {rounds}",
        flush=True,
    )


def main() -> None:
    """Measure and print."""
    if len(sys.argv) > 1:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / "folder"
            kitti(folder, round(float(sys.argv[1]) * 1e9 / (120_000 * 16)))
            measure(folder, "Kitti", 1, with_copy=False)
        return
    for layout, write in CASES.items():
        with tempfile.TemporaryDirectory() as temporary:
            write(Path(temporary) / "folder")
            measure(Path(temporary) / "folder", layout, ROUNDS)


def _speed(size: float, files: int, times: list[float]) -> str:
    return f"{size / min(times):.0f} MB/s, {files / min(times):.0f} files/s"


if __name__ == "__main__":
    main()
