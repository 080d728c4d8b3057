# SPDX-License-Identifier: Apache-2.0
"""Frame of every Job's program: paths of the mounts, its request, and a termination message at any end."""

from __future__ import annotations

import argparse
import errno
import json
import os
import signal
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ValidationError

from slamhive.jobs.messages import failed
from slamhive.model.base import explain
from slamhive.model.errors import InputError, SlamHiveError, SystemFault, sentence
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

MOUNT = Path("/slamhive")
"""Folder of a pod's volumes and its request."""

TERMINATION_LOG = "/dev/termination-log"
_UMASK = 0o027
"""All pods run as one user and group; nobody else on the volume's server is to read or write."""

M = TypeVar("M", bound=BaseModel)

_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
"""Errors by which a disk speaks of itself, not of what it was asked for."""


class Refused(SlamHiveError):  # noqa: N818 - says what a Job answers
    """Error of a Job's program that can't do what it was asked, with the reason that it reports.

    Args:
        reason: why, in one word.
        message: why, in a sentence.
    """

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(message)
        self.why = reason


class _Ended(BaseException):
    """The pod is being taken away."""


def arguments(description: str) -> argparse.ArgumentParser:
    """Return a parser with the options of all programs."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "--root", type=Path, default=MOUNT, help="folder of the mounted volumes (default: %(default)s)"
    )
    return parser


def add_store(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Add the options that say which object storage there is."""
    parser.add_argument("--store", type=Path, required=required, help="settings of the object storage (YAML)")
    parser.add_argument("--secret", type=Path, help="folder with further options of it, a file each")


def run_program(work: Callable[[], str], refusal: Reason = Reason.SYSTEM_FAULT) -> int:
    """Do a Job's work and leave its last words, whatever happens.

    Args:
        work: returns the termination message of success.
        refusal: what wrong input means for whoever reads the message.

    Returns:
        The exit code: 0, or 1 with a message that says why.
    """
    os.umask(_UMASK)
    signal.signal(signal.SIGTERM, _end)
    try:
        message, code = work(), 0
    except (Exception, _Ended) as error:  # noqa: BLE001 - a Job answers for everything
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        reason, told = _told(error, refusal)
        print(f"{reason}: {told}", file=sys.stderr, flush=True)  # noqa: T201
        message, code = failed(reason, told), 1
    return code if leave(message) else 1


def leave(message: str) -> bool:
    """Write the termination message, and tell whether it could be."""
    named = os.environ.get("SLAMHIVE_TERMINATION_LOG")
    flags = os.O_WRONLY | os.O_TRUNC | (os.O_CREAT if named else 0)
    try:
        descriptor = os.open(named or TERMINATION_LOG, flags, 0o640)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(message)
    except FileNotFoundError:
        return True  # not in a pod
    except OSError as error:
        print(f"{named or TERMINATION_LOG}: {error.strerror}", file=sys.stderr)  # noqa: T201
        return False
    return True


def read_request(root: Path) -> dict[str, Any]:
    """Read what a Job is asked for.

    Raises:
        SystemFault: it isn't there or is no object.
    """
    path = root / "request" / "request.json"
    try:
        found = json.loads(path.read_bytes())
    except OSError as error:
        raise SystemFault(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise SystemFault(f"{path}: is no JSON object")
    return found


def parse(kind: type[M], value: Any, where: str) -> M:
    """Read a part of a request.

    Raises:
        InputError: it isn't what it should be.
    """
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in (where, *first["loc"]))
        raise InputError(f"{place}: {explain(first)}") from None


def write_aside(path: Path, fill: Callable[[Path], object], mode: int = 0o440) -> None:
    """Make a file that is whole when it exists, however many make it at once.

    Args:
        path: the file.
        fill: writes a file at the path that it is given.
        mode: who may read it.

    Raises:
        OSError: the disk refuses.
    """
    aside = path.with_name(f".{path.name}.{os.urandom(6).hex()}.making")
    try:
        fill(aside)
        descriptor = os.open(aside, os.O_RDONLY)
        try:
            os.fchmod(descriptor, mode)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        aside.replace(path)
    except OSError as error:
        error.filename = error.filename or str(path)  # a write names no file
        raise
    finally:
        aside.unlink(missing_ok=True)


def _end(_signal: int, _frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise _Ended


def _told(error: BaseException, refusal: Reason) -> tuple[Reason, str]:
    """Return the reason of a Job's failure, in one word and in a sentence."""
    if isinstance(error, _Ended):
        return Reason.SYSTEM_FAULT, "the pod was taken away before it had finished"
    if isinstance(error, MemoryError):
        return Reason.SYSTEM_FAULT, "it needed more memory than it may have"
    if isinstance(error, Refused):
        return error.why, str(error)
    if isinstance(error, SlamHiveError):
        fault = isinstance(error, SystemFault) or _disk_fault(error) is not None
        return Reason.SYSTEM_FAULT if fault else refusal, str(error)
    disk = error if isinstance(error, OSError) else _disk_fault(error)
    if disk is not None:
        return Reason.SYSTEM_FAULT, sentence(disk)
    traceback.print_exception(error)
    return Reason.SYSTEM_FAULT, f"unforeseen: {type(error).__name__}: {' '.join(str(error).split())}"


def _disk_fault(error: BaseException | None) -> OSError | None:
    """Return the disk's refusal behind an error, whatever it was wrapped in."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _DISK:
            return error
        error = error.__cause__ or error.__context__
    return None
