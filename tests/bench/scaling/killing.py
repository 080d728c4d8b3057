# SPDX-License-Identifier: Apache-2.0
"""Kills at random: of operator, API server, etcd and database, and of all the operator's watches."""

from __future__ import annotations

import asyncio
import signal
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from faultlab.proxy import Trouble, proxied
from testcluster.access import until

from slamhive.kube.api.client import Api

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from random import Random

    import operating
    from faultlab.proxy import Proxy
    from servers import PostgreSQL
    from testcluster.access import Cluster
    from testcluster.local import Local

LONGEST_AWAY_SECONDS = 5.0
_READY_SECONDS = 600.0


class Watches:
    """Connections of an operator that go through a proxy and can be cut."""

    def __init__(self, proxy: Proxy, loop: asyncio.AbstractEventLoop) -> None:
        self._proxy = proxy
        self._loop = loop

    def cut(self) -> int:
        """Break all watches; returns their number."""

        async def cut() -> int:
            return self._proxy.cut()

        return asyncio.run_coroutine_threadsafe(cut(), self._loop).result(30)


@contextmanager
def watches_through(access: Cluster, kubeconfig: Path) -> Iterator[Watches]:
    """Have a proxy as long as the context lasts; its kubeconfig is written."""
    ready, over = threading.Event(), threading.Event()
    made: list[Watches] = []

    async def serve() -> None:
        api = await Api.connect(access.kubeconfig)
        async with proxied(api, Trouble(), kubeconfig) as proxy:
            made.append(Watches(proxy, asyncio.get_running_loop()))
            ready.set()
            await asyncio.to_thread(over.wait)
        await api.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()), name="proxy", daemon=True)
    thread.start()
    if not ready.wait(60):
        raise TimeoutError("the proxy between operator and API server did not begin")
    try:
        yield made[0]
    finally:
        over.set()
        thread.join(30)


@dataclass
class Killer:
    """Kills a part whenever a certain number of runs has ended.

    Attributes:
        due: numbers of ended runs at which something is killed, ascending.
        parts: what is killed by turns, by name.
        done: what was killed when, and for how many seconds it was away.
    """

    due: list[int]
    parts: dict[str, Callable[[float], None]]
    random: Random
    done: list[dict[str, object]] = field(default_factory=list)

    def look(self, ended: int) -> None:
        """Kill what is due after so many runs."""
        while self.due and ended >= self.due[0]:
            self.due.pop(0)
            name = [*self.parts][len(self.done) % len(self.parts)]
            seconds = self.random.uniform(0.0, LONGEST_AWAY_SECONDS)
            began = time.monotonic()
            self.parts[name](seconds)
            self.done.append({"ended": ended, "part": name, "away": round(time.monotonic() - began, 1)})
            print(f"killed {name} after {ended} runs", flush=True)


def parts(
    local: Local,
    access: Cluster,
    process: operating.OperatorProcess,
    watches: Watches,
    database: PostgreSQL | None,
) -> dict[str, Callable[[float], None]]:
    """Return the parts that can be killed; each is started again after some seconds."""

    def operator(seconds: float) -> None:
        process.end(signal.SIGKILL)
        time.sleep(seconds)
        process.start(_READY_SECONDS)

    def program(name: str, seconds: float) -> None:
        local.stop(name)
        time.sleep(seconds)
        local.start(name)
        until(
            lambda: access.run("get", "--raw", "/readyz").returncode == 0, "the API server", _READY_SECONDS, 1
        )
        # kwok 0.8 gives a pod up whose patch failed as etcd went away, where a kubelet tries again; it looks
        # once more at what changes.
        going = "--field-selector=status.phase!=Succeeded,status.phase!=Failed"
        access.run("annotate", "pods", "--all-namespaces", going, "--overwrite", f"seen={time.time():.0f}")

    def archive(seconds: float) -> None:
        if database is not None:
            database.kill()
            time.sleep(seconds)
            database.start()

    found: dict[str, Callable[[float], None]] = {
        "operator": operator,
        "API server": lambda seconds: program("apiserver", seconds),
        "watches": lambda _: print(f"cut {watches.cut()} watches", flush=True),
        "etcd": lambda seconds: program("etcd", seconds),
    }
    return found | ({"database": archive} if database is not None else {})
