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
from typing import TYPE_CHECKING, Any

from slamhive.contract.environment import SETTINGS_FOLDER, program_variables
from slamhive.local.assets import place_assets
from slamhive.local.engines import EngineError, engine_named, find_engine
from slamhive.local.unavailable import ImageMissing, Unavailable
from slamhive.model.base import quantity
from slamhive.model.errors import DataError, SystemFault
from slamhive.monitor.spec import TASK_LIMIT, ContainedSpec
from slamhive.plan import image_digest, pinned_digest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from slamhive.local.catalog import AlgorithmEntry
    from slamhive.local.engines import ContainerChoice, Engine
    from slamhive.local.home import Home
    from slamhive.local.prepared import AttemptOrder
    from slamhive.model.algorithm import AlgorithmSpec

RUN = "/slamhive"
USER = 65532
HOME_LABEL = "io.slamhive.home"
RUN_LABEL = "io.slamhive.run"
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
        """Check that an algorithm's image could be run here, whether it is there or not.

        Raises:
            Unavailable: it can't.
        """
        find_engine(choice)
        if entry.algorithm.spec.image is None:
            raise Unavailable("has no image")

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

        Raises:
            Unavailable: no engine can be used, or the image has no program.
            ImageMissing: the image can't be pulled.
        """
        engine, spec = find_engine(self._choice), entry.algorithm.spec
        if spec.plays(pace) is not None:
            instead = "; without --container it runs as a process" if spec.local is not None else ""
            raise Unavailable(
                "is played to in real time as a ROS 1 node, which on a workstation isn't done in containers"
                + instead
            )
        image = self._image(engine, spec.image or "", pull=True)
        if not spec.command and not image.program:
            raise Unavailable(f"image {spec.image!r} has no program of its own: spec.command must name one")
        return ContainerProgram(engine, image, self._label(engine))

    def fetch(self, entries: Iterable[AlgorithmEntry]) -> None:
        """Pull images that aren't there, as far as that can be."""
        for entry in entries:
            with suppress(Unavailable, ImageMissing):
                self._image(find_engine(self._choice), entry.algorithm.spec.image or "", pull=True)

    def remove_left_behind(self) -> None:
        """Remove the containers of this home that a killed slamhive left; its one runner may call this.

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
                left = engine.labelled(f"{HOME_LABEL}={self.identity()}")
            except EngineError as error:
                raise SystemFault(f"{name}: containers of earlier runs can't be listed: {error}") from None
            for identity in left:
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
                path.write_text(f"{uuid.uuid4().hex}\n")
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
    """

    engine: Engine
    image: Image
    home: str

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
        output = run / "output"
        if os.geteuid() == 0:
            os.chown(output, USER, USER)
        else:
            output.chmod(0o777)

    def supervision(
        self, order: AttemptOrder, folder: Path, variables: Mapping[str, str]
    ) -> Mapping[str, Any]:
        """Create the attempt's container; its supervisor starts and removes it.

        Raises:
            SystemFault: the engine doesn't.
        """
        pid_path = folder / "container.pid"
        words = create_words(self, order, folder, variables, pid_path)
        try:
            identity = self.engine.call("create", *words).split()[-1]
        except (EngineError, IndexError) as error:
            raise SystemFault(f"{self.engine.name} can't make the container: {error}") from None
        (folder / "container.json").write_text(json.dumps({"engine": self.engine.name, "id": identity}))
        contained = ContainedSpec(
            engine=self.engine.command,
            identity=identity,
            pid_path=str(pid_path) if self.engine.is_podman else None,
        )
        program = order.entry.algorithm.spec.command or self.image.program
        return {
            "argv": tuple(program),
            "cwd": RUN,
            "env": {},
            "contained": contained.as_json(),
        }

    def abandon(self, folder: Path) -> None:
        """Remove the attempt's container, which its supervisor no longer does."""
        with suppress(OSError, ValueError, KeyError):
            identity = str(json.loads((folder / "container.json").read_text())["id"])
            self.engine.remove(identity)


def create_words(
    program: ContainerProgram,
    order: AttemptOrder,
    folder: Path,
    variables: Mapping[str, str],
    pid_path: Path,
) -> list[str]:
    """Return what an engine's `create` is told: what the pod of a run has, in its words.

    Raises:
        SystemFault: a path can't be said to it.
    """
    engine, spec = program.engine, order.entry.algorithm.spec
    memory = int(quantity(order.spec["resources"]["memory"]))
    told = algorithm_variables(order, spec) | dict(variables)
    command = expanded(spec.command, told)
    entry = ["--entrypoint", command[0]] if command else []
    return [
        # Nothing but this machine: it was pulled before, and what a tag means may change meanwhile.
        *("--pull", "never"),
        *("--label", f"{HOME_LABEL}={program.home}", "--label", f"{RUN_LABEL}={order.uid}"),
        *("--user", f"{USER}:{USER}", "--workdir", RUN),
        *("--read-only", "--network", "none", "--ipc", "private"),
        *("--cap-drop", "all", "--security-opt", "no-new-privileges", "--security-opt", "label=disable"),
        *("--memory", str(memory), "--memory-swap", str(memory)),
        *("--pids-limit", str(TASK_LIMIT)),
        *(("--cpuset-cpus", ",".join(map(str, order.cpus))) if order.cpus else ()),
        *limits(),
        *("--tmpfs", f"/tmp:rw,nosuid,nodev,exec,size={_SCRATCH_BYTES},mode=1777"),  # noqa: S108
        *("--shm-size", str(memory // 2)),
        # As in a pod, the algorithm isn't the first process, to which the kernel passes on few signals.
        "--init",
        # The supervisor keeps the log, within bounds.
        *("--log-driver", "none"),
        # What is removed while it runs is to be gone at once.
        *("--stop-timeout", "0"),
        *_of_podman(engine, pid_path),
        *(word for mounted in mounts(order, folder) for word in ("--mount", mounted)),
        *(word for name, value in sorted(told.items()) for word in ("--env", f"{name}={value}")),
        *entry,
        program.image.identity,
        *command[1:],
    ]


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
    return values | {"SLAMHIVE_CONTAINER": "algorithm"}


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
    words = []
    for source, target, read_only in seen:
        text = str(source.absolute())
        if any(letter in text for letter in ',"\n'):
            raise SystemFault(f"{text}: a container can't be shown a path with a comma, quote or line break")
        mounted = f"type=bind,source={text},target={RUN}/{target}"
        words.append(f"{mounted},readonly" if read_only else mounted)
    return words


def _of_podman(engine: Engine, pid_path: Path) -> list[str]:
    if not engine.is_podman:
        return []
    own = [
        # Only what is named above may be written: podman would add /run and /var/tmp.
        "--read-only-tmpfs=false",
        # Proxies of this machine are none of the algorithm's.
        "--http-proxy=false",
        *("--cgroups", "no-conmon"),
        *("--pidfile", str(pid_path)),
    ]
    return [*own, f"--userns=keep-id:uid={USER},gid={USER}"] if engine.rootless else own


def _closed_to_others(folder: Path) -> Path | None:
    """Return what others than its owner can't read of a folder."""
    for path in (folder, *sorted(folder.rglob("*"))):
        mode = path.stat().st_mode
        needed = stat.S_IROTH | (stat.S_IXOTH if stat.S_ISDIR(mode) else 0)
        if mode & needed != needed:
            return path
    return None
