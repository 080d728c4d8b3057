# SPDX-License-Identifier: Apache-2.0
"""Algorithms as containers of podman or docker: images, and the container of an attempt.

An algorithm meets what it meets in a pod (`kube/builders/run.py`): the same folders, variables, user and
limits. slamhive creates the container, the run's supervisor starts and removes it. A label says whose home's
it is, so that the next slamhive finds what a killed one left, and no other home's.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import resource
import stat
import subprocess
import sys
import threading
import uuid
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from slamhive import __version__
from slamhive.contract.environment import SETTINGS_FOLDER, program_variables
from slamhive.local.assets import place_assets
from slamhive.local.engines import engine_named, find_engine
from slamhive.local.playing import MEMORY_LIMIT, other_processors
from slamhive.local.prepared import PreparedPlayer
from slamhive.local.unavailable import ImageMissing, Unavailable
from slamhive.model.base import quantity
from slamhive.model.errors import DataError, SystemFault
from slamhive.monitor.engine import EngineError
from slamhive.monitor.spec import TASK_LIMIT, ContainedSpec
from slamhive.plan import image_digest, pinned_digest
from slamhive.playback.pod import COMMAND as PLAYER
from slamhive.playback.pod import FOLDER as PLAYER_FOLDER
from slamhive.playback.pod import player_pod
from slamhive.playback.protocol import READY_FILE

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
    from pathlib import Path

    from slamhive.local.catalog import AlgorithmEntry
    from slamhive.local.engines import ContainerChoice, Engine
    from slamhive.local.home import Home
    from slamhive.local.prepared import AttemptOrder
    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.playback.pod import PlayerPod

RUN = "/slamhive"
USER = 65532
HOME_LABEL = "io.slamhive.home"
RUN_LABEL = "io.slamhive.run"
_ALGORITHM = "algorithm"
_CREATED, _PID = "container.json", "container.pid"
_OF_THIS_MACHINE = "localhost/"
_ALONE = ("--network", "none", "--init")
_SCRATCH_BYTES = 2 * 2**30
_MOST_FILES = 1 << 20
# podman itself takes no more for its own user, and refuses to give what it hasn't.
_MOST_TASKS = 1 << 15
_UNKNOWN_IMAGE = re.compile(r"no such image|image not known|not known|not found", re.IGNORECASE)
_VARIABLE = re.compile(r"\$\$|\$\(([A-Za-z_][A-Za-z0-9_.-]*)\)")


@dataclass(frozen=True)
class Image:
    """An image that the engine has.

    Attributes:
        identity: digest of its configuration, which names its content: ``sha256:…``.
        program: the words of its own program.
    """

    identity: str
    program: tuple[str, ...]


class Containers:
    """The images and containers of a home.

    Args:
        home: whose they are.
        choice: the engine that is wanted; None: the first that answers.
        notify: told in a sentence of what takes long.
    """

    def __init__(
        self,
        home: Home,
        choice: ContainerChoice | None = None,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._home = home
        self._choice = choice
        self._notify = notify
        self._images: dict[str, Image] = {}
        self._missing: dict[str, str] = {}
        self._lock = threading.Lock()

    @staticmethod
    def check(entry: AlgorithmEntry, choice: ContainerChoice | None) -> None:
        """Check that an algorithm's image could be run here, whether it still has to be pulled or not.

        Raises:
            Unavailable: it can't.
        """
        engine, image = find_engine(choice), entry.algorithm.spec.image
        if image is None:
            raise Unavailable("has no image")
        known = (
            "@" in image or not image.startswith(_OF_THIS_MACHINE) or image in images_of_this_machine(engine)
        )
        if not known:
            raise Unavailable(
                f"needs the image {image}, which is in no registry and not here: {engine.name} build or "
                f"{engine.name} tag makes it"
            )

    def digest(self, entry: AlgorithmEntry) -> str:
        """Return the digest of an algorithm's image, as a cluster would know it.

        Raises:
            Unavailable: no engine can be used.
            ImageMissing: the image isn't there.
        """
        return image_digest(self.image_id(entry))

    def image_id(self, entry: AlgorithmEntry) -> str:
        """Return the identity of an algorithm's image: the digest that its name carries, or of its content.

        Raises:
            Unavailable: no engine can be used.
            ImageMissing: the image isn't there.
        """
        name = entry.algorithm.spec.image or ""
        return (
            name if pinned_digest(name) else self._image(find_engine(self._choice), name, pull=False).identity
        )

    def get(self, entry: AlgorithmEntry, pace: str) -> ContainerProgram:
        """Return an algorithm's image, pulled when it isn't there, with the engine that runs it.

        Where runs of the pace are played to, the player's image has to be there too.

        Raises:
            Unavailable: no engine can be used, or the image has no program.
            ImageMissing: the image can't be pulled.
        """
        engine, spec = find_engine(self._choice), entry.algorithm.spec
        image = self._image(engine, spec.image or "", pull=True)
        if not spec.command and not image.program:
            raise Unavailable(f"image {spec.image!r} has no program of its own: spec.command must name one")
        player = self._image(engine, player_image(), pull=True) if spec.plays(pace) else None
        return ContainerProgram(engine, image, self._label(engine), player)

    def fetch(self, entries: Iterable[AlgorithmEntry]) -> None:
        """Pull images that aren't there, as far as that can be."""
        for entry in entries:
            with suppress(Unavailable, ImageMissing):
                self._image(find_engine(self._choice), entry.algorithm.spec.image or "", pull=True)

    def remove_left_behind(self, at_work: Collection[str] = ()) -> None:
        """Remove the containers of this home that a killed slamhive left.

        Args:
            at_work: identities of runs that runners are at work on: theirs stay.

        Raises:
            SystemFault: one can't be removed.
        """
        marks = self._home.path / "containers"
        if not marks.is_dir():
            return
        for name in sorted(path.name for path in marks.iterdir() if path.name in {"podman", "docker"}):
            engine = engine_named(name)
            if engine is None:
                continue
            try:
                left = set(engine.labelled(f"{HOME_LABEL}={self.identity()}"))
                for run in at_work if left else ():
                    left -= set(engine.labelled(f"{RUN_LABEL}={run}"))
            except EngineError as error:
                raise SystemFault(f"{name}: containers of earlier runs can't be listed: {error}") from None
            for identity in sorted(left):
                engine.remove(identity)

    def _label(self, engine: Engine) -> str:
        # Before the first container: by this file the next slamhive knows whom to ask.
        (self._home.folder("containers") / engine.name).touch()
        return self.identity()

    def identity(self) -> str:
        """Return what tells this home from all others, a copy of it elsewhere included."""
        path = self._home.folder("containers") / "identity"
        with self._lock:
            if not path.exists():
                aside = path.with_name(f".{uuid.uuid4().hex}")
                aside.write_text(f"{uuid.uuid4().hex}\n")
                with suppress(FileExistsError):  # another runner of this home was faster
                    path.hardlink_to(aside)
                aside.unlink()
            text = f"{path.read_text().strip()} {self._home.path.resolve()}"
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def _image(self, engine: Engine, name: str, *, pull: bool) -> Image:
        """Return an image; it is looked for once, and pulled once, for all runs of a command."""
        with self._lock:
            if name in self._missing:
                raise ImageMissing(self._missing[name])
            if name not in self._images:
                found = _inspect(engine, name)
                if found is None and not pull:
                    raise ImageMissing(f"image {name!r} is not there yet")
                if found is None:
                    found = self._pull(engine, name)
                self._images[name] = found
            return self._images[name]

    def _pull(self, engine: Engine, name: str) -> Image:
        self._notify(f"pulling the image {name} (once)")
        try:
            pull(engine, qualified(name))
            found, why = _inspect(engine, qualified(name)), "it was pulled and is not there"
        except EngineError as error:
            found, why = None, str(error)
        if found is None:
            self._missing[name] = f"image {name!r}: {why}"
            raise ImageMissing(self._missing[name])
        return found


@cache
def images_of_this_machine(engine: Engine) -> frozenset[str]:
    """Return the names of images that no registry has; asked once a program."""
    try:
        listed = engine.call("images", "--format", "{{.Repository}}:{{.Tag}}")
    except EngineError:
        return frozenset()
    return frozenset(name for name in listed.split() if name.startswith(_OF_THIS_MACHINE))


def player_image() -> str:
    """Return the image that plays recordings to ROS 1 nodes; $SLAMHIVE_PLAYER_IMAGE names another."""
    return os.environ.get("SLAMHIVE_PLAYER_IMAGE") or f"slamhive/ros1-player:{__version__}"


def pull(engine: Engine, name: str) -> None:
    """Pull an image, with the engine's own progress on a terminal and quietly without one.

    Raises:
        EngineError: it can't be had.
    """
    if not sys.stderr.isatty():
        engine.follow("pull", name, tell=lambda _line: None)
        return
    # Both draw their progress on a terminal alone: podman on standard error, docker on standard output.
    quiet = subprocess.DEVNULL if engine.is_podman else sys.stderr
    done = subprocess.run(
        [*engine.command, "pull", name], stdin=subprocess.DEVNULL, stdout=quiet, check=False
    )
    if done.returncode != 0:
        raise EngineError(f"{engine.name} pull {name} failed; what it said stands above")


def qualified(name: str) -> str:
    """Return an image's name with the registry that a cluster would take.

    >>> qualified("slamhive/kiss-icp:1.3.0"), qualified("debian:12")
    ('docker.io/slamhive/kiss-icp:1.3.0', 'docker.io/library/debian:12')
    >>> qualified("localhost/a"), qualified("lab:5000/a")
    ('localhost/a', 'lab:5000/a')
    """
    first, slash, _ = name.partition("/")
    if slash and ("." in first or ":" in first or first == "localhost"):
        return name
    return f"docker.io/{name}" if slash else f"docker.io/library/{name}"


def _inspect(engine: Engine, name: str) -> Image | None:
    """Return what an engine knows of an image, None where it has none of that name.

    Raises:
        ImageMissing: it doesn't say.
    """
    try:
        (told,) = json.loads(engine.call("image", "inspect", name))
        configuration = told.get("Config") or {}
        words = [*(configuration.get("Entrypoint") or ()), *(configuration.get("Cmd") or ())]
        identity = str(told["Id"]).removeprefix("sha256:")
    except EngineError as error:
        if _UNKNOWN_IMAGE.search(str(error)):
            return None
        raise ImageMissing(f"image {name!r}: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ImageMissing(f"image {name!r}: {engine.name} doesn't say what it is") from None
    return Image(f"sha256:{identity}", tuple(map(str, words)))


@dataclass(frozen=True)
class ContainerProgram:
    """An algorithm's image, with the engine that runs it.

    Attributes:
        engine: the engine.
        image: the image.
        home: the home's identity, for the label.
        player_image: the image of what plays to it, where something does.
    """

    engine: Engine
    image: Image
    home: str
    player_image: Image | None = None

    def run_folder(self, run: Path) -> str:  # noqa: ARG002
        """Return where the contract says the run folder is."""
        return RUN

    def lay_out(self, order: AttemptOrder, folder: Path) -> None:
        """Fetch files that the image lacks, and make all readable to the algorithm's user.

        Raises:
            DataError: a file of the recording isn't.
            SystemFault: an asset can't be fetched right now.
        """
        run = folder / "run"
        # Those with a path are in the image.
        place_assets(order.entry, run / "assets", folder.parents[2] / "assets", fetched_alone=True)
        if self.engine.rootless:
            return  # the algorithm's user is we
        if order.entry.algorithm.spec.files:
            for path in (run / SETTINGS_FOLDER, *(run / SETTINGS_FOLDER).rglob("*")):
                path.chmod(path.stat().st_mode | (0o555 if path.is_dir() else 0o444))
        closed = _closed_to_others(order.dataset)
        if closed is not None:
            raise DataError(
                f"{closed} can't be read by user {USER}, as which a container runs: chmod o+rX {closed}"
            )
        _give(run / "output")

    def player(self, order: AttemptOrder, folder: Path) -> PreparedPlayer | None:
        """Create the container of a player; the program's shares its network and its processes, as in a pod.

        Raises:
            SystemFault: the engine doesn't.
        """
        pod = player_pod(order.entry.algorithm.spec, order.configuration, _ALGORITHM)
        if pod is None:
            return None
        if self.player_image is None:
            raise SystemFault("the player has no image")
        own = folder / "own"
        own.mkdir(parents=True)
        if not self.engine.rootless:
            _give(own)
        words = player_words(self, self.player_image, order, folder, pod)
        supervision = self._create(words, folder) | {"argv": PLAYER, "cwd": RUN, "env": {}}
        return PreparedPlayer(supervision, own / READY_FILE, lambda: dict(pod.algorithm_variables))

    def supervision(
        self, order: AttemptOrder, folder: Path, variables: Mapping[str, str]
    ) -> Mapping[str, Any]:
        """Create the attempt's container; its supervisor starts and removes it.

        Raises:
            SystemFault: the engine doesn't.
        """
        words = create_words(self, order, folder, variables)
        program = order.entry.algorithm.spec.command or self.image.program
        return self._create(words, folder) | {"argv": tuple(program), "cwd": RUN, "env": {}}

    def _create(self, words: Sequence[str], folder: Path) -> dict[str, Any]:
        """Create a container, and return what its supervisor is told of it."""
        try:
            identity = self.engine.call("create", *words).split()[-1]
        except (EngineError, IndexError) as error:
            raise SystemFault(f"{self.engine.name} can't make the container: {error}") from None
        (folder / _CREATED).write_text(json.dumps({"engine": self.engine.name, "id": identity}))
        contained = ContainedSpec(
            engine=self.engine.command,
            identity=identity,
            removal=self.engine.removal,
            pid_path=str(folder / _PID) if self.engine.is_podman else None,
        )
        return {"contained": contained.as_json()}

    def abandon(self, folder: Path) -> None:
        """Remove the attempt's containers, which their supervisors no longer do."""
        for place in (folder, folder / "player"):
            identity = _created(place)
            if identity is not None:
                self.engine.remove(identity)


def _created(folder: Path) -> str | None:
    """Return the id of the container that was created for what is in a folder."""
    with suppress(OSError, ValueError, KeyError):
        return str(json.loads((folder / _CREATED).read_text())["id"])
    return None


def _give(folder: Path) -> None:
    """Let the algorithm's user write into a folder."""
    if os.geteuid() == 0:
        os.chown(folder, USER, USER)
    else:
        folder.chmod(0o777)


def create_words(
    program: ContainerProgram,
    order: AttemptOrder,
    folder: Path,
    variables: Mapping[str, str],
) -> list[str]:
    """Return what an engine's `create` is told: what the pod of a run has, in its words.

    Raises:
        SystemFault: a path can't be said to it.
    """
    spec = order.entry.algorithm.spec
    memory = int(quantity(order.spec["resources"]["memory"]))
    told = algorithm_variables(order, spec) | dict(variables)
    command = expanded(spec.command, told)
    player = _created(folder / "player")
    return [
        *_confined(program, order.uid, order.cpus, memory),
        # As in a pod, the algorithm isn't the first process, to which the kernel passes on few signals; it
        # shares network and processes with its player.
        *(_of_player(player) if player is not None else _ALONE),
        *_of_podman(program.engine, folder, player),
        *("--shm-size", str(memory // 2)),
        *(word for mounted in mounts(order, folder) for word in ("--mount", mounted)),
        *_environment(told),
        *(("--entrypoint", command[0]) if command else ()),
        program.image.identity,
        *command[1:],
    ]


def player_words(
    program: ContainerProgram, image: Image, order: AttemptOrder, folder: Path, pod: PlayerPod
) -> list[str]:
    """Return what an engine's `create` is told of a player.

    Raises:
        SystemFault: a path can't be said to it.
    """
    run = folder.parent / "run"
    # It must take no CPU time from the cores on which the algorithm is measured, if there are others.
    cpus = sorted(other_processors(order.cpus))
    seen = [
        (order.dataset.resolve(), f"{RUN}/dataset", True),
        (run / "output", f"{RUN}/output", False),
        (folder / "own", PLAYER_FOLDER, False),
    ]
    return [
        *_confined(program, order.uid, cpus, MEMORY_LIMIT),
        *_ALONE,
        *_of_podman(program.engine, folder),
        *(word for mounted in map(_mount, *zip(*seen, strict=True)) for word in ("--mount", mounted)),
        *_environment(pod.variables),
        *("--entrypoint", PLAYER[0]),
        image.identity,
        *PLAYER[1:],
    ]


def _confined(program: ContainerProgram, run: str, cpus: Sequence[int], memory: int) -> list[str]:
    """Return the bounds of a container.

    Args:
        program: whose it is.
        run: identity of the run.
        cpus: logical processors it is pinned to.
        memory: what it may use, bytes.
    """
    return [
        # Nothing but this machine: it was pulled before, and what a tag means may change meanwhile.
        *("--pull", "never"),
        *("--label", f"{HOME_LABEL}={program.home}", "--label", f"{RUN_LABEL}={run}"),
        *("--user", f"{USER}:{USER}", "--workdir", RUN),
        *("--read-only", "--ipc", "private"),
        *("--cap-drop", "all", "--security-opt", "no-new-privileges", "--security-opt", "label=disable"),
        *("--memory", str(memory), "--memory-swap", str(memory)),
        *("--pids-limit", str(TASK_LIMIT)),
        *(("--cpuset-cpus", ",".join(map(str, cpus))) if cpus else ()),
        *limits(),
        *("--tmpfs", f"/tmp:rw,nosuid,nodev,exec,size={_SCRATCH_BYTES},mode=1777"),  # noqa: S108
        # The supervisor keeps the log, within bounds.
        *("--log-driver", "none"),
        # What is removed while it runs is to be gone at once.
        *("--stop-timeout", "0"),
    ]


def _of_player(identity: str) -> tuple[str, ...]:
    return ("--network", f"container:{identity}", "--pid", f"container:{identity}")


def _environment(variables: Mapping[str, str]) -> list[str]:
    return [word for name, value in sorted(variables.items()) for word in ("--env", f"{name}={value}")]


def algorithm_variables(order: AttemptOrder, spec: AlgorithmSpec) -> dict[str, str]:
    """Return the variables that an algorithm has in a container here, as in a pod."""
    scratch = "/tmp"  # noqa: S108 - the container's own
    values = program_variables(
        run=RUN,
        seed=order.configuration.seed,
        cores=len(order.cpus),
        home=scratch,
        scratch=scratch,
        settings_files=bool(spec.files),
    )
    return values | {"SLAMHIVE_CONTAINER": _ALGORITHM}


def expanded(command: Sequence[str], variables: Mapping[str, str]) -> list[str]:
    """Return a command with $(NAME) replaced, as Kubernetes does it; $$ is a dollar.

    >>> expanded(["$(A)/x", "$$(A)", "$(B)"], {"A": "1"})
    ['1/x', '$(A)', '$(B)']
    """

    def value(match: re.Match[str]) -> str:
        return "$" if match[1] is None else variables.get(match[1], match[0])

    return [_VARIABLE.sub(value, word) for word in command]


def limits() -> list[str]:
    """Return bounds of open files, tasks and core dumps: engines ask for more than a user may give."""
    files = min(resource.getrlimit(resource.RLIMIT_NOFILE)[1] % (1 << 63), _MOST_FILES)
    tasks = min(resource.getrlimit(resource.RLIMIT_NPROC)[1] % (1 << 63), _MOST_TASKS)
    found = {"nofile": files, "nproc": tasks, "core": 0}
    return [word for name, most in found.items() for word in ("--ulimit", f"{name}={most}:{most}")]


def mounts(order: AttemptOrder, folder: Path) -> list[str]:
    """Return what of this machine the algorithm sees: the run folder's parts, each by itself.

    Raises:
        SystemFault: a path can't be said to an engine.
    """
    run = folder / "run"
    assets = [asset.name for asset in order.entry.algorithm.spec.assets if asset.url is not None]
    seen = [
        (run / "config.yaml", "config.yaml", True),
        (order.dataset.resolve(), "dataset", True),
        (run / "output", "output", False),
        *(((run / "assets" / name).resolve(), f"assets/{name}", True) for name in assets),
        *([(run / SETTINGS_FOLDER, SETTINGS_FOLDER, True)] if order.entry.algorithm.spec.files else []),
    ]
    return [_mount(source, f"{RUN}/{target}", read_only) for source, target, read_only in seen]


def _mount(source: Path, target: str, read_only: bool) -> str:
    text = str(source.absolute())
    if any(letter in text for letter in ',"\n'):
        raise SystemFault(f"{text}: a container can't be shown a path with a comma, quote or line break")
    mounted = f"type=bind,source={text},target={target}"
    return f"{mounted},readonly" if read_only else mounted


def _of_podman(engine: Engine, folder: Path, player: str | None = None) -> list[str]:
    if not engine.is_podman:
        return []
    own = [
        # Only what is named above may be written: podman would add /run and /var/tmp.
        "--read-only-tmpfs=false",
        # Proxies of this machine are none of the algorithm's.
        "--http-proxy=false",
        *("--cgroups", "no-conmon"),
        *("--pidfile", str(folder / _PID)),
    ]
    if not engine.rootless:
        return own
    # What shares processes has to have the same users.
    users = f"container:{player}" if player is not None else f"keep-id:uid={USER},gid={USER}"
    return [*own, f"--userns={users}"]


def _closed_to_others(folder: Path) -> Path | None:
    """Return what others than its owner can't read of a folder."""
    for path in (folder, *sorted(folder.rglob("*"))):
        mode = path.stat().st_mode
        needed = stat.S_IROTH | (stat.S_IXOTH if stat.S_ISDIR(mode) else 0)
        if mode & needed != needed:
            return path
    return None
