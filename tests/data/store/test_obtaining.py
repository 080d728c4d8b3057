# SPDX-License-Identifier: Apache-2.0
"""Sequences of a catalogue over a real https server: fetched, unpacked, imported; hostile archives."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import shutil
import stat
import subprocess
import tarfile
import zipfile
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from slamhive.data.files import unpacking
from slamhive.data.files.unpacking import unpack
from slamhive.data.importers import import_recording
from slamhive.data.making.exporting import all_roles, export_dataset
from slamhive.data.store.datasets import dataset_sha256, materialise
from slamhive.data.store.groundtruth import ground_truth
from slamhive.data.store.obtaining import Listener, obtain
from slamhive.model.catalogue import FOLDERS, dataset_name, find_sequence, load_catalogue
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError, ManifestError, SystemFault, UnknownNameError
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import ROLES, SensorMode
from slamhive.plan.resolution import role_problems

HEAD = """
name: test
title: A test
homepage: https://localhost/
license: CC0-1.0
cite: Nobody
layout: Euroc
sensors: {left: Camera, right: Camera}
"""


def zipped(path: Path, members: dict[str, bytes], *, deflated: bool = True) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def tarred(path: Path, members: list[tarfile.TarInfo], contents: dict[str, bytes]) -> Path:
    with tarfile.open(path, "w:gz") as archive:
        for member in members:
            content = contents.get(member.name, b"")
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return path


def named(name: str, kind: bytes = tarfile.REGTYPE, linked: str = "") -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, linked
    return member


@pytest.fixture(scope="session")
def euroc(camera_entries: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A folder in EuRoC's layout with ground truth, and the truth of what it was made of."""
    entry, out = camera_entries[0.5], tmp_path_factory.mktemp("euroc") / "hall"
    truth = ground_truth(entry)
    roles = all_roles(entry, DataFormat.EUROC)
    export_dataset(entry, roles, InputOptions(), DataFormat.EUROC, out, truth=truth)
    return out, truth


@pytest.fixture
def catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Writes a family into a folder of the catalogue."""
    folder = tmp_path / "families"
    folder.mkdir()
    monkeypatch.setenv(FOLDERS, str(folder))

    def write(text: str, head: str = HEAD, name: str = "test") -> None:
        (folder / f"{name}.yaml").write_text(head + text)

    return write


@pytest.fixture
def halls(site: Any, catalogue: Any, euroc: tuple[Path, Any]) -> Any:
    """A server with an archive of two sequences in archives of their own, as EuRoC's are."""
    inner = {}
    for name, deflated in (("A", True), ("B", False)):
        path = zipped(site.folder / "inner.zip", {}, deflated=deflated)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED) as archive:
            for file in sorted(euroc[0].rglob("*")):
                if file.is_file() and file.name != "sensors.yaml":
                    relative = file.relative_to(euroc[0])
                    place = relative if relative.parts[0] == "mav0" else f"mav0/{relative}"
                    archive.write(file, str(place))
            archive.writestr("__MACOSX/mav0/._cam0", b"x")
        inner[f"hall/{name}/{name}.zip"] = path.read_bytes()
        path.unlink()
    inner["hall/C/C.zip"] = os.urandom(1 << 20)
    zipped(site.folder / "hall.zip", inner, deflated=False)
    catalogue(
        f"""
parts:
  hall: {{url: "{site.url}/hall.zip", members: ["hall/{{sequence}}/{{sequence}}.zip!mav0"]}}
attributes: {{indoor: true}}
sequences: {{A: {{attributes: {{loops: 1}}}}, B: , C: }}
"""
    )
    return site


def test_one_sequence_of_an_archive_of_many_comes_without_the_others(
    halls: Any, tmp_path: Path, euroc: tuple[Path, Any]
) -> None:
    for name in "AB":
        before = halls.sent
        out = tmp_path / "datasets" / name
        dataset = obtain(find_sequence(f"test/{name}"), out, f"test-{name.lower()}", tmp_path / "downloads")
        assert set(dataset.spec.sensors) == {"left", "right"}
        assert dataset.spec.catalogue == f"test/{name}"
        assert (dataset.spec.license, dataset.spec.attributes["indoor"]) == ("CC0-1.0", True)
        assert halls.sent - before < (halls.folder / "hall.zip").stat().st_size / 2
        np.testing.assert_allclose(
            np.loadtxt(out / "groundtruth.txt"), np.loadtxt(euroc[0] / "groundtruth.txt"), atol=1e-9
        )
    kept = [path for path in (tmp_path / "downloads").iterdir() if path.suffix != ".lock"]
    assert kept == []


@pytest.mark.parametrize(("layout", "form"), [("TumRgbd", DataFormat.TUM), ("Kitti", DataFormat.KITTI)])
def test_what_is_fetched_is_what_its_folder_would_give(  # noqa: PLR0917
    site: Any, catalogue: Any, tmp_path: Path, camera_entries: Any, layout: str, form: DataFormat
) -> None:
    entry, made = camera_entries[0.5], tmp_path / "made" / "s"
    export_dataset(entry, all_roles(entry, form), InputOptions(), form, made, truth=ground_truth(entry))
    with tarfile.open(site.folder / "s.tgz", "w:gz") as archive:
        archive.add(made, "s")
    catalogue(
        f'folder: s\nparts: {{archive: {{url: "{site.url}/s.tgz", members: [s]}}}}\nsequences: {{s: }}\n',
        HEAD.replace("Euroc", layout),
    )
    obtain(find_sequence("test/s"), tmp_path / "fetched", "s", tmp_path / "downloads")
    import_recording(made, tmp_path / "imported", "s", layout)
    for name in ("recording.bag", "groundtruth.txt"):
        assert (tmp_path / "fetched" / name).read_bytes() == (tmp_path / "imported" / name).read_bytes()


def test_a_server_without_parts_sends_the_whole_archive_once(halls: Any, tmp_path: Path) -> None:
    halls.by_ranges = False
    downloads = tmp_path / "downloads"
    said: list[str] = []
    listener = Listener(notify=said.append)
    obtain(find_sequence("test/A"), tmp_path / "a", "a", downloads, listener=listener)
    assert any("stays, as other sequences come from it" in sentence for sentence in said)
    sent = halls.sent
    assert sent >= (halls.folder / "hall.zip").stat().st_size
    obtain(find_sequence("test/B"), tmp_path / "b", "b", downloads)
    assert halls.sent == sent
    assert "hall.zip" in (downloads / "known-sums.json").read_text()


def test_what_was_cut_leaves_no_checksum_behind(halls: Any, tmp_path: Path) -> None:
    halls.by_ranges = halls.measured = False
    halls.drops = [None, 100_000]  # the first answer is the look whether it sends parts
    said: list[str] = []
    listener = Listener(notify=said.append)
    obtain(find_sequence("test/A"), tmp_path / "a", "a", tmp_path / "d", listener=listener)
    assert any("no end was told: it may have been cut" in sentence for sentence in said)
    assert any("fetched again" in sentence for sentence in said)
    sums = json.loads((tmp_path / "d" / "known-sums.json").read_text())
    whole = hashlib.sha256((halls.folder / "hall.zip").read_bytes()).hexdigest()
    assert [entry["sha256"] for entry in sums.values()] == [whole]


def test_a_bag_that_was_cut_is_fetched_again(
    site: Any, catalogue: Any, tmp_path: Path, bag_with_truth: Any
) -> None:
    bag_with_truth(tmp_path)
    (tmp_path / "walk.bag").rename(site.folder / "walk.bag")
    site.measured, site.drops = False, [20_000]
    head = HEAD.replace("Euroc", "Bag").replace("left: Camera, right: Camera", "lidar: Lidar")
    parts = f'parts: {{bag: {{url: "{site.url}/walk.bag"}}}}'
    recording = "{recording: {files: [{path: walk.bag}]}, sensors: {lidar: {type: Lidar, topic: /points}}}"
    catalogue(f"{parts}\ndataset: {recording}\nsequences: {{walk: }}\n", head)
    said: list[str] = []
    listener = Listener(notify=said.append)
    obtain(find_sequence("test/walk"), tmp_path / "out", "walk", tmp_path / "d", listener=listener)
    assert (tmp_path / "out" / "walk.bag").read_bytes() == (site.folder / "walk.bag").read_bytes()
    assert any("fetched again" in sentence for sentence in said)


def test_a_broken_member_is_fetched_again_once(halls: Any, tmp_path: Path) -> None:
    with zipfile.ZipFile(halls.folder / "hall.zip") as archive:
        halls.wrong = {"/hall.zip": archive.getinfo("hall/A/A.zip").header_offset + 5000}
    said: list[str] = []
    obtain(
        find_sequence("test/A"), tmp_path / "a", "a", tmp_path / "d", listener=Listener(notify=said.append)
    )
    assert any("is damaged" in sentence and "fetched again" in sentence for sentence in said)
    with pytest.raises(DataError, match=r"hall/C/C.zip: is damaged, or no archive"):
        obtain(find_sequence("test/C"), tmp_path / "c", "c", tmp_path / "d")
    assert not (tmp_path / "c").exists()


def test_two_datasets_of_one_sequence_at_once_fetch_it_once(
    site: Any, catalogue: Any, euroc: tuple[Path, Any], tmp_path: Path
) -> None:
    members = {
        str(path.relative_to(euroc[0])): path.read_bytes()
        for path in euroc[0].rglob("*")
        if path.is_file() and path.name != "sensors.yaml"
    }
    zipped(site.folder / "A.zip", members)
    parts = f'{{a: {{url: "{site.url}/{{sequence}}.zip", members: [mav0]}}}}'
    catalogue(f"parts: {parts}\nsequences: {{A: }}\n")
    sequence, downloads = find_sequence("test/A"), tmp_path / "downloads"

    def step(text: str) -> None:
        if text.startswith("unpacking"):  # the other one begins and ends meanwhile
            obtain(sequence, tmp_path / "other", "other", downloads)
            assert [path.name for path in downloads.glob("*A.zip")]

    obtain(sequence, tmp_path / "one", "one", downloads, listener=Listener(step=step))
    assert [path for path, _ in site.asked] == ["/A.zip"]
    assert list(downloads.glob("*A.zip")) == []
    assert (tmp_path / "one" / "recording.bag").stat().st_size > 0


def test_a_file_that_changed_since_its_first_fetch_is_refused(
    site: Any, catalogue: Any, tmp_path: Path, euroc: tuple[Path, Any]
) -> None:
    def publish(extra: bytes) -> None:
        with tarfile.open(site.folder / "s.tar", "w") as archive:
            archive.add(euroc[0], "s")
            archive.addfile(named(f"s/{extra.decode()}"))

    publish(b"one")
    catalogue(
        f'folder: s\nparts: {{archive: {{url: "{site.url}/s.tar", members: [s]}}}}\nsequences: {{s: }}\n'
    )
    obtain(find_sequence("test/s"), tmp_path / "a", "a", tmp_path / "d")
    publish(b"two")
    with pytest.raises(
        DataError, match=r"has sha256 \w+, expected \w+, which it had when it was fetched first"
    ):
        obtain(find_sequence("test/s"), tmp_path / "b", "b", tmp_path / "d")


def test_what_is_fetched_by_hand_says_where_from_and_whereto(
    site: Any, catalogue: Any, tmp_path: Path, bag_with_truth: Any
) -> None:
    bag_with_truth(tmp_path)
    head = HEAD.replace("Euroc", "Bag").replace("left: Camera, right: Camera", "lidar: Lidar")
    catalogue(
        """
parts:
  bag: {manual: "https://localhost/login", file: walk.bag}
dataset:
  recording: {files: [{path: walk.bag}]}
  sensors: {lidar: {type: Lidar, topic: /points}}
  groundTruth: {topic: /truth}
sequences: {walk: }
""",
        head,
    )
    walk, downloads = find_sequence("test/walk"), tmp_path / "downloads"
    with pytest.raises(
        InputError, match=r"log in or accept the licence at https://localhost/login, put the file"
    ):
        obtain(walk, tmp_path / "out", "walk", downloads)
    (tmp_path / "walk.bag").rename(downloads / "test" / "walk.bag")
    dataset = obtain(walk, tmp_path / "out", "walk", downloads)
    assert [file.path for file in dataset.spec.recording.files] == ["walk.bag"]
    assert (tmp_path / "out" / "walk.bag").is_file()
    assert (downloads / "test" / "walk.bag").is_file(), "it is the user's"


def test_an_archive_that_someone_put_there_is_taken_and_stays(
    site: Any, catalogue: Any, tmp_path: Path, euroc: tuple[Path, Any]
) -> None:
    catalogue(
        f'folder: s\nparts: {{archive: {{url: "{site.url}/s.tar", members: [s]}}}}\nsequences: {{s: }}\n'
    )
    place = tmp_path / "downloads" / "test" / "s.tar"
    place.parent.mkdir(parents=True)
    with tarfile.open(place, "w") as archive:
        archive.add(euroc[0], "s")
    obtain(find_sequence("test/s"), tmp_path / "out", "s", tmp_path / "downloads")
    assert (tmp_path / "out" / "recording.bag").is_file()
    assert site.asked == []
    assert place.is_file(), "it is the user's"


def test_without_a_network_it_is_said_at_once_and_what_helps(
    catalogue: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []
    monkeypatch.setattr("slamhive.data.files.fetching.time.sleep", waits.append)
    # No server has a name that ends so (RFC 6761).
    catalogue(
        'folder: s\nparts: {archive: {url: "https://data.invalid/s.tar", members: [s]}}\nsequences: {s: }\n'
    )
    with pytest.raises(SystemFault, match=r"no server data\.invalid is known here, or no network") as error:
        obtain(find_sequence("test/s"), tmp_path / "out", "s", tmp_path / "downloads")
    assert f"put s.tar into {tmp_path / 'downloads' / 'test'} and give the same command again" in str(
        error.value
    )
    assert waits == []


@pytest.mark.parametrize("is_elsewhere", [False, True])
@pytest.mark.parametrize("is_folder", [False, True])
def test_links_to_files_of_another_disk_are_taken(  # noqa: PLR0917
    site: Any,
    catalogue: Any,
    tmp_path: Path,
    bag_with_truth: Any,
    monkeypatch: pytest.MonkeyPatch,
    is_elsewhere: bool,
    is_folder: bool,
) -> None:
    (disk := tmp_path / "disk" / "bags").mkdir(parents=True)
    bag_with_truth(disk)
    place = "bags/walk.bag" if is_folder else "walk.bag"
    catalogue(
        f"""
parts:
  bag: {{manual: "https://localhost/login", file: {place.split("/", maxsplit=1)[0]}}}
dataset:
  recording: {{files: [{{path: {place}}}]}}
  sensors: {{lidar: {{type: Lidar, topic: /points}}}}
sequences: {{walk: }}
""",
        HEAD.replace("Euroc", "Bag").replace("left: Camera, right: Camera", "lidar: Lidar"),
    )
    downloads, out = tmp_path / "downloads", tmp_path / "some" / "where" / "out"
    (downloads / "test").mkdir(parents=True)
    linked = "../../disk/bags" if is_folder else "../../disk/bags/walk.bag"
    (downloads / "test" / linked.rpartition("/")[2]).symlink_to(linked)
    if is_elsewhere:

        def refuse(*_: object) -> None:
            raise OSError(errno.EXDEV, "Invalid cross-device link")

        monkeypatch.setattr(Path, "hardlink_to", refuse)
    beside = sorted((downloads / "test").iterdir())
    obtain(find_sequence("test/walk"), out, "walk", downloads)
    assert sorted((downloads / "test").iterdir()) == beside  # it may be of others, who let nobody write
    assert (out / place).read_bytes() == (disk / "walk.bag").read_bytes()
    assert (out / place).is_symlink() == is_elsewhere


def test_a_manifest_that_names_a_sequence_is_a_dataset(
    halls: Any, tmp_path: Path, euroc: tuple[Path, Any]
) -> None:
    dataset = Dataset.model_validate(
        {"metadata": {"name": "mine"}, "spec": {"catalogue": "test/A", "attributes": {"loops": 3}}}
    )
    algorithm_mode = type("Mode", (), {"name": "stereo", "needs": ROLES[SensorMode.STEREO]})
    assert list(role_problems(algorithm_mode, dataset, {})) == []  # type: ignore[arg-type]
    rgbd = type("Mode", (), {"name": "rgbd", "needs": ROLES[SensorMode.RGBD]})
    assert "has: left, right" in next(role_problems(rgbd, dataset, {}))  # type: ignore[arg-type]
    entry = materialise(dataset, tmp_path, tmp_path / "home" / "datasets")
    assert entry.dataset.spec.attributes == {"indoor": True, "loops": 3}
    assert set(entry.dataset.spec.sensors) == {"left", "right"}
    truth = ground_truth(entry)
    assert truth is not None
    np.testing.assert_allclose(
        truth.poses.positions,
        euroc[1].poses.positions,
        atol=1e-6,  # type: ignore[union-attr]
    )
    assert len(dataset_sha256(entry)) == 64
    sent = halls.sent
    assert materialise(dataset, tmp_path, tmp_path / "home" / "datasets").root == entry.root
    assert halls.sent == sent


def test_a_preparation_of_a_cluster_fetches_it_once_to_the_data_volume(
    halls: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from slamhive.jobs.prepare import main

    monkeypatch.setenv("SLAMHIVE_TERMINATION_LOG", str(tmp_path / "message"))

    request = {
        "dataset": {
            "apiVersion": "slamhive.io/v1alpha1",
            "kind": "Dataset",
            "metadata": {"name": "mine"},
            "spec": {"catalogue": "test/A"},
        },
        "roles": ["left", "right"],
        "input": {},
        "formats": ["Rosbag1"],
        "assets": [],
    }
    for folder in ("request", "data"):
        (tmp_path / "pod" / folder).mkdir(parents=True)
    (tmp_path / "pod" / "request" / "request.json").write_text(json.dumps(request))
    assert main(["--root", str(tmp_path / "pod")]) == 0
    sent = halls.sent
    assert len(list((tmp_path / "pod" / "data" / "variants").glob("[0-9a-f]*"))) == 1
    assert (tmp_path / "pod" / "data" / "groundtruth" / "mine.txt").is_file()
    assert main(["--root", str(tmp_path / "pod")]) == 0
    assert halls.sent == sent


def test_a_sequence_is_searched_and_added_by_its_name(
    halls: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Any
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    code, printed, _ = run_command("dataset", "search", "test", "LOOPS: 1", "--sensors", "stereo", "--json")
    (found,) = json.loads(printed)
    assert (code, found["sequence"], found["license"]) == (0, "test/A", "CC0-1.0")
    assert "test/" not in run_command("dataset", "search", "--sensors", "lidar")[1]
    code, printed, said = run_command("dataset", "add", "test/A")
    assert (code, "known now as test-a:" in printed) == (0, True)
    assert "licence: CC0-1.0" in said
    assert "cite: Nobody" in said
    sent = halls.sent
    assert run_command("dataset", "add", "test/A")[0] == 0
    assert halls.sent == sent
    (row,) = (
        line for line in run_command("dataset", "list", "--available")[1].splitlines() if "test/A" in line
    )
    assert row.split()[:2] == ["test/A", "test-a"]
    code, _, said = run_command("dataset", "add", "test/B", "--name", "test-a")
    assert (code, "is known already and is another one" in said) == (2, True)
    code, _, said = run_command("dataset", "add", "tets/B")
    assert (code, "no such file or folder" in said, "did you mean 'test'" in said) == (2, True, True)


def test_an_unknown_sequence_says_what_is_near() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'MH_01_easy'"):
        find_sequence("euroc/MH_01_eas")
    with pytest.raises(UnknownNameError, match="did you mean 'euroc'"):
        find_sequence("eurok/MH_01_easy")


def test_all_that_comes_with_slamhive_follows_the_model() -> None:
    names = set()
    for family in load_catalogue().values():
        for name in family.rows:
            sequence = family.sequence_of(name)
            names.add(dataset_name(family.name, name))
            spec = {"catalogue": sequence.title, "attributes": sequence.attributes, **sequence.dataset}
            Dataset.model_validate({"metadata": {"name": dataset_name(family.name, name)}, "spec": spec})
    assert len(names) == sum(len(family.rows) for family in load_catalogue().values()) > 500


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("parts: {a: {url: 'https://x/a.zip'}}\nsequences: {a: , a: }", "'a' is there twice"),
        (
            "parts: {a: {url: 'https://x/a.zip'}}\nsequences: {a_b: , a-b: }",
            "a_b and a-b make datasets of one",
        ),
        ("parts: {a: {url: 'http://x/a.zip'}}\nsequences: {a: }", "begins with https://|match pattern"),
        ("parts: {a: {}}\nsequences: {a: }", "give either url or manual"),
    ],
)
def test_mistakes_of_a_family_name_the_file(catalogue: Any, text: str, message: str) -> None:
    catalogue(text)
    with pytest.raises(ManifestError, match=rf"test.yaml: .*({message})"):
        load_catalogue()


def test_two_families_of_one_name_are_refused(catalogue: Any) -> None:
    catalogue("parts: {a: {url: 'https://x/a.zip'}}\nsequences: {a: }", HEAD.replace("test", "euroc"))
    with pytest.raises(ManifestError, match=r"test.yaml: a family 'euroc' is in .*euroc.yaml, too"):
        load_catalogue()


HOSTILE = {
    "absolute": (named("/etc/x"), "leads outside of its folder"),
    "above": (named("s/../../x"), "leads outside of its folder"),
    "symbolic link": (named("s/x", tarfile.SYMTYPE, "../../etc/passwd"), "link 's/x' leads outside"),
    "absolute link": (named("s/x", tarfile.SYMTYPE, "/etc/passwd"), "link 's/x' leads outside"),
    "hard link": (named("s/x", tarfile.LNKTYPE, "../x"), "link 's/x' leads outside"),
    "dangling link": (named("s/x", tarfile.SYMTYPE, "y"), "which isn't in it"),
    "link to itself": (named("s/x", tarfile.SYMTYPE, "x"), "in which it is itself"),
    "link to its folder": (named("s/d/x", tarfile.SYMTYPE, ".."), "in which it is itself"),
    "device": (named("s/x", tarfile.CHRTYPE), "is a device: refused"),
    "pipe": (named("s/x", tarfile.FIFOTYPE), "is a device: refused"),
    "file as folder": (named("s/ok/x"), "member 's/ok/x' can't be put there: File exists"),
    "folder as file": (named("s/ok", tarfile.DIRTYPE), "member 's/ok' can't be put there: File exists"),
    "long name": (named("s/" + "x" * 256), "can't be put there: File name too long"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_what_leads_out_of_the_folder_is_refused(tmp_path: Path, kind: str) -> None:
    member, message = HOSTILE[kind]
    archive = tarred(tmp_path / "a.tgz", [named("s/ok"), member], {"s/ok": b"ok"})
    out = tmp_path / "in" / "out"
    with pytest.raises(DataError, match=message):
        unpack(archive, [""], out)
    assert [path.name for path in (tmp_path / "in").iterdir()] == ["out"]


def test_a_zip_that_leads_out_is_refused_too(tmp_path: Path) -> None:
    for name in ("../x", "/x", "..\\x"):
        with pytest.raises(DataError, match="leads outside of its folder"):
            unpack(zipped(tmp_path / "a.zip", {name: b"x"}), [""], tmp_path / "out")
    link = zipfile.ZipInfo("s/x")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(DataError, match="leads outside of its folder"):
        unpack(tmp_path / "b.zip", [""], tmp_path / "out")


def test_links_inside_become_copies(tmp_path: Path) -> None:
    members = [named("s/a"), named("s/d/b", tarfile.SYMTYPE, "../a"), named("s/c", tarfile.LNKTYPE, "s/a")]
    unpack(tarred(tmp_path / "a.tgz", members, {"s/a": b"content"}), ["s"], tmp_path / "out")
    for name in ("s/d/b", "s/c"):
        assert (tmp_path / "out" / name).read_bytes() == b"content"
        assert not (tmp_path / "out" / name).is_symlink()


def test_links_to_folders_and_to_links_become_copies_too(tmp_path: Path) -> None:
    members = [
        named("s/latest", tarfile.SYMTYPE, "first"),
        named("s/again", tarfile.SYMTYPE, "latest/a"),
        named("s/first/same", tarfile.SYMTYPE, "a"),
        named("s/first/a"),
    ]
    unpack(tarred(tmp_path / "a.tgz", members, {"s/first/a": b"content"}), ["s"], tmp_path / "out")
    for name in ("latest/a", "latest/same", "again", "first/same"):
        assert (tmp_path / "out" / "s" / name).read_bytes() == b"content"
        assert not (tmp_path / "out" / "s" / name).is_symlink()


def test_links_that_lead_in_a_circle_are_refused(tmp_path: Path) -> None:
    members = [named("s/a", tarfile.SYMTYPE, "b"), named("s/b", tarfile.SYMTYPE, "a")]
    with pytest.raises(DataError, match=r"a.tgz: the link 's/a' leads to 'b', which isn't in it: refused"):
        unpack(tarred(tmp_path / "a.tgz", members, {}), ["s"], tmp_path / "out")


def test_a_chain_of_links_becomes_copies_however_long_it_is(tmp_path: Path) -> None:
    chain = [named(str(k), tarfile.SYMTYPE, str(k + 1) if k < 1199 else "a") for k in range(1200)]
    unpack(tarred(tmp_path / "a.tgz", [*chain, named("a")], {"a": b"content"}), [""], tmp_path / "out")
    assert {path.read_bytes() for path in (tmp_path / "out").iterdir()} == {b"content"}


def test_a_link_goes_through_another_that_lies_beside_what_goes_through_it(tmp_path: Path) -> None:
    members = [
        named("d/x", tarfile.SYMTYPE, "y"),
        named("d", tarfile.SYMTYPE, "p"),
        named("p/y"),
        named("p/deep", tarfile.SYMTYPE, "../q"),
        named("q/z"),
        named("e", tarfile.SYMTYPE, "d/deep/z"),
    ]
    unpack(tarred(tmp_path / "a.tgz", members, {"p/y": b"y", "q/z": b"z"}), [""], tmp_path / "out")
    found = {name: (tmp_path / "out" / name).read_bytes() for name in ("d/x", "d/y", "d/deep/z", "e")}
    assert found == {"d/x": b"y", "d/y": b"y", "d/deep/z": b"z", "e": b"z"}


@pytest.mark.parametrize(("files", "size", "links"), [(1, 20_000, 2000), (150, 1, 2)])
def test_links_to_folders_count_as_what_they_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: int, size: int, links: int
) -> None:
    """A file counts as what it takes of a disk at least."""
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1 << 20)
    content = {f"s/d/{k}": os.urandom(size) for k in range(files)}
    members = [*map(named, content), *(named(f"s/{k}", tarfile.SYMTYPE, "d") for k in range(links))]
    archive = tarred(tmp_path / "a.tgz", members, content)
    with pytest.raises(DataError, match="times its size: refused"):
        unpack(archive, ["s"], tmp_path / "out")


def test_a_bomb_is_refused_before_it_fills_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1 << 20)
    bomb = zipped(tmp_path / "bomb.zip", {"s/zeros": bytes(32 << 20)})
    with pytest.raises(DataError, match=r"grows to more than \d+ MiB, 200 times its size: refused"):
        unpack(bomb, ["s"], tmp_path / "out")
    written = sum(path.stat().st_size for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert written <= 10 << 20


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
@pytest.mark.parametrize("wanted", ["s/a", "s/a!b"])
def test_members_whose_growth_cannot_be_bounded_are_refused(
    tmp_path: Path, packing: int, wanted: str
) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w", packing) as archive:
        archive.writestr("s/a", b"content")
    with pytest.raises(DataError, match=r"a.zip: the member 's/a' is a file packed in a rare way"):
        unpack(tmp_path / "a.zip", [wanted], tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


HEADERS = {
    "of much": (tarfile.PAX_FORMAT, named("a"), {"comment": "x" * 5000}, "its headers take more memory"),
    "of a long name": (tarfile.GNU_FORMAT, named("a" * 4200), {}, "its headers take more memory"),
    "deep": (tarfile.PAX_FORMAT, named("a/" * 80 + "a"), {}, "more than 4,096 characters or 64 folders"),
    "of no number": (tarfile.PAX_FORMAT, named("a"), {"GNU.sparse.map": "a,b"}, "is damaged, or no archive"),
}


@pytest.mark.parametrize("kind", HEADERS)
def test_headers_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setattr(unpacking, "_HEADER_BYTES", 4096)
    form, member, more, message = HEADERS[kind]
    with tarfile.open(tmp_path / "a.tgz", "w:gz", format=form, pax_headers=more) as archive:
        archive.addfile(member)
    with pytest.raises(DataError, match=message):
        unpack(tmp_path / "a.tgz", [""], tmp_path / "out")


@pytest.mark.parametrize("error", [RecursionError("too deep"), MemoryError(), ValueError("no number")])
def test_what_a_library_meets_in_an_archive_is_its_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    monkeypatch.setattr(tarfile.TarFile, "next", Mock(side_effect=error))
    archive = tarred(tmp_path / "a.tar", [named("a")], {})
    with pytest.raises(unpacking.DamagedArchiveError, match=f": {str(error) or 'MemoryError'}$"):
        unpack(archive, [""], tmp_path / "out")


def test_the_directory_of_a_zip_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "DIRECTORY_BYTES", 2000)
    with pytest.raises(DataError, match="its headers take more memory"):
        unpack(zipped(tmp_path / "a.zip", {f"s/{k}": b"" for k in range(100)}), ["s"], tmp_path / "out")


def test_what_nobody_wants_of_an_archive_is_bounded_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1 << 20)
    archive = tarred(tmp_path / "a.tgz", [named("zeros"), named("s/a")], {"zeros": bytes(16 << 20)})
    with pytest.raises(DataError, match=r"it grows to more than \d+ MiB, 200 times its size"):
        unpack(archive, ["s"], tmp_path / "out")


def test_what_is_missing_is_named_with_what_is_there(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"one/x": b"", "two/y": b""})
    with pytest.raises(DataError, match=r"a.zip: has no three; it has: one/x, two/y"):
        unpack(archive, ["one", "three"], tmp_path / "out")


def test_a_truncated_archive_is_damaged(tmp_path: Path) -> None:
    whole = tarred(tmp_path / "a.tgz", [named("s/a")], {"s/a": os.urandom(5000)})
    whole.write_bytes(whole.read_bytes()[:3000])
    with pytest.raises(DataError, match="is damaged"):
        unpack(whole, ["s"], tmp_path / "out")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"this is no archive" * 100, "is damaged, or no archive: none of zip, tar, tgz"),
        (b"PK\x03\x04" + bytes(5000), "is a zip archive whose end is missing"),
        (b"", "is damaged, or no archive"),
    ],
)
def test_what_is_no_archive_is_said_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.zip").write_bytes(content)
    with pytest.raises(DataError, match=f"^hall: {message}") as caught:
        unpack(tmp_path / "a.zip", [""], tmp_path / "out", title="hall")
    assert "\n" not in str(caught.value)


def test_a_7z_says_which_package_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.7z").write_bytes(b"7z\xbc\xaf\x27\x1c" + bytes(64))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SystemFault, match="apt-get install libarchive-tools"):
        unpack(tmp_path / "a.7z", ["s"], tmp_path / "out")


def test_a_7z_is_read_by_bsdtar(tmp_path: Path) -> None:
    if shutil.which("bsdtar") is None:
        pytest.skip("no bsdtar: apt-get install libarchive-tools")
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "a").write_bytes(b"content")
    subprocess.run(["bsdtar", "--format=7zip", "-cf", "a.7z", "s"], cwd=tmp_path, check=True)
    unpack(tmp_path / "a.7z", ["s"], tmp_path / "out")
    assert (tmp_path / "out" / "s" / "a").read_bytes() == b"content"
