# SPDX-License-Identifier: Apache-2.0
"""Tests side by side: one process collects them all, and forks of it run them, a unit of them at a time.

Collecting takes as long as a hundred tests do: forks have done it when they begin, so there may be many.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
import traceback
import warnings
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing import Pipe
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, NoReturn

import pytest
from _pytest.runner import runtestprotocol

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from units import Durations, Unit, Units

WORKER = "PYTEST_WORKER"
"""Variable that is set in a worker: other ones run tests at the same time."""
TIDY_SECONDS = 20.0
"""From one removal of garbage between units to the next, behind which what is left is looked at no more."""
PATIENCE_SECONDS = 5.0
"""After Ctrl-C, until workers are interrupted that the terminal has not interrupted."""


@dataclass(eq=False)
class Worker:
    """A fork that runs units.

    Attributes:
        pid: its number.
        connection: brings it numbers of tests, and brings their reports.
        descriptor: becomes readable as it ends.
        unit: what it runs.
        left: tests of the unit that it has not reported.
    """

    pid: int
    connection: Connection
    descriptor: int
    unit: Unit | None = None
    left: list[int] = field(default_factory=list)


class Sharing:
    """The plugin that shares tests out.

    Args:
        count: how many workers there are; with none, all goes as without this.
        durations: what tests took, which is kept.
        units: makes the units and says which one comes next.
    """

    def __init__(self, count: int, durations: Durations, units: Units) -> None:
        self._count = count
        self._durations = durations
        self._units = units
        self._workers: list[Worker] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Have workers run the tests."""
        if not self._count or session.config.option.collectonly or session.testsfailed or not session.items:
            return None
        session.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
        self._units.make(session.items)
        try:
            for _ in range(min(self._count, len(self._units.waiting))):
                self._give(session, self._start(session))
            while self._workers:
                self._listen(session)
        finally:
            self._end()
        if session.shouldfail:
            raise session.Failed(session.shouldfail)
        if session.shouldstop:
            raise session.Interrupted(session.shouldstop)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note how long it took."""
        self._durations.add(report)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Keep how long tests took."""
        if session.testscollected and not session.config.option.collectonly:
            self._durations.keep(session.config.rootpath)

    def _start(self, session: pytest.Session) -> Worker:
        """Start a worker and return it."""
        ours, theirs = Pipe()
        sys.stdout.flush()
        with warnings.catch_warnings():
            # Libraries have threads that wait for work; none of them holds a lock while tests aren't run.
            warnings.simplefilter("ignore", DeprecationWarning)
            pid = os.fork()
        if pid == 0:
            for worker in self._workers:
                worker.connection.close()
            ours.close()
            _work(session, theirs)
        theirs.close()
        worker = Worker(pid, ours, os.pidfd_open(pid))
        self._workers.append(worker)
        return worker

    def _give(self, session: pytest.Session, worker: Worker) -> None:
        """Give a worker its next unit, or have it end."""
        worker.unit = None
        if self._units.waiting and not (session.shouldfail or session.shouldstop):
            worker.unit = self._units.next(worker.pid, self._count)
            worker.left = list(worker.unit.numbers)
        with suppress(OSError):  # it has died, which is seen when we listen
            worker.connection.send(worker.unit and worker.unit.numbers)

    def _listen(self, session: pytest.Session) -> None:
        """Wait until workers tell something or end."""
        told = {item for worker in self._workers for item in (worker.connection, worker.descriptor)}
        ready = wait(list(told))
        for worker in list(self._workers):
            if worker.connection in ready:
                try:
                    self._hear(session, worker, worker.connection.recv())
                    continue
                except (EOFError, OSError):
                    pass
            elif worker.descriptor not in ready:
                continue
            self._bury(session, worker)

    def _hear(self, session: pytest.Session, worker: Worker, told: Any) -> None:
        """Take in a test's reports, or what went wrong as a worker ended."""
        config = session.config
        if isinstance(told, str):
            session.testsfailed += 1
            reporter = config.pluginmanager.getplugin("terminalreporter")
            reporter.write_sep("!", "a worker's fixtures could not be torn down")
            reporter.write_line(told)
            return
        read = config.hook.pytest_report_from_serializable
        item = session.items[worker.left.pop(0)]
        self._report(session, item, [read(config=config, data=report) for report in told])
        if session.shouldfail or session.shouldstop:
            with suppress(OSError):
                worker.connection.send(None)
        elif not worker.left:
            self._give(session, worker)

    @staticmethod
    def _report(session: pytest.Session, item: pytest.Item, reports: list[pytest.TestReport]) -> None:
        hook = session.config.hook
        hook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in reports:
            hook.pytest_runtest_logreport(report=report)
        hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)

    def _bury(self, session: pytest.Session, worker: Worker) -> None:
        """Take a worker that has ended from the list; where it died in a test, let another one go on."""
        self._workers.remove(worker)
        worker.connection.close()
        os.close(worker.descriptor)
        _, status = os.waitpid(worker.pid, 0)
        if worker.unit is None or session.shouldfail or session.shouldstop:
            return
        item = session.items[worker.left.pop(0)]
        sentence = f"the worker that ran this ended with {os.waitstatus_to_exitcode(status)}"
        report = pytest.TestReport(item.nodeid, item.location, {}, "failed", sentence, "call")
        self._report(session, item, [report])
        if worker.left:
            self._units.waiting.insert(0, replace(worker.unit, numbers=worker.left))
        if self._units.waiting:
            self._give(session, self._start(session))

    def _end(self) -> None:
        """Wait for the workers that are left after an interruption, and interrupt those that go on."""
        for patience in (PATIENCE_SECONDS, None):
            for worker in list(self._workers):
                with suppress(OSError):
                    worker.connection.send(None)
                if wait([worker.descriptor], patience):
                    os.waitpid(worker.pid, 0)
                    self._workers.remove(worker)
                else:
                    os.kill(worker.pid, signal.SIGINT)


class Runner:
    """A worker's side: runs the tests that are asked for.

    Args:
        session: has all tests.
        connection: asks for numbers of tests, or for the end.
    """

    def __init__(self, session: pytest.Session, connection: Connection) -> None:
        self._session = session
        self._connection = connection
        self._found: list[pytest.TestReport] = []
        self._tidied = time.monotonic()

    def work(self) -> None:
        """Run tests until the end is asked for; leave what went wrong behind them."""
        config = self._session.config
        os.environ[WORKER] = str(os.getpid())
        capture = config.pluginmanager.getplugin("capturemanager")
        # What is captured goes to a file: one for each of us.
        capture.stop_global_capturing()
        capture.start_global_capturing()
        capture.suspend_global_capture()
        config.pluginmanager.register(self)
        try:
            with suppress(EOFError, KeyboardInterrupt):
                while numbers := self._connection.recv():
                    self._run(numbers)
        finally:
            self._session._setupstate.teardown_exact(None)

    def _run(self, numbers: list[int]) -> None:
        """Run a unit; what has the session's scope stays behind the last of its tests."""
        session, config = self._session, self._session.config
        if time.monotonic() - self._tidied > TIDY_SECONDS:
            gc.collect()
            gc.freeze()
            self._tidied = time.monotonic()
        items: list[Any] = [session.items[number] for number in numbers]
        for item, following in zip(items, [*items[1:], session], strict=True):
            self._found.clear()
            config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            tell = config.hook.pytest_report_to_serializable
            self._connection.send([tell(config=config, report=report) for report in self._found])
            if following is not session and self._connection.poll():
                return  # nothing comes in between but that this is the end

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item) -> bool:
        """Do as pytest does, but keep the reports: the process that shares tests out shows them."""
        self._found.extend(runtestprotocol(item, log=False, nextitem=nextitem))
        return True


def _work(session: pytest.Session, connection: Connection) -> NoReturn:
    """Run tests in this process and end it."""
    code = 1
    try:
        Runner(session, connection).work()
        code = 0
    except BaseException:  # noqa: BLE001 - whatever fixtures raise
        with suppress(OSError):
            connection.send(traceback.format_exc())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
