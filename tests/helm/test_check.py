# SPDX-License-Identifier: Apache-2.0
"""The program of ``helm test``, before a stand-in for the API server."""

from __future__ import annotations

import io
import json
import runpy
import ssl
import urllib.error
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

PROGRAM = Path(__file__).parents[2] / "helm" / "slamhive" / "files" / "check.py"
READY = {"observedGeneration": 2, "readyReplicas": 1, "updatedReplicas": 1}
Answer = Any


@pytest.fixture
def check(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, list[str]]]:
    """Run the program where the API answers as given; returns the exit code and the lines printed."""
    for name, value in {
        "KUBERNETES_SERVICE_HOST": "10.0.0.1",
        "KUBERNETES_SERVICE_PORT": "443",
        "NAMESPACE": "lab",
        "OPERATOR": "slamhive-operator",
        "HOSTNAME": "slamhive-test",
        "FOLDERS": f"{tmp_path}/results:{tmp_path}/data",
    }.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(Path, "read_text", _read_text)
    monkeypatch.setattr(ssl, "create_default_context", lambda **_: None)

    def run(status: dict[str, int] = READY, missing: str = "") -> tuple[int, list[str]]:
        def answer(request: urllib.request.Request, **_: Any) -> Answer:
            assert request.get_header("Authorization") == "Bearer token"
            path = urlsplit(request.full_url).path
            if missing and path.endswith(missing):
                raise urllib.error.HTTPError(path, 404, "Not Found", None, None)  # type: ignore[arg-type]
            body = {"metadata": {"generation": 2}, "status": status, "items": []}
            return io.BytesIO(json.dumps(body).encode())

        monkeypatch.setattr(urllib.request, "urlopen", answer)
        times = iter(range(0, 10_000, 100))
        monkeypatch.setattr("time.monotonic", lambda: next(times))
        monkeypatch.setattr("time.sleep", lambda _: None)
        with pytest.raises(SystemExit) as end:
            runpy.run_path(str(PROGRAM), run_name="__main__")
        return int(end.value.code or 0), capsys.readouterr().out.splitlines()

    return run


_REAL = Path.read_text


def _read_text(path: Path, *arguments: Any, **options: Any) -> str:
    return "token" if path.name == "token" else _REAL(path, *arguments, **options)


def test_all_is_well(check: Callable[..., tuple[int, list[str]]], tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    code, lines = check()
    assert code == 0
    assert [line.split()[0] for line in lines] == ["ok"] * 4
    assert [*(tmp_path / "results").iterdir()] == []


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"missing": "/sweeps"}, "sweeps.slamhive.io: install the chart slamhive-crds"),
        ({"status": {}}, "operator: not ready, see kubectl logs deployment/slamhive-operator"),
        ({"status": READY | {"observedGeneration": 1}}, "operator: not ready"),
    ],
)
def test_what_is_wrong_is_said(
    check: Callable[..., tuple[int, list[str]]], changes: dict[str, Any], told: str
) -> None:
    code, lines = check(**changes)
    assert code == 1
    (wrong,) = (line for line in lines if line.startswith("WRONG"))
    assert told in wrong


def test_a_volume_that_cannot_be_written(check: Callable[..., tuple[int, list[str]]], tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file where a folder should be")
    code, lines = check()
    assert code == 1
    assert "can't write it: Not a directory" in " ".join(lines)


EGRESS = PROGRAM.with_name("egress.py")


@pytest.mark.parametrize(
    ("open_ports", "told"),
    [
        ((), ["ok    runs reach neither API server nor dashboard"]),
        ((443,), ["OPEN  runs reach the API server"]),
        (
            (443, 80),
            ["OPEN  runs reach the API server", "OPEN  runs reach the dashboard, and by it ground truth"],
        ),
    ],
)
def test_it_says_where_the_network_keeps_no_algorithm(
    open_ports: tuple[int, ...],
    told: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def connect(place: tuple[str, int], _: float) -> io.BytesIO:
        if place[1] not in open_ports:
            raise TimeoutError
        return io.BytesIO()

    monkeypatch.setenv("KUBERNETES_SERVICE_HOST", "10.0.0.1")
    monkeypatch.setenv("KUBERNETES_SERVICE_PORT", "443")
    monkeypatch.setenv("DASHBOARD", "slamhive-dashboard:80")
    monkeypatch.setattr("socket.create_connection", connect)
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(EGRESS), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert (end.value.code, len(lines)) == (0, len(told))
    assert all(line.startswith(part) for line, part in zip(lines, told, strict=True))
