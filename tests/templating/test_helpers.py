# SPDX-License-Identifier: Apache-2.0
"""Tests of what templates have, read back by the parsers of the field: OpenCV's FileStorage and YAML."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import yaml

from slamhive.data.recordings.images import scale_camera
from slamhive.model.sensors import Camera, Role
from slamhive.model.templates import TemplateMistake
from slamhive.templating.helpers import ROLES
from slamhive.templating.rendering import Renderer
from slamhive_eval.rotation import from_matrix

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Text = Callable[[str], str]

EQUIDISTANT = {"distortion": "Equidistant", "coefficients": [0.1, -0.2, 0.03, -0.004]}


def storage(text: str, folder: Path) -> cv2.FileStorage:
    """Return a text as OpenCV reads it from a file."""
    path = folder / "settings.yaml"
    path.write_text(f"%YAML:1.0\n---\n{text}\n")
    return cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)


def pose(told: dict[str, Any], role: str) -> np.ndarray[Any, Any]:
    return np.array(told["sensors"][role]["T_body_sensor"])


def changed(told: dict[str, Any], role: str, **camera: Any) -> Text:
    """Return a renderer for a run whose camera is another."""
    other = copy.deepcopy(told)
    other["sensors"][role]["camera"] |= camera
    return lambda template: Renderer(other, "/slamhive", "/slamhive/files").text(template)


def test_a_matrix_is_read_by_opencv_as_it_was(text: Text, told: dict[str, Any], tmp_path: Path) -> None:
    template = "body_T_cam0: {{ opencv_matrix(transform('imu', 'left')) }}\nafter: 1\ncam:\n"
    template += "   R: {{ opencv_matrix(rotation(transform('left', 'right')), indent=6) }}\n   t: "
    template += "{{ opencv_matrix(translation(transform('left', 'right')), indent=6) }}\n   n: 2"
    found = storage(text(template), tmp_path)
    np.testing.assert_array_equal(found.getNode("body_T_cam0").mat(), pose(told, "left"))
    assert found.getNode("after").isInt()
    T_left_right = np.linalg.inv(pose(told, "left")) @ pose(told, "right")
    np.testing.assert_allclose(found.getNode("cam").getNode("R").mat(), T_left_right[:3, :3], atol=1e-9)
    np.testing.assert_allclose(found.getNode("cam").getNode("t").mat(), T_left_right[:3, 3:], atol=1e-9)
    assert found.getNode("cam").getNode("n").real() == 2


def test_values_are_read_by_opencv_and_yaml_as_what_they_are(text: Text, tmp_path: Path) -> None:
    template = (
        "name: {{ parameters.name|quoted }}\nsmall: {{ parameters.small }}\nlist: {{ [1, 0.5, 1e-07] }}\n"
    )
    template += "n: {{ parameters.features }}\nfine: {{ parameters.refine|int }}\nwhole: {{ 460.0 }}"
    rendered = text(template)
    expected = {
        "name": 'O\'Neil: "x"',
        "small": 1e-07,
        "list": [1, 0.5, 1e-07],
        "n": 150,
        "fine": 0,
        "whole": 460.0,
    }
    assert yaml.safe_load(rendered) == expected
    found = storage(rendered, tmp_path)
    assert found.getNode("name").string() == expected["name"]
    assert (found.getNode("small").real(), found.getNode("whole").real()) == (1e-07, 460.0)
    # ORB-SLAM3 refuses a real number without a point.
    assert (found.getNode("whole").isReal(), found.getNode("n").isInt()) == (True, True)
    items = found.getNode("list")
    assert [items.at(index).real() for index in range(items.size())] == expected["list"]


def test_truth_and_nothing_are_yamls(text: Text) -> None:
    assert yaml.safe_load(text("[{{ parameters.refine }}, {{ none }}, {{ [true, 'a: b', none] }}]")) == [
        False,
        None,
        [True, "a: b", None],
    ]


def test_transforms_between_any_two_sensors_agree_with_numpy(told: dict[str, Any], text: Text) -> None:
    frames = {role: pose(told, role) for role in told["sensors"]} | {"body": np.eye(4)}
    for to, T_body_to in frames.items():
        for of, T_body_of in frames.items():
            found = yaml.safe_load(text(f"{{{{ transform({to!r}, {of!r}) }}}}"))
            np.testing.assert_allclose(found, np.linalg.inv(T_body_to) @ T_body_of, atol=1e-9)
            flat = yaml.safe_load(text(f"{{{{ row_major(rotation(inverse(transform({of!r}, {to!r})))) }}}}"))
            np.testing.assert_allclose(flat, np.array(found)[:3, :3].ravel(), atol=1e-9)


def test_quaternions_are_those_of_the_evaluator_in_either_order(told: dict[str, Any]) -> None:
    generator = np.random.default_rng(3)
    turns = [np.eye(3), *(np.diag(signs) for signs in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1]))]
    turns += [
        cv2.Rodrigues(generator.normal(size=3) * scale)[0]
        for scale in (1e-6, 0.1, 1, 2, 3)
        for _ in range(20)
    ]
    for R in turns:
        T = np.eye(4)
        T[:3, :3] = R
        told["sensors"]["left"]["T_body_sensor"] = T.tolist()
        render = Renderer(told, "/r", "/r/files").text
        found = np.array(yaml.safe_load(render("{{ quaternion(transform('body', 'left')) }}")))
        expected = from_matrix(R)
        assert found[3] >= 0
        np.testing.assert_allclose(found * np.sign(found @ expected), expected, atol=1e-9)
        swapped = yaml.safe_load(render("{{ quaternion(transform('body', 'left'), 'wxyz') }}"))
        np.testing.assert_allclose(swapped, np.roll(found, 1), atol=0)


def test_a_camchain_is_kalibrs(text: Text, told: dict[str, Any]) -> None:
    found = yaml.safe_load(text("{{ kalibr_camchain() }}"))
    assert list(found) == ["cam0", "cam1"]
    cam0, cam1 = found["cam0"], found["cam1"]
    assert (cam0["camera_model"], cam0["distortion_model"]) == ("pinhole", "radtan")
    assert cam0["intrinsics"] == [458.654, 457.296, 367.215, 248.375]
    assert cam0["distortion_coeffs"] == [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
    assert (cam0["resolution"], cam0["rostopic"]) == ([752, 480], "/cam0/image_raw")
    # t_imu = t_cam + shift: the camera's stamps are 5 ms early.
    assert (cam0["timeshift_cam_imu"], cam1["timeshift_cam_imu"]) == (0.005, 0.0)
    np.testing.assert_allclose(cam0["T_cam_imu"], np.linalg.inv(pose(told, "left")), atol=1e-9)
    expected = np.linalg.inv(pose(told, "right")) @ pose(told, "left")
    np.testing.assert_allclose(cam1["T_cn_cnm1"], expected, atol=1e-9)
    assert "T_cn_cnm1" not in cam0


def test_other_models_have_their_own_names(told: dict[str, Any], tmp_path: Path) -> None:
    fisheye = changed(told, "left", **EQUIDISTANT)
    block = storage(fisheye("{{ camodocal('left') }}"), tmp_path)
    assert block.getNode("model_type").string() == "KANNALA_BRANDT"
    projection = block.getNode("projection_parameters")
    names = ["k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0"]
    values = [0.1, -0.2, 0.03, -0.004, 458.654, 457.296, 367.215, 248.375]
    assert [projection.getNode(name).real() for name in names] == values
    chain = yaml.safe_load(fisheye("{{ kalibr_camchain() }}"))["cam0"]
    assert (chain["distortion_model"], chain["distortion_coeffs"]) == (
        "equidistant",
        EQUIDISTANT["coefficients"],
    )
    orb = yaml.safe_load(fisheye("{{ orb_slam_camera('left') }}"))
    assert [orb[f"Camera1.k{n}"] for n in (1, 2, 3, 4)] == EQUIDISTANT["coefficients"]

    mei = changed(told, "left", model="Mei", xi=1.5)
    block = storage(mei("{{ camodocal('left') }}"), tmp_path)
    assert block.getNode("model_type").string() == "MEI"
    assert block.getNode("mirror_parameters").getNode("xi").real() == 1.5
    assert block.getNode("projection_parameters").getNode("gamma1").real() == 458.654
    assert block.getNode("distortion_parameters").getNode("p2").real() == 1.76187114e-05
    chain = yaml.safe_load(mei("{{ kalibr_camchain() }}"))["cam0"]
    assert (chain["camera_model"], chain["intrinsics"][:2]) == ("omni", [1.5, 458.654])


def test_a_pinhole_has_camodocals_and_orb_slams_names(text: Text, tmp_path: Path) -> None:
    block = storage(text("{{ camodocal('left') }}"), tmp_path)
    assert block.getNode("model_type").string() == "PINHOLE"
    assert (block.getNode("image_width").real(), block.getNode("image_height").real()) == (752, 480)
    assert block.getNode("projection_parameters").getNode("fy").real() == 457.296
    assert block.getNode("distortion_parameters").getNode("k1").real() == -0.28340811
    orb = storage(text("{{ orb_slam_camera('right', 'Camera2') }}"), tmp_path)
    assert orb.getNode("Camera2.cx").real() == 379.999
    assert orb.getNode("Camera2.k3").empty()


def test_a_scaled_camera_is_that_of_the_preparation(told: dict[str, Any], text: Text) -> None:
    expected = scale_camera(Camera.model_validate(told["sensors"]["left"]["camera"]), 0.3)
    found = text("{% set c = camera('left', 0.3) %}{{ [c.width, c.height, c.fx, c.fy, c.cx, c.cy] }}")
    sizes = [expected.width, expected.height, expected.fx, expected.fy, expected.cx, expected.cy]
    np.testing.assert_allclose(yaml.safe_load(found), sizes, rtol=1e-12)


def test_baselines_noise_and_shifts(text: Text) -> None:
    found = yaml.safe_load(
        text(
            "[{{ baseline() }}, {{ baseline_fx() }}, {{ time_shift('left', 'imu') }}, "
            "{{ time_shift('imu', 'left') }}, "
            "{{ discrete_noise(sensors.imu.imu.gyroscopeNoise, sensors.imu.rate) }}]"
        )
    )
    # EuRoC's baseline is 11 cm; ORB-SLAM's own file has bf 47.9 for rectified images of fx 435.3.
    assert found == pytest.approx(
        [0.110078, 0.110078 * 458.654, 0.005, -0.005, 0.00016968 * 200**0.5], rel=1e-5
    )


@pytest.mark.parametrize(
    ("template", "words"),
    [
        ("{{ transform('imu', 'lidar') }}", "unknown frame 'lidar'; known: body, imu, left, right"),
        ("{{ camera('lef').fx }}", "unknown sensor 'lef'; did you mean 'left'?"),
        ("{{ camera('imu').fx }}", "the sensor 'imu' has no intrinsics"),
        ("{{ camera('left', 0).fx }}", "scale must be above 0 and at most 16, not 0"),
        ("{{ quaternion(transform('imu', 'left'), 'xyz') }}", "'xyzw' or 'wxyz', not 'xyz'"),
        ("{{ quaternion([[1, 2], [3, 4]]) }}", "expected a 4×4 or 3×3 matrix"),
        ("{{ inverse([[1]]) }}", "expected a 4×4 matrix with the last row 0 0 0 1"),
        ("{{ opencv_matrix('x') }}", "expected a matrix"),
        ("{{ opencv_matrix([[1, 2], [3]]) }}", "rows of equal length"),
        ("{{ opencv_matrix([['a']]) }}", "expected a matrix of numbers"),
        ("{{ discrete_noise(-1, 200) }}", "density must be a number of at least 0, not -1"),
        ("{{ sensors.left.camera.fz }}", "unknown name 'fz'; known: coefficients, cx"),
        ("{{ sensors.left.camera }}", "it has several fields, name one of them: width, height"),
        ("{{ camera }}", "are its brackets missing?"),
        ("{{ fail('this rig has no IMU') }}", "this rig has no IMU"),
        ("{{ fail('a\\x1b[2J\\ud800\\nb') }}", "a\N{REPLACEMENT CHARACTER}[2J\N{REPLACEMENT CHARACTER} b"),
        ("{{ 1 / 0 }}", "division by zero"),
        ("{{ (1e308 * 10)|int }}", "a number gets too large"),
        ("{{ ''.__class__ }}", "not allowed in a template"),
        ("{{ camera.__globals__ }}", "not allowed in a template"),
        ("{{ '{0.__class__}'.format(1) }}", "not allowed in a template"),
        ("{{ parameters.update({'a': 1}) }}", "unknown name 'update'"),
        ("{% set l = [1] %}{{ l.append(2) }}", "not allowed in a template"),
        ("{{ '%c' % 55296 }}", "half a character"),
        ("{{ 1 + 'a' }}", "TypeError: unsupported operand"),
        ("{{ 'abc'|round }}", "TypeError"),
        ("{{ '%d'|replace }}", "TypeError"),
    ],
)
def test_what_a_template_can_not_have_is_a_sentence_with_its_line(
    template: str, words: str, text: Text
) -> None:
    with pytest.raises(TemplateMistake) as mistake:
        text(f"first: line\n{{# a remark\nof two lines #}}\n{template}")
    assert str(mistake.value).startswith("line 4: ")
    assert words in str(mistake.value)


@pytest.mark.parametrize(
    "camera", [{"coefficients": [0.1, 0, 0, 0, 0.2]}, {"model": "Mei", "xi": 1.0, **EQUIDISTANT}]
)
def test_a_camera_that_a_program_has_no_model_for_is_refused(
    told: dict[str, Any], camera: dict[str, Any]
) -> None:
    with pytest.raises(TemplateMistake, match=r"k1 k2 p1 p2 alone, and 'left' is \w+ with \w+ distortion"):
        changed(told, "left", **camera)("{{ camodocal('left') }}")


def test_paths_are_those_that_the_program_sees(text: Text) -> None:
    template = "{{ paths.recording }} {{ paths.output }} {{ paths.files }} {{ paths.assets }} {{ paths.run }}"
    expected = "/slamhive/dataset/recording.bag /slamhive/output /slamhive/files /slamhive/assets /slamhive"
    assert text(template) == expected


def test_sensors_and_parameters_are_in_one_order_wherever_they_came_from(told: dict[str, Any]) -> None:
    """An API server sorts keys, and a workstation does not."""
    other = copy.deepcopy(told)
    for name in ("sensors", "parameters"):
        other[name] = dict(reversed(other[name].items()))
    template = "{% for x in sensors %}{{ x }} {% endfor %}{% for x in parameters %}{{ x }} {% endfor %}"
    texts = {Renderer(item, "/r", "/r/files").text(template) for item in (told, other)}
    assert texts == {"left right imu features name refine small "}


def test_the_roles_are_those_of_the_models() -> None:
    assert list(ROLES) == [str(role) for role in Role]
