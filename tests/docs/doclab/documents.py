# SPDX-License-Identifier: Apache-2.0
"""Documents of the project, their fenced blocks, and the files that they name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).parents[3]
PACKAGE = ROOT / "operator" / "slamhive"
FOLDERS = ("docs", "tests", "images", "examples", "evaluator", "helm", ".github")
DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
"""Documents that users and maintainers read, whose blocks are held to what they show."""
_BESIDE = chain.from_iterable((ROOT / folder).rglob("*.md") for folder in FOLDERS)
ALL = sorted(
    {path for path in (*DOCUMENTS, *ROOT.glob("*.md"), *_BESIDE) if "node_modules" not in path.parts}
)
"""All documents, those beside the code too."""
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"^# ([\w./-]+\.\w+)$")


def name_of(document: Path) -> str:
    """Return a document's path in the repository."""
    return document.relative_to(ROOT).as_posix()


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and the file that its first line names."""

    language: str
    text: str

    @property
    def file(self) -> str | None:
        match = FILE.match(self.text.split("\n", 1)[0])
        return match.group(1) if match else None


def blocks(document: Path, *languages: str) -> list[Block]:
    found = [Block(*match.groups()) for match in FENCE.finditer(document.read_text())]
    return [block for block in found if not languages or block.language in languages]


def prose(document: Path) -> str:
    """Return a document without its fenced blocks."""
    return FENCE.sub("", document.read_text())


@cache
def code_file(name: str) -> Path | None:
    """Return the file or folder of a name, of the repository or of the package; None where there is none."""
    return next((root / name for root in (ROOT, PACKAGE, ROOT / "evaluator") if (root / name).exists()), None)
