# SPDX-License-Identifier: Apache-2.0
"""A second Sweep beside a large one: edited, suspended, resumed, cancelled and deleted as people do it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

from scaling.points import large_sweep
from testcluster.access import until

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.access import Cluster

NAME = "beside"
LIMIT_SECONDS = 60.0
_LONGEST_SECONDS = 900.0
_PAUSE_SECONDS = 0.5


class Beside:
    """A Sweep beside the large one.

    Args:
        access: the cluster.
        where: namespace of both.
        count: number of its points.
        first: parameter of its first point.
    """

    def __init__(self, access: Cluster, where: str, count: int, first: int) -> None:
        self._access = access
        self._where = where
        self._count = count
        self._first = first
        self.seconds: dict[str, float] = {}

    def run(self) -> list[str]:
        """Do one after the other; returns what took too long, a sentence each."""
        body = large_sweep(NAME, self._count, 8, retained=self._count, first=self._first)
        self._step("made", lambda: self._access.apply(body, namespace=self._where), self._has_ended(1))
        wider = {"parallelism": 16, "maxFailures": 100, "budget": {"wallTime": "48h", "cpuHours": 1000}}
        self._step("edited", lambda: self._edit(**wider), self._is_observed)
        self._step("suspended", lambda: self._edit(suspend=True), self._is_suspended)
        ended = _ended(self._status())
        self._step("resumed", lambda: self._edit(suspend=False), self._has_ended(ended + 1))
        self._step("cancelled", self._cancel, self._is_suspended)
        self._step("deleted", self._delete, self._is_gone)
        return [
            f"a Sweep of {self._count} beside was {step} after {seconds:.0f} s, limit {LIMIT_SECONDS:g} s"
            for step, seconds in self.seconds.items()
            if seconds > LIMIT_SECONDS
        ]

    def _step(self, name: str, act: Callable[[], None], is_so: Callable[[], bool]) -> None:
        began = time.monotonic()
        act()
        until(is_so, f"the Sweep beside to be {name}", _LONGEST_SECONDS, _PAUSE_SECONDS)
        self.seconds[name] = round(time.monotonic() - began, 1)
        print(f"a Sweep of {self._count} beside was {name} after {self.seconds[name]:g} s", flush=True)

    def _edit(self, **spec: Any) -> None:
        self._access.patch("sweep", NAME, {"spec": spec}, self._where)

    def _cancel(self) -> None:
        command = "from slamhive.cli.main import main; main()"
        subprocess.run(
            [sys.executable, "-P", "-c", command, "cancel", NAME, "--namespace", self._where],
            env=self._access.environment,
            check=True,
            stdout=subprocess.DEVNULL,
        )

    def _delete(self) -> None:
        self._access.delete("sweep", NAME, self._where)

    def _body(self) -> dict[str, Any]:
        answer = self._access.run("get", "sweep", NAME, "-n", self._where, "-o", "json")
        found: dict[str, Any] = json.loads(answer.stdout) if answer.returncode == 0 else {}
        return found

    def _status(self) -> dict[str, Any]:
        return self._body().get("status") or {}

    def _has_ended(self, count: int) -> Callable[[], bool]:
        return lambda: _ended(self._status()) >= count

    def _is_observed(self) -> bool:
        body = self._body()
        seen = (body.get("status") or {}).get("observedGeneration")
        return seen is not None and seen == body["metadata"]["generation"]

    def _is_suspended(self) -> bool:
        status = self._status()
        told = {item["type"]: item["status"] for item in status.get("conditions") or ()}
        return told.get("Suspended") == "True" and status.get("running") == 0

    def _is_gone(self) -> bool:
        chosen = f"slamhive.io/sweep={NAME}"
        left = self._access.run("get", "mappingruns,jobs,pods", "-n", self._where, "-l", chosen, "-o", "name")
        return left.returncode == 0 and not left.stdout.strip()


def _ended(status: dict[str, Any]) -> int:
    return int((status.get("succeeded") or 0) + (status.get("failed") or 0))
