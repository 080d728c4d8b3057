# SPDX-License-Identifier: Apache-2.0
"""Tests of recordings that lack something: what is left in them, in each format."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.conformance.damaging import Damage, damaged
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.reading import Recording
from slamhive.data.store.datasets import materialise
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError
from slamhive.model.loading import load_file
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.local.home.folder import Home

FORMATS = (RecordingFormat.ROSBAG1, RecordingFormat.ROSBAG2, RecordingFormat.MCAP)


def variant(home: Home, form: RecordingFormat, cache: Path) -> Variant:
    dataset = load_file(home.path / "tiny.yaml")[0]
    assert isinstance(dataset, Dataset)
    entry = materialise(dataset, home.path, home.path / "datasets")
    return prepare(entry, [Role.LIDAR], InputOptions(), [form], cache)


@pytest.mark.parametrize("form", FORMATS)
def test_a_topic_that_is_missing_is_gone_and_the_others_stay(
    form: RecordingFormat, home: Home, tmp_path: Path
) -> None:
    whole = variant(home, form, tmp_path / "variants")
    found = damaged(whole, Damage(Role.LIDAR), tmp_path / "damaged")
    with Recording([whole.path], form) as before, Recording([found.path], form) as after:
        assert set(before.topics) - set(after.topics) == {"/points"}
        assert all(after.topics[name].count == before.topics[name].count for name in after.topics)
    assert (found.folder / "frames.txt").read_text() == (whole.folder / "frames.txt").read_text()
    assert found.path != whole.path


@pytest.mark.parametrize("form", FORMATS)
def test_a_recording_without_a_message_has_its_topics(
    form: RecordingFormat, home: Home, tmp_path: Path
) -> None:
    whole = variant(home, form, tmp_path / "variants")
    found = damaged(whole, Damage(), tmp_path / "damaged")
    with Recording([found.path], form) as after:
        assert after.topics["/points"].count == 0
        assert after.topics["/points"].message_type == "sensor_msgs/msg/PointCloud2"


def test_what_can_not_be_read_is_a_sentence(home: Home, tmp_path: Path) -> None:
    whole = variant(home, RecordingFormat.ROSBAG1, tmp_path / "variants")
    whole.path.unlink()
    with pytest.raises(DataError):
        damaged(whole, Damage(), tmp_path / "damaged")
