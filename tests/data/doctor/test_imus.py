# SPDX-License-Identifier: Apache-2.0
"""IMUs in other units, in halves, noisy, or too slow: each is named, and its repair leaves a clean stream."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.inspecting.quick import require_usable
from slamhive.data.inspecting.suggestion import suggest_dataset
from slamhive.data.recordings.repairing import open_recording
from slamhive.model.dataset import Dataset
from slamhive_eval import Trajectory

START, NS = 1_600_000_000, 10**9
DEGREE = np.pi / 180
RATE = 100
DENSITY = {"accelerometerNoise": 0.01, "gyroscopeNoise": 0.001}
TIMES = np.arange(0, 12, 1 / RATE)


def turning(axis: int, *, at_most: float) -> tuple[Any, Any]:
    """Return rates and forces of an IMU that rests for 4 s and rocks about an axis then."""
    speed = np.where(TIMES < 4, 0.0, at_most * np.sin(2 * np.pi * (TIMES - 4) / 4))
    rates = np.zeros((len(TIMES), 3))
    rates[:, axis] = speed
    angle = np.cumsum(speed) / RATE
    level = 9.81 * np.column_stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)])
    return rates, level if axis == 0 else np.tile([0.0, 0.0, 9.81], (len(TIMES), 1))


def noisy(rates: Any, forces: Any, scale: float = 1.0) -> tuple[Any, Any]:
    rng, root = np.random.default_rng(4), np.sqrt(RATE) * scale
    return (
        rates + rng.normal(0, DENSITY["gyroscopeNoise"] * root, rates.shape),
        forces + rng.normal(0, DENSITY["accelerometerNoise"] * root, forces.shape),
    )


TILTING, YAWING = noisy(*turning(0, at_most=1.0)), noisy(*turning(2, at_most=0.15))


@pytest.fixture
def recorded(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> Any:
    """Make a dataset of IMUs by topic: what each says, and every which sample of it there is."""

    def make(*, frames: float = 0.0, truth: Any = None, every: int = 1, **topics: Any) -> Any:
        path = tmp_path / "walk.bag"
        path.unlink(missing_ok=True)
        with bag_writer(path) as bag:
            for k, t in enumerate(TIMES.tolist()):
                at = round((START + t) * NS)
                for name, (rates, forces) in topics.items():
                    if k % every == 0 and rates is not None:
                        bag.imu(f"/{name}", at, "imu", rates[k], forces[k])
                if frames and k % round(RATE / frames) == 0:
                    bag.image("/left", at, "left", "mono8", np.arange(64, dtype=np.uint8).reshape(8, 8))
        sensors = {name: ("Imu", f"/{name}") for name in topics}
        spec = {}
        if truth is not None:
            poses = np.column_stack([truth.stamps, truth.positions, truth.quaternions])
            np.savetxt(tmp_path / "truth.txt", poses, fmt="%.9f")
            spec["groundTruth"] = {"file": "truth.txt", "format": "Tum", "frame": "imu"}
        return bag_entry(path, sensors | ({"left": ("Camera", "/left")} if frames else {}), **spec)

    return make


def with_spec(entry: Any, change: Any) -> Any:
    values = entry.dataset.as_json()
    change(values["spec"])
    return type(entry)(Dataset.model_validate(values), entry.root)


def repaired(entry: Any, finding: Any) -> Any:
    return with_spec(entry, lambda spec: spec.update(finding.repair))


def ours(entry: Any) -> dict[str, Any]:
    return {one.code: one for one in inspect(entry).findings if one.code.startswith("imu.")}


def yaw_truth() -> Any:
    angle = np.cumsum(turning(2, at_most=0.15)[0][:, 2]) / RATE
    zero = np.zeros_like(angle)
    quaternions = np.column_stack([zero, zero, np.sin(angle / 2), np.cos(angle / 2)])
    return Trajectory(START + TIMES, np.zeros((len(TIMES), 3)), quaternions)


@pytest.mark.parametrize(
    ("factor", "field", "words", "scale"),
    [
        ((1, 1 / 9.80665), "forceScale", "units of g", 9.80665),
        ((1, 1000 / 9.80665), "forceScale", "units of mg", 9.80665e-3),
        ((1 / DEGREE, 1), "rateScale", "deg/s by the way that gravity turns", DEGREE),
        ((DEGREE, 1), "rateScale", "radians taken for degrees", 1 / DEGREE),
        ((-1, 1), "rateScale", "are of the wrong sign by the way that gravity turns", -1),
        ((-1 / DEGREE, 1), "rateScale", "deg/s of the wrong sign", -DEGREE),
    ],
)
def test_units_and_signs_are_named_with_the_factor_that_mends_them(
    recorded: Any, factor: Any, field: str, words: str, scale: float
) -> None:
    rates, forces = TILTING
    entry = recorded(imu=(rates * factor[0], forces * factor[1]))
    (finding,) = ours(entry).values()
    assert (finding.code, finding.severity) == ("imu.sign" if scale == -1 else "imu.units", "warning")
    assert words in finding.message
    assert finding.repair["repair"]["sensors"]["imu"] == {field: pytest.approx(scale, rel=1e-5)}
    assert ours(repaired(entry, finding)) == {}
    at_once = {one.code for one in require_usable(entry.dataset, entry.root)[0]}
    assert "imu.units" in at_once or field == "rateScale", "turns take longer than a sample"


def test_slow_turns_in_degrees_need_a_truth_and_fast_ones_tell_by_themselves(recorded: Any) -> None:
    rates, forces = YAWING
    spoiled = (rates / DEGREE / 2, forces)
    # In deg/s, 0.15 rad/s are 8.6: robots turn as fast in rad/s. Without more to tell, nothing is said.
    assert ours(recorded(imu=(rates / DEGREE, forces))) == {}
    finding = ours(recorded(imu=(rates / DEGREE, forces), truth=yaw_truth()))["imu.units"]
    assert "deg/s by how far the ground truth turns" in finding.message
    assert ours(recorded(imu=YAWING, truth=yaw_truth())) == {}
    assert "deg/s by their size" in ours(recorded(imu=(spoiled[0] * 4, forces)))["imu.units"].message


def test_a_platform_that_does_turn_fast_is_left_alone(recorded: Any) -> None:
    assert ours(recorded(imu=noisy(*turning(0, at_most=14.0)))) == {}


def test_forces_without_gravity_have_no_factor(recorded: Any) -> None:
    rates, forces = TILTING
    finding = ours(recorded(imu=(rates, forces - turning(0, at_most=1.0)[1])))["imu.units"]
    assert "gravity may have been taken out" in finding.message
    assert finding.repair == {}


@pytest.mark.parametrize("nothing", [0.0, np.nan])
def test_halves_of_an_imu_are_joined(recorded: Any, nothing: float, tmp_path: Path) -> None:
    rates, forces = TILTING
    none = np.full_like(rates, nothing)
    entry = recorded(gyro=(rates, none), accel=(none, forces))
    values = {"imu": {"type": "Imu", "topic": "/gyro"}, "imu2": {"type": "Imu", "topic": "/accel"}}
    both = with_spec(entry, lambda spec: spec.update(sensors=values))
    alone = with_spec(entry, lambda spec: spec.update(sensors={"imu": values["imu"]}))
    for one in (both, alone):
        finding = ours(one)["imu.halves"]
        assert (finding.severity, finding.sensor) == ("error", "imu")
        assert finding.repair["repair"]["sensors"]["imu"] == {"forces": "/accel"}
        assert ours(repaired(one, finding)) == {}
    found = suggest_dataset([tmp_path / "walk.bag"], "walk", tmp_path)
    assert list(found.manifest["spec"]["sensors"]) == ["imu"]
    assert found.manifest["spec"]["repair"] == {"sensors": {"imu": {"forces": "/accel"}}}
    assert any("/gyro has turning rates alone" in sentence for sentence in found.missing)
    suggested = type(entry)(Dataset.model_validate(found.manifest), tmp_path)
    with open_recording(suggested.dataset, tmp_path) as recording:
        sample = recording.first("/gyro")
    assert sample.linear_acceleration.z == pytest.approx(forces[0, 2])
    assert ours(suggested) == {}


@pytest.mark.parametrize("kind", ["AccelStamped", "Vector3Stamped"])
def test_forces_of_another_type_are_a_half_too(
    kind: str, bag_writer: Any, bag_entry: Any, tmp_path: Path
) -> None:
    class Halves(bag_writer):  # type: ignore[misc]
        def forces(self, stamp: int, force: Any) -> None:
            make = {name.rsplit("/", 1)[-1]: made for name, made in self._types.items()}
            vector = make["Vector3"](*force.tolist())
            value = make["Accel"](vector, make["Vector3"](0.0, 0.0, 0.0)) if "Accel" in kind else vector
            message = make[kind](self._header("/accel", stamp, "imu"), value)
            self._write("/accel", f"geometry_msgs/msg/{kind}", stamp, message)

    rates, forces = TILTING
    with Halves(tmp_path / "walk.bag") as bag:
        for k, t in enumerate(TIMES.tolist()):
            at = round((START + t) * NS)
            bag.imu("/gyro", at, "imu", rates[k], np.zeros(3))
            bag.forces(at, forces[k])
    entry = bag_entry(tmp_path / "walk.bag", {"imu": ("Imu", "/gyro")})
    finding = ours(entry)["imu.halves"]
    assert finding.repair["repair"]["sensors"]["imu"] == {"forces": "/accel"}
    assert ours(repaired(entry, finding)) == {}
    spec = suggest_dataset([tmp_path / "walk.bag"], "walk", tmp_path).manifest["spec"]
    assert spec["repair"] == {"sensors": {"imu": {"forces": "/accel"}}}


def test_each_half_goes_with_the_forces_of_its_own_device(recorded: Any, tmp_path: Path) -> None:
    rates, forces = TILTING
    none = np.zeros_like(rates)
    recorded(
        t265_gyro=(rates, none), d435_gyro=(rates, none), d435_accel=(none, forces), t265_accel=(none, forces)
    )
    spec = suggest_dataset([tmp_path / "walk.bag"], "walk", tmp_path).manifest["spec"]
    joined = {
        spec["sensors"][name]["topic"]: repair["forces"] for name, repair in spec["repair"]["sensors"].items()
    }
    assert joined == {"/t265_gyro": "/t265_accel", "/d435_gyro": "/d435_accel"}


def test_units_are_said_once_when_a_recording_is_added(recorded: Any, tmp_path: Path) -> None:
    rates, forces = TILTING
    recorded(imu=(rates, forces / 9.80665))
    said = suggest_dataset([tmp_path / "walk.bag"], "walk", tmp_path).missing
    (sentence,) = [one for one in said if "units of g" in one]
    assert 'repair: {"sensors": {"imu": {"forceScale": 9.80665}}}' in sentence


@pytest.mark.parametrize(("half", "words"), [(0, "each turning rate"), (1, "each specific force")])
def test_an_imu_without_its_other_half_serves_no_inertial_mode(recorded: Any, half: int, words: str) -> None:
    sample = list(TILTING)
    sample[half] = np.zeros_like(sample[half])
    finding = ours(recorded(imu=tuple(sample)))["imu.zero"]
    assert (finding.severity, finding.count) == ("error", len(TIMES))
    assert words in finding.message
    assert finding.repair == {}


def test_samples_that_are_no_numbers_are_left_out(recorded: Any) -> None:
    rates, forces = TILTING
    broken = forces.copy()
    broken[[7, 9], 1] = np.nan
    entry = recorded(imu=(rates, broken))
    finding = ours(entry)["imu.finite"]
    assert (finding.severity, finding.count) == ("error", 2)
    assert finding.first == pytest.approx(START + 0.07)
    assert ours(repaired(entry, finding)) == {}


def test_what_can_not_be_judged_is_no_traceback(recorded: Any) -> None:
    rates, forces = (table.copy() for table in TILTING)
    rates[::2], forces[1::2] = np.nan, np.nan
    assert ours(recorded(imu=(rates, forces)))["imu.finite"].count == len(TIMES)
    later = yaw_truth()
    for entry in (
        recorded(imu=TILTING, truth=Trajectory(later.stamps + 1e8, later.positions, later.quaternions)),
        recorded(imu=TILTING, every=len(TIMES)),
        recorded(imu=TILTING, every=len(TIMES) - 1, frames=20.0),
    ):
        assert ours(entry).keys() <= {"imu.rate"}


def frames_and_imu(recorded: Any, every: int) -> dict[str, Any]:
    return ours(recorded(imu=TILTING, frames=20.0, every=every))


def test_frames_without_a_sample_between_them_are_counted(recorded: Any) -> None:
    assert frames_and_imu(recorded, 4) == {}
    finding = frames_and_imu(recorded, 6)["imu.rate"]
    # Samples at 16.7 Hz between frames at 20 Hz: one frame in six has none.
    assert finding.count == pytest.approx(239 / 6, abs=1)
    assert "mono-inertial" in finding.message
    assert finding.severity == "warning"


def noises(entry: Any, stated: Any) -> Iterator[Any]:
    def state(spec: Any) -> None:
        spec["sensors"]["imu"]["imu"] = stated

    return (one for one in inspect(with_spec(entry, state)).findings if one.code == "imu.noise")


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_noise_as_stated_is_no_finding(recorded: Any, scale: float) -> None:
    entry = recorded(imu=noisy(*turning(0, at_most=1.0), scale))
    assert [*noises(entry, DENSITY)] == []


def test_noise_unlike_the_stated_one_is_measured_at_rest(recorded: Any) -> None:
    entry = recorded(imu=TILTING)
    more = [*noises(entry, {name: value / 5 for name, value in DENSITY.items()})]
    assert [one.severity for one in more] == ["warning", "warning"]
    assert [one.value for one in more] == [pytest.approx(0.001, rel=0.3), pytest.approx(0.01, rel=0.3)]
    assert more[0].first == pytest.approx(START, abs=0.1)
    less = [*noises(entry, {name: value * 5 for name, value in DENSITY.items()})]
    assert [one.severity for one in less] == ["note", "note"]


def test_noise_in_motion_and_of_samples_without_any_is_not_judged(recorded: Any) -> None:
    rates, forces = turning(0, at_most=1.0)
    moving = [table[4 * RATE :] for table in noisy(rates, forces)]
    rates, forces = (np.resize(table, (len(TIMES), 3)) for table in moving)
    stated = {name: value / 100 for name, value in DENSITY.items()}
    assert [*noises(recorded(imu=(rates, forces)), stated)] == []
    assert [*noises(recorded(imu=turning(0, at_most=1.0)), DENSITY)] == []


def test_a_slow_sway_is_no_noise(recorded: Any) -> None:
    sway = 0.012 * np.sin(2 * np.pi * TIMES)[:, np.newaxis]
    entry = recorded(imu=noisy(np.tile(sway, 3), np.tile([0.0, 0.0, 9.81], (len(TIMES), 1)), 0.1))
    assert [*noises(entry, {name: value / 10 for name, value in DENSITY.items()})] == []


def test_messages_that_break_off_are_named_and_end_nothing_else(
    tmp_path: Path, bag_writer: Any, bag_entry: Any
) -> None:
    with bag_writer(tmp_path / "a.bag") as bag:
        for k in range(20):
            bag.imu("/imu", START * NS + k * 10**7, "imu", np.ones(3), np.array([0, 0, 9.81]))
    with (
        AnyReader([tmp_path / "a.bag"]) as reader,
        Writer(tmp_path / "short.bag") as writer,
    ):
        (one,) = reader.connections
        other = writer.add_connection("/imu", one.msgtype, typestore=reader.typestore)
        for _, time, raw in reader.messages():
            writer.write(other, time, raw[:100])
    report = inspect(bag_entry(tmp_path / "short.bag", {"imu": ("Imu", "/imu")}))
    assert any("100 bytes are no sensor_msgs/msg/Imu" in sentence for sentence in report.warnings)
