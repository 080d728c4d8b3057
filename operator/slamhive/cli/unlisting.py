# SPDX-License-Identifier: Apache-2.0
"""``dataset remove``, ``dataset rename`` and ``algorithm remove``: forgetting entries of the catalog."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.cli.parts.asking import DryRun, Yes, agreed, progress
from slamhive.cli.parts.console import bytes_text, open_archive, out, remark
from slamhive.local.home.folder import Home
from slamhive.model.base import plural

if TYPE_CHECKING:
    from slamhive.local.housekeeping.unlisting import Listed

Name = Annotated[str, typer.Argument(metavar="NAME", help="Name in the catalog.")]


def remove_dataset(name: Name, *, yes: Yes = False, dry_run: DryRun = False) -> None:
    """Forget a dataset: its manifest, and what was imported, generated or fetched of it.

    Files that it links to stay where they are. Records and files of its runs stay.

    Example: slamhive dataset remove hall --dry-run
    """
    from slamhive.local.housekeeping.unlisting import listed_dataset

    home = Home.from_environment()
    entry = listed_dataset(home, name)
    count = referring(home, "dataset", name)
    if count:
        remark(
            f"{plural(count, 'run')} of it stay readable; they can't be measured again, nor drawn over the "
            "ground truth"
        )
    _remove(home, entry, yes=yes, dry_run=dry_run)


def remove_algorithm(name: Name, *, yes: Yes = False, dry_run: DryRun = False) -> None:
    """Forget an algorithm. A folder that was added stays where it is; records and files of runs stay.

    Example: slamhive algorithm remove my-slam
    """
    from slamhive.local.housekeeping.unlisting import listed_algorithm

    home = Home.from_environment()
    entry = listed_algorithm(home, name)
    count = referring(home, "algorithm", name)
    if count:
        remark(f"{plural(count, 'run')} of it stay readable")
    _remove(home, entry, yes=yes, dry_run=dry_run)


def rename(name: Name, new: Annotated[str, typer.Argument(metavar="NEW", help="New name.")]) -> None:
    """Give a dataset another name: in its manifest, and in the records of its runs on this machine.

    Results stay what they are, and serve sweeps over the new name. Files of sweeps are yours to change.

    Example: slamhive dataset rename hall hall-2026
    """
    from slamhive.local.housekeeping.forgetting import alone
    from slamhive.local.housekeeping.unlisting import rename_dataset

    home = Home.from_environment()
    with open_archive(home) as archive, alone(home, "slamhive dataset rename"):
        total = archive.count({"dataset": name})
        with progress(f"renaming {name}", total or 1) as step:
            count = rename_dataset(home, archive, name, new, step)
        left = archive.count({"dataset": name})
    out.print(f"{name} is {new} now, with {plural(count, 'run')}", markup=False, soft_wrap=True)
    if left:
        remark(f"{plural(left, 'run')} of a cluster or an import keep the name: that dataset is another one")


def _remove(home: Home, entry: Listed, *, yes: bool, dry_run: bool) -> None:
    from slamhive.local.home.extent import DiskTally
    from slamhive.local.housekeeping.forgetting import alone
    from slamhive.local.housekeeping.unlisting import unlist

    tally = DiskTally(freed=True)
    link = f", a link to {entry.folder.resolve()}, which stays" if entry.folder.is_symlink() else ""
    for path in (entry.folder, *entry.made):
        extent = tally.of(path)
        what = link or f": {bytes_text(extent.size)} in {plural(extent.files, 'file')}"
        out.print(f"to remove: {path}{what}", markup=False, soft_wrap=True)
        link = ""
    if entry.comes_back:
        remark(f"{entry.name} is then the one again that comes with slamhive")
    if not agreed(f"Remove {entry.name}?", yes=yes, dry_run=dry_run):
        return
    with alone(home, f"the removal of {entry.name}"):
        busy = unlist(entry)
    out.print(f"removed: {entry.name}", markup=False)
    for folder in busy:
        remark(f"{folder} stays, as somebody works with it; slamhive gc removes it later")


def referring(home: Home, column: str, name: str) -> int:
    """Return the number of runs that refer to an entry; refuses a home of a newer version."""
    from slamhive.analysis.grouping import where_equal
    from slamhive.archive import Archive
    from slamhive.tables.reading import read_archive

    if home.missing_archive:
        return 0
    Archive.open(home.archive_url, read_only=True).close()
    frame = read_archive(home.archive_url, home.path / "cache")
    return frame.count_runs(where_equal(frame, column, name))
