# SPDX-License-Identifier: Apache-2.0
"""Process executor: a workstation's runner in this process, on a home of its own."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import yaml

from slamhive.archive import Archive
from slamhive.local.home.catalog import Workshop
from slamhive.local.home.folder import Home
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job, Runner, Watcher
from slamhive.local.running.workbench import Workbench
from slamhive.model.loading import load_file
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.local.programs.engines import ContainerChoice

TINY = Path(__file__).parents[2] / "actor" / "tiny.yaml"


class Process:
    """Runs sweeps as `slamhive run` does.

    Args:
        home: where; its file tiny.yaml is the dataset.
    """

    name = "process"
    container: ClassVar[ContainerChoice | None] = None

    def __init__(self, home: Home) -> None:
        self.home = home
        self._folder = home.path / "behaving"
        self._folder.mkdir()

    @classmethod
    def at(cls, folder: Path, environments: Path, datasets: Path) -> Self:
        """Make one on a home of its own.

        Args:
            folder: where the home is made.
            environments: virtual environments that homes share.
            datasets: a folder in which the small recording has been made.
        """
        folder.mkdir()
        (folder / "environments").symlink_to(environments)
        (folder / "datasets").symlink_to(datasets)
        shutil.copyfile(TINY, folder / "tiny.yaml")
        return cls(Home.at(folder))

    def program(self, text: str) -> dict[str, Any]:
        (self._folder / "adapter.py").write_text(text)
        (self._folder / "requirements.txt").write_text("")
        return {"local": {"adapter": "adapter.py", "requirements": "requirements.txt", "python": ">=3.11"}}

    def run(
        self,
        algorithm: Mapping[str, Any],
        sweep: Mapping[str, Any],
        *,
        rerun: bool = False,
    ) -> str:
        path = self._folder / "algorithm.yaml"
        path.write_text(yaml.safe_dump(dict(algorithm)))
        workshop = Workshop()
        workshop.add(load_file(path), self._folder)
        workshop.add(load_file(self.home.path / "tiny.yaml"), self.home.path)
        asked = Sweep.model_validate({key: sweep[key] for key in ("metadata", "spec")})
        with Archive.open(self.home.archive_url) as archive:
            job = Job(asked, local_uid(asked), Plan(asked, workshop))
            runner = Runner(
                Workbench(self.home, workshop, archive, container=self.container),
                Silent(),
                wish=RunChoice(rerun=rerun),
            )
            assert not runner.run([job])
        return self.home.archive_url

    def faults(self, sweep: str) -> dict[str, int]:
        return {}  # where it does, something is wrong


class Silent(Watcher):
    """A watcher that shows nothing."""
