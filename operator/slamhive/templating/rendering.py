# SPDX-License-Identifier: Apache-2.0
"""Rendering of templates in this process, with sentences that name the line.

Unbounded in time and memory: `slamhive.templating.process` runs it in a process that the kernel bounds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jinja2 import TemplateSyntaxError, UndefinedError
from jinja2.exceptions import SecurityError

from slamhive.contract.lines import printable
from slamhive.model.templates import TemplateMistake
from slamhive.templating.helpers import Helpers
from slamhive.templating.numbers import HelperProblem
from slamhive.templating.sandbox import Sandbox

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping
    from types import TracebackType

    from jinja2 import Template

_FILE = "<template>"  # what Jinja calls the code of a template that comes from no file
OUTPUT_LIMIT = 1 << 20
"""Bytes of a rendered file."""


class OutOfTime(Exception):  # noqa: N818 - raised by a signal of the kernel
    """The processor time is used up."""


class Renderer:
    """Renders the templates of one run.

    Args:
        told: the run's configuration, as config.yaml has it.
        run: the run folder, as the program sees it.
        files: the folder of settings files, as the program sees it.
        time: what a sentence calls the time that rendering may take.
        memory: what it calls the memory.
    """

    def __init__(
        self,
        told: Mapping[str, Any],
        run: str,
        files: str,
        time: str = "its time",
        memory: str = "its memory",
    ) -> None:
        helpers = Helpers(told, run, files)
        self._sandbox = Sandbox()
        self._values = helpers.values() | helpers.functions()
        self._time, self._memory = time, memory

    def text(self, template: str) -> str:
        """Return a template's text.

        Raises:
            TemplateMistake: it can't be rendered, or gives more than a settings file may hold.
        """
        try:
            compiled = self._sandbox.from_string(template)
        except TemplateSyntaxError as error:
            raise TemplateMistake(error.lineno, error.message or "not understood") from None
        except (RecursionError, MemoryError, OutOfTime, ValueError, SyntaxError) as error:
            raise TemplateMistake(1, self._said(error)) from None
        try:
            chunks: Any = compiled.root_render_func(compiled.new_context(self._values))
            return "".join(_bounded(chunks))
        except Exception as error:  # noqa: BLE001 - whatever an expression raises is the template's
            raise TemplateMistake(_line(compiled, error.__traceback__), self._said(error)) from None

    def _said(self, error: Exception) -> str:
        sentences: dict[type[Exception], str] = {
            OutOfTime: f"it takes more than {self._time}",
            MemoryError: f"it takes more than {self._memory}",
            RecursionError: "nested too deeply",
            UnicodeEncodeError: "half a character (a lone surrogate)",
            ZeroDivisionError: "division by zero",
            OverflowError: "a number gets too large",
        }
        told = _clean(str(error))
        if type(error) in sentences:
            return sentences[type(error)]
        if isinstance(error, SecurityError):
            return f"not allowed in a template: {told}"
        return (
            told if isinstance(error, HelperProblem | UndefinedError) else f"{type(error).__name__}: {told}"
        )


def _clean(sentence: str) -> str:
    """Return a sentence in one line, without what a terminal or a file in UTF-8 can't show."""
    return printable(" ".join(sentence.split())[:500])


def _bounded(chunks: Generator[str, None, None]) -> Iterator[str]:
    """Yield a template's text; what is wrong with it is raised where the template stands."""
    size = 0
    for chunk in chunks:
        try:
            size += len(chunk.encode())
        except UnicodeEncodeError as error:
            chunks.throw(error)
        if size > OUTPUT_LIMIT:
            chunks.throw(HelperProblem(f"the file gets larger than {OUTPUT_LIMIT} bytes"))
        yield chunk


def _line(template: Template, trace: TracebackType | None) -> int:
    """Return the last line of a template that a traceback leads through."""
    line = 1
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == _FILE:
            line = template.get_corresponding_lineno(trace.tb_lineno)
        trace = trace.tb_next
    return line
