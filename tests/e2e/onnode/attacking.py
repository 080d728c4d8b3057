# SPDX-License-Identifier: Apache-2.0
"""An algorithm that reaches for its monitor: text for ``python3 -c``, told by a parameter what to try."""

from __future__ import annotations

from typing import Any

PROGRAM = r"""
import ctypes, json, os, pathlib, re, resource, time
libc = ctypes.CDLL(None, use_errno=True)
run = pathlib.Path(os.environ["SLAMHIVE_RUN"])
act = re.search(r"^  act: (\S+)$", (run / "config.yaml").read_text(), re.MULTILINE).group(1)
def monitors():
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            words = pathlib.Path(f"/proc/{name}/cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if words[:1] == [b"python3"] and b"slamhive.monitor.sidecar" in words:
            yield int(name)
def use(seconds):
    while time.process_time() < seconds: sum(range(1000))
def call(result):
    if result == -1: raise OSError(ctypes.get_errno(), "")
(pid,) = monitors()
inside = f"/proc/{pid}/root"
(run / "output" / "trajectory.txt").write_text("".join(f"{k / 10} {k} 0 0 0 0 0 1\n" for k in range(100)))
use(1.0)
if act == "look":
    place = ctypes.create_string_buffer(8)
    vector = (ctypes.c_void_p * 2)(ctypes.addressof(place), 8)
    start = int(pathlib.Path("/proc/self/maps").read_text().split("-")[0], 16)
    remote = (ctypes.c_void_p * 2)(start, 8)
    tries = {
        "mem": lambda: open(f"/proc/{pid}/mem", "r+b"),
        "root": lambda: os.listdir(f"{inside}/slamhive-run"),
        "summary": lambda: open(f"{inside}/slamhive-run/summary.json", "w"),
        "message": lambda: open(f"{inside}/dev/termination-log", "w"),
        "fd": lambda: os.listdir(f"/proc/{pid}/fd"),
        "environ": lambda: open(f"/proc/{pid}/environ", "rb").read(),
        "attach": lambda: call(libc.ptrace(16, pid, 0, 0)),
        "readv": lambda: call(libc.process_vm_readv(pid, vector, 1, remote, 1, 0)),
        "writev": lambda: call(libc.process_vm_writev(pid, vector, 1, remote, 1, 0)),
        "getfd": lambda: call(libc.syscall(438, os.pidfd_open(pid), 1, 0)),
        "oom": lambda: open(f"/proc/{pid}/oom_score_adj", "w"),
    }
    for name, attempt in tries.items():
        try:
            attempt()
            print("OPEN", name, flush=True)
        except OSError as error:
            print("closed", name, error.strerror or error.errno, flush=True)
elif act == "claim":
    (run / "output" / "metrics.json").write_text(json.dumps({"readerCpuSeconds": 0.99 * time.process_time()}))
elif act == "stop":
    os.kill(pid, 19); time.sleep(0.5); os.kill(pid, 18); time.sleep(0.5)
elif act == "limit":
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (200, 200)); time.sleep(0.5)
elif act == "renice":
    os.setpriority(os.PRIO_PROCESS, pid, 19); time.sleep(0.5)
elif act == "kill":
    forged = '{"reason": null, "usage": {"cpu": {"seconds": 0.001}, "memory": {}}}'
    os.kill(pid, 9)
    end = time.monotonic() + 20
    while time.monotonic() < end:
        for other in monitors():
            folder = f"/proc/{other}/root"
            try:
                pathlib.Path(f"{folder}/slamhive-run/summary.json").write_text(forged)
                print("wrote", flush=True)
            except OSError:
                pass
"""

SUSPECT = {
    "claim": "its reader claims",
    "stop": "made to go on, by a signal",
    "limit": "the monitor's limits were changed",
    "renice": "the monitor's priority was changed",
}
"""Remarks on the figures of each try."""

ACTS = ["look", *SUSPECT, "kill"]


def algorithm(image: str) -> dict[str, Any]:
    """Return the Algorithm, in an image that has python3."""
    return {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Algorithm",
        "metadata": {"name": "attacking"},
        "spec": {
            "version": "1",
            "image": image,
            "command": ["python3", "-c", PROGRAM],
            "modes": [{"name": "lidar", "roles": ["lidar"]}],
            "recording": ["Rosbag1"],
            "parameters": {"act": {"type": "String", "default": "look", "values": ACTS}},
            "output": {"frame": "lidar"},
            "paces": ["Lockstep"],
        },
    }
