# SPDX-License-Identifier: Apache-2.0
"""One attempt of a run: its folder, its program under a supervisor, and what it left.

::

    RUN/attempt.json    whose attempt this is, so that a finished one is taken up after a crash
    RUN/log.txt         what the program printed
    RUN/summary.json    the supervisor's last word: without it the attempt has not ended
    RUN/run/            what the program sees as $SLAMHIVE_RUN
"""

from __future__ import annotations

import json
import os
import stat
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import yaml

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.contract.files import read_regular
from slamhive.contract.metrics import frame_counts, keep_values, read_metrics
from slamhive.contract.posefiles import FRAMES
from slamhive.contract.trajectory import check_trajectory
from slamhive.data.files.erasing import erase
from slamhive.engine import AttemptEnd
from slamhive.local.programs.playing import Player
from slamhive.local.programs.supervision import Supervised
from slamhive.model.base import quantity, seconds
from slamhive.model.errors import SystemFault
from slamhive.model.results import Frames, Reason, TrajectoryInfo, Usage, remark_of
from slamhive.monitor import SupervisorSpec, end_orphans
from slamhive.monitor.measuring.machine import processors_text
from slamhive.monitor.spec import OUTPUT_LIMIT
from slamhive.playback.judging import judge
from slamhive.playback.player.ros2.shm import remove_dead_segments
from slamhive.templating import place_files, render

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from slamhive.local.programs.prepared import AttemptOrder, PreparedProgram

_OBJECT_LIMIT = 4 * 2**20


class Attempt:
    """A program in a run folder, under the supervision of a process of its own.

    Args:
        folder: the run's folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.run = folder / "run"
        self.output = self.run / "output"
        self._program = Supervised(folder)
        self._player = Player(folder)
        self._prepared: PreparedProgram | None = None
        self._stopping = False
        self._offered: int | None = None

    def finished(self, uid: str, content_hash: str) -> bool:
        """Tell whether this very attempt was made before and ended by itself."""
        ticket, summary = _read_object(self.folder / "attempt.json"), self._kept_summary()
        # Both: the folder may hold an attempt of the same run with an adapter or a recording that has changed
        # since.
        same = ticket == {"uid": uid, "contentHash": content_hash}
        if not same or summary is None or summary.get("reason") == Reason.CANCELLED:
            return False
        return "trajectory" in summary or "trajectoryProblem" in summary

    def start(self, order: AttemptOrder) -> None:
        """Lay out the folder afresh and start the program.

        Raises:
            SettingsError: a settings file can't be rendered.
            SystemFault: the folder can't be made or the supervisor can't be started.
        """
        try:
            with suppress(ValueError):  # no record: nobody is named by it
                end_orphans(self._program.record)
            with suppress(ValueError):
                end_orphans(self._player.record)
            if self._player.took_part:
                remove_dead_segments()
            self._lay_out(order)
            self._prepared = order.program
            self._offered = order.frames
            variables = self._player.start(order)
            ticket = {"uid": order.uid, "contentHash": order.content_hash}
            (self.folder / "attempt.json").write_text(json.dumps(ticket))
            self._program.start(self._supervisor_spec(order, variables), order.holding)
            self._player.watch(self._program.end)
        except OSError as error:
            self._player.stop()
            order.program.abandon(self.folder)
            raise SystemFault(f"{self.folder}: {error.strerror or error}") from None

    def wait(self) -> None:
        """Wait until the program and all its descendants are gone."""
        self._program.wait()
        if self._prepared is not None and self._program.summary() is None:
            self._prepared.abandon(self.folder)
        self._player.stop()
        self._player.wait()
        if self._player.took_part:
            remove_dead_segments()  # a player that was killed left its own

    def stop(self) -> None:
        """Ask the supervisor to end the program; ``wait`` returns when it has."""
        self._stopping = True
        self._program.end()

    def end(self) -> AttemptEnd:
        """Return the end of the attempt."""
        summary = self._checked()
        if summary is None:
            if self._stopping:
                return AttemptEnd(reason=Reason.CANCELLED, message="cancelled")
            fault = self._program.fault() or "the supervisor was killed"
            return AttemptEnd(reason=Reason.SYSTEM_FAULT, message=fault)
        reason = summary.get("reason")
        # The algorithm has our user and can send signals: a run that it cancels itself is a fault, not a wish
        # of the user.
        if reason == Reason.CANCELLED and self._program.started and not self._program.asked_to_end:
            message = "another program told the supervisor to end the run"
            return AttemptEnd(reason=Reason.SYSTEM_FAULT, message=message)
        end = AttemptEnd(
            exit_code=summary.get("exitCode"),
            signal=summary.get("signal"),
            reason=Reason(reason) if reason in set(Reason) else None,
            message=summary.get("message"),
            trajectory_problem=summary.get("trajectoryProblem"),
            trajectory_missing=bool(summary.get("trajectoryMissing")),
            remark=_joined(remark_of(self.usage(), summary.get("metricsProblem")), summary.get("notes")),
        )
        return end if self._stopping else judge(end, self._player.played())

    def collect(self) -> str | None:
        """Put the usage samples beside the trajectory, and return why they can't be."""
        source = self.folder / "usage.csv"
        try:
            # Moved only now: the output folder is the algorithm's while it runs.
            if source.exists() and self.output.is_dir() and not self.output.is_symlink():
                source.replace(self.output / "usage.csv")
        except OSError as error:  # the algorithm may have put something else there, or locked its folder
            return f"usage.csv could not be put into {self.output}: {error.strerror}"
        return None

    def usage(self) -> Usage | None:
        """Return the usage of the attempt."""
        summary = self._summary() or {}
        found = summary.get("usage")
        if not found:
            return None
        asked = _read_object(self.folder / "supervisor.json") or {}
        return Usage.model_validate(found | {"processors": processors_text(asked.get("cpus"))})

    def times(self) -> tuple[str | None, str | None]:
        """Return the times that the program started and ended, as ISO 8601."""
        summary = self._summary() or {}
        return summary.get("startedAt"), summary.get("finishedAt")

    def log_tail(self) -> str | None:
        """Return the last lines that the program printed."""
        tail = (self._summary() or {}).get("logTail")
        return "\n".join(tail) if isinstance(tail, list) else tail

    def metrics(self) -> dict[str, Any]:
        """Return the algorithm's own values, as far as they are kept."""
        found = self._reported().get("metrics")
        return found if isinstance(found, dict) else {}

    def frames(self, offered: int | None = None) -> Frames:
        """Return the numbers of frames offered, processed and dropped.

        Args:
            offered: how many the recording has, for an attempt that an earlier version made, which didn't
                write that down.
        """
        found = Frames.model_validate(self._reported().get("frames") or {})
        return found if found.offered is not None else found.replace(offered=offered)

    def trajectory(self) -> TrajectoryInfo | None:
        """Return the facts about trajectory.txt, or None when it can't be used."""
        found = (self._checked() or {}).get("trajectory")
        path = str(self.output / "trajectory.txt")
        return TrajectoryInfo.model_validate(found).replace(path=path) if found else None

    def _reported(self) -> dict[str, Any]:
        """Return the contents of metrics.json, as summary.json has them."""
        summary = self._summary() or {}
        if not self._player.took_part:
            return summary
        # As below: the player adds what it counted.
        found = read_metrics(str(self.output), bounded=False)
        # One that another slamhive started knows from its summary what was offered.
        offered = self._offered or (summary.get("frames") or {}).get("offered")
        return {"frames": frame_counts(found, offered), "metrics": keep_values(found.values).values}

    def _checked(self) -> dict[str, Any] | None:
        """Return the end of the attempt, with the facts about its trajectory."""
        summary = self._summary()
        if summary is None or not self._player.took_part:
            return summary
        # A player that lost its node writes what it heard after the supervisor has looked.
        kept = {key: value for key, value in summary.items() if not key.startswith("trajectory")}
        return kept | check_trajectory(str(self.output)).as_json()

    def _summary(self) -> dict[str, Any] | None:
        """Return the end of the attempt: as its supervisor said, where we started that."""
        return self._program.summary() if self._program.started else self._kept_summary()

    def _kept_summary(self) -> dict[str, Any] | None:
        return _read_object(self.folder / "summary.json")

    def _lay_out(self, order: AttemptOrder) -> None:
        # Nothing of an earlier attempt may pass for a result of this one.
        if self.folder.exists() and not erase(self.folder):
            raise SystemFault(f"{self.folder}: what an earlier attempt left can't be removed")
        self.output.mkdir(parents=True)
        (self.run / "dataset").symlink_to(order.dataset.resolve())
        text = yaml.safe_dump(order.configuration.as_json(), sort_keys=False, allow_unicode=True)
        config = self.run / "config.yaml"
        config.write_text(text)
        # Keeps out a slip of the algorithm, no attack: it has the same user.
        config.chmod(stat.S_IRUSR | stat.S_IRGRP | stat.S_IROTH)
        templates = order.entry.algorithm.spec.templates
        if templates:
            told, run = order.configuration.as_json(), order.program.run_folder(self.run)
            rendered = render(templates, told, run, f"{run}/{SETTINGS_FOLDER}")
            place_files(rendered, self.run / SETTINGS_FOLDER)
        order.program.lay_out(order, self.folder)

    def _supervisor_spec(self, order: AttemptOrder, variables: Mapping[str, str]) -> SupervisorSpec:
        algorithm = order.entry.algorithm.spec
        return SupervisorSpec(
            **order.program.supervision(order, self.folder, variables),
            log_path=str(self.folder / "log.txt"),
            usage_path=str(self.folder / "usage.csv"),
            summary_path=str(self.folder / "summary.json"),
            process_path=str(self.folder / "process.json"),
            output_directory=str(self.output),
            cpus=order.cpus,
            timeout_seconds=seconds(order.spec["timeout"]),
            memory_limit_bytes=int(quantity(order.spec["resources"]["memory"])),
            output_limit_bytes=int(quantity(OUTPUT_LIMIT)),
            data_seconds=order.configuration.dataset.duration_seconds,
            frames=order.frames,
            includes_reader=algorithm.includes_reader,
            is_played=self._player.took_part,
            poses=algorithm.output_of(algorithm.mode(order.configuration.mode)).pose_files(
                str(order.dataset.resolve() / FRAMES)
            ),
            parent_pid=os.getpid(),
        )


def end_left_behind(runs: Path, at_work: Callable[[Path], bool] = lambda _: False) -> None:
    """End what a slamhive that was killed left running, its supervisors included, in any folder of a home.

    What killed ROS 2 nodes and players left in shared memory goes as well. An attempt whose supervisor wrote
    its summary left nothing.

    Args:
        runs: folder of the folders of sweeps.
        at_work: tells whether a runner that lives is at work in a run's folder.
    """
    left = False
    for record in (*runs.glob("*/*/process.json"), *runs.glob("*/*/player/process.json")):
        if at_work(runs.joinpath(*record.relative_to(runs).parts[:2])):
            continue
        if not record.with_name("summary.json").exists():
            left = True
            with suppress(ValueError, OSError):  # an algorithm may have spoilt it: it names nobody
                end_orphans(record)
            with suppress(OSError):
                record.unlink()
    if left:
        remove_dead_segments()


def _joined(remark: str | None, notes: Any) -> str | None:
    """Return a remark with what the supervisor noted."""
    found = [remark, *(notes if isinstance(notes, list) else ())]
    return "; ".join(str(sentence) for sentence in found if sentence) or None


def _read_object(path: Path) -> dict[str, Any] | None:
    """Return the JSON object in a file that the program may have written, None where there is none."""
    try:
        found = json.loads(read_regular(str(path), _OBJECT_LIMIT))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
