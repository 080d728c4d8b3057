# SPDX-License-Identifier: Apache-2.0
"""Training of the bag-of-words vocabulary that ORB-SLAM needs, from images that are never evaluated on.

The vocabulary is a tree of binary descriptors made by clustering them again and again (Gálvez-López and
Tardós, "Bags of binary words for fast place recognition in image sequences", T-RO 2012). It is written in the
text format that ORB-SLAM reads: a line `branching depth scoring weighting`, then a line
`parent is-leaf 32-bytes weight` for each node but the root, parents before children.

Equal images, seed and OpenCV give an equal file: nothing here depends on threads or on the order of sums.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from slamhive.data.recordings.images import image_pixels
from slamhive.data.recordings.reading import Recording, guess_format
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Bits = NDArray[np.float32]
    Descriptors = NDArray[np.uint8]

L1_NORM: Final = 0
TF_IDF: Final = 0
DESCRIPTOR_BYTES: Final = 32
MAX_DESCRIPTORS: Final = 200_000
"""Descriptors that the tree is made from at most; they are drawn evenly from all images."""

MAX_ROUNDS: Final = 12
"""Rounds of one clustering at most; it has usually settled before."""


@dataclass
class VocabularyNode:
    """A node of the tree.

    Attributes:
        parent: Index of the parent, 0 being the root.
        descriptor: `(32,)`, its centre.
        children: Indices of its children; none for a word.
        weight: Inverse document frequency of a word.
    """

    parent: int
    descriptor: Descriptors
    children: list[int] = field(default_factory=list)
    weight: float = 0.0


def train_vocabulary(
    images: Iterable[NDArray[np.uint8]],
    out: Path,
    *,
    branching: int = 4,
    depth: int = 6,
    features: int = 1000,
    seed: int = 0,
) -> int:
    """Train a vocabulary and write it.

    The default depth is that of the published vocabulary, since ORB-SLAM looks for matches between features
    that share their ancestor four levels above the words: with a depth of four or less all features do.

    Args:
        images: `(height, width)` uint8, of training sequences.
        out: The file to write.
        branching: Children of a node at most, 2 to 20.
        depth: Levels below the root, 1 to 10. There are at most `branching ** depth` words.
        features: ORB features taken from an image at most.
        seed: Of the clustering's starts.

    Returns:
        The number of words.

    Raises:
        InputError: The tree's shape is not allowed, or the images hold too few features.
    """
    if not 2 <= branching <= 20 or not 1 <= depth <= 10:
        raise InputError(
            f"vocabulary: branching {branching} and depth {depth} are not allowed, "
            "only a branching from 2 to 20 and a depth from 1 to 10"
        )
    per_image = describe(images, features)
    total = sum(len(descriptors) for descriptors in per_image)
    if total < branching:
        raise InputError(f"vocabulary: the training images hold {total} features, too few to make words from")
    rng = np.random.default_rng(seed)
    pool = np.concatenate(per_image)
    if total > MAX_DESCRIPTORS:
        pool = pool[np.linspace(0, total - 1, MAX_DESCRIPTORS).round().astype(np.int64)]
    nodes = grow(pool, branching, depth, rng)
    weigh(nodes, per_image)
    out.write_text(render(nodes, branching, depth), encoding="ascii")
    return sum(not node.children for node in nodes[1:])


def training_images(recording: Path, topic: str, every: int = 3) -> Iterator[NDArray[np.uint8]]:
    """Read the images to train on.

    Args:
        recording: A recording that no algorithm is evaluated on.
        topic: Its sensor_msgs/Image topic.
        every: One image of so many is taken, since those that follow each other show the same.

    Yields:
        Grey images `(height, width)`.

    Raises:
        InputError: The recording has no such topic, or its images don't have 8 bits.
        DataError: The recording can't be read.
    """
    with Recording([recording], guess_format(recording)) as source:
        if topic not in source.topics:
            raise InputError(f"vocabulary: {recording} has no topic {topic}, only {', '.join(source.topics)}")
        for index, (connection, _, raw) in enumerate(source.messages([topic])):
            if index % every:
                continue
            image = image_pixels(source.decode(raw, connection.msgtype), topic)
            if image.dtype != np.uint8:
                raise InputError(f"vocabulary: the images of {topic} must have 8 bits, not {image.dtype}")
            # The mean is the same for red, green, blue and for blue, green, red.
            yield np.asarray(image if image.ndim == 2 else image[:, :, :3].mean(axis=2), np.uint8)


def describe(images: Iterable[NDArray[np.uint8]], features: int) -> list[Descriptors]:
    """Extract the ORB descriptors `(n, 32)` of each image that has any."""
    # The levels and the scale between them are ORB-SLAM's defaults.
    orb = cv2.ORB_create(nfeatures=features, scaleFactor=1.2, nlevels=8, fastThreshold=12)  # type: ignore[attr-defined]
    found = []
    for image in images:
        _, descriptors = orb.detectAndCompute(image, None)
        if descriptors is not None and len(descriptors):
            found.append(np.asarray(descriptors, np.uint8))
    return found


def grow(
    descriptors: Descriptors, branching: int, depth: int, rng: np.random.Generator
) -> list[VocabularyNode]:
    """Make the tree, level by level, the root first.

    Args:
        descriptors: `(n, 32)`.
        branching: Children of a node at most.
        depth: Levels below the root.
        rng: Draws where a clustering starts.
    """
    nodes = [VocabularyNode(0, np.zeros(DESCRIPTOR_BYTES, np.uint8))]
    level = [(0, descriptors)]
    for _ in range(depth):
        below = []
        for parent, members in level:
            if len(members) < 2:
                continue
            centres, labels = cluster(members, branching, rng)
            if len(centres) < 2:
                continue
            for label, centre in enumerate(centres):
                nodes[parent].children.append(len(nodes))
                below.append((len(nodes), members[labels == label]))
                nodes.append(VocabularyNode(parent, centre))
        level = below
    return nodes


def cluster(
    descriptors: Descriptors, count: int, rng: np.random.Generator
) -> tuple[Descriptors, NDArray[np.intp]]:
    """Cluster binary descriptors by k-majority.

    As k-means, with the Hamming distance, and as centre of a cluster the bits that at least half of its
    members have. It starts from centres drawn far apart (Arthur and Vassilvitskii, "k-means++", 2007).

    Args:
        descriptors: `(n, 32)`.
        count: Clusters at most.
        rng: Draws the start.

    Returns:
        Centres `(k, 32)` and the centre of each descriptor `(n,)`; k is less than `count` where the
        descriptors are too much alike.
    """
    bits = np.unpackbits(descriptors, axis=1).astype(np.float32)
    centres = _spread(bits, count, rng)
    labels = distances(bits, centres).argmin(axis=1)
    for _ in range(MAX_ROUNDS):
        kept = np.unique(labels)
        centres = np.stack([bits[labels == label].mean(axis=0, dtype=np.float64) >= 0.5 for label in kept])
        centres = centres.astype(np.float32)
        moved = distances(bits, centres).argmin(axis=1)
        settled = len(kept) == labels.max() + 1 and np.array_equal(moved, labels)
        labels = moved
        if settled:
            break
    kept, labels = np.unique(labels, return_inverse=True)
    return np.packbits(centres[kept].astype(np.uint8), axis=1), labels


def _spread(bits: Bits, count: int, rng: np.random.Generator) -> Bits:
    chosen = [int(rng.integers(len(bits)))]
    nearest = distances(bits, bits[chosen])[:, 0]
    while len(chosen) < count and nearest.any():
        # Whole numbers, so that the draw is the same on every machine.
        squared = np.cumsum(nearest.astype(np.int64) ** 2)
        chosen.append(int(np.searchsorted(squared, rng.integers(squared[-1]), side="right")))
        nearest = np.minimum(nearest, distances(bits, bits[chosen[-1:]])[:, 0])
    return bits[chosen]


def distances(bits: Bits, centres: Bits) -> Bits:
    """Hamming distances `(n, k)` of descriptors `(n, 256)` to centres `(k, 256)`, given as zeros and ones."""
    # Sums of whole numbers below 2**24 are exact in float32, in whatever order they are added.
    return np.asarray(
        bits.sum(axis=1)[:, None] + centres.sum(axis=1)[None] - 2 * (bits @ centres.T), np.float32
    )


def words_of(nodes: list[VocabularyNode], descriptors: Descriptors) -> NDArray[np.int64]:
    """Find the word of each descriptor `(n, 32)`, as the index `(n,)` of its node."""
    bits = np.unpackbits(descriptors, axis=1).astype(np.float32)
    words = np.zeros(len(descriptors), np.int64)
    pending = [(0, np.arange(len(descriptors)))]
    while pending:
        index, members = pending.pop()
        children = nodes[index].children
        if not children or not len(members):
            words[members] = index
            continue
        centres = np.unpackbits(np.stack([nodes[child].descriptor for child in children]), axis=1)
        nearest = distances(bits[members], centres.astype(np.float32)).argmin(axis=1)
        pending.extend((child, members[nearest == label]) for label, child in enumerate(children))
    return words


def weigh(nodes: list[VocabularyNode], per_image: list[Descriptors]) -> None:
    """Weigh each word by its inverse document frequency, log(images / images with the word)."""
    images_with = np.zeros(len(nodes), np.int64)
    for descriptors in per_image:
        images_with[np.unique(words_of(nodes, descriptors))] += 1
    for node, count in zip(nodes, images_with, strict=True):
        node.weight = float(np.log(len(per_image) / count)) if count and not node.children else 0.0


def render(nodes: list[VocabularyNode], branching: int, depth: int) -> str:
    """Write the tree as ORB-SLAM reads it.

    There is no newline at the end: its reader would take an empty line for one more child of the root.
    """
    lines = [f"{branching} {depth} {L1_NORM} {TF_IDF}"]
    for node in nodes[1:]:
        descriptor = " ".join(str(byte) for byte in node.descriptor.tolist())
        lines.append(f"{node.parent} {int(not node.children)} {descriptor} {node.weight:.6g}")
    return "\n".join(lines)
