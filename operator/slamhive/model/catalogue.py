# SPDX-License-Identifier: Apache-2.0
"""Catalogue of public datasets: families of sequences, where each is to be had, and what is in it.

A family is a YAML file of the package `slamhive.catalogue`, or of a folder in ``$SLAMHIVE_CATALOGUE``. Who
lists them reads plain values; a sequence is validated when it is used.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import yaml
from pydantic import Field, ValidationError, model_validator

from slamhive.model.algorithm import RelativePath
from slamhive.model.base import HTTPS, Model, Scalar, Sha256, explain, optional, plain_name
from slamhive.model.errors import InputError, ManifestError, UnknownNameError
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FOLDERS = "SLAMHIVE_CATALOGUE"
"""Variable with further folders of families, separated as in PATH."""
BAG = "Bag"
"""Layout of recordings that need no importer."""
_FIELD = re.compile(r"\{(\w+)\}")


class Part(Model):
    """A file that sequences come from: an archive, or a file of the recording itself.

    In all texts ``{sequence}`` and the words of a sequence stand for what they are.
    """

    url: str | None = optional("Where it is.", pattern=HTTPS)
    mirrors: list[str] = Field(default_factory=list, description="Other addresses of it.")
    manual: str | None = optional(
        "The page from which it is to be fetched by hand, after a login or a click.", pattern=HTTPS
    )
    how: str | None = optional("What is to be done there, where it isn't a login or a click.")
    file: RelativePath | None = optional(
        "Its name, or its place among what is unpacked, where it isn't the last part of the url. What is "
        "fetched by hand may be a folder."
    )
    shared: bool = Field(
        default=False, description="Whether it holds other sequences, too, also such as aren't listed."
    )
    size: int | None = optional("Bytes.", gt=0)
    sha256: Sha256 | None = optional("Checksum.")
    piece_bytes: int = Field(default=0, ge=0, description="Size of the pieces whose checksums are known.")
    pieces: list[Sha256] = Field(default_factory=list, description="Checksums of its pieces, in order.")
    members: list[str] | None = optional(
        "Of an archive: what is taken of it, a!b being the member b of the archive a in it; an empty text is "
        "all. Absent: the file is taken as it is."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.url is None) == (self.manual is None):
            raise ValueError("give either url or manual")
        if bool(self.pieces) != bool(self.piece_bytes):
            raise ValueError("pieces and pieceBytes belong together")
        if self.how is not None and self.manual is None:
            raise ValueError("how: only of what is fetched by hand, which has manual")
        if self.manual is not None and self.file is None:
            raise ValueError("file: what is fetched by hand needs its name")
        return self

    @property
    def name(self) -> str:
        """Return the name of the file."""
        return self.file or str(self.url).split("?")[0].rstrip("/").rpartition("/")[2]


class SequenceSpec(Model):
    """Entry of one sequence in its family's file: what it has beside what the family says."""

    parts: list[str] | None = optional("Names of the parts that it comes from; absent: all.")
    words: dict[str, str] = Field(default_factory=dict, description="Words for the texts of its parts.")
    sizes: dict[str, int] = Field(default_factory=dict, description="Sizes of parts of its own, bytes.")
    sha256: dict[str, Sha256] = Field(default_factory=dict, description="Checksums of parts of its own.")
    dataset: dict[str, Any] = Field(
        default_factory=dict, description="Fields that its manifest has of its own."
    )
    attributes: dict[str, Scalar] = Field(default_factory=dict, description="To select by.")


class FamilyHead(Model):
    """A family of sequences, which one publisher gives away in one layout."""

    name: str = Field(pattern=r"^[a-z0-9]([-a-z0-9]*[a-z0-9])?$", description="First word of its datasets.")
    title: str = Field(description="Name for people.")
    homepage: str = Field(pattern=HTTPS, description="Page that describes it.")
    license: str = Field(description="Licence of the data.")
    cite: str = Field(description="Publication to cite with results.")
    unverified: str = Field(default="", description="Claims that nobody has verified yet, one sentence.")
    layout: str = Field(description="An importer's layout, or Bag.")
    sensors: dict[str, SensorType] = Field(description="Kinds of the sensors by their names.")
    folder: str = Field(default="", description="The folder that is imported of what is unpacked.")
    sequence: str | None = optional("Which sequence in it the importer takes.")
    parts: dict[str, Part] = Field(min_length=1, description="Files and archives that sequences come from.")
    dataset: dict[str, Any] = Field(
        default_factory=dict, description="Fields of the manifests beside what is imported; of Bag all."
    )
    attributes: dict[str, Scalar] = Field(default_factory=dict, description="To select all by.")


@dataclass(frozen=True)
class Family:
    """A family as its file has it.

    Attributes:
        head: All but the sequences.
        rows: What is said of each sequence, plain, by name.
        source: The file.
    """

    head: FamilyHead
    rows: Mapping[str, Mapping[str, Any]]
    source: Path

    @property
    def name(self) -> str:
        """Return the family's name."""
        return self.head.name

    def attributes(self, sequence: str) -> dict[str, Scalar]:
        """Return the attributes that a sequence is selected by."""
        return self.head.attributes | dict(self.rows[sequence].get("attributes") or {})

    def size(self, sequence: str) -> int | None:
        """Return the bytes of what belongs to a sequence alone; None where that isn't known."""
        sizes = self.rows[sequence].get("sizes") or {}
        return sum(sizes.values()) if sizes else None

    def sequence_of(self, name: str) -> CatalogueSequence:
        """Return a sequence.

        Raises:
            UnknownNameError: There is none of that name.
            ManifestError: What is said of it doesn't follow the model.
        """
        if name not in self.rows:
            raise UnknownNameError("sequence", name, self.rows, f"catalogue {self.name}")
        try:
            own = SequenceSpec.model_validate(self.rows[name])
            return CatalogueSequence.of(self, name, own)
        except ValidationError as error:
            raise _mistakes(error, f"{self.source}: sequences.{name}") from None


@dataclass(frozen=True)
class CatalogueSequence:
    """A sequence with all that is to be known to have it here.

    Attributes:
        family: Its family.
        name: Its name.
        parts: What it comes from, all words filled in, by their names.
        shared: Names of the parts that other sequences come from, too.
        folder: What is imported of what is unpacked.
        choice: Which sequence in it the importer takes.
        dataset: What its manifest has beside what is imported.
        attributes: To select by.
    """

    family: FamilyHead
    name: str
    parts: Mapping[str, Part]
    shared: frozenset[str]
    folder: str
    choice: str | None
    dataset: Mapping[str, Any]
    attributes: Mapping[str, Scalar]

    @classmethod
    def of(cls, family: Family, name: str, own: SequenceSpec) -> CatalogueSequence:
        """Fill in what a family says of one of its sequences.

        Raises:
            ManifestError: It names a part or a word that isn't there.
        """
        head, where = family.head, f"{family.source}: sequences.{name}"
        words = own.words | {"sequence": name}
        chosen = list(head.parts) if own.parts is None else own.parts
        parts, shared = {}, set()
        for title in chosen:
            if title not in head.parts:
                raise ManifestError(f"{where}: parts: {UnknownNameError('part', title, head.parts)}")
            plain = head.parts[title].as_json()
            filled = _filled(plain, words, where) | {
                key: value[title]
                for key, value in (("size", own.sizes), ("sha256", own.sha256))
                if title in value
            }
            parts[title] = Part.model_validate(filled)
            if head.parts[title].shared or _has_others(family, name, title, words):
                shared.add(title)
        return cls(
            family=head,
            name=name,
            parts=parts,
            shared=frozenset(shared),
            folder=_filled(head.folder, words, where),
            choice=_filled(head.sequence, words, where),
            dataset=_filled(_merged(head.dataset, own.dataset), words, where),
            attributes=head.attributes | own.attributes,
        )

    @property
    def title(self) -> str:
        """Return family and sequence as users write them."""
        return f"{self.family.name}/{self.name}"


def _has_others(family: Family, name: str, title: str, words: Mapping[str, str]) -> bool:
    """Tell whether other sequences of a family come from the same file as one of them."""
    part = family.head.parts[title]
    used = set(_FIELD.findall(part.url or str(part.file)))
    rows = [row for other, row in family.rows.items() if other != name]
    chosen = [row for row in rows if title in (row.get("parts") or family.head.parts)]
    return "sequence" not in used and any(
        all((row.get("words") or {}).get(word) == words.get(word) for word in used) for row in chosen
    )


def dataset_name(family: str, sequence: str) -> str:
    """Return the name of a sequence's dataset where none is chosen.

    >>> dataset_name("euroc", "MH_01_easy")
    'euroc-mh-01-easy'
    """
    return plain_name(f"{family}-{sequence}")


def catalogue_folders() -> list[Path]:
    """Return the folders of families: the package's own, then those of ``$SLAMHIVE_CATALOGUE``."""
    own = Path(__file__).resolve().parent.parent / "catalogue"
    return [own, *(Path(folder) for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder)]


def load_catalogue(folders: Sequence[Path] | None = None) -> dict[str, Family]:
    """Return all families by name.

    Raises:
        ManifestError: A file doesn't follow the model, or two families or sequences have one name.
        InputError: A folder can't be read.
    """
    families: dict[str, Family] = {}
    for folder in catalogue_folders() if folders is None else folders:
        if not folder.is_dir():
            raise InputError(f"{FOLDERS}: {folder} is no folder")
        for path in sorted(folder.glob("*.yaml")):
            family = load_family(path, path.stat().st_mtime_ns)
            if family.name in families:
                raise ManifestError(
                    f"{path}: a family {family.name!r} is in {families[family.name].source}, too; give it "
                    "another name"
                )
            families[family.name] = family
    return families


def find_sequence(title: str) -> CatalogueSequence:
    """Return a sequence by what users write, ``FAMILY/SEQUENCE``.

    Raises:
        InputError: There is none, or the catalogue can't be read.
    """
    family, slash, sequence = title.partition("/")
    if not slash or not sequence:
        raise InputError(f"catalogue: {title!r}: expected FAMILY/SEQUENCE, such as euroc/MH_01_easy")
    for folder in catalogue_folders():
        path = folder / f"{family}.yaml"
        if path.is_file():  # one file instead of all of them
            found = load_family(path, path.stat().st_mtime_ns)
            if found.name == family:
                return found.sequence_of(sequence)
    families = load_catalogue()
    if family not in families:
        raise UnknownNameError("family", family, families, "catalogue")
    return families[family].sequence_of(sequence)


def sequence_attributes(family: str, sequence: str) -> dict[str, Scalar]:
    """Return the attributes of a sequence; none where the catalogue doesn't know it."""
    for folder in catalogue_folders():
        path = folder / f"{family}.yaml"
        if "/" not in family and path.is_file():
            found = load_family(path, path.stat().st_mtime_ns)
            return found.attributes(sequence) if sequence in found.rows else {}
    return {}


@lru_cache(maxsize=256)
def load_family(path: Path, _changed: int) -> Family:
    """Return a family; a file that hasn't changed is read once.

    Raises:
        ManifestError: The file doesn't follow the model.
        InputError: It can't be read.
    """
    try:
        plain = yaml.load(path.read_text(encoding="utf-8"), _CatalogueLoader)  # noqa: S506 - a safe loader
        rows = plain.pop("sequences")
        rows = {str(name): row or {} for name, row in rows.items()}
        family = Family(FamilyHead.model_validate(plain), rows, path)
    except ValidationError as error:
        raise _mistakes(error, str(path)) from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except (yaml.YAMLError, AttributeError, KeyError, TypeError) as error:
        raise ManifestError(f"{path}: expected a family with sequences: {error}") from None
    names: dict[str, str] = {}
    for name in rows:
        same = names.setdefault(dataset_name(family.name, name), name)
        if same != name:
            raise ManifestError(f"{path}: sequences: {same} and {name} make datasets of one name")
    return family


class _CatalogueLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads YAML safely, fast where libyaml is there; a key that is there twice is a mistake."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value]
        if len(set(keys)) < len(keys):
            twice = next(key for key in keys if keys.count(key) > 1)
            raise yaml.MarkedYAMLError(
                problem=f"{twice!r} is there twice", problem_mark=node.start_mark, context=None
            )
        made: dict[Any, Any] = super().construct_mapping(node, deep)
        return made


def _mistakes(error: ValidationError, where: str) -> ManifestError:
    lines = [f"{where}: {'.'.join(map(str, one['loc']))}: {explain(one)}" for one in error.errors()]
    return ManifestError("\n".join(lines))


def _filled(value: Any, words: Mapping[str, str], where: str) -> Any:
    """Put words into all texts of plain values."""
    if isinstance(value, str):

        def word(match: re.Match[str]) -> str:
            if match[1] not in words:
                raise ManifestError(f"{where}: words: {match[1]} is missing, for {value!r}")
            return words[match[1]]

        return _FIELD.sub(word, value)
    if isinstance(value, dict):
        return {key: _filled(item, words, where) for key, item in value.items()}
    if isinstance(value, list):
        return [_filled(item, words, where) for item in value]
    return value


def _merged(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in own.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merged(merged[key], value) if both else value
    return merged
