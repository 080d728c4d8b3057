# SPDX-License-Identifier: Apache-2.0
"""A small sweep in a home of its own, run under faults and once more without: what must be the same again."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from injecting import Command

from slamhive.archive import Archive
from slamhive.data.store.datasets import materialise
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from injecting import Call, Done, Fault, Injector

    from slamhive.model.results import RunRecord

ACTOR = Path(__file__).parents[1] / "actor"
TABLE = ("results", "table", "--sweep", "faulty", "-m", "ate.rmse", "-m", "coverage")
MANIFEST = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: faulty}
spec:
  template:
    spec: {algorithmRef: {name: actor}, datasetRef: {name: tiny}, retries: 1, parameters: {act: noted}}
  matrix:
  - {path: input.frameRate, values: [10, 5]}
---
apiVersion: slamhive.io/v1alpha1
kind: Evaluation
metadata: {name: again}
spec: {runs: {sweepRef: {name: faulty}}, alignment: SE3}
"""
_FORMS = (
    (r"runs/faulty/[^/]*", "runs/faulty/*"),
    (r"(variants|truths|environments)/(\.?)[0-9a-f]{16,}", r"\1/\2*"),
    (r"\.hashes/.*", ".hashes/*"),
    (r"(/\.?tiny-)[0-9a-f]{16}", r"\1*"),
    (r"\.[0-9a-f]{12}\.making", ".*.making"),
    (r"\.making-\w+", ".making-*"),
    (r"(variants/\*)\.[0-9a-f]{12}", r"\1"),
    (r"\.\d+\.tmp\b", ".*.tmp"),
    (r"(yaml\.)\d+", r"\1*"),
)


def form_of(path: str) -> str:
    """Return the form of a path: what differs from run to run is an asterisk."""
    for pattern, form in _FORMS:
        path = re.sub(pattern, form, path)
    return path


def write_home(home: Path, environments: Path) -> None:
    """Lay out a home with the actor; its environment is shared, all else is still to be made."""
    actor = home / "algorithms" / "actor"
    actor.mkdir(parents=True)
    for name in ("algorithm.yaml", "adapter.py", "requirements.txt"):
        shutil.copyfile(ACTOR / name, actor / name)
    shutil.copyfile(environments.parent / "truth.txt", actor / "truth.txt")
    environments.mkdir(exist_ok=True)
    (home / "environments").symlink_to(environments)
    (home / "sweep.yaml").write_text((ACTOR / "tiny.yaml").read_text() + "---" + MANIFEST)


def write_truth(place: Path) -> None:
    """Write what the actor copies: the ground truth of the small dataset."""
    folder = place.parent / "for-truth"
    entry = materialise(load_file(ACTOR / "tiny.yaml")[0], folder, folder)  # type: ignore[arg-type]
    lines = (entry.root / "groundtruth.txt").read_text().splitlines(keepends=True)
    place.write_text("".join(line for line in lines if not line.startswith("#")))
    shutil.rmtree(folder)


@dataclass(frozen=True)
class End:
    """State of a home after a command: its finished runs, how often each was started, and damage to files.

    Attributes:
        records: the finished runs by UID, as far as faults must not change them.
        done: of those that succeeded, when they did.
        started: how often each was started, by the algorithm's own account.
        ended: runs whose supervisor said that all went well.
        damage: what is wrong with the files, in sentences.
    """

    records: dict[str, Any] = field(default_factory=dict)
    done: dict[str, str] = field(default_factory=dict)
    started: Counter[str] = field(default_factory=Counter)
    ended: frozenset[str] = frozenset()
    damage: tuple[str, ...] = ()


def look(home: Path) -> End:
    """Say what a home holds."""
    started: Counter[str] = Counter()
    journal = home / "journal"
    for line in journal.read_text().splitlines() if journal.exists() else ():
        words = json.loads(line)
        started[words["run"]] += words["event"] == "start"
    ended = set()
    for summary in home.glob("runs/*/*/summary.json"):
        found = json.loads(summary.read_text())
        if found["reason"] is None and found["exitCode"] == 0:
            ended.add(summary.parent.name)
    database = home / "archive.sqlite"
    records: list[RunRecord] = []
    damage = []
    if database.exists() and database.stat().st_size:
        verdict, tables = _verdict(database)
        if verdict != "ok":
            damage.append(f"archive: {verdict}")
        if tables:
            with Archive.open(f"sqlite:///{database}") as archive:
                records = list(archive.runs())
    damage += [f"{record.name}: {problem}" for record in records for problem in _damage(record)]
    return End(
        {record.uid: comparable(record) for record in records},
        {record.name: str(record.finished) for record in records if record.phase == "Succeeded"},
        started,
        frozenset(ended),
        tuple(damage),
    )


def _verdict(database: Path) -> tuple[str, int]:
    """Return SQLite's verdict on a database, and the number of its tables."""
    connection = sqlite3.connect(database)
    try:
        tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        return connection.execute("PRAGMA integrity_check").fetchone()[0], tables
    except sqlite3.DatabaseError as error:
        return str(error), 0
    finally:
        connection.close()


def comparable(record: RunRecord) -> Any:
    """Return the part of a run that is the same whenever it is made."""
    found = record.as_json()
    for name in ("attempts", "created", "started", "finished", "usage", "folder", "logTail", "message"):
        found.pop(name, None)
    found.get("trajectory", {}).pop("path", None)
    return found


def _damage(record: RunRecord) -> list[str]:
    """Say what is missing of a run that succeeded, unless it says so itself."""
    if record.phase != "Succeeded" or record.folder is None:
        return []
    problems = []
    message = record.message or ""
    usage = Path(record.folder) / "run" / "output" / "usage.csv"
    text = usage.read_text() if usage.exists() else ""
    if "usage.csv" not in message and (not text.endswith("\n") or len(text.splitlines()) < 2):
        problems.append("usage.csv is not whole, and nothing says so")
    if record.usage is None:
        problems.append("no usage")
    if "not evaluated" in message and record.results:
        problems.append(f"is evaluated, and says: {message}")
    return problems


@dataclass(frozen=True)
class Outcome:
    """Outcome of a sweep with a fault, and of the same sweep once more without.

    Attributes:
        fault: as asked for.
        made: the calls that failed.
        first, second: the command with the fault, and once more without.
        word: unharmed, told (of, and mended by the second run), or absent (nothing failed).
        wrong: what must not be, in sentences.
    """

    fault: Fault
    made: list[Call]
    first: Done
    second: Done | None
    word: str
    wrong: tuple[str, ...]


class Scene:
    """A sweep that is run again and again, each time in a home of its own.

    Args:
        folder: for everything.
        injector: makes the faults.
    """

    def __init__(self, folder: Path, injector: Injector) -> None:
        self._folder = folder
        self._injector = injector
        self._environments = folder / "environments"
        self._count = 0
        write_truth(folder / "truth.txt")
        self._run(self._fresh(), None)  # makes the environment
        home = self._fresh()
        self.undisturbed = self._run(home, None)
        assert self.undisturbed.code == 0, self.undisturbed.err
        self.expected = look(home)
        self.table = self._command(home, TABLE, None).out
        assert len(self.expected.records) == 2
        assert not self.expected.damage, self.expected.damage

    def _fresh(self) -> Path:
        self._count += 1
        home = self._folder / f"home-{self._count}"
        write_home(home, self._environments)
        return home

    def _command(self, home: Path, words: tuple[str, ...], fault: Fault | None) -> Done:
        return self._injector.run(Command(words, {"SLAMHIVE_HOME": str(home)}), home, fault)

    def _run(self, home: Path, fault: Fault | None) -> Done:
        return self._command(home, ("run", str(home / "sweep.yaml"), "-j", "2"), fault)

    def inject(self, fault: Fault, *, table: bool = False) -> Outcome:
        """Run the sweep with a fault, then without, and say what became of it."""
        home = self._fresh()
        first = self._run(home, fault)
        between = look(home)
        wrong = [*self._wrong_of_command(first), *between.damage]
        lost = _superfluous_records(between, self.expected)
        wrong += [f"unknown record {uid}" for uid in lost]
        if first.code == 0 and between.records != self.expected.records:
            wrong.append(f"exit code 0, and {difference(between.records, self.expected.records)}")
        second = self._run(home, None)
        after = look(home)
        wrong += self._wrong_of_second(second, between, after)
        if table and self._command(home, TABLE, None).out != self.table:
            wrong.append("the table differs")
        word = "absent" if not first.calls else "unharmed" if first.code == 0 else "told"
        if not wrong:
            shutil.rmtree(home, ignore_errors=True)
        return Outcome(fault, first.calls, first, second, word, tuple(wrong))

    @staticmethod
    def _wrong_of_command(done: Done) -> list[str]:
        wrong = []
        if "Traceback" in done.err + done.out:
            wrong.append("a traceback")
        if done.code not in {0, 1, 2}:
            wrong.append(f"exit code {done.code}")
        if done.code and not done.err.strip() and "failed" not in done.out:
            wrong.append("no sentence")
        return wrong

    def _wrong_of_second(self, second: Done, between: End, after: End) -> list[str]:
        wrong = [f"then: {problem}" for problem in [*self._wrong_of_command(second), *after.damage]]
        if second.code != 0:
            wrong.append(f"then: exit code {second.code}: {second.err.strip()[-300:]}")
        if after.records != self.expected.records:
            wrong.append(f"then: {difference(after.records, self.expected.records)}")
        for run, when in between.done.items():
            if after.done.get(run) != when:
                wrong.append(f"{run} was finished, and done again")
        wrong += [
            f"{run} had ended, and was started again"
            for run in between.ended
            if after.started[run] > between.started[run]
        ]
        return wrong


def _superfluous_records(found: End, expected: End) -> list[str]:
    return sorted(found.records.keys() - expected.records.keys())


def difference(found: dict[str, Any], expected: dict[str, Any]) -> str:
    """Say in what two ends differ."""
    missing, more = expected.keys() - found.keys(), found.keys() - expected.keys()
    words = [f"{len(missing)} runs missing"] if missing else []
    words += [f"{len(more)} runs too many"] if more else []
    for uid in found.keys() & expected.keys():
        one, other = found[uid], expected[uid]
        keys = [key for key in one.keys() | other.keys() if one.get(key) != other.get(key)]
        words += [f"{key} is {json.dumps(one.get(key), default=str)[:160]}" for key in sorted(keys)]
    return "; ".join(dict.fromkeys(words)) or "the same"
