# SPDX-License-Identifier: Apache-2.0
"""Sandbox in which templates are rendered: Jinja2's, with fewer names and with sentences of ours.

It keeps templates from what is not theirs. How long they take and how much memory is bounded by the kernel:
see `slamhive.templating.process`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jinja2 import StrictUndefined, pass_context
from jinja2.defaults import DEFAULT_NAMESPACE
from jinja2.sandbox import ImmutableSandboxedEnvironment
from jinja2.utils import missing

from slamhive.model.errors import suggestion
from slamhive.model.templates import FILTERS, FUNCTIONS, SYNTAX, TESTS, VALUES
from slamhive.templating.numbers import HelperProblem, number, plain, quoted, shown

if TYPE_CHECKING:
    from jinja2.runtime import Context

_OF_MAPPINGS = ("items", "keys", "values", "get")
_OWN_FILTERS = {"number": number, "quoted": quoted}


class Unknown(StrictUndefined):
    """A name that nothing is known by: any use of it says so."""

    __slots__ = ()

    @property
    def _undefined_message(self) -> str:
        name, owner = self._undefined_name, self._undefined_obj
        if self._undefined_hint:
            return self._undefined_hint
        if isinstance(owner, dict):
            return f"unknown name {name!r}{suggestion(str(name), map(str, owner))}"
        if isinstance(owner, list | tuple | str):
            return f"{shown(owner)} has no item {name!r}"
        if owner is missing:
            return f"unknown name {name!r}{suggestion(str(name), (*VALUES, *FUNCTIONS))}"
        return f"{shown(owner)} has no {name!r}"


class Sandbox(ImmutableSandboxedEnvironment):
    """Environment of templates: values print as YAML has them, and mappings have nothing but their fields."""

    def __init__(self) -> None:
        # Nothing is computed while a template is compiled: a fifth of the time, and lines would not be known.
        super().__init__(**SYNTAX, undefined=Unknown, finalize=_printed, cache_size=0, optimized=False)
        self.filters = {name: _OWN_FILTERS.get(name) or self.filters[name] for name in FILTERS}
        self.tests = {name: self.tests[name] for name in TESTS}
        self.globals = {name: DEFAULT_NAMESPACE[name] for name in FUNCTIONS if name in DEFAULT_NAMESPACE}
        self.globals["range"] = self._range

    def getattr(self, obj: Any, attribute: str) -> Any:
        """Return a field, before any method of that name."""
        if isinstance(obj, dict):
            if attribute in obj:
                return obj[attribute]
            if attribute not in _OF_MAPPINGS:
                return self.undefined(obj=obj, name=attribute)
        return super().getattr(obj, attribute)

    def getitem(self, obj: Any, argument: Any) -> Any:
        """Return an item; a mapping has no other."""
        if isinstance(obj, dict):
            try:
                return obj[argument] if argument in obj else self.undefined(obj=obj, name=argument)
            except TypeError:  # a list as a key
                raise HelperProblem(f"{shown(argument)} is no name of a field") from None
        return super().getitem(obj, argument)

    @staticmethod
    def _range(*bounds: Any) -> range:
        if not all(isinstance(item, int) for item in bounds) or not 1 <= len(bounds) <= 3:
            raise HelperProblem("range: expected one to three whole numbers")
        return range(*bounds)


@pass_context  # so that constants are printed when a template is rendered, too
def _printed(_context: Context, value: Any) -> str:
    if isinstance(value, Unknown):
        return str(value)  # which says that it is unknown
    return plain(value)
