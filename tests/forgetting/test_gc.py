# SPDX-License-Identifier: Apache-2.0
"""``slamhive gc``: what nothing refers to goes, and nothing because something else is missing."""

from __future__ import annotations

import errno
import os
import shutil
import time
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.data.files.once import in_use
from slamhive.data.store.datasets import made_folder
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import lock
from slamhive.local.programs.environments import Environments
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

VARIANTS = ("a" * 32, "b" * 32)
LONG_AGO = time.time() - 86_400


def cached(folder: Path, *, when: float = LONG_AGO) -> Path:
    """Make a folder as `once` does, last used at a time."""
    folder.mkdir(parents=True)
    (folder / "file").write_bytes(b"x" * 5000)
    mark = folder.with_name(f".{folder.name}.lock")
    mark.touch()
    os.utime(mark, (when, when))
    return folder


def refer(lab: Any, run: str, name: str, target: Path) -> None:
    link = lab.folder(run) / "run" / name
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(target)


@pytest.fixture
def variants(lab: Any) -> list[Path]:
    """Two variants, of which a run refers to the first."""
    found = [cached(lab.home.path / "variants" / name) for name in VARIANTS]
    lab.run("a")
    refer(lab, "a", "dataset", found[0])
    return found


def there(paths: list[Path]) -> list[bool]:
    return [path.exists() for path in paths]


def test_a_variant_goes_when_no_run_refers_to_it(
    lab: Any, slamhive: Callable[..., Any], variants: list[Path]
) -> None:
    said = slamhive("gc", "--dry-run")
    assert "variants 1 8 KiB a run was made from it" in said.out.replace("4 KiB", "8 KiB")
    assert there(variants) == [True, True]
    said = slamhive("gc", "--yes")
    assert (said.code, there(variants)) == (0, [True, False])
    assert said.out.endswith("in 1 file")
    assert slamhive("gc", "--yes").out.endswith("nothing to remove")
    # Once the run's files are forgotten, nothing refers to the other one either.
    slamhive("results", "prune", "--sweep", "s", "--yes")
    slamhive("gc", "--yes")
    assert there(variants) == [False, False]
    assert slamhive("results", "show", "a").code == 0


def test_all_takes_what_is_made_again(lab: Any, slamhive: Callable[..., Any], variants: list[Path]) -> None:
    said = slamhive("gc", "--all", "--yes")
    assert "a run was made from it; made again when it is needed" in said.out
    assert there(variants) == [False, False]
    assert (lab.folder("a") / "run" / "output" / "map.bin").exists()


def test_what_is_in_use_or_was_just_now_stays(
    lab: Any, slamhive: Callable[..., Any], variants: list[Path]
) -> None:
    young = cached(lab.home.path / "variants" / ("c" * 32), when=time.time())
    held = cached(lab.home.path / "variants" / ("d" * 32))
    with in_use(held):
        os.utime(held.with_name(f".{held.name}.lock"), (LONG_AGO, LONG_AGO))
        said = slamhive("gc", "--all", "--yes")
    assert "used in the last 10 minutes" in said.out
    assert "1 thing stayed, as somebody works with it" in said.err
    assert there([*variants, young, held]) == [False, False, True, True]


def test_nothing_goes_while_a_runner_is_at_work_or_unasked(
    lab: Any, slamhive: Callable[..., Any], variants: list[Path]
) -> None:
    with lock(lab.home.path / "runner.lock"):
        said = slamhive("gc", "--yes")
    assert (said.code, "another slamhive run is at work" in said.err) == (2, True)
    assert "--yes removes this" in slamhive("gc").err
    assert there(variants) == [True, True]


def test_a_full_disk_is_freed(
    lab: Any, slamhive: Callable[..., Any], variants: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    def refuse_to_open(_: object) -> None:
        raise SystemFault("the disk is full")

    usage = shutil.disk_usage(lab.home.path)._replace(free=0)
    monkeypatch.setattr("slamhive.archive.connection.shutil.disk_usage", lambda _: usage)
    monkeypatch.setattr("slamhive.cli.home.open_archive", refuse_to_open)
    monkeypatch.setattr("slamhive.local.home.folder.os.write", refuse)
    assert slamhive("gc", "--all", "--yes").code == 0
    assert there(variants) == [False, False]


def test_folders_of_runs_that_are_missing_keep_the_variants(
    lab: Any, slamhive: Callable[..., Any], variants: list[Path]
) -> None:
    lab.run("elsewhere", files=False)
    said = slamhive("gc", "--yes")
    assert "folders of 1 run are missing" in said.out
    assert there(variants) == [True, True]


def test_a_folder_without_record_goes_only_when_asked_for(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("a")
    lab.run("b")
    with lab.archive() as archive:
        archive.remove_run("u-b")
    assert "runs 1" in slamhive("gc", "--yes").out
    assert (lab.folder("b") / "run").exists()
    slamhive("gc", "--unrecorded", "--yes")
    assert not lab.folder("b").exists()
    assert (lab.folder("a") / "run").exists()


def test_without_an_archive_nothing_goes(
    lab: Any, slamhive: Callable[..., Any], variants: list[Path]
) -> None:
    (lab.home.path / "archive.sqlite").unlink()
    said = slamhive("gc", "--all", "--unrecorded", "--yes")
    assert (said.code, "no archive at" in said.err) == (2, True)
    assert there([*variants, lab.folder("a") / "run"]) == [True, True, True]


def test_a_linked_folder_may_be_another_homes(
    lab: Any, slamhive: Callable[..., Any], tmp_path: Path, variants: list[Path]
) -> None:
    elsewhere = tmp_path / "disk"
    (lab.home.path / "variants").rename(elsewhere)
    (lab.home.path / "variants").symlink_to(elsewhere)
    said = slamhive("gc", "--all", "--yes")
    assert "variants is a link: other homes may use it" in said.out
    assert there(variants) == [True, True]


def algorithm(lab: Any, name: str, **spec: Any) -> Path:
    folder = lab.home.path / "algorithms" / name
    folder.mkdir(parents=True)
    (folder / "requirements.txt").write_text(f"# {name}\n")
    (folder / "adapter.py").touch()
    body = {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Algorithm",
        "metadata": {"name": name},
        "spec": {
            "local": {"adapter": "adapter.py", "requirements": "requirements.txt"},
            "modes": [{"name": "lidar"}],
            "output": {"frame": "body", "stamp": "ScanStart"},
            **spec,
        },
    }
    (folder / "algorithm.yaml").write_text(yaml.safe_dump(body))
    return folder  # type: ignore[no-any-return]


def whole(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / ".complete").touch()
    return folder


def test_environments_and_assets_stay_while_the_catalog_or_a_run_needs_them(
    lab: Any, slamhive: Callable[..., Any]
) -> None:
    root, assets = lab.home.path / "environments", lab.home.path / "assets"
    checksums = {name: f"{number:064x}" for number, name in enumerate(("named", "used", "neither"))}
    asset = {"name": "v.txt", "url": "https://example.org/v.txt", "sha256": checksums["named"]}
    folder = algorithm(lab, "mine", assets=[asset])
    lab.run("a")
    entry = load_workshop(lab.home).algorithm("mine")
    (needed,) = map(whole, Environments(root).folders_of(entry))
    used, neither, half = whole(root / ("1" * 16)), whole(root / ("2" * 16)), root / ("3" * 16 + ".making")
    half.mkdir()
    (lab.folder("a") / "supervisor.json").write_text(f'{{"argv": ["{used}/bin/python"]}}')
    assets.mkdir()
    for checksum in checksums.values():
        (assets / checksum).write_text("x")
    (lab.folder("a") / "run" / "assets").mkdir()
    refer(lab, "a", "assets/v.txt", assets / checksums["used"])
    # While a folder of the catalog is away, what it may need stays.
    away = folder.rename(lab.home.path / "away")
    (lab.home.path / "algorithms" / "gone").symlink_to(lab.home.path / "nowhere")
    said = slamhive("gc", "--yes")
    assert "the folder of algorithm gone is missing" in said.out
    assert there([needed, used, neither, half]) == [True, True, True, False]
    away.rename(folder)
    (lab.home.path / "algorithms" / "gone").unlink()
    slamhive("gc", "--yes")
    assert there([needed, used, neither]) == [True, True, False]
    assert [(assets / checksum).exists() for checksum in checksums.values()] == [True, True, False]
    slamhive("gc", "--all", "--yes")
    assert there([needed, used]) == [False, False]


def test_the_ros_2_player_stays_while_the_catalog_has_a_node(lab: Any, slamhive: Callable[..., Any]) -> None:
    entry = load_workshop(lab.home).algorithm("kiss-icp-ros2")
    try:
        folders = Environments(lab.home.path / "environments").folders_of(entry)
    except Unavailable as error:
        pytest.skip(str(error))
    both = [whole(folder) for folder in folders]
    assert len(both) == 2
    lab.run("a")
    said = slamhive("gc", "--yes")
    assert "an algorithm of the catalog needs it" in said.out
    assert there(both) == [True, True]
    slamhive("gc", "--all", "--yes")
    assert there(both) == [False, False]


def test_recordings_stay_while_a_dataset_or_a_record_needs_them(
    lab: Any, slamhive: Callable[..., Any]
) -> None:
    root = lab.home.path / "datasets"
    bundled = load_workshop(lab.home).dataset("synthetic-lidar").dataset
    current = cached(made_folder(bundled, root))
    earlier = cached(root / ("synthetic-lidar-" + "0" * 16))
    recorded, nobodys = cached(root / ("hall-" + "1" * 16)), cached(root / ("attic-" + "2" * 16))
    lab.run("a", dataset="hall")
    slamhive("gc", "--yes")
    assert there([current, recorded, earlier, nobodys]) == [True, True, False, False]


def test_leftovers_of_killed_work_go(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("a")
    path = lab.home.path
    old = [
        path / ".archive.sqlite.ab12.making",
        path / "cache" / ".dashboard-x.npz",
        path / "assets" / ".fetching-x",
        path / "findings" / ".aa.json.bb",
    ]
    for file in old:
        file.parent.mkdir(exist_ok=True)
        file.touch()
        os.utime(file, (LONG_AGO, LONG_AGO))
    fresh = path / "assets" / ".fetching-y"
    fresh.touch()
    folders = [path / "variants" / ".ff.making", path / "datasets" / ".hall.making", path / "check"]
    folders.append(path / "algorithms" / ".mine.removing")
    for folder in folders:
        (folder / "in").mkdir(parents=True)
    busy = path / "truths" / ".aa.making"
    busy.mkdir(parents=True)
    with lock(path / "truths" / ".aa.lock"):
        assert slamhive("gc", "--yes").code == 0
    assert not any(there([*old, *folders]))
    assert there([fresh, busy]) == [True, True]


def test_what_was_found_in_recordings_stays_until_all_goes(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("a")
    kept = lab.home.folder("findings") / "aa.json"
    kept.touch()
    slamhive("gc", "--yes")
    assert kept.exists()
    slamhive("gc", "--all", "--yes")
    assert not kept.exists()


def test_home_says_what_takes_its_room(lab: Any, slamhive: Callable[..., Any], variants: list[Path]) -> None:
    lab.run("b@12345678", size=3 << 20)
    lab.run("c", size=2 << 20)
    said = slamhive("home", "--size")
    assert said.code == 0
    kinds = [said.out.index(kind) for kind in ("runs set aside", "files of runs 2", "variants: prepared")]
    assert kinds == sorted(kinds)
    assert "slamhive results prune --superseded" in said.out
    assert '"removedBy": "slamhive gc --all"' in slamhive("home", "--size", "--json").out
    assert str(lab.home.path) in slamhive("home").out


@pytest.mark.parametrize("words", [("home", "--size"), ("gc", "--yes"), ("sweep", "list")])
def test_a_home_of_a_newer_version_is_refused(
    lab: Any, slamhive: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    lab.run("a")
    monkeypatch.setattr("slamhive.archive.schema.VERSION", 2)
    said = slamhive(*words)
    assert (said.code, "written by a newer slamhive" in said.err) == (2, True)


def test_kept_archives_go_with_all_and_parts_of_them_at_once(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.run("a")
    downloads = lab.home.path / "downloads"
    (downloads / "mcd").mkdir(parents=True)
    kept, part = downloads / f"{'a' * 16}-hall.zip", downloads / f".fetching-{'b' * 24}.part"
    state, own, sums = part.with_suffix(".state"), downloads / "mcd" / "a.bag", downloads / "known-sums.json"
    for path in (kept, part, state, own, sums):
        path.write_bytes(b"x" * 5000)
        os.utime(path, (LONG_AGO, LONG_AGO))
    with lock(part.with_suffix(".lock")):
        slamhive("gc", "--yes")
        assert there([kept, part, state, own, sums]) == [True] * 5
    slamhive("gc", "--yes")
    assert there([kept, part, state, own, sums]) == [True, False, False, True, True]
    said = slamhive("gc", "--all", "--yes")
    assert "dataset add takes other sequences from it" in said.out
    assert there([kept, own, sums]) == [False, True, True]
