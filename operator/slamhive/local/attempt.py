# SPDX-License-Identifier: Apache-2.0
"""One attempt of a run: its folder, its program under a supervisor, and what it left.

::

    RUN/attempt.json    whose attempt this is, so that a finished one is taken up after a crash
    RUN/log.txt         what the program printed
    RUN/summary.json    the supervisor's last word: without it the attempt has not ended
    RUN/run/            what the program sees as $SLAMHIVE_RUN
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import stat
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml

from slamhive.analysis.measuring import read_estimate
from slamhive.data.erasing import erase
from slamhive.engine import AttemptEnd
from slamhive.local.assets import place_assets
from slamhive.local.catalog import bundled
from slamhive.local.playing import Player
from slamhive.model.base import quantity, seconds
from slamhive.model.errors import SystemFault
from slamhive.model.results import Frames, Reason, TrajectoryInfo, Usage
from slamhive.monitor import SupervisorSpec, end_orphans
from slamhive.monitor.files import compression_problem
from slamhive.playback.judging import judge
from slamhive_eval import EvaluationError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from slamhive.local.catalog import AlgorithmEntry
    from slamhive.local.environments import Environment
    from slamhive.model.configuration import RunConfiguration

_OUTPUT_LIMIT = 8 * 2**30
_TRAJECTORY_LIMIT = 512 * 2**20
_METRICS_LIMIT = 4 * 2**20
_PASSED_ON = ("LD_LIBRARY_PATH", "SSL_CERT_FILE", "TZ")


@dataclass(frozen=True)
class AttemptOrder:
    """What an attempt runs.

    Attributes:
        uid: the run's identity.
        content_hash: what makes this attempt's result what it is.
        configuration: the unified configuration.
        entry: the algorithm with its folder.
        environment: its virtual environment.
        dataset: folder of the prepared recording.
        spec: the run's resolved spec, for resources and timeout.
        cpus: logical processors it is pinned to.
    """

    uid: str
    content_hash: str
    configuration: RunConfiguration
    entry: AlgorithmEntry
    environment: Environment
    dataset: Path
    spec: Mapping[str, Any]
    cpus: tuple[int, ...]


class Attempt:
    """A program in a run folder, under the supervision of a process of its own.

    Args:
        folder: the run's folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.run = folder / "run"
        self.output = self.run / "output"
        self._process: subprocess.Popen[bytes] | None = None
        self._player = Player(folder)
        self._stopping = False

    def finished(self, uid: str, content_hash: str) -> bool:
        """Tell whether this very attempt was made before and ended by itself."""
        try:
            ticket = json.loads((self.folder / "attempt.json").read_text())
            summary = self._summary()
        except (OSError, ValueError):
            return False
        same = ticket == {"uid": uid, "contentHash": content_hash}
        return same and summary is not None and summary.get("reason") != Reason.CANCELLED

    def start(self, order: AttemptOrder) -> None:
        """Lay out the folder afresh and start the program.

        Raises:
            SystemFault: the folder can't be made or the supervisor can't be started.
        """
        try:
            with suppress(ValueError):  # no record: nobody is named by it
                end_orphans(self.folder / "process.json")
            with suppress(ValueError):
                end_orphans(self._player.record)
            self._lay_out(order)
            variables = self._player.start(order)
            spec = self._supervisor_spec(order, variables)
            spec_path = self.folder / "supervisor.json"
            spec_path.write_text(spec.to_json())
            ticket = {"uid": order.uid, "contentHash": order.content_hash}
            (self.folder / "attempt.json").write_text(json.dumps(ticket))
            with (self.folder / "supervisor.log").open("wb") as log:
                self._process = subprocess.Popen(
                    # -P: a json.py in the user's working folder is none of ours.
                    [sys.executable, "-P", "-m", "slamhive.monitor", "--spec", str(spec_path)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=log,
                    start_new_session=True,
                )
            self._player.watch(self._end_program)
        except OSError as error:
            self._player.stop()
            raise SystemFault(f"{self.folder}: {error.strerror or error}") from None

    def wait(self) -> None:
        """Wait until the program and all its descendants are gone."""
        if self._process is not None:
            self._process.wait()
        self._player.stop()
        self._player.wait()

    def stop(self) -> None:
        """Ask the supervisor to end the program; ``wait`` returns when it has."""
        self._stopping = True
        self._end_program()

    def _end_program(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)

    def end(self) -> AttemptEnd:
        """Return how the attempt ended."""
        summary = self._summary()
        if summary is None:
            if self._stopping:
                return AttemptEnd(reason=Reason.CANCELLED, message="cancelled")
            lines = _last_lines(self.folder / "supervisor.log")
            return AttemptEnd(reason=Reason.SYSTEM_FAULT, message=lines or "the supervisor was killed")
        reason = summary.get("reason")
        problem, missing = self._trajectory_problem()
        end = AttemptEnd(
            exit_code=summary.get("exitCode"),
            signal=summary.get("signal"),
            reason=Reason(reason) if reason in set(Reason) else None,
            message=summary.get("message"),
            trajectory_problem=problem,
            trajectory_missing=missing,
            remark=summary.get("metricsProblem"),
        )
        return end if self._stopping else judge(end, self._player.played())

    def collect(self) -> None:
        """Put the usage samples beside the trajectory."""
        source = self.folder / "usage.csv"
        with suppress(OSError):  # the algorithm may have put something else there, or locked its folder
            if source.exists() and self.output.is_dir() and not self.output.is_symlink():
                source.replace(self.output / "usage.csv")

    def usage(self) -> Usage | None:
        """Return what the attempt cost."""
        summary = self._summary() or {}
        found = summary.get("usage")
        return Usage.model_validate(found) if found else None

    def times(self) -> tuple[str | None, str | None]:
        """Return when the program started and ended, as ISO 8601."""
        summary = self._summary() or {}
        return summary.get("startedAt"), summary.get("finishedAt")

    def log_tail(self) -> str | None:
        """Return the last lines that the program printed."""
        tail = (self._summary() or {}).get("logTail")
        return "\n".join(tail) if isinstance(tail, list) else tail

    def metrics(self) -> dict[str, Any]:
        """Return the algorithm's own numbers, those of metrics.json that are plain values."""
        text = _read_regular(self.output / "metrics.json", _METRICS_LIMIT)
        try:
            found = json.loads(text) if text else {}
        except (ValueError, RecursionError):
            return {}
        if not isinstance(found, dict):
            return {}
        return {
            str(key): value
            for key, value in found.items()
            if isinstance(value, int | float | str | dict) and _is_shallow(value)
        }

    def frames(self, offered: int | None) -> Frames:
        """Return how many frames were offered, processed and dropped, as the algorithm counted."""
        found = self.metrics()

        def number(key: str) -> int | None:
            value = found.get(key)
            return value if isinstance(value, int) and not isinstance(value, bool) else None

        return Frames(
            offered=number("framesOffered") or offered,
            processed=number("framesProcessed"),
            dropped=number("framesDropped"),
        )

    def trajectory(self) -> TrajectoryInfo | None:
        """Return what is to say of trajectory.txt, or None when it can't be used."""
        path = self.output / "trajectory.txt"
        problem, _ = self._trajectory_problem()
        if problem:
            return None
        estimate = read_estimate(path)
        poses = 0 if estimate is None else len(estimate)
        span = 0.0 if estimate is None else float(estimate.stamps[-1] - estimate.stamps[0])
        checksum = hashlib.sha256(path.read_bytes()).hexdigest()
        return TrajectoryInfo(poses=poses, duration_seconds=span, sha256=checksum, path=str(path))

    def _trajectory_problem(self) -> tuple[str | None, bool]:
        path = self.output / "trajectory.txt"
        if not _is_regular(path):
            return "output/trajectory.txt is missing or not a regular file", True
        if path.stat().st_size > _TRAJECTORY_LIMIT:
            return f"output/trajectory.txt is larger than {_TRAJECTORY_LIMIT >> 20} MiB", False
        try:
            with path.open("rb") as file:
                problem = compression_problem(file.fileno(), "output/trajectory.txt")
            if problem:
                return problem, False
            read_estimate(path)
        except EvaluationError as error:
            return str(error).replace(str(path), "output/trajectory.txt"), False
        return None, False

    def _summary(self) -> dict[str, Any] | None:
        try:
            found = json.loads((self.folder / "summary.json").read_text())
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) else None

    def _lay_out(self, order: AttemptOrder) -> None:
        if self.folder.exists() and not erase(self.folder):
            raise SystemFault(f"{self.folder}: what an earlier attempt left can't be removed")
        for folder in (self.output, self.folder / "home", self.folder / "tmp"):
            folder.mkdir(parents=True)
        (self.run / "dataset").symlink_to(order.dataset.resolve())
        place_assets(order.entry, self.run / "assets", self.folder.parents[2] / "assets")
        text = yaml.safe_dump(order.configuration.as_json(), sort_keys=False, allow_unicode=True)
        config = self.run / "config.yaml"
        config.write_text(text)
        config.chmod(stat.S_IRUSR | stat.S_IRGRP | stat.S_IROTH)

    def _supervisor_spec(self, order: AttemptOrder, variables: Mapping[str, str]) -> SupervisorSpec:
        program = order.entry.algorithm.spec.local
        adapter = order.entry.folder / (program.adapter if program else "adapter.py")
        return SupervisorSpec(
            argv=(str(order.environment.python), str(adapter)),
            cwd=str(self.run),
            env=self._variables(order) | dict(variables),
            log_path=str(self.folder / "log.txt"),
            usage_path=str(self.folder / "usage.csv"),
            summary_path=str(self.folder / "summary.json"),
            process_path=str(self.folder / "process.json"),
            output_directory=str(self.output),
            cpus=order.cpus,
            timeout_seconds=seconds(order.spec["timeout"]),
            memory_limit_bytes=int(quantity(order.spec["resources"]["memory"])),
            output_limit_bytes=_OUTPUT_LIMIT,
            data_seconds=order.configuration.dataset.duration_seconds,
            includes_reader=order.entry.algorithm.spec.includes_reader,
            parent_pid=os.getpid(),
        )

    def _variables(self, order: AttemptOrder) -> dict[str, str]:
        threads = str(max(1, len(order.cpus)))
        kept = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        return kept | {
            "PATH": f"{order.environment.path / 'bin'}:/usr/local/bin:/usr/bin:/bin",
            "HOME": str(self.folder / "home"),
            "TMPDIR": str(self.folder / "tmp"),
            "LANG": "C.UTF-8",
            "PYTHONPATH": f"{order.entry.folder.parent}:{bundled('algorithms')}",
            "OMP_WAIT_POLICY": "PASSIVE",
            "PYTHONNOUSERSITE": "1",
            "PYTHONDONTWRITEBYTECODE": "1",
            "SLAMHIVE_RUN": str(self.run),
            "SLAMHIVE_SEED": str(order.configuration.seed),
            **dict.fromkeys(_THREAD_VARIABLES, threads),
        }


def end_left_behind(runs: Path) -> None:
    """End what a slamhive that was killed left running, its supervisors included, in any folder of a home.

    An attempt whose supervisor wrote its summary left nothing. Only the home's one runner may call this.
    """
    for record in (*runs.glob("*/*/process.json"), *runs.glob("*/*/player/process.json")):
        if not record.with_name("summary.json").exists():
            with suppress(ValueError, OSError):  # an algorithm may have spoilt it: it names nobody
                end_orphans(record)
            with suppress(OSError):
                record.unlink()


_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "TBB_NUM_THREADS",
)


def _is_shallow(value: Any, levels: int = 8) -> bool:
    """Tell whether a value of JSON is nested so little that everything that writes it can."""
    if isinstance(value, dict | list):
        items = value.values() if isinstance(value, dict) else value
        return levels > 0 and all(_is_shallow(item, levels - 1) for item in items)
    return True


def _is_regular(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _read_regular(path: Path, limit: int) -> str | None:
    if not _is_regular(path) or path.stat().st_size > limit:
        return None
    return path.read_text(encoding="utf-8", errors="replace")


def _last_lines(path: Path, count: int = 3) -> str:
    text = _read_regular(path, _METRICS_LIMIT) or ""
    lines: Sequence[str] = [line for line in text.splitlines() if line.strip()]
    return " ".join(lines[-count:])
