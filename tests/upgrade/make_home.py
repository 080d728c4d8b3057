# SPDX-License-Identifier: Apache-2.0
"""A maker of homes for the tests of upgrades: a sweep of this checkout, stopped half-way by SIGKILL.

    git worktree add ../released v0.2.0
    cd ../released && make install && .venv/bin/python tests/upgrade/make_home.py 0.2.0
    cp tests/upgrade/homes/0.2.0.tar.xz …/tests/upgrade/homes/

Kept are the archive, the runs, the catalog and what links them; recordings and environments are made again.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
ROOT = TESTS.parent
HOMES = Path(__file__).parent / "homes"
KEPT = ("archive.sqlite", "algorithms", "runs", "journal", "tiny.yaml", "sweep.yaml")
PLACE = "@HOME@"
"""Placeholder in all texts for the folder that the home was in."""
HELD = 1500
"""Number of the point at which slamhive is killed; also for how many milliseconds it runs."""
DEADLINE_SECONDS = 300
SWEEP = f"""\
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {{name: halfway}}
spec:
  template:
    spec: {{algorithmRef: {{name: actor}}, datasetRef: {{name: tiny}}}}
  matrix:
    - {{path: parameters.number, values: [0, 1, {HELD}, 2]}}
    - {{path: parameters.act, values: [noted, crash]}}
"""


# What tells apart environments names Python's version and the machine: they differ where tests are run.
# The tests are about all else that tells experiments apart.
def make_environments_equal() -> None:
    """Have all environments called the same; before anything else of slamhive is imported."""
    from slamhive.local.programs import environments
    from slamhive.local.running import workbench

    def digest(*_: object) -> str:
        return "the environment"

    environments.Environments.digest = digest  # type: ignore[method-assign]
    environments.digest_of = workbench.digest_of = digest


PROGRAM = """\
from make_home import make_environments_equal
make_environments_equal()
from slamhive.cli.main import main
main()
"""


def slamhive(home: Path, *arguments: str) -> subprocess.Popen[bytes]:
    """Start the slamhive of a checkout on a home."""
    return subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments], env=surroundings(home), cwd=home)


def surroundings(home: Path) -> dict[str, str]:
    """Return the environment of a slamhive of this checkout on a home."""
    kept = {name: value for name, value in os.environ.items() if name != "SLAMHIVE_ARCHIVE"}
    code = os.pathsep.join(map(str, (ROOT / "operator", ROOT / "evaluator", Path(__file__).parent)))
    return kept | {"SLAMHIVE_HOME": str(home), "PYTHONPATH": code}


def lay_out(home: Path) -> None:
    """Make a home with the actor, the small dataset's manifest and the sweep."""
    actor = home / "algorithms" / "actor"
    actor.mkdir(parents=True)
    for name in ("algorithm.yaml", "adapter.py", "requirements.txt"):
        shutil.copyfile(TESTS / "actor" / name, actor / name)
    shutil.copyfile(TESTS / "actor" / "tiny.yaml", home / "tiny.yaml")
    (home / "sweep.yaml").write_text(SWEEP)
    for arguments in (("dataset", "add", "tiny.yaml"), ("dataset", "make", "tiny")):
        if slamhive(home, *arguments).wait():
            sys.exit("the dataset could not be made")
    write_truth(home)


def write_truth(home: Path) -> None:
    """Give the actor the ground truth of the small dataset."""
    truth = next(home.glob("datasets/tiny-*/groundtruth.txt")).read_text()
    lines = [f"{line}\n" for line in truth.splitlines() if line[0] != "#"]
    (home / "algorithms" / "actor" / "truth.txt").write_text("".join(lines))


def run_halfway(home: Path) -> None:
    """Run the sweep and kill it amid the run that takes long."""
    process = slamhive(home, "run", "sweep.yaml", "--parallelism", "1")
    until = time.monotonic() + DEADLINE_SECONDS
    while process.poll() is None and time.monotonic() < until:
        starts = journal(home)
        if len(starts) == 3:  # 0, 1 and the long one
            process.kill()
            process.wait()
            return
        time.sleep(0.02)
    sys.exit("slamhive ended, or the run to be cut off never began")


def journal(home: Path) -> list[str]:
    """Return the runs that were started, by the account of the algorithm itself."""
    path = home / "journal"
    lines = path.read_text().splitlines() if path.exists() else []
    return [words["run"] for words in map(json.loads, lines) if words["event"] == "start"]


def keep(home: Path, target: Path) -> None:
    """Pack a home, with a word in place of its folder."""
    replace(home, str(home), PLACE)
    target.parent.mkdir(exist_ok=True)
    with tarfile.open(target, "w:xz", preset=9) as archive:
        for name in KEPT:
            archive.add(home / name, name)


def unpack(packed: Path, home: Path) -> None:
    """Unpack a home into a folder and make that its own."""
    with tarfile.open(packed) as archive:
        archive.extraction_filter = getattr(tarfile, "tar_filter", None)  # Python 3.11.4 has it
        archive.extractall(home)  # noqa: S202 - an archive of our own
    replace(home, PLACE, str(home))


def replace(home: Path, old: str, new: str) -> None:
    """Replace a text in all files, links and columns of a home."""
    for path in sorted(home.rglob("*")):
        if path.is_symlink():
            target = str(path.readlink())
            path.unlink()
            path.symlink_to(target.replace(old, new))
        elif path.is_file() and not path.name.startswith("archive.sqlite"):
            content = path.read_bytes()
            if old.encode() in content:
                path.write_bytes(content.replace(old.encode(), new.encode()))
    database = sqlite3.connect(home / "archive.sqlite")
    with database:
        tables = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for table in tables:
            columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            for column in columns:
                change = f'UPDATE "{table}" SET "{column}" = replace("{column}", ?, ?)'
                database.execute(f'{change} WHERE instr("{column}", ?)', (old, new, old))
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.close()


def main() -> None:
    """Make a home."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("name", help="of the version, such as 0.2.0")
    name = parser.parse_args().name
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "home"
        lay_out(home)
        run_halfway(home)
        keep(home, HOMES / f"{name}.tar.xz")


if __name__ == "__main__":
    main()
