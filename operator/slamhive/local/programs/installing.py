# SPDX-License-Identifier: Apache-2.0
"""Steps of pip and uv, by what they print: for environments of algorithms, and for ``make install``.

The standard library alone: ``make install`` uses this before there is anything else.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pathlib import Path

_STEP = re.compile(r"\s*(?P<verb>Collecting|Downloading|Installing) (?:collected packages: )?(?P<rest>.+)")
_STEP_OF_UV = re.compile(r" ?(?P<verb>Resolved|Downloaded|Prepared) (?P<rest>[\w.-]+)")
_SIZE = re.compile(r" \([\d.]+ ?[kKMG]?i?B\)")
_NAME_ENDS = {"collecting": re.compile(r"[\s=<>~!\[;]"), "downloading": re.compile(r"-\d|\s")}


class InstallStep(NamedTuple):
    """Step of an installation, with the number of packages fetched so far.

    Attributes:
        what: in words.
        done: packages that are fetched.
        total: packages in all, as far as that is known.
    """

    what: str
    done: int
    total: int

    @property
    def share(self) -> float:
        """Return the share that is done: all packages are fetched, then all are installed at once."""
        return self.done / (self.total + 1)


class Steps:
    """Follows what pip or uv prints.

    Args:
        requirements: what is installed: a file that states each package on a line.
    """

    def __init__(self, requirements: Path) -> None:
        self._stated = sum(b"==" in line for line in requirements.read_bytes().splitlines())
        self._seen = 0

    def step(self, line: str) -> InstallStep | None:
        """Return the step that a line of theirs is about; None where it is about none."""
        found = _STEP.match(line)
        if found is None:
            return self._of_uv(line)
        verb, rest = found["verb"].lower(), found["rest"]
        size = _SIZE.search(rest)
        # What pip is fetching isn't there yet; uv fetches many at a time, and says which have come.
        done = max(0, self._seen - (verb == "downloading" and ".whl" in rest))
        if verb == "installing":
            what = f"{rest.count(',') + 1} packages"
        else:
            self._seen += verb == "collecting"
            what = _NAME_ENDS[verb].split(rest, maxsplit=1)[0] + (size[0] if size else "")
        return InstallStep(f"{verb} {what}", done, max(self._stated, self._seen))

    def _of_uv(self, line: str) -> InstallStep | None:
        found = _STEP_OF_UV.match(line)
        if found is None:
            return None
        if found["verb"] == "Downloaded":
            self._seen += 1
            return InstallStep(f"fetched {found['rest']}", self._seen, self._stated)
        if found["verb"] == "Prepared":
            return InstallStep(f"installing {found['rest']} packages", self._stated, self._stated)
        self._stated = int(found["rest"])
        return InstallStep("fetching packages", 0, self._stated)
