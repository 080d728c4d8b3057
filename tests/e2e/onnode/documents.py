# SPDX-License-Identifier: Apache-2.0
"""The commands and files of a document, as a reader would copy them."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT = Path(__file__).resolve().parents[3]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"^# ([\w./-]+\.\w+)$")


def sections(name: str) -> dict[str, str]:
    """Return the text below each heading of a document in docs/."""
    found: dict[str, list[str]] = {"": []}
    fenced, heading = False, ""
    for line in (ROOT / "docs" / name).read_text().splitlines(keepends=True):
        fenced ^= line.startswith("```")
        if not fenced and line.startswith("#"):
            heading = line.lstrip("#").strip()
        found.setdefault(heading, []).append(line)
    return {name: "".join(lines) for name, lines in found.items()}


def scripts(text: str) -> list[str]:
    """Return the shell blocks of a text."""
    return [body for language, body in FENCE.findall(text) if language in {"bash", "sh"}]


def files(text: str) -> dict[str, str]:
    """Return the blocks of a text that are files, by the name in their first line."""
    named = [(FILE.match(body.split("\n", 1)[0]), body) for _, body in FENCE.findall(text)]
    return {match[1]: body for match, body in named if match}


WAITING = re.compile(r"^helm (?:install|upgrade) .*--wait\b", re.MULTILINE)
"""Commands that wait for five minutes, which is too short while both cores of a machine are taken."""
STANDING = """
kubectl get pods,persistentvolumeclaims --all-namespaces --output wide || true
kubectl get events --all-namespaces --field-selector type=Warning --sort-by .lastTimestamp | tail -n 30
"""
"""Commands whose output is printed where a block fails: why a cluster doesn't go on stands at its objects."""


@dataclass(frozen=True)
class Desk:
    """A folder that looks like a checkout, and a shell in it.

    Attributes:
        folder: where commands are run.
        environment: what they find, among it the cluster.
    """

    folder: Path
    environment: Mapping[str, str]

    def lay_out(self, charts: Mapping[str, Path]) -> None:
        """Put links to what the documents' commands name into the folder.

        Args:
            charts: what stands for the charts, by their names. Helm takes an archive wherever it takes a
                folder, so that commands on a checkout install what a release has.
        """
        (self.folder / "helm").mkdir(parents=True)
        links = {name: ROOT / name for name in ("images", "examples", "crds")}
        for name, target in (links | {f"helm/{name}": path for name, path in charts.items()}).items():
            (self.folder / name).symlink_to(target)

    def run(self, script: str, timeout: float = 900) -> str:
        """Run a block; all of its commands have to succeed. Returns what they print."""
        done = self._shell(WAITING.sub(r"\g<0> --timeout 12m", script), timeout)
        if done.returncode:
            raise AssertionError(f"{script}\n{done.stdout}{done.stderr}\n{self._shell(STANDING, 300).stdout}")
        return done.stdout + done.stderr

    def _shell(self, script: str, timeout: float) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["bash", "-euo", "pipefail", "-c", script],
            cwd=self.folder,
            env=dict(self.environment),
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
