# SPDX-License-Identifier: Apache-2.0
"""Extras of slamhive: libraries imported when they are asked for, and the line that installs one."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from typing import Any

from slamhive.model.errors import InputError

_CHECKOUT = Path(__file__).resolve().parents[3]
"""Folder of the checkout, where this is one."""


def how_to_install(extra: str) -> str:
    """Return the line that installs an extra where this runs: in a checkout's own environment, or by pip."""
    packages = _CHECKOUT / "constraints.txt"
    if not packages.exists():
        return f"pip install 'slamhive[{extra}]'"
    own = _CHECKOUT / ".venv"
    if Path(sys.prefix).resolve() != own.resolve():
        return f"pip install -e '{_CHECKOUT}[{extra}]'"
    from importlib import metadata  # noqa: PLC0415 - takes long, and is asked where an extra is missing

    mark = f"; extra == '{extra}'"
    stated = [line.removesuffix(mark) for line in metadata.requires("slamhive") or () if line.endswith(mark)]
    pinned = packages.read_text(encoding="utf-8")
    names = [re.split(r"[^\w.-]", line)[0].lower() for line in stated]
    if all(f"\n{name}==" in pinned for name in names if not name.startswith("slamhive")):
        return f"make -C {_CHECKOUT} install"
    return f"{own}/bin/uv pip install --python {own} {' '.join(map(repr, stated))}"


def without(what: str, package: str | None, extra: str) -> InputError:
    """Return the error that a package of an extra isn't installed.

    Args:
        what: needs it, as the subject of a sentence.
        package: the package, or a module of it.
        extra: of slamhive, which brings it.
    """
    name = (package or extra).partition(".")[0]
    return InputError(f"{what} needs the package {name}, of the extra {extra}: {how_to_install(extra)}")


def library(module: str, extra: str, what: str) -> Any:
    """Return a module of an extra.

    Args:
        module: what is imported.
        extra: of slamhive, which brings it.
        what: the option or command that needs it, for the sentence.

    Raises:
        InputError: it isn't installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise without(what, error.name or module, extra) from None
