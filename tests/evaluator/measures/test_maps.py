# SPDX-License-Identifier: Apache-2.0
"""Clouds and meshes from files; maps against references."""

from __future__ import annotations

import contextlib
import json
import struct
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import FileError, OptionError, Trajectory, write_tum
from slamhive_eval.command import main
from slamhive_eval.formats.clouds import Cloud, read_cloud, sample_mesh
from slamhive_eval.measures.maps import compare_maps, mean_map_entropy, thin_out

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

POINTS = np.array(((0.5, 1, 2), (3, 4, 5), (-6, 7, 8.25), (9, 10, 11)))
PLY = """ply
format {form} 1.0
comment made by hand
element vertex 4
property uchar red
property float x
property float y
property double z
{faces}end_header
"""
FACES = "element face 2\nproperty list uchar int vertex_indices\nproperty uchar flag\n"
PCD = """# .PCD v0.7
VERSION 0.7
FIELDS rgb x y z normal
SIZE 4 4 4 8 4
TYPE U F F F F
COUNT 1 1 1 1 3
WIDTH 4
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 4
DATA {form}
"""


def ply(form: str, faces: bool) -> bytes:
    head = PLY.format(form=form, faces=FACES if faces else "").encode()
    polygons = ((0, 1, 2), (0, 1, 2, 3))
    if form == "ascii":
        text = "".join(f"7 {x} {y} {z}\n" for x, y, z in POINTS)
        text += "".join(f"{len(one)} {' '.join(map(str, one))} 1\n" for one in polygons) if faces else ""
        return head + text.encode()
    sign = "<" if "little" in form else ">"
    body = b"".join(struct.pack(f"{sign}Bffd", 7, *point) for point in POINTS)
    if faces:
        body += b"".join(struct.pack(f"{sign}B{len(one)}iB", len(one), *one, 1) for one in polygons)
    return head + body


def pcd(form: str) -> bytes:
    head = PCD.format(form=form).encode()
    if form == "ascii":
        return head + "".join(f"1 {x} {y} {z} 0 0 1\n" for x, y, z in POINTS).encode()
    return head + b"".join(struct.pack("<Iffdfff", 1, *point, 0, 0, 1) for point in POINTS)


@pytest.mark.parametrize("faces", [False, True])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply(tmp_path: Path, form: str, faces: bool) -> None:
    file = tmp_path / "map.ply"
    file.write_bytes(ply(form, faces))
    found = read_cloud(file)
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.triangles.tolist() == ([[0, 1, 2], [0, 1, 2], [0, 2, 3]] if faces else [])
    for cut in range(len(ply(form, faces)) - 5):
        file.write_bytes(ply(form, faces)[:cut])
        with pytest.raises(FileError):
            read_cloud(file)


@pytest.mark.parametrize("sign", "<>")
@pytest.mark.parametrize("last", [(3, 0, 2, 3), (3, 0, 2, -1), (4, 0, 1, 2, 3)])
def test_triangles_at_once(tmp_path: Path, sign: str, last: tuple[int, ...]) -> None:
    file = tmp_path / "map.ply"
    file.write_bytes(
        PLY.format(form=f"binary_{'little' if sign == '<' else 'big'}_endian", faces=FACES).encode()
        + b"".join(struct.pack(f"{sign}Bffd", 7, *point) for point in POINTS)
        + b"".join(struct.pack(f"{sign}B{len(one) - 1}iB", *one, 1) for one in ((3, 0, 1, 2), last))
    )
    if -1 in last:
        with pytest.raises(FileError, match="beyond the 4"):
            read_cloud(file)
        return
    fan = [[0, 1, 2]] * (len(last) - 4) + [[0, 2, 3]]
    assert read_cloud(file).triangles.tolist() == [[0, 1, 2], *fan]


@pytest.mark.parametrize("form", ["ascii", "binary"])
def test_pcd(tmp_path: Path, form: str) -> None:
    file = tmp_path / "map.pcd"
    file.write_bytes(pcd(form))
    np.testing.assert_array_equal(read_cloud(file).points, POINTS)
    for cut in range(len(pcd(form)) - 9):
        file.write_bytes(pcd(form)[:cut])
        with pytest.raises(FileError):
            read_cloud(file)


def test_npy_drops_what_is_not_finite(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", np.vstack((np.hstack((POINTS, POINTS)), np.full((2, 6), np.nan))))
    found = read_cloud(tmp_path / "m.npy")
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.dropped == 2


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("m.xyz", b"1 2 3\n", "must be a file of .ply, .pcd, .npy"),
        ("m.npy", b"hello", "is no array of numpy"),
        ("m.npy", b"", "is no array of numpy"),
        ("m.ply", b"ply\nformat ascii 2\n", "no PLY file, or cut off in its header"),
        ("m.ply", b"PLY\nformat ascii 1.0\nend_header\n", "no PLY file of the format"),
        ("m.ply", b"ply\nformat ascii 1.0\nend_header\n", "holds no vertices"),
        ("m.ply", ply("ascii", faces=False).replace(b"vertex 4", b"vertex -4"), "negative count"),
        ("m.ply", ply("ascii", faces=False).replace(b"vertex 4", b"vertex 4" + b"0" * 30), "is cut off"),
        ("m.pcd", pcd("ascii").replace(b"POINTS 4", b"POINTS 4" + b"0" * 30), "is cut off"),
        ("m.ply", ply("ascii", faces=False).replace(b"float x", b"float u"), "no x, y and z"),
        ("m.ply", ply("ascii", faces=False).replace(b"float x", b"real x"), "PLY doesn't have"),
        ("m.ply", ply("ascii", faces=False).replace(b"float y", b"float x"), "a property of vertex twice"),
        ("m.ply", ply("ascii", faces=False).replace(b"float x", b"list char int x"), "no x, y and z|numbers"),
        ("m.npy", b"\x93NUMPY\x01\x00\x06\x00{'a':(", "is no array of numpy"),
        ("m.pcd", pcd("binary").replace(b"SIZE 4 4", b"SIZE 4 4,f8"), "lacks FIELDS"),
        ("m.ply", ply("ascii", faces=False).replace(b"7 3.0", b"7 a"), "doesn't hold the numbers"),
        ("m.ply", ply("ascii", faces=True).replace(b"3 0 1 2 1", b"3 0 1 9 1"), "beyond the 4 there are"),
        ("m.ply", ply("ascii", faces=True).replace(b"3 0 1 2 1", b"3 0 -1 2 1"), "beyond the 4 there are"),
        ("m.ply", ply("ascii", faces=True).replace(b"3 0 1 2", b"3 0 1 " + b"9" * 400), "beyond the 4"),
        ("m.ply", ply("ascii", faces=True).replace(b"7 0.5", b"7 nan"), "must be finite"),
        ("m.pcd", pcd("binary").replace(b"DATA binary", b"DATA binary_compressed"), "convert it to binary"),
        ("m.pcd", pcd("ascii").replace(b"FIELDS rgb x", b"FIELDS rgb u"), "lacks FIELDS with x, y and z"),
        ("m.pcd", pcd("ascii").replace(b"POINTS 4", b"POINTS -4"), "lacks FIELDS"),
        ("m.pcd", pcd("ascii").replace(b"1 3.0", b"1 a"), "doesn't hold the numbers"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises((FileError, OptionError), match=says):
        read_cloud(file)
    with pytest.raises(FileError, match="can't be read"):
        read_cloud(tmp_path / "none.ply")


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npy"])
def test_broken_files_are_read_or_refused(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(0)
    np.save(tmp_path / "whole.npy", POINTS)
    plys = [ply(form, faces=True) for form in ("ascii", "binary_little_endian")]
    wholes = {
        "ply": plys,
        "pcd": [pcd("ascii"), pcd("binary")],
        "npy": [(tmp_path / "whole.npy").read_bytes()],
    }
    file = tmp_path / f"map.{suffix}"
    for k in range(600):
        data = bytearray(wholes[suffix][k % len(wholes[suffix])])
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at : at + rng.integers(0, 3)] = (b"", b"-1", b"9" * 20, b"\n", b"\xff", b"nan")[
                rng.integers(6)
            ]
        file.write_bytes(data)
        with contextlib.suppress(FileError):
            assert np.isfinite(read_cloud(file).points).all()


def test_samples_are_even_over_the_area() -> None:
    corners = np.array(((0.0, 0, 1), (4, 0, 1), (4, 1, 1), (0, 1, 1)))
    mesh = Cloud(corners, np.array(((0, 1, 2), (0, 2, 3), (0, 0, 1))))
    found = sample_mesh(mesh, 20_000)
    np.testing.assert_allclose(found[:, 2], 1.0)
    counts, _, _ = np.histogram2d(found[:, 0], found[:, 1], bins=(4, 2), range=((0, 4), (0, 1)))
    np.testing.assert_allclose(counts, 2500, rtol=0.08)
    with pytest.raises(OptionError, match="no area"):
        sample_mesh(Cloud(corners, np.array(((0, 0, 1),))), 10)
    with pytest.raises(OptionError, match="one point at least, not 0"):
        sample_mesh(mesh, 0)


def grid(n: int = 40, step: float = 0.1) -> np.ndarray[Any, np.dtype[np.float64]]:
    x, y = np.meshgrid(np.arange(n) * step, np.arange(n) * step)
    return np.column_stack((x.ravel(), y.ravel(), np.zeros(n * n)))


def test_a_shifted_half_of_a_plane() -> None:
    pytest.importorskip("scipy", reason="scipy is an extra")
    truth = grid()
    found = compare_maps(truth, truth[:800] + np.array((0, 0, 0.03)), 0.05)
    np.testing.assert_allclose(found.to_reference, 0.03)
    assert (found.precision, found.recall) == (1.0, 0.5)
    assert found.f_score == pytest.approx(2 / 3)
    rows = np.hypot(0.03, np.maximum(np.arange(1600) // 40 - 19, 0) * 0.1)
    np.testing.assert_allclose(found.to_estimate, rows)
    told = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert told["chamfer"] == pytest.approx(0.03 + rows.mean())
    assert compare_maps(truth, truth + 100.0).f_score == 0.0


def test_entropy_grows_with_blur_and_equals_that_of_a_gaussian() -> None:
    pytest.importorskip("scipy", reason="scipy is an extra")
    rng = np.random.default_rng(0)
    blob = rng.normal(0, 0.02, (1200, 3)) + 1000.0
    # All points lie within the radius: one covariance for all, from more pairs than are held at once.
    _, volume = np.linalg.slogdet(2 * np.pi * np.e * np.cov(blob.T, ddof=0))
    assert mean_map_entropy(blob, 10.0).mean == pytest.approx(volume / 2, rel=1e-6)
    sharp, blurred = (mean_map_entropy(grid() + rng.normal(0, s, (1600, 3))).mean for s in (0.002, 0.02))
    assert sharp < blurred
    assert np.isfinite(mean_map_entropy(grid()).mean)
    lonely = mean_map_entropy(grid(5), 0.01)
    assert (lonely.mean, lonely.used, lonely.points) == (None, 0, 25)


def test_thinning() -> None:
    even = grid(4, 1.0) + np.array((0.25, 0.25, -3))
    thinned = thin_out(np.repeat(even, 7, axis=0), 0.5)
    np.testing.assert_allclose(np.sort(thinned, axis=0), np.sort(even, axis=0))
    np.testing.assert_allclose(thin_out(np.array(((0.0, 0, 0), (0.4, 0, 0))), 0.5), ((0.2, 0, 0),))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: compare_maps(grid(), grid(), 0.0), "threshold must be a positive"),
        (lambda: compare_maps(np.empty((0, 3)), grid()), "reference must be points"),
        (lambda: compare_maps(grid(), grid()[:, :2]), "map must be points"),
        (lambda: mean_map_entropy(grid(), -1.0), "radius must be a positive"),
        (lambda: thin_out(grid(), 0.0), "edge of a voxel"),
        (lambda: thin_out(grid(), 1e-9), "too small for a map of 3.9 m"),
    ],
)
def test_wrong_options(call: Callable[[], Any], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        call()


def test_command(
    tmp_path: Path, wander: Callable[..., Trajectory], capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("scipy", reason="scipy is an extra")
    truth = wander()
    turn = np.array(((0.0, -1, 0), (1, 0, 0), (0, 0, 1)))
    write_tum(tmp_path / "gt.txt", truth)
    write_tum(tmp_path / "est.txt", truth.transformed(turn, np.array((1.0, 2, 3))))
    np.save(tmp_path / "ref.npy", grid())
    np.save(tmp_path / "map.npy", grid() @ turn.T + np.array((1, 2, 3)))
    words = ["map", str(tmp_path / "map.npy"), "--reference", str(tmp_path / "ref.npy")]
    lay = ["--trajectories", str(tmp_path / "gt.txt"), str(tmp_path / "est.txt")]
    assert main([*words, *lay, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["fScore"], found["points"]) == (1.0, 1600)
    assert found["accuracy"]["max"] < 1e-6
    assert main([*words, "--voxel", "0.2", "--entropy-radius", "0.5"]) == 0
    out = capsys.readouterr().out
    assert "400 points against 400" in out
    assert "mean map entropy -" in out
    assert main(words[:2]) == 0
    assert "radius 0.3 m" in capsys.readouterr().out


def test_without_scipy_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "scipy.spatial", None)
    np.save(tmp_path / "m.npy", grid())
    assert main(["map", str(tmp_path / "m.npy")]) == 2
    assert "mean map entropy needs scipy's kd-tree: pip install scipy" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    words = ["map", str(tmp_path / "m.npy"), "--reference", str(tmp_path / "m.npy")]
    assert main(words) == 2
    assert capsys.readouterr().err == "slamhive-eval: maps need a kd-tree: pip install scipy, or small_gicp\n"


def test_either_kd_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("small_gicp", reason="small_gicp is an extra")
    pytest.importorskip("scipy", reason="scipy is an extra")
    rng = np.random.default_rng(0)
    clouds = rng.normal(0, 5, (500, 3)), rng.normal(0, 5, (300, 3))
    fast = compare_maps(*clouds)
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    slow = compare_maps(*clouds)
    np.testing.assert_allclose(fast.to_reference, slow.to_reference, rtol=1e-12)
    np.testing.assert_allclose(fast.to_estimate, slow.to_estimate, rtol=1e-12)


def test_command_with_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("scipy", reason="scipy is an extra")
    (tmp_path / "mesh.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n3.9 0 0\n3.9 3.9 0\n0 3.9 0\n4 0 1 2 3\n"
    )
    np.save(tmp_path / "map.npy", grid() + np.array((0, 0, 0.02)))
    words = [str(tmp_path / "map.npy"), "--reference", str(tmp_path / "mesh.ply"), "--threshold", "0.1"]
    assert main(["map", *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["referencePoints"], found["fScore"]) == (200_000, 1.0)
    assert found["accuracy"]["median"] == pytest.approx(0.02, abs=0.001)
