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
import stat
import tarfile
import threading
import uuid
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.local.programs.assets import place_assets
from slamhive.local.programs.containerwords import (
    ALGORITHM,
    HOME_LABEL,
    PID_FILE,
    RUN,
    RUN_LABEL,
    USER,
    ImageProgram,
    PlayerBeside,
    PreparingLimits,
    create_words,
    player_words,
    preparing_words,
)
from slamhive.local.programs.engines import engine_named, find_engine
from slamhive.local.programs.images import Image, find_image, inspect, player_image, pull, qualified
from slamhive.local.programs.prepared import PreparedPlayer
from slamhive.local.programs.unavailable import ImageMissing, Unavailable
from slamhive.model.errors import DataError, SystemFault
from slamhive.monitor.programs.engine import EngineError
from slamhive.monitor.spec import ContainedSpec
from slamhive.plan import image_digest, pinned_digest
from slamhive.playback.pod import COMMAND as PLAYER
from slamhive.playback.pod import player_pod
from slamhive.playback.protocol import READY_FILE

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
    from pathlib import Path

    from slamhive.local.home.catalog import AlgorithmEntry
    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import ContainerChoice, Engine
    from slamhive.local.programs.prepared import AttemptOrder
    from slamhive.playback.pod import PlayerPod

_CREATED = "container.json"


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
        """Check that an algorithm's image, and its player's, could be run here, if need be after a pull.

        Raises:
            Unavailable: they can't.
            ImageMissing: the engine doesn't say.
        """
        engine, spec = find_engine(choice), entry.algorithm.spec
        if spec.image is None:
            raise Unavailable("has no image")
        find_image(engine, spec.image)
        if spec.node is not None and all(map(spec.plays, spec.paces)):
            find_image(engine, player_image(spec.node))

    def digest(self, entry: AlgorithmEntry) -> str:
        """Return the digest of an algorithm's image, as a cluster would know it.

        Raises:
            Unavailable: no engine can be used, or the image has to be made first.
            ImageMissing: the image isn't there.
        """
        return image_digest(self.image_id(entry))

    def image_id(self, entry: AlgorithmEntry) -> str:
        """Return the identity of an algorithm's image: the digest that its name carries, or of its content.

        Raises:
            Unavailable: no engine can be used, or the image has to be made first.
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
            Unavailable: no engine can be used, the image has to be made first, or it has no program.
            ImageMissing: the image can't be pulled.
        """
        engine, spec = find_engine(self._choice), entry.algorithm.spec
        image = self._image(engine, spec.image or "", pull=True)
        if not spec.command and not image.program:
            raise Unavailable(f"image {spec.image!r} has no program of its own: spec.command must name one")
        node = spec.plays(pace)
        player = self._image(engine, player_image(node), pull=True) if node is not None else None
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
        """Return the identity of this home among all others, a copy of it elsewhere included."""
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
                found = find_image(engine, name)
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
            found, why = inspect(engine, qualified(name)), "it was pulled and is not there"
        except EngineError as error:
            found, why = None, str(error)
        if found is None:
            self._missing[name] = f"image {name!r}: {why}"
            raise ImageMissing(self._missing[name])
        return found


@dataclass(frozen=True)
class ContainerProgram(ImageProgram):
    """An algorithm's image that is run: its containers, made and removed.

    Attributes:
        player_image: the image of what plays to it, where something does.
    """

    player_image: Image | None = None

    def run_folder(self, run: Path) -> str:  # noqa: ARG002
        """Return the run folder's path as the contract has it."""
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
        if os.geteuid() != 0:
            return  # the algorithm's user is we
        if order.entry.algorithm.spec.files:
            for path in (run / SETTINGS_FOLDER, *(run / SETTINGS_FOLDER).rglob("*")):
                path.chmod(path.stat().st_mode | (0o555 if path.is_dir() else 0o444))
        closed = _closed_to_others(order.dataset)
        if closed is not None:
            raise DataError(
                f"{closed} can't be read by user {USER}, as which a container runs: chmod o+rX {closed}"
            )
        os.chown(run / "output", USER, USER)

    def player(self, order: AttemptOrder, folder: Path) -> PreparedPlayer | None:
        """Create the container of a player; the program's shares its network and its processes, as in a pod.

        With a node of ROS 2 it shares /dev/shm too.

        Raises:
            SystemFault: the engine doesn't.
        """
        pod = _pod(order)
        if pod is None:
            return None
        if self.player_image is None:
            raise SystemFault("the player has no image")
        own = folder / "own"
        own.mkdir(parents=True)
        if os.geteuid() == 0:
            os.chown(own, USER, USER)
        words = player_words(self, self.player_image, order, folder, pod)
        supervision = self._create(words, folder, self.player_image) | {"argv": PLAYER, "cwd": RUN, "env": {}}
        return PreparedPlayer(supervision, own / READY_FILE, lambda: dict(pod.algorithm_variables))

    def supervision(
        self, order: AttemptOrder, folder: Path, variables: Mapping[str, str]
    ) -> Mapping[str, Any]:
        """Create the attempt's container; its supervisor starts and removes it.

        Raises:
            SystemFault: the engine doesn't.
        """
        identity, pod = _created(folder / "player"), _pod(order)
        beside = None if identity is None or pod is None else PlayerBeside(identity, pod)
        words = create_words(self, order, folder, variables, beside)
        program = order.entry.algorithm.spec.command or self.image.program
        return self._create(words, folder, self.image) | {"argv": tuple(program), "cwd": RUN, "env": {}}

    def prepares(
        self, work: Path, command: Sequence[str], variables: Mapping[str, str], limits: PreparingLimits
    ) -> Mapping[str, Any]:
        """Create the container of a program that prepares a recording; its supervisor starts and removes it.

        Args:
            work: its folder.
            command: its program; empty: the image's own.
            variables: what it is started with.
            limits: what it may use.

        Raises:
            SystemFault: the engine doesn't.
        """
        if os.geteuid() == 0:
            for path in (work / "own", *(work / "own").iterdir()):
                os.chown(path, USER, USER)
        words = preparing_words(self, work, command, variables, limits)
        program = tuple(command) or self.image.program
        return self._create(words, work, self.image) | {"argv": program, "cwd": RUN, "env": {}}

    def _open_scratch(self, identity: str) -> None:
        """Have a container's own /tmp be for all: runc gives its mode to what is mounted there."""
        folder = tarfile.TarInfo("tmp")
        folder.type, folder.mode = tarfile.DIRTYPE, 0o1777
        archive = folder.tobuf().decode() + "\0" * 2 * tarfile.BLOCKSIZE
        with suppress(EngineError):  # it then has none, and says so where it needs one
            self.engine.call("cp", "-", f"{identity}:/", given=archive)

    def _create(self, words: Sequence[str], folder: Path, image: Image) -> dict[str, Any]:
        """Create a container, and return what its supervisor is told of it."""
        try:
            identity = self.engine.call("create", *words).split()[-1]
        except (EngineError, IndexError) as error:
            raise SystemFault(f"{self.engine.name} can't make the container: {error}") from None
        (folder / _CREATED).write_text(json.dumps({"engine": self.engine.name, "id": identity}))
        if image.closes_scratch and self.engine.is_podman:
            self._open_scratch(identity)
        contained = ContainedSpec(
            engine=self.engine.command,
            identity=identity,
            removal=self.engine.removal,
            pid_path=str(folder / PID_FILE) if self.engine.is_podman else None,
        )
        return {"contained": contained.as_json()}

    def abandon(self, folder: Path) -> None:
        """Remove the attempt's containers, which their supervisors no longer do."""
        abandon(folder)
        abandon(folder / "player")


def abandon(folder: Path) -> None:
    """Remove the container that was created for what is in a folder, if there is one.

    Raises:
        SystemFault: it can't be removed.
    """
    with suppress(OSError, ValueError, KeyError):
        created = json.loads((folder / _CREATED).read_text())
        engine = engine_named(created["engine"])
        if engine is not None:
            engine.remove(str(created["id"]))


def _pod(order: AttemptOrder) -> PlayerPod | None:
    return player_pod(order.entry.algorithm.spec, order.configuration, ALGORITHM)


def _created(folder: Path) -> str | None:
    """Return the id of the container that was created for what is in a folder."""
    with suppress(OSError, ValueError, KeyError):
        return str(json.loads((folder / _CREATED).read_text())["id"])
    return None


def _closed_to_others(folder: Path) -> Path | None:
    """Return the first path of a folder that others than its owner can't read."""
    for path in (folder, *sorted(folder.rglob("*"))):
        mode = path.stat().st_mode
        needed = stat.S_IROTH | (stat.S_IXOTH if stat.S_ISDIR(mode) else 0)
        if mode & needed != needed:
            return path
    return None
