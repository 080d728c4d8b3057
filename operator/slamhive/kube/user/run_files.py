# SPDX-License-Identifier: Apache-2.0
"""Download of finished runs' files, whole and checked or not at all: ``slamhive fetch --files``.

A run's folder here is laid out like that of a run on this machine. It is filled under another name, which is
taken up again after an interruption, and gets its own when it is whole. Names come from pods: whatever they
are, nothing outside of the folder is written.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import json
import os
import shutil
from collections import deque
from contextlib import aclosing, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.kube.api.errors import ApiError, ServerFault
from slamhive.kube.api.kinds import Kind, Label, Object, Role
from slamhive.kube.builders.common import label_value
from slamhive.kube.user.queries import name_of, status_of
from slamhive.kube.user.sending import sender
from slamhive.model.errors import DataError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from slamhive.kube.user.api import PodSession
    from slamhive.kube.user.connecting import ConnectedCluster
    from slamhive.kube.user.sending import SenderPod

LOG = "log.txt"
TRAJECTORY = "output/trajectory.txt"

_RUN = "run"
_IN_RUN = ("output", "config.yaml", SETTINGS_FOLDER)
_DEPTH = 17
_NAME_BYTES = 255
_CHUNK = 1 << 20
_FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | getattr(os, "O_NOFOLLOW", 0)

_AHEAD = 4
_FAILURES = 3
_PAUSE_SECONDS = 1.0
_LOG_BYTES = 64 << 20
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS})


class Incoming:
    """A file that is being written.

    Args:
        descriptor: where it goes.
        offset: how much of it is there.
    """

    def __init__(self, descriptor: int, offset: int) -> None:
        self._descriptor = descriptor
        self._digest = hashlib.sha256()
        left = offset
        while left:
            data = os.read(descriptor, min(left, _CHUNK))
            if not data:
                raise DataError("the part of it that was here is gone")
            self._digest.update(data)
            left -= len(data)
        os.ftruncate(descriptor, offset)

    def write(self, data: bytes) -> None:
        """Add the next bytes."""
        self._digest.update(data)
        if data.count(0) == len(data):  # a hole of it comes as zeros, and is one here again
            os.ftruncate(self._descriptor, os.lseek(self._descriptor, len(data), os.SEEK_CUR))
            return
        left = memoryview(data)
        while left:
            left = left[os.write(self._descriptor, left) :]

    @property
    def sha256(self) -> str:
        """Return the checksum of all that is there."""
        return self._digest.hexdigest()


class RunFolder:
    """Folder on this machine that a run's files are fetched into.

    Args:
        place: the folder of its sweep.
        name: its name.
        uid: its identity: other runs of that name may have been here before.
    """

    def __init__(self, place: Path, name: str, uid: str) -> None:
        # With the uid: the folder of a former run of that name stays what it is.
        title = f"{name}@{uid[:8]}"
        self.path = place / title
        self._making = place / f".{title}.fetching"

    @property
    def trajectory(self) -> Path:
        """Return the path of its trajectory when it has one."""
        return self.path / _RUN / TRAJECTORY

    @property
    def is_whole(self) -> bool:
        """Tell whether all of it is here."""
        return self.path.is_dir()

    def held(self) -> dict[str, int]:
        """Return the number of bytes here of each file that is not whole, by its path on the volume."""
        found = {}
        for folder, _, names in os.walk(self._making):
            for name in names:
                file = os.path.join(folder, name)  # noqa: PTH118 - many of them
                path = os.path.relpath(file, self._making)
                if not os.path.islink(file):  # noqa: PTH114
                    found[path.removeprefix(f"{_RUN}/")] = os.path.getsize(file)  # noqa: PTH202
        return found

    @contextmanager
    def incoming(self, path: str, offset: int = 0) -> Iterator[Incoming]:
        """Write a file from an offset on.

        Raises:
            DataError: its path may lead elsewhere, or is no plain one.
            OSError: the disk refuses.
        """
        file = self._file(path)
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(file, _FLAGS, 0o644)
        try:
            yield Incoming(descriptor, offset)
        finally:
            os.close(descriptor)

    def drop(self, path: str) -> None:
        """Remove a file that is not what it should be."""
        self._file(path).unlink(missing_ok=True)

    def finish(self) -> None:
        """Give the folder its name: all of it is there.

        Raises:
            OSError: the disk refuses.
        """
        # Renamed last: a folder under its own name is whole.
        self._making.mkdir(parents=True, exist_ok=True)
        self._making.rename(self.path)

    def forget(self) -> None:
        """Remove what is here of a folder that is not whole."""
        shutil.rmtree(self._making, ignore_errors=True)

    def _file(self, path: str) -> Path:
        parts = path.split("/")
        if path == LOG:
            return self._making / LOG
        if len(parts) > _DEPTH or parts[0] in {_RUN, LOG} or not all(map(_is_plain, parts)):
            raise DataError("its name is not that of a plain file in the folder")
        return self._making.joinpath(*((_RUN,) if parts[0] in _IN_RUN else ()), *parts)


def _is_plain(part: str) -> bool:
    """Tell whether a part of a path names a file or folder, on any system and on a terminal."""
    return (
        part not in {"", ".", ".."}
        and part.isprintable()
        and "\\" not in part
        and len(part.encode("utf-8", "replace")) <= _NAME_BYTES
    )


@dataclass(frozen=True)
class WantedRun:
    """A finished run whose files are to be here.

    Attributes:
        run: the MappingRun.
        sweep: the sweep that it belongs to here.
    """

    run: Mapping[str, Any]
    sweep: str

    @property
    def name(self) -> str:
        """Return its name."""
        return name_of(self.run)

    @property
    def uid(self) -> str:
        """Return its identity."""
        return str(self.run["metadata"]["uid"])

    @property
    def folder(self) -> str:
        """Return its folder on the results volume; empty when it never had one."""
        return str(status_of(self.run).get("folder") or "")

    @property
    def trajectory_sha256(self) -> str | None:
        """Return the checksum of its trajectory; None when it has none."""
        return (status_of(self.run).get("trajectory") or {}).get("sha256")


@dataclass
class Filed:
    """Result of fetching the files of runs: folders filled, bytes, problems and remarks.

    Attributes:
        runs: how many folders were filled.
        size: bytes that came.
        problems: a sentence about each run whose files could not be had.
        remarks: sentences about what was left out.
    """

    runs: int = 0
    size: int = 0
    problems: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


class Filing:
    """Fetches files of runs.

    Args:
        cluster: where they are.
        place: the folder of runs here; each sweep has one in it.
        keep: called with each run whose folder is whole.
        step: called with (runs done, of how many, bytes) as it goes on.
        tell: told what is waited for.
    """

    def __init__(
        self,
        cluster: ConnectedCluster,
        place: Path,
        *,
        keep: Callable[[WantedRun, RunFolder], None],
        step: Callable[[int, int, int], None],
        tell: Callable[[str], None],
    ) -> None:
        self._cluster = cluster
        self._place = place
        self._keep = keep
        self._step = step
        self._tell = tell
        self._filed = Filed()
        self._total = 0

    async def fetch(self, wanted: Sequence[WantedRun]) -> Filed:
        """Fetch the files of some runs; folders that are here already are not fetched again.

        Raises:
            ClusterError: there can be no pod that sends them.
            SystemFault: nothing more can be written here.
            ApiError: the cluster does not answer any more.
        """
        todo: deque[WantedRun] = deque()
        for item in wanted:
            folder = self._folder(item)
            if folder.is_whole:
                self._keep(item, folder)
            elif item.folder:
                todo.append(item)
        self._total = len(todo)
        if todo:
            async with sender(self._cluster, [item.run for item in todo], self._tell) as pod:
                await self._take_all(pod, todo)
        return self._filed

    def _folder(self, item: WantedRun) -> RunFolder:
        return RunFolder(self._place / item.sweep, item.name, item.uid)

    async def _take_all(self, pod: SenderPod, todo: deque[WantedRun]) -> None:
        failures = 0
        while todo:
            before = self._filed.size, len(todo)
            try:
                async with pod.session() as session:
                    await self._converse(session, todo)
            except ServerFault:
                # A connection that brought anything is no failure: long transfers may break as often as they
                # like.
                failures = 0 if (self._filed.size, len(todo)) != before else failures + 1
                if failures >= _FAILURES:
                    raise
                await asyncio.sleep(_PAUSE_SECONDS)

    async def _converse(self, session: PodSession, todo: deque[WantedRun]) -> None:
        """Take one folder after the other, asking for the next ones meanwhile."""
        asked = 0
        while todo:
            # Asked ahead, so that the pod has the next folder at hand while this one arrives.
            while asked < min(_AHEAD, len(todo)):
                item = todo[asked]
                request = {"folder": item.folder, "have": self._folder(item).held()}
                await session.send(json.dumps(request).encode() + b"\n")
                asked += 1
            try:
                await self._take(session, todo[0])
            except OSError as error:
                raise SystemFault(f"{self._place}: {error.strerror or error}") from error
            todo.popleft()
            asked -= 1
            self._progress(todo)

    def _progress(self, todo: deque[WantedRun]) -> None:
        self._step(self._total - len(todo), self._total, self._filed.size)

    async def _take(self, session: PodSession, item: WantedRun) -> None:
        """Take a run's folder; what is wrong with it is noted."""
        folder, problems = self._folder(item), []
        checksums: dict[str, str] = {}
        while not (told := _parsed(await session.line())).get("end"):
            path = str(told.get("path"))
            try:
                checksums[path] = await self._file(session, folder, told)
            except DataError as error:
                self._filed.remarks.append(f"{item.name}: {path!r} is left out: {error}")
            except _Damaged as error:
                problems.append(f"{path}: {error}")
        for path, why in told.get("left") or ():
            self._filed.remarks.append(f"{item.name}: {str(path)!r} is left out: {why}")
        if told.get("problem"):
            problems.append(str(told["problem"]))
        # The checksum stands in the run's status, which the programs on the volume can't change.
        elif (wanted := item.trajectory_sha256) and checksums.get(TRAJECTORY) != wanted:
            folder.drop(TRAJECTORY)
            problems.append("the trajectory on the results volume is not the one that the run reported")
        if problems:
            self._filed.problems.append(f"{item.name}: its files can't be fetched: {'; '.join(problems)}")
            return
        await self._log(item, folder)
        folder.finish()
        self._filed.runs += 1
        self._keep(item, folder)

    async def _file(self, session: PodSession, folder: RunFolder, told: Object) -> str:
        """Take one file and return its checksum.

        Raises:
            DataError: it is not to be written; it was passed over.
            _Damaged: it is not what was sent.
        """
        path, size, offset = told.get("path"), told.get("size"), told.get("offset")
        if not (isinstance(path, str) and isinstance(size, int) and isinstance(offset, int)):
            raise _nonsense(told)
        if not 0 <= offset <= size:
            raise _nonsense(told)
        left = size - offset
        try:
            with folder.incoming(path, offset) as file:
                async with aclosing(session.take(left)) as pieces:
                    async for data in pieces:
                        left -= len(data)
                        file.write(data)
                        self._filed.size += len(data)
                here = file.sha256
        except (DataError, OSError) as error:
            if isinstance(error, OSError) and error.errno in _FULL:
                raise
            # What follows in the stream is the next file: this one has to be read to its end.
            async for _ in session.take(left):
                pass
            await session.line()
            raise DataError(str(getattr(error, "strerror", None) or error)) from None
        end = _parsed(await session.line())
        if end.get("sha256") != here:
            folder.drop(path)
            raise _Damaged(str(end.get("problem") or "it arrived damaged"))
        return here

    async def _log(self, item: WantedRun, folder: RunFolder) -> None:
        """Add what the algorithm printed: all of it while its pod is there, else the lines that were kept."""
        kept = str(status_of(item.run).get("logTail") or "")
        with folder.incoming(LOG) as file:
            try:
                size = await self._pods_log(item, file.write)
            except ApiError:
                size = 0
        if not size:
            with folder.incoming(LOG) as file:
                file.write(f"{kept}\n".encode() if kept else b"")

    async def _pods_log(self, item: WantedRun, write: Callable[[bytes], None]) -> int:
        api, namespace = self._cluster.api, self._cluster.namespace
        labels = f"{Label.RUN}={label_value(item.name)},{Label.ROLE}={Role.RUN}"
        pods, _ = await api.list(Kind.POD, namespace, labels=labels)
        uid, size = item.folder.rpartition("/")[2], 0
        for pod in pods:
            if pod["metadata"]["uid"] != uid:
                continue
            async with aclosing(api.log_lines(namespace, name_of(pod), "algorithm")) as lines:
                async for _, text in lines:
                    data = f"{text}\n".encode()
                    size += len(data)
                    if size > _LOG_BYTES:
                        break
                    write(data)
        return size


class _Damaged(Exception):  # noqa: N818 - a state of a file
    """A file did not arrive as it was sent."""


def _parsed(line: bytes) -> Object:
    try:
        told = json.loads(line)
    except (ValueError, RecursionError):
        told = None
    if not isinstance(told, dict):
        raise _nonsense(line[:200])
    return told


def _nonsense(what: object) -> ServerFault:
    return ServerFault(
        f"the pod that sends the files sent what can't be understood: {what!r}",
        verb="get",
        resource="pods/exec",
    )
