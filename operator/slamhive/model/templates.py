# SPDX-License-Identifier: Apache-2.0
"""The language of settings files' templates: its names, and what can be said of a template unrendered.

Jinja2's syntax without what reads other files. Templates are parsed here and never compiled: compiling
computes what is constant in them. `slamhive.templating` gives the names their meaning and renders.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from slamhive.model.errors import suggestion

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from jinja2 import nodes

TEMPLATE_LIMIT = 32 * 1024
"""Characters of a template."""
TEMPLATES_LIMIT = 64 * 1024
"""Bytes of all templates of an Algorithm: they reach a pod in one of its annotations."""
FILES_LIMIT = 16
"""Settings files of an Algorithm."""

VALUES = (
    *("algorithm", "cores", "dataset", "input", "mode", "parameters", "paths", "run", "seed", "sensors"),
)
"""Names of values: those of config.yaml, and paths."""
FUNCTIONS = (
    *("transform", "inverse", "rotation", "translation", "quaternion", "row_major", "opencv_matrix"),
    *("camera", "camodocal", "orb_slam_camera", "kalibr_camchain", "baseline", "baseline_fx"),
    *("time_shift", "discrete_noise", "fail", "range", "dict", "namespace"),
)
"""Names of functions."""
FILTERS = (
    *("abs", "batch", "default", "d", "dictsort", "first", "float", "indent", "int", "items", "join", "last"),
    *("length", "count", "list", "lower", "map", "max", "min", "reject", "replace", "reverse", "round"),
    *("select", "slice", "sort", "string", "sum", "trim", "unique", "upper", "number", "quoted"),
)
"""Names of filters. None of Jinja2's that depend on chance or are for web pages is among them."""
TESTS = (
    *("boolean", "defined", "divisibleby", "eq", "equalto", "==", "even", "false", "float", "ge", ">="),
    *("gt", "greaterthan", ">", "in", "integer", "iterable", "le", "<=", "lower", "lt", "lessthan", "<"),
    *("mapping", "ne", "!=", "none", "number", "odd", "sameas", "sequence", "string", "true", "undefined"),
    "upper",
)
"""Names of tests."""
SYNTAX: Mapping[str, Any] = {
    "trim_blocks": True,
    "lstrip_blocks": True,
    "keep_trailing_newline": True,
    "autoescape": False,
}
"""Options of the syntax: lines that hold nothing but a statement leave no empty line."""

_OF_BLOCKS = ("loop", "caller", "varargs", "kwargs")
_WHOLE = ("items", "keys", "values", "get")
_ROWS = {"Include": "include", "Import": "import", "FromImport": "from", "Extends": "extends"}


class TemplateMistake(ValueError):  # noqa: N818 - what a user wrote, said in a sentence
    """Something in a template can't be.

    Args:
        line: of the template, from 1.
        problem: what is wrong there.
    """

    def __init__(self, line: int, problem: str) -> None:
        super().__init__(f"line {line}: {problem}")


@dataclass(frozen=True)
class Template:
    """Parameters of the run that a template of a settings file takes.

    Attributes:
        parameters: names of parameters that it names.
        takes_all: whether it takes parameters by names that are only known when it is rendered.
    """

    parameters: frozenset[str]
    takes_all: bool


def read_template(
    text: str, parameters: Collection[str] | None = None, roles: Collection[str] | None = None
) -> Template:
    """Return the fields of the run that a template takes, after looking for all that shows unrendered.

    Args:
        text: the template.
        parameters: names that the Algorithm declares; None: any may be named.
        roles: roles that its modes have; None: any may be named.

    Raises:
        TemplateMistake: it doesn't follow the syntax, or names something that isn't there.
    """
    tree = _parse(text)
    found = list(_all_nodes(tree))
    stored = _stored(found)
    for node in found:
        _check_node(node, stored)
    taken: set[str] = set()
    takes_all = False
    for name, node in _fields_of("parameters", found):
        if name is None or (name in _WHOLE and name not in (parameters or ())):
            takes_all = True
        else:
            _known(name, parameters, "parameter", node.lineno)
            taken.add(name)
    for name, node in _fields_of("sensors", found):
        if name is not None and name not in _WHOLE:
            _known(name, roles, "sensor", node.lineno)
    return Template(frozenset(taken), takes_all)


@cache
def _language() -> Any:
    from jinja2 import Environment  # noqa: PLC0415 - only where an Algorithm has templates

    # Nothing is ever rendered or compiled by this one, so nothing needs escaping either.
    return Environment(**SYNTAX)  # noqa: S701


def _parse(text: str) -> nodes.Template:
    from jinja2 import TemplateSyntaxError  # noqa: PLC0415

    try:
        tree: nodes.Template = _language().parse(text)
    except TemplateSyntaxError as error:
        raise TemplateMistake(error.lineno, error.message or "not understood") from None
    except RecursionError:
        raise TemplateMistake(1, "nested too deeply") from None
    except ValueError as error:  # an integer of thousands of digits
        raise TemplateMistake(1, str(error).partition(";")[0]) from None
    return tree


def _all_nodes(tree: nodes.Node) -> Iterator[nodes.Node]:
    left = [tree]
    while left:
        node = left.pop()
        yield node
        left.extend(reversed(list(node.iter_child_nodes())))


def _stored(found: list[nodes.Node]) -> set[str]:
    """Return the names that a template itself gives to something, wherever in it."""
    names = set()
    for node in found:
        kind, name = type(node).__name__, str(getattr(node, "name", ""))
        if kind == "Macro" or (kind == "Name" and getattr(node, "ctx", "") in {"store", "param"}):
            if name in (*VALUES, *FUNCTIONS):
                raise TemplateMistake(node.lineno, f"{name!r} has a meaning already; take another name")
            names.add(name)
    return names


def _check_node(node: nodes.Node, stored: set[str]) -> None:
    kind, name = type(node).__name__, str(getattr(node, "name", ""))
    if kind in _ROWS:
        raise TemplateMistake(node.lineno, f"{_ROWS[kind]!r} is not allowed: a template reads no other file")
    value = getattr(node, "value", None)
    if isinstance(value, float) and not math.isfinite(value):
        raise TemplateMistake(node.lineno, "a number is too large: at most 1.797e308")
    if kind == "Filter":
        _known(name, FILTERS, "filter", node.lineno)
    if kind == "Test":
        _known(name, TESTS, "test", node.lineno)
    if kind == "Name" and getattr(node, "ctx", "") == "load" and name not in stored:
        _known(name, (*VALUES, *FUNCTIONS, *_OF_BLOCKS), "name", node.lineno, (*VALUES, *FUNCTIONS))


def _known(
    name: str, known: Collection[str] | None, kind: str, line: int, shown: Collection[str] | None = None
) -> None:
    if known is not None and name not in known:
        raise TemplateMistake(line, f"unknown {kind} {name!r}{suggestion(name, shown or known)}")


def _fields_of(value: str, found: list[nodes.Node]) -> Iterator[tuple[str | None, nodes.Node]]:
    """Yield the fields that are taken of a value, None where the value itself is."""
    inner = set()
    for node in found:
        kind, target = type(node).__name__, getattr(node, "node", None)
        if kind not in {"Getattr", "Getitem"} or getattr(target, "name", None) != value:
            continue
        name = getattr(node, "attr", None) or getattr(getattr(node, "arg", None), "value", None)
        if isinstance(name, str):
            inner.add(id(target))
            yield name, node
    for node in found:
        if type(node).__name__ == "Name" and getattr(node, "name", "") == value and id(node) not in inner:
            yield None, node
