# SPDX-License-Identifier: Apache-2.0
"""The list of an image's packages: what is read from its files, and the CycloneDX document."""

from __future__ import annotations

import json
from pathlib import Path

from building import packages
from building.packages import Package
from building.recipes import recipes
from building.tools import Image

IMAGE = Image("sha256:" + "ab" * 32, 1, {})
STATUS = b"""\
Package: libc6
Status: install ok installed
Architecture: amd64
Version: 2.36-9+deb12u10
Description: C library
 Package: nothing

Package: gone
Status: deinstall ok config-files
Architecture: all
Version: 1.0

Package: zlib1g
Status: install ok installed
Architecture: amd64
Version: 1:1.2.13.dfsg-1
"""
FILES = {
    "usr/lib/os-release": b'PRETTY_NAME="Debian"\nID=debian\nVERSION_ID="12"\n',
    "var/lib/dpkg/status": STATUS,
    "opt/venv/lib/python3.11/site-packages/Ruamel.yaml-0.19.1.dist-info/METADATA": (
        b"Metadata-Version: 2.4\nName: Ruamel.yaml\nVersion: 0.19.1\nLicense-Expression: MIT\n\nName: no\n"
    ),
    "opt/venv/lib/python3.11/site-packages/odd-1.dist-info/METADATA": b"\xff\xfe nothing of the kind",
}


def test_packages_of_debian_and_python_are_read() -> None:
    found, distribution = packages.read(FILES.items())
    assert found == [
        Package("deb", "libc6", "2.36-9+deb12u10", "amd64"),
        Package("deb", "zlib1g", "1:1.2.13.dfsg-1", "amd64"),
        Package("pypi", "ruamel-yaml", "0.19.1", license="MIT"),
    ]
    assert distribution == "debian-12"


def test_only_what_tells_of_packages_is_read() -> None:
    assert all(packages.wanted(path) for path in FILES)
    for path in ("etc/passwd", "var/lib/dpkg/status-old", "x/a.dist-info/RECORD", "home/METADATA"):
        assert not packages.wanted(path)


def test_the_document_is_valid_and_names_what_is_in_the_image() -> None:
    from cyclonedx.schema import SchemaVersion  # takes two seconds
    from cyclonedx.validation.json import JsonStrictValidator

    found, distribution = packages.read(FILES.items())
    text = packages.document(recipes()["evaluator"], IMAGE, found, distribution)
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    read = json.loads(text)
    assert read["metadata"]["component"]["name"] == "slamhive/evaluator"
    assert {part["purl"] for part in read["components"]} == {
        "pkg:deb/debian/libc6@2.36-9%2Bdeb12u10?arch=amd64&distro=debian-12",
        "pkg:deb/debian/zlib1g@1:1.2.13.dfsg-1?arch=amd64&distro=debian-12",
        "pkg:pypi/ruamel-yaml@0.19.1",
    }


def test_every_algorithm_has_a_licence_that_the_document_takes() -> None:
    from cyclonedx.schema import SchemaVersion  # takes two seconds
    from cyclonedx.validation.json import JsonStrictValidator

    for recipe in recipes().values():
        text = packages.document(recipe, IMAGE, [], "debian-12")
        assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None, recipe.name
        assert Path(recipe.dockerfile).is_file()
