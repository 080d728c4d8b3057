# SPDX-License-Identifier: Apache-2.0
"""The dashboard's pod: shows a sweep while it runs, may write nothing, comes back after any fault."""

from __future__ import annotations

import json
import os
import signal
import ssl
import threading
from contextlib import contextmanager
from itertools import product
from typing import TYPE_CHECKING, Any

import httpx
import pytest
import yaml
from onnode.lab import OPERATOR
from onnode.node import processes
from testcluster.access import until

from slamhive.kube.api.kinds import OUR_KINDS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from onnode.lab import Lab

POD = ("-l", "app.kubernetes.io/component=dashboard")
BROKEN = (httpx.HTTPError, AssertionError, ValueError)


@pytest.fixture
def server(lab: Lab) -> tuple[str, ssl.SSLContext]:
    return lab.cluster.server()


class Page:
    """Client that acts as a page: it asks the API, follows the events, and reconnects when they break off.

    Args:
        client: asks the dashboard by way of the API server.
    """

    def __init__(self, client: httpx.Client) -> None:
        self._client = client
        self.seen: list[dict[str, Any]] = []
        self.connections = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)

    def get(self, path: str) -> Any:
        """Return the answer to a question to the API."""
        answer = self._client.get(f"api/v1/{path}")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def file(self, path: str) -> str:
        """Return a file of the pages."""
        answer = self._client.get(path)
        assert answer.status_code == 200, answer.text
        return answer.text

    @contextmanager
    def open(self) -> Iterator[Page]:
        """Follow the events meanwhile."""
        self._thread.start()
        try:
            yield self
        finally:
            self._ended.set()
            self._thread.join(30)

    def _follow(self) -> None:
        while not self._ended.is_set():
            try:
                with self._client.stream("GET", "api/v1/events", timeout=30) as answer:
                    assert answer.status_code == 200
                    self.connections += 1
                    for line in answer.iter_lines():
                        if line.startswith("data: "):
                            self.seen.append(json.loads(line.removeprefix("data: ")))
                        if self._ended.is_set():
                            return
            except BROKEN:
                self._ended.wait(0.5)


@pytest.fixture
def page(lab: Lab, server: tuple[str, ssl.SSLContext]) -> Iterator[Page]:
    address, context = server
    place = f"{address}/api/v1/namespaces/{lab.namespace}/services/slamhive-dashboard:http/proxy/"
    with httpx.Client(base_url=place, verify=context, timeout=30) as client:
        yield Page(client)


def of_sweep(page: Page, name: str) -> dict[str, Any]:
    found = [item for item in page.get("sweeps")["items"] if item["name"] == name]
    return found[0] if found else {"phases": {}, "live": None}


def test_a_running_sweep_is_seen_live_with_its_files_and_ground_truth(lab: Lab, page: Page) -> None:
    lab.begin("seen", 4)
    with page.open():
        until(lambda: page.seen and page.seen[-1]["counts"]["live"], "live runs among the events", 180)
        # Those may be runs of other tests' sweeps.
        until(lambda: of_sweep(page, "seen")["live"] is True, "the sweep among the live ones", 240)
        lab.completed("seen", 300)
        until(lambda: of_sweep(page, "seen")["phases"] == {"Succeeded": 4}, "the sweep's end", 240)
        until(lambda: not of_sweep(page, "seen")["live"], "the sweep to be over", 240)
    assert page.connections == 1
    assert len({event["revision"] for event in page.seen}) >= 3

    def measured() -> Any:
        items = page.get("runs?sweep=seen&evaluation=se3&columns=uid,ate.rmse,algorithm")["items"]
        return items if len(items) == 4 else None

    runs = until(measured, "results of all runs", 240)
    expected = {run["metadata"]["uid"]: run["status"]["results"][0] for run in lab.runs("seen")}
    assert {run["uid"]: run["ate.rmse"] for run in runs} == {
        uid: result["ate"]["rmse"] for uid, result in expected.items()
    }
    uid = runs[0]["uid"]
    assert {"output/trajectory.txt", "usage.csv"} <= {
        item["path"] for item in page.get(f"runs/{uid}/files")["items"]
    }
    drawn = page.get(f"runs/{uid}/trajectory")
    assert drawn["notes"] == []
    assert drawn["reference"]["x"]
    assert page.get(f"runs/{uid}/usage")["cpu"]
    assert 'id="app"' in page.file("")
    assert "import" in page.file("app.js")


def test_its_account_is_refused_every_write(lab: Lab, server: tuple[str, ssl.SSLContext]) -> None:
    token = lab.kubectl("create", "token", "slamhive-dashboard").strip()
    place = f"/apis/slamhive.io/v1alpha1/namespaces/{lab.namespace}"
    plain = ssl.create_default_context(cadata=ca(lab))
    with httpx.Client(
        base_url=server[0], verify=plain, headers={"Authorization": f"Bearer {token}"}
    ) as client:
        for kind, part in product([kind.plural for kind in OUR_KINDS], ["", "/x", "/x/status"]):
            for method in ("POST", "PUT", "PATCH", "DELETE"):
                body = {"apiVersion": "slamhive.io/v1alpha1", "metadata": {"name": "x"}}
                given = {"Content-Type": "application/merge-patch+json"} if method == "PATCH" else None
                answer = client.request(method, f"{place}/{kind}{part}", json=body, headers=given)
                # A method that the API does not have at all is refused before the account is looked at.
                assert answer.status_code in {403, 405}, (method, kind, part, answer.text)
            assert client.get(f"{place}/{kind}").status_code == 200
        for path in ("secrets", "pods", "configmaps", "serviceaccounts/slamhive-operator/token"):
            assert client.get(f"/api/v1/namespaces/{lab.namespace}/{path}").status_code == 403
        assert client.get("/apis/slamhive.io/v1alpha1/namespaces/default/sweeps").status_code == 403


def ca(lab: Lab) -> str:
    """Return the certificate that the API server's is signed by, as every namespace has it."""
    return str(lab.get("configmap", "kube-root-ca.crt")["data"]["ca.crt"])


def test_a_page_goes_on_after_dashboard_and_operator_were_killed(lab: Lab, page: Page) -> None:
    lab.begin("through", 6)

    def done(count: int) -> bool:
        try:
            return int(of_sweep(page, "through")["phases"].get("Succeeded", 0)) >= count
        except BROKEN:
            return False

    with page.open():
        until(lambda: done(1), "the first run", 240)
        (pod,) = lab.get("pods", *POD)["items"]
        (process,) = processes(pod["metadata"]["uid"], "slamhive.dashboard")
        os.kill(process, signal.SIGKILL)
        (operator,) = lab.get("pods", *OPERATOR)["items"]
        (process,) = processes(operator["metadata"]["uid"], "slamhive.kube")
        os.kill(process, signal.SIGKILL)
        until(lambda: page.connections >= 2, "the page to be connected again", 240)
        until(lambda: done(3), "three runs", 240)
        lab.kubectl("delete", "pod", *POD, "--wait=false")
        lab.completed("through", 400)
        until(lambda: done(6), "all runs on the page", 240)

        def told() -> bool:
            return page.seen[-1]["counts"]["live"] == 0 and not page.seen[-1]["problems"]

        until(told, "the last event to say that nothing runs", 240)
    pods = lab.get("pods", *POD)["items"]
    assert pod["metadata"]["uid"] not in {one["metadata"]["uid"] for one in pods}
    deployment = yaml.safe_load(lab.kubectl("get", "deployment", "slamhive-dashboard", "-o", "yaml"))
    assert deployment["status"]["readyReplicas"] == 1
