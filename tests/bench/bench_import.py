# SPDX-License-Identifier: Apache-2.0
"""Import of folders of images, in MB and images per second beside a copy of the same folder, and its memory.

Run: python tests/bench/bench_import.py
"""

from __future__ import annotations

import json
import multiprocessing
import resource
import shutil
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from slamhive.data.files.once import settle
from slamhive.data.importers import import_recording

if TYPE_CHECKING:
    from collections.abc import Callable

FRAMES, ROUNDS, SCENES = 200, 2, 8
START = 1_600_000_000 * 10**9
POSE = "T_BS: {cols: 4, rows: 4, data: [1, 0, 0, %g, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}\n"
LENS = "intrinsics: [458, 457, 367, 248]\n"
EUROC = "rate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\n" + LENS + "distortion_model: none\n"
CAMERA = """cam%d:
  T_cam_imu: [[1, 0, 0, %g], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  camera_model: pinhole
  distortion_model: equidistant
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  intrinsics: [190.9, 190.9, 254.9, 256.8]
  resolution: [512, 512]
"""
PLACED = {"px": 0.0, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}


def views(size: tuple[int, int], dtype: type = np.uint8, channels: int = 1) -> list[bytes]:
    """Return PNG files with the detail and the noise of a camera's images."""
    random, found = np.random.default_rng(1), []
    for _ in range(SCENES):
        scene = cv2.GaussianBlur(random.normal(0, 400, size), (0, 0), 6) + 110
        pixels = np.clip(scene + random.normal(0, 2, size), 0, 255).astype(dtype)
        pixels = pixels * 256 if dtype is np.uint16 else pixels
        found.append(cv2.imencode(".png", np.dstack([pixels] * channels))[1].tobytes())
    return found


def asl(folder: Path, size: tuple[int, int], dtype: type = np.uint8) -> None:
    """Write mav0 with two cameras and an IMU."""
    files = views(size, dtype)
    for n in range(2):
        place = folder / "mav0" / f"cam{n}"
        (place / "data").mkdir(parents=True)
        stamps = [START + k * 50_000_000 for k in range(FRAMES)]
        for k, stamp in enumerate(stamps):
            (place / "data" / f"{stamp}.png").write_bytes(files[k % SCENES])
        (place / "data.csv").write_text("".join(f"{stamp},{stamp}.png\n" for stamp in stamps))
    (folder / "mav0" / "imu0").mkdir()
    rows = (f"{START + k * 5_000_000},0.1,0.2,0.3,0.4,0.5,9.8\n" for k in range(10 * FRAMES))
    (folder / "mav0" / "imu0" / "data.csv").write_text("".join(rows))


def euroc(folder: Path) -> None:
    """Write a folder as EuRoC's: 752×480 of 8 bits."""
    asl(folder, (480, 752))
    for n in range(2):
        (folder / "mav0" / f"cam{n}" / "sensor.yaml").write_text(POSE % (0.1 * n) + EUROC)
    (folder / "mav0" / "imu0" / "sensor.yaml").write_text(POSE % 0)


def tum_vi(folder: Path) -> None:
    """Write a folder as TUM VI's: 512×512 of 16 bits."""
    asl(folder, (512, 512), np.uint16)
    (folder / "dso").mkdir()
    (folder / "dso" / "camchain.yaml").write_text(CAMERA % (0, 0) + CAMERA % (1, -0.1))
    (folder / "dso" / "imu_config.yaml").write_text("update_rate: 200\n")


def monado(folder: Path) -> None:
    """Write a folder as Monado's: 960×960 of 8 bits."""
    asl(folder, (960, 960))
    numbers = {"fx": 420.0, "fy": 420.0, "cx": 480.0, "cy": 480.0, "k1": 0.1, "k2": 0.0, "k3": 0.0, "k4": 0.0}
    camera = {"camera_type": "kb4", "intrinsics": numbers}
    value = {"T_imu_cam": [PLACED] * 2, "intrinsics": [camera] * 2, "resolution": [[960, 960]] * 2}
    (folder / "calibration.json").write_text(json.dumps({"value0": value}))


def tum(folder: Path) -> None:
    """Write a folder as TUM RGB-D's: 640×480 in colours and depth."""
    for name, files in (("rgb", views((480, 640), channels=3)), ("depth", views((480, 640), np.uint16))):
        (folder / name).mkdir(parents=True)
        stamps = [f"{1305031102 + k / 30:.6f}" for k in range(FRAMES)]
        for k, stamp in enumerate(stamps):
            (folder / name / f"{stamp}.png").write_bytes(files[k % SCENES])
        (folder / f"{name}.txt").write_text("".join(f"{stamp} {name}/{stamp}.png\n" for stamp in stamps))


def eth3d(folder: Path) -> None:
    """Write a folder as ETH3D's."""
    tum(folder)
    (folder / "calibration.txt").write_text("726.2 726.2 359.2 202.5\n")


def imported(source: Path, target: Path, layout: str) -> tuple[float, float]:
    """Import in a process of its own; return the time, s, and the peak of the memory, MB."""
    begin = time.perf_counter()
    import_recording(source, target, "bench", layout)
    elapsed = time.perf_counter() - begin
    return elapsed, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def copied(source: Path, target: Path) -> float:
    """Return the seconds that a copy takes, through to the disk as an import goes."""
    begin = time.perf_counter()
    shutil.copytree(source, target)
    settle(target, read_only=False)
    elapsed = time.perf_counter() - begin
    shutil.rmtree(target)
    return elapsed


def main() -> None:
    """Measure and print."""
    cases: list[tuple[str, str, Callable[[Path], None]]] = [
        ("EuRoC", "Euroc", euroc),
        ("TUM VI", "Euroc", tum_vi),
        ("Monado", "Euroc", monado),
        ("fr1_TUM RGB-D", "TumRgbd", tum),
        ("ETH3D", "TumRgbd", eth3d),
    ]
    context = multiprocessing.get_context("spawn")
    for name, layout, write in cases:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / name
            write(folder)
            files = [path for path in folder.rglob("*") if path.is_file()]
            size = sum(path.stat().st_size for path in files) / 1e6
            images = sum(path.suffix == ".png" for path in files)
            copies, times, peaks = [], [], []
            for number in range(ROUNDS):
                copies.append(copied(folder, folder.parent / "copy"))
                out = folder.parent / str(number)
                with ProcessPoolExecutor(1, mp_context=context) as pool:
                    elapsed, peak = pool.submit(imported, folder, out, layout).result()
                times.append(elapsed)
                peaks.append(peak)
                shutil.rmtree(out)
            print(
                f"{name.removeprefix('fr1_')} · {_speed(size, images, times)}; peak memory "
                f"{max(peaks):.0f} MB · a copy {_speed(size, images, copies)} · {size:.0f} MB in "
                f"{len(files)} files, best of {ROUNDS}"
            )


def _speed(size: float, images: int, times: list[float]) -> str:
    return f"{size / min(times):.0f} MB/s, {images / min(times):.0f} images/s"


if __name__ == "__main__":
    main()
