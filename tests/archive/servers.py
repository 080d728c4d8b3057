# SPDX-License-Identifier: Apache-2.0
"""PostgreSQL servers of Debian's packages, each in a temporary folder and listening on a socket alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(frozen=True)
class PostgreSQL:
    """A server in a folder.

    Attributes:
        programs: where its programs are.
        folder: its data, socket and log.
        user: whom it runs as; None: whoever starts it.
    """

    programs: Path
    folder: Path
    user: str | None

    @property
    def url(self) -> str:
        """The URL of its own database."""
        return f"postgresql://slamhive@/postgres?host={self.folder}"

    @property
    def is_running(self) -> bool:
        """Tell whether it was started, and not ended since."""
        return (self.folder / "data" / "postmaster.pid").exists()

    def start(self, *, durable: bool = False) -> None:
        """Start it and wait until it answers.

        Args:
            durable: whether what it has confirmed survives a power cut; this costs time.
        """
        options = f"-c listen_addresses= -c unix_socket_directories={self.folder}"
        options += "" if durable else " -c fsync=off"
        self._call("pg_ctl", "start", "-w", "-s", "-D", "data", "-o", options, "-l", "log")

    def kill(self) -> None:
        """End it as a power cut would."""
        self._call("pg_ctl", "stop", "-s", "-D", "data", "-m", "immediate")

    def make(self) -> None:
        """Make its data folder."""
        self._call("initdb", "-D", "data", "-U", "slamhive", "-A", "trust", "--no-sync")

    def _call(self, program: str, *words: str) -> None:
        subprocess.run(
            [str(self.programs / program), *words],
            user=self.user,
            cwd=self.folder,
            check=True,
            stdout=subprocess.DEVNULL,
            timeout=300,
        )


def programs() -> Path | None:
    """Return the folder of PostgreSQL's programs, None where it is not installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=_version)
    other = shutil.which("initdb")
    found = found or ([Path(other)] if other else [])
    return found[-1].parent if found else None


def _version(path: Path) -> tuple[int, ...]:
    return tuple(int(part) for part in path.parts[-3].split(".") if part.isdecimal())


@contextmanager
def postgresql(*, durable: bool = False) -> Iterator[PostgreSQL | None]:
    """Run a server as long as the context lasts; None where PostgreSQL is not installed."""
    found = programs()
    if found is None:
        yield None
        return
    # Paths of sockets are short, those of pytest's folders are not; and PostgreSQL refuses to run as root.
    folder = Path(tempfile.mkdtemp(prefix="slamhive-postgresql-"))
    user = "nobody" if os.getuid() == 0 else None
    if user is not None:
        shutil.chown(folder, user)
    server = PostgreSQL(found, folder, user)
    try:
        server.make()
        server.start(durable=durable)
        yield server
    finally:
        if server.is_running:
            server.kill()
        shutil.rmtree(folder)
