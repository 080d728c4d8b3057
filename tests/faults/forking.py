# SPDX-License-Identifier: Apache-2.0
"""Commands called in forks of one process that has imported all they need, which takes longer than they do.

As a program it reads orders as lines of JSON, and writes the exit code of each. A fork has the order's
environment and folder; where a library is preloaded that makes faults, the fork tells it anew where, before
the call. ``Forks`` starts that program and gives the orders.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import traceback
from importlib import import_module
from typing import Any


class Forks:
    """A process that forks commands.

    Args:
        modules: what it imports first; ``MODULE:FUNCTION`` is called too, for what is made at its first use.
        env: its environment.
    """

    def __init__(self, modules: tuple[str, ...], env: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__, *modules],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def call(self, **order: Any) -> int:
        """Call a function and return its exit code.

        Args:
            order: module, function, arguments; words of the command line; env, cwd; files out and err.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def call(order: dict[str, Any]) -> int:
    """Call a function of a module in a fork and return its exit code."""
    process = os.fork()
    if process == 0:
        code = 70
        try:
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # ours has the orders
            for number, path in ((1, order["out"]), (2, order["err"])):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), number)
            os.environ.clear()
            os.environ.update(order["env"])
            os.chdir(order["cwd"])
            sys.argv = ["slamhive", *order["words"]]
            if "LD_PRELOAD" in os.environ:
                ctypes.CDLL(os.environ["LD_PRELOAD"]).fault_begin()
            code = _called(order)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def _called(order: dict[str, Any]) -> int:
    try:
        found = getattr(import_module(order["module"]), order["function"])(*order["arguments"])
    except SystemExit as end:
        return int(end.code or 0)
    except BaseException:  # noqa: BLE001 - as the interpreter would
        traceback.print_exc()
        return 1
    return int(found or 0)


def main() -> None:
    """Import and call what is named, then take orders until there are none."""
    for name in sys.argv[1:]:
        module, _, function = name.partition(":")
        imported = import_module(module)
        if function:
            getattr(imported, function)()
    for line in sys.stdin:
        sys.stdout.write(f"{call(json.loads(line))}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
