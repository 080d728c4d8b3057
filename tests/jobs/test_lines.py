# SPDX-License-Identifier: Apache-2.0
import json
import random
from typing import Any

import pytest

from slamhive.jobs.lines import LINE_BYTES, decode, encode, encode_all

RECORDS: list[dict[str, Any]] = [
    {"uid": "a", "result": {"ate": 0.1 + 0.2, "text": "é “quoted” \\ \n @slamhive 0/9 00000000 {}"}},
    {"uid": "b", "result": {"values": [random.Random(1).random() for _ in range(9000)]}},
    {"uid": "c", "error": '"\\' * 40_000},
    {"uid": "d"},
]


def log_of(records: list[dict[str, Any]]) -> list[str]:
    return "".join(encode_all(records)).splitlines(keepends=True)


def test_records_come_back_whatever_their_size() -> None:
    lines = log_of(RECORDS)
    assert max(map(len, lines)) <= LINE_BYTES
    assert len(lines) > len(RECORDS)
    found = decode("".join(lines))
    assert [found.records[number] for number in range(4)] == RECORDS
    assert (found.is_complete, found.missing, found.damaged) == (True, [], 0)


def test_order_repetition_and_foreign_lines_do_no_harm() -> None:
    lines = [*log_of(RECORDS), *log_of(RECORDS)]
    random.Random(2).shuffle(lines)
    mixed = "".join(f"2026-01-02T03:04:05.678Z {line}progress: 3 %\n" for line in lines)
    assert decode(mixed).records == dict(enumerate(RECORDS))


@pytest.mark.parametrize("number", range(len(RECORDS)))
def test_a_lost_line_leaves_its_record_missing(number: int) -> None:
    lines = log_of(RECORDS)
    lost = next(k for k, line in enumerate(lines) if line.startswith(f"@slamhive {number}/"))
    found = decode("".join(lines[:lost] + lines[lost + 1 :]))
    assert found.missing == [number]
    assert not found.is_complete


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line[: len(line) // 2],
        lambda line: line.replace("uid", "UID"),
        lambda line: line.replace("/4 ", "/5 "),
        lambda line: line.replace("@slamhive 0/4", "@slamhive 4/4"),
        lambda line: line.rstrip("\n") + line,
    ],
)
def test_damaged_lines_are_told_and_not_believed(damage: Any) -> None:
    lines = log_of(RECORDS)
    found = decode("".join(lines[1:]) + damage(lines[0]) + "\n")
    assert found.missing == [0]
    assert found.damaged == 1


def test_a_forged_payload_is_no_record() -> None:
    import zlib

    for text in ("3", "[1]", "[0, 2, {}]", "[" * 5000, '[0, "x", "y"]', "nul"):
        line = f"@slamhive 0/1 {zlib.crc32(text.encode()):08x} {text}"
        assert decode(line).records == {}


def test_an_empty_log_is_not_complete() -> None:
    assert not decode("").is_complete
    assert decode("nothing of ours").total is None


def test_what_json_cannot_say_is_refused() -> None:
    with pytest.raises(ValueError, match="JSON"):
        encode(0, 1, {"ate": float("nan")})
    assert json.loads(encode(0, 1, {"a": None}).split(" ", 3)[3]) == {"a": None}
