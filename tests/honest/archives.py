# SPDX-License-Identifier: Apache-2.0
"""Made-up archives, as nasty as real ones get: raw rows of the archive's tables.

One generator makes them, from Python's random numbers (a seed is an archive) or from hypothesis's, which then
looks for the smallest archive that breaks something.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from hypothesis import strategies as st
from sqlalchemy import create_engine, event, insert

from slamhive.archive import schema

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sqlalchemy import Engine

    Tables = dict[str, list[dict[str, Any]]]

START = datetime(2026, 3, 1, 12, tzinfo=UTC)
PLACES = ((None, None), ("lab", "slam"), ("lab", "other"), ("edge", "slam"))
MODES = ("mono", "stereo", "rgbd", "mono-inertial")
PACES = ("Realtime", "Lockstep", None)
PROCESSORS = ("Ryzen 9", "Xeon", None)
REASONS = (
    *("InvalidParameters", "DatasetMissing", "AlgorithmUnavailable", "PreparationFailed", "ImagePullFailed"),
    *("OutOfMemory", "DeadlineExceeded", "AlgorithmFailed", "OutputTooLarge", "NoTrajectory"),
    *("InvalidTrajectory", "NodeLost", "Disrupted", "SystemFault"),
)
OUTCOMES = ("Tracked", "Tracked", "Tracked", "Partial", "Lost", "Diverged")
EVALUATIONS = (
    ("se3", ("se3",), ("5e30", "5e31")),
    ("sim3", ("sim3",), ("5130",)),
    ("default", ("se3", "sim3", None), ("def0", "def1", None)),
)
"""Evaluations: name, alignments, hashes of settings."""

TRACKS = ("aa" * 32, "bb" * 32, "cc" * 32)
NUMBERS = (0.0, 0.01, 0.02, 0.02, 0.5, 1.0, 3.25)
"""Errors that several runs have, so that there are ties."""


@dataclass(frozen=True)
class _Version:
    """A sweep as it was asked for once."""

    uid: str
    name: str
    place: tuple[str | None, str | None]


def made_up(random: Random) -> Tables:
    """Return the rows of an archive: JSON values, times as texts."""
    places = random.sample(PLACES, random.choice((1, 1, 1, 2, 3)))
    sweeps, versions = _sweeps(random, places)
    evaluations = [
        (name, _some(random, alignments, 0.7), _some(random, settings, 0.7))
        for name, alignments, settings in random.sample(EVALUATIONS, random.choice((1, 1, 2, 3)))
    ]
    # Few values of each kind: nearly all archives then hold repetitions, equals and edits.
    kinds: dict[str, Any] = {
        "algorithm": _some(random, ("orb", "vins", "kiss"), 0.3),
        "dataset": _some(random, ("mh01", "room", "street"), 0.5),
        "sensors": _some(random, MODES, 0.7),
        "n": _some(random, (500, 1000, 2000), 0.6),
        "pace": _some(random, PACES, 0.7),
        "processor": _some(random, PROCESSORS, 0.7),
        "reader": _some(random, (True, False, None), 0.7),
        # A change of algorithm or dataset supersedes much: in most archives there is none.
        "versions": [1] * random.choice((2, 8, 30)) + [2, 3][: random.choice((0, 0, 0, 1, 2))],
        "repetitions": random.choice(((0,), (0, 1, 2), (0, 0, 1, 2, 3))),
        "tracks": [TRACKS[:1], TRACKS, ()][random.randrange(3)],
        "missing": [random.choice((0.0, 0.0, 0.05, 0.2))],
        # In such an archive the same comes out of the same setting each time, also how it fails.
        "steady": [random.choice((None, None, random.random()))],
    }
    runs: list[dict[str, Any]] = []
    results: list[dict[str, Any]] = []
    for _ in range(random.choice((1, 3, 8, 16, 30, 50))):
        version = random.choice(versions)
        place = version.place if version else random.choice(places)
        run = _run(random, kinds, (version, place), runs)
        mine = [one for one in evaluations if random.random() < 0.8]
        meant = [_meant(random, one) for one in mine]
        if random.random() < 0.9:
            run["evaluations"] = meant
        runs.append(run)
        results += _results(random, run, evaluations, meant, kinds["steady"][0])
    return {"sweeps": sweeps, "runs": runs, "results": results}


def _some(random: Random, values: Sequence[Any], alone: float) -> list[Any]:
    """Return one of some values with a probability, else several."""
    return random.sample(values, 1 if random.random() < alone else random.randint(1, len(values)))


def archives() -> st.SearchStrategy[Tables]:
    """Return made-up archives that hypothesis can make smaller."""
    return st.randoms(use_true_random=False).map(made_up)


def _sweeps(random: Random, places: list[Any]) -> tuple[list[dict[str, Any]], list[_Version | None]]:
    rows: list[dict[str, Any]] = []
    versions: list[_Version | None] = [None]
    for name in random.sample(("rates", "grid", "night"), random.randint(0, 3)):
        for place in places:
            for number in range(random.choice((0, 1, 1, 1, 2, 3))):
                version = _Version(f"{number}{name}-{'-'.join(filter(None, place))}", name, place)
                versions.append(version)
                if random.random() < 0.1:  # its row was never stored, or is lost
                    continue
                rows.append(
                    {
                        "uid": version.uid,
                        "name": name,
                        "labels": {},
                        "spec": {},
                        "evaluation": None,
                        "created": _time(random),
                        "cluster": place[0],
                        "namespace": place[1],
                    }
                )
    random.shuffle(rows)
    return rows, versions


def _time(random: Random) -> str | None:
    """Return one of few times, so that there are ties, or none."""
    if random.random() < 0.15:
        return None
    return (START + timedelta(minutes=random.randint(0, 6))).isoformat()


def _run(
    random: Random,
    kinds: Mapping[str, Any],
    where: tuple[_Version | None, tuple[str | None, str | None]],
    earlier: list[dict[str, Any]],
) -> dict[str, Any]:
    version, place = where
    number = len(earlier) + 1
    picked = {name: random.choice(values) for name, values in kinds.items() if values}
    repetition, missing = picked["repetitions"], picked["missing"]
    algorithm = picked["algorithm"] if random.random() >= missing / 4 else None
    dataset = picked["dataset"] if random.random() >= missing / 4 else None
    spec: dict[str, Any] = {
        "sensors": picked["sensors"] if random.random() >= missing else None,
        "repetition": repetition,
        "parameters": {"n": picked["n"]} if random.random() >= missing else {},
        "input": {"pace": picked["pace"]} if picked["pace"] else {},
    }
    if algorithm:
        spec["algorithmRef"] = {"name": algorithm}
    if dataset:
        spec["datasetRef"] = {"name": dataset}
    provenance = _provenance(random, spec, kinds, earlier)
    chance = random
    if picked["steady"] is not None and random.random() < 0.95:
        asked = {name: value for name, value in spec.items() if name != "repetition"}
        chance = Random(json.dumps([picked["steady"], asked, provenance.get("algorithmHash")]))
    phase, reason = _end(chance)
    if picked["processor"]:
        provenance["cpuModel"] = picked["processor"]
    created = _time(random)
    return {
        "id": number,
        "uid": f"uid-{number:03}",
        "name": f"run-{number:03}",
        "sweep": version.name if version else None,
        "sweep_uid": version.uid if version and random.random() < 0.95 else None,
        "cluster": place[0],
        "namespace": place[1],
        "point": number,
        "algorithm": algorithm,
        "dataset": dataset,
        "sensors": spec["sensors"],
        "pace": picked["pace"],
        "repetition": repetition,
        "seed": None,
        "phase": phase,
        "reason": reason,
        "message": None,
        "attempts": 1,
        "created": created,
        "started": created,
        "finished": created,
        "content_hash": provenance.get("contentHash"),
        "reused_from": provenance.get("reusedFrom"),
        "cpu_model": provenance.get("cpuModel"),
        "labels": {},
        "spec": spec,
        "attributes": {"fps": 20} if random.random() >= missing else {},
        "usage": _usage(random, picked["reader"]),
        "frames": None,
        "metrics": {},
        "trajectory": _trajectory(chance, kinds["tracks"]) if phase == "Succeeded" else None,
        "evaluations": [],
        "provenance": provenance,
        "folder": None,
        "log_tail": None,
    }


def _end(random: Random) -> tuple[str, str | None]:
    draw = random.random()
    if draw < 0.65:
        return "Succeeded", None
    if draw < 0.9:
        return "Failed", random.choice(REASONS) if random.random() < 0.97 else None
    return "Cancelled", random.choice(("Cancelled", None))


def _provenance(
    random: Random, spec: Mapping[str, Any], kinds: Mapping[str, Any], earlier: list[dict[str, Any]]
) -> dict[str, Any]:
    found: dict[str, Any] = {}
    (missing,) = kinds["missing"]
    for key, kind in (
        ("algorithmHash", "algorithmRef"),
        ("environment", "algorithmRef"),
        ("datasetSha256", "datasetRef"),
        ("preparation", "datasetRef"),
    ):
        if random.random() >= missing:
            name = spec.get(kind, {}).get("name")
            found[key] = f"{key}-{name}-{random.choice(kinds['versions'])}"
    if random.random() < 0.3:
        found["imageID"] = f"sha256:{random.choice(kinds['versions'])}"
    if random.random() >= missing:
        content = json.dumps([spec, found], sort_keys=True)
        found["contentHash"] = hashlib.sha256(content.encode()).hexdigest()
        equals = [run for run in earlier if run["content_hash"] == found["contentHash"]]
        if (equals and random.random() < 0.7) or random.random() < 0.03:
            found["reusedFrom"] = equals[0]["uid"] if equals else "uid-gone"
    return found


def _usage(random: Random, reader: bool | None) -> dict[str, Any] | None:
    if random.random() < 0.15:
        return None
    wall = random.choice((10.0, 20.0, random.uniform(5, 50)))
    usage: dict[str, Any] = {
        "cpu": {"seconds": random.uniform(1, 100)},
        "memory": {"peakBytes": random.randint(1, 10**9)} if random.random() < 0.9 else {},
    }
    if random.random() < 0.9:
        usage["wallSeconds"] = wall
    if random.random() < 0.9:
        usage["cpu"] |= {"meanCores": random.choice((1.0, random.uniform(0.2, 4))), "maxCores": 4.0}
    if random.random() < 0.5:
        usage["contendedSeconds"] = wall * random.choice((0.0, 0.05, 0.2, 0.9))
    if random.random() < 0.5:
        usage["throttledSeconds"] = wall * random.choice((0.0, 0.001, 0.02))
    if reader is not None:
        usage["includesReader"] = reader
        if not reader and random.random() < 0.8:
            usage["readerCpuSeconds"] = random.choice((0.0, 0.5))
    return usage


def _trajectory(random: Random, tracks: tuple[str, ...]) -> dict[str, Any] | None:
    if random.random() < 0.05:
        return None
    sha = random.choice(tracks) if tracks else f"{random.getrandbits(256):064x}"
    return {"poses": 100, "durationSeconds": 10.0, "sha256": sha, "path": "trajectory.txt"}


def _meant(random: Random, evaluation: tuple[str, Sequence[Any], Sequence[Any]]) -> dict[str, Any]:
    name, alignments, settings = evaluation
    return {
        "evaluation": name,
        "alignment": random.choice(alignments) if random.random() < 0.9 else None,
        "settings": random.choice(settings) if random.random() < 0.9 else None,
    }


def _results(
    random: Random,
    run: Mapping[str, Any],
    evaluations: list[Any],
    meant: list[dict[str, Any]],
    steady: float | None,
) -> list[dict[str, Any]]:
    if random.random() >= {"Succeeded": 0.9, "Failed": 0.05}.get(run["phase"], 0.0):
        return []
    wanted = [one for one in meant if random.random() < 0.9]
    names = {one["evaluation"] for one in wanted}
    # Measured later by what nobody had meant at first.
    wanted += [_meant(random, one) for one in evaluations if one[0] not in names and random.random() < 0.1]
    track = (run["trajectory"] or {}).get("sha256")
    return [
        _result(random if steady is None else Random(f"{steady} {track} {one}"), run["id"], one)
        for one in wanted
    ]


def _result(random: Random, run: int, evaluation: Mapping[str, Any]) -> dict[str, Any]:
    outcome = random.choice(OUTCOMES)
    values: dict[str, Any] = {}
    for name in ("alignment", "settings"):
        if evaluation[name] is not None:
            values[name] = evaluation[name]
    if random.random() < 0.5:
        values["evaluationVersion"] = 2
    if random.random() < 0.95:
        rmse = random.choice(NUMBERS) if random.random() < 0.4 else random.uniform(0.001, 2)
        values["ate"] = {"rmse": rmse, "mean": rmse * 0.9}
    if random.random() < 0.8:
        values["rpe"] = [{"delta": 1.0, "unit": "m", "rmse": random.uniform(0.001, 0.1)}]
    if random.random() < 0.3:
        values["scale"] = random.choice((1.0, 1.02, random.uniform(0.9, 1.1)))
    coverage = None if random.random() < 0.1 else random.choice((1.0, 1.0, 0.95, random.uniform(0, 1)))
    return {
        "run_id": run,
        "evaluation": evaluation["evaluation"],
        "outcome": outcome,
        "coverage": coverage,
        "alignment": values.get("alignment"),
        "scale": values.get("scale"),
        "ate_rmse": values.get("ate", {}).get("rmse"),
        "rpe_rmse": values["rpe"][0]["rmse"] if "rpe" in values else None,
        "values": values,
    }


def _engine(url: str) -> Engine:
    """Return an engine that does not wait for the disk: these archives live for a moment."""
    engine = create_engine(url)
    event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA synchronous = OFF"))
    return engine


@cache
def _empty() -> bytes:
    """Return the file of an archive without runs."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "archive.sqlite"
        engine = _engine(f"sqlite:///{file}")
        schema.metadata.create_all(engine)
        with engine.begin() as connection:
            connection.execute(insert(schema.schema_version), [{"version": schema.VERSION}])
        engine.dispose()
        return file.read_bytes()


def write(tables: Tables, file: Path) -> str:
    """Write an archive's rows into an SQLite file anew, and return its URL."""
    for ending in ("", "-wal", "-shm", "-journal"):  # who still reads the one before keeps it
        Path(f"{file}{ending}").unlink(missing_ok=True)
    file.write_bytes(_empty())
    url = f"sqlite:///{file}"
    engine = _engine(url)
    try:
        with engine.begin() as connection:
            for table in (schema.sweeps, schema.runs, schema.results):
                if rows := tables[table.name]:
                    connection.execute(insert(table), [with_times(row) for row in rows])
    finally:
        engine.dispose()
    return url


def with_times(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with its times read."""
    times = {
        name: datetime.fromisoformat(row[name])
        for name in ("created", "started", "finished")
        if row.get(name) is not None
    }
    return {**row, **times}
