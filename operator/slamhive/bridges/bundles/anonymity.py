# SPDX-License-Identifier: Apache-2.0
"""Anonymity of a bundle, for double-blind review: names, machines, paths, authors and times are taken out.

What decides the result stays, and so do model of the processor, figures and settings. What can't be taken
out, as a checksum is of it, is looked through: a bundle that still tells isn't written.
"""

from __future__ import annotations

import getpass
import platform
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.model.results import RunRecord

_TELLING = ("homepage", "description", "url")
"""Fields of manifests that aren't part of what their hashes are of, or name where a file is kept."""
_LEAST = 4
"""Characters of a name from which on it is looked for: shorter ones are words of their own."""
_COMMON = frozenset({"root", "user", "home", "localhost", "slamhive", "runner", "admin"})


def anonymous_record(record: RunRecord) -> RunRecord:
    """Return a run's record without names, machine and times."""
    provenance = record.provenance.replace(node=None)
    figures = {name: value for name, value in record.metrics.items() if isinstance(value, int | float)}
    return record.replace(
        namespace=None,
        cluster=None,
        labels={},
        message=None,
        created=None,
        started=None,
        finished=None,
        metrics=figures,
        provenance=provenance,
    )


def anonymous_spec(spec: Mapping[str, Any], *, is_public: bool) -> dict[str, Any]:
    """Return the spec of a manifest without what tells whose it is.

    Args:
        spec: the spec.
        is_public: whether everybody has it, as it comes with slamhive: it tells nothing.
    """
    if is_public:
        return dict(spec)
    found = {name: value for name, value in _without(spec, _TELLING).items() if name != "annotations"}
    if isinstance(image := found.get("image"), str):
        found["image"] = f"anonymous/{image.rpartition('/')[2]}"
    return found


def _without(value: Any, names: Iterable[str]) -> Any:
    if isinstance(value, dict):
        return {key: _without(item, names) for key, item in value.items() if key not in names}
    if isinstance(value, list):
        return [_without(item, names) for item in value]
    return value


def words_that_tell(home: Path, nodes: Iterable[str | None]) -> dict[str, str]:
    """Return texts that no anonymous bundle may hold, with what they are.

    Args:
        home: the folder of the home.
        nodes: machines on which runs ran.
    """
    found = {node: "name of a machine" for node in (platform.node(), *nodes) if node}
    found |= {str(home): "path of the home", str(Path.home()): "path of a home"}
    with suppress(OSError, KeyError):
        found[getpass.getuser()] = "name of a user"
    return {
        word: what for word, what in found.items() if len(word) >= _LEAST and word.lower() not in _COMMON
    } | {"/home/": "path of a home"}


def require_silence(files: Mapping[str, Path], words: Mapping[str, str]) -> None:
    """Look through all files for what would tell whose they are.

    Args:
        files: by their names in the bundle.
        words: texts that none may hold, with what they are.

    Raises:
        InputError: one does; the sentence names the file, not the text.
    """
    patterns = {
        re.compile(rb"(?<![A-Za-z0-9_])" + re.escape(word.encode()) + rb"(?![A-Za-z0-9_])", re.IGNORECASE)
        if word[-1] != "/"
        else re.compile(re.escape(word.encode())): what
        for word, what in words.items()
    }
    for name, path in files.items():
        content = path.read_bytes()
        for pattern, what in patterns.items():
            match = pattern.search(content)
            if match is not None:
                line = content.count(b"\n", 0, match.start()) + 1
                raise InputError(f"--anonymous: {name}:{line} holds the {what}: nothing was written")
