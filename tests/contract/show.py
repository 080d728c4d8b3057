# SPDX-License-Identifier: Apache-2.0
"""Command that prints what an executor makes of the table of behaviours, to be compared by `diff`.

    .venv/bin/python tests/contract/show.py process
    .venv/bin/python tests/contract/show.py container
    .venv/bin/python tests/contract/show.py cluster --namespace lab

`cluster` is the one of $KUBECONFIG, with SLAM Hive in the namespace; what is made there is deleted again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "cluster"), str(HERE.parent / "e2e")]

from executors import table  # noqa: E402
from executors.container import InContainers  # noqa: E402
from executors.process import TINY, Process  # noqa: E402

from slamhive.data.files.erasing import erase  # noqa: E402
from slamhive.data.store.datasets import materialise  # noqa: E402
from slamhive.model.loading import load_file  # noqa: E402

if TYPE_CHECKING:
    from executors.executor import Row


def process(_: str) -> dict[str, Row]:
    """Return the table's outcomes on a workstation."""
    return workstation(Process)


def container(_: str) -> dict[str, Row]:
    """Return the table's outcomes in containers."""
    return workstation(InContainers)


def workstation(kind: type[Process]) -> dict[str, Row]:
    """Return the table's outcomes on an executor with a home of its own."""
    folder = Path(tempfile.mkdtemp())
    try:
        (dataset,) = load_file(TINY)
        environments, datasets = folder / "environments", folder / "datasets"
        environments.mkdir()
        datasets.mkdir()
        materialise(dataset, datasets, datasets)
        return table.carry_out(kind.at(folder / "home", environments, datasets))
    finally:
        erase(folder)


def cluster(namespace: str) -> dict[str, Row]:
    """Return the table's outcomes on the cluster of $KUBECONFIG."""
    from executors.cluster import OnCluster
    from onnode.documents import Desk
    from onnode.lab import Lab
    from testcluster.choice import Current

    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        found = Current().up(node=True)
        lab = Lab(found, namespace, Desk(folder, found.environment), folder, folder)
        made = OnCluster(lab, folder)
        stack.callback(made.delete, *table.study(made))
        return table.carry_out(made)


EXECUTORS = {"process": process, "container": container, "cluster": cluster}


def main() -> None:
    """Print the table of an executor."""
    parser = argparse.ArgumentParser(description="Print what an executor makes of the table of behaviours.")
    parser.add_argument("executor", choices=[*EXECUTORS])
    parser.add_argument("--namespace", default="default", help="where SLAM Hive is, on a cluster")
    given = parser.parse_args()
    sys.stdout.write(table.text(EXECUTORS[given.executor](given.namespace)))


if __name__ == "__main__":
    main()
