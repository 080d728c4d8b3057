# SPDX-License-Identifier: Apache-2.0
"""Libraries of other programs: extras of slamhive, imported when they are asked for."""

from __future__ import annotations

import importlib
from typing import Any

from slamhive.model.errors import InputError


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
        raise InputError(
            f"{what} needs the package {(error.name or module).partition('.')[0]}; install slamhive with its "
            f"extra: pip install 'slamhive[{extra}]'"
        ) from None
