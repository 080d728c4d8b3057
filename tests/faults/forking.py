# SPDX-License-Identifier: Apache-2.0
"""Commands called in forks of one process that has imported all they need, which takes longer than they do.

As a program it reads lines of JSON: an order, which it answers with the fork's number, or the number of a
fork, which it answers with that one's exit code. A fork has the order's environment and folder; where a
library is preloaded that makes faults, the fork tells it anew where, before the call. ``Forks`` starts that
program and gives the orders.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
import traceback
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable


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
        code: int = self._answer({"end": self._answer(order), "wait": True})
        return code

    def start(self, **order: Any) -> Fork:
        """Begin to call a function, which ``call`` describes."""
        return Fork(self._answer(order), self._answer)

    def _answer(self, line: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(line) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


class Fork:
    """A fork that runs, with what tests need of ``subprocess.Popen``.

    Args:
        pid: its number.
        answer: what gives the forking program a line and returns its answer.
    """

    def __init__(self, pid: int, answer: Callable[[Any], Any]) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._answer = answer

    def poll(self) -> int | None:
        """Return the exit code, None as long as it runs."""
        if self.returncode is None:
            self.returncode = self._answer({"end": self.pid, "wait": False})
        return self.returncode

    def wait(self, timeout: float = 300.0) -> int:
        """Return the exit code when it has ended.

        Raises:
            subprocess.TimeoutExpired: it has not ended within so many seconds.
        """
        deadline = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(f"fork {self.pid}", timeout)
            time.sleep(0.02)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it by SIGKILL."""
        self.send_signal(signal.SIGKILL)


def fork(order: dict[str, Any]) -> int:
    """Call a function of a module in a fork and return that one's number."""
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
    return process


def end(process: int, *, wait: bool) -> int | None:
    """Return the exit code of a fork, None as long as it runs; perhaps wait until it has ended."""
    ended, status = os.waitpid(process, 0 if wait else os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if ended else None


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
    """Import and call what is named, then take lines until there are none."""
    for name in sys.argv[1:]:
        module, _, function = name.partition(":")
        imported = import_module(module)
        if function:
            getattr(imported, function)()
    for line in sys.stdin:
        told = json.loads(line)
        found = end(told["end"], wait=told["wait"]) if "end" in told else fork(told)
        sys.stdout.write(f"{json.dumps(found)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
