# SPDX-License-Identifier: Apache-2.0
"""Judgement of images: encodings, images that show nothing, or the same again, and the unit of depth.

Bytes of all images are looked at, some thirty of them are decoded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.doctor.repeats import is_same
from slamhive.data.doctor.watching import MessageWatcher
from slamhive.data.recordings.images import compressed_pixels, image_pixels
from slamhive.data.recordings.kinds import IMAGE
from slamhive.model.errors import DataError
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from slamhive.data.doctor.watching import PassingMessage, WatchedSensor

LOOKED_AT = 30
FLAT = 7
"""Grey levels between the darkest pixel and the brightest up to which FAST finds no corner (minThFAST)."""
DARK = 40
"""Grey level of 255 that one pixel in a hundred of a dark image passes at most: a room by night with a lamp
has brighter ones."""
_HEAD, _PIECE = 512, 4096
"""Bytes that hold a message's header, and bytes by which an image is judged at a glance."""
_STEP = 24
"""Bytes after which each layout of pixels, of 1 to 4 channels and 1 or 2 bytes, comes to the same channel."""
_FEW_BITS = 14
"""Bits of 16 below which the upper 8 hold so few that what is seen is dark."""
DEPTHS = (0.1, 60.0)
"""Typical depths in m of a camera: none sees nearer, 16 bits of mm end at 65.5 m, and of what is farther away
a robot's stereo pair knows nothing."""
_LIKELY = (0.4, 10.0)
SCALES = {"f": (1.0, 1000.0), "u": (1.0, 1000.0, 5000.0, 10_000.0)}
"""Usual units a metre, of floats and of whole numbers."""


class Pictures(MessageWatcher):
    """Watcher of the images of a camera or depth camera.

    Attributes:
        is_depth: Whether it is one of depth.
        depths: Typical depths of the images that were looked at, in units of theirs.
    """

    def __init__(self, of: WatchedSensor) -> None:
        super().__init__(of)
        self.is_depth = of.sensor.type is SensorType.DEPTH_CAMERA
        self._every = max(1, of.messages // LOOKED_AT)
        self._last: bytes | None = None
        self._is_flat = False
        self._largest = 0
        self._looked = 0
        self._flat: list[tuple[int, int]] = []
        self._unread: list[tuple[int, str]] = []
        self._stepless: list[int] = []
        self._dark: list[int] = []
        self._bits = 0
        self._kinds: dict[str, int] = {}
        self._described = ""
        self._letter = "u"
        self.depths: list[float] = []
        self._full: list[float] = []

    def take(self, message: PassingMessage) -> None:
        """Take in an image."""
        raw, before = message.raw, self._last
        self._last, self._largest = raw, max(self._largest, len(raw))
        if before is not None and is_same(before, raw):
            if not self._is_flat:
                self.repeated.append(message.index)
        else:
            sampled = message.index % self._every == 0
            # A run of flat images is followed to its end; what else looks like one is not without a limit.
            likely = self._is_flat or (self._looked < 8 * LOOKED_AT and self._may_be_flat(raw))
            self._is_flat = (sampled or likely) and self._look(message, sampled=sampled)
        if self._is_flat:
            self._flat.append((message.index, message.stamp))

    @property
    def has_odd_unit(self) -> bool:
        """Tell whether depth by itself is in another unit than stated, or in none that is stated."""
        return self.is_depth and any(True for _ in self._unit())

    def findings(self) -> Iterator[Finding]:
        """Yield the findings of the images."""
        yield from self._encodings()
        yield from self._nothing_seen()
        if self.is_depth:
            yield from self._unit()

    def found(  # noqa: PLR0917 - as a finding has them
        self, code: str, severity: Severity, sentence: str, stamps: list[int], value: float | None = None,
        unit: str | None = None, **more: Any,
    ) -> Finding:  # fmt: skip
        """Return a finding of this sensor on the images of some stamps (ns)."""
        first = self.of.seconds(stamps[0]) if stamps else None
        text = f"{self.of.where}: {sentence}"
        return Finding(code, severity, text, self.of.name, len(stamps) or 1, first, value, unit, **more)

    def _may_be_flat(self, raw: bytes) -> bool:
        if self.of.message_type != IMAGE:
            # What shows nothing takes far less than what shows something.
            return 3 * len(raw) < self._largest
        step = _STEP * max(1, len(raw) // (_STEP * _PIECE))
        some = np.frombuffer(raw, dtype=np.uint8)[_HEAD::step]
        # A few bytes tell of most images that they show something.
        return some.size < _STEP or all(int(np.ptp(some[::every])) <= FLAT for every in (64, 1))

    def _look(self, message: PassingMessage, *, sampled: bool) -> bool:
        """Look at an image's pixels, and tell whether nothing is to be seen in it."""
        self._looked += 1
        decoded = message.decoded
        raw = self.of.message_type == IMAGE
        self._described = decoded.encoding if raw else decoded.format
        try:
            pixels = (image_pixels if raw else compressed_pixels)(decoded, self.of.sensor.topic)
        except DataError as error:
            self._unread.append((message.stamp, str(error)))
            return False
        if raw and not decoded.step:
            self._stepless.append(message.stamp)
        kind = f"{pixels.shape[1]}×{pixels.shape[0]} {self._described}"
        self._kinds[kind] = self._kinds.get(kind, 0) + 1
        self._letter = pixels.dtype.kind
        if self.is_depth:
            return self._look_at_depth(pixels)
        if pixels.dtype == np.uint16:
            self._bits = max(self._bits, int(pixels.max()).bit_length())
            pixels = (pixels >> 8).astype(np.uint8)
        is_flat = int(np.ptp(pixels.reshape(-1, *pixels.shape[2:]), axis=0).max()) <= FLAT
        if sampled and not is_flat and np.count_nonzero(pixels >= DARK) < 0.01 * pixels.size:
            self._dark.append(message.stamp)
        return is_flat

    def _look_at_depth(self, pixels: npt.NDArray[Any]) -> bool:
        known = pixels[np.isfinite(pixels) & (pixels > 0)]
        if known.size:
            self.depths.append(float(np.median(known)))
            self._full.append(
                float((known == np.iinfo(np.uint16).max).mean()) if self._letter == "u" else 0.0
            )
        return not known.size or bool(np.ptp(known) == 0 and known.size == pixels.size)

    def _encodings(self) -> Iterator[Finding]:
        code = "depth.format" if self.is_depth else "images.encoding"
        topic = self.of.sensor.topic
        if self._unread:
            yield self.found(
                code, Severity.ERROR,
                f"of {self._looked} images looked at {len(self._unread)} can't be read, so runs with it "
                f"fail: {self._unread[0][1]}", [stamp for stamp, _ in self._unread],
            )  # fmt: skip
        if self._stepless:
            yield self.found(
                code, Severity.WARNING,
                f"images on {topic} state rows of 0 bytes (step), and are read as rows without padding; ROS "
                "nodes refuse them. Set step where they are recorded", self._stepless,
            )  # fmt: skip
        if len(self._kinds) > 1:
            kinds = ", ".join(f"{kind} ({count})" for kind, count in self._kinds.items())
            yield self.found(
                code, Severity.WARNING,
                f"images on {topic} aren't alike: {kinds} of {self._looked} looked at; algorithms take one "
                "size and encoding", [],
            )  # fmt: skip
        if self.is_depth:
            yield from self._depth_format(code, topic)
        elif self._bits:
            lost = self._bits < _FEW_BITS
            yield self.found(
                code, Severity.WARNING if lost else Severity.NOTE,
                f"images on {topic} have 16 bits ({self._described}), and values of {self._bits} bits: "
                "visual algorithms take 8, and adapters give them the upper 8 of 16"
                + (f", in which {max(0, self._bits - 8)} bits are left of these: too dark to track. Record 8 "
                   "bits, or values that fill 16" if lost else ""), [], self._bits, "bit",
            )  # fmt: skip
        elif self._described.startswith(("bayer", "yuv", "uyvy", "yuyv")) and self._kinds:
            yield self.found(
                code, Severity.NOTE,
                f"images on {topic} are {self._described}: adapters and exports make colours "
                "of them; programs that read the topic themselves get them as they are", [],
            )  # fmt: skip

    def _depth_format(self, code: str, topic: str) -> Iterator[Finding]:
        camera = self.of.sensor.camera
        stated = self._described.split(";")[0].strip()
        if self._kinds and ((self._letter == "u") is (stated == "32FC1") or self._letter not in "uf"):
            # A float can't come of whole numbers; seen where a driver states another encoding than it sends.
            yield self.found(code, Severity.WARNING, f"depth on {topic} isn't {stated}, as it says", [])
        real = self._letter == "f"
        if self._kinds and camera is not None and real != (camera.encoding == "32FC1"):
            found = "32-bit floats" if real else "whole numbers"
            yield self.found(
                code, Severity.WARNING,
                f"camera.encoding states {camera.encoding}, but the depth on {topic} is {found} "
                f"({self._described}); programs that are told it misread it", [],
            )  # fmt: skip
        if self._described.strip().endswith("rvl"):
            yield self.found(
                code, Severity.NOTE,
                f"depth on {topic} is compressed as RVL, which few programs read: preparation writes it as "
                "PNG, without loss", [],
            )  # fmt: skip

    def _nothing_seen(self) -> Iterator[Finding]:
        if self._flat:
            (first, _), stamps = self._flat[0], [stamp for _, stamp in self._flat]
            what = "no depth" if self.is_depth else f"one grey (within {FLAT} levels of 255)"
            drop = [index for index, _ in self._flat]
            leading = drop == list(range(len(drop))) and len(drop) < self.of.messages
            yield self.found(
                "images.constant", Severity.WARNING,
                f"{len(self._flat)} images show {what}, the first is message {first + 1}: nothing can be "
                "tracked in them, and visual algorithms lose track or start late"
                + ("; leave out these first ones" if leading else ""), stamps, len(stamps), "images",
                repair=sensor_repair(self.of.name, dropLeading=len(drop)) if leading else {},
            )  # fmt: skip
        # Images that use few of 16 bits are named as such.
        if not 0 < self._bits < _FEW_BITS and 2 * len(self._dark) > min(LOOKED_AT, self._looked):
            yield self.found(
                "images.dark", Severity.WARNING,
                f"{len(self._dark)} of {self._looked} images looked at are dark: 99 % of their pixels are "
                f"below {DARK} of 255, and visual algorithms find few corners in them. Lower their "
                "thresholds, or record with more light or a longer exposure",
                self._dark, len(self._dark), "images",
            )  # fmt: skip

    def _unit(self) -> Iterator[Finding]:
        if not self.depths:
            return
        camera = self.of.sensor.camera
        scale = camera.depth_scale if camera else None
        found, full = float(np.median(self.depths)), float(np.median(self._full))
        fitting = [one for one in SCALES[self._letter] if _LIKELY[0] < found / one < _LIKELY[1]]
        # Depths in 65535ths of a metre are at the end of 16 bits from 1 m on.
        better = 65_535.0 if full > 0.5 else next((one for one in (1000.0, 1.0) if one in fitting), None)
        better = better or (fitting[0] if fitting else None)
        if better == scale:
            better = None
        helps = f"; {better:g} would make it {found / better:.3g} m" if better else ""
        more: dict[str, Any] = {"repair": sensor_repair(self.of.name, depthScale=better)} if better else {}
        if scale is None:
            yield self.found(
                "depth.unit", Severity.WARNING,
                "camera.depthScale: not given; 1000 (millimetres) is common, TUM RGB-D has 5000" + helps,
                [], **more,
            )  # fmt: skip
        elif full > 0.5 or not DEPTHS[0] < found / scale < DEPTHS[1]:
            end = f", and {full:.0%} of it is at the end of 16 bits" if full > 0.01 else ""
            yield self.found(
                "depth.unit", Severity.ERROR if not better else Severity.WARNING,
                f"camera.depthScale: with {scale:g} units a metre the depth is {found / scale:.3g} m "
                f"typically{end}: runs with it come out Diverged, by their scale{helps}",
                [], found / scale, "m", **more,
            )  # fmt: skip
