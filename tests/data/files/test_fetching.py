# SPDX-License-Identifier: Apache-2.0
"""Recordings from the network, over a real https server, and checksums of those at hand."""

from __future__ import annotations

import errno
import hashlib
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

import pytest
from serving import ENDLESS

from slamhive.data.files import fetching, https
from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError, SystemFault

if TYPE_CHECKING:
    from pathlib import Path

CONTENT = b"a recording\n" * 1000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def server(site: Any) -> str:
    """The address of an https server that has a recording."""
    (site.folder / "hall.bag").write_bytes(CONTENT)
    return str(site.url)


def dataset(url: str | None, sha256: str | None = SHA256) -> Dataset:
    return Dataset.model_validate(
        {
            "metadata": {"name": "hall"},
            "spec": {
                "recording": {"files": [{"path": "bags/hall.bag", "url": url, "sha256": sha256}]},
                "sensors": {"lidar": {"type": "Lidar", "topic": "/points"}},
                "groundTruth": {"file": "truth.txt"},
            },
        }
    )


def test_a_missing_recording_is_fetched_once_and_lies_beside_its_ground_truth(
    server: str, tmp_path: Path
) -> None:
    root, home = tmp_path / "root", tmp_path / "home"
    root.mkdir()
    (root / "truth.txt").write_text("1 0 0 0 0 0 0 1\n")
    entry = materialise(dataset(f"{server}/hall.bag"), root, home)
    assert (entry.root / "bags/hall.bag").read_bytes() == CONTENT
    assert (entry.root / "truth.txt").read_text().startswith("1 0")
    before = (entry.root / "bags/hall.bag").stat().st_mtime_ns
    again = materialise(dataset(f"{server}/hall.bag"), root, home)
    assert (again.root / "bags/hall.bag").stat().st_mtime_ns == before


def test_another_file_than_the_one_named_is_refused_and_not_kept(server: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"sha256 .* expected 0000"):
        materialise(dataset(f"{server}/hall.bag", "0" * 64), tmp_path / "root", tmp_path / "home")
    assert not list((tmp_path / "home").glob("hall-*/bags/*"))


def test_a_server_that_has_it_not_is_worth_another_try(server: str, tmp_path: Path) -> None:
    with pytest.raises(SystemFault, match="404"):
        materialise(dataset(f"{server}/other.bag"), tmp_path / "root", tmp_path / "home")


def test_a_redirect_over_https_is_followed(server: str, tmp_path: Path) -> None:
    entry = materialise(dataset(f"{server}/to/{server}/hall.bag"), tmp_path / "root", tmp_path / "home")
    assert (entry.root / "bags/hall.bag").read_bytes() == CONTENT


@pytest.mark.parametrize("where", ["http://localhost:1/hall.bag", "ftp://localhost/hall.bag"])
def test_a_redirect_away_from_https_is_refused(server: str, tmp_path: Path, where: str) -> None:
    with pytest.raises(DataError, match=r"leads to .*, expected an https:// address"):
        materialise(dataset(f"{server}/to/{where}"), tmp_path / "root", tmp_path / "home")


@pytest.mark.parametrize("name", ["endless", "hall"])
@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        ({"MOST_BYTES": 5000}, (DataError, "the most that is fetched")),
        ({"LEFT_BYTES": 1 << 60}, (SystemFault, "MiB more, but the disk of .* has room for 0 MiB, as ")),
    ],
)
def test_a_file_without_end_is_not_kept(  # noqa: PLR0917
    server: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    limit: dict[str, int],
    expected: tuple[type[Exception], str],
) -> None:
    for constant, value in limit.items():
        monkeypatch.setattr(fetching, constant, value)
    with pytest.raises(expected[0], match=expected[1]):
        materialise(dataset(f"{server}/{name}.bag"), tmp_path / "root", tmp_path / "home")
    kept = [path for path in (tmp_path / "home").rglob("*") if path.is_file()]
    assert [path for path in kept if path.suffix != ".lock"] == []


def test_a_full_disk_is_no_reason_to_ask_a_mirror(
    site: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (site.folder / "a.bin").write_bytes(CONTENT)
    wanted = fetching.WantedFile([f"{site.url}/a.bin", f"{site.url}/a.bin?again"], "hall: a.bin")

    def write(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(fetching.Partial, "write", write)
    with pytest.raises(SystemFault, match=r"^hall: a.bin: the disk of .* is full; what was fetched stays"):
        fetching.fetch_file(wanted, tmp_path / "a.bin")
    assert [path for path, _ in site.asked] == ["/a.bin"]


@pytest.mark.parametrize("path", ENDLESS)
def test_a_server_that_hardly_sends_is_given_up(
    server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    """In whatever part of its answers it goes on for ever."""
    seconds = itertools.count(0, 20)
    monkeypatch.setattr(https.time, "monotonic", lambda: next(seconds))
    monkeypatch.setattr(https, "STALL_BYTES", 1 << 30)
    monkeypatch.setattr(fetching, "PAUSES", ())
    with pytest.raises(SystemFault, match="MiB came in 60 s"):
        materialise(dataset(f"{server}{path}"), tmp_path / "root", tmp_path / "home")


@pytest.mark.parametrize(("name", "is_said"), [("hall.bag", True), ("hall.tgz", False)])
def test_a_file_that_comes_packed_is_told(site: Any, tmp_path: Path, name: str, is_said: bool) -> None:
    site.odd = 200, {"Content-Encoding": "gzip", "Content-Length": "0"}
    said: list[str] = []
    asked = fetching.WantedFile([f"{site.url}/{name}"], "hall")
    fetching.fetch_file(asked, tmp_path / name, fetching.FetchProgress(notify=said.append))
    assert any("comes packed (gzip)" in words for words in said) == is_said


def test_a_recording_at_hand_must_be_what_its_checksum_says(tmp_path: Path) -> None:
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags/hall.bag").write_bytes(CONTENT)
    assert materialise(dataset(None), tmp_path, tmp_path / "home").root == tmp_path
    (tmp_path / "bags/hall.bag").write_bytes(CONTENT + b"!")
    with pytest.raises(DataError, match="expected"):
        materialise(dataset(None), tmp_path, tmp_path / "home")


LARGE = bytes(range(256)) * (16 << 10)  # 4 MiB


@pytest.fixture
def large(site: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A server with a file of several blocks."""
    monkeypatch.setattr(fetching, "BLOCK", 1 << 18)
    (site.folder / "large.bag").write_bytes(LARGE)
    return site


def wanted(site: Any, **fields: Any) -> fetching.WantedFile:
    return fetching.WantedFile(**{"urls": [f"{site.url}/large.bag"], "what": "large", **fields})


def test_a_connection_that_drops_is_gone_on_with(large: Any, tmp_path: Path) -> None:
    large.drops = [1 << 20, 1 << 20]
    found = fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    assert found == hashlib.sha256(LARGE).hexdigest()
    assert [asked for _, asked in large.asked] == [None, "bytes=1048576-", "bytes=2097152-"]
    assert large.sent == len(LARGE)


def test_a_fetch_that_failed_goes_on_where_it_was(
    large: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetching, "PAUSES", ())
    large.drops = [1 << 20]
    with pytest.raises(SystemFault, match=r"large: .*ended after 1,048,576 of 4,194,304 bytes"):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert not (tmp_path / "large.bag").exists()
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    assert large.sent == len(LARGE)
    assert not [path for path in tmp_path.glob(".fetching-*") if path.suffix != ".lock"]


def test_after_a_loss_of_power_only_what_was_flushed_counts(
    large: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetching, "PAUSES", ())
    large.drops = [1 << 20]
    with pytest.raises(SystemFault):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    state = next(tmp_path.glob(".fetching-*.state"))
    state.write_text(json.dumps(json.loads(state.read_text()) | {"boot": "another"}))
    part = state.with_suffix(".part")
    part.write_bytes(bytes(part.stat().st_size))
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE


@pytest.mark.parametrize("changed", [True, False])
def test_a_server_without_parts_or_with_another_file_begins_afresh(
    large: Any, tmp_path: Path, changed: bool
) -> None:
    large.by_ranges = changed
    large.drops = [1 << 20]
    path, content = large.folder / "large.bag", LARGE
    said: list[str] = []

    def notify(sentence: str) -> None:
        said.append(sentence)

    class Changing(list[Any]):
        def pop(self, at: Any = -1) -> Any:
            if changed:
                path.write_bytes(content[::-1])
            return super().pop(at)

    large.drops = Changing(large.drops)
    fetching.fetch_file(wanted(large), tmp_path / "large.bag", fetching.FetchProgress(notify=notify))
    assert (tmp_path / "large.bag").read_bytes() == path.read_bytes()
    assert "comes from its start again" in said[0]


def test_where_parts_never_come_right_all_of_it_is_asked_for(
    large: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetching, "PAUSES", (0.0, 0.0))
    large.drops, large.beside = [1 << 20], 7
    said: list[str] = []
    fetching.fetch_file(wanted(large), tmp_path / "large.bag", fetching.FetchProgress(notify=said.append))
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    assert [asked for _, asked in large.asked] == [None, *["bytes=1048576-"] * 2, None]
    assert "was asked for the bytes from 1,048,576 on, and sent others (bytes 1048583-" in said[0]
    large.drops = [1 << 20] * 9
    with pytest.raises(SystemFault, match="and sent others"):  # and it ends where it ends early each time
        fetching.fetch_file(wanted(large), tmp_path / "again.bag")


class Replacing(list[Any]):
    """Drops of a server, with whose first one a file is replaced by another."""

    def __init__(self, path: Path, drops: list[int | None], content: bytes = LARGE[::-1]) -> None:
        super().__init__(drops)
        self._path, self._content = path, content

    def pop(self, at: Any = -1) -> Any:
        drop = super().pop(at)
        self._path.write_bytes(self._content)
        return drop


@pytest.mark.parametrize(
    ("known_by", "heeds"), [("weak", True), ("tag", False), ("time", False), ("folded", True)]
)
def test_halves_of_two_files_are_never_joined(large: Any, tmp_path: Path, known_by: str, heeds: bool) -> None:
    large.known_by, large.heeds = known_by, heeds
    large.drops = Replacing(large.folder / "large.bag", [1 << 20])
    said: list[str] = []
    progress = fetching.FetchProgress(notify=said.append)
    fetching.fetch_file(wanted(large), tmp_path / "large.bag", progress)
    assert (tmp_path / "large.bag").read_bytes() == LARGE[::-1]
    assert "is another file now" in said[0]


def test_an_answer_without_marks_makes_none_forgotten(large: Any, tmp_path: Path) -> None:
    class Changing(list[Any]):
        def pop(self, at: Any = -1) -> Any:
            large.heeds, large.known_by = False, "nothing" if len(self) == 2 else "tag"
            if len(self) == 1:
                (large.folder / "large.bag").write_bytes(LARGE[::-1])
            return super().pop(at)

    large.drops = Changing([1 << 20, 1 << 20])  # the first one has a mark, the second none, the third another
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE[::-1]


@pytest.mark.parametrize("known_by", ["nothing", "weak"])
def test_a_file_without_marks_is_begun_anew_by_the_next_process(
    large: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known_by: str
) -> None:
    large.known_by, large.drops = known_by, [1 << 20, 1 << 19, 1 << 19]
    monkeypatch.setattr(fetching, "PAUSES", (0.0,))
    with pytest.raises(SystemFault):  # though all answers went on with the first one
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    if known_by == "nothing":
        (large.folder / "large.bag").write_bytes(LARGE[::-1])
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == (large.folder / "large.bag").read_bytes()
    assert (large.asked[-1][1] is None) == (known_by == "nothing")


@pytest.mark.parametrize("changes", [False, True])
def test_answers_that_bring_next_to_nothing_are_given_up(
    large: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: bool
) -> None:
    monkeypatch.setattr(fetching, "PAUSES", (0.0,) * 3)
    path = large.folder / "large.bag"

    class Dripping(list[Any]):
        def __bool__(self) -> bool:
            return True

        def pop(self, _at: Any = -1) -> Any:
            if changes:
                path.write_bytes(bytes([path.read_bytes()[0] ^ 1]) + LARGE[1:])
            return 1000

    large.drops = Dripping()
    with pytest.raises(SystemFault, match=r"large: https://.*(of 4,194,304 bytes|changed on the server)"):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert len(large.asked) <= 5


def test_what_takes_for_ever_is_given_up(large: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetching, "PATIENCE_SECONDS", -600.0)
    large.drops = [1 << 20]
    with pytest.raises(SystemFault, match="given up after 0 min; what came stays"):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert large.sent == len(LARGE)


def test_an_answer_without_an_end_may_have_been_cut(large: Any, tmp_path: Path) -> None:
    large.measured = False
    said: list[str] = []
    fetching.fetch_file(wanted(large), tmp_path / "large.bag", fetching.FetchProgress(notify=said.append))
    assert said == [f"large: {large.url}/large.bag: no end was told: it may have been cut"]


def test_a_known_size_is_an_end(large: Any, tmp_path: Path) -> None:
    large.measured, large.drops, said = False, [1 << 20], list[str]()
    progress = fetching.FetchProgress(notify=said.append)
    fetching.fetch_file(wanted(large, size=len(LARGE)), tmp_path / "large.bag", progress)
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    assert (large.sent, said) == (len(LARGE), [])
    with pytest.raises(DataError, match="has 4,194,304 bytes, expected 4,000,000"):
        fetching.fetch_file(wanted(large, size=4_000_000), tmp_path / "other.bag")


def test_a_size_that_was_told_before_nothing_came_is_forgotten(large: Any, tmp_path: Path) -> None:
    class Changing(list[Any]):
        def pop(self, at: Any = -1) -> Any:
            (large.folder / "large.bag").write_bytes(LARGE + LARGE)
            large.known_by, large.measured = "nothing", False
            return super().pop(at)

    large.known_by, large.drops = "nothing", Changing([0])
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE + LARGE


def test_of_a_file_that_became_empty_nothing_is_kept(large: Any, tmp_path: Path) -> None:
    large.drops = Replacing(large.folder / "large.bag", [1 << 20], b"")
    assert fetching.fetch_file(wanted(large), tmp_path / "a.bag") == hashlib.sha256(b"").hexdigest()
    with pytest.raises(DataError, match=r"large: https://.*: 1 of 1 pieces are wrong"):
        fetching.fetch_file(wanted(large, piece_bytes=9, pieces=["0" * 64]), tmp_path / "b.bag")


@pytest.mark.parametrize(
    ("status", "headers", "message"),
    [
        (302, {"Location": "https://[x"}, "leads to an address that can't be: Invalid IPv6"),
        (302, {"Location": f"https://{'a' * 70}.test/"}, "leads to an address that can't be: .*too long"),
        (204, {}, "HTTP status 204, no file: No Content"),
        (200, {"Content-Length": "9" * 5000}, "more than 256 GiB"),
        (206, {"Content-Range": f"bytes 0-8/{'9' * 5000}"}, "more than 256 GiB"),
        (
            206,
            {"Content-Range": f"bytes {'9' * 5000}-1/2"},
            r"the bytes from 0 on, and sent others \(bytes 9",
        ),
        (206, {}, "the server was asked for the bytes from 0 on, and sent some without saying which"),
    ],
)
def test_an_answer_that_makes_no_sense_is_named(
    large: Any, tmp_path: Path, status: int, headers: dict[str, str], message: str
) -> None:
    large.odd = status, headers
    with pytest.raises((DataError, SystemFault), match=f"^large: .*{message}"):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")


def test_wrong_bytes_are_fetched_again_once(large: Any, tmp_path: Path) -> None:
    large.wrong = {"/large.bag": 5000}
    sha256 = hashlib.sha256(LARGE).hexdigest()
    fetching.fetch_file(wanted(large, sha256=sha256), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE


def test_of_wrong_bytes_only_their_piece_is_fetched_again(large: Any, tmp_path: Path) -> None:
    large.wrong = {"/large.bag": 3 << 20}
    size = 1 << 19
    pieces = [hashlib.sha256(LARGE[k : k + size]).hexdigest() for k in range(0, len(LARGE), size)]
    sha256 = hashlib.sha256(LARGE).hexdigest()
    fetching.fetch_file(wanted(large, sha256=sha256, piece_bytes=size, pieces=pieces), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    assert large.sent == len(LARGE) + size


def test_another_file_names_both_sums(large: Any, tmp_path: Path) -> None:
    found = hashlib.sha256(LARGE).hexdigest()
    with pytest.raises(DataError, match=f"large: https://.* has sha256 {found}, expected 0000"):
        fetching.fetch_file(wanted(large, sha256="0" * 64), tmp_path / "large.bag")
    assert not [path for path in tmp_path.glob(".fetching-*") if path.suffix != ".lock"]


def test_a_file_of_another_size_is_refused_before_it_comes(large: Any, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="has 4,194,304 bytes, expected 5,000,000"):
        fetching.fetch_file(wanted(large, size=5_000_000), tmp_path / "large.bag")
    assert large.sent < len(LARGE)


def test_an_empty_file_is_a_file(large: Any, tmp_path: Path) -> None:
    (large.folder / "large.bag").write_bytes(b"")
    fetching.fetch_file(wanted(large, sha256=hashlib.sha256(b"").hexdigest()), tmp_path / "empty")
    assert (tmp_path / "empty").read_bytes() == b""


def test_a_labs_own_authority_is_trusted_beside_the_systems(
    server: str, tmp_path: Path, certificate: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SSL_CERT_FILE")
    trusted = len(https.trusted().get_ca_certs())
    with pytest.raises(SystemFault, match="certificate verify failed"):
        fetching.fetch(f"{server}/hall.bag", tmp_path / "hall.bag", SHA256, "hall")
    monkeypatch.setenv("SLAMHIVE_CERTIFICATES", str(certificate[0]))
    assert len(https.trusted().get_ca_certs()) == trusted + 1
    fetching.fetch(f"{server}/hall.bag", tmp_path / "hall.bag", SHA256, "hall")
    assert (tmp_path / "hall.bag").read_bytes() == CONTENT


@pytest.mark.parametrize(("content", "words"), [(None, "No such file"), ("no PEM", "no certificate or crl")])
def test_certificates_that_cannot_be_read(
    server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str | None, words: str
) -> None:
    if content is not None:
        (tmp_path / "ca.crt").write_text(content)
    monkeypatch.setenv("SLAMHIVE_CERTIFICATES", str(tmp_path / "ca.crt"))
    with pytest.raises(InputError, match=rf"SLAMHIVE_CERTIFICATES: .*ca.crt: expected a file .*{words}"):
        fetching.fetch(f"{server}/hall.bag", tmp_path / "hall.bag", SHA256, "hall")


def test_the_next_mirror_is_asked(large: Any, tmp_path: Path) -> None:
    urls = ["https://localhost:1/large.bag", f"{large.url}/gone.bag", f"{large.url}/large.bag"]
    fetching.fetch_file(wanted(large, urls=urls), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    with pytest.raises(
        SystemFault, match=r"large: https://localhost:1/.*refused; .*gone.bag: HTTP Error 404"
    ):
        fetching.fetch_file(wanted(large, urls=urls[:2]), tmp_path / "other.bag")


def test_a_disk_that_is_full_in_the_middle_keeps_what_came(
    large: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, full = os.pwrite, [3 << 18]

    def refuse(descriptor: int, data: Any, at: int) -> int:
        if full and at >= full[0]:
            full.clear()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data, at)

    monkeypatch.setattr(os, "pwrite", refuse)
    with pytest.raises(SystemFault, match="is full; what was fetched stays"):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    assert large.asked[-1][1] == f"bytes={3 << 18}-"


def test_two_at_once_fetch_once(large: Any, tmp_path: Path) -> None:
    said: list[str] = []
    results: list[str] = []
    start = threading.Barrier(3)

    def one() -> None:
        start.wait(50)
        progress = fetching.FetchProgress(notify=said.append)
        results.append(fetching.fetch_file(wanted(large), tmp_path / "large.bag", progress))

    threads = [threading.Thread(target=one) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [hashlib.sha256(LARGE).hexdigest()] * 3
    assert large.sent in {len(LARGE) * k for k in (1, 2, 3)}
    assert large.sent == len(LARGE) * (3 - len(said))


def test_a_page_of_google_drive_is_confirmed(large: Any, tmp_path: Path) -> None:
    large.pages["/large.bag"] = (
        "<html><head><title>Google Drive - Virus scan warning</title></head><body>"
        f'<form id="download-form" action="{large.url}/large.bag" method="get">'
        '<input type="hidden" name="id" value="x"><input type="hidden" name="confirm" value="t"></form>'
    )
    fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    assert (tmp_path / "large.bag").read_bytes() == LARGE
    assert large.asked[-1][0] == "/large.bag?id=x&confirm=t"


def test_a_page_that_wants_a_login_is_told(large: Any, tmp_path: Path) -> None:
    large.pages["/large.bag"] = "<html><head><title>Sign in</title></head><body>Please</body></html>"
    with pytest.raises(DataError, match="leads to a page, 'Sign in', not to a file: it may want a login"):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")
    large.pages["/large.bag"] = '<form id="download-form" action="https://["></form><![x['
    with pytest.raises(DataError, match="leads to a page, not to a file"):
        fetching.fetch_file(wanted(large), tmp_path / "large.bag")


@pytest.mark.parametrize("sha256", [None, "0" * 64])
def test_a_page_under_the_type_of_a_file_is_told_too(large: Any, tmp_path: Path, sha256: str | None) -> None:
    page = "\ufeff\n<!DOCTYPE html><html><head><title>Sign in</title></head><body>Please</body></html>"
    (large.folder / "large.bag").write_text(page)
    with pytest.raises(DataError, match="leads to a page, 'Sign in', not to a file: it may want a login"):
        fetching.fetch_file(wanted(large, sha256=sha256), tmp_path / "large.bag")
    assert (len(large.asked), [path.suffix for path in tmp_path.glob(".fetching-*")]) == (1, [".lock"])


CHILD = """
import sys
from pathlib import Path
from slamhive.data.files import fetching
fetching.BLOCK, fetching.PAUSES = 1 << 18, (0.0,) * 5
def count(held, total):
    print(held, flush=True)
wanted = fetching.WantedFile([sys.argv[1]], "large")
fetching.fetch_file(wanted, Path(sys.argv[2]), fetching.FetchProgress(count))
"""


def test_a_fetch_that_is_killed_goes_on(large: Any, tmp_path: Path) -> None:
    size = 24 << 20
    (large.folder / "large.bag").write_bytes(os.urandom(size))
    place = tmp_path / "large.bag"
    command = [sys.executable, "-c", CHILD, f"{large.url}/large.bag", str(place)]
    for share in (0.2, 0.5, 0.8):
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            next((line for line in child.stdout if int(line) >= share * size), None)
            child.send_signal(signal.SIGKILL)
    subprocess.run(command, check=True, capture_output=True)
    assert place.read_bytes() == (large.folder / "large.bag").read_bytes()
    starts = [int(asked.removeprefix("bytes=").rstrip("-")) for _, asked in large.asked if asked]
    assert starts[0] >= 0.2 * size
    assert starts == sorted(starts)
