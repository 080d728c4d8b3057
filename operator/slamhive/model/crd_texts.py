# SPDX-License-Identifier: Apache-2.0
"""What `kubectl explain` says of fields whose models say it once for the whole record."""

from __future__ import annotations

TEXTS: dict[str, str] = {
    "OutputChange.frame": "Whose pose is written in this mode.",
    "OutputChange.stamp": "The instant that a pose and its stamp mean in this mode.",
    "OutputChange.poses": "Every frame or keyframes alone, in this mode.",
    "OutputChange.gravityAligned": "Whether the world's z axis points up in this mode.",
    "OutputChange.scale": "Whether the trajectory is metric in this mode.",
    "Usage.cpu": "CPU time.",
    "Usage.memory": "Memory.",
    "Usage.wallSeconds": "Time from the start of the algorithm's first process to its end, in s.",
    "Usage.throttledSeconds": "Time for which its limit held it back, in s; absent where nothing counts it.",
    "Usage.contendedSeconds": "CPU time that it waited for while others used its processors, in s.",
    "Usage.samples": "Number of samples that the figures rest on.",
    "Usage.source": "Whose account it is: the container's cgroup, or its processes in /proc.",
    "Usage.includesReader": "Whether reading the recording is part of the figures and can't be told apart.",
    "Usage.maxIncludesReader": "Whether maxCores includes the reading that was taken out elsewhere.",
    "Usage.readerCpuSeconds": "CPU time of reading the recording that was taken out, in s.",
    "CpuUsage.meanCores": "CPU seconds by second of wall time.",
    "CpuUsage.maxCores": "The most cores used in any window of 1 s.",
    "CpuUsage.seconds": "CPU time in s, reading of the recording taken out.",
    "CpuUsage.secondsPerDataSecond": "CPU seconds by second of recording; lockstep runs are compared by it.",
    "MemoryUsage.peakBytes": "Peak of the resident memory of all processes in bytes; see kind.",
    "MemoryUsage.meanBytes": "Mean of the same over time in bytes.",
    "MemoryUsage.anonymousPeakBytes": "Peak of memory without a file behind it in bytes, of the samples.",
    "MemoryUsage.workingSetPeakBytes": "Peak of the working set in bytes: page cache in use counts.",
    "MemoryUsage.kernelPeakBytes": "The kernel's own peak in bytes; a cgroup's counts page cache too.",
    "Frames.offered": "Frames that the algorithm was given.",
    "Frames.processed": "Frames that it took in.",
    "Frames.dropped": "Frames that it left out.",
    "TrajectoryInfo.poses": "Number of poses.",
    "TrajectoryInfo.durationSeconds": "Time from the first pose to the last, in s.",
    "TrajectoryInfo.sha256": "Checksum of the file.",
    "TrajectoryInfo.path": "The file, below the run's folder.",
    "Provenance.contentHash": "Hash of everything that decides the result: equal hashes, equal runs.",
    "Provenance.specHash": "Hash of the spec as far as it decides the result.",
    "Provenance.environment": "Hash of the program and what it links to.",
    "Provenance.imageID": "Digest of the image that ran.",
    "Provenance.datasetSha256": "Checksum of the recording that the variant was made of.",
    "Provenance.variant": "Name of the prepared form of the dataset.",
    "Provenance.node": "Machine that it ran on.",
    "Provenance.cpuModel": "Model of that machine's processor.",
    "Provenance.slamhiveVersion": "Version of SLAM Hive that measured it.",
    "Provenance.reusedFrom": "Run whose result was taken, as all that decides it is equal.",
}
"""Descriptions by model and field."""
KUBERNETES: dict[str, str] = {
    "apiVersion": "Version of the language.",
    "kind": "What the object is.",
}
"""Descriptions of the fields that every object has; of metadata the API server tells by itself."""
