# SPDX-License-Identifier: Apache-2.0
"""Import of scenes of Replica as rendered for NICE-SLAM: results/frame*.jpg, results/depth*.png, traj.txt."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from slamhive.data.importers.contents import Contents, ImportedTruth, depth_pixels
from slamhive.data.importers.frames import frame_stamps, require_frames, view_stream
from slamhive.data.importers.poses import from_rows
from slamhive.data.importers.tables import read_table
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.importers import ImportOptions

TITLE = "a scene of Replica (results/frame*.jpg, traj.txt)"

RATE = 30.0
"""Hz, assumed: the files have no stamps."""
LENS = {"width": 1200, "height": 680, "fx": 600.0, "fy": 600.0, "cx": 599.5, "cy": 339.5}
DEPTH_SCALE = 6553.5
"""Units of a depth image per metre."""
_KEYS = {"w": "width", "h": "height", "fx": "fx", "fy": "fy", "cx": "cx", "cy": "cy"}


def recognises(source: Path) -> bool:
    """Tell whether something has results/ with frames, or traj.txt beside results/."""
    results = source / "results"
    return results.is_dir() and ((source / "traj.txt").is_file() or any(results.glob("frame*.jpg")))


def read(source: Path, options: ImportOptions) -> Contents:  # noqa: ARG001
    """Read a scene; the body is the camera (right, down, forward), whose poses traj.txt has.

    Raises:
        DataError: Something is missing or damaged.
    """
    colors, depths = sorted(source.glob("results/frame*.jpg")), sorted(source.glob("results/depth*.png"))
    if not colors:
        raise DataError(f"{source / 'results'}: no images frame*.jpg in it")
    path = source / "traj.txt"
    rows = read_table(path, 16, "16 numbers, a 4×4 matrix row by row").values
    series = {f"{source / 'results'}, frame*.jpg": colors}
    if depths:
        series[f"{source / 'results'}, depth*.png"] = depths
    require_frames(series, len(rows), path)
    notes: list[str] = []
    lens, scale, stated = _lens(source, notes)
    stamps = frame_stamps(len(colors), RATE, notes)
    name = "color" if depths else "camera"
    streams = [view_stream(name, stamps, colors, lens, frame="color", source=stated)]
    if depths:
        depth = (scale, depth_pixels)
        streams.append(view_stream("depth", stamps, depths, lens, frame="depth", source=stated, depth=depth))
    return Contents(
        description="Imported from a scene of Replica.",
        streams=streams,
        truth=ImportedTruth(GroundTruth(file="groundtruth.txt"), from_rows(path, stamps, rows[:, :12])),
        body="color",
        notes=notes,
    )


def _lens(source: Path, notes: list[str]) -> tuple[dict[str, Any], float, str]:
    """Return the lens, the scale of depth and what states them."""
    places = (source / "cam_params.json", source.resolve().parent / "cam_params.json")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        notes.append(
            "no cam_params.json: NICE-SLAM's camera is assumed (1200×680, f 600, c 599.5, 339.5, "
            "depth / 6553.5)"
        )
        return LENS, DEPTH_SCALE, "NICE-SLAM's camera"
    try:
        known = json.loads(path.read_text(encoding="utf-8"))["camera"]
        lens = {ours: known[theirs] for theirs, ours in _KEYS.items()}
        return lens, float(known["scale"]), str(path)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path}: no camera with {', '.join(_KEYS)} and scale in it ({type(error).__name__}: {error})"
        ) from None
