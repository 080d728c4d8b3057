# SPDX-License-Identifier: Apache-2.0
"""Words of an engine's `create`: a run's container and its player's, with the bounds that a pod has.

`containers` creates the containers; `kube/builders/run.py` says the same for a pod.
"""

from __future__ import annotations

import os
import re
import resource
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.contract.environment import SETTINGS_FOLDER, program_variables
from slamhive.local.programs.playing import MEMORY_LIMIT, other_processors
from slamhive.model.base import quantity
from slamhive.model.errors import SystemFault
from slamhive.monitor.spec import TASK_LIMIT
from slamhive.playback.pod import COMMAND as PLAYER
from slamhive.playback.pod import FOLDER as PLAYER_FOLDER
from slamhive.playback.protocol import LEAST_SHARED_MEMORY

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from slamhive.local.programs.engines import Engine
    from slamhive.local.programs.images import Image
    from slamhive.local.programs.prepared import AttemptOrder
    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.playback.pod import PlayerPod

RUN = "/slamhive"
USER = 65532
HOME_LABEL = "io.slamhive.home"
RUN_LABEL = "io.slamhive.run"
ALGORITHM = "algorithm"
PID_FILE = "container.pid"
_ALONE = ("--network", "none", "--init")
_PRIVATE = ("--ipc", "private")
_SCRATCH = f"rw,nosuid,nodev,exec,size={2 * 2**30},mode=1777"
_MOST_FILES = 1 << 20
# podman itself takes no more for its own user, and refuses to give what it hasn't.
_MOST_TASKS = 1 << 15
_VARIABLE = re.compile(r"\$\$|\$\(([A-Za-z_][A-Za-z0-9_.-]*)\)")


@dataclass(frozen=True)
class ImageProgram:
    """An algorithm's image, with the engine that runs it.

    Attributes:
        engine: the engine.
        image: the image.
        home: the home's identity, for the label.
    """

    engine: Engine
    image: Image
    home: str


@dataclass(frozen=True)
class PlayerBeside:
    """A player's container beside an algorithm's.

    Attributes:
        identity: the engine's name for it.
        pod: what both need.
    """

    identity: str
    pod: PlayerPod


@dataclass(frozen=True)
class PreparingLimits:
    """Limits of a program that prepares a recording: logical processors, and memory in bytes."""

    cpus: Sequence[int]
    memory: int


def create_words(
    program: ImageProgram,
    order: AttemptOrder,
    folder: Path,
    variables: Mapping[str, str],
    player: PlayerBeside | None,
) -> list[str]:
    """Return the words of an engine's `create`: the pod of a run, said to an engine.

    Args:
        program: what runs.
        order: the attempt.
        folder: of the attempt.
        variables: beside those that every algorithm has.
        player: the player's container, if there is one.

    Raises:
        SystemFault: a path can't be said to it.
    """
    spec = order.entry.algorithm.spec
    told = algorithm_variables(order, spec) | dict(variables)
    command = [*expanded(spec.command, told), *(player.pod.arguments if player is not None else ())]
    seen = mounts(order, folder)
    if player is not None and player.pod.meets_in_memory:
        seen.append(_mount(folder / "player" / "own", PLAYER_FOLDER, read_only=True))
    return [
        *confined(program, order.uid, order.cpus, _memory(order)),
        # As in a pod, the algorithm isn't the first process, to which the kernel passes on few signals; it
        # shares network and processes with its player.
        *(_of_player(player.identity) if player is not None else _ALONE),
        *_of_podman(program.engine, folder, player),
        *_shared_memory(order, player),
        *(word for mounted in seen for word in ("--mount", mounted)),
        *_environment(told),
        *(("--entrypoint", command[0]) if command else ()),
        program.image.identity,
        *command[1:],
    ]


def player_words(
    program: ImageProgram, image: Image, order: AttemptOrder, folder: Path, pod: PlayerPod
) -> list[str]:
    """Return the words of an engine's `create` for a player.

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
        *confined(program, order.uid, cpus, MEMORY_LIMIT),
        *_ALONE,
        *_of_podman(program.engine, folder),
        *(("--ipc", "shareable", "--shm-size", str(_room(order))) if pod.meets_in_memory else _PRIVATE),
        *(word for mounted in map(_mount, *zip(*seen, strict=True)) for word in ("--mount", mounted)),
        *_environment(pod.variables),
        *("--entrypoint", PLAYER[0]),
        image.identity,
        *PLAYER[1:],
    ]


def preparing_words(
    program: ImageProgram,
    work: Path,
    command: Sequence[str],
    variables: Mapping[str, str],
    limits: PreparingLimits,
) -> list[str]:
    """Return the words of an engine's `create` for a program that prepares a recording.

    Raises:
        SystemFault: a path can't be said to it.
    """
    words = expanded(command, variables)
    seen = [(work / "in", f"{RUN}/in", True), (work / "own", f"{RUN}/own", False)]
    return [
        *confined(program, f"preparation-{work.name}", limits.cpus, limits.memory),
        *_ALONE,
        *_of_podman(program.engine, work),
        *(*_PRIVATE, "--shm-size", str(limits.memory // 2)),
        *(word for mounted in map(_mount, *zip(*seen, strict=True)) for word in ("--mount", mounted)),
        *_environment(variables),
        *(("--entrypoint", words[0]) if words else ()),
        program.image.identity,
        *words[1:],
    ]


def confined(program: ImageProgram, run: str, cpus: Sequence[int], memory: int) -> list[str]:
    """Return the bounds of a container, with its user.

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
        *("--user", _user(program.engine), "--workdir", RUN),
        "--read-only",
        *("--cap-drop", "all", "--security-opt", "no-new-privileges", "--security-opt", "label=disable"),
        *("--memory", str(memory), "--memory-swap", str(memory)),
        *("--pids-limit", str(TASK_LIMIT)),
        *(("--cpuset-cpus", ",".join(map(str, cpus))) if cpus else ()),
        *limits(),
        *("--tmpfs", f"/tmp:{_SCRATCH}{',notmpcopyup' if program.engine.is_podman else ''}"),  # noqa: S108
        # The supervisor keeps the log, within bounds.
        *("--log-driver", "none"),
        # What is removed while it runs is to be gone at once.
        *("--stop-timeout", "0"),
    ]


def _user(engine: Engine) -> str:
    """Return the user and group of a container: where its folders can't be given to another, we ourselves."""
    if engine.is_podman or (os.geteuid() == 0 and not engine.rootless):
        return f"{USER}:{USER}"
    # Who runs docker's daemon without root is root in its containers.
    return "0:0" if engine.rootless else f"{os.geteuid()}:{os.getegid()}"


def _of_player(identity: str) -> tuple[str, ...]:
    return ("--network", f"container:{identity}", "--pid", f"container:{identity}")


def _shared_memory(order: AttemptOrder, player: PlayerBeside | None) -> tuple[str, ...]:
    """Return the words for an algorithm's /dev/shm: its own, or that of the player whom it meets there."""
    if player is not None and player.pod.meets_in_memory:
        return ("--ipc", f"container:{player.identity}")
    return (*_PRIVATE, "--shm-size", str(_memory(order) // 2))


def _memory(order: AttemptOrder) -> int:
    return int(quantity(order.spec["resources"]["memory"]))


def _room(order: AttemptOrder) -> int:
    """Return the size of the /dev/shm in which an algorithm and its player meet, bytes."""
    return max(_memory(order) // 2, LEAST_SHARED_MEMORY)


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
    return values | {"SLAMHIVE_CONTAINER": ALGORITHM}


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
    """Return the mounts of what the algorithm sees of this machine: the run folder's parts, each by itself.

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


def _of_podman(engine: Engine, folder: Path, player: PlayerBeside | None = None) -> list[str]:
    if not engine.is_podman:
        return []
    own = [
        # Only what is named above may be written: podman would add /run and /var/tmp.
        "--read-only-tmpfs=false",
        # Proxies of this machine are none of the algorithm's.
        "--http-proxy=false",
        *("--cgroups", "no-conmon"),
        *("--pidfile", str(folder / PID_FILE)),
    ]
    if not engine.rootless:
        return own
    # What shares processes has to have the same users.
    users = f"container:{player.identity}" if player is not None else f"keep-id:uid={USER},gid={USER}"
    return [*own, f"--userns={users}"]
