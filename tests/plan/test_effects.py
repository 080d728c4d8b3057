# SPDX-License-Identifier: Apache-2.0
"""Settings that a recording can't give: refused where they are in vain, told truly where they are not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.model.algorithm import Algorithm
from slamhive.model.errors import InputError
from slamhive.model.loading import parse, to_object
from slamhive.model.results import Prepared
from slamhive.model.run import MappingRunSpec
from slamhive.model.sensors import SensorMode
from slamhive.plan import FixedCatalog, Plan, option_problems, plan_problems, recording_fields, spec_hash
from slamhive.plan.effects import nominal
from slamhive.plan.resolution import run_problems

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.sweep import Sweep

CATALOG = """
apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: odometry}
spec:
  image: none
  modes: [{name: lidar}, {name: stereo}, {name: mono}, {name: rgbd}, {name: odometry}, {name: scan-odometry}]
  paces: [Lockstep, Realtime]
  realtime: {queue: 1}
  output: {frame: body}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: slow}
spec: {recording: {synthetic: {sensors: [Lidar], durationSeconds: 15, lidar: {rings: 16}}}}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: fast}
spec: {recording: {synthetic: {sensors: [Lidar, Stereo], durationSeconds: 30, lidar: {rate: 20}}}}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: robot}
spec: {recording: {synthetic: {sensors: [LaserScan, Odometry], durationSeconds: 15}}}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: bag}
spec:
  recording: {files: [{path: some.bag}]}
  sensors:
    lidar: {type: Lidar, topic: /points, rate: 10.07}
    left: {type: Camera, topic: /left, rate: 29.97}
    right: {type: Camera, topic: /right, rate: 15}
    color: {type: Camera, topic: /color}
    depth: {type: DepthCamera, topic: /depth, rate: 15}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: measured}
spec:
  recording: {files: [{path: some.bag}], durationSeconds: 145.6}
  sensors: {lidar: {type: Lidar, topic: /points}}
"""


@pytest.fixture(scope="module")
def known() -> FixedCatalog:
    return FixedCatalog.of(to_object(document) for document in parse(CATALOG, "catalog.yaml"))


@pytest.fixture
def study(known: FixedCatalog, sweep: Callable[..., Sweep]) -> Callable[..., Plan]:
    def make(matrix: str = "[]", *, mode: str = "lidar", **fields: Any) -> Plan:
        spec = {"algorithmRef": {"name": "odometry"}, "datasetRef": {"name": "slow"}, "sensors": mode}
        spec |= fields.pop("template", {})
        more = "".join(f"{key}: {value}\n" for key, value in fields.items())
        return Plan(sweep(f"template: {{spec: {spec}}}\nmatrix: {matrix}\n{more}"), known)

    return make


@pytest.mark.parametrize(
    ("mode", "dataset", "options", "sentence"),
    [
        ("lidar", "slow", {"frameRate": 30}, "input.frameRate: 30 Hz is asked, slow's lidar has 10 Hz"),
        ("lidar", "bag", {"frameRate": 20.5}, "input.frameRate: 20.5 Hz is asked, bag's lidar has 10.07 Hz"),
        ("mono", "bag", {"frameRate": 40}, "input.frameRate: 40 Hz is asked, bag's left has 29.97 Hz"),
        (
            "mono",
            "bag",
            {"frameRate": 20, "remap": {"camera": "right"}},
            "input.frameRate: 20 Hz is asked, bag's right has 15 Hz",
        ),
        (
            "lidar",
            "slow",
            {"resolution": 0.5},
            "input.resolution: 0.5 is asked, the mode lidar has no camera",
        ),
        ("lidar", "slow", {"duration": "100s"}, "input.duration: 100s is asked, slow lasts 15 s"),
        (
            "lidar",
            "slow",
            {"start": "5s", "duration": "12s"},
            "input.duration: 12s is asked, slow lasts 15 s, 10 s after input.start",
        ),
        ("lidar", "measured", {"duration": "3m"}, "input.duration: 3m is asked, measured lasts 145.6 s"),
        ("lidar", "slow", {"start": "15s"}, "input.start: 15s is asked, slow lasts 15 s"),
        ("lidar", "slow", {"lidar": {"rings": 64}}, "input.lidar.rings: 64 is asked, slow's LiDAR has 16"),
        (
            "stereo",
            "fast",
            {"lidar": {"maxRange": 30}},
            "input.lidar.maxRange: 30 is asked, the mode stereo has no LiDAR",
        ),
        (
            "scan-odometry",
            "robot",
            {"frameRate": 15},
            "input.frameRate: 15 Hz is asked, robot's scan has 10 Hz",
        ),
        (
            "odometry",
            "robot",
            {"frameRate": 10},
            "input.frameRate: 10 Hz is asked, the mode odometry has no frames; samples are never thinned",
        ),
        ("lidar", "slow", {"rate": 2}, "input.rate: 2 is asked, the pace Lockstep has no speed of playback"),
    ],
)
def test_a_single_run_is_refused_with_what_there_is(
    study: Callable[..., Plan], mode: str, dataset: str, options: dict[str, Any], sentence: str
) -> None:
    points = study(mode=mode, template={"datasetRef": {"name": dataset}, "input": options})
    assert plan_problems(points) == [f"spec.template.spec: {sentence}"]
    chosen = points.algorithms["odometry"].spec.mode(SensorMode(mode))
    given = {"pace": "Lockstep", **options}
    assert option_problems(given, points.datasets[dataset], chosen) == [sentence]


@pytest.mark.parametrize(
    ("mode", "dataset", "options"),
    [
        ("lidar", "slow", {"frameRate": 10}),
        ("lidar", "bag", {"frameRate": 10}),
        ("lidar", "bag", {"frameRate": 10.2}),
        ("mono", "bag", {"frameRate": 30}),
        ("stereo", "bag", {"frameRate": 20}),  # the right images follow the left ones
        ("rgbd", "bag", {"frameRate": 90}),  # nobody knows the rate of the colour images
        ("lidar", "bag", {"duration": "1000s", "start": "900s"}),  # nor how long the bag is
        ("lidar", "slow", {"resolution": 1.0, "rate": 1, "lidar": {"rings": 16}}),
        ("lidar", "slow", {"duration": "15s"}),
        ("lidar", "slow", {"start": "5s", "duration": "10s"}),
        ("stereo", "fast", {"resolution": 0.5, "frameRate": 7.5}),
        ("lidar", "slow", {"rate": 2, "pace": "Realtime"}),
    ],
)
def test_what_the_recording_has_or_may_have_is_as_asked(
    study: Callable[..., Plan], mode: str, dataset: str, options: dict[str, Any]
) -> None:
    points = study(mode=mode, template={"datasetRef": {"name": dataset}, "input": options})
    assert plan_problems(points) == []
    assert points.point(0).asked == {}
    assert points.remarks() == []


@pytest.mark.parametrize("pace", ["Realtime", "Stepped"])
def test_what_is_played_has_a_speed_of_playback(study: Callable[..., Plan], pace: str) -> None:
    points = study(mode="lidar", template={"datasetRef": {"name": "slow"}})
    mode = points.algorithms["odometry"].spec.mode(SensorMode("lidar"))
    assert option_problems({"pace": pace, "rate": 2}, points.datasets["slow"], mode) == []


def test_rates_above_that_of_the_only_recording_are_refused_each_where_it_stands(
    study: Callable[..., Plan],
) -> None:
    assert plan_problems(study("[{path: input.frameRate, values: [10, 15, 30]}]")) == [
        "spec.matrix[0].values[1]: input.frameRate: 15 Hz is asked, slow's lidar has 10 Hz",
        "spec.matrix[0].values[2]: input.frameRate: 30 Hz is asked, slow's lidar has 10 Hz",
    ]


def test_a_value_in_vain_on_every_recording_is_refused(study: Callable[..., Plan]) -> None:
    axes = "[{path: dataset, values: [slow, fast]}, {path: input.resolution, values: [1, 0.5]}]"
    [sentence] = plan_problems(study(axes))
    assert sentence == (
        "spec.matrix[1].values[1]: input.resolution: 0.5 is asked, the mode lidar has no camera; "
        "nor has it an effect elsewhere in the sweep"
    )
    several = "[{path: sensors, values: [stereo, lidar]}, {path: input.resolution, values: [1, 0.5]}]"
    assert plan_problems(study(several, template={"datasetRef": {"name": "fast"}})) == []


def test_a_run_cannot_start_beyond_the_end_of_any_recording(study: Callable[..., Plan]) -> None:
    points = study("[{path: dataset, values: [slow, fast]}]", template={"input": {"start": "20s"}})
    assert plan_problems(points) == ["spec.template.spec: input.start: 20s is asked, slow lasts 15 s"]


RATES = "[{path: dataset, values: [slow, fast]}, {path: input.frameRate, values: [10, 15, 30]}]"


def test_over_several_recordings_each_run_has_what_took_effect(study: Callable[..., Plan]) -> None:
    points = study(RATES)
    assert plan_problems(points) == []
    found = [(point.spec["input"]["frameRate"], point.asked) for point in points]
    assert found == [
        (10, {}),
        (10, {"frameRate": 15}),
        (10, {"frameRate": 30}),
        (10, {}),
        (15, {}),
        (20, {"frameRate": 30}),
    ]
    mode = points.algorithms["odometry"].spec.modes[0]
    for point in points:
        assert point.spec_hash == spec_hash(point.spec)
        assert option_problems(point.spec["input"], points.datasets[point.coordinates["dataset"]], mode) == []


def test_runs_that_come_out_equal_wait_for_the_first_of_them(study: Callable[..., Plan]) -> None:
    points = study(RATES, repetitions=2)
    assert points.twins == {2: 0, 3: 1, 4: 0, 5: 1}
    assert all(points.point(k).spec_hash == points.point(twin).spec_hash for k, twin in points.twins.items())
    assert points.start_order()[-4:] == [2, 4, 3, 5]
    assert points.remarks() == [
        "input.frameRate: 15 Hz is asked, slow's lidar has 10 Hz; runs as 10",
        "input.frameRate: 30 Hz is asked, slow's lidar has 10 Hz; runs as 10",
        "input.frameRate: 30 Hz is asked, fast's lidar has 20 Hz; runs as 20",
        "4 of 12 runs are equal to others and are not run again",
    ]


def test_nothing_waits_where_every_value_has_an_effect(study: Callable[..., Plan]) -> None:
    points = study("[{path: input.frameRate, values: [10, 5]}]")
    assert points.twins == {}
    assert points.start_order() == [0, 1]


def test_a_length_beyond_the_end_is_the_rest(study: Callable[..., Plan]) -> None:
    points = study("[{path: dataset, values: [slow, fast]}]", template={"input": {"duration": "100s"}})
    assert plan_problems(points) == []
    assert [point.spec["input"]["duration"] for point in points] == ["15s", "30s"]
    assert [point.asked for point in points] == [{"duration": "100s"}] * 2


def test_what_a_mode_has_no_sensor_for_is_left_out(study: Callable[..., Plan]) -> None:
    axes = "[{path: sensors, values: [stereo, lidar]}, {path: input.lidar.rings, values: [8, 16]}]"
    points = study(axes, template={"datasetRef": {"name": "fast"}, "input": {"resolution": 0.5}})
    assert plan_problems(points) == []
    inputs = [point.spec["input"] for point in points]
    assert [options.get("lidar") for options in inputs] == [None, None, {"rings": 8}, {"rings": 16}]
    assert [options["resolution"] for options in inputs] == [0.5, 0.5, 1, 1]
    assert points.twins == {1: 0}
    assert points.point(1).asked == {"lidar.rings": 16}


def test_a_template_may_ask_for_more_than_some_recordings_have(study: Callable[..., Plan]) -> None:
    points = study("[{path: dataset, values: [slow, fast]}]", template={"input": {"frameRate": 12}})
    assert plan_problems(points) == []
    assert [point.spec["input"]["frameRate"] for point in points] == [10, 12]


@pytest.mark.parametrize(
    ("rate", "expected"), [(29.97, 30), (20.02, 20), (10.07, 10), (12.5, 12.5), (0.4, 0.4), (5.064, 5)]
)
def test_a_measured_rate_stands_for_a_whole_one_within_two_percent(rate: float, expected: float) -> None:
    assert nominal(rate) == expected


def test_what_preparation_finds_of_a_bag_is_told(known: FixedCatalog) -> None:
    mode = known.algorithms["odometry"].spec.mode(SensorMode.RGBD)
    prepared = Prepared(frame_rate=30.01, recorded_frame_rate=30.01, recorded_seconds=14.9)
    given = {"frameRate": 60, "duration": "1m", "start": "2s", "resolution": 0.5, "pace": "Lockstep"}
    fields = recording_fields(given, {}, known.datasets["bag"], mode, prepared)
    assert fields == {
        "asked": {"frameRate": 60, "duration": "1m"},
        "effective": {"frameRate": 30, "duration": "12s900ms"},
        "prepared": prepared,
    }


def test_what_was_asked_stays_asked_where_preparation_finds_still_less(known: FixedCatalog) -> None:
    mode = known.algorithms["odometry"].spec.mode(SensorMode.LIDAR)
    prepared = Prepared(recorded_frame_rate=5.0, recorded_seconds=14.9)
    fields = recording_fields({"frameRate": 10}, {"frameRate": 30}, known.datasets["bag"], mode, prepared)
    assert (fields["asked"], fields["effective"]) == ({"frameRate": 30}, {"frameRate": 5})


def test_of_a_run_that_was_never_prepared_only_what_is_asked_is_known(known: FixedCatalog) -> None:
    mode = known.algorithms["odometry"].spec.mode(SensorMode.LIDAR)
    fields = recording_fields({"frameRate": 10}, {"frameRate": 30}, known.datasets["slow"], mode, None)
    assert fields == {"asked": {"frameRate": 30}, "effective": {"frameRate": 10}, "prepared": None}
    left_out = recording_fields({}, {"rate": 2}, known.datasets["slow"], mode, None)
    assert (left_out["asked"], left_out["effective"]) == ({"rate": 2}, None)
    assert recording_fields({}, {}, known.datasets["slow"], mode, None)["asked"] is None


PERTURBED = """
- {path: input.perturb.lidar.rangeNoise, values: [0, 0.1]}
- {path: input.perturb.timeOffset.lidar, values: [0, 0.02]}
- {path: input.perturb.seed, values: [1, 2]}
"""


def test_perturbations_are_axes_whose_zero_is_a_plain_run(study: Callable[..., Plan]) -> None:
    points = study(PERTURBED)
    assert plan_problems(points) == []
    plain = study().point(0)
    assert [point.spec_hash for point in points] == [spec_hash(point.spec) for point in points]
    hashes = [point.spec_hash for point in points]
    assert hashes[0] == hashes[1] == plain.spec_hash
    assert hashes[2] == hashes[3] != plain.spec_hash  # what isn't random has no seed
    assert len(set(hashes)) == 6
    assert points.point(0).spec["input"]["perturb"] == {
        "lidar": {"rangeNoise": 0},
        "timeOffset": {"lidar": 0},
        "seed": 1,
    }
    assert points.twins == {1: 0, 3: 2}


@pytest.mark.parametrize(
    ("mode", "perturb", "sentence"),
    [
        (
            "stereo",
            {"lidar": {"rangeNoise": 0.1}},
            "input.perturb.lidar.rangeNoise: 0.1 is asked, the mode stereo has no LiDAR",
        ),
        (
            "lidar",
            {"images": {"blur": 4}},
            "input.perturb.images.blur: 4 is asked, the mode lidar has no camera",
        ),
        ("lidar", {"imu": {"rate": 50}}, "input.perturb.imu.rate: 50 is asked, the mode lidar has no IMU"),
        (
            "lidar",
            {"timeOffset": {"imu": 0.1}},
            "input.perturb.timeOffset.imu: 0.1 is asked, the mode lidar has no imu",
        ),
        (
            "lidar",
            {"late": {"imu": 0.1}},
            "input.perturb.late.imu: 0.1 is asked, the mode lidar has no imu",
        ),
        (
            "stereo",
            {"lidar": {"rain": 0.1}},
            "input.perturb.lidar.rain: 0.1 is asked, the mode stereo has no LiDAR",
        ),
        (
            "lidar",
            {"images": {"motionBlur": 10}},
            "input.perturb.images.motionBlur: 10 is asked, the mode lidar has no camera",
        ),
        (
            "lidar",
            {"seed": 3},
            "input.perturb.seed: 3 is asked, and nothing that is perturbed is random",
        ),
    ],
)
def test_a_perturbation_of_what_is_not_there_is_refused(
    known: FixedCatalog, mode: str, perturb: dict[str, Any], sentence: str
) -> None:
    algorithm, dataset = known.algorithms["odometry"].spec, known.datasets["fast"]
    chosen = algorithm.mode(SensorMode(mode))
    assert option_problems({"perturb": perturb}, dataset, chosen) == [sentence]


def test_an_unknown_role_of_a_perturbation_is_named(study: Callable[..., Plan]) -> None:
    with pytest.raises(InputError, match=r"unknown role 'lidr'; did you mean 'lidar'"):
        study("[{path: input.perturb.timeOffset.lidr, values: [0.1]}]")


@pytest.mark.parametrize(
    ("formats", "perturb", "sentence"),
    [
        (
            "[Kitti]",
            {"swapped": {"left": 0.2}},
            (
                "input.perturb.swapped.left: a folder in Kitti's form has no order of delivery; only bags "
                "have, which are played or read message by message"
            ),
        ),
        ("[Rosbag1]", {"swapped": {"left": 0.2}}, None),
        ("[Kitti]", {"swapped": {"left": 0}}, None),
        (
            "[Rosbag1]",
            {"images": {"motionBlur": 10}},
            (
                "input.perturb.images.motionBlur: nothing says how bag turns: it has no IMU, and no ground "
                "truth with orientations; images.blur in pixels needs neither"
            ),
        ),
    ],
)
def test_a_perturbation_that_cannot_be_had_is_refused_before_anything_runs(
    known: FixedCatalog, formats: str, perturb: dict[str, Any], sentence: str | None
) -> None:
    document = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Algorithm", "metadata": {"name": "reader"}}
    spec = {"image": "none", "modes": [{"name": "mono", "roles": ["left"]}], "paces": ["Lockstep"]}
    spec |= {"recording": formats.strip("[]").split(), "output": {"frame": "left"}}
    algorithm = Algorithm.model_validate(document | {"spec": spec})
    asked = {"algorithmRef": {"name": "reader"}, "datasetRef": {"name": "bag"}, "input": {"perturb": perturb}}
    body = MappingRunSpec.model_validate(asked).as_json() | {"sensors": "mono"}
    problems = list(run_problems(body, algorithm, known.datasets["bag"]))
    assert problems[:1] == ([sentence] if sentence else [])
