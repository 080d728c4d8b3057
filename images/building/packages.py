# SPDX-License-Identifier: Apache-2.0
"""The packages in an image, as a CycloneDX document: those of Debian and those of Python."""

from __future__ import annotations

import json
import re
import uuid
from dataclasses import dataclass
from email.parser import HeaderParser
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cyclonedx.model.component import Component

    from building.recipes import Recipe
    from building.tools import Image

_DEBIAN = re.compile(r"var/lib/dpkg/(status|status\.d/[^/]+)")
_PYTHON = re.compile(r"(.*/)?[^/]+(\.dist-info/METADATA|\.egg-info/PKG-INFO)")
_RELEASE = "usr/lib/os-release"


@dataclass(frozen=True, order=True)
class Package:
    """A package of an image.

    Attributes:
        kind: As in a package URL: `deb` or `pypi`.
        name: Its name.
        version: Its version.
        machine: Architecture, of Debian's packages.
        license: SPDX expression, where the package gives one.
    """

    kind: str
    name: str
    version: str
    machine: str = ""
    license: str = ""


def wanted(path: str) -> bool:
    """Tell whether a file of an image says what packages there are."""
    return path == _RELEASE or bool(_DEBIAN.fullmatch(path) or _PYTHON.fullmatch(path))


def read(files: Iterable[tuple[str, bytes]]) -> tuple[list[Package], str]:
    """Return an image's packages in a fixed order, and its distribution, such as `debian-12`.

    Args:
        files: Path and content of the files that `wanted` names.
    """
    found: set[Package] = set()
    release: dict[str, str] = {}
    for path, content in files:
        text = content.decode("utf-8", "replace")
        if path == _RELEASE:
            release = dict(re.findall(r'^(\w+)="?([^"\n]*)"?$', text, re.MULTILINE))
        elif _DEBIAN.fullmatch(path):
            found.update(_debian(text))
        else:
            found.update(_python(text))
    return sorted(found), f"{release.get('ID', 'linux')}-{release.get('VERSION_ID', '')}".rstrip("-")


def _debian(text: str) -> Iterator[Package]:
    for paragraph in re.split(r"\n\n+", text.strip()):
        fields = dict(re.findall(r"^([\w-]+): (.*)$", paragraph, re.MULTILINE))
        if "Package" in fields and fields.get("Status", "install ok installed").endswith(" installed"):
            yield Package("deb", fields["Package"], fields.get("Version", ""), fields.get("Architecture", ""))


def _python(text: str) -> Iterator[Package]:
    fields = HeaderParser().parsestr(text)
    if fields["Name"]:
        name = re.sub(r"[-_.]+", "-", fields["Name"]).lower()
        yield Package("pypi", name, fields["Version"] or "", license=fields["License-Expression"] or "")


def document(recipe: Recipe, image: Image, packages: Iterable[Package], distribution: str) -> str:
    """Return the CycloneDX 1.6 document of an image as JSON.

    Args:
        recipe: How the image was built.
        image: What was built.
        packages: What is in it.
        distribution: As in `read`.
    """
    from cyclonedx.contrib.license.factories import LicenseFactory
    from cyclonedx.model import HashAlgorithm, HashType
    from cyclonedx.model.component import Component, ComponentType

    name, _, version = recipe.tag.partition(":")
    root = Component(
        name=name,
        version=version,
        type=ComponentType.CONTAINER,
        bom_ref=recipe.reference,
        description=recipe.title,
        licenses=[LicenseFactory().make_from_string(recipe.license)],
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=image.identity.removeprefix("sha256:"))],
    )
    return listing(root, f"{recipe.reference}@{image.identity}", packages, distribution)


def listing(root: Component, identity: str, packages: Iterable[Package], distribution: str = "") -> str:
    """Return the CycloneDX 1.6 document of something as JSON; it says no time: equal things have equal ones.

    Args:
        root: The thing.
        identity: What tells it from all others.
        packages: What is in it, or what it needs.
        distribution: As in `read`, where some are packages of one.
    """
    from cyclonedx.contrib.license.factories import LicenseFactory
    from cyclonedx.model.bom import Bom
    from cyclonedx.model.component import Component, ComponentType
    from cyclonedx.output.json import JsonV1Dot6
    from packageurl import PackageURL

    licences = LicenseFactory()
    parts = []
    for package in packages:
        debian = package.kind == "deb"
        qualifiers = {"arch": package.machine, "distro": distribution} if debian else {}
        namespace = distribution.partition("-")[0] if debian else None
        url = PackageURL(package.kind, namespace, package.name, package.version, qualifiers)
        parts.append(
            Component(
                name=package.name,
                version=package.version,
                type=ComponentType.LIBRARY,
                purl=url,
                bom_ref=url.to_string(),
                licenses=[licences.make_from_string(package.license)] if package.license else [],
            )
        )
    bom = Bom(components=parts, serial_number=uuid.uuid5(uuid.NAMESPACE_URL, identity))
    bom.metadata.component = root
    bom.register_dependency(root, parts)
    made = json.loads(JsonV1Dot6(bom).output_as_string())
    del made["metadata"]["timestamp"]
    return json.dumps(made, indent=1) + "\n"
