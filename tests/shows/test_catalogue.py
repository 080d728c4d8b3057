# SPDX-License-Identifier: Apache-2.0
"""Sequences of catalogues, fetched from an https server: algorithms err as on the generated original."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "data" / "datalab"))

from publishing import euroc_archive, family_of, kitti_archives, tum_archive, vi_archive
from serving import Site, make_certificate, serving

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Command = Callable[..., str]

pytestmark = pytest.mark.timeout(900)

ORIGINAL = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: original}
spec:
  recording:
    synthetic:
      {seed: 11, sensors: [Lidar, Imu], durationSeconds: 9, loops: 0.15, lidar: {rings: 16, columns: 360}}
"""
SWEEP = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: named}
spec: {catalogue: test/basement_2}
---
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: show}
spec:
  template: {spec: {algorithmRef: {name: kiss-icp}, sensors: lidar}}
  matrix:
    - {path: dataset, values: [original, test-basement-2, named]}
"""


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate: apt-get install openssl")
    certificate = make_certificate(tmp_path)
    (tmp_path / "served").mkdir()
    with serving(Site(tmp_path / "served"), *certificate) as served:
        yield served


@pytest.fixture
def families(tmp_path: Path) -> Path:
    """A folder of a lab's own families."""
    folder = tmp_path / "families"
    folder.mkdir()
    return folder


@pytest.fixture
def slamhive(home: Path, families: Path, tmp_path: Path) -> Command:
    """Runs the command, which knows the families and trusts the server; returns what it prints."""
    environment = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    environment |= {
        "SLAMHIVE_HOME": str(home),
        "SLAMHIVE_CATALOGUE": str(families),
        "SSL_CERT_FILE": str(tmp_path / "certificate.pem"),
    }

    def run(*words: str) -> str:
        command = [str(Path(sys.executable).with_name("slamhive")), *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.mark.slow
def test_a_bag_of_the_catalogue_is_measured_as_its_original(
    slamhive: Command, families: Path, site: Site, tmp_path: Path
) -> None:
    (tmp_path / "original.yaml").write_text(ORIGINAL)
    slamhive("dataset", "add", "original.yaml")
    slamhive("dataset", "export", "original", "--format", "Rosbag1", "-o", "made", "--ground-truth")
    (tmp_path / "made" / "recording.bag").rename(site.folder / "exp14_basement_2.bag")
    (tmp_path / "made" / "groundtruth.txt").rename(site.folder / "exp14_basement_2_imu.txt")
    made = yaml.safe_load((tmp_path / "made" / "dataset.yaml").read_text())["spec"]
    family = {
        "name": "test",
        "title": "Bags as Hilti publishes them",
        "homepage": "https://localhost/",
        "license": "CC0-1.0",
        "cite": "Nobody",
        "layout": "Bag",
        "sensors": {"lidar": "Lidar", "imu": "Imu"},
        "parts": {"bag": {"url": f"{site.url}/{{bag}}.bag"}, "truth": {"url": f"{site.url}/{{bag}}_imu.txt"}},
        "dataset": {
            "recording": {"format": "Rosbag1", "files": [{"path": "{bag}.bag"}]},
            "sensors": made["sensors"],
            "groundTruth": {"file": "{bag}_imu.txt", "format": "Tum", "frame": "body"},
            "gravityAligned": True,
        },
        "sequences": {"basement_2": {"words": {"bag": "exp14_basement_2"}}},
    }
    (families / "test.yaml").write_text(yaml.safe_dump(family))
    slamhive("dataset", "add", "test/basement_2")
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    slamhive("run", "sweep.yaml")
    rows = json.loads(slamhive("results", "export", "--sweep", "show", "--format", "json"))
    errors = {row["dataset"]: row["ate.rmse"] for row in rows}
    assert len(errors) == 3
    assert errors == pytest.approx(dict.fromkeys(errors, errors["original"]), abs=1e-6)


HILTI = "datasets/Hilti-Research/hilti-slam-challenge-2022/resolve/main"
SYSTEMS = {"flow-odometry": "flow", "descriptor-odometry": "descriptors"}
CAMERAS = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: original}
spec:
  recording:
    synthetic:
      seed: 11
      sensors: [Stereo, Rgbd, Imu]
      durationSeconds: 8
      loops: 0.1
      depthOffsetSeconds: 0.02
      camera: {width: 240, height: 180, rate: 10}
"""
STEREO = ["lab-euroc-mh-01-easy", "lab-tum-vi-room1", "lab-kitti-00", "lab-hilti-2022-basement-2"]
RGBD = ["lab-tum-rgbd-freiburg1-xyz"]
LAYOUTS = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: layouts}
spec:
  template: {spec: {}}
"""


@pytest.mark.slow
def test_five_layouts_of_archives_are_measured_as_what_they_were_made_of(
    slamhive: Command, home: Path, families: Path, site: Site, tmp_path: Path
) -> None:
    for name, points in SYSTEMS.items():
        write_system(home / "algorithms" / name, name, points)
    (tmp_path / "original.yaml").write_text(CAMERAS)
    slamhive("dataset", "add", "original.yaml")
    made = {}
    for form in ("Euroc", "Tum", "Kitti", "Rosbag1"):
        made[form] = tmp_path / "made" / form
        slamhive("dataset", "export", "original", "--format", form, "-o", str(made[form]), "--ground-truth")
    mirrored(families, site, "tum-vi", vi_archive(made["Euroc"], tmp_path / "vi"))
    mirrored(families, site, "euroc", euroc_archive(made["Euroc"]))
    mirrored(families, site, "tum-rgbd", tum_archive(made["Tum"]))
    mirrored(families, site, "kitti", kitti_archives(made["Kitti"]))
    bag = yaml.safe_load((made["Rosbag1"] / "dataset.yaml").read_text())["spec"]
    files = {
        f"{HILTI}/rosbags/exp14_basement_2.bag": (made["Rosbag1"] / "recording.bag").read_bytes(),
        f"{HILTI}/ground_truth/exp14_basement_2_imu.txt": (made["Rosbag1"] / "groundtruth.txt").read_bytes(),
    }
    # The rig is the generated one: its topics and calibration take the place of Hilti's.
    kinds = {name: sensor["type"] for name, sensor in bag["sensors"].items()}
    mirrored(families, site, "hilti-2022", files, sensors=kinds, rig=bag["sensors"])
    for sequence in ("euroc/MH_01_easy", "tum-vi/room1", "kitti/00", "hilti-2022/basement_2"):
        slamhive("dataset", "add", f"lab-{sequence}")
    slamhive("dataset", "add", "lab-tum-rgbd/freiburg1_xyz")
    sweep = yaml.safe_load(LAYOUTS)
    data = [("stereo", name) for name in ("original", *STEREO)]
    data += [("rgbd", name) for name in ("original", *RGBD)]
    points = {f"{mode}-{name}": {"dataset": name, "sensors": mode} for mode, name in data}
    sweep["spec"]["matrix"] = [
        {"path": "algorithm", "values": [*SYSTEMS]},
        {"name": "data", "points": points},
    ]
    (tmp_path / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    slamhive("run", "sweep.yaml")
    rows = json.loads(slamhive("results", "export", "--sweep", "layouts", "--format", "json"))
    found = {(row["algorithm"], row["sensors"], row["dataset"]): row for row in rows}
    assert len(found) == len(SYSTEMS) * len(data)
    for (algorithm, mode, _), row in found.items():
        original = found[algorithm, mode, "original"]
        assert row["outcome"] == "Tracked"
        assert row["ate.rmse"] == pytest.approx(original["ate.rmse"], abs=1e-6)
        assert row["trajectory.poses"] == original["trajectory.poses"]


def write_system(folder: Path, name: str, points: str) -> None:
    """Write an algorithm that is the odometry beside these tests, by one kind of points."""
    folder.mkdir(parents=True)
    program = folder / "odometry.py"
    text = Path(__file__).with_name("odometry.py").read_text()
    program.write_text(f"#!{sys.executable}\n{text}")
    program.chmod(0o755)
    manifest = {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Algorithm",
        "metadata": {"name": name},
        "spec": {
            "local": {"command": [program.name]},
            "modes": [{"name": "stereo"}, {"name": "rgbd", "output": {"frame": "color"}}],
            "recording": ["Kitti", "Tum"],
            "parameters": {"points": {"type": "String", "default": points}},
            "output": {"frame": "left", "trajectory": {"path": "poses.txt", "format": "Kitti"}},
            "deterministic": "Yes",
        },
    }
    (folder / "algorithm.yaml").write_text(yaml.safe_dump(manifest))


def mirrored(
    families: Path,
    site: Site,
    name: str,
    files: dict[str, bytes],
    *,
    sensors: dict[str, str] | None = None,
    rig: dict[str, Any] | None = None,
) -> None:
    """Serve files under the paths of their publisher, and write the family that names them."""
    for path, content in files.items():
        (site.folder / path).parent.mkdir(parents=True, exist_ok=True)
        (site.folder / path).write_bytes(content)
    family = family_of(name)
    family["name"] = f"lab-{name}"
    for part in family["parts"].values():
        part["url"] = site.url + urlsplit(part["url"]).path
        part.pop("size", None)
        part.pop("mirrors", None)
    for row in filter(None, family["sequences"].values()):  # what is served is smaller
        row.pop("sizes", None)
        row.pop("sha256", None)
    if rig is not None:
        family |= {"sensors": sensors, "dataset": family["dataset"] | {"sensors": rig}}
    (families / f"{family['name']}.yaml").write_text(yaml.safe_dump(family))
