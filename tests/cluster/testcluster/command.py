# SPDX-License-Identifier: Apache-2.0
"""The commands: prepare, build, up, down, load, status."""

from __future__ import annotations

import argparse
import sys

from testcluster import choice, missing, programs
from testcluster.errors import ClusterError
from testcluster.places import DEFAULT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="cluster.py", description="A real Kubernetes for tests.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    up = commands.add_parser("up", help="start it, or what is missing of it")
    up.add_argument("--control-plane", action="store_true", help="no node, for tests of the API alone")
    down = commands.add_parser("down", help="end it and leave nothing of it")
    load = commands.add_parser("load", help="put images built on this machine into it")
    load.add_argument("images", nargs="+", metavar="IMAGE")
    for command in (up, down, load):
        command.add_argument("--name", default=DEFAULT, help="another cluster beside the usual one")
    commands.add_parser("build", help="build its programs once; they are kept")
    commands.add_parser(
        "prepare", help="have ready what tests need, packages too, or say what is missing and succeed"
    )
    commands.add_parser("status", help="say which cluster tests would use, and why")
    return parser


def _prepare() -> None:
    if choice.asked() in {"", "local"}:
        missing.install()
    chosen = choice.choose(building=True)
    if chosen.mode == "local" and not chosen.problems:
        programs.build()
    else:
        sys.stdout.write(chosen.sentence() + "\n")


def _run(options: argparse.Namespace) -> None:
    match options.command:
        case "build":
            programs.build()
        case "prepare":
            _prepare()
        case "status":
            sys.stdout.write(choice.choose().sentence() + "\n")
        case "up":
            if choice.asked() in {"", "local"}:
                missing.install()
            access = choice.cluster(options.name).up(node=not options.control_plane)
            sys.stdout.write(f"KUBECONFIG={access.kubeconfig}\n")
        case "down":
            choice.cluster(options.name).down()
        case "load":
            access = choice.cluster(options.name).access()
            for image in options.images:
                access.load(image)


def main(arguments: list[str]) -> int:
    """Do what the arguments say; return the exit code."""
    try:
        _run(_parser().parse_args(arguments))
    except ClusterError as error:
        sys.stderr.write("".join(f"{line}\n" for line in str(error).splitlines()))
        return 1
    except KeyboardInterrupt:
        return 130
    return 0
