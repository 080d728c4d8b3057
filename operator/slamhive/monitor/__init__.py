# SPDX-License-Identifier: Apache-2.0
"""CPU and memory of an algorithm, of its process tree alone, and the supervisor that runs and ends it.

`python -m slamhive.monitor --spec FILE` supervises one run on a workstation: one process per run, the
parent of the algorithm, so that nothing of the run outlives it. `python -m slamhive.monitor.sidecar` sits in
the algorithm's pod beside it and attaches to its container. Both read the same sources and reckon alike.

Standard library alone, and little of it: this process starts once per run and its start counts.
"""

from slamhive.monitor.measuring.accounting import (
    Accounting,
    Contention,
    MeasuredCpu,
    MeasuredMemory,
    MeasuredUsage,
)
from slamhive.monitor.measuring.cgroup import RunCgroup, make_run_cgroup, sweep_stale_cgroups
from slamhive.monitor.measuring.proc import ProcSource
from slamhive.monitor.measuring.processes import ProcessIdentity, identify
from slamhive.monitor.measuring.sources import (
    CgroupV1Source,
    CgroupV2Source,
    Sample,
    UsageSource,
    cgroup_source_at,
)
from slamhive.monitor.programs.orphans import ProcessRecord, end_orphans, find_orphans
from slamhive.monitor.spec import SidecarSpec, SpecError, SupervisorSpec
from slamhive.monitor.summary import Reason, RunSummary

__all__ = [
    "Accounting",
    "CgroupV1Source",
    "CgroupV2Source",
    "Contention",
    "MeasuredCpu",
    "MeasuredMemory",
    "MeasuredUsage",
    "ProcSource",
    "ProcessIdentity",
    "ProcessRecord",
    "Reason",
    "RunCgroup",
    "RunSummary",
    "Sample",
    "SidecarSpec",
    "SpecError",
    "SupervisorSpec",
    "UsageSource",
    "cgroup_source_at",
    "end_orphans",
    "find_orphans",
    "identify",
    "make_run_cgroup",
    "sweep_stale_cgroups",
]
