# SPDX-License-Identifier: Apache-2.0
"""Object storage by its URL, through fsspec: S3, Google Cloud, Azure, or a folder by ``file://``.

Every client has errors of its own. Here alone they become sentences: `StorageUnavailable` where the store
does not do what it is asked, `FileNotFoundError` for an object that is not there.
"""

from __future__ import annotations

import re
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import yaml
from pydantic import Field, ValidationError

from slamhive.model.base import Model, explain
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.extras import without

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from fsspec import AbstractFileSystem

PART_BYTES = 8 << 20
"""Largest object that is written at once; larger ones go in parts of this size, and all are read in such."""

_S3_PATIENCE = {"connect_timeout": 5, "read_timeout": 30, "retries": {"max_attempts": 2}}
_SENTENCE = 400
_LIBRARIES = {"s3": "s3fs", "s3a": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "az": "adlfs", "abfs": "adlfs"}


class StorageUnavailable(SystemFault):
    """The object storage does not do what it is asked: it is away, or refuses.

    Attributes:
        answered: whether it answered at all.
    """

    reason = "StorageUnavailable"

    def __init__(self, message: str, *, answered: bool = False) -> None:
        super().__init__(message)
        self.answered = answered


class StoreSettings(Model):
    """Settings of the object storage: where it is, and how it is reached."""

    url: str = Field(pattern=r"^[a-z][a-z0-9+.-]*://[^\s:]")
    options: dict[str, Any] = Field(default_factory=dict)

    @classmethod
    def read(cls, path: Path, secret: Path | None = None) -> Self:
        """Read the settings.

        Args:
            path: a YAML file with ``url`` and ``options``, which fsspec gets.
            secret: a folder with further options, a file for each, as a Secret is mounted.

        Raises:
            InputError: a sentence that names the file, the field and what is allowed.
        """
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
            found = cls.model_validate({} if content is None else content)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: the storage's settings can't be read: {error}") from None
        except yaml.YAMLError as error:
            raise InputError(f"{path}: not valid YAML: {getattr(error, 'problem', error)}") from None
        except ValidationError as error:
            mistake = error.errors()[0]
            place = ".".join(str(part) for part in mistake["loc"])
            raise InputError(
                f"{path}: {place}: {explain(mistake)}; expected a URL such as s3://bucket/folder"
            ) from None
        return found.replace(options=found.options | (_secrets(secret) if secret else {}))


def _secrets(folder: Path) -> dict[str, str]:
    """Return the texts of a mounted Secret's files, by their names."""
    try:
        # Kubernetes has folders beside them whose names begin with two dots.
        files = [path for path in sorted(folder.iterdir()) if path.is_file() and path.name[0] != "."]
        return {path.name: path.read_text(encoding="utf-8").strip() for path in files}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{folder}: the storage's secret can't be read: {error}") from None


class ObjectStorage:
    """Objects by their names below a URL.

    Args:
        settings: where it is.

    Raises:
        InputError: the URL or the options are not such.
    """

    def __init__(self, settings: StoreSettings) -> None:
        self.url = settings.url.rstrip("/")
        protocol = settings.url.partition("://")[0]
        options = dict(settings.options)
        if protocol in {"s3", "s3a"}:
            options = {"config_kwargs": _S3_PATIENCE} | options
        elif protocol in {"file", "local"}:
            options = {"auto_mkdir": True} | options
        self._fs, self._base = _opened(self.url, protocol, options)
        self._is_folder = protocol in {"file", "local"}

    def check(self) -> None:
        """See whether the store answers.

        Raises:
            StorageUnavailable: it does not.
        """
        # A mount that is away leaves an empty place behind, which must not be taken for the store.
        if self._is_folder and not Path(self._base).is_dir():
            raise StorageUnavailable(f"storage {self.url}: there is no folder {self._base}")
        with suppress(FileNotFoundError), self._told():
            self._fs.ls(self._base, detail=False)

    def write(self, name: str, pieces: Iterable[bytes]) -> None:
        """Write an object of some pieces, of which none is larger than `PART_BYTES`.

        Raises:
            StorageUnavailable: it can't be.
        """
        waiting = iter(pieces)
        first = next(waiting, b"")
        second = next(waiting, None)
        if second is None:
            with self._told():
                self._fs.pipe_file(self._path(name), first)
            return
        with self._told():
            file = self._fs.open(self._path(name), "wb", block_size=PART_BYTES)
        try:
            for data in (first, second):
                self._told_call(file.write, data)
            for data in waiting:
                self._told_call(file.write, data)
        except BaseException:
            self._abandon(file)
            raise
        self._told_call(file.close)

    def read(self, name: str, begin: int | None = None, end: int | None = None) -> bytes:
        """Return an object, or a range of its bytes.

        Raises:
            FileNotFoundError: there is none.
            StorageUnavailable: it can't be had.
        """
        with self._told():
            found = self._fs.cat_file(self._path(name), start=begin, end=end)
        return bytes(found)

    def pieces(self, name: str, begin: int, end: int) -> Iterator[bytes]:
        """Read an object from one byte to another, a part at a time; errors as of `read`.

        It ends early where the object does.
        """
        while begin < end:
            wanted = min(end - begin, PART_BYTES)
            data = self.read(name, begin, begin + wanted)
            begin += len(data)
            if data:
                yield data
            if len(data) < wanted:  # beyond its end, some stores refuse to answer
                return

    def sizes(self, folder: str) -> dict[str, int]:
        """Return the sizes of all objects below a folder, in bytes, by their names from there.

        Raises:
            StorageUnavailable: they can't be listed.
        """
        place = self._path(folder)
        try:
            with self._told():
                self._fs.invalidate_cache()
                found = self._fs.find(place, detail=True)
        except FileNotFoundError:
            return {}
        return {path.removeprefix(place).lstrip("/"): int(item["size"]) for path, item in found.items()}

    def _abandon(self, file: Any) -> None:
        """Let go of an object that is half written; closing it would make one of what is there."""
        if self._is_folder:
            file.close()
            return
        with suppress(Exception):
            file.discard()
        file.closed = True

    def _path(self, name: str) -> str:
        return f"{self._base}/{name}"

    def _told_call(self, method: Callable[..., object], *words: object) -> None:
        with self._told():
            method(*words)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn what a client raises into errors of ours."""
        try:
            yield
        except FileNotFoundError as error:
            if _code(error) == "NoSuchBucket":
                raise StorageUnavailable(self._sentence(error)) from error
            raise
        except Exception as error:
            raise StorageUnavailable(self._sentence(error), answered=_code(error) is not None) from error

    def _sentence(self, error: Exception) -> str:
        said = " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
        code = _code(error)
        shown = f"{code}: {said}" if code and code not in said else said
        return f"storage {self.url}: {shown[:_SENTENCE]}"


def _code(error: BaseException) -> str | None:
    """Return the code that S3 gave for an error, None where there is none."""
    response = getattr(error.__cause__, "response", None)
    found = response.get("Error", {}).get("Code") if isinstance(response, dict) else None
    return str(found) if found else None


def _opened(url: str, protocol: str, options: dict[str, Any]) -> tuple[AbstractFileSystem, str]:
    if "::" in url or re.search(r"//[^/]*@", url):
        raise InputError(
            f"url: {url!r} is a chain or has a password; expected one such as s3://bucket/folder"
        )
    try:
        import fsspec  # noqa: PLC0415 - an extra, and for those alone who have a store
    except ImportError:
        raise without("object storage", "fsspec", "s3") from None
    try:
        system, base = fsspec.url_to_fs(url, skip_instance_cache=True, use_listings_cache=False, **options)
    except ImportError as error:
        library = _LIBRARIES.get(protocol)
        raise InputError(f"url: {url!r} needs {library or 'another library'}: {error}") from None
    except Exception as error:  # noqa: BLE001 - every client checks its options in its own way
        raise InputError(f"url: {url!r} with these options: {' '.join(str(error).split())}") from None
    return system, str(base).rstrip("/")
