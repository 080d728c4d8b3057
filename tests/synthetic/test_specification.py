# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from pydantic import ValidationError

from slamhive.data.synthetic.inertial import sample_imu
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.model.synthetic import NOMINAL_LAP_METRES, SyntheticRecording


def test_outside_names_are_camel_case_and_survive_a_round_trip() -> None:
    given = {"seed": 4, "headerOffsetSeconds": 0.01, "camera": {"exposureSeconds": 0.005}}
    spec = SyntheticRecording.model_validate(given)
    assert spec.camera.exposure_seconds == 0.005
    assert SyntheticRecording.model_validate(spec.model_dump(mode="json", by_alias=True)) == spec


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"seed": -1}, "seed"),
        ({"speeed": 1.0}, "speeed"),
        ({"sensors": ["Radar"]}, "Lidar"),
        ({"sensors": []}, "sensors"),
        ({"sensors": ["Imu", "Imu"]}, "twice"),
        ({"speed": 1.0, "durationSeconds": 20.0}, "exclude each other"),
        ({"loops": 5, "durationSeconds": 10.0}, "too short"),
        ({"camera": {"rate": 30.0, "exposureSeconds": 0.05}}, "0.0333"),
        ({"lidar": {"minRange": 4.0, "maxRange": 3.0}}, "maxRange"),
        ({"noise": float("nan")}, "noise"),
        ({"rig": "Flat"}, "'Askew', 'Euroc' or 'Mav'"),
        (
            {"scene": "Field", "sensors": ["Lidar", "Rgbd"]},
            "scene: Field has no texture for cameras, found Rgbd",
        ),
        ({"people": 21}, "people"),
        (
            {"vibration": {"spectrum": "Vehicle"}, "imu": {"rate": 100}},
            "spectrum Vehicle with up to 26.25 is",
        ),
        ({"vibration": {"minFrequency": 6.0, "maxFrequency": 4.0}}, "maxFrequency 4.0 must not be less"),
        ({"vibration": {"amplitudeMetres": 0.5}}, "amplitudeMetres"),
        ({"vibration": {}, "imu": {"rate": 19.9}}, "rate"),
        ({"vibration": {"maxFrequency": 20.0}, "imu": {"rate": 50.0}}, "a quarter of imu.rate 50"),
    ],
)
def test_wrong_input_is_refused_with_a_word_on_what_is_wrong(given: dict[str, object], word: str) -> None:
    with pytest.raises(ValidationError, match=word):
        SyntheticRecording.model_validate(given)


@pytest.mark.parametrize(
    ("given", "seconds"),
    [
        ({"durationSeconds": 30.0}, 30.0),
        ({"speed": 2.0}, 6.0 + NOMINAL_LAP_METRES / 2.0),
        ({"loops": 2, "speed": 2.0}, 6.0 + NOMINAL_LAP_METRES),
    ],
)
def test_length_follows_from_two_of_three(given: dict[str, object], seconds: float) -> None:
    spec = SyntheticRecording.model_validate(given)
    assert spec.total_seconds == pytest.approx(seconds)
    assert spec.mean_speed * spec.moving_seconds == pytest.approx(spec.loops * NOMINAL_LAP_METRES)


def test_attributes_are_what_can_be_plotted() -> None:
    assert SyntheticRecording(loops=2, light=0.3, speed=1.5).attributes() == {
        "loops": 2.0,
        "speed": 1.5,
        "motion": 1.0,
        "light": 0.3,
        "noise": 1.0,
        "exposureSeconds": 0.0,
        "lengthMetres": 60.6,
    }
    shaken = SyntheticRecording.model_validate({"vibration": {"amplitudeMetres": 0.003}})
    assert shaken.attributes()["vibrationMetres"] == 0.003


def test_every_knob_is_documented() -> None:
    schema = SyntheticRecording.model_json_schema()
    parts = [schema, *schema["$defs"].values()]
    knobs = {name: knob for part in parts for name, knob in part.get("properties", {}).items()}
    assert [name for name, knob in knobs.items() if not knob.get("description")] == []


def test_options_that_are_not_given_are_no_part_of_a_manifest() -> None:
    """Manifests of earlier versions, and what is made of them, stay what they were."""
    given = {"seed": 4, "sensors": ["Imu"], "durationSeconds": 30.0}
    assert not {"rig", "vibration"} & set(SyntheticRecording.model_validate(given).as_json())


def test_what_is_generated_by_default_stays_what_it_was() -> None:
    """Kept figures of one sample; results of all earlier versions stand on them."""
    spec = SyntheticRecording(seed=5, sensors=("Imu",), loops=0.15, duration_seconds=7.0)
    trajectory = SyntheticMotion(spec)
    samples = sample_imu(spec, trajectory, np.arange(0.0, 7.0, 0.005))
    np.testing.assert_allclose(
        samples.specific_force[777], [-14.71535651, -2.087056, 11.87377008], rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(
        samples.angular_rate[777], [-0.05202802, -0.04289644, 0.13315942], rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(
        trajectory.at([3.885]).position, [[3.38980034, 2.99442285, 1.21607525]], rtol=0, atol=1e-8
    )
