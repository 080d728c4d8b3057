# SPDX-License-Identifier: Apache-2.0
"""Point clouds and meshes from files: PLY, PCD and numpy arrays."""

from __future__ import annotations

import io
import itertools
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval.errors import FileError, OptionError

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray, IndexArray

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4",
    "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LARGEST_HEADER = 100_000
_NO_CORNER = 1 << 52


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points, and triangles between them where the file is a mesh.

    Attributes:
        points: In m, shape (n, 3), all finite.
        triangles: Indices of their corners, shape (k, 3), k = 0 for a cloud.
        dropped: Points left out because a coordinate isn't finite.
    """

    points: FloatArray
    triangles: IndexArray
    dropped: int = 0


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[tuple[str, str, str], ...]
    """Name, type, and the type of the count for a list, otherwise empty."""


def read_cloud(path: str | Path) -> Cloud:
    """Read a ``.ply`` (cloud or mesh), ``.pcd`` (ascii or binary) or ``.npy`` (n, ≥ 3) file.

    Raises:
        FileError: The file can't be read, holds no points, or is cut off.
        OptionError: Another suffix.
    """
    readers = {".ply": _read_ply, ".pcd": _read_pcd, ".npy": _read_npy}
    reader = readers.get(Path(path).suffix.lower())
    if reader is None:
        raise OptionError(f"{path}: a map must be a file of {', '.join(readers)}")
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise FileError(path, f"can't be read: {error.strerror or error}") from error
    points, triangles = reader(path, data)
    finite = np.isfinite(points).all(axis=1)
    if len(triangles) and not finite.all():
        raise FileError(path, "the corners of a mesh must be finite numbers")
    if not finite.any():
        raise FileError(path, "holds no points")
    if len(triangles) and triangles.max() >= len(points):
        raise FileError(path, f"a face names a corner beyond the {len(points)} there are")
    return Cloud(points[finite], triangles, int(np.count_nonzero(~finite)))


def sample_mesh(mesh: Cloud, points: int, seed: int = 0) -> FloatArray:
    """Points spread evenly over the area of a mesh (Osada et al. 2002, eq. 1).

    Args:
        mesh: With triangles.
        points: How many, ≥ 1.
        seed: Of the random numbers.

    Returns:
        Shape (points, 3).

    Raises:
        OptionError: No triangle has an area, or fewer than one point.
    """
    if points < 1:
        raise OptionError(f"a mesh must be sampled at one point at least, not {points}")
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not areas.sum() > 0:
        raise OptionError("the mesh has no area to sample")
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(areas), points, p=areas / areas.sum())
    root, share = np.sqrt(rng.random((points, 1))), rng.random((points, 1))
    sampled: FloatArray = (
        (1.0 - root) * a[chosen] + root * (1.0 - share) * b[chosen] + root * share * c[chosen]
    )
    return sampled


def _read_npy(path: str | Path, data: bytes) -> tuple[FloatArray, IndexArray]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as error:  # the header is parsed as Python, which fails in many ways
        raise FileError(path, "is no array of numpy, or cut off") from error
    if (
        not isinstance(array, np.ndarray)
        or array.ndim != 2
        or array.shape[1] < 3
        or array.dtype.kind not in "fiu"
    ):
        raise FileError(path, "must hold an array of numbers of shape (n, 3) or wider")
    return _table([array[:, axis] for axis in range(3)]), np.empty((0, 3), dtype=np.intp)


def _header(path: str | Path, data: bytes, last: bytes, kind: str) -> tuple[list[str], int]:
    """Lines of the header and where the body begins."""
    at = 0
    lines: list[str] = []
    while at < min(len(data), _LARGEST_HEADER):
        end = data.find(b"\n", at)
        if end < 0:
            break
        line = data[at:end].strip()
        lines.append(line.decode("latin-1"))
        at = end + 1
        if line.startswith(last):
            return lines, at
    raise FileError(path, f"is no {kind} file, or cut off in its header (no {last.decode()})")


def _read_ply(path: str | Path, data: bytes) -> tuple[FloatArray, IndexArray]:
    lines, at = _header(path, data, b"end_header", "PLY")
    words = [line.split() for line in lines]
    order = next(
        (_PLY_ORDERS.get(line[1]) for line in words if line[:1] == ["format"] and len(line) > 1), None
    )
    if lines[0] != "ply" or order is None:
        raise FileError(path, "is no PLY file of the format ascii, binary_little_endian or binary_big_endian")
    elements = _ply_elements(path, words)
    points: FloatArray | None = None
    triangles: IndexArray = np.empty((0, 3), dtype=np.intp)
    rows = iter(data[at:].decode("latin-1").splitlines()) if order == "" else iter(())
    for element in elements:
        if element.count > len(data):
            raise FileError(path, f"is cut off within its {element.count} {element.name} entries")
        if order == "":
            table = [line.split() for line in itertools.islice(rows, element.count)]
            if len(table) < element.count:
                raise FileError(path, f"is cut off: {len(table)} of {element.count} {element.name} lines")
            found = _from_words(path, element, table)
        else:
            found, at = _from_bytes(path, element, data, at, order)
        if element.name == "vertex":
            if not {"x", "y", "z"} <= found.keys():
                raise FileError(path, "the vertices have no x, y and z")
            points = _table([found[name] for name in "xyz"])
        elif element.name == "face":
            triangles = np.asarray(found.get("triangles", triangles), dtype=np.intp)
    if points is None:
        raise FileError(path, "holds no vertices")
    return points, triangles


def _ply_elements(path: str | Path, words: list[list[str]]) -> list[_Element]:
    elements: list[_Element] = []
    try:
        for line in words:
            if line[:1] == ["element"]:
                elements.append(_Element(line[1], int(line[2]), ()))
            elif line[:1] == ["property"]:
                last = elements[-1]
                counts, kind, name = (
                    (line[2], line[3], line[4]) if line[1] == "list" else ("", line[1], line[2])
                )
                one = (name, _PLY_TYPES[kind], _PLY_TYPES[counts] if counts else "")
                elements[-1] = _Element(last.name, last.count, (*last.properties, one))
    except (IndexError, KeyError, ValueError) as error:
        raise FileError(path, "the header names an element or a property that PLY doesn't have") from error
    for element in elements:
        if element.count < 0 or (element.count and not element.properties):
            raise FileError(path, "the header names an element with a negative count or without properties")
        if len({name for name, _, _ in element.properties}) < len(element.properties):
            raise FileError(path, f"the header names a property of {element.name} twice")
    return elements


def _fan(polygons: list[list[int]]) -> FloatArray:
    """Triangles of polygons, shape (k, 3); a number that no corner can have becomes the largest one."""
    fans = ((one[0], one[k], one[k + 1]) for one in polygons for k in range(1, len(one) - 1))
    return np.array(
        [[corner if 0 <= corner < _NO_CORNER else _NO_CORNER for corner in fan] for fan in fans],
        dtype=np.float64,
    ).reshape(-1, 3)


def _from_words(path: str | Path, element: _Element, table: list[list[str]]) -> dict[str, FloatArray]:
    try:
        if not any(counts for _, _, counts in element.properties):
            numbers = np.array(table, dtype=np.float64).reshape(len(table), -1)
            return {name: numbers[:, k] for k, (name, _, _) in enumerate(element.properties)}
        if not element.properties[0][2]:
            return {}
        polygons = [[int(row[1 + k]) for k in range(int(row[0]))] for row in table]
    except (ValueError, IndexError) as error:
        raise FileError(path, f"a {element.name} line doesn't hold the numbers it should") from error
    return {"triangles": _fan(polygons)}


def _from_bytes(
    path: str | Path, element: _Element, data: bytes, at: int, order: str
) -> tuple[dict[str, FloatArray], int]:
    if not any(counts for _, _, counts in element.properties):
        kind = np.dtype([(name, order + what) for name, what, _ in element.properties])
        size = kind.itemsize * element.count
        if at + size > len(data):
            raise FileError(path, f"is cut off within its {element.count} {element.name} entries")
        table = np.frombuffer(data, kind, element.count, at)
        return {name: table[name] for name in kind.names or ()}, at + size
    found = _all_triangles(element, data, at, order)
    if found is not None:
        return found
    polygons: list[list[int]] = []
    try:
        for _ in range(element.count):
            for k, (_, what, counts) in enumerate(element.properties):
                count = 1
                if counts:
                    count = max(int(np.frombuffer(data, order + counts, 1, at)[0]), 0)
                    at += np.dtype(counts).itemsize
                values = np.frombuffer(data, order + what, count, at)
                at += values.nbytes
                if k == 0 and counts:
                    polygons.append(values.tolist())
    except ValueError as error:
        raise FileError(path, f"is cut off within its {element.count} {element.name} entries") from error
    return {"triangles": _fan(polygons)}, at


def _all_triangles(
    element: _Element, data: bytes, at: int, order: str
) -> tuple[dict[str, FloatArray], int] | None:
    """The faces of a mesh of triangles alone, all at once; None for any other."""
    (_, what, counts), *others = element.properties
    if not counts or any(one[2] for one in others) or what[0] == "f" or counts[0] == "f":
        return None
    fields = [("count", order + counts), ("corners", order + what, (3,))]
    kind = np.dtype([*fields, *((f"{k}", order + one[1]) for k, one in enumerate(others))])
    if at + kind.itemsize * element.count > len(data):
        return None
    table = np.frombuffer(data, kind, element.count, at)
    if (table["count"] != 3).any():
        return None
    corners = table["corners"].astype(np.float64)
    corners[corners < 0] = _NO_CORNER
    return {"triangles": corners}, at + kind.itemsize * element.count


def _read_pcd(path: str | Path, data: bytes) -> tuple[FloatArray, IndexArray]:
    lines, at = _header(path, data, b"DATA", "PCD")
    words = {line.split()[0]: line.split()[1:] for line in lines if line and line[0] != "#"}
    none: IndexArray = np.empty((0, 3), dtype=np.intp)
    try:
        names, count, storage = words["FIELDS"], int(words["POINTS"][0]), words["DATA"][0]
        counts = [int(word) for word in words.get("COUNT", ["1"] * len(names))]
        letters = {"F": "f", "I": "i", "U": "u"}
        fields: list[tuple[str, npt.DTypeLike, tuple[int, ...]]] = [
            (f"{k} {name}", np.dtype(f"<{letters[letter]}{int(size)}"), (each,))
            for k, (name, letter, size, each) in enumerate(
                zip(names, words["TYPE"], words["SIZE"], counts, strict=True)
            )
        ]
        kind = np.dtype(fields)
        columns = [names.index(name) for name in "xyz"]
        if count < 0 or min(counts) < 1:
            raise ValueError(count)  # noqa: TRY301 - a fault of the header like the others
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise FileError(path, "the PCD header lacks FIELDS with x, y and z, TYPE, SIZE or POINTS") from error
    if count > len(data):
        raise FileError(path, f"is cut off within its {count} points")
    if storage == "ascii":
        first = np.concatenate(([0], np.cumsum(counts)))[columns]
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                table = np.loadtxt(io.BytesIO(data[at:]), ndmin=2, max_rows=count or None)
            points = table[:, first]
        except (ValueError, IndexError) as error:
            raise FileError(path, "a line doesn't hold the numbers it should") from error
        if len(points) < count:
            raise FileError(path, f"is cut off: {len(points)} of {count} points")
        return points, none
    if storage != "binary":
        raise FileError(path, f"is stored as {storage}; convert it to binary or ascii")
    if at + kind.itemsize * count > len(data):
        raise FileError(path, f"is cut off within its {count} points")
    rows = np.frombuffer(data, kind, count, at)
    found = [rows[(kind.names or ())[k]][:, 0] for k in columns]
    return _table(found), none


def _table(columns: list[FloatArray]) -> FloatArray:
    with np.errstate(invalid="ignore"):  # casting a signalling NaN, which is dropped afterwards, warns
        return np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
