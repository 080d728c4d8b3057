# SPDX-License-Identifier: Apache-2.0
"""An archive in PostgreSQL that is killed under a dashboard and comes back."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import pytest

from slamhive.archive import Archive
from slamhive.dashboard.sources import Workstation

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

pytest.importorskip("psycopg")


@dataclass
class Server:
    """A PostgreSQL server in a folder, listening on a socket alone."""

    programs: Path
    folder: Path
    user: str | None

    @property
    def url(self) -> str:
        return f"postgresql://slamhive@/postgres?host={self.folder}"

    def call(self, program: str, *words: str) -> None:
        command = [str(self.programs / program), *words]
        subprocess.run(command, user=self.user, cwd=self.folder, check=True, capture_output=True)

    def start(self) -> None:
        options = f"-c listen_addresses= -c unix_socket_directories={self.folder} -c fsync=off"
        self.call("pg_ctl", "start", "-w", "-s", "-D", "data", "-o", options, "-l", "log")

    def kill(self) -> None:
        """End it as a power cut would."""
        self.call("pg_ctl", "stop", "-s", "-D", "data", "-m", "immediate")


@pytest.fixture
def server() -> Iterator[Server]:
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    if not programs:
        pytest.skip("no PostgreSQL here: apt-get install postgresql")
    # Paths of sockets are short, those of pytest's folders are not; and PostgreSQL refuses to run as root.
    folder = Path(tempfile.mkdtemp(prefix="slamhive-dashboard-"))
    user = "nobody" if os.getuid() == 0 else None
    if user is not None:
        shutil.chown(folder, user)
    made = Server(programs[-1], folder, user)
    made.call("initdb", "-D", "data", "-U", "slamhive", "-A", "trust", "--no-sync")
    made.start()
    yield made
    if (folder / "data" / "postmaster.pid").exists():
        made.kill()
    shutil.rmtree(folder)


async def until(found: Callable[[], Awaitable[bool]], seconds: float = 120) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not await found():
        assert time.monotonic() < deadline
        await anyio.sleep(0.1)


async def test_a_killed_archive_stays_on_view_and_is_followed_again(
    server: Server, open_app: Callable[..., Any], make_run: Callable[..., Any]
) -> None:
    with Archive.open(server.url) as archive:
        archive.put_runs(make_run(number) for number in range(3))
    async with open_app(Workstation(server.url)) as client:

        async def problems(count: int) -> bool:
            return len((await client.get(""))["problems"]) == count

        async def shown(count: int) -> bool:
            return bool((await client.get("/runs"))["total"] == count)

        await until(lambda: shown(3))
        server.kill()
        await until(lambda: problems(1))
        assert await shown(3)
        board = (await client.get("/analysis/leaderboard"))["boards"]
        assert board
        # What needs the database itself says that it is away.
        assert (await client.raw.get("/api/v1/runs/uid-000")).status_code == 503
        assert (await client.raw.get("/readyz")).status_code == 200
        server.start()
        await until(lambda: problems(0))
        with Archive.open(server.url) as archive:
            archive.put_run(make_run(4))
        await until(lambda: shown(4))
        assert (await client.get("/runs/uid-004"))["uid"] == "uid-004"
