# SPDX-License-Identifier: Apache-2.0
"""Contract of object storage: what every place does alike, and what is said where one does not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from buckets import S3, make_place

from slamhive.model.errors import InputError
from slamhive.storage.store import PART_BYTES, ObjectStorage, StorageUnavailable, StoreSettings

if TYPE_CHECKING:
    from pathlib import Path

    from buckets import Place


@pytest.mark.parametrize("size", [0, 1, PART_BYTES, 2 * PART_BYTES + 3])
def test_what_is_written_is_read(place: Place, size: int) -> None:
    store = place.store()
    content = bytes(range(256)) * (size // 256) + bytes(size % 256)
    store.write("runs/a/x", [content[at : at + PART_BYTES] for at in range(0, size, PART_BYTES)])
    assert store.read("runs/a/x") == content
    assert b"".join(store.pieces("runs/a/x", 0, size)) == content
    assert b"".join(store.pieces("runs/a/x", size // 2, size)) == content[size // 2 :]
    assert store.sizes("runs/a") == {"x": size}


def test_objects_are_told_apart_by_their_folders(place: Place) -> None:
    store = place.store()
    for name in ("runs/a/x", "runs/a/b/y", "runs/ab/z"):
        store.write(name, [name.encode()])
    assert store.sizes("runs/a") == {"x": 8, "b/y": 10}
    assert store.sizes("runs/none") == {}
    store.check()


def test_an_object_that_is_not_there_is_told_from_a_store_that_is_not(place: Place) -> None:
    with pytest.raises(FileNotFoundError):
        place.store().read("runs/none")
    gone = ObjectStorage(
        StoreSettings(url=f"{place.url.replace('lab-', 'no-')}-none/x", options=place.options)
    )
    with pytest.raises(StorageUnavailable, match=r"there is no folder|NoSuchBucket"):
        gone.check()


def test_a_write_that_breaks_off_leaves_no_object(place: Place) -> None:
    def breaking() -> Any:
        yield bytes(PART_BYTES)
        yield bytes(PART_BYTES)
        raise RuntimeError

    store = place.store()
    with pytest.raises(RuntimeError):
        store.write("runs/a/x", breaking())
    if place.kind == "s3":  # a folder keeps what came until then; the note is what counts
        assert store.sizes("runs/a") == {}


def test_wrong_keys_are_told_in_the_store_s_own_words(tmp_path: Path) -> None:
    s3 = S3()
    place = make_place("s3", tmp_path / "bucket", s3)
    s3.demand_keys(after="0")
    try:
        with pytest.raises(StorageUnavailable, match=r"s3://lab-.*Access ?Key"):
            place.store().check()
        with pytest.raises(StorageUnavailable, match=r"Access ?Key"):
            place.store().write("x", [b"x"])
    finally:
        s3.demand_keys(after="inf")
        s3.stop()


def test_a_store_that_is_away_is_told_and_found_again(tmp_path: Path) -> None:
    s3 = S3()
    place = make_place("s3", tmp_path / "bucket", s3)
    store = place.store()
    store.write("x", [b"x"])
    s3.stop()
    with pytest.raises(StorageUnavailable, match=f"{s3.port}"):
        store.read("x")
    s3.start()
    assert store.read("x") == b"x"
    s3.stop()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("url: bucket", "url: expected a URL|expected a URL such as s3://bucket/folder"),
        ("[1]", "expected a URL"),
        ("{url: s3://b, keys: 1}", "keys"),
        ("url: {", "not valid YAML"),
    ],
)
def test_wrong_settings_name_file_and_field(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "store.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as error:
        StoreSettings.read(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("nonsense://bucket", "nonsense"),
        ("s3://user:word@bucket/x", "password"),
        ("s3://bucket::file://x", "is a chain"),
    ],
)
def test_a_url_that_can_not_be_used_is_refused(url: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        ObjectStorage(StoreSettings(url=url))


def test_a_secret_s_files_are_options(tmp_path: Path) -> None:
    (tmp_path / "store.yaml").write_text("{url: s3://b/x, options: {endpoint_url: http://e}}")
    secret = tmp_path / "secret"
    (secret / "..data").mkdir(parents=True)
    (secret / "..data" / "key").write_text("k\n")
    (secret / "key").symlink_to("..data/key")
    found = StoreSettings.read(tmp_path / "store.yaml", secret)
    assert found.options == {"endpoint_url": "http://e", "key": "k"}
    with pytest.raises(InputError, match="secret can't be read"):
        StoreSettings.read(tmp_path / "store.yaml", tmp_path / "none")
