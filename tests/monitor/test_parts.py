# SPDX-License-Identifier: Apache-2.0
"""The parts by themselves: specification, accounting, log, cgroup files as other machines have them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.contract.lines import telling_line
from slamhive.monitor import (
    Accounting,
    CgroupV2Source,
    Contention,
    ProcessIdentity,
    ProcSource,
    Sample,
    SpecError,
    SupervisorSpec,
    cgroup_source_at,
    identify,
    make_run_cgroup,
    sweep_stale_cgroups,
)
from slamhive.monitor.measuring import accounting, proc, processes
from slamhive.monitor.measuring.hierarchy import Hierarchy, own_hierarchies, unified_parents
from slamhive.monitor.outcome import ProgramEnding, judge
from slamhive.monitor.playing import played_to_the_end
from slamhive.monitor.programs import output
from slamhive.monitor.programs.contained import explain
from slamhive.monitor.programs.log import BoundedLog, clean_tail
from slamhive.monitor.programs.output import OutputMeter

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SPEC = SupervisorSpec(
    argv=("a", "b"),
    cwd="/",
    env={"A": "1"},
    log_path="/l",
    usage_path="/u",
    summary_path="/s",
    process_path="/p",
    cpus=(0, 1),
    timeout_seconds=1.5,
)


def test_spec_round_trip() -> None:
    assert SupervisorSpec.from_json(SPEC.to_json()) == SPEC
    assert json.loads(SPEC.to_json())["timeoutSeconds"] == 1.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"argv": []}, "argv must be a list of strings that begins with a program, not ()"),
        ({"argv": ["a\0"]}, "argv must be"),
        ({"cwd": "here"}, "cwd must be an absolute path, not 'here'"),
        ({"env": {"A": 1}}, "env must be a map from names to strings"),
        ({"cpus": [-1]}, "cpus must be a list of processor numbers"),
        ({"timeoutSeconds": 0}, "timeoutSeconds must be a number of seconds above 0 or null, not 0"),
        ({"timeoutSeconds": float("nan")}, "timeoutSeconds must be"),
        ({"memoryLimitBytes": 1.5}, "memoryLimitBytes must be a whole number above 0 or null"),
        ({"intervalSeconds": 0.001}, "intervalSeconds must be a number of seconds from 0.01 to 10"),
        ({"cgroup": "v2"}, "cgroup must be auto or none, not 'v2'"),
        ({"colour": 1}, "unknown field colour; known are argv, "),
    ],
)
def test_spec_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError) as caught:
        SupervisorSpec.from_json(json.dumps({**json.loads(SPEC.to_json()), **change}))
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("text", "message"), [("{", "not JSON"), ("[]", "a JSON object"), ("{}", "argv is missing")]
)
def test_command_refuses(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "spec.json"
    path.write_text(text)
    command = [sys.executable, "-m", "slamhive.monitor", "--spec", str(path)]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert told.returncode == 2
    assert message in told.stderr
    assert told.stderr.count("\n") == 1


def _account(samples: list[tuple[float, float]]) -> Any:
    account = Accounting(100.0)
    for time, cpu in samples:
        account.add(Sample(100.0 + time, cpu, 0, 0, 0))
    return account.usage("proc").cpu


@pytest.mark.parametrize(
    ("samples", "mean", "most"),
    [
        ([(0.5, 0.25)], 0.5, 0.5),
        ([(0.25 * k, 0.5 * 0.25 * k) for k in range(1, 13)], 0.5, 0.5),
        # Busy from 1 s to 2 s with two cores, in windows of 1 s on the samples' grid.
        ([(0.25 * k, 2 * min(max(0.25 * k - 1, 0), 1)) for k in range(1, 17)], 0.5, 2.0),
        # Half a second of two cores is one core over any window of a second.
        ([(0.1 * k, 2 * min(max(0.1 * k - 1, 0), 0.5)) for k in range(1, 31)], 1 / 3, 1.0),
        # A late sample: its window begins between two samples.
        ([(1.0, 0.0), (1.6, 0.6), (2.3, 1.3)], 1.3 / 2.3, 1.0),
    ],
)
def test_windows(samples: list[tuple[float, float]], mean: float, most: float) -> None:
    cpu = _account(samples)
    assert (cpu.mean_cores, cpu.max_cores) == pytest.approx((mean, most))


def test_memory_is_weighted_by_time_and_ends_with_the_algorithm() -> None:
    account = Accounting(0.0)
    for time, memory in ((0.1, 100), (1.1, 400), (2.1, 200)):
        account.add(Sample(time, 0.0, 3 * memory, memory // 2, memory))
    account.add(Sample(4.1, 0.0, 9999, 9999, 9999), final=True)
    memory = account.usage("cgroup-v1", kernel_peak=5000).memory
    assert (memory.peak_bytes, memory.anonymous_peak_bytes, memory.kernel_peak_bytes) == (400, 200, 5000)
    assert memory.working_set_peak_bytes == 1200
    assert memory.mean_bytes == pytest.approx((100 + 400 + 2 * 200) / 4)
    assert account.usage("cgroup-v1", largest_process=500).memory.peak_bytes == 500


def test_memory_that_no_sample_saw_is_unknown_and_not_zero() -> None:
    account = Accounting(0.0)
    account.add(Sample(0.004, 0.003, 0, 0, 0), final=True)
    memory = account.usage("cgroup-v2", kernel_peak=5000).memory
    assert (memory.peak_bytes, memory.mean_bytes, memory.kernel_peak_bytes) == (None, None, 5000)
    assert (memory.anonymous_peak_bytes, memory.working_set_peak_bytes) == (None, None)
    # Its only process has ended, and the kernel tells how large it was.
    memory = account.usage("proc", largest_process=700).memory
    assert (memory.peak_bytes, memory.mean_bytes) == (700, 700)


@pytest.mark.parametrize(
    ("others", "waited", "expected"), [(0.5, 0.3, 0.3), (0.2, 0.9, 0.2), (0.01, 0.9, 0.0), (0.9, 0.0, 0.0)]
)
def test_contention_takes_both(
    monkeypatch: pytest.MonkeyPatch, others: float, waited: float, expected: float
) -> None:
    class Source:
        total = 0.0

        def pressure(self) -> float:
            return self.total

    busy = iter([10.0, 10.0 + 0.4 + others])
    monkeypatch.setattr(accounting, "_busy_seconds", lambda _names: next(busy))
    source: Any = Source()
    contention = Contention([0], source, 0.0)
    source.total = waited
    contention.add(1.0, 0.4)
    assert contention.seconds == pytest.approx(expected)


@pytest.mark.parametrize(
    ("allowed", "seconds", "said"),
    [
        (600, 554.4, "it took more than 600 s, most of them waiting for processors that others used"),
        (600, 290, "it took more than 600 s"),
        (3, 2.9, "it took more than 3 s"),
    ],
)
def test_a_timeout_says_when_others_made_the_run_slow(allowed: float, seconds: float, said: str) -> None:
    source: Any = SimpleNamespace(pressure=lambda: 0.0)
    contention = Contention([0], source, 0.0)
    contention.seconds = seconds
    assert contention.overrun(allowed) == said


@pytest.mark.parametrize("sizes", [[10], [5000], [100] * 100, [1] * 20000, [9000, 3, 9000]])
def test_bounded_log(tmp_path: Path, sizes: list[int]) -> None:
    path = tmp_path / "log"
    stream = b"".join(bytes([65 + k % 26]) * size for k, size in enumerate(sizes))
    log = BoundedLog(str(path), 4096)
    for k, size in enumerate(sizes):
        log.write(bytes([65 + k % 26]) * size)
    log.close()
    kept = path.read_bytes()
    if len(stream) <= 4096:
        assert kept == stream
    else:
        message = f"\n[... {len(stream) - 4096} bytes left out ...]\n".encode()
        assert kept == stream[:2048] + message + stream[-2048:]


def test_tail_is_short() -> None:
    assert clean_tail(b"".join(b"%d\n" % k for k in range(100))).split("\n") == [
        str(k) for k in range(80, 100)
    ]
    assert len(clean_tail("é".encode() * 10000).encode()) <= 4096
    assert clean_tail("a\u202eb\x9bc\td".encode() + b"\xff") == "abc\td\ufffd"


def test_out_of_memory_of_the_machine() -> None:
    assert judge(ProgramEnding(status=9, machine_oom_kills=1)).reason == "OutOfMemory"
    assert judge(ProgramEnding(status=9)).reason == "AlgorithmFailed"
    assert judge(ProgramEnding(status=0, machine_oom_kills=1)).reason is None


@pytest.mark.parametrize(
    ("status", "last_line", "message"),
    [
        (9, "[ WARN] [1600.25]: gyroscope bias initial calibration", "ended by signal 9 (SIGKILL)"),
        (6, "[INFO] [1600.25] [slam]: map saved", "ended by signal 6 (SIGABRT)"),
        (6, "  what():  no map", "ended by signal 6 (SIGABRT):   what():  no map"),
        (1 << 8, "[ WARN] [1600.25]: no settings", "exit code 1: [ WARN] [1600.25]: no settings"),
        (6, "[ERROR] [1600.25]: no memory", "ended by signal 6 (SIGABRT): [ERROR] [1600.25]: no memory"),
    ],
)
def test_reports_of_a_node_are_not_why_a_signal_ended_it(status: int, last_line: str, message: str) -> None:
    assert judge(ProgramEnding(status=status, last_line=last_line)).message == message


@pytest.mark.parametrize(
    ("log", "line"),
    [
        ("std::bad_alloc\n[ INFO] [1600.1]: 12 features\n", "std::bad_alloc"),
        ("[ INFO] [1600.1]: a\n[ WARN] [1600.2]: b\n", "[ WARN] [1600.2]: b"),
        ("a\n[ WARN] no stamp, so not of ROS\n", "[ WARN] no stamp, so not of ROS"),
        ("a\n[FATAL] [1600.2] [slam]: b\n", "[FATAL] [1600.2] [slam]: b"),
    ],
)
def test_the_telling_line_is_no_report_where_there_is_another(log: str, line: str) -> None:
    assert telling_line(log) == line


CUT = """Traceback (most recent call last):
  File "/a/adapter.py", line 41, in track
    return self._slam.track_stereo(
           ^^^^^^^^^^^^^^^^^^^^^^^^^
"""
CRASH = """Fatal Python error: Segmentation fault

Current thread 0x00007f (most recent call first):
  File "/a/adapter.py", line 41 in track

Current thread's C stack trace (most recent call first):
  Binary file "python", at _Py_DumpStack+0x2d [0x5]
"""
THROWN = "terminate called after throwing an instance of 'std::runtime_error'\n  what():  no vocabulary\n"


@pytest.mark.parametrize(
    ("log", "message"),
    [
        (CUT, "ended by signal 11 (SIGSEGV)"),
        ("12 features\n" + CUT, "ended by signal 11 (SIGSEGV): 12 features"),
        (
            CUT
            + "KeyError: 'a'\n\nDuring handling of the above exception, another exception occurred:\n\n"
            + CUT,
            "ended by signal 11 (SIGSEGV): KeyError: 'a'",
        ),
        (CRASH, "ended by signal 11 (SIGSEGV): Fatal Python error: Segmentation fault"),
        (THROWN, "ended by signal 11 (SIGSEGV): what():  no vocabulary"),
    ],
    ids=["nothing else", "a word before", "two", "faulthandler", "C++"],
)
def test_no_line_of_source_or_of_a_stack_stands_behind_a_signal(log: str, message: str) -> None:
    assert judge(ProgramEnding(status=11, last_line=telling_line(log))).message == message


def test_who_was_played_to_the_end_may_abort_when_told_to_go() -> None:
    outcome = judge(ProgramEnding(status=6, last_line="Aborted", was_played=True))
    assert outcome == (None, 6, None, "")
    assert judge(ProgramEnding(status=9, group_oom_kills=1, was_played=True)).reason == "OutOfMemory"


@pytest.mark.parametrize(
    ("report", "ended"),
    [({"state": "Ended"}, True), ({"state": "Playing"}, False), ([], False), (None, False)],
)
def test_playing_has_ended_when_the_player_says_so(tmp_path: Path, report: object, ended: bool) -> None:
    if report is not None:
        (tmp_path / "playback.json").write_text(json.dumps(report))
    assert played_to_the_end(str(tmp_path)) is ended
    assert played_to_the_end(None) is False


NOBODY = 1 << 22  # the first number that no kernel gives to a process
V2 = {
    "cpu.stat": "usage_usec 2500000\nuser_usec 1\nthrottled_usec 1500000\n",
    "memory.current": "1000000\n",
    "memory.stat": "anon 300000\nfile 600000\nkernel 5\ninactive_anon 7\ninactive_file 400000\n",
    "memory.peak": "1200000\n",
    "cgroup.procs": f"{NOBODY}\n{NOBODY + 1}\n",
    "cpu.pressure": "some avg10=0.00 avg60=0.00 avg300=0.00 total=250000\nfull avg10=0.00 total=0\n",
}
V1 = {
    "cpuacct/cpuacct.usage": "2500000000\n",
    "cpuacct/cgroup.procs": f"{NOBODY}\n{NOBODY + 1}\n",
    "memory/memory.usage_in_bytes": "1000000\n",
    "memory/memory.max_usage_in_bytes": "1200000\n",
    "memory/memory.stat": "cache 1\nrss 9\ninactive_file 9\ntotal_rss 300000\ntotal_inactive_file 400000\n",
}


def _write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@pytest.mark.parametrize(("name", "files"), [("cgroup-v2", V2), ("cgroup-v1", V1)])
def test_sources_attach_where_a_container_shows_its_cgroup(
    tmp_path: Path, name: str, files: dict[str, str]
) -> None:
    _write(tmp_path, files)
    source = cgroup_source_at(str(tmp_path))
    assert source is not None
    assert source.name == name
    assert source.read()[1:] == (2.5, 600000, 300000, 0)
    assert list(source.processes()) == [NOBODY, NOBODY + 1]
    assert source.kernel_peak() == 1200000
    assert source.pressure() == (0.25 if name == "cgroup-v2" else None)
    source.close()


def test_version_2_without_controllers_is_no_source(tmp_path: Path) -> None:
    _write(tmp_path, {name: text for name, text in V2.items() if not name.startswith("memory")})
    assert cgroup_source_at(str(tmp_path)) is None
    with pytest.raises(FileNotFoundError):
        CgroupV2Source(str(tmp_path))


def test_no_cgroup_where_none_can_be_made(tmp_path: Path) -> None:
    trees = [
        Hierarchy(1, frozenset({"memory"}), str(tmp_path), str(tmp_path)),
        Hierarchy(1, frozenset({"cpuacct"}), str(tmp_path), str(tmp_path / "missing")),
        Hierarchy(2, frozenset(), str(tmp_path), str(tmp_path)),
    ]
    assert make_run_cgroup(ProcessIdentity(1, 2), trees) is None
    assert list(tmp_path.iterdir()) == []


def test_parents_in_the_unified_tree() -> None:
    tree = Hierarchy(2, frozenset(), "/sys/fs/cgroup", "/sys/fs/cgroup/user.slice/a.scope")
    assert unified_parents([tree]) == [
        "/sys/fs/cgroup/user.slice/a.scope",
        "/sys/fs/cgroup/user.slice",
        "/sys/fs/cgroup",
    ]


@pytest.fixture
def owner() -> ProcessIdentity:
    me = identify(os.getpid())
    assert me is not None
    if (group := make_run_cgroup(me)) is None:
        pytest.skip("no cgroup with CPU and memory can be made here")
    group.remove()
    return me


@pytest.mark.parametrize("frozen", [False, True], ids=["running", "frozen"])
def test_stale_cgroups_are_swept_with_what_runs_in_them(owner: ProcessIdentity, frozen: bool) -> None:
    """A supervisor may be killed between freezing its run and thawing it."""
    stale = make_run_cgroup(replace_start(owner))
    living = make_run_cgroup(owner)
    assert stale is not None
    assert living is not None
    process = subprocess.Popen(["sleep", "600"])
    for directory in stale.directories:
        with open(f"{directory}/cgroup.procs", "w") as file:  # noqa: PTH123
            file.write(str(process.pid))
    for directory in stale.directories if frozen else ():
        if os.path.exists(f"{directory}/freezer.state"):  # noqa: PTH110
            with open(f"{directory}/freezer.state", "w") as file:  # noqa: PTH123
                file.write("FROZEN")
    try:
        assert set(sweep_stale_cgroups()) >= set(stale.directories)
        assert process.wait(50) == -9
        assert [os.path.exists(path) for path in living.directories] == [True] * len(living.directories)  # noqa: PTH110
    finally:
        assert living.remove()


def replace_start(process: ProcessIdentity) -> ProcessIdentity:
    """The process that had this pid before."""
    return process._replace(start=process.start - 1)


def test_groups_of_another_pid_namespace_are_left_alone(owner: ProcessIdentity) -> None:
    parent = next(tree.directory for tree in own_hierarchies() if tree.version == 1 or not tree.controllers)
    foreign = f"{parent}/slamhive-{owner.pid}-1-7"
    os.mkdir(foreign)  # noqa: PTH102
    try:
        assert foreign not in sweep_stale_cgroups()
    finally:
        os.rmdir(foreign)  # noqa: PTH106


@pytest.mark.parametrize("listed", [True, False])
def test_proc_source_of_another_process(
    monkeypatch: pytest.MonkeyPatch, wait_for: Callable[..., Any], listed: bool
) -> None:
    if not listed:
        for module in (processes, proc):
            monkeypatch.setattr(module, "kernel_lists_children", lambda: False)
    thread = "t = threading.Thread(target=lambda: subprocess.run(['cat']))\nt.start()\nt.join()"
    code = f"import threading, subprocess\n{thread}"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE) as process:
        source = ProcSource(process.pid)
        try:
            wait_for(lambda: source.read() and len(source.processes()) == 2)
            sample = source.read()
            assert sample.cpu > 0
            assert 0 < sample.anonymous < sample.working_set
            assert sample.resident > sample.anonymous
            assert process.stdin is not None
            process.stdin.close()
            process.wait(50)
            assert source.read().working_set == 0
            assert source.read().cpu >= sample.cpu
        finally:
            source.close()
    with pytest.raises(ProcessLookupError):
        ProcSource(process.pid)


def test_spec_is_frozen() -> None:
    assert replace(SPEC, data_seconds=2.0).data_seconds == 2.0
    with pytest.raises(AttributeError):
        SPEC.cwd = "/tmp"  # type: ignore[misc]


def volume(free: int, files: int = 0, *, total: int = 1000, used: int = 0) -> SimpleNamespace:
    """Return the statistics of a file system, in MiB and files, in the form of `os.statvfs`."""
    return SimpleNamespace(
        f_blocks=total, f_bfree=total - used, f_bavail=free, f_frsize=1 << 20, f_files=1000, f_favail=files
    )


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (volume(500, 900), None),
        (volume(15, 900), None),
        (volume(5, 900), "the volume has 5 MiB left, and its output takes 10 MiB"),
        (volume(500, 11), None),
        (volume(500, 9), "the volume has room for 9 files, and its output has 10"),
    ],
)
def test_who_fills_the_volume_is_ended_before_it_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: SimpleNamespace, told: str | None
) -> None:
    """All runs of a namespace share it: those that wrote more than what is left go first."""
    for name in range(10):
        (tmp_path / str(name)).write_bytes(b"1" * (1 << 20))
    monkeypatch.setattr(output.os, "statvfs", lambda _: found)
    stop = OutputMeter(str(tmp_path), 1 << 40, 100).problem(1.0, [])
    assert (stop.message if stop else None) == told


def test_who_hides_what_it_holds_is_judged_by_the_volume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(path: str) -> list[str]:
        raise PermissionError(path)

    monkeypatch.setattr(output.os, "statvfs", lambda _: volume(500, 900))
    meter = OutputMeter(str(tmp_path), 5 << 20, 100)
    monkeypatch.setattr(output.os, "statvfs", lambda _: volume(500, 900, used=6))
    assert meter.problem(1.0, []) is None
    monkeypatch.setattr(output.os, "listdir", closed)
    stop = meter.problem(1e9, [os.getpid()])
    assert stop is not None
    assert "while it hid the files it holds open" in stop.message


def test_an_output_that_goes_while_it_is_measured_is_none(tmp_path: Path) -> None:
    assert OutputMeter(str(tmp_path / "gone"), 1, 1).problem(1.0, []) is None
    assert OutputMeter(None, 1, 1).problem(1.0, []) is None


NO_FILE = "No such file or directory"
RUNC = "runc: runc create failed: unable to start container process:"


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("ERROR (catatonit:2): failed to exec pid1: No such file or directory", NO_FILE),
        ("[FATAL tini (7)] exec /no failed: Permission denied", "Permission denied"),
        (f'{RUNC} exec: "bash": executable file not found in $PATH: OCI', NO_FILE),
        (f'OCI {RUNC} exec: "/no": stat /no: no such file or directory: unknown', NO_FILE),
        (f"{RUNC} exec /secret: permission denied: OCI permission denied", "Permission denied"),
        ("exec /script: no such file or directory", NO_FILE),
        ("crun: executable file `bash` not found in $PATH: No such file or directory: OCI runtime", NO_FILE),
        ("crun: open executable: Permission denied: OCI permission denied", "Permission denied"),
        ('{"msg":"exec container process `/script`: No such file or directory","level":"error"}', NO_FILE),
        # These are the machine's, or of a program that ran.
        ('runc: runc create failed: error mounting "/x" to rootfs: stat /x: no such file or directory', None),
        ("crun: cannot stat `/x`: No such file or directory: OCI runtime attempted to invoke", None),
        ('exec: "gnuplot": executable file not found in $PATH', None),
    ],
)
def test_a_program_that_never_began_in_its_container_is_told_from_all_else(
    said: str, why: str | None
) -> None:
    found = explain("run", said)
    assert found is None if why is None else (found or "").startswith(f"cannot start run: {why}; ")
