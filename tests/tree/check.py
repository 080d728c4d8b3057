# SPDX-License-Identifier: Apache-2.0
"""Check of the tree as a whole, a line a mistake: licences, names, words, and how full its folders are.

``make lint`` calls it. Whatever breaks every clone, or what the next reader trips over, wherever it was made.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

ROOT = Path(__file__).parents[2]
SPDX = "SPDX-License-Identifier: Apache-2.0"
SOURCES = {".py", ".yaml", ".yml", ".toml", ".sh", ".js", ".css"}
NOT_OURS = ("crds/", "tests/kube/golden/", "tests/plan/golden/")
SKIPPED = {"__pycache__", "build", "dist", "node_modules"}
PLACES = re.compile(rb"(?<![\w.>])/(?:root|work|home/[a-z]\w*|Users/\w+|tmp/[a-z]\w*)/[\w.-]+")
READ = ("operator/", "evaluator/", "images/", "helm/", "tests/")
"""Folders whose docstrings are read."""
PACKAGES = ("operator/slamhive/", "evaluator/slamhive_eval/")
"""Folders whose classes have names that mean one thing."""
QUESTIONS = "what|whether|where|who|whom|whose|which|how|when|why|that|if"
RIDDLES = re.compile(
    rf'^ *r?"""(((return|yield|give)s?,? )?({QUESTIONS})|as)\b.*', re.IGNORECASE | re.MULTILINE
)
"""First lines of docstrings, which ruff has begin like this: parsing all modules takes ten times as long."""
CLASSES = re.compile(r"^class \w+", re.MULTILINE)
GLOSSARY = ("variant", "point", "slot", "attempt", "twin", "board", "common support")
MOST_SHARED = 20
"""Class names that may stand for several things, as those of the evaluator's API and of our objects do."""
FULLEST = 30
"""Files that may lie side by side in a folder of our packages."""
CATALOGUE = "operator/slamhive/catalogue/"

USED = ("operator/", "evaluator/", "images/", "helm/", "examples/", "pyproject.toml")
"""Folders and files in which a function is used that is no dead code; tests don't count."""
DEFINITIONS = re.compile(
    r"^(?P<before>.*)\n(?P<indent> *)(?:async )?(?:def|class) (?P<name>\w+)", re.MULTILINE
)
REGISTERED = re.compile(r" *@(?!property|cached_property|staticmethod|cache\b|contextmanager|dataclass)")
"""Decorators that hand a function to somebody who calls it, such as a command's."""
CALLED_BY_OTHERS = {
    *("handle_starttag", "handle_endtag", "handle_data"),  # by html.parser
    *("process_bind_param", "process_result_value"),  # by SQLAlchemy
    *("seekable", "ignore_aliases", "_undefined_message"),  # by zipfile, PyYAML, Jinja
    "Writer",  # by bridges/exporting.py, of the module that the user names
    *("put_runs", "put_catalog"),  # by tests and benches alone, which fill archives with thousands of runs
}


def tracked() -> list[Path]:
    """Return the files that belong to the tree: those that git knows, or all where there is no git."""
    git = shutil.which("git")
    if git and (ROOT / ".git").exists():
        command = [git, "-c", "safe.directory=*", "ls-files", "-z"]
        output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
        files = [ROOT / name for name in output.split("\0") if name]
    else:
        files = [path for path in ROOT.rglob("*") if not _skipped(path.relative_to(ROOT))]
    return [path for path in files if path.is_file()]


def _skipped(path: Path) -> bool:
    return any(part in SKIPPED or part.startswith(".") or part.endswith(".egg-info") for part in path.parts)


def licences(name: str, content: bytes) -> Iterator[str]:
    """Yield the complaint about a source file that doesn't begin with its licence."""
    if Path(name).suffix in SOURCES and not name.startswith(NOT_OURS):
        lines = content.split(b"\n", 2)
        if SPDX.encode() not in lines[1 if content.startswith(b"#!") else 0]:
            yield f"{name}: its first line doesn't say {SPDX}"


def places(name: str, content: bytes) -> Iterator[str]:
    """Yield the lines of a file that name a place of one machine."""
    if PLACES.search(content) and name != Path(__file__).relative_to(ROOT).as_posix():
        for number, line in enumerate(content.splitlines(), 1):
            if PLACES.search(line):
                yield f"{name}:{number}: a place of one machine: {line.decode(errors='replace').strip()[:99]}"


def packages(names: Iterable[str]) -> Iterator[str]:
    """Yield files that make a package of what must be none."""
    for name in names:
        if name == "operator/__init__.py":
            yield f"{name}: it would stand in front of Python's own module of this name"
        elif name.endswith("/__init__.py") and "tests" in name.split("/"):
            yield f"{name}: tests are no package"


def riddles(name: str, text: str) -> Iterator[str]:
    """Yield the docstrings of a module, its constants, classes and functions that begin with a question."""
    for number, first in _matches(RIDDLES, text):
        told = "is a riddle: say the noun, as in 'Return the token of the next page.'"
        yield f"{name}:{number}: {first.strip()} {told}"


def _matches(pattern: re.Pattern[str], text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines in which a pattern begins, each with its number from 1."""
    for match in pattern.finditer(text):
        yield text.count("\n", 0, match.start()) + 1, match[0]


def shared_names(classes: Iterable[tuple[str, str]], most: int = MOST_SHARED) -> Iterator[str]:
    """Yield the class names that stand for several things, with their places, where there are too many.

    Args:
        classes: the name and the place of each class; a private one shares its name with a public one.
        most: names that may do so.
    """
    found: dict[str, list[str]] = defaultdict(list)
    for word, place in classes:
        found[word.lstrip("_")].append(place)
    shared = {word: there for word, there in found.items() if len(there) > 1}
    if len(shared) > most:
        yield f"{len(shared)} class names stand for several things, at most {most} may: put the noun in front"
        yield from (f"  {word}: {', '.join(there)}" for word, there in sorted(shared.items()))


def full_folders(names: Iterable[str], most: int = FULLEST) -> Iterator[str]:
    """Yield the folders of our packages in which more files lie than a reader takes in."""
    ours = (name for name in names if name.startswith(("operator/", "evaluator/")))
    # The catalogue is a table with a file a row.
    counts = Counter(name.rpartition("/")[0] for name in ours if not name.startswith(CATALOGUE))
    for folder, count in sorted(counts.items()):
        if count > most:
            yield f"{folder}/: {count} files lie side by side, at most {most} may: give it sub-packages"


def dead_code(texts: Mapping[str, str]) -> Iterator[str]:
    """Yield the functions, methods and classes of our packages that nothing uses.

    A method is used if its name occurs anywhere else, what is of a module if it does in that module, or in a
    file that names the module.

    Args:
        texts: all in which they may be used, by path.
    """
    words = {path: Counter(re.findall(r"\w+", text)) for path, text in texts.items()}
    files: defaultdict[str, set[str]] = defaultdict(set)
    for path, found in words.items():
        for word in found:
            files[word].add(path)
    for path, text in texts.items():
        for match in DEFINITIONS.finditer(text) if path.startswith(PACKAGES) and path.endswith(".py") else ():
            name = match["name"]
            if name in CALLED_BY_OTHERS or name.startswith("__") or REGISTERED.match(match["before"]):
                continue
            elsewhere = files[name]
            if not match["indent"]:
                elsewhere = (
                    elsewhere & files[path.removesuffix("/__init__.py").removesuffix(".py").split("/")[-1]]
                )
            if words[path][name] == 1 and not elsewhere - {path}:
                number = text.count("\n", 0, match.start("name")) + 1
                yield f"{path}:{number}: {name}: nothing uses it but tests, if anything does"


def missing_words(glossary: str) -> Iterator[str]:
    """Yield the words of the house that a glossary lacks."""
    rows = re.findall(r"^\| (.+?) \|", glossary, re.MULTILINE)
    known = {name for row in rows for name in row.split(", ")}
    yield from (f"docs/glossary.md: no row for {word!r}" for word in GLOSSARY if word not in known)


def problems() -> Iterator[str]:
    """Yield all that is wrong with this tree."""
    contents = {path.relative_to(ROOT).as_posix(): path.read_bytes() for path in tracked()}
    for name, content in contents.items():
        yield from licences(name, content)
        yield from places(name, content)
    yield from packages(contents)
    classes: list[tuple[str, str]] = []
    for name, content in contents.items():
        if name.endswith(".py") and name.startswith(READ):
            text = content.decode()
            yield from riddles(name, text)
            if name.startswith(PACKAGES):
                found = _matches(CLASSES, text)
                classes += [(line.removeprefix("class "), f"{name}:{number}") for number, line in found]
    yield from shared_names(classes)
    yield from full_folders(contents)
    yield from dead_code(
        {
            name: content.decode(errors="replace")
            for name, content in contents.items()
            if name.startswith(USED) and "/vendor/" not in name
        }
    )
    yield from missing_words(contents["docs/glossary.md"].decode())


def main() -> None:
    """Print what is wrong, and fail if anything is."""
    found = list(problems())
    print("\n".join(found or ["The tree is in order."]))
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
