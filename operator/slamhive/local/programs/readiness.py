# SPDX-License-Identifier: Apache-2.0
"""Readiness of this machine for ``slamhive doctor``: packages, engines, cgroups, cores, archive.

Each look returns rows and changes nothing that stays. Some ask other programs and may take long: whoever
calls them bounds their time.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.archive import keeping
from slamhive.archive.connection import file_of, shown
from slamhive.local.programs.cores import whole_cores, within
from slamhive.local.programs.engines import ContainerChoice, find_engine
from slamhive.local.programs.executors import unavailable
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.base import plural
from slamhive.model.errors import InputError, SlamHiveError, sentence
from slamhive.model.extras import how_to_install
from slamhive.model.readiness import ReadinessRow, State, limited, missing, there
from slamhive.monitor.measuring.cgroup import make_run_cgroup
from slamhive.monitor.measuring.hierarchy import cpu_quota, own_hierarchies
from slamhive.monitor.measuring.machine import SYSTEM, cpu_model, governors, turbo
from slamhive.monitor.measuring.processes import identify
from slamhive.monitor.measuring.sources import read_number

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home

_OLDEST = (3, 11)
_PER_RUN_BYTES = 4 << 30
"""Memory that a run is allowed unless its sweep says otherwise."""
_ENOUGH_DISK, _LITTLE_DISK = 20 << 30, 1 << 30
_BUSY = 0.25
"""Load of a core by other work from which figures suffer."""
_TRIAL_BYTES = 256 << 20
_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(?:\[[\w,-]+\])?\s*(?P<clauses>[^;]*)(?:;(?P<marker>.*))?$")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([\w-]+)['\"]")
_LEAST = re.compile(r">=\s*([\d.]+)")
_GOOD_FOR = {
    "cluster": "submit, status, logs, cancel, fetch and run --on cluster",
    "operator": "running the operator from here",
    "dashboard": "slamhive dashboard",
    "postgresql": "archives in PostgreSQL",
    "parquet": "tables as Parquet",
    "pandas": "slamhive.results() and export as pandas frames",
    "polars": "slamhive.results() as polars frames",
    "plot": "figures",
    "maps": "comparing maps",
    "uv": "environments of algorithms in a third of the time",
}


def python() -> ReadinessRow:
    """Look at the Python that runs this."""
    version = ".".join(map(str, sys.version_info[:3]))
    found = f"{version}, {sys.executable}"
    if sys.version_info[:2] >= _OLDEST:
        return there("Python", found, needed=True)
    least = ".".join(map(str, _OLDEST))
    return missing(
        "Python", found, "slamhive does not start", f"install Python {least} or newer", needed=True
    )


def packages(distribution: str = "slamhive") -> Iterator[ReadinessRow]:
    """Look at the packages that slamhive needs, and those that its extras bring."""
    try:
        stated = metadata.requires(distribution) or []
    except metadata.PackageNotFoundError:
        yield ReadinessRow(
            *("packages", State.UNKNOWN, f"{distribution} runs from a folder, not as an installed package"),
            costs="nobody can say which packages it needs",
            helps="make install in its checkout",
        )
        return
    wanted: dict[str, list[str]] = {"": []}
    for line in stated:
        extra = _EXTRA.search(line)
        wanted.setdefault(extra[1] if extra else "", []).append(line)
    own = wanted.pop("")
    lacking = _lacking(own)
    if lacking:
        found = f"{len(lacking)} of {len(own)} are not there: {', '.join(lacking)}"
        helps = f"pip install --upgrade {distribution}, or make install in a checkout"
        yield missing("packages", found, "slamhive fails where it needs them", helps, needed=True)
    else:
        yield there("packages", f"all {len(own)}", needed=True)
    poor = {name: short for name, lines in sorted(wanted.items()) if (short := _lacking(lines))}
    full = [name for name in sorted(wanted) if name not in poor]
    if full:
        yield there("extras", ", ".join(full))
    for name, short in poor.items():
        costs = f"no {_GOOD_FOR[name]}" if name in _GOOD_FOR else f"nothing of the extra {name}"
        yield missing(f"extra {name}", f"without {', '.join(short)}", costs, how_to_install(name))


def _lacking(lines: Iterable[str]) -> list[str]:
    """Return the requirements that are not met here, with the version that is there."""
    found = []
    for line in lines:
        match = _REQUIREMENT.match(line)
        if match is None or _of_elsewhere(match["marker"] or ""):
            continue
        least = _LEAST.search(match["clauses"])
        try:
            version = metadata.version(match["name"])
        except metadata.PackageNotFoundError:
            found.append(match["name"])
            continue
        if least and _numbers(version) < _numbers(least[1]):
            found.append(f"{match['name']} {version} (needs {least[1]})")
    return found


def _of_elsewhere(marker: str) -> bool:
    """Tell whether a requirement is for other machines or versions of Python: those we leave to pip."""
    return bool(_EXTRA.sub("", marker).strip(" ()and"))


def _numbers(version: str) -> list[int]:
    parts = [int(part) for part in re.findall(r"\d+", version.partition("+")[0])]
    # 2 and 2.0 are one version.
    while parts and not parts[-1]:
        parts.pop()
    return parts


def algorithms(workshop: Workshop) -> ReadinessRow:
    """Look at which algorithms of the catalog can run on this machine."""
    entries = sorted(workshop.algorithm_entries.items())
    reasons = [name for name, entry in entries if unavailable(entry) is not None]
    found = f"{len(entries) - len(reasons)} of {len(entries)} can run here"
    if not reasons:
        return there("algorithms", found)
    return limited(
        "algorithms",
        f"{found}; not {', '.join(reasons)}",
        "runs of those fail (AlgorithmUnavailable)",
        "slamhive algorithm list says what each of them needs",
    )


def engines() -> Iterator[ReadinessRow]:
    """Look for podman and docker, and whether they can hold a container to its limits."""
    usable = 0
    rows = []
    for choice in (ContainerChoice.PODMAN, ContainerChoice.DOCKER):
        try:
            engine = find_engine(choice)
        except Unavailable as error:
            said = str(error).removeprefix("needs a container engine").lstrip(":, ")
            rows.append((choice.value, said.removeprefix("and ")))
            continue
        usable += 1
        how = "without root" if engine.rootless else "as root"
        yield there(choice.value, f"{how}; holds containers to their cores, memory and processes")
    costs = "algorithms that have an image alone do not run here, the others as processes of your user"
    # One engine is enough: what the other one lacks then costs nothing.
    for name, said in rows:
        if usable:
            yield ReadinessRow(name, State.UNNEEDED, said)
        else:
            found, _, helps = said.partition(": ")
            yield missing(name, found, costs, helps)


def accounting() -> Iterator[ReadinessRow]:
    """Look whether a run gets a cgroup of its own, by making one, and whether the kernel keeps its limit."""
    versions = sorted({tree.version for tree in own_hierarchies()})
    mounted = f"version {' and '.join(map(str, versions))}" if versions else "none is mounted"
    delegated = "run slamhive in a unit of its own: systemd-run --user --scope -p Delegate=yes slamhive run …"
    own = identify(os.getpid())
    # No file says whether one can be made, so one is, and removed again.
    group = make_run_cgroup(own) if own is not None else None
    if group is None:
        yield limited(
            "cgroup accounting",
            f"{mounted}; none can be made for a run",
            "CPU and memory are read from /proc, ten times a second: what lives shorter is in the sum of CPU "
            "seconds, not in the peaks",
            delegated,
        )
        yield limited(
            "memory limit",
            "kept by looking ten times a second",
            "a run that fills memory within a tenth of a second may take other programs with it",
            delegated,
        )
        return
    try:
        kept = group.limit(_TRIAL_BYTES, None)
        source = group.source.name
    finally:
        group.remove()
    yield there("cgroup accounting", f"{mounted}; a run gets one of its own ({source})")
    if kept:
        yield there("memory limit", "kept by the kernel")
    else:
        yield limited(
            "memory limit",
            "the kernel refuses one; kept by looking ten times a second",
            "a run that fills memory within a tenth of a second may take other programs with it",
            delegated,
        )


def cores() -> ReadinessRow:
    """Look at the cores that runs may have."""
    all_of_them, quota = whole_cores(), cpu_quota()
    usable = within(all_of_them, quota)
    threads = sum(map(len, all_of_them))
    found = f"{len(usable)}, {threads} threads, {cpu_model()}"
    costs, helps = [], []
    if len(usable) < len(all_of_them):
        costs.append(
            f"{len(all_of_them) - len(usable)} of {len(all_of_them)} cores lie idle: the quota of this "
            f"container or unit is {quota:g} processors"
        )
        helps.append("raise its CPU quota")
    if len(usable) < 2:
        costs.append("one run at a time, which shares its core with all else")
        helps.append("measure load on a machine with several cores")
    if costs:
        return limited("cores", found, "; ".join(costs), "; ".join(helps))
    return there("cores", f"{found}; {plural(len(usable), 'run')} of one core at a time")


def clock(folder: Path = Path(SYSTEM)) -> ReadinessRow:
    """Look at what changes the processor's clock: governor and turbo."""
    words, clocked_up = governors(str(folder)), turbo(str(folder))
    if not words and clocked_up is None:
        return ReadinessRow(
            *("clock", State.UNKNOWN, "the kernel tells neither governor nor turbo, as in virtual machines"),
            costs="other machines on the same processor may change CPU seconds: compare repetitions",
        )
    parts = [f"governor {', '.join(words)}"] if words else []
    parts += [] if clocked_up is None else [f"turbo {'on' if clocked_up else 'off'}"]
    costs, helps = [], []
    if words and words != ["performance"]:
        helps.append("cpupower frequency-set --governor performance")
        costs.append("the clock follows the load")
    if clocked_up:
        costs.append("a run beside others is clocked lower than one alone")
        helps.append(
            f"echo 1 > {folder / 'intel_pstate/no_turbo'}"
            if (folder / "intel_pstate").is_dir()
            else f"echo 0 > {folder / 'cpufreq/boost'}"
        )
    if not costs:
        return there("clock", ", ".join(parts))
    told = f"{', and '.join(costs)}: CPU seconds and wall times vary by that"
    return limited("clock", ", ".join(parts), told, f"as root: {'; '.join(helps)}")


def load(now: Sequence[float] | None = None, count: int | None = None) -> ReadinessRow:
    """Look how busy the machine is.

    Args:
        now: loads of the last 1, 5 and 15 minutes.
        count: logical processors.
    """
    loads = os.getloadavg() if now is None else now
    processors = (os.cpu_count() or 1) if count is None else count
    found = f"{loads[0]:.1f} of {processors} processors in the last minute, {loads[2]:.1f} in 15 minutes"
    if loads[0] < _BUSY * processors:
        return there("load", found)
    return limited(
        "load",
        found,
        "runs that share their cores with other work say nothing of load: tables leave their cores and wall "
        "seconds out",
        "end what else runs here, or leave it a core: slamhive run -j N",
    )


def memory(facts: Path = Path("/proc/meminfo")) -> ReadinessRow:
    """Look at how much memory is free for runs."""
    numbers = {
        line.partition(":")[0]: int(line.split()[1]) << 10
        for line in facts.read_text(encoding="utf-8").splitlines()
        if len(line.split()) > 1
    }
    total, free = numbers.get("MemTotal", 0), numbers.get("MemAvailable", 0)
    limits = [read_number(f"{tree.directory}/memory.max") for tree in own_hierarchies() if tree.version == 2]
    allowed = min((limit for limit in limits if limit is not None), default=None)
    found = f"{size_text(free)} of {size_text(total)} free"
    if allowed is not None and allowed < free:
        found, free = f"{found}, {size_text(allowed)} allowed to this container or unit", allowed
    if free >= _PER_RUN_BYTES:
        return there(
            "memory", f"{found}; runs may take {size_text(_PER_RUN_BYTES)} each unless told otherwise"
        )
    return limited(
        "memory",
        found,
        f"a run is allowed {size_text(_PER_RUN_BYTES)} unless told otherwise: one that takes it fills memory",
        "template.spec.resources.memory in the sweep says less",
    )


def disk(home: Home) -> ReadinessRow:
    """Look whether there is room for runs, and whether it can be written."""
    place = home.path
    # A home that is not made yet will be on the disk of the first folder above it.
    while not place.exists() and place != place.parent:
        place = place.parent
    if not (place.is_dir() and os.access(place, os.W_OK | os.X_OK)):
        helps = "set SLAMHIVE_HOME to a folder of your own"
        return missing("disk", f"{place} can't be written", "nothing can be run or kept", helps, needed=True)
    free = shutil.disk_usage(place).free
    found = f"{size_text(free)} free at {home.path}"
    helps = "set SLAMHIVE_HOME to another disk, or remove what is not needed there"
    if free < _LITTLE_DISK:
        return missing("disk", found, "runs and datasets fail for want of room", helps, needed=True)
    if free < _ENOUGH_DISK:
        return limited("disk", found, "datasets and their variants take gigabytes each", helps, needed=True)
    return there("disk", found, needed=True)


def archive(home: Home) -> ReadinessRow:
    """Look the archive through: version, size, and whether each record is sound."""
    url = home.archive_url
    try:
        file = file_of(url)
        if file is not None and not file.exists():
            return there("archive", f"none at {file} yet; the first run makes it", needed=True)
        findings = keeping.check(url)
    except (SlamHiveError, OSError) as error:
        said = str(error) if isinstance(error, SlamHiveError) else sentence(error)
        if isinstance(error, InputError) and "archive upgrade" in said:
            costs = "commands that only read it refuse it"
            return limited("archive", said, costs, "slamhive archive upgrade", needed=True)
        helps = "slamhive archive check says more"
        return missing("archive", said, "no run can be kept, nothing be shown", helps, needed=True)
    size = f", {size_text(file.stat().st_size)}" if file is not None else ""
    numbers = {name: findings.counts.get(f"{name}s", 0) for name in ("run", "sweep")}
    counts = ", ".join(f"{count:,} {name}{'' if count == 1 else 's'}" for name, count in numbers.items())
    found = f"{shown(url)}: {counts}{size}"
    if findings.faults:
        told = f"{found}; {len(findings.faults)} faults, the first: {findings.faults[0]}"
        helps = "slamhive archive check; slamhive archive restore puts a backup in its place"
        return missing("archive", told, "what is damaged is not shown", helps, needed=True)
    return there("archive", f"{found}, sound", needed=True)


def unneeded() -> ReadinessRow:
    """Say what is often asked for and takes no part."""
    return ReadinessRow(
        *("browser, TeX", State.UNNEEDED, "pages are shown by any browser, also of another machine"),
        helps="tables for papers are compiled wherever the paper is",
    )


def size_text(count: float) -> str:
    """Return a number of bytes as people read it."""
    return f"{count / (1 << 30):.1f} GiB" if count >= 1 << 30 else f"{count / (1 << 20):.1f} MiB"
