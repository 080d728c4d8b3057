# SPDX-License-Identifier: Apache-2.0
"""Uses of an algorithm's parameters: those that nothing reads change no run."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from slamhive.local.home.catalog import bundled
from slamhive.model.errors import InputError
from slamhive.model.loading import read_text
from slamhive.model.templates import read_template

if TYPE_CHECKING:
    from slamhive.local.home.catalog import AlgorithmEntry

_WHOLE = re.compile(r"""parameters["']?\]?\)?\s*\.\s*(items|values|keys)\b|\*\*[\w.\[\]"'()]*parameters""")
_FILES, _BYTES = 1000, 4 << 20
_SHARED = re.compile(r"^from (adapter_\w+) import", re.MULTILINE)
_ASKS = "run.parameter("


class Uses(NamedTuple):
    """Parameters of an algorithm that nothing seems to read, and why that may be wrong.

    Attributes:
        unused: those that no template and no program of its folder names.
        why_unsure: why others than these may read them all the same; None where nobody can.
    """

    unused: list[str]
    why_unsure: str | None


def parameter_uses(entry: AlgorithmEntry) -> Uses:
    """Return the parameters of an algorithm that nothing reads: looked for as words of the text."""
    spec = entry.algorithm.spec
    left = set(spec.parameters)
    for _, template in spec.templates:
        found = read_template(template)
        left -= left if found.takes_all else found.parameters
    if not left:
        return Uses([], None)
    text = "\n".join(_programs(entry))
    left = {name for name in left if not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text)}
    why = None
    if spec.local is None:
        why = "what its image reads isn't known here"
    elif spec.local.command is not None:
        why = "what its program reads by itself isn't known here"
    elif _WHOLE.search(text):
        why = "its adapter takes all parameters by whatever name they have"
    return Uses(sorted(left), why)


def _programs(entry: AlgorithmEntry) -> list[str]:
    """Return the text of the programs in an algorithm's folder, and of shared ones that ask for some."""
    local = entry.algorithm.spec.local
    paths = [] if local is None or local.command else [entry.folder / local.adapter]
    paths += sorted(entry.folder.rglob("*.py"))[:_FILES]
    texts = []
    for path in dict.fromkeys(paths):
        if path.is_file() and path.stat().st_size <= _BYTES:
            try:
                texts.append(read_text(path))
            except InputError:  # no text in UTF-8: no program of ours
                continue
    shared = dict.fromkeys(name for text in texts for name in _SHARED.findall(text))
    helpers = [bundled("algorithms") / f"{name}.py" for name in shared]
    # Most of them know no algorithm's parameters, and their words are anybody's.
    return texts + [text for path in helpers if path.is_file() and _ASKS in (text := read_text(path))]
