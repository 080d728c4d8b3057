# SPDX-License-Identifier: Apache-2.0
"""Places for objects: a folder, and a bucket of an S3 server on this machine."""

from __future__ import annotations

import json
import socket
import urllib.request
import uuid
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import boto3
import pytest
from moto.server import ThreadedMotoServer

from slamhive.storage.store import ObjectStorage, StoreSettings

if TYPE_CHECKING:
    from collections.abc import Iterator


class S3:
    """An S3 server on this machine; it may be ended and started again with what it held."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.endpoint = f"http://127.0.0.1:{self.port}"
        self.start()

    def start(self) -> None:
        self._server = ThreadedMotoServer("127.0.0.1", self.port, verbose=False)
        self._server.start()

    def stop(self) -> None:
        self._server.stop()
        self._server._server.server_close()

    def demand_keys(self, *, after: str) -> None:
        """Have it look at keys after so many requests: it knows none, so that all are wrong ones."""
        plain = {"Content-Type": "text/plain"}
        asked = urllib.request.Request(f"{self.endpoint}/moto-api/reset-auth", after.encode(), plain)  # noqa: S310
        urllib.request.urlopen(asked).read()  # noqa: S310

    def client(self) -> Any:
        return boto3.client("s3", endpoint_url=self.endpoint, **KEYS)


KEYS = {"aws_access_key_id": "reader", "aws_secret_access_key": "secret", "region_name": "us-east-1"}


@dataclass
class Place:
    """A place for objects.

    Attributes:
        kind: file or s3.
        url: where it is.
        options: what fsspec is told.
        s3: its server.
    """

    kind: str
    url: str
    options: dict[str, Any]
    s3: S3 | None = None

    def store(self) -> ObjectStorage:
        return ObjectStorage(StoreSettings(url=self.url, options=self.options))

    def settings(self, folder: Path) -> tuple[str, ...]:
        """Write its settings as the chart does, the keys apart, and return the options of programs."""
        open_, secret = dict(self.options), {}
        for name in ("key", "secret"):
            if name in open_:
                secret[name] = open_.pop(name)
        (folder / "secret").mkdir(parents=True, exist_ok=True)
        for name, value in secret.items():
            (folder / "secret" / name).write_text(f"{value}\n")
        (folder / "store.yaml").write_text(json.dumps({"url": self.url, "options": open_}))
        return ("--store", str(folder / "store.yaml"), "--secret", str(folder / "secret"))

    def below(self, name: str) -> Place:
        """Return an empty place in this one."""
        if self.s3 is None:
            Path(self.url.removeprefix("file://"), name).mkdir()
        return replace(self, url=f"{self.url}/{name}")

    def change(self, name: str, content: bytes) -> None:
        """Put something else into an object, past our code."""
        if self.s3 is None:
            Path(self.url.removeprefix("file://"), name).write_bytes(content)
            return
        bucket, _, prefix = self.url.removeprefix("s3://").partition("/")
        self.s3.client().put_object(Bucket=bucket, Key=f"{prefix}/{name}", Body=content)

    def remove(self, name: str) -> None:
        """Remove an object, past our code."""
        self.store()._fs.rm_file(self.store()._path(name))


def make_place(kind: str, folder: Path, s3: S3 | None) -> Place:
    if kind == "file":
        folder.mkdir()
        return Place(kind, f"file://{folder}", {})
    assert s3 is not None
    bucket = f"lab-{uuid.uuid4().hex}"
    s3.client().create_bucket(Bucket=bucket)
    return Place(kind, f"s3://{bucket}/lab", {"key": "k", "secret": "s", "endpoint_url": s3.endpoint}, s3)


@pytest.fixture(scope="session")
def s3() -> Iterator[S3]:
    found = S3()
    yield found
    found.stop()


@pytest.fixture(params=["file", pytest.param("s3", marks=pytest.mark.slow)])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    server = request.getfixturevalue("s3") if request.param == "s3" else None
    return make_place(request.param, tmp_path / "bucket", server)
