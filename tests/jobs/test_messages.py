# SPDX-License-Identifier: Apache-2.0
import json
from typing import Any

import numpy as np
import pytest

from slamhive.jobs.messages import MESSAGE_BYTES, described, failed
from slamhive.kube.reports import read_description, read_failure
from slamhive.model.errors import SystemFault
from slamhive.model.results import Reason

ROLES = {
    "left": "Camera",
    "right": "Camera",
    "color": "Camera",
    "depth": "DepthCamera",
    "camera": "Camera",
    "lidar": "Lidar",
    "imu": "Imu",
}


def description(sensors: int = 7, others: int = 0) -> dict[str, Any]:
    """A description of sensors whose poses and intrinsics have all their digits."""
    random = np.random.default_rng(7)

    def pose() -> list[list[float]]:
        q, _ = np.linalg.qr(random.normal(size=(3, 3)))
        return [*np.column_stack((q, random.normal(size=3))).tolist(), [0.0, 0.0, 0.0, 1.0]]

    views = {}
    for role, kind in list(ROLES.items())[:sensors]:
        view: dict[str, Any] = {"name": role, "type": kind, "topic": f"/{role}/data", "rate": 19.98765}
        view |= {"T_body_sensor": pose(), "stamp": "Sample", "timeOffset": random.normal()}
        if "Camera" in kind:
            numbers = dict(zip(("fx", "fy", "cx", "cy"), (400 + random.random(4)).tolist(), strict=True))
            coefficients = random.normal(size=5).tolist()
            view["camera"] = {"width": 752, "height": 480, "coefficients": coefficients, **numbers}
        views[role] = view
    return {
        "folder": "a" * 32,
        "format": "Rosbag1",
        "recording": "recording.bag",
        "sensors": views,
        "startTime": 1403636579.763556,
        "durationSeconds": 181.91234567891,
        "frameRate": 19.98765432101,
        "resolution": 1.0,
        "frames": 3638,
        **{key: random.bytes(32).hex() for key in ("key", "sourceSha256", "datasetSha256")},
        "sizeBytes": 123456789,
        "groundTruth": "poses",
        "T_body_frame": pose(),
        "extrinsics": {name: view["T_body_sensor"] for name, view in views.items()}
        | {f"other{k}": pose() for k in range(others)},
        "gravityAligned": True,
        "attributes": {"motion": "fast"},
        "preparationVersion": 1,
    }


def test_seven_sensors_fit_with_all_their_digits() -> None:
    given = description()
    text = described(given)
    assert len(text.encode()) <= MESSAGE_BYTES
    found = read_description(text)
    assert found is not None
    for role, view in given["sensors"].items():
        assert found.sensors[role].T_body_sensor == view["T_body_sensor"]
    assert found.T_body_frame == given["T_body_frame"]
    assert found.gravity_aligned
    assert (found.start_time, found.duration_seconds) == (1403636579.763556, 181.91234567891)


@pytest.mark.parametrize("others", [5, 12, 200])
def test_what_does_not_fit_goes_but_nothing_that_runs_need(others: int) -> None:
    given = description(others=others)
    text = described(given)
    assert len(text.encode()) <= MESSAGE_BYTES
    found = read_description(text)
    assert found is not None
    assert found.duration_seconds == given["durationSeconds"]
    for role, view in given["sensors"].items():
        held, wanted = found.sensors[role], view["T_body_sensor"]
        assert np.allclose(held.T_body_sensor, wanted, rtol=1e-11, atol=0)
        assert held.topic == view["topic"]


def test_a_description_that_is_too_long_is_a_fault() -> None:
    given = description()
    given["sensors"]["imu"]["topic"] = "/" + np.random.default_rng(1).bytes(5000).hex()
    with pytest.raises(SystemFault, match="4096"):
        described(given)


@pytest.mark.parametrize("text", ["short", "ü" * 9000, '"\\\n' * 3000, "bad \udcff name"])
def test_failures_fit_and_say_why(text: str) -> None:
    message = failed(Reason.DATASET_MISSING, text)
    assert len(message.encode()) <= MESSAGE_BYTES
    assert json.loads(message)["error"]["message"][:3] == text[:3]
    found = read_failure(message)
    assert found is not None
    assert found.reason is Reason.DATASET_MISSING
