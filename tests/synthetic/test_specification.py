# SPDX-License-Identifier: Apache-2.0
import pytest
from pydantic import ValidationError

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


def test_every_knob_is_documented() -> None:
    schema = SyntheticRecording.model_json_schema()
    parts = [schema, *schema["$defs"].values()]
    knobs = {name: knob for part in parts for name, knob in part.get("properties", {}).items()}
    assert [name for name, knob in knobs.items() if not knob.get("description")] == []
