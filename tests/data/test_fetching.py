# SPDX-License-Identifier: Apache-2.0
"""Recordings from the network, over a real https server, and checksums of those at hand."""

from __future__ import annotations

import hashlib
import http.server
import shutil
import ssl
import subprocess
import threading
from typing import TYPE_CHECKING

import pytest

from slamhive.data.store import materialise
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CONTENT = b"a recording\n" * 1000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


class _Quiet(http.server.SimpleHTTPRequestHandler):
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


def test_a_recording_at_hand_must_be_what_its_checksum_says(tmp_path: Path) -> None:
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags/hall.bag").write_bytes(CONTENT)
    assert materialise(dataset(None), tmp_path, tmp_path / "home").root == tmp_path
    (tmp_path / "bags/hall.bag").write_bytes(CONTENT + b"!")
    with pytest.raises(DataError, match="expected"):
        materialise(dataset(None), tmp_path, tmp_path / "home")
