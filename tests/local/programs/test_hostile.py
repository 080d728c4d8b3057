# SPDX-License-Identifier: Apache-2.0
"""Errors that nobody foresaw, and assets that a program changed: neither is in the way of other runs."""

from __future__ import annotations

import hashlib
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.engine import PointState
from slamhive.local.programs import assets
from slamhive.model.algorithm import Asset
from slamhive.model.errors import DataError
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.algorithm import Algorithm


def test_an_error_nobody_foresaw_ends_its_run_alone(
    run_acts: Callable, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare = bench.prepare

    def fail(spec: dict[str, Any], algorithm: Algorithm) -> Variant:
        if spec["parameters"]["act"] == "crash":
            raise ZeroDivisionError("no such number")
        return prepare(spec, algorithm)

    monkeypatch.setattr(bench, "prepare", fail)
    job, notes = run_acts(["crash", "good"])
    assert list(job.states) == [PointState.FAILED, PointState.SUCCEEDED]
    broken = next(record for record in notes.records if record.index == 0)
    assert broken.reason is Reason.SYSTEM_FAULT
    assert "ZeroDivisionError: no such number" in broken.message


def test_an_asset_that_a_program_changed_is_fetched_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All runs share the file that their folders link to."""

    def fetched(_url: str, place: Path, _sha256: str, _what: str) -> None:
        place.unlink(missing_ok=True)
        place.write_text("words")

    monkeypatch.setattr(assets, "fetch", fetched)
    checksum = hashlib.sha256(b"words").hexdigest()
    asset = Asset(name="vocabulary.txt", url="https://example.org/vocabulary.txt", sha256=checksum)
    entry: Any = SimpleNamespace(algorithm=SimpleNamespace(spec=SimpleNamespace(assets=[asset])))
    cache = tmp_path / "assets"
    assets.place_assets(entry, tmp_path / "first", cache)
    shared = (tmp_path / "first" / "vocabulary.txt").resolve()
    assert shared.stat().st_mode & 0o222 == 0
    shared.chmod(0o644)
    shared.write_text("other")
    assets.place_assets(entry, tmp_path / "second", cache)
    assert (tmp_path / "second" / "vocabulary.txt").read_text() == "words"


def test_a_changed_asset_of_the_algorithm_s_own_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "weights").write_text("other")
    asset = Asset(name="weights", path="weights", sha256=hashlib.sha256(b"words").hexdigest())
    spec = SimpleNamespace(assets=[asset])
    entry: Any = SimpleNamespace(algorithm=SimpleNamespace(spec=spec), folder=tmp_path)
    with pytest.raises(DataError, match="has sha256"):
        assets.place_assets(entry, tmp_path / "run", tmp_path / "assets")
