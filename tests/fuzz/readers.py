# SPDX-License-Identifier: Apache-2.0
"""Fuzz every reader of slamhive_eval: ``python tests/fuzz/readers.py --seconds 600``.

Files that are right are broken in all ways that files break: bytes changed, cut, repeated and swapped,
numbers replaced by awkward ones, lines mixed between formats. Whatever comes, a reader returns or raises an
EvaluationError of one line, within seconds, and what it returns can be evaluated. Anything else is a failure:
its traceback is printed, its file is kept in tests/fuzz/corpus, and the exit code is 1. The files kept there
are read first, each time.
"""

from __future__ import annotations

import argparse
import bz2
import gzip
import hashlib
import io
import json
import random
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

sys.path.append(str(Path(__file__).parent))

from drawing import bound, timed

from slamhive_eval import (
    EvaluationError,
    Options,
    Preparation,
    Trajectory,
    evaluate,
    evaluate_health,
    evaluate_relations,
    measure_consistency,
    number_poses,
    read_cloud,
    read_covariances,
    read_health,
    read_relations,
    read_segments,
    read_trajectory,
)
from slamhive_eval.formats.files import read_transform

if TYPE_CHECKING:
    from collections.abc import Callable

CORPUS = Path(__file__).with_name("corpus")
"""Files that once failed: DIGEST-NAME.kept, with the name that they were read by."""
AWKWARD = (
    *(b"nan", b"inf", b"-inf", b"1e400", b"-0", b"1e-320", b"0x1", b"1_0", b"", b"1.5.2", b"1d3", b"(1+2j)"),
    *(
        b"\xff\xfe",
        b"\x00",
        b"\x1c",
        b"\xc2\x85",
        b'"',
        b"#",
        b",",
        b"1e18",
        b"-1",
        b"99999999999999999999999",
    ),
)


class First(random.Random):
    """Chooses what comes first: what a file is read as when nothing is amiss."""

    def random(self) -> float:
        """The least there is."""
        return 0.0

    def choice(self, seq: Any) -> Any:
        """The first one."""
        return seq[0]


Seed = tuple[str, bytes]
"""Name of the file with its ending, and what is in it."""


def poses(n: int = 12) -> np.ndarray:
    """Stamps, positions and quaternions, shape (n, 8)."""
    t = np.arange(n) * 0.1
    turned = np.column_stack((np.zeros((n, 2)), np.sin(t / 2), np.cos(t / 2)))
    return np.column_stack((1.6e9 + t, np.sin(t), np.cos(t), 0.1 * t, turned))


def text_seeds() -> list[Seed]:
    """Files of every text format, plain and compressed."""
    rows = poses()
    covariance = np.tile(np.eye(6).ravel() * 0.01, (len(rows), 1))

    def text(columns: np.ndarray, separator: str, head: str = "") -> bytes:
        return (head + "\n".join(separator.join(map(repr, row)) for row in columns.tolist()) + "\n").encode()

    matrices = np.tile(np.eye(4)[:3].ravel(), (len(rows), 1))
    tum = text(rows, " ", "# timestamp tx ty tz qx qy qz qw\n")
    nanoseconds = np.column_stack((rows[:, 0] * 1e9, rows[:, [1, 2, 3, 7, 4, 5, 6]], rows[:, :6]))
    euroc = text(nanoseconds, ",", "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w []\n")
    names = "timestamp,x,y,z,qx,qy,qz,qw," + ",".join(f"covariance{k}" for k in range(36))
    table = text(np.hstack((rows, covariance)), ",", names + "\n")
    upper = [f"P{kind}{i}{j}" for kind in "rt" for i in (1, 2, 3) for j in range(i, 4)]
    openvins = text(np.hstack((rows, covariance[:, :12])), " ", f"# {TUM} {' '.join(upper)}\n")
    relations = text(np.column_stack((rows[:-1, 0], rows[1:, 0], rows[:-1, 1:7])), " ")
    segments = b"start,end,map,reason\n1600000000,1600000000.5,0,start\n1600000000.6,1600000001,1,lost\n"
    health = b"stamp,value,flag\n1600000000,0.5,ok\n1600000000.1,,degraded\n1600000000.2,-3e2,\n"
    known = text(
        np.hstack((rows[:, :1], covariance[:, :6])), ",", "stamp,cov_xx,cov_xy,cov_xz,cov_yy,cov_yz,cov_zz\n"
    )
    ply = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    ply += (
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    pcd = b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\n"
    pcd += b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA "
    raw = np.arange(9, dtype="<f4").tobytes()
    npy = io.BytesIO()
    np.save(npy, rows[:, 1:4])
    binary = ply.replace(b"ascii", b"binary_little_endian").split(b"element face")[0] + b"end_header\n" + raw
    return [
        *(("a.txt", tum), ("b.csv", euroc), ("c.kitti", text(matrices, " ")), ("d.csv", table)),
        *(("e.txt", openvins), ("f.relations", relations), ("segments.csv", segments)),
        *(("health.csv", health), ("covariances.csv", known)),
        *(("g.gz", gzip.compress(tum)), ("h.bz2", bz2.compress(tum)), ("i.txt", b"1 2 3 0 0 0 1\n")),
        *(("a.ply", ply), ("b.ply", binary), ("a.pcd", pcd + b"ascii\n0 0 0\n1 0 0\n0 1 0\n")),
        *(("b.pcd", pcd + b"binary\n" + raw), ("a.npy", npy.getvalue())),
    ]


TF = "tf2_msgs/msg/TFMessage"
TUM = "timestamp(s) tx ty tz qx qy qz qw"


def bag_seeds(folder: Path) -> list[Seed]:
    """A ROS 1 bag, MCAP and SQLite files, and the metadata of a ROS 2 bag, with odometry and transforms."""
    store1, store2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    store1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    with Writer1(folder / "seed.bag") as writer:
        fill(writer, store1, store1.serialize_ros1)
    for name, plugin in (("mcap", StoragePlugin.MCAP), ("db3", StoragePlugin.SQLITE3)):
        with Writer2(folder / name, version=9, storage_plugin=plugin) as other:
            fill(other, store2, store2.serialize_cdr)
    metadata = folder / "db3" / "metadata.yaml"
    return [
        ("a.bag", (folder / "seed.bag").read_bytes()),
        *((f"a.{name}", next((folder / name).glob(f"*.{name}")).read_bytes()) for name in ("mcap", "db3")),
        (str(metadata.relative_to(folder)), metadata.read_bytes()),
    ]


def fill(writer: Writer1 | Writer2, store: object, serialize: Callable[[object, str], bytes]) -> None:
    """Write poses and transforms."""
    types = store.types  # type: ignore[attr-defined]
    number = [0] if isinstance(writer, Writer1) else []
    kinds = {"/odom": "nav_msgs/msg/Odometry", "/tf": TF}
    connections = {
        topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()
    }
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    zero = types["geometry_msgs/msg/Twist"](vector(0, 0, 0), vector(0, 0, 0))
    for row in poses():
        stamp = types["builtin_interfaces/msg/Time"](int(row[0]), int(row[0] % 1 * 1e9))
        header = types["std_msgs/msg/Header"](*number, stamp, "map")
        turn = quaternion(*row[4:])
        pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*row[1:4]), turn)
        messages = {
            "/odom": types["nav_msgs/msg/Odometry"](
                header,
                "base",
                types["geometry_msgs/msg/PoseWithCovariance"](pose, np.eye(6).ravel()),
                types["geometry_msgs/msg/TwistWithCovariance"](zero, np.zeros(36)),
            ),
            "/tf": types[TF](
                [
                    types["geometry_msgs/msg/TransformStamped"](
                        header, "base", types["geometry_msgs/msg/Transform"](vector(*row[1:4]), turn)
                    )
                ]
            ),
        }
        for topic, message in messages.items():
            writer.write(connections[topic], int(row[0] * 1e9), serialize(message, kinds[topic]))


def mutate(rng: random.Random, data: bytes, others: list[Seed]) -> bytes:
    """A file like it, broken in one or more ways."""
    changed = bytearray(data)
    for _ in range(1 + int(rng.expovariate(0.7))):
        at = rng.randrange(len(changed) + 1)
        kind = rng.randrange(9)
        if kind == 0:
            del changed[at:]
        elif kind == 1:
            del changed[at : at + rng.choice((1, 2, 8, 64))]
        elif kind == 2:
            changed[at:at] = rng.choice(AWKWARD)
        elif kind == 3 and at < len(changed):
            changed[at] = rng.randrange(256)
        elif kind == 4 and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 5:
            changed[at : at + 4] = rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**31)).to_bytes(4, "little")
        elif kind == 6:
            words = bytes(changed).split(b" ") if b" " in changed else bytes(changed).split(b",")
            words[rng.randrange(len(words))] = rng.choice(AWKWARD)
            changed = bytearray((b" " if b" " in changed else b",").join(words))
        elif kind == 7:
            lines = bytes(changed).split(b"\n")
            lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
            rng.shuffle(lines) if rng.random() < 0.2 else None
            changed = bytearray(b"\n".join(lines))
        else:
            other = rng.choice(others)[1]
            start = rng.randrange(len(other))
            changed[at : at + rng.randrange(40)] = other[start : start + rng.randrange(1, 80)]
    return bytes(changed)


def check_trajectory(path: Path, rng: random.Random) -> None:
    """Read it, by a format or by what it is, and evaluate what was read."""
    name = str(path.parent if path.name == "metadata.yaml" else path)
    chosen = rng.choice((None, None, None, "tum", "euroc", "kitti", "csv"))
    if path.suffix in (".bag", ".mcap", ".db3", ".yaml"):
        name += rng.choice((":/odom", "", ":/tf:map.base", ":/tf"))
        chosen = None
    found = read_trajectory(name, chosen, unsorted="sort")
    flipped = Trajectory(
        found.stamps, found.positions[::-1], found.quaternions[::-1], oriented=found.oriented
    )
    alignment = rng.choice(("none", "origin", "se3", "sim3", "scale", "yaw"))
    if alignment == "origin" and not found.oriented:
        alignment = "none"
    measured = evaluate(flipped, found, Options(alignment=alignment))
    json.dumps(measured.as_dict(), allow_nan=False)
    if found.covariances is not None:
        measure_consistency(flipped, found, found.covariances).as_dict()


def check(path: Path, rng: random.Random) -> None:
    """Read a file with what reads such files, now and then with what doesn't."""
    kind = path.suffix if rng.random() < 0.95 else rng.choice((".relations", ".ply", ".csv", ".transform"))
    rows = poses()
    path_of_12 = Trajectory(rows[:, 0], rows[:, 1:4], rows[:, 4:])
    if path.name == "segments.csv":
        number_poses(path_of_12, read_segments(path))
    elif path.name in {"health.csv", "covariances.csv"}:
        is_health = path.name == "health.csv"
        told = {"said": read_health(path)} if is_health else {"covariances": read_covariances(path)}
        found = evaluate_health(path_of_12, path_of_12, Preparation(alignment="se3"), **told)
        json.dumps(found, allow_nan=False)
    elif kind == ".relations":
        json.dumps(evaluate_relations(read_relations(path), path_of_12).as_dict(), allow_nan=False)
    elif kind in (".ply", ".pcd", ".npy"):
        read_cloud(path)
    elif kind == ".transform" or path.name == "i.txt":
        read_transform(path)
    else:
        check_trajectory(path, rng)


class Reading:
    """Reads broken files and notes what fails.

    Args:
        folder: where the files are written to be read; what isn't broken is there already.
        keep: the folder for those that fail.

    Attributes:
        seeds: the files that are right, by the names that they are read by.
        failures: the tracebacks, by the kind of failure.
        count: files that were read or refused.
        read: of those, how many were read.
    """

    def __init__(self, folder: Path, keep: Path) -> None:
        self._folder = folder
        self._keep = keep
        self.seeds = text_seeds() + bag_seeds(folder)
        self.failures: dict[str, str] = {}
        self.count = self.read = 0
        for name, data in self.seeds:
            (folder / name).write_bytes(data)
            check(folder / name, First())

    def corpus(self) -> None:
        """Read every file of the corpus."""
        names = {Path(name).name: name for name, _ in self.seeds}
        for path in sorted(CORPUS.glob("*.kept")):
            self.attempt(names[path.stem.partition("-")[2]], path.read_bytes())

    def broken(self, rng: random.Random) -> None:
        """Break one of the files and read it."""
        name, data = rng.choice(self.seeds)
        self.attempt(name, mutate(rng, data, self.seeds))

    def attempt(self, name: str, data: bytes) -> None:
        """Read a file: how follows from its bytes, so that a file that failed fails again."""
        path = self._folder / name
        path.write_bytes(data)
        digest = hashlib.sha256(data).hexdigest()
        self.count += 1
        try:
            with timed(), warnings.catch_warnings():
                warnings.simplefilter("error")
                check(path, random.Random(digest))
            self.read += 1
        except EvaluationError as error:
            if "\n" in str(error):
                self._failed("a sentence of several lines", f"{digest[:12]}-{path.name}.kept", data)
        except Exception as error:  # noqa: BLE001 - that is what is looked for
            frame = traceback.extract_tb(error.__traceback__)[-1]
            kind = f"{type(error).__name__} in {Path(frame.filename).name}, line {frame.lineno}"
            self._failed(kind, f"{digest[:12]}-{path.name}.kept", data)

    def _failed(self, kind: str, name: str, data: bytes) -> None:
        """Keep the first file of each kind of failure."""
        if kind not in self.failures:
            self._keep.mkdir(parents=True, exist_ok=True)
            (self._keep / name).write_bytes(data)
            self.failures[kind] = f"{kind}: {self._keep / name}\n{traceback.format_exc()}"


def main() -> int:
    """Fuzz for a while, or over a number of files, and say how much."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--files", type=int, default=None, help="so many broken files, however long it takes")
    parser.add_argument(
        "--seed", type=int, default=None, help="repeat a session (default: another each time)"
    )
    parser.add_argument("--keep", type=Path, default=CORPUS, help="folder for files that fail")
    asked = parser.parse_args()
    seed = time.time_ns() % 2**32 if asked.seed is None else asked.seed
    print(f"seed {seed}", flush=True)  # noqa: T201
    rng = random.Random(seed)
    bound()
    with tempfile.TemporaryDirectory() as folder:
        reading = Reading(Path(folder), asked.keep)
        reading.corpus()
        kept = reading.count
        end = time.monotonic() + asked.seconds
        while reading.count - kept < asked.files if asked.files is not None else time.monotonic() < end:
            reading.broken(rng)
    for failure in reading.failures.values():
        sys.stderr.write(f"{failure}\n")
    print(  # noqa: T201
        f"{reading.count} files ({kept} of the corpus), {reading.read} of them read, "
        f"{len(reading.failures)} kinds of failure"
    )
    return 1 if reading.failures else 0


if __name__ == "__main__":
    sys.exit(main())
