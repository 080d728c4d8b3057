# SPDX-License-Identifier: Apache-2.0
"""Parameters that the algorithm's nodes were started with, as the arguments of their processes name them.

So the Algorithm's file, its command and what a launch file of its image adds are seen alike. ROS 2 ignores
without a word what no node declares. Without rclpy.
"""

from __future__ import annotations

import re
from contextlib import suppress
from difflib import get_close_matches
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from slamhive.playback.player.processes import carriers
from slamhive.playback.player.recorder import read_regular

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

_CONTENT = "ros__parameters"
_OVERRIDE = re.compile(r"(?:(?P<node>[^:]+):)?(?P<name>[^:]+):=.*", re.DOTALL)
_MOST_NAMES, _SHOWN_NAMES = 1000, 5


class Overrides(NamedTuple):
    """Parameters that are set for the nodes of one name.

    Attributes:
        source: The file that sets them, as the node sees it; empty for the arguments themselves.
        section: The nodes: a name, with ``*`` for any one and ``**`` for any number.
        names: Of the parameters.
    """

    source: str
    section: str
    names: frozenset[str]

    def is_for(self, node: str) -> bool:
        """Tell whether a node takes them."""
        pattern = re.escape("/" + self.section.strip("/"))
        for stars, names in ((r"/\*\*", "(/.*)?"), (r"\*", "[^/]+")):
            pattern = pattern.replace(stars, names)
        return re.fullmatch(pattern, node) is not None


def overrides(mark: str) -> list[Overrides]:
    """Return the parameters that are set for the nodes of processes with a mark in their environment.

    Files that can't be read, or are no YAML, are left to ROS.
    """
    found: dict[Overrides, None] = {}
    for process in carriers(mark):
        with suppress(OSError):
            words = Path(f"/proc/{process.pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
            found |= dict.fromkeys(_of_arguments(words, Path(f"/proc/{process.pid}")))
    return list(found)


def _of_arguments(words: list[str], process: Path) -> Iterator[Overrides]:
    for option, value in pairwise(words):
        if option == "--params-file":
            # As the process sees it, which may be in a container.
            seen = process / ("root" if value.startswith("/") else "cwd") / value.lstrip("/")
            with suppress(OSError, ValueError, RecursionError, YAMLError):
                content = YAML(typ="safe", pure=True).load(read_regular(seen))
                for section, names in _sections(content, ""):
                    yield Overrides(value, section, names)
        elif option in {"-p", "--param"} and (told := _OVERRIDE.fullmatch(value)):
            section = f"/**/{told['node']}" if told["node"] else "/**"
            yield Overrides("", section, frozenset([told["name"]]))


def _sections(content: object, above: str) -> Iterator[tuple[str, frozenset[str]]]:
    """Yield the nodes that a params file is for, with the names of their parameters."""
    for key, value in content.items() if isinstance(content, dict) else ():
        if key == _CONTENT:
            yield above, frozenset(islice(_names(value, ""), _MOST_NAMES))
        else:
            yield from _sections(value, f"{above}/{key}".lstrip("/") if above else str(key))


def _names(content: object, above: str) -> Iterator[str]:
    for key, value in content.items() if isinstance(content, dict) else ():
        if value and isinstance(value, dict):
            yield from _names(value, f"{above}{key}.")
        else:
            yield f"{above}{key}"


def undeclared(given: Iterable[Overrides], declared: Mapping[str, frozenset[str] | None]) -> str:
    """Return a sentence about the parameters that no node declares; empty where there are none.

    Args:
        given: What nodes were started with.
        declared: By the name of each node its parameters, None where they aren't known.
    """
    found: dict[str, set[str]] = {}
    known: set[str] = set()
    for one in given:
        of_nodes = [names for node, names in declared.items() if one.is_for(node)]
        sure = [names for names in of_nodes if names is not None]
        if of_nodes and len(sure) == len(of_nodes):
            found.setdefault(one.source, set()).update(one.names.difference(*sure))
            known = known.union(*sure)
    return "; ".join(
        f"no node declares {_listed(names, known)}, which "
        f"{Path(source).name or 'the command'} sets: ROS 2 ignored {'them' if len(names) > 1 else 'it'}"
        for source, names in found.items()
        if names
    )


def _listed(names: set[str], known: set[str]) -> str:
    shown = []
    for name in sorted(names)[:_SHOWN_NAMES]:
        close = get_close_matches(name, sorted(known), n=1)
        shown.append(f"{name} (did you mean {close[0]}?)" if close else name)
    more = len(names) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")
