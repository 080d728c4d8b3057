# SPDX-License-Identifier: Apache-2.0
"""Environment of a checkout: whole or not there, whatever happened before, with uv and without."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import checkout
import pytest

from slamhive.local.programs import uv as uv_module
from slamhive.local.programs.uv import find_uv, uv_commands, uv_variables
from wheels import wheel

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.timeout(300)

ROOT = Path(__file__).parents[2]
UV = find_uv([Path(sys.prefix) / "bin"])
PROJECT = """
[build-system]
requires = []
build-backend = "own"
backend-path = ["."]
[project]
name = "{name}"
version = "1.0"
[tool.hatch]
"""
BACKEND = """
import os, zipfile
def build_editable(folder, config_settings=None, metadata_directory=None):
    name = os.path.basename(os.getcwd())
    with zipfile.ZipFile(os.path.join(folder, f"{name}-1.0-py3-none-any.whl"), "w") as wheel:
        info = f"{name}-1.0.dist-info/"
        wheel.writestr(f"{name}.pth", os.getcwd())
        wheel.writestr(info + "METADATA", f"Metadata-Version: 2.1\\nName: {name}\\nVersion: 1.0\\n")
        wheel.writestr(info + "WHEEL", "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n")
        wheel.writestr(info + "RECORD", "")
    return os.path.basename(wheel.filename)
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout whose demo needs one package, and everything one more; nothing is asked of a network."""
    root, links = tmp_path / "checkout", tmp_path / "wheels"
    links.mkdir()
    for project in (root, root / "evaluator"):
        project.mkdir()
        (project / "pyproject.toml").write_text(PROJECT.format(name=project.name))
        (project / "own.py").write_text(BACKEND)
    (root / "hatch_build.py").touch()
    shown, other = wheel(links, "shown"), wheel(links, "other")
    (root / "constraints-demo.txt").write_text(shown)
    (root / "constraints.txt").write_text(shown + other)
    for name in [name for name in os.environ if name.startswith(("PIP_", "UV_"))]:
        monkeypatch.delenv(name)
    settings = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": links, "UV_CACHE_DIR": tmp_path / "cache"}
    for name, value in settings.items():
        monkeypatch.setenv(name, str(value))
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    (tmp_path / "bin").mkdir()
    monkeypatch.setattr(checkout, "ROOT", root)
    monkeypatch.chdir(root)
    return root


@pytest.fixture
def uv_is(place: Path) -> Callable[[str | None], None]:
    """Put a shell script in the place of uv, or the real one."""
    program = place.parent / "bin" / "uv"

    def put(script: str | None) -> None:
        program.unlink(missing_ok=True)
        if script is None:
            assert UV is not None
            program.symlink_to(UV)
        else:
            program.write_text(f"#!/bin/sh\n{script}\n")
            program.chmod(0o755)

    put(None)
    return put


def works(folder: Path, *names: str) -> bool:
    """Tell whether an environment has exactly these packages and their programs, under its own name."""
    there = {path.name.partition("-")[0] for path in folder.glob("lib/python*/site-packages/*.dist-info")}
    said = [subprocess.run([folder / "bin" / name], capture_output=True, check=True).stdout for name in names]
    assert said == [f"this is {name}\n".encode() for name in names]
    return there == {*names, "checkout", "evaluator"}


@pytest.mark.usefixtures("uv_is")
def test_an_environment_is_made_once_and_grows_as_a_whole(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = place / ".venv"
    checkout.make_environment(folder, "demo")
    assert works(folder, "shown")
    assert capsys.readouterr().out.startswith(f"{folder} is not there: it is made.\n")
    checkout.make_environment(folder, "demo")
    assert capsys.readouterr().out == ""
    checkout.make_environment(folder, "all")
    assert works(folder, "shown", "other")
    assert "has not the packages that are wanted now" in capsys.readouterr().out
    # What is enough for everything is enough for the demo.
    checkout.make_environment(folder, "demo")
    assert works(folder, "shown", "other")
    assert capsys.readouterr().out == ""
    assert sorted(path.name for path in place.glob(".venv*")) == [".venv"]


def write_stamp(folder: Path, **fields: str) -> None:
    (folder / checkout.STAMP).write_text(json.dumps(checkout.origin("demo", folder) | fields))


def lose_python(folder: Path) -> None:
    (folder / "bin" / "python").unlink()
    (folder / "bin" / "python").symlink_to("/nowhere/python3")


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (
            lambda folder: (folder / checkout.STAMP).unlink(),
            "was not made to its end, or by an earlier version",
        ),
        (lambda folder: (folder / checkout.STAMP).write_text("{"), "was not made to its end"),
        (lambda folder: (folder / "../hatch_build.py").write_text("#"), "has not the packages that"),
        (lambda folder: write_stamp(folder, place="/there/.venv"), "was made in /there/.venv"),
        (lambda folder: write_stamp(folder, checkout="/there"), "was made for /there"),
        (lambda folder: write_stamp(folder, Python="3.10 (/usr)"), "is of Python 3.10 (/usr)"),
        (lose_python, "has lost its Python 3."),
    ],
    ids=["half made", "half a stamp", "older", "moved", "another checkout", "another Python", "no Python"],
)
def test_an_environment_says_why_it_must_be_made_anew(
    place: Path, harm: Callable[[Path], None], told: str
) -> None:
    folder = place / ".venv"
    (folder / "bin").mkdir(parents=True)
    (folder / "bin" / "python").symlink_to(sys.executable)
    write_stamp(folder)
    assert checkout.fault(folder, checkout.origin("demo", folder)) is None
    harm(folder)
    assert (checkout.fault(folder, checkout.origin("demo", folder)) or "").startswith(told)


@pytest.mark.usefixtures("uv_is")
def test_an_environment_that_moved_is_made_anew(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, there = place / ".venv", place / "there" / ".venv"
    checkout.make_environment(folder, "demo")
    there.parent.mkdir()
    folder.rename(there)
    checkout.make_environment(there, "demo")
    assert f"{there} was made in {folder}: it is made.\n" in capsys.readouterr().out
    assert works(there, "shown")


def in_a_process(folder: Path) -> list[str]:
    """Return the command that makes an environment as make does."""
    code = (
        f"import sys; from pathlib import Path; sys.path.append({str(ROOT / 'tools')!r}); import checkout\n"
        "checkout.ROOT = Path.cwd(); checkout.make_environment(Path(sys.argv[1]), 'demo')"
    )
    return [sys.executable, "-c", code, str(folder)]


def test_what_is_killed_in_the_middle_leaves_nothing_that_passes_for_whole(
    place: Path, uv_is: Callable[[str | None], None]
) -> None:
    folder = place / ".venv"
    uv_is('case "$*" in --version) echo uv 9.0;; pip*) kill -9 $PPID;; esac')
    assert subprocess.run(in_a_process(folder), cwd=place, check=False).returncode == -9
    assert not folder.exists()
    assert (place / ".venv.making").exists()
    uv_is(None)
    subprocess.run(in_a_process(folder), cwd=place, check=True)
    assert works(folder, "shown")
    assert not (place / ".venv.making").exists()


@pytest.mark.usefixtures("uv_is")
def test_two_at_once_make_one(place: Path) -> None:
    folder = place / ".venv"
    with checkout._alone(place):
        process = subprocess.Popen(in_a_process(folder), cwd=place, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert process.stdout.readline() == f"Another make is at work in {place}: this one waits for it.\n"
        assert not (place / ".venv.making").exists()
    said = process.communicate()[0]
    assert "is not there" in said
    assert process.returncode == 0
    assert works(folder, "shown")


@pytest.mark.slow
def test_pip_does_what_uv_can_not(place: Path, uv_is: Callable, capsys: pytest.CaptureFixture[str]) -> None:
    uv_is('case "$*" in --version) echo uv 9.0;; *) echo "error: not that"; exit 2;; esac')
    # Where there is no uv, none is installed.
    path = place / "constraints-demo.txt"
    path.write_text(path.read_text() + f"uv==9.0 \\\n    --hash=sha256:{'0' * 64}\n")
    checkout.make_environment(place / ".venv", "demo")
    assert works(place / ".venv", "shown")
    told = "uv can't install them (error: not that): pip does, in a minute or three.\n"
    assert told in capsys.readouterr().out


def test_where_no_uv_can_be_had_pip_is_asked(
    place: Path, uv_is: Callable, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    uv_is("echo uv 0.4.9")
    monkeypatch.setattr(checkout._Venv, "_by_pip", lambda _: ["pip says no"])
    with pytest.raises(SystemExit, match=r"pip says no\n.*could not be made"):
        checkout.make_environment(place / ".venv", "demo")
    assert "pip does, in a minute or three.\n" in capsys.readouterr().out


@pytest.mark.usefixtures("uv_is")
def test_what_can_not_be_made_says_why_and_leaves_what_was_there(place: Path) -> None:
    folder = place / ".venv"
    checkout.make_environment(folder, "demo")
    path = place / "constraints-demo.txt"
    path.write_text(path.read_text().replace("sha256:", "sha256:0")[:-2] + "\n")
    with pytest.raises(
        SystemExit, match=r"(?s)hash.*\.venv could not be made: pip failed, and says why above"
    ):
        checkout.make_environment(folder, "demo")
    assert works(folder, "shown")


@pytest.mark.parametrize("script", ["exit 1", "echo uv 0.4.9", "echo no uv"])
def test_an_uv_that_is_broken_or_too_old_is_passed_over(
    uv_is: Callable, script: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert UV is not None
    uv_is(script)
    assert find_uv() is None
    monkeypatch.setenv("PATH", f"{os.environ['PATH']}:{Path(UV).parent}")
    assert find_uv() == UV


def test_a_cache_that_can_not_be_written_is_not_used(
    uv_is: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    uv_is(None)
    uv = find_uv()
    assert uv is not None
    first, second = uv_commands(uv, Path("python"), ["x"])
    assert (first[-1], second) == ("--offline", first[:-1])
    # root may write everywhere: the kernel is asked on a file system that refuses it.
    monkeypatch.setattr(uv_module.os, "access", lambda *_: False)
    assert uv_commands(uv, Path("python"), ["x"]) == [[*second, "--no-cache"]]


def test_uv_asks_the_indexes_that_pip_is_set_to(tmp_path: Path) -> None:
    settings = tmp_path / ".config/pip/pip.conf"
    settings.parent.mkdir(parents=True)
    settings.write_text(
        "[global]\nindex-url = https://a.test\nproxy = http://p.test\n[install]\nno-index=no\n"
    )
    variables = {
        "HOME": str(tmp_path),
        "PIP_FIND_LINKS": f"/no/such/folder {tmp_path}",
        "XDG_CONFIG_DIRS": "/no",
    }
    expected = {
        "UV_DEFAULT_INDEX": "https://a.test",
        "UV_FIND_LINKS": str(tmp_path),
        "ALL_PROXY": "http://p.test",
    }
    found = uv_variables(variables)
    assert {name: found.get(name) for name in expected} == expected
    assert (
        uv_variables(variables | {"PIP_INDEX_URL": "https://b.test"})["UV_DEFAULT_INDEX"] == "https://b.test"
    )
    assert uv_variables(variables | {"UV_INDEX_URL": "https://c.test"}) == {}
    settings.write_text("no section\n")
    assert uv_variables(variables).get("UV_DEFAULT_INDEX") is None


def test_make_sees_to_the_environment_before_all_else() -> None:
    for target, what in (("install", "all"), ("test", "all"), ("lint", "all"), ("demo", "demo")):
        command = ["make", "--dry-run", "VENV=elsewhere", target]
        told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        assert f"tools/checkout.py elsewhere \\\n  {what}\n" in told
    # Before anything is installed: -S takes all packages away but Python's own.
    command = [sys.executable, "-S", "-P", "-c", "import checkout"]
    subprocess.run(command, env={"PYTHONPATH": f"{ROOT / 'operator'}:{ROOT / 'tools'}"}, check=True)
