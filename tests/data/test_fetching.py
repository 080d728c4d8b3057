# SPDX-License-Identifier: Apache-2.0
"""Recordings from the network, over a real https server, and checksums of those at hand."""

from __future__ import annotations

import contextlib
import hashlib
import http.server
import itertools
import shutil
import ssl
import subprocess
import threading
from typing import TYPE_CHECKING

import pytest

from slamhive.data import fetching
from slamhive.data.store import materialise
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CONTENT = b"a recording\n" * 1000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def do_GET(self) -> None:
        if self.path == "/endless.bag":
            self.send_response(200)
            self.end_headers()
            with contextlib.suppress(OSError):  # until nobody listens any more
                while True:
                    self.wfile.write(CONTENT)
        elif self.path.startswith("/to/"):
            self.send_response(302)
            self.send_header("Location", self.path.removeprefix("/to/"))
            self.end_headers()
        else:
            super().do_GET()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An https server with a certificate of its own that this process trusts."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate: apt-get install openssl")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "1"]
    files = ["-keyout", str(key), "-out", str(certificate)]
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", *names, *files],
        check=True,
        capture_output=True,
    )
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    for name in ("https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    folder = tmp_path / "served"
    folder.mkdir()
    (folder / "hall.bag").write_bytes(CONTENT)

    def handler(*arguments: object) -> _Quiet:
        return _Quiet(*arguments, directory=str(folder))  # type: ignore[arg-type]

    httpd = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    httpd.socket = context.wrap_socket(httpd.socket, server_side=True)
    thread = threading.Thread(target=httpd.serve_forever)
    thread.start()
    yield f"https://localhost:{httpd.server_port}"
    httpd.shutdown()
    thread.join()
    httpd.server_close()


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
        ({"LEFT_BYTES": 1 << 60}, (SystemFault, "more than the disk has room for, 0 MiB")),
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


def test_a_server_that_hardly_sends_is_given_up(
    server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hours = itertools.count(0, 3600)
    monkeypatch.setattr(fetching.time, "monotonic", lambda: next(hours))
    monkeypatch.setattr(fetching, "STALL_BYTES", 1 << 30)
    with pytest.raises(SystemFault, match="MiB came in 60 s"):
        materialise(dataset(f"{server}/hall.bag"), tmp_path / "root", tmp_path / "home")


def test_a_recording_at_hand_must_be_what_its_checksum_says(tmp_path: Path) -> None:
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags/hall.bag").write_bytes(CONTENT)
    assert materialise(dataset(None), tmp_path, tmp_path / "home").root == tmp_path
    (tmp_path / "bags/hall.bag").write_bytes(CONTENT + b"!")
    with pytest.raises(DataError, match="expected"):
        materialise(dataset(None), tmp_path, tmp_path / "home")
