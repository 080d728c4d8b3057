# SPDX-License-Identifier: Apache-2.0
"""Processes that a dead supervisor left behind in a run folder: found and ended.

The runner and the supervisor call it.

`process.json` names supervisor and algorithm by pid and start time, the boot they belong to, and the cgroup.
Every process of a run carries `SLAMHIVE_SUPERVISOR=<pid>:<start>` in its environment: by that, by the
session, by the cgroup and by descent from any of these all of them are found, and nobody else.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass

from slamhive.monitor.measuring.cgroup import kill_frozen, remove_directories
from slamhive.monitor.measuring.hierarchy import directory_processes
from slamhive.monitor.measuring.processes import (
    ProcessIdentity,
    boot_id,
    descendants,
    end_processes,
    identify,
    is_alive,
    pid_namespace,
    read_file,
    send,
    stat_fields,
)

TOKEN = "SLAMHIVE_SUPERVISOR"  # noqa: S105 - a name, no secret
_SIGTERM = 15
_END_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class ProcessRecord:
    """Contents of process.json: the supervisor, algorithm and cgroups of a run, to find what is left.

    Attributes:
        boot: The boot it belongs to; after another one nothing of it can be alive.
        namespace: The pid namespace its pids belong to.
        supervisor: The supervisor.
        algorithm: The algorithm's first process, None before it started.
        cgroups: The run's cgroup directories.
    """

    boot: str
    namespace: int
    supervisor: ProcessIdentity
    algorithm: ProcessIdentity | None
    cgroups: tuple[str, ...]

    @property
    def token(self) -> str:
        """Value of SLAMHIVE_SUPERVISOR in the environment of the run's processes."""
        return f"{self.supervisor.pid}:{self.supervisor.start}"

    def write(self, path: str) -> None:
        """Write the record, never half of it."""
        values = asdict(self)
        for name in ("supervisor", "algorithm"):
            process = getattr(self, name)
            values[name] = None if process is None else process._asdict()
        write_atomically(path, json.dumps(values, indent=2) + "\n", durable=False)

    @classmethod
    def read(cls, path: str) -> ProcessRecord | None:
        """Read a record, None if there is none.

        Raises:
            ValueError: The file is no such record.
        """
        try:
            data = read_file(path)
        except FileNotFoundError:
            return None
        except IsADirectoryError:  # the algorithm may have put one there
            raise ValueError(f"{path} is a folder, no record of a run's processes; remove it") from None
        try:
            values = json.loads(data)
            algorithm = values["algorithm"]
            return cls(
                boot=str(values["boot"]),
                namespace=int(values["namespace"]),
                supervisor=_identity(values["supervisor"]),
                algorithm=None if algorithm is None else _identity(algorithm),
                cgroups=tuple(map(str, values["cgroups"])),
            )
        except (ValueError, TypeError, KeyError):
            raise ValueError(f"{path} is no record of a run's processes; remove it") from None


def find_orphans(process_json: str | os.PathLike[str]) -> list[ProcessIdentity]:
    """Return the living processes of a run, its supervisor first if that lives.

    Args:
        process_json: The run's process.json; no such file means no processes.

    Raises:
        ValueError: The file is no such record.
    """
    record = ProcessRecord.read(os.fspath(process_json))
    return [] if record is None else _living(record)


def end_orphans(process_json: str | os.PathLike[str]) -> list[ProcessIdentity]:
    """End all processes of a run and remove its cgroup.

    A supervisor that still lives is asked first, so that it ends its run by itself and says so.

    Args:
        process_json: The run's process.json.

    Returns:
        What could not be ended.

    Raises:
        ValueError: The file is no such record.
    """
    record = ProcessRecord.read(os.fspath(process_json))
    if record is None or not _here(record):
        return []
    # A supervisor that lives knows its run better than its record does, and writes a summary.
    if send(record.supervisor, _SIGTERM):
        deadline = time.monotonic() + _END_SECONDS
        while is_alive(record.supervisor) and time.monotonic() < deadline:
            time.sleep(0.005)
    kill_frozen(record.cgroups)
    left = end_processes(lambda: _living(record), _END_SECONDS)
    remove_directories(record.cgroups)
    return left


def write_atomically(path: str, text: str, *, durable: bool = True) -> None:
    """Write a file so that others see all of it or nothing; durable: a power cut included.

    Raises:
        OSError: The disk refuses; what was there stays, and the error names the file.
    """
    temporary = f"{path}.{os.getpid()}.tmp"
    try:
        with open(temporary, "w", encoding="utf-8") as file:  # noqa: PTH123
            file.write(text)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.replace(temporary, path)  # noqa: PTH105
    except OSError as error:
        with suppress(OSError):
            os.unlink(temporary)  # noqa: PTH108
        error.filename = path  # a write has none
        raise


def _here(record: ProcessRecord) -> bool:
    # Elsewhere the pids of the record belong to strangers, who must not be ended.
    return record.boot == boot_id() and record.namespace == pid_namespace()


def _living(record: ProcessRecord) -> list[ProcessIdentity]:
    if not _here(record):
        return []
    roots: dict[int, None] = {}
    if is_alive(record.supervisor):
        roots[record.supervisor.pid] = None
    for directory in record.cgroups:
        roots.update(dict.fromkeys(directory_processes(directory)))
    token = f"{TOKEN}={record.token}".encode()
    # A session's number is free for others once its leader is gone: only a living leader vouches for it.
    session = record.algorithm.pid if record.algorithm and is_alive(record.algorithm) else None
    for name in os.listdir("/proc"):  # noqa: PTH208
        if name.isdigit() and _belongs(name, token, session):
            roots[int(name)] = None
    roots.pop(os.getpid(), None)
    everyone = dict.fromkeys([*roots, *descendants(roots)])
    return [found for found in map(identify, everyone) if found is not None]


def _belongs(pid: str, token: bytes, session: int | None) -> bool:
    try:
        if session is not None and int(stat_fields(read_file(f"/proc/{pid}/stat"))[3]) == session:
            return True
        return token in read_file(f"/proc/{pid}/environ").split(b"\0")
    except (OSError, ValueError):
        return False


def _identity(values: dict[str, int]) -> ProcessIdentity:
    return ProcessIdentity(int(values["pid"]), int(values["start"]))
