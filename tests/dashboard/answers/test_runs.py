# SPDX-License-Identifier: Apache-2.0
"""The table of runs: filters, order, pages, formats."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import RunRecord

ROWS = 31


async def test_the_default_columns_hold_the_unrounded_error(api: Any) -> None:
    answer = await api.get("/runs?limit=2")
    assert answer["total"] == ROWS
    assert [item["ate.rmse"] for item in answer["items"]] == [0.01, 0.02]


@pytest.mark.parametrize(
    ("query", "uids"),
    [
        ("uid=uid-003", [3]),
        ("uid=uid-003&uid=uid-005", [3, 5]),
        ("algorithm=algorithm-1&parameters.nFeatures=500&ate.rmse<=0.1", [3, 9]),
        ("ate.rmse<=0.02", [0, 1]),
        ("ate.rmse>0.22&ate.rmse<=0.24", [22, 23]),
        ("parameters.loop=true&ate.rmse<0.04", [0, 2]),
        ("outcome=null", [24, 26]),
        ("status=OutOfMemory", [24]),
        ("outcome!=Tracked", [24, 25, 26]),
        ("where=seed in (3, 5) or reason == 'OutOfMemory'", [3, 5, 24]),
        ("where=seed in (3, 5)&algorithm=algorithm-1", [3, 5]),
        ("parameters.nFeatures=many", [28]),
        ("where=", list(range(30))),
    ],
)
async def test_filters(api: Any, query: str, uids: list[int]) -> None:
    answer = await api.get(f"/runs?limit=1000&{query}")
    assert sorted({item["uid"] for item in answer["items"]}) == [f"uid-{number:03d}" for number in uids]


@pytest.mark.parametrize(
    "sort", ["", "-ate.rmse", "algorithm,-seed", "parameters.nFeatures", "-message,run", "started"]
)
async def test_pages_put_together_are_the_whole(api: Any, sort: str) -> None:
    whole = await api.get(f"/runs?limit=1000&sort={sort}")
    assert len(whole["items"]) == ROWS
    for limit in (1, 7, 31):
        items, path = [], f"/runs?limit={limit}&sort={sort}"
        while path:
            page = await api.get(path)
            items += page["items"]
            path = (page["next"] or "").removeprefix("/api/v1")
        assert items == whole["items"], limit


async def test_missing_values_come_last_either_way(api: Any) -> None:
    for sort in ("ate.rmse", "-ate.rmse"):
        items = (await api.get(f"/runs?limit=1000&sort={sort}"))["items"]
        assert [item["uid"] for item in items[-2:]] == ["uid-024", "uid-026"]


async def test_the_header_links_the_next_page(api: Any) -> None:
    answer = await api.raw.get("/api/v1/runs?limit=10&sort=-ate.rmse")
    link = answer.headers["link"]
    assert link == f'<{answer.json()["next"]}>; rel="next"'
    assert "link" not in (await api.raw.get("/api/v1/runs?limit=1000")).headers


@pytest.mark.usefixtures("looks_at_once")
async def test_a_page_stays_in_place_while_rows_come_and_go(
    api: Any, assorted: str, make_run: Callable[..., RunRecord]
) -> None:
    first = await api.get("/runs?limit=5&sort=ate.rmse")
    with Archive.open(assorted) as archive:
        archive.remove_run("uid-004")  # the last row of the first page
        archive.put_run(make_run(200, results=[]))
        archive.put_run(make_run(201, uid="uid-early"))
    second = await api.get(first["next"].removeprefix("/api/v1"))
    assert [item["uid"] for item in second["items"]] == [f"uid-{number:03d}" for number in range(5, 10)]
    assert second["total"] == first["total"] + 1


async def test_a_token_that_was_made_up_is_refused(api: Any) -> None:
    for token in ("", "x", "AAAA", "%00", "Ä", "0" * 5000):
        answer = await api.get(f"/runs?after={token}", 400)
        assert answer["field"] == "after", token


async def test_a_token_that_was_changed_is_refused(api: Any) -> None:
    path = (await api.get("/runs?limit=5&sort=ate.rmse"))["next"].removeprefix("/api/v1")
    head, token = path.split("after=")
    for place in range(0, len(token), 5):
        other = "A" if token[place] != "A" else "B"
        await api.get(f"{head}after={token[:place]}{other}{token[place + 1 :]}", 400)
    assert (await api.get(path.replace("sort=ate.rmse", "sort=-ate.rmse"), 400))["field"] == "after"


@pytest.mark.parametrize(
    ("query", "field", "part"),
    [
        ("columns=uid,ate.rms", "columns", "did you mean 'ate.rmse'"),
        ("sort=-algoritm", "sort", "did you mean 'algorithm'"),
        ("limit=0", "limit", "greater than or equal to 1"),
        ("limit=1001", "limit", "less than or equal to 1000"),
        ("limit=ten", "limit", "integer"),
        ("algoritm=x", "algoritm", "did you mean 'algorithm'"),
        ("ate.rms<3", "ate.rms", "did you mean 'ate.rmse'"),
        ("where=ate.rmse ~ 3", "where", "character 10"),
        ("where=(", "where", "found the end"),
        ("where=__import__('os')", "where", "unknown column"),
        ("format=xlsx", "format", "known: csv, json, parquet"),
        ("coverage>=", "coverage", "is missing"),
    ],
)
async def test_mistakes_say_where_they_are(api: Any, query: str, field: str, part: str) -> None:
    answer = await api.get(f"/runs?{query}", 400)
    assert answer["field"] == field
    assert part in answer["error"]


async def test_csv_holds_all_rows_and_every_digit(api: Any) -> None:
    answer = await api.raw.get("/api/v1/runs?format=csv&columns=uid,ate.rmse,parameters.text,parameters.loop")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert len(rows) == ROWS
    assert float(rows[2]["ate.rmse"]) == 0.03
    assert rows[28]["parameters.text"] == "<script>alert('x')</script> & \"quotes\""
    assert rows[0]["parameters.loop"] == "true"


async def test_accept_chooses_the_format(api: Any) -> None:
    answer = await api.raw.get("/api/v1/runs?limit=1", headers={"Accept": "text/csv"})
    assert answer.headers["content-type"].startswith("text/csv")
    assert "Accept" in answer.headers["vary"]


async def test_parquet_comes_back_as_it_was(api: Any) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    answer = await api.raw.get("/api/v1/runs?format=parquet&columns=uid,ate.rmse,parameters.nFeatures")
    table = parquet.read_table(io.BytesIO(answer.content)).to_pylist()
    assert table[1] == {"uid": "uid-001", "ate.rmse": 0.02, "parameters.nFeatures": "1000"}


async def test_without_pyarrow_parquet_is_refused_with_a_sentence(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    answer = await api.get("/runs?format=parquet", 406)
    assert "pyarrow" in answer["error"]


async def test_names_and_long_texts_stay_as_they_are(api: Any) -> None:
    answer = await api.get("/runs?uid=uid-027&uid=uid-028&columns=parameters.text,parameters.long,label.note")
    assert answer["items"][0]["label.note"] == "<script>alert('x')</script> & \"quotes\""
    assert answer["items"][1]["parameters.long"] == "ü" * 10_000


async def test_columns_tell_their_kind_range_and_values(api: Any) -> None:
    answer = await api.get("/columns?columns=ate.rmse,algorithm,parameters.loop,started,parameters.nFeatures")
    error, algorithm, loop, started, features = answer["items"]
    assert (error["kind"], error["unit"], error["min"]) == ("number", "m", 0.01)
    assert {item["value"]: item["count"] for item in algorithm["values"]} == {
        "algorithm-0": 15,
        "algorithm-1": 16,
    }
    assert loop["kind"] == "boolean"
    assert started["min"] == "2026-01-02T03:04:00.250000+00:00"
    assert features["kind"] == "other"


@pytest.mark.usefixtures("looks_at_once")
async def test_a_note_is_found_as_soon_as_it_is_written_and_is_plain_text(api: Any, assorted: str) -> None:
    asked = ("/search?words=v2+kernel", "/runs?where=tags+contains+robust", "/runs?where=note+contains+'<B>'")
    assert [(await api.get(path))["total"] for path in asked] == [0, 0, 0]
    with Archive.open(assorted) as archive:
        archive.annotate(["uid-003"], lambda had: had.changed("a <b>robust</b> kernel", ["v2", "robust"], []))
    for path in asked:
        assert [item["uid"] for item in (await api.get(path))["items"]] == ["uid-003"]
    run = await api.get("/runs/uid-003")
    assert (run["note"], run["tags"]) == ("a <b>robust</b> kernel", ["robust", "v2"])
    refused = await api.raw.post("/api/v1/runs/uid-003", json={"note": "from afar"})
    assert refused.status_code == 405
