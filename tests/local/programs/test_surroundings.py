# SPDX-License-Identifier: Apache-2.0
"""Whatever machine, container and working folder slamhive is started in."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import time
import venv
from pathlib import Path
from typing import TYPE_CHECKING

import pip
import pytest
import yaml

from slamhive.local.home.folder import lock
from slamhive.local.programs import cores, making
from slamhive.local.programs.interpreters import Interpreter
from slamhive.local.programs.making import Making, _anything_in
from slamhive.local.programs.pipcommands import explained, run_command
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.errors import SystemFault
from slamhive.model.results import Phase, Reason
from slamhive.monitor.measuring import hierarchy
from slamhive.monitor.measuring.hierarchy import Hierarchy

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.timeout(300)

DEADLINE_SECONDS = 50


@pytest.fixture(scope="module")
def environments(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of their own: requirements here name folders of a test."""
    return tmp_path_factory.mktemp("environments")


@pytest.fixture(scope="module")
def empty_environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with pip alone, a copy of our own: installing it takes seconds."""
    folder = tmp_path_factory.mktemp("empty") / "environment"
    venv.create(folder, symlinks=True)
    packages = next(folder.glob("lib/python*/site-packages"))
    shutil.copytree(Path(pip.__file__).parent, packages / "pip")
    return folder


@pytest.fixture
def _copied_environments(empty_environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies that environment where another one would be made."""
    command = making.run_command

    def call(argv: list[str], *rest: object, **how: object) -> None:
        if argv[1:3] == ["-m", "venv"]:
            shutil.copytree(empty_environment, argv[-1], symlinks=True)
        else:
            command(argv, *rest, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(making, "run_command", call)


def test_modules_in_the_working_folder_are_not_ours(
    run_acts: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("json", "select", "resource", "venv", "logging"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('not mine')\n")
    monkeypatch.chdir(tmp_path)
    _, notes = run_acts(["good"], template={"retries": 0})
    assert notes.records[0].phase is Phase.SUCCEEDED, notes.records[0].message


_IMPORTING = """
import json, cv2
from slamhive.contract.environment import own_variables
print(json.dumps(own_variables(["LD_LIBRARY_PATH", "TZ"])))
"""


@pytest.mark.parametrize(
    ("before", "kept"),
    [(None, {}), ("", {}), ("/opt/mine/lib:/usr/cv2/lib", {"LD_LIBRARY_PATH": "/opt/mine/lib:/usr/cv2/lib"})],
)
def test_what_our_libraries_add_to_the_variables_is_not_passed_on(
    before: str | None, kept: dict[str, str]
) -> None:
    surroundings = {key: value for key, value in os.environ.items() if key not in {"LD_LIBRARY_PATH", "TZ"}}
    surroundings |= {"TZ": "UTC"} | ({} if before is None else {"LD_LIBRARY_PATH": before})
    command = [sys.executable, "-c", _IMPORTING]
    told = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True).stdout
    assert json.loads(told) == {"TZ": "UTC"} | kept


def test_no_run_looks_for_libraries_where_ours_are_or_in_its_own_folder(
    run_acts: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LD_LIBRARY_PATH", "/site-packages/cv2/../../lib64:/opt/mine/lib:")
    _, notes = run_acts(["good"])
    supervised = json.loads((Path(notes.records[0].folder) / "supervisor.json").read_text())
    assert supervised["env"]["LD_LIBRARY_PATH"] == "/opt/mine/lib"


_KILLED = """
import sys
from pathlib import Path
from slamhive.local.programs.pipcommands import run_command
from slamhive.local.home.folder import lock
folder = Path(sys.argv[1])
with lock(folder / "lock") as held:
    run_command(["sh", "-c", "echo $$ > new && mv new pid && exec sleep 600"], "it", folder, held)
"""


def test_what_a_killed_slamhive_left_installing_holds_its_lock(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", _KILLED, str(tmp_path)])
    until = time.monotonic() + DEADLINE_SECONDS
    while not (tmp_path / "pid").exists() and time.monotonic() < until:
        time.sleep(0.01)
    process.kill()
    process.wait()
    with lock(tmp_path / "lock", wait=False) as held:
        assert held is None
    os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)
    with lock(tmp_path / "lock") as held:
        assert held is not None


@pytest.mark.usefixtures("_copied_environments")
def test_packages_that_do_not_exist_are_asked_for_once(run_acts: Callable, home, bench) -> None:  # noqa: ANN001
    requirements = home.path / "algorithms/actor/requirements.txt"
    requirements.write_text("--no-index\nno-such-package==1\n")
    told: list[str] = []
    bench.programs.environments._notify = told.append
    _, notes = run_acts(["good", "slow"])
    for record in notes.records:
        assert (record.phase, record.reason) == (Phase.FAILED, Reason.ALGORITHM_UNAVAILABLE)
        assert record.message == (
            "packages of actor can't be installed: No matching distribution found for no-such-package==1 "
            "among the wheels; if there is only source, a line --no-binary no-such-package among the "
            "requirements lets its own setup program run"
        )
    assert len(told) == 1


PIP_SAYS = """\
Collecting numpy==2.3.4 (from -r requirements.txt (line 1))
  Downloading numpy-2.3.4-cp311-cp311-manylinux_2_28_x86_64.whl (16.9 MB)
Collecting typing-extensions>=4 (from -r requirements.txt (line 2))
  Using cached typing_extensions-4.15.0-py3-none-any.whl (44 kB)
Installing collected packages: typing-extensions, numpy
Successfully installed numpy-2.3.4 typing-extensions-4.15.0
"""


def test_it_shows_which_packages_come(tmp_path: Path) -> None:
    requirements = tmp_path / "requirements.txt"
    requirements.write_text("numpy==2.3.4 --hash=sha256:0\ntyping-extensions==4.15.0 --hash=sha256:1\n")
    shown: dict[str, float] = {}
    seen = []
    with Making("x", Interpreter(sys.executable, (3, 11)), requirements, shown) as made:
        seen.append(dict(shown))
        for line in PIP_SAYS.splitlines():
            made.tell(line)
            if seen[-1] != shown:
                seen.append(dict(shown))
    what = "making the environment of x"
    assert seen == [
        {what: 0.0},
        {f"{what}: collecting numpy": 0.0},
        {f"{what}: downloading numpy (16.9 MB)": 0.0},
        {f"{what}: collecting typing-extensions": 1 / 3},
        {f"{what}: installing 2 packages": 2 / 3},
    ]
    assert shown == {}


def test_pip_is_followed_while_it_works(tmp_path: Path) -> None:
    told: list[str] = []
    program = "import sys; print('Collecting x'); print('ERROR: No such x', file=sys.stderr); sys.exit(1)"
    with pytest.raises(Unavailable, match="packages of x can't be installed: No such x"):
        run_command([sys.executable, "-c", program], "packages of x", tmp_path, None, told.append)
    assert told == ["Collecting x"]


_BACKEND = """
import json, os, zipfile
def build_wheel(folder, config_settings=None, metadata_directory=None):
    with open({told!r}, "w") as file:
        json.dump(dict(os.environ), file)
    name = "sourced-1.0-py3-none-any.whl"
    with zipfile.ZipFile(os.path.join(folder, name), "w") as wheel:
        info = "sourced-1.0.dist-info/"
        wheel.writestr(info + "METADATA", "Metadata-Version: 2.1\\nName: sourced\\nVersion: 1.0\\n")
        wheel.writestr(info + "WHEEL", "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n")
        wheel.writestr(info + "RECORD", "")
    return name
"""


@pytest.fixture
def told_by_setup(home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:  # noqa: ANN001
    """Make the actor need a package that has source alone; return where its setup tells its variables."""
    # pip keeps what it built by the file's path, which an earlier session of pytest may have had too.
    monkeypatch.setenv("PIP_CACHE_DIR", str(tmp_path / "pip"))
    told = tmp_path / "told.json"
    files = {
        "pyproject.toml": '[build-system]\nrequires = []\nbuild-backend = "own"\nbackend-path = ["."]\n',
        "own.py": _BACKEND.format(told=str(told)),
        "PKG-INFO": "Metadata-Version: 2.1\nName: sourced\nVersion: 1.0\n",
    }
    with tarfile.open(tmp_path / "sourced-1.0.tar.gz", "w:gz") as archive:
        for name, text in files.items():
            entry = tarfile.TarInfo(f"sourced-1.0/{name}")
            entry.size = len(text)
            archive.addfile(entry, io.BytesIO(text.encode()))
    text = f"--no-index\n--find-links {tmp_path}\nsourced==1.0\n"
    (home.path / "algorithms/actor/requirements.txt").write_text(text)
    return told


@pytest.mark.usefixtures("_copied_environments")
def test_setup_programs_of_packages_are_not_run(run_acts: Callable, told_by_setup: Path) -> None:
    _, notes = run_acts(["good"])
    assert notes.records[0].reason == Reason.ALGORITHM_UNAVAILABLE
    assert "a line --no-binary sourced among the requirements lets" in (notes.records[0].message or "")
    assert not told_by_setup.exists()


@pytest.mark.usefixtures("_copied_environments")
@pytest.mark.parametrize("tool", ["uv", pytest.param("pip", marks=pytest.mark.slow)])
def test_setup_programs_that_are_allowed_see_no_secret(
    run_acts: Callable,
    tool: str,
    home,  # noqa: ANN001
    told_by_setup: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    requirements = home.path / "algorithms/actor/requirements.txt"
    requirements.write_text(requirements.read_text() + "--no-binary sourced\n")
    if tool == "pip":
        monkeypatch.setattr(making, "find_uv", lambda _: None)
    kept = {"PIP_INDEX_URL": "https://mirror.test/simple", "https_proxy": "http://proxy.test:3128"}
    kept |= {"SSL_CERT_FILE": os.environ.get("SSL_CERT_FILE", "/etc/ssl/certs/ca-certificates.crt")}
    secrets = {"HF_TOKEN": "canary", "AWS_SECRET_ACCESS_KEY": "canary", "SLAMHIVE_ARCHIVE_PASSWORD": "canary"}
    for name, value in (kept | secrets).items():
        monkeypatch.setenv(name, value)
    _, notes = run_acts(["good"])
    assert notes.records[0].phase is Phase.SUCCEEDED, notes.records[0].message
    seen = json.loads(told_by_setup.read_text())
    assert {name: seen.get(name) for name in kept} == kept
    assert "canary" not in str(seen)


@pytest.mark.parametrize(
    ("told", "kind", "why"),
    [
        (
            "ERROR: Invalid requirement: './x' (from line 1 of r.txt)\nHint: no",
            Unavailable,
            "Invalid requirement",
        ),
        ("ERROR: No matching distribution found for pyOpenSSL==99", Unavailable, "pyOpenSSL==99"),
        (
            "WARNING: Retrying after connection broken by 'NewConnectionError()': /x/\nERROR: No matching x",
            SystemFault,
            "the package index can't be reached (NewConnectionError)",
        ),
        (
            "ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device",
            SystemFault,
            "No space left",
        ),
        ("Error: Command 'python -m ensurepip' returned non-zero exit status 1.", SystemFault, "ensurepip"),
    ],
)
def test_only_what_another_try_may_mend_is_a_fault_of_the_machine(
    told: str, kind: type[Exception], why: str
) -> None:
    error = explained("packages of x", told, by_itself=True)
    assert type(error) is kind
    assert why in str(error)


@pytest.mark.parametrize(
    ("limit", "expected"),
    [(None, 4), (8.0, 4), (4.0, 2), (3.9, 1), (0.5, 1)],
)
def test_no_more_cores_than_a_quota_can_keep_busy(limit: float | None, expected: int) -> None:
    assert len(cores.within([(0, 4), (1, 5), (2, 6), (3, 7)], limit)) == expected


def test_the_tightest_quota_above_us_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own, old = tmp_path / "v2/pod/own", tmp_path / "v1/own"
    own.mkdir(parents=True)
    old.mkdir(parents=True)
    trees = [
        Hierarchy(2, frozenset(), str(tmp_path / "v2"), str(own)),
        Hierarchy(1, frozenset({"cpu"}), str(tmp_path / "v1"), str(old)),
    ]
    monkeypatch.setattr(hierarchy, "own_hierarchies", lambda: trees)
    assert hierarchy.cpu_quota() is None
    (own / "cpu.max").write_text("max 100000\n")
    (own.parent / "cpu.max").write_text("250000 100000\n")
    assert hierarchy.cpu_quota() == 2.5
    (old / "cpu.cfs_quota_us").write_text("150000\n")
    (old / "cpu.cfs_period_us").write_text("100000\n")
    assert hierarchy.cpu_quota() == 1.5
    (old / "cpu.cfs_quota_us").write_text("-1\n")
    assert hierarchy.cpu_quota() == 2.5
    machine = hierarchy.memory_limit()
    (old / "memory.limit_in_bytes").write_text("9223372036854771712\n")
    (own / "memory.max").write_text("max\n")
    assert hierarchy.memory_limit() == machine
    (own.parent / "memory.max").write_text(f"{64 << 20}\n")
    assert hierarchy.memory_limit() == 64 << 20


@pytest.mark.skipif(len(cores.whole_cores()) < 2, reason="needs two cores")
def test_a_run_gets_no_less_than_it_asks_for(run_acts: Callable) -> None:
    _, notes = run_acts(["good"], template={"resources": {"cpu": "1200m"}})
    configuration = yaml.safe_load((Path(notes.records[0].folder) / "run/config.yaml").read_text())
    assert configuration["cores"] == sum(map(len, cores.whole_cores()[:2]))


@pytest.mark.parametrize(
    ("text", "has_any"),
    [
        (b"", False),
        (b"# nothing but comments\n\n", False),
        (b"numpy\n", True),
        ("# -*- coding: latin-1 -*-\n# M\u00e4nner\nnumpy\n".encode("latin-1"), True),
        ("numpy\n".encode("utf-16"), True),
    ],
    ids=["empty", "comments", "one", "Latin-1", "UTF-16"],
)
def test_requirements_in_every_encoding_that_pip_reads(text: bytes, has_any: bool, tmp_path: Path) -> None:
    path = tmp_path / "requirements.txt"
    path.write_bytes(text)
    assert _anything_in(path) is has_any
