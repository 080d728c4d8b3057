# SPDX-License-Identifier: Apache-2.0
"""Page of a dataset: its overview as one HTML file that needs nothing but itself.

`slamhive dataset show --html` writes it. It has no script; charts are SVG in the style of the report.
"""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import groupby
from typing import TYPE_CHECKING, Any

from slamhive import __version__
from slamhive.reporting.markup import Markup, clip, element, joined
from slamhive.reporting.page import document
from slamhive.reporting.scales import nice_ticks

if TYPE_CHECKING:
    from collections.abc import Sequence

_WIDTH, _LEFT, _RIGHT, _BOTTOM = 900.0, 110.0, 14.0, 26.0
_ROW = 22.0
_TIME = ("#440154", "#3b528b", "#21918c", "#5ec962", "#d8b000")
"""Colours of a path from its begin to its end."""


def dataset_page(overview: dict[str, Any], description: str) -> str:
    """Make the page.

    Args:
        overview: what is drawn, as `slamhive.data.inspecting.overview.overview` returns it.
        description: what the dataset is.
    """
    name = str(overview["name"])
    counts = (
        f"{overview['seconds']:.1f} s from {overview['start']:.3f} s · {len(overview['sensors'])} sensors · "
        f"{datetime.now(UTC):%Y-%m-%d} · slamhive {__version__}"
    )
    header = element(
        "header",
        element("h1", clip(name, 300)),
        element("p", clip(description, 1000)) if description else None,
        element("p", counts, class_="quiet"),
    )
    sections = [
        ("What covers which time", coverage_chart(overview)),
        ("Path of the ground truth", _paths(overview)),
        *_pictures(overview),
        ("Messages over time", joined(_rates(overview))),
        *(("IMU over time", part) for part in _imus(overview)),
    ]
    notes = [element("li", clip(one, 600)) for one in overview["notes"]]
    body = [element("section", element("h2", title), content) for title, content in sections if content]
    if notes:
        body.append(element("section", element("h2", "Notes"), element("ul", *notes, class_="notes")))
    return document(name, joined([header, element("main", *body)]))


def coverage_chart(overview: dict[str, Any]) -> Markup:
    """Return a bar for each sensor and the ground truth, with gaps left out of it."""
    rows: list[tuple[str, float, float, Sequence[Sequence[float]]]] = [
        (one["name"], one["first"], one["last"], one["gaps"])
        for one in overview["sensors"]
        if one["first"] is not None
    ]
    truth = overview["truth"]
    if truth is not None:
        rows.append(("ground truth", truth["first"], truth["last"], ()))
    if not rows:
        return Markup("")
    low, high = min(row[1] for row in rows), max(row[2] for row in rows)
    axis = _PlotScale(low, high, _LEFT, _WIDTH - _RIGHT)
    height = len(rows) * _ROW + _BOTTOM
    parts = [*_time_axis(axis, height)]
    for number, (name, first, last, gaps) in enumerate(rows):
        top = number * _ROW + 4
        parts.append(_text(_LEFT - 8, top + 11, clip(name, 16), anchor="end"))
        parts.append(_bar(axis, first, last, top, f"c{number % 6}"))
        parts += [_hole(axis, begin, end, top) for begin, end in gaps]
    return _svg(parts, height, "Time that each sensor and the ground truth cover, gaps white")


def _paths(overview: dict[str, Any]) -> Markup | None:
    truth = overview["truth"]
    if truth is None:
        return None
    planes = [_plane(truth, "x", "y"), _plane(truth, "x", "z")]
    words = "The circle is the start; colours go from dark to light with time. Equal scales, m."
    return joined([element("p", words, class_="quiet"), element("div", *planes, class_="grid")])


def _plane(truth: dict[str, Any], across: str, up: str) -> Markup:
    xs, ys = truth[across], truth[up]
    side, edge = 420.0, 46.0
    reach = max(max(xs) - min(xs), max(ys) - min(ys), 1e-3)
    scale = (side - 2 * edge) / reach
    middle = [(max(values) + min(values)) / 2 for values in (xs, ys)]
    places = [
        (side / 2 + (x - middle[0]) * scale, side / 2 - (y - middle[1]) * scale)
        for x, y in zip(xs, ys, strict=True)
    ]
    parts: list[Markup] = []
    size = max(1, -(-len(places) // len(_TIME)))
    for number, ink in enumerate(_TIME):
        piece = places[number * size : (number + 1) * size + 1]
        if len(piece) > 1:
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in piece)
            parts.append(element("polyline", points=points, fill="none", stroke=ink, stroke_width="1.8"))
    parts.append(
        element(
            "circle",
            cx=f"{places[0][0]:.1f}",
            cy=f"{places[0][1]:.1f}",
            r="5",
            fill="none",
            stroke=_TIME[0],
            stroke_width="2",
        )
    )
    for value, x, y, anchor in (
        (min(xs), edge, side - 24, "start"),
        (max(xs), side - edge, side - 24, "end"),
    ):
        parts.append(_text(x, y, f"{value:.4g}", anchor=anchor))
    parts.append(_text(side / 2, side - 8, f"{across} [m]", anchor="middle"))
    parts.append(_text(6, 14, f"{up} [m]: {min(ys):.4g} to {max(ys):.4g}"))
    return element("figure", _svg(parts, side, f"Path of the ground truth, {across} and {up}", side))


def _pictures(overview: dict[str, Any]) -> list[tuple[str, Markup]]:
    found = []
    for sensor in overview["sensors"]:
        if sensor["pictures"]:
            shots = [
                element(
                    "figure",
                    element(
                        "img",
                        src=f"data:image/jpeg;base64,{one['data']}",
                        alt=f"{sensor['name']} at {one['t']:.2f} s",
                        width="100%",
                    ),
                    element("figcaption", f"{one['t']:.2f} s", class_="quiet"),
                )
                for one in sensor["pictures"]
            ]
            found.append((f"Images of {sensor['name']}", element("div", *shots, class_="sheet")))
        if sensor["clouds"]:
            views = [element("figure", _cloud(one, sensor["name"])) for one in sensor["clouds"]]
            found.append((f"{sensor['name']} from above", element("div", *views, class_="sheet")))
    return found


def _cloud(cloud: dict[str, Any], name: str) -> Markup:
    side = 300.0
    distances = sorted(max(abs(x), abs(y)) for x, y in zip(cloud["x"], cloud["y"], strict=True))
    reach = max(distances[int(0.98 * (len(distances) - 1))], 0.1) if distances else 1.0
    scale = side / 2 / reach
    dots = "".join(
        f"M{side / 2 + x * scale:.1f} {side / 2 - y * scale:.1f}h1"
        for x, y in zip(cloud["x"], cloud["y"], strict=True)
        if abs(x) <= reach and abs(y) <= reach
    )
    parts = [
        element("path", d=dots, fill="none", stroke="currentColor", stroke_width="1.2"),
        element("circle", cx=side / 2, cy=side / 2, r="4", class_="c1"),
        _text(4, side - 6, f"{cloud['t']:.2f} s, ±{reach:.3g} m"),
    ]
    return _svg(parts, side, f"Points of {name} from above at {cloud['t']:.2f} s", side)


def _rates(overview: dict[str, Any]) -> list[Markup]:
    charts = []
    for number, sensor in enumerate(overview["sensors"]):
        if not sensor["rates"]:
            continue
        title = f"{sensor['name']} ({sensor['topic']}): {sensor['messages']} messages"
        gaps = len(sensor["gaps"])
        if gaps:
            longest = max(end - begin for begin, end in sensor["gaps"])
            count = "1 gap of" if gaps == 1 else f"{gaps}{'' if gaps < 50 else ' or more'} gaps, the longest"
            title += f", {count} {longest:.3g} s"
        lines = [(f"c{number % 6}", sensor["rates"])]
        charts.append(_over_time(overview, lines, title, "Hz", gaps=sensor["gaps"]))
    return charts


def _imus(overview: dict[str, Any]) -> list[Markup]:
    charts = []
    for sensor in overview["sensors"]:
        for what, unit in (("gyro", "rad/s"), ("accel", "m/s²")):
            if what in sensor["imu"]:
                bands = [
                    (f"c{number}", low, high)
                    for number, (low, high) in enumerate(sensor["imu"][what].values())
                ]
                title = f"{sensor['name']}, {what} x, y, z: least and greatest"
                charts.append(_over_time(overview, [], title, unit, bands=bands))
    return [joined(charts)] if charts else []


def _over_time(
    overview: dict[str, Any],
    lines: Sequence[tuple[str, Sequence[float]]],
    title: str,
    unit: str,
    *,
    bands: Sequence[tuple[str, Sequence[float | None], Sequence[float | None]]] = (),
    gaps: Sequence[Sequence[float]] = (),
) -> Markup:
    height = 140.0
    seconds = max(overview["seconds"], 1e-9)
    axis = _PlotScale(0.0, seconds, _LEFT, _WIDTH - _RIGHT)
    every = [value for _, values in lines for value in values]
    every += [value for _, *ends in bands for values in ends for value in values if value is not None]
    low, high = (min(0.0, *every), max(every)) if lines else (min(every), max(every))
    up = _PlotScale(low, high if high > low else low + 1, height - _BOTTOM, 18)
    parts = [*_time_axis(axis, height)]
    parts += [_text(_LEFT - 8, up(value) + 4, f"{value:.3g}", anchor="end") for value in (low, high)]
    parts.append(_text(8, height / 2, unit))
    for begin, end in gaps:
        width = max(axis(end) - axis(begin), 1.0)
        parts.append(
            element(
                "rect",
                x=f"{axis(begin):.1f}",
                y="8",
                width=f"{width:.1f}",
                height=f"{height - _BOTTOM - 8:.1f}",
                class_="c1",
                opacity="0.25",
            )
        )
    for ink, values in lines:
        step = seconds / len(values)
        points = " ".join(f"{axis((k + 0.5) * step):.1f},{up(value):.1f}" for k, value in enumerate(values))
        parts.append(element("polyline", points=points, class_=f"{ink} curve"))
    for ink, lows, highs in bands:
        for points in _bands(axis, up, lows, highs, seconds):
            parts.append(element("polygon", points=points, class_=ink, opacity="0.55"))
    return joined([element("p", title, class_="caption"), _svg(parts, height, title)])


def _bands(
    axis: _PlotScale,
    up: _PlotScale,
    lows: Sequence[float | None],
    highs: Sequence[float | None],
    seconds: float,
) -> list[str]:
    """Return outlines of the parts of a band between its holes."""
    step = seconds / len(lows)
    found = []
    for known, members in groupby(range(len(lows)), key=lambda k: lows[k] is not None):
        if known:
            places = list(members)
            above = [f"{axis((k + 0.5) * step):.1f},{up(highs[k] or 0.0) - 0.5:.1f}" for k in places]
            below = [f"{axis((k + 0.5) * step):.1f},{up(lows[k] or 0.0) + 0.5:.1f}" for k in places]
            found.append(" ".join([*above, *reversed(below)]))
    return found


class _PlotScale:
    """Numbers to places."""

    def __init__(self, low: float, high: float, begin: float, end: float) -> None:
        self.low, self.high = low, high if high > low else low + 1.0
        self.begin, self.end = begin, end

    def __call__(self, value: float) -> float:
        return self.begin + (value - self.low) / (self.high - self.low) * (self.end - self.begin)


def _time_axis(axis: _PlotScale, height: float) -> list[Markup]:
    parts = []
    for value in nice_ticks(axis.low, axis.high, 8):
        x = f"{axis(value):.1f}"
        parts.append(element("line", x1=x, x2=x, y1="0", y2=height - _BOTTOM, class_="grid-line"))
        parts.append(_text(axis(value), height - 10, f"{value:g} s", anchor="middle"))
    return parts


def _bar(axis: _PlotScale, first: float, last: float, top: float, ink: str) -> Markup:
    width = max(axis(last) - axis(first), 2.0)
    return element(
        "rect",
        element("title", f"{first:.2f} s to {last:.2f} s"),
        x=f"{axis(first):.1f}",
        y=top,
        width=f"{width:.1f}",
        height="14",
        class_=ink,
    )


def _hole(axis: _PlotScale, begin: float, end: float, top: float) -> Markup:
    width = max(axis(end) - axis(begin), 0.8)
    return element(
        "rect",
        element("title", f"gap of {end - begin:.3g} s at {begin:.2f} s"),
        x=f"{axis(begin):.1f}",
        y=top - 1,
        width=f"{width:.1f}",
        height="16",
        class_="hole",
    )


def _text(x: float, y: float, text: str, *, anchor: str = "start") -> Markup:
    return element("text", text, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, class_="small")


def _svg(parts: Sequence[Markup], height: float, title: str, width: float = _WIDTH) -> Markup:
    return element(
        "svg", *parts, viewBox=f"0 0 {width:g} {height:g}", role="img", aria_label=clip(title, 300)
    )
