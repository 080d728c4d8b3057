# SPDX-License-Identifier: Apache-2.0
"""``slamhive dataset show``: a dataset's manifest, or a page with a picture of its recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
import yaml

from slamhive.cli.parts.console import open_workbench, out, remark
from slamhive.cli.parts.waiting import Work
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.errors import InputError


def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name in the catalog.")],
    *,
    page: Annotated[
        bool, typer.Option("--html", help="Write a page: images, path, rates and gaps over time, IMU.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="The page [NAME.html].")
    ] = None,
) -> None:
    """Show a dataset's manifest, or write a page with a picture of its recording.

    The page stands alone. The dashboard shows the same picture, once it was made.

    Example: slamhive dataset show synthetic-lidar --html
    """
    if page:
        _write_page(name, output or Path(f"{name}.html"))
        return
    if output is not None:
        raise InputError("--output: is the file of --html; the manifest goes to standard output")
    dataset = load_workshop(Home.from_environment()).dataset(name).dataset
    typer.echo(yaml.safe_dump(dataset.as_json(), sort_keys=False, allow_unicode=True), nl=False)


def _write_page(name: str, path: Path) -> None:
    from slamhive.data.files.outputs import output_whole
    from slamhive.data.inspecting.overview import overview
    from slamhive.data.inspecting.overviews import FOLDER
    from slamhive.data.store.datasets import HASHES
    from slamhive.reporting.dataset_page import dataset_page

    if not path.parent.is_dir():
        raise InputError(f"--output: {path}: there is no folder {path.parent}")
    home = Home.from_environment()
    with Work(f"looking at {name}") as work:
        bench = open_workbench(home)
        work.follow(bench.making)
        with bench.archive:
            entry = bench.dataset(name)
            made = overview(
                entry,
                home.folder("cache") / FOLDER,
                home.folder("datasets") / HASHES,
                home.folder("truths"),
                work.share,
            )
    with output_whole(path) as aside:
        aside.write_text(dataset_page(made, entry.dataset.spec.description or ""), encoding="utf-8")
    out.print(str(path), soft_wrap=True, markup=False)
    remark("the dashboard shows the same on the dataset's page")
