# SPDX-License-Identifier: Apache-2.0
"""A sequence of a catalogue, fetched from an https server: real algorithms err as on its original."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "data" / "datalab"))

from serving import Site, make_certificate, serving

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.timeout(900)

ORIGINAL = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: original}
spec:
  recording:
    synthetic:
      {seed: 11, sensors: [Lidar, Imu], durationSeconds: 12, loops: 0.2, lidar: {rings: 16, columns: 360}}
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
  template: {spec: {sensors: lidar}}
  matrix:
    - {path: algorithm, values: [kiss-icp, genz-icp]}
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


def test_a_bag_of_the_catalogue_is_measured_as_its_original(home: Path, site: Site, tmp_path: Path) -> None:
    families = tmp_path / "families"
    families.mkdir()
    environment = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    environment |= {
        "SLAMHIVE_HOME": str(home),
        "SLAMHIVE_CATALOGUE": str(families),
        "SSL_CERT_FILE": str(tmp_path / "certificate.pem"),
    }

    def slamhive(*words: str) -> str:
        command = [str(Path(sys.executable).with_name("slamhive")), *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

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
    errors = {(row["algorithm"], row["dataset"]): row["ate.rmse"] for row in rows}
    assert len(errors) == 6
    for (algorithm, _), error in errors.items():
        assert error == pytest.approx(errors[algorithm, "original"], abs=1e-6)
