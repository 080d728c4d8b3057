# SPDX-License-Identifier: Apache-2.0
"""Building of a site: all answers asked of the dashboard's own API, then the files that lead to them."""

from __future__ import annotations

import hashlib
import json
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np

from slamhive import __version__
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.repeating import repeatability, spread_within
from slamhive.dashboard.answering.encoding import encode_csv, encode_json
from slamhive.dashboard.answers.catalog import sweep_names
from slamhive.dashboard.publishing import questions, table
from slamhive.dashboard.publishing.asking import (
    PublishedRuns,
    QuestionAsker,
    RefusedQuestion,
    address,
    canonical,
)
from slamhive.dashboard.publishing.feed import badge, feed, places
from slamhive.dashboard.publishing.folder import FORMAT, KIND, MARK, SiteFolder
from slamhive.dashboard.publishing.runpages import RunPages
from slamhive.dashboard.publishing.sharing import shared
from slamhive.dashboard.publishing.state import state_of
from slamhive.dashboard.server.security import CONTENT_POLICY
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from importlib.resources.abc import Traversable
    from pathlib import Path

    from slamhive.analysis.frame import Frame
    from slamhive.dashboard.answering.encoding import Body
    from slamhive.dashboard.publishing.feed import Place
    from slamhive.dashboard.publishing.state import MarkedSource, SiteState
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.dashboard.sources.looks import Looks

TITLE = "SLAM Hive"
MOST_TITLE = 200
MOST_BYTES = 2_000_000
"""Bytes of an answer, unpacked: a longer one is no page's, and would be most of the site."""

MOST_TABLE = 50_000
"""The same of an answer whose table is kept beside it: of longer ones a browser lays the answer out flat."""

TOO_MUCH = 501
_TOO_MUCH = (
    "This site leaves out what has too many groups: choose columns to group by here. Where the runs are, "
    "slamhive dashboard shows them."
)
_RANKS = address(
    f"{questions.ANALYSIS}/leaderboard",
    *(("metric", questions.ERROR), ("by", questions.COMPETITORS[0]), ("outcomes", "tracked")),
)
_ROOT = re.compile(r'(href|src)="/(?!/)')
_NO_SCRIPT = (
    '<noscript>These pages need JavaScript. What is new here: <a href="feed.xml">feed.xml</a>.</noscript>'
)


@dataclass(frozen=True)
class BuiltSite:
    """Outcome of building a site.

    Attributes:
        runs: that it shows.
        answers: questions that it answers.
        added: files that were added or changed.
        bytes: of those.
        files: in the folder by now.
        size: bytes of those.
        badges: places of competitors that have badges.
        same: whether nothing it is made from differs from what it showed, so that nothing was done.
    """

    runs: int
    answers: int
    added: int
    bytes: int
    files: int
    size: int
    badges: Sequence[Place] = ()
    same: bool = False


@dataclass(frozen=True)
class SiteWish:
    """Wish for a site: its runs, its title, its address.

    Attributes:
        sweeps: whose runs it shows; empty for all.
        title: what its pages are called.
        base_url: the address that it will have; empty where nobody knows yet.
    """

    sweeps: Sequence[str] = ()
    title: str = TITLE
    base_url: str = ""

    def __post_init__(self) -> None:
        if not self.title.strip() or len(self.title) > MOST_TITLE or not self.title.isprintable():
            raise InputError(f"expected 1 to {MOST_TITLE} characters that can be printed", "title")
        if self.base_url:
            parts = urlsplit(self.base_url)
            if parts.scheme not in {"http", "https"} or not parts.netloc or parts.query or parts.fragment:
                raise InputError(
                    f"expected an address such as https://lab.example/slam/, found {self.base_url[:200]!r}",
                    "base-url",
                )

    @property
    def base(self) -> str:
        """The address with a slash at its end, or nothing."""
        return f"{self.base_url.rstrip('/')}/" if self.base_url else ""


async def build(
    path: Path, source: MarkedSource, wish: SiteWish, tell: Callable[[str], None] = lambda _: None
) -> BuiltSite:
    """Write a site, or bring one up to date.

    Args:
        path: its folder.
        source: where the runs are.
        wish: what it is to be.
        tell: called with what is being done.

    Raises:
        InputError: the folder holds something else, or there is nothing to show.
    """
    folder = SiteFolder(path)
    looks = source.looks()
    with ThreadPoolExecutor(1, thread_name_prefix="look") as executor:
        await source.start(executor)
        try:
            published = PublishedRuns(source, await source.fresh(), wish.sweeps)
            return await _Building(folder, published, await published.fresh(), wish, tell).built(looks)
        finally:
            await source.stop()


@dataclass(frozen=True)
class _KeptAnswer:
    """Answer as it was kept, or why there is none; and files and bytes that were written for it."""

    file: str = ""
    table: str | None = None
    refused: dict[str, Any] | None = None
    written: tuple[int, int] = (0, 0)


class _Building:
    def __init__(
        self,
        folder: SiteFolder,
        source: PublishedRuns,
        snapshot: Snapshot,
        wish: SiteWish,
        tell: Callable[[str], None],
    ) -> None:
        self._folder = folder
        self._source = source
        self._snapshot = snapshot
        self._wish = wish
        self._tell = tell
        self._asker = QuestionAsker(source)
        self._answers: dict[str, Any] = {}
        self._asked: dict[str, Callable[[], _KeptAnswer]] = {}
        self._files: dict[str, str] = {}
        self._tables: dict[str, str] = {}
        self._refused: dict[str, Any] = {}
        self._conditions: list[str] = []

    async def built(self, looks: Looks) -> BuiltSite:
        frame = self._snapshot.frame
        if not len(frame):
            raise InputError("there are no finished runs to show: slamhive run SWEEP.yaml makes some")
        code = PagesCode.read()
        wish = [FORMAT, code.folder, self._wish.title, self._wish.base, *self._wish.sweeps]
        state = state_of(self._source, self._snapshot, looks, wish)
        before = self._folder.before
        kept = self._folder.kept()
        if before.get("state") == state.whole and before.get("kept") == kept:
            return BuiltSite(len(state.runs), before["answers"], 0, 0, *self._folder.size(), same=True)
        shown = self._folder.read(before["index"]) if before else None
        self._folder.begin()
        self._tell("questions")
        await self._ask_all()
        index: dict[str, Any] = {
            "answers": self._files,
            "csv": self._tables,
            "refused": self._refused,
            "measures": self._measures,
        }

        def own() -> None:
            self._tell("table")
            index["table"] = table.written(self._folder, frame, self._conditions)
            self._tell("runs")
            pages = RunPages(self._folder, self._source, self._snapshot, state.runs, state.alike)
            lost = kept[:1] < before.get("kept", [])[:1]
            directory = pages.written(self._folder.read(shown["runs"]) if shown else None, lost=lost)
            index["runs"] = self._folder.keep(directory)
            self._tell("answers")

        self._answer_all(own)
        ranks = list(self._ranks(frame))
        self._lead_to(self._folder.keep(index), ranks, code, state)
        added, added_bytes = self._folder.written
        return BuiltSite(
            len(state.runs), len(self._files), added, added_bytes, *self._folder.size(), badges=ranks
        )

    async def _ask_all(self) -> None:
        """Ask all questions; what is known by now are the answers that others follow from."""
        columns = questions.AskedColumns(await self._known(f"{questions.API}/columns"))
        await self._known(f"{questions.API}/sweeps")
        for question in questions.told_apart(await self._known(_RANKS)):
            await self._ask(question)
        sweeps = sorted(sweep_names(self._snapshot.frame))
        named = {
            "sweeps": [name for _, name in sweeps],
            "algorithms": columns.names("algorithm"),
            "datasets": columns.names("dataset"),
        }
        for question in questions.general(named):
            await self._ask(question)
        for view in questions.views(columns, list(dict.fromkeys(named["sweeps"]))):
            asked = columns
            if view:
                question = address(f"{questions.API}/columns", *view)
                asked = questions.AskedColumns(await self._known(question))
            for question in questions.of_view(view, asked):
                await self._ask(question)
        for question in questions.of_all(columns):
            await self._ask(question)
        self._conditions, self._measures = questions.conditions(columns), columns.measures

    async def _ask(self, question: str) -> None:
        """Ask; the answer is made later, wherever there is time for it."""
        key = canonical(question)
        if key not in self._asked:
            self._asked[key] = partial(self._kept, await self._asker.ask(question))

    async def _known(self, question: str) -> Any:
        """Return an answer, made now; None where it is refused."""
        found = (await self._asker.ask(question))()
        key = canonical(question)
        self._answers[key] = None if isinstance(found, RefusedQuestion) else found.content
        self._asked.setdefault(key, partial(self._kept, lambda: found))
        return self._answers[key]

    def _kept(self, make: Callable[[], Body | RefusedQuestion]) -> _KeptAnswer:
        """Make an answer, keep it and its table; a refusal is kept as one."""
        before, found = tuple(self._folder.written), make()
        if isinstance(found, RefusedQuestion):
            return _KeptAnswer(refused={"status": found.status, **found.said})
        content = encode_json(found.content)
        if len(content) > MOST_BYTES:
            return _KeptAnswer(refused={"status": TOO_MUCH, "error": _TOO_MUCH, "field": None})
        file, table_file = self._folder.keep_text(content), None
        if found.columns is not None and len(content) <= MOST_TABLE:
            table_file = self._folder.keep_text(encode_csv(found.columns()))
        files, size = self._folder.written
        return _KeptAnswer(file, table_file, None, (files - before[0], size - before[1]))

    def _answer_all(self, meanwhile: Callable[[], None]) -> None:
        """Make all answers that were asked for, while this process does something else first."""
        answers, beside = shared(list(self._asked.values()), meanwhile)
        for at in beside:
            self._folder.count(*answers[at].written)
        for key, answer in zip(self._asked, answers, strict=True):
            if answer.refused is not None:
                self._refused[key] = answer.refused
            else:
                self._files[key] = answer.file
            if answer.table is not None:
                self._tables[key] = answer.table

    def _ranks(self, frame: Frame) -> Iterator[Place]:
        """Go through the places on all boards; of a badge's several ones that of most competitors counts."""
        names = ("algorithm", "sensors", "dataset")
        finished = frame.column("finished").floats()
        dates: dict[tuple[str, ...], float] = {}
        for *key, at in zip(*(frame.column(name).tolist() for name in names), finished, strict=True):
            told = tuple(map(str, key))
            dates[told] = np.fmax(dates.get(told, np.nan), at)
        days = {key: _moment(at)[:10] for key, at in dates.items() if at == at}  # noqa: PLR0124
        found = self._answers[canonical(_RANKS)]
        seen: set[str] = set()
        for board in sorted((found or {}).get("boards") or [], key=lambda one: -len(one["entries"])):
            of_board = np.ones(len(frame), dtype=bool)
            for name, value in board["facets"].items():
                of_board &= where_equal(frame, name, value)
            repetitions, _ = repeatability(frame.select(of_board), questions.ERROR)
            for place in places(board, days, spread_within(repetitions, names)):
                if place.file not in seen:
                    seen.add(place.file)
                    yield place

    def _lead_to(self, index: str, ranks: Sequence[Place], code: PagesCode, state: SiteState) -> None:
        """Write what leads to the answers: the feed and the badges, then the pages, the mark last."""
        sweeps = (self._answers[f"{questions.API}/sweeps"] or {}).get("items") or []
        now, before = datetime.now(UTC).isoformat(timespec="seconds"), self._folder.bytes_of("feed.xml")
        atom, updated = feed(self._wish.title, self._wish.base, sweeps, ranks, now=now, before=before)
        self._folder.replace("feed.xml", atom)
        for place in ranks:
            self._folder.replace(place.file, badge(place))
        for name, content in code.files.items():
            self._folder.keep_file(f"{code.folder}/{name}", content)
        self._folder.replace("index.html", _index_html(code.home, code.folder, self._wish).encode())
        mark = {
            "kind": KIND,
            "format": FORMAT,
            "slamhive": __version__,
            "title": self._wish.title,
            "updated": updated,
            "index": index,
            "answers": len(self._files),
            "state": state.whole,
            "kept": self._folder.kept(),
        }
        self._folder.replace(MARK, json.dumps(mark, indent=1).encode() + b"\n")


@dataclass(frozen=True)
class PagesCode:
    """Code of the pages, which a site keeps in a folder called by its content.

    Attributes:
        folder: its address.
        files: by their names in it.
        home: the page that begins, as the dashboard has it.
    """

    folder: str
    files: Mapping[str, bytes]
    home: str

    @classmethod
    def read(cls) -> PagesCode:
        """Return the dashboard's own, fit for any address."""
        # A site may lie below any address: what the pages name from the root is named from beside them.
        static = files("slamhive.dashboard").joinpath("static")
        found = {
            name: content.replace(b"'/vendor/", b"'../vendor/") if name.startswith("core/") else content
            for name, content in _files_below(static)
        }
        home = found.pop("index.html")
        digest = hashlib.sha256(
            b"\0".join(name.encode() + content for name, content in sorted(found.items()))
        )
        return cls(f"pages/{digest.hexdigest()[:12]}", found, home.decode())


def _files_below(folder: Traversable, prefix: str = "") -> Iterator[tuple[str, bytes]]:
    for place in sorted(folder.iterdir(), key=lambda one: one.name):
        name = f"{prefix}{place.name}"
        if place.is_dir():
            yield from _files_below(place, f"{name}/")
        else:
            yield name, place.read_bytes()


def _index_html(home: str, pages: str, wish: SiteWish) -> str:
    """Return the page that a site begins with, of the dashboard's own.

    Args:
        home: of the dashboard.
        pages: folder of the pages' code.
        wish: what the site is to be.
    """
    policy = f'<meta http-equiv="Content-Security-Policy" content="{CONTENT_POLICY.strip()}">'
    kind = '<meta name="slamhive-site" content="1">\n<meta name="referrer" content="no-referrer">'
    address = f'<link rel="canonical" href="{escape(wish.base)}">\n' if wish.base else ""
    atom = f'<link rel="alternate" type="application/atom+xml" href="feed.xml" title="{escape(wish.title)}">'
    head = f"\n{policy}\n{kind}\n{address}{atom}"
    text = _ROOT.sub(rf'\1="{pages}/', home)
    text = text.replace('<meta charset="utf-8">', f'<meta charset="utf-8">{head}', 1)
    text = re.sub(r"<title>.*?</title>", lambda _: f"<title>{escape(wish.title)}</title>", text, count=1)
    return re.sub(r"<noscript>.*?</noscript>", lambda _: _NO_SCRIPT, text, count=1, flags=re.DOTALL)


def _moment(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
