# SPDX-License-Identifier: Apache-2.0
"""Asking of the API within the process: the addresses of the dashboard, without workers and sockets."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast
from urllib.parse import quote, unquote

from fastapi import Request, Response

from slamhive.analysis.grouping import where_equal
from slamhive.dashboard.answering.totals import SweepTotals
from slamhive.dashboard.problems import told
from slamhive.dashboard.server.app import application
from slamhive.dashboard.server.service import Service
from slamhive.model.errors import UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from slamhive.archive.records import SweepRecord
    from slamhive.dashboard.answering.encoding import Body
    from slamhive.dashboard.answering.workers import AnswerWorkers
    from slamhive.dashboard.sources.archived import Snapshot, Source
    from slamhive.model.results import RunRecord

T = TypeVar("T")
G = TypeVar("G")

REVISION = "site"
"""Revision that all answers of a site bear: equal answers are then equal files."""

_UNESCAPED = "!'()*"


class PublishedRuns:
    """A source as it was at one moment, its finished runs alone, of some sweeps alone.

    Args:
        source: the source.
        snapshot: its data.
        sweeps: the sweeps; empty for all runs.
    """

    def __init__(self, source: Source, snapshot: Snapshot, sweeps: Sequence[str] = ()) -> None:
        self._source = source
        self._ahead: dict[str, RunRecord] = {}
        self._sweeps = tuple(dict.fromkeys(sweeps))
        frame = snapshot.frame
        if self._sweeps:
            known = {str(value) for value in frame.column("sweep").unique() if value is not None}
            for name in self._sweeps:
                if name not in known:
                    raise UnknownNameError("sweep", name, known, argument="sweep")
            inside = where_equal(frame, "sweep", self._sweeps[0])
            for name in self._sweeps[1:]:
                inside |= where_equal(frame, "sweep", name)
            frame = frame.select(inside)
        self._snapshot = replace(
            snapshot,
            frame=frame,
            revision=REVISION,
            sweeps={},
            at_work=(),
            asked=frozenset(one for one in snapshot.asked if self._meant(one[1])),
        )

    def _meant(self, sweep: str) -> bool:
        return not self._sweeps or sweep in self._sweeps

    async def start(self, _: object) -> None:
        """Begin: all is there."""

    async def stop(self) -> None:
        """End: who gave the source ends it."""

    async def fresh(self) -> Snapshot:
        """Return the data."""
        return self._snapshot

    def ahead(self, uids: Sequence[str]) -> None:
        """Read some runs together, which are asked for next."""
        together = getattr(self._source, "records", None)
        self._ahead = {record.uid: record for record in together(uids)} if together else {}

    def record(self, uid: str) -> RunRecord | None:
        """Return a run by its UID."""
        return self._ahead.get(uid) or self._source.record(uid)

    def sweeps(self) -> list[SweepRecord]:
        """Return the sweeps that are meant."""
        return [one for one in self._source.sweeps() if self._meant(one.name)]

    def live_runs(self) -> int:
        """Return 0: what goes on is shown when it has ended."""
        return 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)


class _Within:
    """Workers' part, done here and now: nobody else waits."""

    async def compute(self, work: Callable[[], T], client: str = "", rows: int = 0) -> T:  # noqa: ARG002
        return work()

    async def stop(self) -> None:
        """End."""


class _AskedService(Service):
    """Service that keeps how each answer is made.

    Attributes:
        made: makes the last answer, and asks no database.
    """

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self.workers = cast("AnswerWorkers", _Within())
        self._totals = SweepTotals(self.workers)
        self.made: Callable[[], Body] | None = None

    def forget(self) -> None:
        """Forget the last answer, so that a refusal isn't taken for it."""
        self.made = None

    async def answer_with(
        self,
        request: Request,  # noqa: ARG002
        gather: Callable[[Snapshot], Awaitable[G]],
        compute: Callable[[Snapshot, G], Body],
        little: Callable[[Snapshot], bool] | None = None,  # noqa: ARG002
    ) -> Response:
        """Gather what an answer is made of, and keep how."""
        snapshot = await self.fresh()
        self.made = partial(compute, snapshot, await gather(snapshot))
        return Response(status_code=200)


@dataclass(frozen=True)
class RefusedQuestion:
    """Answer to a question that has none: its status, and what it says."""

    status: int
    said: dict[str, Any]


class QuestionAsker:
    """Asks the API of a source."""

    def __init__(self, source: PublishedRuns) -> None:
        self._service = _AskedService(cast("Source", source))
        self._app = application(self._service)

    async def ask(self, question: str) -> Callable[[], Body | RefusedQuestion]:
        """Return the work that answers an address of the API: path and query string of one for programs."""
        path, _, query = question.partition("?")
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": "GET",
            "scheme": "http",
            "path": unquote(path),
            "raw_path": path.encode(),
            "root_path": "",
            "query_string": query.encode(),
            "headers": [(b"host", b"localhost")],
            "client": None,
            "server": ("localhost", 80),
        }
        parts: list[bytes] = []
        status = 0

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Any) -> None:
            nonlocal status
            status = message.get("status", status)
            parts.append(message.get("body", b""))

        self._service.forget()
        await self._app(scope, receive, send)
        made = self._service.made
        if made is not None and status == 200:
            return partial(_answered, made)
        refused = RefusedQuestion(status, json.loads(b"".join(parts) or b"{}"))
        return lambda: refused


def _answered(make: Callable[[], Body]) -> Body | RefusedQuestion:
    """Return an answer, or what the API says in the place of one."""
    try:
        return make()
    except Exception as error:
        found = told(error)
        if found is None:
            raise
        return RefusedQuestion(*found)


def address(path: str, *pairs: tuple[str, str]) -> str:
    """Return an address of the API, escaped as the pages do it; pairs without a value are left out."""
    query = "&".join(f"{escaped(name)}={escaped(value)}" for name, value in pairs if value)
    return f"{path}?{query}" if query else path


def escaped(text: str) -> str:
    """Return a text as JavaScript's encodeURIComponent has it."""
    return quote(text, safe=_UNESCAPED)


def canonical(question: str) -> str:
    """Return an address with its pairs in one order: the key that the pages look an answer up by."""
    path, _, query = question.partition("?")
    pairs = sorted(pair for pair in query.split("&") if pair)
    return f"{path}?{'&'.join(pairs)}" if pairs else path
