# SPDX-License-Identifier: Apache-2.0
"""uv, which installs packages in a fraction of pip's time: where it is, and how it is asked.

It is asked first wherever it is, and pip where it is not or fails, for whatever reason: what pip says is then
what is told. The standard library alone: ``make install`` uses this before there is anything else.
"""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

OLDEST = (0, 5)
"""The oldest uv that is asked: what is asked of it here was tried with it."""
_SECONDS = 30


def find_uv(folders: Iterable[Path] = ()) -> str | None:
    """Return the first uv that is new enough, of some folders and of the PATH; None where there is none."""
    for folder in (*map(str, folders), *os.get_exec_path()):
        program = shutil.which("uv", path=folder) if folder else None
        version = re.match(r"uv (\d+)\.(\d+)", _said([program, "--version"])) if program else None
        if program and version and (int(version[1]), int(version[2])) >= OLDEST:
            return program
    return None


def uv_commands(uv: str, python: Path, arguments: Iterable[str]) -> list[list[str]]:
    """Return the commands that install packages into an environment, each for where the one before failed.

    Args:
        uv: the program.
        python: the environment's interpreter.
        arguments: what is installed, and how.
    """
    # Of several indexes the best version, as pip takes it.
    how = ["--color", "never", "--no-progress", "--index-strategy", "unsafe-best-match"]
    command = [uv, "pip", "install", *how, "--python", str(python), *arguments]
    cache = Path(_said([uv, "cache", "dir"]).strip() or "/")
    there = next(path for path in (cache, *cache.parents) if path.exists())
    if not os.access(there, os.W_OK):
        return [[*command, "--no-cache"]]
    # Without a network first: what is in the cache needs none, and is not asked for again.
    return [[*command, "--offline"], command]


def uv_variables(variables: Mapping[str, str]) -> dict[str, str]:
    """Return variables by which uv asks the indexes that pip is set to, unless uv has settings of its own.

    Args:
        variables: those that both are started with.
    """
    own = ("UV_INDEX", "UV_DEFAULT_INDEX", "UV_EXTRA_INDEX", "UV_NO_INDEX", "UV_FIND_LINKS")
    if any(name.startswith(own) for name in variables):
        return {}
    pip = _settings_of_pip(variables)
    links = [one for one in pip.get("find-links", "").split() if "://" in one or Path(one).exists()]
    found = {
        "UV_DEFAULT_INDEX": pip.get("index-url", ""),
        "UV_INDEX": " ".join(pip.get("extra-index-url", "").split()),
        "UV_FIND_LINKS": ",".join(links),
        "UV_NO_INDEX": "1" if pip.get("no-index", "").lower() in {"1", "true", "yes", "on"} else "",
        "UV_INSECURE_HOST": " ".join(pip.get("trusted-host", "").split()),
        "SSL_CERT_FILE": pip.get("cert", "") if "SSL_CERT_FILE" not in variables else "",
        "ALL_PROXY": pip.get("proxy", ""),
    }
    return {name: value for name, value in found.items() if value}


def settle(made: Path, final: Path) -> None:
    """Have an environment's programs name the path that it is about to get.

    Args:
        made: where it was made.
        final: where it will be.
    """
    for path in (made / "pyvenv.cfg", *(made / "bin").iterdir()):
        if path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 16:
            text = path.read_bytes()
            settled = text.replace(os.fsencode(made), os.fsencode(final))
            if settled != text:
                path.write_bytes(settled)


def _settings_of_pip(variables: Mapping[str, str]) -> dict[str, str]:
    """Return pip's settings of its files and variables, without those of its commands but ``install``."""
    home, named = variables.get("HOME", "/"), variables.get("PIP_CONFIG_FILE")
    folders = variables.get("XDG_CONFIG_DIRS", "/etc/xdg").split(":")
    own = variables.get("XDG_CONFIG_HOME") or f"{home}/.config"
    files = [*(f"{folder}/pip/pip.conf" for folder in folders), "/etc/pip.conf", f"{home}/.pip/pip.conf"]
    files += [f"{own}/pip/pip.conf", f"{sys.prefix}/pip.conf", *([named] if named else [])]
    parser = configparser.RawConfigParser(strict=False)
    try:
        parser.read([] if named == os.devnull else files, encoding="utf-8")
    except (configparser.Error, UnicodeDecodeError):  # pip says it
        return {}
    found: dict[str, str] = {}
    for section in ("global", "install"):
        found |= dict(parser.items(section)) if parser.has_section(section) else {}
    of_variables = {name: value for name, value in variables.items() if name.startswith("PIP_")}
    return found | {name[4:].lower().replace("_", "-"): value for name, value in of_variables.items()}


def _said(command: list[str]) -> str:
    """Return the output of a command, nothing where it fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""
