# SPDX-License-Identifier: Apache-2.0
"""Whatever a file holds, it is read or refused by one sentence, and what is read can be evaluated."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval import (
    FileError,
    Options,
    Trajectory,
    evaluate,
    evaluate_relations,
    read_relations,
    read_trajectory,
)

if TYPE_CHECKING:
    from collections.abc import Callable

numbers = st.one_of(
    st.floats(allow_subnormal=True).map(repr),
    st.integers(-9, 9).map(str),
    st.sampled_from(
        ("1e400", "-0", "+1", "1e-320", "0x1", "1_0", "nan", "é", "", "1.5.2", "1d3", "(1+2j)", '"1"')
    ),
)
stamps = st.floats(0, 30).map(repr)
separators = st.sampled_from((" ", "\t", ",", ", ", "  ", ";"))
rows = st.tuples(stamps, st.lists(numbers, min_size=6, max_size=12), separators)
good = st.tuples(stamps, st.lists(st.floats(-1e30, 1e30).map(repr), min_size=7, max_size=7), separators)


def text(lines: list[tuple[str, list[str], str]], end: str) -> bytes:
    return end.join(separator.join((stamp, *values)) for stamp, values, separator in lines).encode()


contents = st.one_of(
    st.binary(max_size=60),
    st.text("0123456789.eE+-# \n,nanif\r\t\0\v\f\x1c", max_size=120).map(str.encode),
    st.builds(
        text, st.lists(st.one_of(rows, good), max_size=6), st.sampled_from(("\n", "\r\n", "\n\n# c\n"))
    ),
    st.builds(text, st.lists(good, min_size=3, max_size=8).map(sorted), st.just("\n")),
)


@pytest.fixture(scope="module", name="file")
def file_fixture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "trajectory.txt"


@given(content=contents, file_format=st.sampled_from((None, "tum", "euroc", "kitti")))
def test_reading_and_evaluating(file: Path, content: bytes, file_format: str | None) -> None:
    file.write_bytes(content)
    try:
        found = read_trajectory(file, file_format, unsorted="sort")
    except FileError as error:
        assert "\n" not in str(error).replace(str(file), "")  # noqa: PT017
        return
    assert len(found) >= 1
    reference = Trajectory(found.stamps, found.positions[::-1], found.quaternions[::-1])
    for method in ("none", "origin", "se3", "sim3", "scale", "yaw"):
        json.dumps(evaluate(reference, found, Options(alignment=method)).as_dict(), allow_nan=False)


@given(content=contents)
def test_relations(file: Path, wander: Callable[..., Trajectory], content: bytes) -> None:
    file.write_bytes(content)
    try:
        truth = read_relations(file)
    except FileError:
        return
    found = evaluate_relations(truth, wander(300, start=0.0), interpolate_gap_seconds=1.0)
    json.dumps(found.as_dict(), allow_nan=False)


def test_files_that_failed_once_and_broken_ones_are_read_or_refused() -> None:
    """The same files each time; ``make fuzz`` looks for new ones."""
    script = Path(__file__).parents[1] / "fuzz" / "readers.py"
    words = [sys.executable, script, "--seed", "1", "--files", "300"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode or done.stderr:
        pytest.fail(done.stdout + done.stderr, pytrace=False)
    assert int(done.stdout.splitlines()[1].split()[0]) >= 300
