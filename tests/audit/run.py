# SPDX-License-Identifier: Apache-2.0
"""Asker for advisories about all that is pinned: ``make audit``.

Python packages are asked for by pip-audit, JavaScript that lies in the repository or checks it by npm audit.
Every package and version must have an answer: where a service can't be reached or doesn't know one, that is
an error.

Exit codes: 0 all was checked and nothing is known; 1 there are advisories; 2 something could not be checked.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PINNED = [ROOT / "constraints.txt", ROOT / "constraints-demo.txt", ROOT / "images" / "hatchling.txt"]
PINNED += sorted(path for path in (ROOT / "images").rglob("requirements.txt") if not path.is_symlink())
PINNED += [*sorted((ROOT / "operator/slamhive/playback").glob("*.txt")), ROOT / "tests/reporting/rerun.txt"]
MANIFESTS = [ROOT / "operator/slamhive/dashboard/static/vendor/manifest.json"]
MANIFESTS += [ROOT / "tests/dashboard_pages/vendor/manifest.json"]
LOCK = ROOT / "tests/javascript/package-lock.json"
SECONDS = 900

Package = tuple[str, str]
"""Name and version."""


class NotChecked(Exception):  # noqa: N818 - a state that is told
    """Something could not be checked; the text says what and why."""


def python_packages() -> list[Package]:
    """Return all pinned Python packages, with each version of each."""
    found = {
        (re.sub(r"[-_.]+", "-", name).lower(), version)
        for path in PINNED
        for name, version in re.findall(r"^([\w.-]+)==([\w.]+)", path.read_text(), re.MULTILINE)
    }
    return sorted(found)


def scripts() -> list[Package]:
    """Return the packages whose JavaScript lies in the repository, those inside of others too, and npm's."""
    locked = json.loads(LOCK.read_text())["packages"]
    found = {(path.removeprefix("node_modules/"), entry["version"]) for path, entry in locked.items() if path}
    for path in MANIFESTS:
        for entry in json.loads(path.read_text())["files"]:
            if re.search(r"\.m?js(\.txt)?$", entry["file"]):
                found.add((entry["package"], entry["version"]))
                found |= set(entry.get("inside", {}).items())
    return sorted(found)


def audit_python(wanted: list[Package], service: str) -> list[str]:
    """Return the known advisories on Python packages, a line each.

    Raises:
        NotChecked: pip-audit failed, or has no answer for some.
    """
    found: list[str] = []
    rest = wanted
    while rest:  # a list for pip-audit holds one version of a package
        batch = dict(reversed(rest))
        rest = [package for package in rest if batch[package[0]] != package[1]]
        found += _audit_batch(batch, service)
    return found


def _audit_batch(batch: dict[str, str], service: str) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        asked = Path(folder) / "requirements.txt"
        asked.write_text("".join(f"{name}=={version}\n" for name, version in batch.items()))
        command = ["pip-audit", "--requirement", str(asked), "--no-deps", "--disable-pip", "--format", "json"]
        answer = _json([*command, "--progress-spinner", "off", "--vulnerability-service", service])
    told = {item["name"]: item for item in answer.get("dependencies", [])}
    missing = [
        f"{name} {version}: {told.get(name, {}).get('skip_reason', 'no answer')}"
        for name, version in batch.items()
        if "vulns" not in told.get(name, {}) or told[name].get("version") != version
    ]
    if missing:
        raise NotChecked(f"{len(missing)} of {len(batch)} Python packages, the first {missing[0]}")
    return [
        f"{name} {version}: {one['id']}, mended in {', '.join(one.get('fix_versions') or ['no version yet'])}"
        for name, version in batch.items()
        for one in told[name]["vulns"]
    ]


def audit_scripts(wanted: list[Package]) -> list[str]:
    """Return the known advisories on JavaScript packages, a line each.

    Raises:
        NotChecked: npm failed, or checked another number of packages.
    """
    names = dict(wanted)
    root: dict[str, Any] = {"name": "vendored", "version": "0.0.0"}
    packages = {"": root | {"dependencies": names}}
    packages |= {f"node_modules/{name}": {"version": version} for name, version in wanted}
    lock = root | {"lockfileVersion": 3, "packages": packages}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "package.json").write_text(json.dumps(root | {"dependencies": names}))
        (Path(folder) / "package-lock.json").write_text(json.dumps(lock))
        answer = _json(["npm", "audit", "--json", "--package-lock-only"], folder)
    if "metadata" not in answer:
        why = answer.get("message") or answer.get("error")
        raise NotChecked(f"JavaScript packages: npm audit says {why}")
    checked = answer["metadata"]["dependencies"]["total"]
    if checked != len(wanted):
        raise NotChecked(f"JavaScript packages: npm audit checked {checked} of {len(wanted)}")
    return [
        f"{name} {names.get(name, '')}: {one['title']}, {one['url']}"
        for name, found in answer["vulnerabilities"].items()
        for one in found["via"]
        if isinstance(one, dict)
    ]


def _json(command: list[str], folder: str | None = None) -> dict[str, Any]:
    if shutil.which(command[0]) is None:
        raise NotChecked(f"{command[0]} is not installed")
    try:
        result = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False, timeout=SECONDS
        )
    except subprocess.TimeoutExpired:
        raise NotChecked(f"{command[0]} had no answer after {SECONDS} s") from None
    try:
        found = json.loads(result.stdout)
    except ValueError:
        last = (result.stderr.strip().splitlines() or [f"exit code {result.returncode}"])[-1]
        raise NotChecked(f"{command[0]} failed: {last[:300]}") from None
    if not isinstance(found, dict):
        raise NotChecked(f"{command[0]} wrote no object")
    return found


def main() -> int:
    """Check all, and return the exit code."""
    parser = argparse.ArgumentParser(prog="tests/audit/run.py", description=__doc__.partition("\n")[0])
    parser.add_argument("--service", choices=("pypi", "osv"), default="pypi", help="whom pip-audit asks")
    service = parser.parse_args().service
    python, vendored = python_packages(), scripts()
    known: list[str] = []
    unchecked: list[str] = []
    for check in (partial(audit_python, python, service), partial(audit_scripts, vendored)):
        try:
            known += check()
        except NotChecked as error:
            unchecked.append(str(error))
    for line in known:
        print(line)
    for line in unchecked:
        print(f"not checked: {line}", file=sys.stderr)
    if not known and not unchecked:
        print(f"nothing is known of {len(python)} Python and {len(vendored)} JavaScript packages")
    return 2 if unchecked else 1 if known else 0


if __name__ == "__main__":
    sys.exit(main())
