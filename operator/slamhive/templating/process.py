# SPDX-License-Identifier: Apache-2.0
"""Rendering by a process of its own: what a template takes of time and memory, the kernel bounds.

No counter in the sandbox would: ``ns.x = [ns.x, ns.x]`` in a loop of sixty doubles what printing it takes
each time, and a single operation in C is seen by no counter. See docs/decisions/0010-templates.md.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import SettingsError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

CPU_SECONDS = 2.0
"""Processor time that all templates of a run may take."""
MEMORY_BYTES = 64 << 20
"""Memory that rendering may take beyond that of the process that renders."""
MEMORY_TEXT = f"{MEMORY_BYTES >> 20} MiB of memory"
_WALL_SECONDS = 120.0


@dataclass(frozen=True)
class RenderedFile:
    """A settings file as the program reads it.

    Attributes:
        path: below the folder of settings files.
        text: its content.
    """

    path: str
    text: str


def render(
    templates: Sequence[tuple[str, str]],
    told: Mapping[str, Any],
    run: str,
    files: str,
    cpu_seconds: float = CPU_SECONDS,
) -> list[RenderedFile]:
    """Return an algorithm's settings files for a run.

    Args:
        templates: path and template of each.
        told: the run's configuration as plain values, as config.yaml has it.
        run: the run folder, as the program sees it.
        files: the folder of settings files, as the program sees it.
        cpu_seconds: processor time that all of them may take.

    Raises:
        SettingsError: a template can't be rendered; the sentence names its field and line.
        SystemFault: the machine couldn't.
    """
    time = f"{cpu_seconds:g} s of processor time"
    request = {
        "templates": [text for _, text in templates],
        "told": told,
        "run": run,
        "files": files,
        "seconds": cpu_seconds,
        "time": time,
    }
    try:
        ended = subprocess.run(
            # -P: a json.py in the user's working folder is none of ours.
            [sys.executable, "-P", "-m", "slamhive.templating"],
            input=json.dumps(request).encode(),
            capture_output=True,
            check=False,
            timeout=_WALL_SECONDS,
        )
    except subprocess.TimeoutExpired:
        raise SystemFault(f"settings files: not rendered within {_WALL_SECONDS:g} s") from None
    except OSError as error:
        raise SystemFault(f"settings files can't be rendered: {error.strerror}") from None
    numbers = [line for line in ended.stderr.decode(errors="replace").splitlines() if line.isdecimal()]
    at = int(numbers[-1]) if numbers else None
    if ended.returncode < 0 and at is not None and at < len(templates):
        # Ended by the kernel, in the middle of one operation.
        raise SettingsError(f"{_where(told, at, templates)}: it takes more than {time} or {MEMORY_TEXT}")
    if ended.returncode != 0:
        last = ended.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise SystemFault(f"settings files can't be rendered: {last or f'exit code {ended.returncode}'}")
    answer = json.loads(ended.stdout.decode("utf-8", "surrogatepass"))
    if "problem" in answer:
        raise SettingsError(f"{_where(told, answer['file'], templates)}: {answer['problem']}")
    return [RenderedFile(path, text) for (path, _), text in zip(templates, answer["texts"], strict=True)]


def _where(told: Mapping[str, Any], index: int, templates: Sequence[tuple[str, str]]) -> str:
    return f"algorithm {told.get('algorithm')!r}: files.{index}.template ({templates[index][0]})"
