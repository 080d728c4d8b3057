# SPDX-License-Identifier: Apache-2.0
"""runc for pods under faults: it gives containers a library that makes a write of theirs fail, then is runc.

The programs and images are the real ones, and nothing in the API says that a fault will come. The plan is
``faults/plan.json`` beside this program::

    library    the library, in this folder
    seed       of what is drawn
    share      of the containers that have a fault
    most       by a container's name, up to which of its writes one fails; others have none
    paths      form of the paths that count (fnmatch, without the first slash)
"""

import fcntl
import json
import os
import random
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent / "faults"
INSIDE = "/.faults"
KINDS = ("ENOSPC", "EIO", "EROFS", "EDQUOT", "short")


def number() -> int:
    """Return the number of this container in the plan, from 0."""
    with (FOLDER / "containers").open("a+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write("x")
        return file.tell() - 1


def spoil(bundle: Path) -> None:
    """Let a write of a container fail, if it is one of those that the plan names."""
    plan = json.loads((FOLDER / "plan.json").read_text())
    config = json.loads((bundle / "config.json").read_text())
    annotations = config.get("annotations", {})
    name = annotations.get("io.kubernetes.cri.container-name")
    if name not in plan["most"]:
        return
    mine = number()
    chance = random.Random(f"{plan['seed']} {mine}")
    if chance.random() >= plan["share"]:
        return
    at, how, lasting = chance.randint(1, plan["most"][name]), chance.choice(KINDS), chance.random() < 0.3
    stem = f"{mine}-{name}-{annotations['io.kubernetes.cri.sandbox-name']}"
    for ending, content in ((".count", bytes(4096)), (".log", b"")):
        file = FOLDER / f"{stem}{ending}"
        file.write_bytes(content)
        file.chmod(0o666)
    config["process"]["env"] += [
        f"LD_PRELOAD={INSIDE}/{plan['library']}",
        "FAULT_ROOT=",
        f"FAULT_MATCH={plan['paths']}",
        f"FAULT_COUNT={INSIDE}/{stem}.count",
        f"FAULT_LOG={INSIDE}/{stem}.log",
        f"FAULT_AT={at}",
        f"FAULT_HOW={how}",
        f"FAULT_LASTING={int(lasting and how != 'short')}",
    ]
    mount = {"destination": INSIDE, "type": "bind", "source": str(FOLDER), "options": ["rbind", "rw"]}
    config["mounts"].append(mount)
    (bundle / "config.json").write_text(json.dumps(config))


if __name__ == "__main__":
    words = sys.argv[1:]
    if "create" in words and "--bundle" in words and (FOLDER / "plan.json").exists():
        spoil(Path(words[words.index("--bundle") + 1]))
    os.execvp("runc", ["runc", *words])  # noqa: S606
