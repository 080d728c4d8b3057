# SPDX-License-Identifier: Apache-2.0
"""Ways to a site from elsewhere: an Atom feed of its sweeps and ranks, and badges."""

from __future__ import annotations

import re
import uuid
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from urllib.parse import quote
from xml.sax.saxutils import escape, quoteattr

from slamhive.model.base import plural

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

MOST_ENTRIES = 100
_SPACE = uuid.UUID("5d0f3c39-2a7c-5c3b-9a44-5f6f2a1d9a10")
_CHARACTER = 6.6
_DATED = re.compile(r"<entry><title>(.*?)</title><id>(.*?)</id><updated>(.*?)</updated>", re.DOTALL)
_UNFIT = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Place:
    """Place of a competitor on a dataset, as a badge tells it.

    Attributes:
        competitor: what it is called.
        keys: columns that tell it, with their values.
        dataset: the dataset.
        rank: its rank among ``of`` competitors there; None where all its runs failed.
        of: competitors.
        median: of the error, m.
        spread: standard deviation of the error within its settings, m; None where each ran once.
        runs: that count.
        date: of its last run, as YYYY-MM-DD.
    """

    competitor: str
    keys: Mapping[str, Any]
    dataset: str
    rank: float | None
    of: int
    median: float | None
    spread: float | None
    runs: int
    date: str

    @property
    def said(self) -> str:
        """Rank, error and spread, and date, in words."""
        rank = "not ranked" if self.rank is None else f"#{self.rank:g} of {self.of}"
        error = "failed" if self.median is None else f"ATE {_metres(self.median)}"
        spread = "" if self.median is None or self.spread is None else f" ± {_metres(self.spread)}"
        date = f" · {self.date}" if self.date else ""
        return f"{rank} · {error}{spread}{'' if self.median is None else ' m'}{date}"

    @property
    def file(self) -> str:
        """Address of its badge below the site."""
        named = ".".join(_plain(str(value)) for value in self.keys.values() if value is not None)
        return f"badges/{_plain(self.dataset)}/{named}.svg"


def _metres(value: float) -> str:
    return f"{value:.3g}"


def _plain(name: str) -> str:
    """Return a name as a part of an address; what can't be in one is told apart by a hash."""
    plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60]
    return plain if plain and plain == name.lower() else f"{plain or 'x'}-{uuid.uuid5(_SPACE, name).hex[:6]}"


def places(
    board: Mapping[str, Any],
    dates: Mapping[tuple[str, ...], str],
    spreads: Mapping[tuple[str, ...], float],
) -> Iterator[Place]:
    """Go through the places of a leaderboard's competitors.

    Args:
        board: of /api/v1/analysis/leaderboard.
        dates: when the last run ended, by algorithm, sensors and dataset.
        spreads: of the error within settings, m, by the same.
    """
    for entry in board["entries"]:
        keys = entry["keys"]
        name = " ".join(str(value) for value in keys.values() if value is not None)
        for one in entry["datasets"]:
            ranked = [
                standing
                for other in board["entries"]
                for standing in other["datasets"]
                if standing["dataset"] == one["dataset"]
            ]
            key = (*(str(value) for value in keys.values()), str(one["dataset"]))
            yield Place(
                name,
                keys,
                str(one["dataset"]),
                one["rank"],
                len(ranked),
                one["median"],
                spreads.get(key),
                one["n"],
                dates.get(key, ""),
            )


def badge(place: Place) -> bytes:
    """Return an SVG of a place: no script, no font of its own, nothing from elsewhere."""
    left, right = _fit(f"{place.competitor} on {place.dataset}")[:80], _fit(place.said)
    first, second = (round(len(text) * _CHARACTER + 14) for text in (left, right))
    title = escape(f"{left}: {right}")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{first + second}" height="20" role="img" '
        f"aria-label={quoteattr(f'{left}: {right}')}><title>{title}</title>"
        f'<rect width="{first}" height="20" fill="#3a424c"/>'
        f'<rect x="{first}" width="{second}" height="20" fill="#00457c"/>'
        '<g fill="#fff" font-family="Verdana,Geneva,sans-serif" font-size="11" text-anchor="middle">'
        f'<text x="{first / 2}" y="14">{escape(left)}</text>'
        f'<text x="{first + second / 2}" y="14">{escape(right)}</text></g></svg>\n'
    ).encode()


@dataclass(frozen=True)
class _FeedEntry:
    """Entry of a feed."""

    known: str
    title: str
    when: str
    place: str
    text: str

    def name(self, space: str) -> str:
        """Return its identity on a site."""
        return f"urn:uuid:{uuid.uuid5(_SPACE, f'{space} {self.known}')}"

    def written(self, base: str, site: str) -> str:
        """Return it as XML."""
        return (
            f"<entry><title>{escape(_fit(self.title))}</title><id>{self.name(base or site)}</id>"
            f"<updated>{escape(self.when)}</updated>"
            f"<link href={quoteattr(f'{base}index.html{self.place}')}/>"
            f"<summary>{escape(_fit(self.text))}</summary></entry>"
        )


def feed(
    title: str,
    base: str,
    sweeps: Sequence[Mapping[str, Any]],
    ranks: Sequence[Place],
    *,
    now: str,
    before: bytes,
) -> tuple[bytes, str]:
    """Return an Atom feed (RFC 4287) of the sweeps and the ranks, the latest first, and when it changed last.

    Args:
        title: of the site.
        base: its address with a slash at its end; empty where it isn't known: links are relative then.
        sweeps: items of /api/v1/sweeps.
        ranks: of competitors.
        now: when it is made (RFC 3339): the date of what is new and has none of its own.
        before: the feed that was there: what says the same as in it keeps its date.
    """
    dates = {(known, told): when for told, known, when in _DATED.findall(before.decode(errors="replace"))}
    entries = [
        _FeedEntry(
            f"sweep {one['name']}",
            f"Sweep {one['name']}: {plural(one['runs'], 'run')}",
            one.get("finished") or "",
            f"#/sweeps/{_quoted(one['name'])}",
            " on ".join(", ".join(map(str, one.get(name) or ())) for name in ("algorithms", "datasets")),
        )
        for one in sweeps
    ]
    entries += [
        _FeedEntry(
            f"rank {one.file}",
            f"{one.competitor} on {one.dataset}: {one.said}",
            f"{one.date}T00:00:00+00:00" if one.date else "",
            f"#/leaderboard?dataset={_quoted(one.dataset)}",
            plural(one.runs, "run"),
        )
        for one in ranks
    ]
    kept = [dates.get((one.name(base or title), escape(_fit(one.title)))) for one in entries]
    entries = [replace(one, when=when or one.when or now) for one, when in zip(entries, kept, strict=True)]
    entries.sort(key=lambda one: one.when, reverse=True)
    updated = entries[0].when if entries else now
    whole = "".join(one.written(base, title) for one in entries[:MOST_ENTRIES])
    atom = (
        '<?xml version="1.0" encoding="utf-8"?>\n<feed xmlns="http://www.w3.org/2005/Atom">'
        f"<title>{escape(_fit(title))}</title>"
        f"<id>urn:uuid:{uuid.uuid5(_SPACE, base or title)}</id><updated>{escape(updated)}</updated>"
        f"<author><name>{escape(_fit(title))}</name></author><link href={quoteattr(base or './')}/>"
        f'<link rel="self" href={quoteattr(f"{base}feed.xml")}/>{whole}</feed>\n'
    )
    return atom.encode(), updated


def _fit(text: str) -> str:
    """Return a text without what XML can't hold."""
    return _UNFIT.sub("?", text)


def _quoted(name: str) -> str:
    return quote(name, safe="")
