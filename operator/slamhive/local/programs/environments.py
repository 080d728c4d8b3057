# SPDX-License-Identifier: Apache-2.0
"""Virtual environments of algorithms: made once for each set of requirements, and kept."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.contract.environment import LIBRARY_PATH, SETTINGS_FOLDER, own_variables, program_variables
from slamhive.local.home.catalog import bundled
from slamhive.local.home.folder import lock
from slamhive.local.programs.assets import place_assets
from slamhive.local.programs.interpreters import interpreter
from slamhive.local.programs.making import ASIDE, MARKER, Making
from slamhive.local.programs.players import player_for
from slamhive.local.programs.playing import own_player
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.base import RELATIVE_PATH
from slamhive.playback.building import node_arguments
from slamhive.playback.ros import find_ros
from slamhive.playback.ros2 import libraries_without_ros

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.local.programs.interpreters import Interpreter
    from slamhive.local.programs.prepared import AttemptOrder, PreparedPlayer
    from slamhive.model.algorithm import LocalProgram
    from slamhive.playback.ros import Ros

_PLAYER = "the ROS 2 player"
_TO_PROGRAMS = ("LD_LIBRARY_PATH", "SSL_CERT_FILE", "TZ")


class ProgramPart(NamedTuple):
    """A part of what a program is.

    Attributes:
        name: what people call it: a file's name, or words.
        value: what tells it from others: a file's checksum, or a version.
    """

    name: str
    value: str


@dataclass(frozen=True)
class Environment:
    """A virtual environment that is ready: an algorithm as a process of this machine.

    Attributes:
        path: where it is.
        digest: of it and the adapter.
        ros: the machine's ROS that the program takes.
        player_ros: that of its player, where it is a node.
    """

    path: Path
    digest: str
    ros: Ros | None = None
    player_ros: Ros | None = None

    @property
    def python(self) -> Path:
        """Return its interpreter."""
        return self.path / "bin" / "python"

    def run_folder(self, run: Path) -> str:
        """Return the path of the run folder."""
        return str(run)

    def lay_out(self, order: AttemptOrder, folder: Path) -> None:
        """Lay out folders of the program's own, and the files that its Algorithm names.

        Raises:
            DataError: a file is missing or isn't the one that was named.
            SystemFault: one can't be fetched right now.
        """
        for name in ("home", "tmp"):
            (folder / name).mkdir()
        place_assets(order.entry, folder / "run" / "assets", folder.parents[2] / "assets")

    def player(self, order: AttemptOrder, folder: Path) -> PreparedPlayer | None:
        """Lay out a player that is a process as well; None where nothing is played.

        Raises:
            SystemFault: this machine has no ROS.
        """
        return own_player(order, folder, self.player_ros)

    def supervision(
        self, order: AttemptOrder, folder: Path, variables: Mapping[str, str]
    ) -> Mapping[str, Any]:
        """Return the start of the adapter with its interpreter, or of the program of its own."""
        algorithm, own = order.entry.algorithm.spec, order.entry.folder
        program = algorithm.local
        if program is not None and program.command is not None:
            argv = (str(own / program.command[0]), *program.command[1:])
        else:
            argv = (str(self.python), str(own / (program.adapter if program else "adapter.py")))
        files = f"{self.run_folder(folder / 'run')}/{SETTINGS_FOLDER}"
        return {
            "argv": (*argv, *node_arguments(algorithm, order.configuration, files)),
            "cwd": str(folder / "run"),
            "env": self._variables(order, folder) | dict(variables),
        }

    def abandon(self, folder: Path) -> None:
        """Do nothing: processes are found by their record."""

    def _variables(self, order: AttemptOrder, folder: Path) -> dict[str, str]:
        spec = order.entry.algorithm.spec
        own = program_variables(
            run=self.run_folder(folder / "run"),
            seed=order.configuration.seed,
            cores=len(order.cpus),
            home=str(folder / "home"),
            scratch=str(folder / "tmp"),
            settings_files=bool(spec.files),
        )
        passed = own_variables(_TO_PROGRAMS)
        if self.ros is not None:
            passed |= dict(self.ros.variables)
        elif spec.ros2 is not None:
            passed[LIBRARY_PATH] = libraries_without_ros(passed.get(LIBRARY_PATH, ""))
            if spec.local is not None and spec.local.command is None:
                # Where nodes on wheels look for a package's folder.
                passed["AMENT_PREFIX_PATH"] = str(self.path)
        helpers = [str(order.entry.folder.parent), str(bundled("algorithms"))]
        programs = [str(self.path / "bin"), passed.get("PATH"), "/usr/local/bin:/usr/bin:/bin"]
        return {
            **{name: value for name, value in passed.items() if value},
            **own,
            "PATH": os.pathsep.join(filter(None, programs)),
            "PYTHONPATH": os.pathsep.join([*helpers, *(self.ros.paths if self.ros else ())]),
        }


class Environments:
    """The environments of a home.

    Args:
        folder: where they are kept.
        notify: told in a sentence when one is being made, as that takes time.
        making: gets what is being done to make one, in words, and the share of it that is done.
        given_up: tells whether one that is being made is wanted no more.
    """

    def __init__(
        self,
        folder: Path,
        notify: Callable[[str], None] = lambda _: None,
        making: dict[str, float] | None = None,
        given_up: Callable[[], bool] = lambda: False,
    ) -> None:
        self._folder = folder
        self._given_up = given_up
        self._notify = notify
        self._making = {} if making is None else making
        self._usable: set[tuple[str, Path]] = set()
        self._impossible: dict[Path, str] = {}

    def digest(self, entry: AlgorithmEntry) -> str:
        """Return the digest of environment and adapter: equal ones run the same program."""
        return digest_of(self.parts(entry))

    def parts(self, entry: AlgorithmEntry) -> list[ProgramPart]:
        """Return the parts that the digest is made of, each by its name for people, with checksums of files.

        Raises:
            Unavailable: this machine can't run it.
        """
        program = _program(entry)
        if program.command is not None:
            return _parts_of_command(entry)
        python = interpreter(entry)
        parts = [
            ProgramPart("Python", f"{python.version[0]}.{python.version[1]}"),
            ProgramPart("machine", platform.machine()),
            *([ProgramPart("ROS", python.beside)] if python.beside else []),
        ]
        return parts + [ProgramPart(path.name, _sha256(path)) for path in source_files(entry)]

    def get(self, entry: AlgorithmEntry, pace: str = "") -> Environment:  # noqa: ARG002
        """Return an algorithm's environment, the same for all paces, made when it isn't there.

        That of the ROS 2 player is made beside it for an algorithm that is a ROS 2 node.

        Raises:
            Unavailable: this machine can't run the algorithm, or its packages can't be had; that is found out
                once.
            SystemFault: the packages can't be installed right now.
            GivenUp: nobody waits for it any more.
        """
        program, python = _program(entry), interpreter(entry)
        player = self._player_ros(entry)
        if program.command is not None:
            _check_command(entry, program)
            return Environment(entry.folder, self.digest(entry), python.ros, player)
        path = self._made(entry.name, python, entry.folder / program.requirements)
        environment = Environment(path, self.digest(entry), python.ros, player)
        if (entry.name, path) not in self._usable:
            _check_libraries(entry, program, environment.python)
            self._usable.add((entry.name, path))
        return environment

    def folders_of(self, entry: AlgorithmEntry) -> list[Path]:
        """Return the folders of an algorithm's environment and of its player's, made or not, if it has any.

        Raises:
            Unavailable: this machine can't run the algorithm, or a file of it can't be read.
        """
        program = entry.algorithm.spec.local
        if program is None:
            return []
        found = [] if entry.algorithm.spec.ros2 is None else [player_for(entry.algorithm.spec.ros2)]
        folders = [self._folder_for(*base) for base in found]
        if program.command is None:
            folders.append(self._folder_for(interpreter(entry), entry.folder / program.requirements))
        return folders

    def _player_ros(self, entry: AlgorithmEntry) -> Ros | None:
        """Return the ROS of an algorithm's player, whose environment is made when it isn't there."""
        spec = entry.algorithm.spec
        if spec.ros2 is None:
            return find_ros() if spec.ros1 is not None else None
        base = player_for(spec.ros2)
        return base.in_environment(self._made(_PLAYER, *base))

    def _folder_for(self, python: Interpreter, requirements: Path) -> Path:
        return self._folder / _key(python, requirements)

    def _made(self, name: str, python: Interpreter, requirements: Path) -> Path:
        """Return the path of an environment, made when it isn't there."""
        path = self._folder_for(python, requirements)
        if not (path / MARKER).exists():
            with lock(_lock_of(path)) as held:
                # Looked at again under the lock: another slamhive may have made it while this one waited.
                if not (path / MARKER).exists():
                    self._make(name, path, python, requirements, held)
        return path

    def _make(self, name: str, path: Path, python: Interpreter, requirements: Path, held: int | None) -> None:
        if path in self._impossible:
            raise Unavailable(self._impossible[path])
        self._notify(f"making the environment of {name} (once)")
        try:
            making = Making(name, python, requirements, self._making, held=held, given_up=self._given_up)
            with making:
                making.make(path)
        except Unavailable as error:
            self._impossible[path] = str(error)
            raise


def is_whole(path: Path) -> bool:
    """Tell whether an environment was made to its end."""
    return (path / MARKER).exists()


def remove_environment(path: Path) -> bool:
    """Remove an environment unless it is being made, and tell whether it was; nobody may be running in it."""
    with lock(_lock_of(path), wait=False) as held:
        if held is None:
            return False
        (path / MARKER).unlink(missing_ok=True)  # first: half of one is not to be used
        shutil.rmtree(path)
    return True


def _lock_of(path: Path) -> Path:
    return path.with_name(f"{path.name.removesuffix(ASIDE)}.lock")


def _key(python: Interpreter, requirements: Path) -> str:
    beside = [python.beside] if python.beside else []
    parts = [python.path, str(python.version), _sha256(requirements), *beside]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def availability(entry: AlgorithmEntry) -> str | None:
    """Say why an algorithm can't run on this machine, as far as that shows without installing it."""
    try:
        program = _program(entry)
        interpreter(entry)
        if entry.algorithm.spec.ros2 is not None:
            player_for(entry.algorithm.spec.ros2)
        if program.command is not None:
            _check_command(entry, program)
    except Unavailable as error:
        return str(error)
    return None


def _program(entry: AlgorithmEntry) -> LocalProgram:
    program = entry.algorithm.spec.local
    if program is None:
        raise Unavailable("has a container image only; a workstation runs algorithms with spec.local")
    return program


def digest_of(parts: Iterable[ProgramPart]) -> str:
    """Return the digest of a program by its parts, whose names don't count."""
    return hashlib.sha256("\n".join(part.value for part in parts).encode()).hexdigest()


def source_files(entry: AlgorithmEntry) -> list[Path]:
    """Return the files that an algorithm's program on a workstation is made of; one may stand twice.

    The order is that of the digest.
    """
    program = _program(entry)
    assets = [entry.folder / asset.path for asset in entry.algorithm.spec.assets if asset.path]
    if program.command is not None:
        paths = [word for word in program.command[1:] if re.match(RELATIVE_PATH, word)]
        given = [entry.folder / path for path in paths if (entry.folder / path).is_file()]
        return [entry.folder / program.command[0], *given, *assets]
    files = [entry.folder / name for name in (program.requirements, program.adapter)]
    # What the adapter may import: its own folder, and the helpers that adapters share.
    files += sorted(entry.folder.glob("*.py"))
    for folder in dict.fromkeys((entry.folder.parent, bundled("algorithms"))):
        for pattern in ("adapter_*.py", "*_support.py"):
            files += sorted(folder.glob(pattern))
    return files + assets


def _parts_of_command(entry: AlgorithmEntry) -> list[ProgramPart]:
    """Return the parts of a program that needs no Python: it, and files beside it that it is given."""
    beside = interpreter(entry).beside
    parts = [ProgramPart("its kind", "command"), ProgramPart("machine", platform.machine())]
    parts += [ProgramPart("ROS", beside)] if beside else []
    return parts + [ProgramPart(path.name, _sha256(path)) for path in source_files(entry)]


def _check_command(entry: AlgorithmEntry, program: LocalProgram) -> None:
    path = entry.folder / (program.command or [""])[0]
    if not path.is_file():
        raise Unavailable(f"{path} is not there: build it first")
    if not os.access(path, os.X_OK):
        raise Unavailable(f"{path} is no program: chmod +x makes it one")
    _check_libraries(entry, program, Path(sys.executable))


def _check_libraries(entry: AlgorithmEntry, program: LocalProgram, python: Path) -> None:
    if not program.libraries:
        return
    code = (
        "import ctypes, sys\n"
        "for name in sys.argv[1:]:\n"
        "    try: ctypes.CDLL(name)\n"
        "    except OSError: print(name)\n"
    )
    result = subprocess.run(
        [str(python), "-I", "-c", code, *program.libraries],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    missing = result.stdout.split()
    if missing:
        packages = " ".join(program.system_packages)
        raise Unavailable(f"{entry.name} needs {', '.join(missing)}: apt-get install {packages}")


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise Unavailable(f"{path}: {error.strerror}") from None
