# SPDX-License-Identifier: Apache-2.0
"""Try the recording's doctor on made-up recordings: ``python tests/doctor/check.py``.

Clean ones first: 20 bases, each cut and turned nine times, must have no finding that is an error, and
warnings in fewer than one of 100. Then faults of a known size in each base: how many are found, and the error
of each estimate. The exit code is 1 where a clean one has an error, or too many have warnings.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "data" / "datalab"))

from spoiling import spoil

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset
from slamhive_eval import read_tum, write_tum

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.entries import DatasetEntry

    Change = Callable[[str, Any], Any]

MOST_WARNINGS = 0.01
"""Share of clean recordings in which a warning is let pass."""
SENSORS = (["Lidar", "Imu"], ["Stereo", "Imu"], ["Rgbd"], ["LaserScan", "Odometry", "Imu"], ["Lidar"])


def base(number: int, folder: Path) -> DatasetEntry:
    """Return a clean recording that is made up from a number."""
    chance = Random(number)
    synthetic = {
        "seed": number,
        "sensors": SENSORS[number % len(SENSORS)],
        "durationSeconds": chance.uniform(8, 16),
        "loops": chance.uniform(0.15, 0.4),
        "motion": chance.choice([0.5, 1, 2, 3]),
        "lidar": {"rings": 8, "columns": chance.choice([90, 180])},
        "camera": {"width": 160, "height": 120, "rate": chance.choice([5, 10])},
        "imu": {"rate": chance.choice([100, 200])},
    }
    values = {"metadata": {"name": f"base-{number}"}, "spec": {"recording": {"synthetic": synthetic}}}
    return materialise(Dataset.model_validate(values), folder / f"base-{number}", folder / f"base-{number}")


def nanoseconds(message: Any) -> int:
    """Return a message's header stamp, ns."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def shifted(message: Any, seconds: float) -> Any:
    """Return a message with its header stamp moved."""
    stamp = nanoseconds(message) + round(seconds * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message


def cut_and_turned(clean: DatasetEntry, folder: Path, chance: Random) -> DatasetEntry:
    """Return a recording without its begin and end, in a world that is turned about the vertical."""
    span = inspect(clean)
    assert span.start is not None
    assert span.duration_seconds is not None
    low = span.start + chance.uniform(0, 0.15) * span.duration_seconds
    high = span.start + chance.uniform(0.85, 1.0) * span.duration_seconds

    def keep(_: str, message: Any) -> Any:
        if not hasattr(message, "header"):
            return message  # transforms that are said once
        return message if low <= nanoseconds(message) / 1e9 <= high else None

    made = spoil(clean, folder, keep)
    truth = made.dataset.spec.ground_truth
    assert truth is not None
    assert truth.file is not None
    path = folder / truth.file
    poses = read_tum(path)
    angle = chance.uniform(-np.pi, np.pi)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    away = np.array([chance.uniform(-50, 50), chance.uniform(-50, 50), 0.0])
    turned = poses.transformed(turn, away)
    write_tum(path, turned)
    return made


@dataclass(frozen=True)
class MadeUpFault:
    """A fault of a known size.

    Attributes:
        code: What must be found.
        sensor: The sensor that has it; ``groundTruth`` for the truth.
        value: Its size, in the finding's unit; None where only the finding counts.
        change: How it is put into a recording.
    """

    code: str
    sensor: str
    value: float | None
    change: Change


def faults(clean: DatasetEntry, chance: Random) -> list[MadeUpFault]:
    """Return the faults that the sensors of a recording can have, of sizes by chance."""
    sensors = clean.dataset.spec.sensors
    found: list[MadeUpFault] = []
    by_topic = {sensor.topic: name for name, sensor in sensors.items()}

    def on(name: str, change: Callable[[Any], Any]) -> Change:
        return lambda topic, message: change(message) if by_topic.get(topic) == name else message

    def scaled(message: Any, of: str, factor: float) -> Any:
        vector = getattr(message, of)
        vector.x, vector.y, vector.z = vector.x * factor, vector.y * factor, vector.z * factor
        return message

    if "imu" in sensors:
        found += [
            MadeUpFault("imu.units", "imu", None, on("imu", partial(scaled, of=of, factor=factor)))
            for of, factor in (("linear_acceleration", 1 / 9.80665), ("angular_velocity", 180 / np.pi))
        ]
        for name in set(sensors) & {"lidar", "left", "imu"}:
            offset = chance.uniform(0.03, 0.2) * chance.choice((-1, 1))
            found.append(
                MadeUpFault("clock.offset", name, offset, on(name, partial(shifted, seconds=offset)))
            )
    for name in set(sensors) & {"lidar", "scan"} if len(sensors) > 1 else ():  # alone it is the only clock
        whole = chance.choice((37.0, 18.0, 7200.0))
        found.append(MadeUpFault("clock.epoch", name, whole, on(name, partial(shifted, seconds=whole))))
    return found


@dataclass
class Tally:
    """Tally of what was found in clean recordings and in faulty ones.

    Attributes:
        clean: Number of clean recordings.
        severities: In how many of them was a finding of each severity.
        codes: Their findings, by severity and code.
        missed: Faults that were not found, by code.
        errors: Errors of the estimates of those that were, by code.
        told: All findings as plain values, a recording each.
    """

    clean: int = 0
    severities: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    missed: Counter[str] = field(default_factory=Counter)
    errors: defaultdict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    told: list[dict[str, Any]] = field(default_factory=list)

    def look(self, entry: DatasetEntry, what: str) -> list[Finding]:
        """Return the findings of a recording, which are noted."""
        began = time.process_time()
        found = inspect(entry).findings
        seconds = time.process_time() - began
        self.told.append({"what": what, "cpuSeconds": seconds, "findings": [one.as_json() for one in found]})
        return found

    def take_clean(self, entry: DatasetEntry, what: str) -> None:
        """Look at a recording that has no fault."""
        found = self.look(entry, what)
        self.clean += 1
        self.severities.update({str(one.severity) for one in found})
        self.codes.update(f"{one.severity} {one.code}" for one in found)

    def take_faulty(self, entry: DatasetEntry, fault: MadeUpFault, what: str) -> None:
        """Look at a recording that has one fault."""
        fitting = [one for one in self.look(entry, what) if one.code == fault.code]
        if not fitting:
            self.missed[fault.code] += 1
            return
        size = abs(fault.value or 0.0)
        off = min(abs(abs(one.value or 0.0) - size) for one in fitting)
        self.errors[fault.code].append(off if fault.value is not None else 0.0)

    @property
    def is_trustworthy(self) -> bool:
        """Tell whether clean recordings are left alone."""
        return not self.severities["error"] and self.severities["warning"] <= MOST_WARNINGS * self.clean

    def text(self) -> str:
        """Return the tally in words."""
        errors, warnings = self.severities["error"], self.severities["warning"]
        lines = [
            f"{self.clean} clean recordings: {errors} with an error, {warnings} with a warning",
            *(f"  {code}: {count}" for code, count in self.codes.most_common()),
        ]
        for code in sorted({*self.errors, *self.missed}):
            values = self.errors[code]
            line = f"{code}: {len(values)} of {len(values) + self.missed[code]} found"
            if any(values):
                line += f", estimates are off by {np.median(values):.3g} (median), {max(values):.3g} at most"
            lines.append(line)
        return "\n".join(lines)


def main() -> int:
    """Try clean recordings, then faulty ones; print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bases", type=int, default=20, help="recordings that are made up")
    parser.add_argument("--cuts", type=int, default=9, help="cut and turned ones of each")
    parser.add_argument("--faults", type=int, default=50, help="faulty ones of each")
    parser.add_argument("--json", type=Path, help="where all findings go")
    options = parser.parse_args()
    tally = Tally()
    for number in range(options.bases):
        chance = Random(number)
        with TemporaryDirectory(prefix="slamhive-doctor-") as name:
            folder = Path(name)
            clean = base(number, folder)
            tally.take_clean(clean, f"base {number}")
            for cut in range(options.cuts):
                with TemporaryDirectory(dir=folder) as aside:
                    tally.take_clean(cut_and_turned(clean, Path(aside), chance), f"base {number}, cut {cut}")
            # Of one base all faults in turn, each time with other sizes.
            endless = (fault for _ in range(options.faults) for fault in faults(clean, chance))
            for at, fault in enumerate(islice(endless, options.faults)):
                with TemporaryDirectory(dir=folder) as aside:
                    spoiled = spoil(clean, Path(aside), fault.change)
                    what = f"base {number}, fault {at}: {fault.code} of {fault.sensor}, {fault.value}"
                    tally.take_faulty(spoiled, fault, what)
        print(f"{number + 1} of {options.bases} bases", file=sys.stderr)
    if options.json:
        options.json.write_text(json.dumps(tally.told, indent=1), encoding="utf-8")
    print(tally.text())
    return int(not tally.is_trustworthy)


if __name__ == "__main__":
    sys.exit(main())
