# SPDX-License-Identifier: Apache-2.0
"""Programs that prepare recordings on a workstation: of a Dataset's folder, or images, under a supervisor.

They run where algorithms do, in an environment or a container, and within bounds as these::

    preparing/KEY/in/          what the program is given, read-only for a container
    preparing/KEY/own/out/     what it writes; own/home and own/tmp beside it count towards its disk, too
    preparing/KEY/log.txt      what it printed, kept where it failed
"""

from __future__ import annotations

import os
import platform
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.contract.environment import THREAD_VARIABLES, own_variables
from slamhive.data.files.erasing import erase
from slamhive.data.recordings.entries import file_sha256
from slamhive.local.home.catalog import AlgorithmEntry
from slamhive.local.programs.containers import abandon
from slamhive.local.programs.containerwords import RUN as IN_CONTAINER
from slamhive.local.programs.containerwords import PreparingLimits
from slamhive.local.programs.environments import ProgramPart, digest_of, source_files
from slamhive.local.programs.executors import CONTAINER
from slamhive.local.programs.interpreters import interpreter
from slamhive.local.programs.supervision import Supervised
from slamhive.local.programs.unavailable import ImageMissing, Unavailable
from slamhive.model.algorithm import Algorithm, AlgorithmSpec, Mode, Output, Pace
from slamhive.model.base import ObjectMeta, quantity, seconds
from slamhive.model.errors import DataError, InputError, SystemFault
from slamhive.model.results import Reason
from slamhive.model.sensors import SensorMode
from slamhive.model.variant import program_title
from slamhive.monitor import SupervisorSpec, end_orphans

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from slamhive.local.home.catalog import DatasetPlace
    from slamhive.local.home.folder import Home
    from slamhive.local.programs.executors import Programs
    from slamhive.model.variant import PreparingProgram

_LOG = "log.txt"
_LOOK_SECONDS = 0.5
_SPARE_FILES = 1000
_TAIL_LINES, _TAIL_LENGTH = 5, 600
_TO_PROGRAMS = ("LD_LIBRARY_PATH", "SSL_CERT_FILE", "TZ")


@dataclass(frozen=True)
class Preparer:
    """A preparing program of a Dataset on this machine.

    Attributes:
        home: where its folder is.
        programs: makes environments, and finds images.
        dataset: the Dataset.
        name: its name.
        program: what the Dataset says of it.
        entry: it as if it were an algorithm's program, which is made ready in the same ways.
        digest: what tells it from others.
        failed: what programs of this command failed of, by the names of their folders.
    """

    home: Home
    programs: Programs
    dataset: str
    name: str
    program: PreparingProgram
    entry: AlgorithmEntry
    digest: str
    failed: dict[str, str]

    @classmethod
    def of(
        cls, home: Home, programs: Programs, place: DatasetPlace, name: str, failed: dict[str, str]
    ) -> Preparer:
        """Return a Dataset's program of a name.

        Raises:
            InputError: there is none, or it can't run here.
        """
        program = place.dataset.spec.preparation(name)
        spec = AlgorithmSpec(
            image=program.image,
            command=program.command,
            local=program.local,
            modes=[Mode(name=SensorMode.INERTIAL)],
            output=Output(frame="body"),
        )
        algorithm = Algorithm(metadata=ObjectMeta(name=name), spec=spec)
        entry = AlgorithmEntry(algorithm, place.folder)
        try:
            digest = _digest(programs, entry)
        except (Unavailable, ImageMissing) as error:
            raise InputError(f"{program_title(name, place.dataset.name)} can't run here: {error}") from None
        return cls(home, programs, place.dataset.name, name, program, entry, digest, failed)

    @property
    def called(self) -> str:
        """Return the name for it in sentences."""
        return program_title(self.name, self.dataset)

    def work(self, key: str) -> Path:
        """Return an empty folder for it.

        Raises:
            InputError: it failed before, for another run of this command: it may take an hour to fail again.
            SystemFault: what an earlier one left can't be removed.
        """
        work = self.home.folder("preparing") / key[:32]
        if work.name in self.failed:
            raise InputError(self.failed[work.name])
        with suppress(ValueError):  # no record: nobody is named by it
            end_orphans(work / "process.json")
        if work.exists() and not erase(work):
            raise SystemFault(f"{work}: what an earlier preparation left can't be removed")
        work.mkdir()
        return work

    def close(self, work: Path, *, keep_log: bool = False) -> None:
        """Remove its folder, or all of it but the log."""
        for path in [*work.iterdir()] if keep_log else [work]:
            if path.name != _LOG:
                erase(path)

    def failure(self, sentence: str, work: Path) -> InputError:
        """Return the error of a program of which a sentence tells what it did, with the end of its log."""
        log = work / _LOG
        said = _tail(log)
        end = f"; its log ends: {said} ({log})" if said else "; its log is empty"
        self.failed[work.name] = found = f"{self.called} {sentence}{end}"
        return InputError(found)

    def run(self, work: Path, frames: int, progress: Callable[[float], None]) -> Path:
        """Run it, and return the folder that it wrote into.

        Raises:
            InputError: it failed, or can't run here.
            SystemFault: it can't be supervised right now.
        """
        own = work / "own"
        for folder in (own, own / "out", own / "home", own / "tmp"):
            folder.mkdir()
        try:
            start = self._start(work)
        except (Unavailable, ImageMissing) as error:
            raise InputError(f"{self.called} can't run here: {error}") from None
        most = frames * (1 + len(self.program.given)) + _SPARE_FILES
        spec = SupervisorSpec(
            **start,
            log_path=str(work / _LOG),
            usage_path=str(work / "usage.csv"),
            summary_path=str(work / "summary.json"),
            process_path=str(work / "process.json"),
            output_directory=str(own),
            cpus=_cpus(),
            timeout_seconds=seconds(self.program.timeout),
            memory_limit_bytes=int(quantity(self.program.memory)),
            output_limit_bytes=int(quantity(self.program.disk)),
            output_file_limit=most,
            parent_pid=os.getpid(),
        )
        supervised = Supervised(work)
        try:
            supervised.start(spec)
            _wait(supervised, own / "out", frames, progress)
        except OSError as error:
            raise SystemFault(f"{work}: {error.strerror or error}") from None
        finally:
            supervised.end()
            supervised.wait()
            if supervised.summary() is None:
                abandon(work)
        self._judge(supervised, work)
        return own / "out"

    def _start(self, work: Path) -> Mapping[str, Any]:
        """Return the fields of a SupervisorSpec that say what is started and how.

        Raises:
            SlamHiveError: it can't be started here.
        """
        if self.programs.executor(self.entry) == CONTAINER:
            image = self.programs.containers.get(self.entry, Pace.LOCKSTEP)
            limits = PreparingLimits(_cpus(), int(quantity(self.program.memory)))
            return image.prepares(work, self.program.command, _variables(IN_CONTAINER), limits)
        environment = self.programs.environments.get(self.entry)
        own, local = self.entry.folder, self.program.local
        if local is not None and local.command is not None:
            argv = (str(own / local.command[0]), *local.command[1:])
        else:
            argv = (str(environment.python), str(own / (local.adapter if local else "adapter.py")))
        passed = own_variables(_TO_PROGRAMS)
        path = os.pathsep.join([str(environment.path / "bin"), "/usr/local/bin:/usr/bin:/bin"])
        return {
            "argv": argv,
            "cwd": str(work / "own"),
            "env": passed | _variables(str(work)) | {"PATH": path},
        }

    def _judge(self, supervised: Supervised, work: Path) -> None:
        """Raise what became of it where that is no success."""
        summary = supervised.summary()
        if summary is None:
            raise SystemFault(f"{self.called}: {supervised.fault() or 'its supervisor was killed'}")
        reason, code = summary.get("reason"), summary.get("exitCode")
        if reason is None:
            return
        message = str(summary.get("message"))
        if reason in {Reason.CANCELLED, Reason.SYSTEM_FAULT}:
            raise SystemFault(f"{self.called}: {message}")
        if reason == Reason.ALGORITHM_FAILED and code is not None:
            message = f"exit code {code}"
        raise self.failure(f"failed: {message}", work)


def _digest(programs: Programs, entry: AlgorithmEntry) -> str:
    """Return the digest of a program: of its image, or of what it is made of in its own folder.

    Raises:
        Unavailable: it can't run here.
        ImageMissing: its image can't be had.
    """
    local = entry.algorithm.spec.local
    if programs.executor(entry) == CONTAINER:
        # Pulled here: a recording has the name of what it was made by.
        programs.containers.get(entry, Pace.LOCKSTEP)
        return programs.containers.digest(entry)
    if local is None or local.command is not None:
        return programs.digest(entry)
    python = interpreter(entry)
    parts = [
        ProgramPart("Python", f"{python.version[0]}.{python.version[1]}"),
        ProgramPart("machine", platform.machine()),
    ]
    # Without the helpers of adapters, which it doesn't see: a new version of ours makes nothing anew.
    own = [path for path in dict.fromkeys(source_files(entry)) if path.parent.is_relative_to(entry.folder)]
    try:
        return digest_of([*parts, *(ProgramPart(path.name, file_sha256(path)) for path in own)])
    except DataError as error:
        raise Unavailable(str(error)) from None


def _variables(work: str) -> dict[str, str]:
    """Return the variables that it is started with."""
    cores = str(len(_cpus()))
    return {
        "SLAMHIVE_IN": f"{work}/in",
        "SLAMHIVE_OUT": f"{work}/own/out",
        **dict.fromkeys(THREAD_VARIABLES, cores),
        "HOME": f"{work}/own/home",
        "TMPDIR": f"{work}/own/tmp",
        "LANG": "C.UTF-8",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONNOUSERSITE": "1",
    }


def _cpus() -> tuple[int, ...]:
    """Return the processors of the run that waits for it."""
    return tuple(sorted(os.sched_getaffinity(0)))


def _wait(supervised: Supervised, out: Path, frames: int, progress: Callable[[float], None]) -> None:
    """Wait for a program, telling by what it has written how far it is."""
    ended = threading.Event()

    def wait() -> None:
        supervised.wait()
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    while not ended.wait(_LOOK_SECONDS):
        written = sum(len(os.listdir(path)) for path in out.iterdir() if path.is_dir())  # noqa: PTH208
        progress(min(written / max(frames, 1), 1.0))


def _tail(log: Path) -> str:
    """Return the last lines of a log in one line."""
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    said = " | ".join(line.strip() for line in lines[-_TAIL_LINES:] if line.strip())
    return said if len(said) <= _TAIL_LENGTH else f"…{said[-_TAIL_LENGTH:]}"
