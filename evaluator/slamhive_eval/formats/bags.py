# SPDX-License-Identifier: Apache-2.0
"""Trajectories in recordings: ROS 1 bags, ROS 2 bags and MCAP files, through rosbags, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from slamhive_eval.errors import FileError, TrajectoryError, did_you_mean
from slamhive_eval.formats import posemessages
from slamhive_eval.formats.notices import NotDamagedError
from slamhive_eval.formats.posemessages import READERS, STATIC_TRANSFORMS, TF_TYPES
from slamhive_eval.formats.transforms import Frames

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive_eval.trajectory import Trajectory

SUFFIXES = (".bag", ".mcap", ".db3")


def is_bag(path: str | Path) -> bool:
    """Tell whether a path is that of a recording: by its ending, or a folder with metadata.yaml."""
    path = Path(path)
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(path: str | Path, topic: str | None = None, *, sort: bool = False) -> Trajectory:
    """Read the poses of a topic of a recording.

    Args:
        path: A ROS 1 bag, a ROS 2 bag's folder, or an MCAP file.
        topic: With messages of a type in `posemessages.READERS`; ``TOPIC:PARENT.CHILD`` for the pose of the
            frame CHILD in the frame PARENT by the transforms of a TF topic and /tf_static. None for the
            only topic with poses.
        sort: Whether to sort decreasing stamps instead of refusing them.

    Returns:
        The trajectory by header stamps in s.

    Raises:
        FileError: The recording can't be read, it has no such topic or several to choose from, or the
            topic holds no trajectory.
    """
    with _Bag(path) as bag:
        name = bag.find(topic)
        kind = bag.topics[name]
        place = f"{path}:{topic or name}"
        try:
            if kind in TF_TYPES:
                frames = Frames()
                for source, message in bag.messages({name, STATIC_TRANSFORMS}):
                    posemessages.add_transforms(frames, message, source)
                return frames.trajectory(*frames.split((topic or "").removeprefix(name).lstrip(":")))
            found = (message for _, message in bag.messages({name}))
            return posemessages.read_poses(found, kind, sort=sort)
        except FileError:
            raise
        except TrajectoryError as error:
            raise FileError(place, str(error)) from None
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            # The recording describes its messages itself, and describes them wrongly.
            raise FileError(place, f"messages aren't what {kind} is ({error})") from None


class _Bag:
    """An open recording; whatever parsers raise on damaged files becomes one sentence."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.exists():
            raise FileError(path, "can't be read: No such file or directory")
        try:
            # It takes longer than a small evaluation.
            from slamhive_eval.formats.rosreading import RosReader  # noqa: PLC0415
        except ImportError:
            raise FileError(
                path, "reading recordings needs the package rosbags: pip install rosbags"
            ) from None
        try:
            self._reader = RosReader([self.path], is_ros1=self.path.suffix == ".bag")
            self._reader.open()
        except Exception as error:  # noqa: BLE001 - parsers raise anything on hostile bytes
            raise self._damaged(error) from None
        self.topics: dict[str, str] = {one.topic: one.msgtype for one in self._reader.connections}
        if not all(isinstance(word, str) for words in self.topics.items() for word in words):
            self._reader.close()
            raise self._damaged(ValueError("a topic has no name or no type"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def find(self, asked: str | None) -> str:
        """The topic's name, which must carry poses."""
        if asked is not None and ":" in asked and asked not in self.topics:
            asked = asked.split(":", 1)[0]
        if asked is not None:
            for name in (asked, f"/{asked}"):
                if name in self.topics:
                    self._require_poses(name)
                    return name
            with_poses = self._candidates() or list(self.topics)
            hint = did_you_mean(asked, with_poses) or f"; there are {', '.join(sorted(with_poses))}"
            raise FileError(self.path, f"has no topic {asked!r}{hint}")
        candidates = [name for name in self._candidates() if self.topics[name] not in TF_TYPES]
        if len(candidates) == 1:
            return candidates[0]
        transforms = sorted(name for name in self._candidates() if self.topics[name] in TF_TYPES)
        if candidates:
            listed = ", ".join(sorted(candidates))
            raise FileError(self.path, f"has several topics with poses, name one as in FILE:TOPIC: {listed}")
        if transforms:
            example = f"{self.path.name}:{transforms[0]}:map.base_link"
            raise FileError(self.path, f"has transforms only; name two frames as in {example}")
        raise FileError(
            self.path, f"has no topic with poses, only {', '.join(sorted(self.topics)) or 'none'}"
        )

    def messages(self, topics: set[str]) -> Iterator[tuple[str, Any]]:
        """Topic and decoded message, in the order of recording."""
        chosen = [one for one in self._reader.connections if one.topic in topics]
        try:
            for connection, _, raw in self._reader.messages(chosen):
                yield connection.topic, self._reader.deserialize(raw, connection.msgtype)
        except Exception as error:  # noqa: BLE001 - parsers raise anything on hostile bytes
            raise self._damaged(error) from None

    def _candidates(self) -> list[str]:
        return [name for name, kind in self.topics.items() if kind in READERS or kind in TF_TYPES]

    def _require_poses(self, name: str) -> None:
        kind = self.topics[name]
        if kind not in READERS and kind not in TF_TYPES:
            known = ", ".join(one.rpartition("/")[2] for one in (*READERS, TF_TYPES[0]))
            raise FileError(f"{self.path}:{name}", f"messages of type {kind} carry no pose; {known} do")

    def _damaged(self, error: Exception) -> FileError:
        if isinstance(error, NotDamagedError):
            return FileError(self.path, str(error))
        text = " ".join(str(error).split()) or type(error).__name__
        shown = text if len(text) <= 160 else text[:160] + "…"
        return FileError(self.path, f"can't be read as a recording, it is damaged or cut off ({shown})")
