# SPDX-License-Identifier: Apache-2.0
"""However a run ends: a reason, a sentence, and nothing of it left."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.monitor import end_orphans, find_orphans, identify

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Run

MIB = 1 << 20
# Forks twice, leaves the session and the environment's session leader behind, and stays.
DAEMON = """
import os, signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        open('daemon', 'w').write(str(os.getpid()))
        time.sleep(600)
    os._exit(0)
os.wait()
while not os.path.exists('daemon') or not open('daemon').read(): time.sleep(.01)
"""
STUBBORN = f"{DAEMON}\nopen('main', 'w').write(str(os.getpid()))\ntime.sleep(600)"


@pytest.mark.parametrize(
    ("code", "exit_code", "number", "message"),
    [
        ("import sys; sys.exit('no such topic: /points')", 1, None, "exit code 1: no such topic: /points"),
        ("import os; os._exit(3)", 3, None, "exit code 3"),
        ("import os; print('no map', flush=True); os._exit(3)", 3, None, "exit code 3: no map"),
        (
            "import sys; print('frame 9 done'); 1 / 0",
            1,
            None,
            "exit code 1: ZeroDivisionError: division by zero",
        ),
        (
            "import sys; print('frame 9 done'); sys.stderr.write('  no vocabulary \\n\\n'); sys.exit(3)",
            3,
            None,
            "exit code 3: no vocabulary",
        ),
        ("import os; os.kill(os.getpid(), 11)", None, 11, "ended by signal 11 (SIGSEGV)"),
        ("import os; os.kill(os.getpid(), 9)", None, 9, "ended by signal 9 (SIGKILL)"),
    ],
)
def test_failure(run: Run, code: str, exit_code: int | None, number: int | None, message: str) -> None:
    summary = run.python(code)
    assert (summary["exitCode"], summary["signal"]) == (exit_code, number)
    assert (summary["reason"], summary["message"]) == ("AlgorithmFailed", message)


def test_lines_of_both_streams_are_whole_in_the_log(run: Run) -> None:
    code = "import os, time\nfor k in range(60): os.write(k % 2 + 1, b'abcd'); time.sleep(.01); "
    run.python(code + "os.write(k % 2 + 1, b'efgh\\n' if k % 4 > 1 else b'')")
    lines = (run.folder / "log.txt").read_text().split()
    assert set(lines) == {"abcdabcdefgh"}


@pytest.mark.parametrize(
    ("argv", "options", "part"),
    [
        (["no-such-program"], {}, "cannot start no-such-program: No such file"),
        (["true"], {"cpus": (4000,)}, "processors 4000 (allowed are 0"),
        (["/"], {}, "cannot start /: Permission denied"),
    ],
)
def test_start_that_fails(run: Run, argv: list[str], options: dict[str, Any], part: str) -> None:
    summary = run(*argv, **options)
    assert summary["reason"] == "AlgorithmFailed"
    assert part in summary["message"]


def test_daemon_ends_with_the_first_process(run: Run) -> None:
    summary = run.python(DAEMON)
    assert (summary["exitCode"], summary["leftProcesses"]) == (0, 1)
    assert identify(run.pid("daemon")) is None


def test_timeout_ends_what_ignores_sigterm(run: Run) -> None:
    summary = run.python(STUBBORN, timeout_seconds=0.7, kill_grace_seconds=0.2)
    assert summary["reason"] == "DeadlineExceeded"
    assert summary["message"] == "it took more than 0.7 s"
    assert summary["signal"] == signal.SIGKILL
    assert [identify(run.pid(name)) for name in ("main", "daemon")] == [None, None]


@pytest.mark.parametrize("state", ["running", "stopped"])
def test_timeout_asks_first(run: Run, state: str) -> None:
    stop = "os.kill(os.getpid(), signal.SIGSTOP)" if state == "stopped" else ""
    code = f"import os, signal, sys, time\nsignal.signal(15, lambda *_: sys.exit(7))\n{stop}\ntime.sleep(600)"
    summary = run.python(code, timeout_seconds=0.5, kill_grace_seconds=60)
    assert (summary["reason"], summary["exitCode"]) == ("DeadlineExceeded", 7)


def test_too_much_memory(run: Run) -> None:
    code = "x = []\nwhile True: x.append(bytearray(b'1' * (4 << 20)))"
    summary = run.python(code, memory_limit_bytes=150 * MIB, timeout_seconds=60)
    assert summary["reason"] == "OutOfMemory"
    assert "150 MiB" in summary["message"]
    if run.cgroup == "auto":
        assert summary["usage"]["memory"]["kernelPeakBytes"] <= 150 * MIB


def test_too_much_memory_of_a_child(run: Run) -> None:
    child = "x = []\n  while True: x.append(bytearray(b'1' * (4 << 20)))"
    code = f"import os, time\nif os.fork() == 0:\n  {child}\ntime.sleep(600)"
    summary = run.python(code, memory_limit_bytes=150 * MIB, timeout_seconds=60)
    assert summary["reason"] == "OutOfMemory"


def test_too_much_output(run: Run) -> None:
    code = "f = open('map.bin', 'wb')\nwhile True: f.write(b'1' * 100000); f.flush()"
    summary = run.python(code, output_limit_bytes=5 * MIB, timeout_seconds=60)
    assert summary["reason"] == "OutputTooLarge"
    assert "5 MiB" in summary["message"]
    (run.output / "map.bin").unlink()


TOO_MUCH = {
    "empty files": (
        "import os\nfor k in range(400): os.mknod(f'{k}')\ntime.sleep(60)",
        {"output_file_limit": 300},
        "more than 300 files and folders",
    ),
    "folders": (
        "import os\nfor k in range(400): os.mkdir(f'{k}')\ntime.sleep(60)",
        {"output_file_limit": 300},
        "more than 300 files and folders",
    ),
    "deleted": (
        "import os\nf = open('map', 'wb', 0)\nos.unlink('map')\nf.write(b'1' * 6_000_000)\ntime.sleep(60)",
        {"output_limit_bytes": 5 * MIB},
        "files that it deleted but holds open included",
    ),
    "too deep to be seen": (
        "import os\nfor _ in range(30):\n    os.mkdir('d' * 200)\n    os.chdir('d' * 200)\ntime.sleep(60)",
        {"output_limit_bytes": 5 * MIB},
        "can't be looked into",
    ),
}


@pytest.mark.parametrize("what", TOO_MUCH)
def test_too_much_output_however_it_is_hidden(run: Run, what: str) -> None:
    code, options, told = TOO_MUCH[what]
    options = {"output_limit_bytes": 1 << 40, "timeout_seconds": 50, **options}
    summary = run.python(f"import time\n{code}", **options)
    assert summary["reason"] == "OutputTooLarge"
    assert told in summary["message"]
    shutil.rmtree(run.output, ignore_errors=True)


def test_fork_bomb(run: Run) -> None:
    code = """
import os, time
for _ in range(9):
    try: os.fork()
    except OSError: print('refused', flush=True)
time.sleep(600)
"""
    summary = run.python(code, task_limit=60, timeout_seconds=2, kill_grace_seconds=0)
    if run.cgroup == "auto":
        assert "refused" in summary["logTail"]
    else:
        assert summary["message"] == "it had more than 60 processes at the same time"


def test_much_printing_is_bounded(run: Run) -> None:
    code = "print('first')\nfor i in range(100): print('x' * 1048575)\nprint('last')"
    summary = run.python(code, log_limit_bytes=MIB)
    log = (run.folder / "log.txt").read_bytes()
    assert len(log) < MIB + 100
    assert (log[:6], log[-5:]) == (b"first\n", b"last\n")
    assert b"bytes left out" in log
    assert summary["reason"] is None


def test_log_tail_has_no_control_characters(run: Run) -> None:
    summary = run("printf", r"one\n\033[31mred\033[0m\a\000\n10%%\r100%%\n")
    assert summary["logTail"] == "one\nred\n100%"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_cancel(run: Run, number: int) -> None:
    supervisor = run.start(sys.executable, "-c", STUBBORN, kill_grace_seconds=0.1)
    pids = [run.pid("main"), run.pid("daemon")]
    supervisor.send_signal(number)
    assert supervisor.wait(50) == 0
    assert run.summary()["reason"] == "Cancelled"
    assert [identify(pid) for pid in pids] == [None, None]


def test_second_cancel_does_not_wait(run: Run, wait_for: Callable[..., Any]) -> None:
    supervisor = run.start(sys.executable, "-c", STUBBORN, kill_grace_seconds=600)
    run.pid("main")
    wait_for(lambda: supervisor.send_signal(signal.SIGTERM) or supervisor.poll() is not None)
    assert run.summary()["reason"] == "Cancelled"


def test_end_of_the_parent_ends_the_run(run: Run, killed: Callable[..., None], wait_for: Any) -> None:
    command = run.command(sys.executable, "-c", STUBBORN, kill_grace_seconds=0.1)
    code = f"import subprocess; subprocess.run({command!r})"
    parent = subprocess.Popen([sys.executable, "-c", code])
    pids = [run.pid("main"), run.pid("daemon")]
    killed(parent)
    wait_for((run.folder / "summary.json").exists)
    assert run.summary()["reason"] == "Cancelled"
    assert [identify(pid) for pid in pids] == [None, None]
    wait_for(lambda: find_orphans(run.process_json) == [])


def test_parent_that_ended_before_the_start(run: Run) -> None:
    process = subprocess.Popen(["true"])
    process.wait()
    summary = run("touch", "started", parent_pid=process.pid)
    assert summary["reason"] == "Cancelled"
    assert not (run.output / "started").exists()


def test_end_of_the_starting_thread_does_not_end_the_run(run: Run) -> None:
    import threading

    started: list[subprocess.Popen[bytes]] = []
    thread = threading.Thread(
        target=lambda: (started.append(run.start("sh", "-c", "echo $$ > main; sleep 0.7")), run.pid("main"))
    )
    thread.start()
    thread.join()
    assert started[0].wait(50) == 0
    assert run.summary()["reason"] is None


def test_orphans_of_a_killed_supervisor(run: Run, killed: Callable[..., None]) -> None:
    bystander = subprocess.Popen(["sleep", "600"])
    code = f"import subprocess\nsubprocess.Popen(['sleep', '600'])\n{STUBBORN}"
    supervisor = run.start(sys.executable, "-c", code)
    main, daemon = run.pid("main"), run.pid("daemon")
    killed(supervisor)
    found = {process.pid for process in find_orphans(run.process_json)}
    assert daemon in found
    assert len(found - {main}) >= 2
    assert end_orphans(run.process_json) == []
    assert find_orphans(run.process_json) == []
    assert [identify(pid) for pid in (main, daemon, *found)] == [None] * (2 + len(found))
    assert bystander.poll() is None
    assert not (run.folder / "summary.json").exists()
    bystander.kill()
    bystander.wait()


def test_orphans_with_a_living_supervisor(run: Run) -> None:
    supervisor = run.start(sys.executable, "-c", STUBBORN, kill_grace_seconds=0.1)
    run.pid("main")
    assert find_orphans(run.process_json)[0].pid == supervisor.pid
    assert end_orphans(run.process_json) == []
    assert supervisor.wait(50) == 0
    assert run.summary()["reason"] == "Cancelled"


def test_recycled_pid_is_left_alone(run: Run) -> None:
    run("true")
    bystander = subprocess.Popen(["sleep", "600"], start_new_session=True)
    record = json.loads(run.process_json.read_text())
    for role in ("supervisor", "algorithm"):
        record[role] = {"pid": bystander.pid, "start": 1}
    run.process_json.write_text(json.dumps(record))
    assert find_orphans(run.process_json) == []
    assert end_orphans(run.process_json) == []
    assert bystander.poll() is None
    bystander.kill()
    bystander.wait()


def test_no_record_and_a_broken_one(run: Run) -> None:
    assert find_orphans(run.process_json) == []
    run.process_json.write_text("{")
    with pytest.raises(ValueError, match=r"process\.json is no record"):
        find_orphans(run.process_json)
    run.process_json.unlink()


def test_descriptors_do_not_leak_into_the_algorithm(run: Run) -> None:
    inherited = os.open("/dev/null", os.O_RDONLY)
    os.set_inheritable(inherited, True)
    command = run.command("sh", "-c", "ls /proc/$$/fd > fds")
    assert subprocess.run(command, close_fds=False, check=False).returncode == 0
    os.close(inherited)
    assert set((run.output / "fds").read_text().split()) <= {"0", "1", "2", "10", "255"}
