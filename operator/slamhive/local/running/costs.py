# SPDX-License-Identifier: Apache-2.0
"""Costs of runs as they are predicted: settings of planned runs and of those that the archive has."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from slamhive.analysis.design import Known, Quantity, Setting
from slamhive.local.home.extent import DiskTally
from slamhive.local.running.outlook import Points
from slamhive.model.base import seconds
from slamhive.model.errors import InputError
from slamhive.model.results import Reason
from slamhive.model.sensors import SensorMode
from slamhive.plan.effects import recorded

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.archive import Cost
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset
    from slamhive.plan.paths import Settings

_SPARE = ("input.pace", "input.rate", "resources.memory", "resources.gpu", "resources.exclusiveNodes")
"""Options that are told otherwise, or that change no cost."""

NOW = "now"
"""Name of what runs together from now on."""

MOST_FOLDERS = 20
"""Folders of runs of an algorithm on a dataset whose size is looked at."""


@dataclass
class Knowledge:
    """Costs of finished runs and lengths of recordings, from which the costs of other runs are predicted.

    Attributes:
        costs: of finished runs, the latest first.
        lengths: what runs were given of recordings: frames and s, by dataset, mode and options.
        recordings: frames a second and s of whole recordings, by dataset and mode.
        failed: runs that are left out as they failed.
        limited: runs that hit their time limit, which count.
    """

    costs: list[Cost] = field(default_factory=list)
    lengths: dict[tuple[Any, ...], tuple[float, float]] = field(default_factory=dict)
    recordings: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    failed: int = 0
    limited: int = 0

    @classmethod
    def of(cls, costs: Iterable[Cost]) -> Knowledge:
        """Return the knowledge that finished runs give."""
        found = cls()
        for cost in costs:
            prepared = cost.prepared or {}
            data, mode, given = cost.dataset, cost.spec.get("sensors") or "", cost.spec.get("input") or {}
            if prepared.get("frames") and prepared.get("durationSeconds"):
                length = (float(prepared["frames"]), float(prepared["durationSeconds"]))
                found.lengths.setdefault((data, mode, *_cut(given)), length)
            if prepared.get("recordedFrameRate") and prepared.get("recordedSeconds"):
                whole = (float(prepared["recordedFrameRate"]), float(prepared["recordedSeconds"]))
                found.recordings.setdefault((data, mode), whole)
            # A failed run cost little because it failed; one that hit its time limit cost at least that.
            if cost.reason is None or cost.reason == Reason.DEADLINE_EXCEEDED:
                found.limited += cost.reason is not None
                found.costs.append(cost)
            else:
                found.failed += 1
        return found

    def known(self, *, folders: bool = False) -> list[Known]:
        """Return the runs with their settings and costs.

        Args:
            folders: whether to look at what their files take.
        """
        sizes: dict[tuple[str, str], int] = {}
        found = []
        for cost in self.costs:
            setting = self.setting_of(cost)
            costs = {
                quantity: float(value)
                for quantity, value in (
                    (Quantity.CPU, cost.cpu_seconds),
                    (Quantity.WALL, cost.wall_seconds),
                    (Quantity.MEMORY, cost.memory_bytes),
                )
                if value
            }
            kind = (cost.algorithm, cost.dataset)
            # Runs of one kind write much the same: to go through the folders of thousands would take minutes.
            if folders and cost.folder and sizes.get(kind, 0) < MOST_FOLDERS:
                extent = DiskTally().of(Path(cost.folder))
                if extent.files and Path(cost.folder).is_dir():
                    sizes[kind] = sizes.get(kind, 0) + 1
                    costs[Quantity.DISK] = float(extent.size)
            found.append(Known(setting, costs))
        return found

    def setting_of(self, cost: Cost) -> Setting:
        """Return the setting of a finished run."""
        given = cost.spec.get("input") or {}
        mode = cost.spec.get("sensors") or ""
        frames, length = self.lengths.get((cost.dataset, mode, *_cut(given)), (None, None))
        prepared = cost.prepared or {}
        return Setting(
            algorithm=cost.algorithm,
            sensors=mode,
            pace=given.get("pace") or "",
            dataset=cost.dataset,
            processor=cost.cpu_model,
            occasion=cost.sweep_uid,
            frames=prepared.get("frames") or frames,
            seconds=prepared.get("durationSeconds") or length,
            resolution=float(given.get("resolution") or 1),
            rate=float(given.get("rate") or 1),
            changed=_flat(cost.spec),
        )

    def starting_seconds(self) -> float:
        """Return the time that runs were made ready before their programs began, s: the median."""
        found = [
            (cost.started - cost.created).total_seconds()
            for cost in self.costs
            if cost.created is not None and cost.started is not None
        ]
        # The median, as the first run of a recording also prepares it, which the next ones need not.
        return max(0.0, median(found)) if found else 0.0


class Combinations(Points, Protocol):
    """The runs of a sweep, and the combinations that they repeat."""

    @property
    def algorithms(self) -> Mapping[str, Algorithm]:
        """Return the Algorithms of the catalog by name."""

    @property
    def datasets(self) -> Mapping[str, Dataset]:
        """Return the Datasets of the catalog by name."""

    def settings(self, row: int) -> Settings:
        """Return the fields of a combination by path, as they take effect."""

    def short_spec(self, settings: Settings) -> dict[str, str | None]:
        """Return the names in a combination's spec: algorithm, dataset and sensor mode."""

    def basis(self, algorithm: str) -> dict[str, Any]:
        """Return the spec of the runs of an algorithm before anything is set."""


class PlannedSetting(NamedTuple):
    """Setting, time limit and processors of a combination of a plan, from which its cost is predicted.

    Attributes:
        setting: what is predicted from.
        limit: s that its program may take.
        cpu: its processors, as a manifest writes them.
        alone: whether nothing runs beside it.
    """

    setting: Setting
    limit: float
    cpu: str
    alone: bool


def planned_settings(
    points: Combinations, rows: Sequence[int], knowledge: Knowledge, processor: str | None
) -> list[PlannedSetting]:
    """Return the needs of a plan's combinations.

    Args:
        points: the plan.
        rows: which combinations.
        knowledge: of lengths of recordings.
        processor: model of the processor that they are to run on.
    """
    bases: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {}
    lengths: dict[tuple[Any, ...], tuple[float | None, float | None]] = {}
    found = []
    # Bases are the same for all rows of an algorithm, of which there may be thousands.
    for row in rows:
        settings = points.settings(row)
        spec = points.short_spec(settings)
        name, data = spec["algorithm"] or "", spec["dataset"] or ""
        if name not in bases:
            whole = points.basis(name)
            bases[name] = (whole, _flat(whole))
        whole, options = bases[name]
        changed = {
            ".".join(path): _plain(value)
            for path, value in settings.items()
            if path[0] in {"parameters", "input", "resources"} and ".".join(path) not in _SPARE
        }
        given = whole.get("input", {}) | {
            path[1]: value for path, value in settings.items() if path[0] == "input" and len(path) == 2
        }
        mode = spec["sensors"] or ""
        key = (data, mode, *_cut(given))
        if key not in lengths:
            lengths[key] = _length(points, name, key, given, knowledge)
        frames, length = lengths[key]
        setting = Setting(
            algorithm=name,
            sensors=mode,
            pace=given.get("pace") or "",
            dataset=data,
            processor=processor,
            occasion=NOW,
            frames=frames,
            seconds=length,
            resolution=float(given.get("resolution") or 1),
            rate=float(given.get("rate") or 1),
            options=options,
            changed=changed,
        )
        resources = whole.get("resources", {})
        cpu = settings.get(("resources", "cpu"), resources.get("cpu", "1"))
        alone = settings.get(("resources", "exclusiveNodes"), resources.get("exclusiveNodes"))
        limit = seconds(settings.get(("timeout",), whole.get("timeout", "1h")))
        found.append(PlannedSetting(setting, limit, str(cpu), bool(alone)))
    return found


def _length(
    points: Combinations, algorithm: str, key: tuple[Any, ...], given: Mapping[str, Any], knowledge: Knowledge
) -> tuple[float | None, float | None]:
    """Return the frames and s that a run is given of its recording; None where they aren't known."""
    if key in knowledge.lengths:
        return knowledge.lengths[key]
    name, mode = key[:2]
    whole = knowledge.recordings.get((name, mode))
    rate, length = whole if whole is not None else (None, None)
    dataset, one = points.datasets.get(name), points.algorithms.get(algorithm)
    if whole is None and dataset is not None and one is not None and mode:
        try:
            seen = recorded(dataset, one.spec.mode(SensorMode(mode)), given)
            rate, length = seen.frame_rate, seen.seconds
        except (InputError, ValueError, KeyError):
            return None, None
    if length is None:
        return None, None
    length = max(0.1, length - seconds(given.get("start") or "0s"))
    if given.get("duration"):
        length = min(length, seconds(given["duration"]))
    rates = [one for one in (rate, given.get("frameRate")) if one is not None]
    return (max(1.0, min(rates) * length) if rates else None), length


def _cut(given: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the options on which it depends how much a run is given of its recording."""
    return given.get("frameRate"), given.get("start"), given.get("duration")


def _flat(spec: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a spec by name, those that change no cost left out."""
    found: dict[str, Any] = {}
    for section in ("parameters", "input", "resources"):
        for name, value in (spec.get(section) or {}).items():
            if isinstance(value, dict):
                found.update((f"{section}.{name}.{key}", _plain(item)) for key, item in value.items())
            elif value is not None or section == "parameters":
                found[f"{section}.{name}"] = _plain(value)
    for name in _SPARE:
        found.pop(name, None)
    return found


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool | None) else repr(value)
