# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from slamhive.data.synthetic import rig
from slamhive.data.synthetic.inertial import sample_imu
from slamhive.data.synthetic.trajectory import SyntheticMotion, quaternion_from_rotation, rotation_from_euler
from slamhive.data.synthetic.world import CLEARANCE, build_world
from slamhive.model.synthetic import SyntheticRecording, SyntheticSpectrum, SyntheticVibration

STEP = 1e-4
SPEC = SyntheticRecording(seed=8, sensors=("Imu",), duration_seconds=30.0)
SHAKEN = SPEC.model_copy(update={"vibration": SyntheticVibration()})
CARRIED = [
    SPEC.model_copy(update={"vibration": SyntheticVibration(spectrum=one, amplitude_metres=0.01)})
    for one in SyntheticSpectrum
]


@pytest.mark.parametrize("spec", [SPEC, SHAKEN, *CARRIED], ids=["smooth", "shaken", "carried", "driven"])
def test_rates_are_the_derivatives_of_the_poses(spec: SyntheticRecording) -> None:
    trajectory = SyntheticMotion(spec)
    t = np.linspace(0.01, 29.99, 400)
    before, now, after = (trajectory.at(t + shift) for shift in (-STEP, 0.0, STEP))

    def slope(name: str) -> np.ndarray:
        return (getattr(after, name) - getattr(before, name)) / (2 * STEP)

    # The differences of what shakes at 25 Hz are as exact as its third derivative is small.
    near = 1e-3 if spec.vibration and spec.vibration.spectrum else 1e-5
    np.testing.assert_allclose(slope("position"), now.velocity, atol=near / 10)
    np.testing.assert_allclose(slope("velocity"), now.acceleration, atol=near)
    np.testing.assert_allclose(slope("angular_rate"), now.angular_acceleration, atol=near)
    skew = np.einsum("nji,njk->nik", now.rotation, slope("rotation"))
    np.testing.assert_allclose(skew[:, [2, 0, 1], [1, 2, 0]], now.angular_rate, atol=1e-6)


@pytest.mark.parametrize("spec", [SPEC, SHAKEN, *CARRIED], ids=["smooth", "shaken", "carried", "driven"])
@pytest.mark.parametrize("t", [np.linspace(0.0, 3.0, 50), np.linspace(27.0, 30.0, 50)])
def test_it_rests_exactly_at_both_ends(t: np.ndarray, spec: SyntheticRecording) -> None:
    motion = SyntheticMotion(spec).at(t)
    for still in (motion.velocity, motion.acceleration, motion.angular_rate, motion.angular_acceleration):
        assert not still.any()
    assert (np.ptp(motion.position, axis=0) == 0.0).all()


@pytest.mark.parametrize("loops", [1, 2])
def test_whole_laps_return_to_the_start(loops: int) -> None:
    trajectory = SyntheticMotion(SyntheticRecording(loops=loops))
    ends = trajectory.at([0.0, trajectory._moving + 6.0])
    np.testing.assert_allclose(ends.position[0], ends.position[1], atol=1e-9)
    np.testing.assert_allclose(ends.rotation[0], ends.rotation[1], atol=1e-9)
    assert trajectory.length(0.0, trajectory._moving + 6.0) == pytest.approx(30.5 * loops, rel=0.02)


def test_all_six_degrees_of_freedom_are_excited() -> None:
    motion = SyntheticMotion(SPEC).at(np.linspace(0.0, 30.0, 600))
    assert (motion.angular_rate.std(axis=0) > 0.03).all()
    assert (np.ptp(motion.position, axis=0) > 0.3).all()


@pytest.mark.parametrize("seed", range(8))
def test_the_path_keeps_clear_of_obstacles(seed: int) -> None:
    trajectory = SyntheticMotion(SyntheticRecording(seed=seed))
    path = trajectory.at(np.linspace(0.0, 30.0, 500)).position
    assert build_world(seed).distance(path).min() > CLEARANCE - 0.2


def test_quaternions_turn_as_their_rotations_do() -> None:
    rotation = rotation_from_euler(np.random.default_rng(0).uniform(-np.pi, np.pi, (200, 3)))
    x, y, z, w = quaternion_from_rotation(rotation).T
    np.testing.assert_allclose(rotation[:, 0, 0], 1 - 2 * (y * y + z * z), atol=1e-12)
    np.testing.assert_allclose(rotation[:, 1, 0], 2 * (x * y + z * w), atol=1e-12)
    np.testing.assert_allclose(rotation[:, 2, 1], 2 * (y * z + x * w), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("given", [{}, {"rig": "Euroc"}, {"rig": "Mav"}, {"vibration": {}}], ids=str)
def test_integrating_the_imu_gives_the_ground_truth(given: dict[str, object]) -> None:
    rate = 2000.0
    spec = SyntheticRecording.model_validate(SPEC.model_dump() | given)
    spec = spec.model_copy(update={"imu": SPEC.imu.model_copy(update={"rate": rate})})
    mounting = rig.imu_pose(spec)
    t = np.arange(0.0, 12.0, 1.0 / rate)
    trajectory = SyntheticMotion(spec)
    samples = sample_imu(spec.model_copy(update={"noise": 0.0}), trajectory, t)
    truth = trajectory.at(t)
    attitude = truth.rotation[0] @ mounting[:3, :3]
    position = truth.position[0] + truth.rotation[0] @ mounting[:3, 3]
    velocity = np.zeros(3)
    gyro = (samples.angular_rate[1:] + samples.angular_rate[:-1]) / 2.0
    force = (samples.specific_force[1:] + samples.specific_force[:-1]) / 2.0
    for omega, specific in zip(gyro, force, strict=True):
        half = _exponential(omega / rate / 2.0)
        acceleration = attitude @ half @ specific - [0.0, 0.0, rig.GRAVITY]
        position = position + velocity / rate + acceleration / (2.0 * rate**2)
        velocity = velocity + acceleration / rate
        attitude = attitude @ half @ half
    expected = truth.position[-1] + truth.rotation[-1] @ mounting[:3, 3]
    np.testing.assert_allclose(attitude, truth.rotation[-1] @ mounting[:3, :3], atol=1e-5)
    np.testing.assert_allclose(position, expected, atol=1e-3)


@pytest.mark.parametrize("rate", [15.0, 20.0])
@pytest.mark.parametrize("seed", [8, 23])
def test_a_vibration_changes_the_acceleration_between_frames_as_initialisation_asks(
    seed: int, rate: float
) -> None:
    """ORB-SLAM3 starts where the mean specific force of two frames differs by 0.5 m/s²."""
    given = {"seed": seed, "noise": 0.0, "imu": {"rate": 600.0}, "durationSeconds": 30.0}
    steps = {}
    for name, vibration in (("smooth", None), ("shaken", {})):
        spec = SyntheticRecording.model_validate(given | {"vibration": vibration})
        t = np.arange(5.5, 24.5, 1.0 / 600.0)
        force = sample_imu(spec, SyntheticMotion(spec), t).specific_force
        samples = round(600.0 / rate)
        means = force[: len(force) // samples * samples].reshape(-1, samples, 3).mean(axis=1)
        steps[name] = np.linalg.norm(np.diff(means, axis=0), axis=1)
    assert steps["smooth"].max() < 0.2
    assert (steps["shaken"] >= 0.5).mean() > 0.98


def test_a_vibration_is_as_large_as_asked_and_within_its_band() -> None:
    asked = {"amplitudeMetres": 0.004, "amplitudeDegrees": 0.3, "minFrequency": 3.0, "maxFrequency": 6.0}
    shaken = SyntheticRecording.model_validate({"durationSeconds": 60.0, "loops": 1, "vibration": asked})
    smooth = shaken.model_copy(update={"vibration": None})
    t = np.arange(6.0, 54.0, 0.01)
    moved, path = SyntheticMotion(shaken).at(t), SyntheticMotion(smooth).at(t)
    added = moved.position - path.position
    np.testing.assert_allclose(added.std(axis=0), 0.004, rtol=0.1)
    turned = np.einsum("nji,njk->nik", path.rotation, moved.rotation)
    angle = np.degrees(np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)))
    assert np.sqrt((angle**2).mean()) == pytest.approx(0.3 * np.sqrt(3.0), rel=0.1)
    power = np.abs(np.fft.rfft(added, axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(t), 0.01)
    inside = (frequency > 2.9) & (frequency < 6.1)
    assert (power[inside].sum(axis=0) / power.sum(axis=0) > 0.99).all()


@pytest.mark.parametrize(
    ("spectrum", "lines"),
    [
        ("Walker", [0.95, 1.9, 2.85, 3.8, 5.7, 7.6]),
        ("Vehicle", [0.8, 1.3, 1.4, 1.6, 1.7, 10.5, 11, 11.5, 12.5, 25]),
    ],
)
def test_a_carrier_shakes_at_its_own_frequencies(spectrum: str, lines: list[float]) -> None:
    vibration = {"spectrum": spectrum, "amplitudeMetres": 0.01}
    shaken = SyntheticRecording.model_validate({"durationSeconds": 70.0, "vibration": vibration})
    smooth = shaken.model_copy(update={"vibration": None})
    t = np.arange(6.0, 64.0, 0.01)
    moved, path = SyntheticMotion(shaken).at(t), SyntheticMotion(smooth).at(t)
    added = moved.position - path.position
    assert 0.01 < added[:, 2].std() < 0.0115
    power = (np.abs(np.fft.rfft(added * np.hanning(len(t))[:, None], axis=0)) ** 2).sum(axis=1)
    frequency = np.fft.rfftfreq(len(t), 0.01)
    # A carrier's own pace is within 5 % of the usual one, the same for all its lines.
    shares = [
        power[np.abs(frequency[:, None] - np.array(lines) * pace).min(axis=1) < 0.06].sum() / power.sum()
        for pace in np.linspace(0.95, 1.05, 101)
    ]
    assert max(shares) > 0.99


def test_a_walker_shakes_as_initialisation_asks() -> None:
    given = {"seed": 8, "noise": 0.0, "imu": {"rate": 600.0}, "durationSeconds": 30.0}
    given |= {"vibration": {"spectrum": "Walker", "amplitudeMetres": 0.01}}
    spec = SyntheticRecording.model_validate(given)
    force = sample_imu(spec, SyntheticMotion(spec), np.arange(5.5, 24.5, 1.0 / 600.0)).specific_force
    means = force[: len(force) // 30 * 30].reshape(-1, 30, 3).mean(axis=1)
    assert (np.linalg.norm(np.diff(means, axis=0), axis=1) >= 0.5).mean() > 0.6


def test_imu_noise_has_the_stated_densities() -> None:
    t = np.arange(0.0, 30.0, 1.0 / SPEC.imu.rate)
    trajectory = SyntheticMotion(SPEC)
    clean = sample_imu(SPEC.model_copy(update={"noise": 0.0}), trajectory, t)
    noisy = sample_imu(SPEC.model_copy(update={"noise": 3.0}), trajectory, t)
    stated = rig.sensors(SPEC.model_copy(update={"noise": 3.0}))["imu"]["imu"]
    force = noisy.specific_force - noisy.force_bias - clean.specific_force
    rate = noisy.angular_rate - noisy.rate_bias - clean.angular_rate
    assert force.std() == pytest.approx(stated["accelerometerNoise"] * np.sqrt(SPEC.imu.rate), rel=0.03)
    assert rate.std() == pytest.approx(stated["gyroscopeNoise"] * np.sqrt(SPEC.imu.rate), rel=0.03)
    steps = np.diff(noisy.rate_bias, axis=0).std() * np.sqrt(SPEC.imu.rate)
    assert steps == pytest.approx(stated["gyroscopeRandomWalk"], rel=0.03)
    assert np.abs(noisy.force_bias[0]).max() > 0.0


def test_at_rest_the_imu_feels_gravity_upwards() -> None:
    trajectory = SyntheticMotion(SPEC)
    samples = sample_imu(SPEC.model_copy(update={"noise": 0.0}), trajectory, np.array([1.0]))
    to_world = trajectory.at([1.0]).rotation[0] @ rig.imu_pose(SPEC)[:3, :3]
    np.testing.assert_allclose(to_world @ samples.specific_force[0], [0.0, 0.0, rig.GRAVITY], atol=1e-12)


def _exponential(vector: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(vector)
    x, y, z = vector
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine = np.sinc(angle / np.pi)
    return np.eye(3) + sine * skew + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * skew @ skew
