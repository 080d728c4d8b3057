# SPDX-License-Identifier: Apache-2.0
"""The operator's process: how it ends when it cannot begin, what it logs, how the kubelet asks."""

from __future__ import annotations

import io
import json
import logging
import socket
from typing import TYPE_CHECKING, Any

import aiohttp
import pytest
from kubernetes.aio.client import ApiClient, Configuration

from slamhive.kube import __main__ as process
from slamhive.kube.api.client import Api
from slamhive.kube.cluster import Cluster
from slamhive.kube.health import HealthServer
from slamhive.kube.logs import set_up_logs
from slamhive.kube.operator import Operator
from slamhive.kube.settings import Settings

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator
    from pathlib import Path

LEAST = {
    "namespaces": ["lab"],
    "image": "slamhive",
    "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
    "health": {"port": 0},
    "metrics": {"port": 0},
}


@pytest.fixture(autouse=True)
def logs_as_before() -> Iterator[None]:
    root = logging.getLogger()
    before, level = [*root.handlers], root.level
    yield
    root.handlers[:], root.level = before, level
    for name in ("asyncio", "slamhive"):
        logging.getLogger(name).setLevel(logging.NOTSET)


def written(folder: Path, **changes: Any) -> Path:
    file = folder / "operator.yaml"
    file.write_text(json.dumps(LEAST | changes))
    return file


def test_wrong_settings_end_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert process.main(["--settings", str(written(tmp_path, workers=0))]) == 2
    assert "operator.yaml: workers: must be greater than or equal to 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "words"), [(None, "cannot be read"), ("\n", "is empty: expected a data")]
)
def test_an_archive_that_cannot_be_used_ends_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None, words: str
) -> None:
    url = tmp_path / "url"
    if content is not None:
        url.write_text(content)
    assert process.main(["--settings", str(written(tmp_path, archiveUrlFile=str(url)))]) == 2
    assert words in capsys.readouterr().err


def test_without_a_cluster_it_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--settings", str(written(tmp_path)), "--kubeconfig", str(tmp_path / "none")]
    assert process.main(arguments) == 1
    assert "no cluster is known" in capsys.readouterr().err


def test_a_port_that_is_taken_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kubeconfig = tmp_path / "config"
    kubeconfig.write_text(
        json.dumps(
            {
                "current-context": "c",
                "contexts": [{"name": "c", "context": {"cluster": "c", "user": "u"}}],
                "clusters": [{"name": "c", "cluster": {"server": "http://127.0.0.1:1"}}],
                "users": [{"name": "u", "user": {}}],
            }
        )
    )
    with socket.create_server(("0.0.0.0", 0)) as taken:  # noqa: S104
        settings = written(tmp_path, metrics={"port": taken.getsockname()[1]})
        assert process.main(["--settings", str(settings), "--kubeconfig", str(kubeconfig)]) == 1
    assert "metrics.port: cannot listen on port" in capsys.readouterr().err


def test_the_log_in_json() -> None:
    stream = io.StringIO()
    set_up_logs(Settings.model_validate(LEAST | {"logFormat": "json"}), stream)
    logging.getLogger("slamhive.operator").info("watching %s", "lab")
    logging.getLogger("kopf.objects").info("not this")
    try:
        int("oops")
    except ValueError:
        logging.getLogger("slamhive.operator").exception("failed")
    first, second = map(json.loads, stream.getvalue().splitlines())
    assert (first["level"], first["message"]) == ("INFO", "watching lab")
    assert "ValueError: invalid literal" in second["traceback"]


@pytest.fixture
async def health() -> AsyncIterator[HealthServer]:
    api = Api(ApiClient(Configuration(host="http://none")))
    server = HealthServer(Operator(Cluster(api, Settings.model_validate(LEAST)), {}), 0)
    await server.start()
    yield server
    await server.stop()
    await api.close()


async def test_the_kubelet_is_told_when_all_is_listed(health: HealthServer) -> None:
    async with aiohttp.ClientSession(f"http://127.0.0.1:{health.port}") as session:
        seen = [(await session.get(path)).status for path in ("/healthz", "/readyz")]
        assert seen == [200, 503]
        health._op.ready = True
        assert (await session.get("/readyz")).status == 200
