# SPDX-License-Identifier: Apache-2.0
"""The vocabulary: a tree that ORB-SLAM can read, equal for equal images and seed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive.data.inspecting.vocabulary import (
    VocabularyNode,
    cluster,
    grow,
    render,
    train_vocabulary,
    training_images,
    weigh,
)
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from conftest import Maker

PUBLISHED = Path(__file__).parents[2] / "images" / "algorithms" / "orb-slam3" / "vocabulary.txt"


def textured(count: int, seed: int = 3) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, 256, (count, 16, 20), dtype=np.uint8)
    return [np.kron(block, np.ones((8, 8), np.uint8)) for block in blocks]


def parse(text: str) -> tuple[list[int], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Header, parents, leaf flags, descriptors and weights."""
    header, *lines = text.split("\n")
    rows = [line.split() for line in lines]
    assert {len(row) for row in rows} == {35}
    numbers = np.array([[int(word) for word in row[:34]] for row in rows])
    weights = np.array([float(row[34]) for row in rows])
    return [int(word) for word in header.split()], numbers[:, 0], numbers[:, 1], numbers[:, 2:], weights


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, int]:
    path = tmp_path_factory.mktemp("vocabulary") / "vocabulary.txt"
    words = train_vocabulary(textured(8), path, branching=3, depth=4, features=200)
    return path.read_text(), words


def test_the_tree_is_one_that_orb_slam_reads(trained: tuple[str, int]) -> None:
    header, parents, leaves, descriptors, weights = parse(trained[0])
    assert header == [3, 4, 0, 0]
    identifiers = np.arange(1, len(parents) + 1)
    assert (parents < identifiers).all()
    counts = np.bincount(parents, minlength=len(parents) + 1)
    assert counts.max() <= 3
    assert ((counts[1:] == 0) == (leaves == 1)).all()
    assert descriptors.min() >= 0
    assert descriptors.max() <= 255
    assert (weights[leaves == 0] == 0).all()
    assert leaves.sum() == trained[1] <= 3**4


def test_there_is_no_line_too_many(trained: tuple[str, int]) -> None:
    assert not trained[0].endswith("\n")


def test_no_node_is_deeper_than_asked(trained: tuple[str, int]) -> None:
    _, parents, *_ = parse(trained[0])
    depths = [0]
    for parent in parents:
        depths.append(depths[parent] + 1)
    assert max(depths) == 4


def test_equal_images_and_seed_give_an_equal_file(tmp_path: Path, trained: tuple[str, int]) -> None:
    path = tmp_path / "vocabulary.txt"
    train_vocabulary(iter(textured(8)), path, branching=3, depth=4, features=200)
    assert path.read_text() == trained[0]
    train_vocabulary(textured(8), path, branching=3, depth=4, features=200, seed=1)
    assert path.read_text() != trained[0]


def test_clusters_are_found() -> None:
    rng = np.random.default_rng(5)
    centres = rng.integers(0, 256, (4, 32), dtype=np.uint8)
    truth = np.repeat(np.arange(4), 50)
    bits = np.unpackbits(centres[truth], axis=1)
    bits ^= rng.random(bits.shape) < 0.05
    found, labels = cluster(np.packbits(bits, axis=1), 4, rng)
    assert {tuple(row) for row in found.tolist()} == {tuple(row) for row in centres.tolist()}
    assert len({(a, b) for a, b in zip(truth.tolist(), labels.tolist(), strict=True)}) == 4


def test_descriptors_that_are_all_alike_make_no_clusters() -> None:
    found, labels = cluster(np.full((9, 32), 7, np.uint8), 4, np.random.default_rng(0))
    assert found.tolist() == [[7] * 32]
    assert labels.tolist() == [0] * 9


def test_a_word_weighs_by_how_few_images_have_it() -> None:
    low, high = np.zeros((1, 32), np.uint8), np.full((1, 32), 255, np.uint8)
    nodes = grow(np.concatenate([low, high]), 2, 1, np.random.default_rng(0))
    weigh(nodes, [np.concatenate([low, high]), low, low, low])
    weights = {int(node.descriptor[0]): node.weight for node in nodes[1:]}
    assert weights == {0: 0.0, 255: pytest.approx(np.log(4))}


def test_renders_a_node_a_line() -> None:
    nodes = [
        VocabularyNode(0, np.zeros(32, np.uint8), [1]),
        VocabularyNode(0, np.arange(32, dtype=np.uint8), weight=1.5),
    ]
    assert render(nodes, 2, 1) == f"2 1 0 0\n0 1 {' '.join(map(str, range(32)))} 1.5"


@pytest.mark.parametrize(
    ("branching", "depth", "images", "sentence"),
    [
        (1, 6, 8, "branching 1 and depth 6 are not allowed"),
        (21, 6, 8, "branching 21 and depth 6 are not allowed"),
        (4, 11, 8, "branching 4 and depth 11 are not allowed"),
        (4, 6, 0, "hold 0 features, too few"),
    ],
)
def test_refuses_what_makes_no_vocabulary(
    tmp_path: Path, branching: int, depth: int, images: int, sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        train_vocabulary(textured(images), tmp_path / "v.txt", branching=branching, depth=depth)
    assert not list(tmp_path.iterdir())


def test_every_third_image_is_taken(maker: Maker) -> None:
    start = 1_600_000_000 * 10**9
    for index in range(7):
        maker.add("/camera", start + index, maker.image(bytes([index] * 6), (2, 3), "mono8", 3, big=False))
    path = maker.write()
    assert [image[0, 0] for image in training_images(path, "/camera")] == [0, 3, 6]
    with pytest.raises(InputError, match="has no topic /left, only /camera"):
        list(training_images(path, "/left"))


def test_the_vocabulary_that_comes_with_orb_slam_is_whole() -> None:
    header, parents, leaves, _, weights = parse(PUBLISHED.read_text())
    assert header == [4, 6, 0, 0]
    assert (parents < np.arange(1, len(parents) + 1)).all()
    assert 2000 < leaves.sum() <= 4**6
    assert (weights[leaves == 1] > 0).all()
