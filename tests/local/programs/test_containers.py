# SPDX-License-Identifier: Apache-2.0
"""Algorithms in containers: images that can't be used, what a program sees and costs, docker's commands."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.archive import Archive
from slamhive.local.home.catalog import Workshop
from slamhive.local.programs import engines
from slamhive.local.programs.containers import Containers
from slamhive.local.programs.engines import ContainerChoice
from slamhive.local.programs.executors import unavailable
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job, Runner, Watcher
from slamhive.local.running.workbench import Workbench
from slamhive.model.algorithm import AlgorithmSpec
from slamhive.model.loading import load_file
from slamhive.model.results import Phase, Reason
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

sys.path.append(str(Path(__file__).parent))

from registry import Registry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import Engine
    from slamhive.model.results import RunRecord

pytestmark = pytest.mark.usefixtures("podman")

BASE = {"modes": [{"name": "lidar", "roles": ["lidar"]}], "output": {"frame": "lidar"}}
SHELL = "slamhive/shell-algorithm:1.0.0"
POSES = """i=0
while [ $i -lt 100 ]; do
    echo "160000000$((i / 10)).$((i % 10)) $i 0 0 0 0 0 1"
    i=$((i + 1))
done > /slamhive/output/trajectory.txt
"""


class Silent(Watcher):
    """A watcher that shows nothing."""


class Boxes:
    """A home in which algorithms of an image run."""

    def __init__(self, home: Home) -> None:
        self.home = home
        self.told: list[str] = []
        self.choice: ContainerChoice | None = None

    def __call__(self, *algorithms: dict[str, Any], rerun: bool = True, **template: Any) -> list[RunRecord]:
        """Run algorithms in one sweep, and return their records in this order."""
        workshop = Workshop()
        folder = self.home.path / "boxes"
        folder.mkdir(exist_ok=True)
        workshop.add(load_file(self.home.path / "tiny.yaml"), self.home.path)
        for number, fields in enumerate(algorithms):
            header = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Algorithm"}
            made = header | {"metadata": {"name": f"box{number}"}, "spec": BASE | fields}
            (folder / "algorithm.yaml").write_text(yaml.safe_dump(made))
            workshop.add(load_file(folder / "algorithm.yaml"), folder)
        names = [f"box{number}" for number in range(len(algorithms))]
        spec = {"algorithmRef": {"name": "box0"}, "datasetRef": {"name": "tiny"}} | template
        spec |= {"resources": {"cpu": "1", "memory": "128Mi"}, "retries": 0}
        matrix = [{"path": "algorithm", "values": names}]
        sweep = Sweep.model_validate(
            {"metadata": {"name": "boxes"}, "spec": {"template": {"spec": spec}, "matrix": matrix}}
        )
        with Archive.open(self.home.archive_url) as archive:
            job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
            bench = Workbench(self.home, workshop, archive, self.told.append, self.choice)
            assert not Runner(bench, Silent(), wish=RunChoice(rerun=rerun)).run([job])
            found = {
                record.spec["algorithmRef"]["name"]: record for record in archive.runs({"sweep": "boxes"})
            }
        return [found[name] for name in names]


@pytest.fixture
def boxes(home: Home, podman: Engine) -> Iterator[Boxes]:
    """A home, of which no container stays."""
    yield Boxes(home)
    assert podman.labelled(f"io.slamhive.home={Containers(home).identity()}") == []


def shell(script: str, image: str = SHELL, **fields: Any) -> dict[str, Any]:
    return {"image": image, "command": ["sh", "-c", script], **fields}


@pytest.fixture(scope="module")
def bare(podman: Engine, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """An image with no shell, and with programs that lack an interpreter or are for root alone."""
    folder = tmp_path_factory.mktemp("bare")
    (folder / "script").write_text("#!/bin/sh\nexit 0\n")
    (folder / "secret").write_text("#!/bin/sh\nexit 0\n")
    (folder / "script").chmod(0o755)
    (folder / "secret").chmod(0o700)
    (folder / "Dockerfile").write_text("FROM scratch\nCOPY script secret /\n")
    name = f"localhost/slamhive-bare-{folder.name}:1"
    build = ["buildah", "bud", "--isolation", "chroot", "-q", "-t", name, str(folder)]
    subprocess.run(build, check=True, capture_output=True, timeout=120)
    yield name
    podman.call("rmi", "--force", name)


def test_an_image_that_can_not_be_used_is_one_sentence_and_others_go_on(boxes: Boxes, bare: str) -> None:
    """Those that write nothing or too little, too."""
    cases: list[tuple[dict[str, Any], str | None, str]] = [
        (shell(POSES), None, ""),
        ({"image": bare}, "AlgorithmUnavailable", "has no program of its own: spec.command must name one"),
        (
            shell("true", image=bare),
            "AlgorithmFailed",
            "cannot start sh: No such file or directory; it, or the",
        ),
        (
            {"image": bare, "command": ["/script"]},
            "AlgorithmFailed",
            "the interpreter that its first line names",
        ),
        ({"image": bare, "command": ["/secret"]}, "AlgorithmFailed", "the image doesn't let everyone run it"),
        (shell("echo x > /etc/x"), "AlgorithmFailed", "cannot create /etc/x: Read-only file system"),
        (shell("true"), "NoTrajectory", "output/trajectory.txt is missing"),
        (shell(f"{POSES}chmod 0 /slamhive/output/trajectory.txt"), None, ""),
        (shell("exit 126"), "AlgorithmFailed", "exit code 126"),
        (shell("kill -9 $$$$"), "AlgorithmFailed", "ended by signal 9 (SIGKILL)"),
    ]
    records = boxes(*(algorithm for algorithm, _, _ in cases))
    for record, (_, reason, message) in zip(records, cases, strict=True):
        assert (record.reason.value if record.reason else None) == reason, record.message
        assert message in (record.message or "")
        assert "\n" not in (record.message or "")


PROBE = """
id -u; id -g
grep -E 'CapEff|NoNewPrivs|Seccomp:' /proc/self/status | tr -d '\\t'
ls / /slamhive /slamhive/dataset
for place in / /slamhive /slamhive/dataset /usr /run; do
    (echo x > $place/probe) 2>/dev/null && echo "wrote $place"
done
for place in /tmp /dev/shm; do (echo x > $place/probe) && echo "scratch $place"; done
ls /sys/class/net
nproc
env | grep -c -i proxy
cat /slamhive/config.yaml | head -1
echo "pid $$$$"
env | grep ^SLAMHIVE_ | sort
exit 9
"""


def test_a_program_sees_what_it_sees_in_a_pod_and_no_more(
    boxes: Boxes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HTTP_PROXY", "http://secret")
    (record,) = boxes(shell(PROBE), seed=7)
    said = (Path(record.folder or "") / "log.txt").read_text().splitlines()
    assert said[:2] == ["65532", "65532"]
    assert "CapEff:0000000000000000" in said
    assert "NoNewPrivs:1" in said
    assert "Seccomp:2" in said
    assert not [line for line in said if line.startswith("wrote")]
    assert [line for line in said if line.startswith("scratch")] == ["scratch /tmp", "scratch /dev/shm"]
    assert "lo" in said
    assert "eth0" not in said
    assert {"config.yaml", "dataset", "output", "recording.bag", "frames.txt"} <= {*said}
    assert "groundtruth.txt" not in said
    assert said[said.index("apiVersion: slamhive.io/v1alpha1") - 2 :][:2] == ["1", "0"]
    (pid,) = [line for line in said if line.startswith("pid ")]
    assert int(pid.split()[1]) > 1
    assert said[-3:] == ["SLAMHIVE_CONTAINER=algorithm", "SLAMHIVE_RUN=/slamhive", "SLAMHIVE_SEED=7"]


@pytest.fixture
def closed(podman: Engine, tmp_path: Path) -> Iterator[str]:
    """An image with a file in its /tmp, which only root may write into."""
    name = f"localhost/slamhive-closed-{tmp_path.name.replace('_', '-')}:1"
    script = f"""container=$(buildah from {SHELL})
folder=$(buildah mount $container)
touch $folder/tmp/left && chmod 755 $folder/tmp
buildah commit -q $container {name}
buildah rm $container
"""
    subprocess.run(["sh", "-e", "-c", script], check=True, capture_output=True, timeout=120)
    yield name
    podman.call("rmi", "--force", name)


def test_scratch_is_empty_and_writable_whatever_the_image_has_there(boxes: Boxes, closed: str) -> None:
    """A pod has a volume of its own there."""
    (record,) = boxes(shell(f"ls -A /tmp; echo x > /tmp/x && cat /tmp/x; {POSES}", image=closed))
    assert record.phase is Phase.SUCCEEDED, record.message
    assert (Path(record.folder or "") / "log.txt").read_text().split() == ["x"]


def test_a_run_says_of_which_image_it_is_and_an_equal_one_is_not_made_again(boxes: Boxes) -> None:
    (first,) = boxes(shell(POSES))
    image = str(first.provenance.image_id)
    assert image.startswith("sha256:")
    assert first.provenance.environment == image
    assert first.usage is not None
    assert first.usage.source.startswith("cgroup")
    assert first.usage.wall_seconds > 0
    (again,) = boxes(shell(POSES), rerun=False)
    assert again.started == first.started
    pinned = shell(POSES, image=f"{SHELL.rpartition(':')[0]}@{_digest()}")
    (by_digest,) = boxes(pinned)
    assert by_digest.phase is Phase.SUCCEEDED
    assert by_digest.provenance.environment == _digest()


def _digest() -> str:
    listed = subprocess.run(
        ["podman", "image", "inspect", "--format", "{{.Digest}}", SHELL],
        check=True,
        capture_output=True,
        text=True,
    )
    return listed.stdout.strip()


def test_usage_is_the_kernels_own_account(boxes: Boxes) -> None:
    """Compare it with what the program itself reads of its control group, as its first and its last act."""
    account = "cat /sys/fs/cgroup/cpuacct/cpuacct.usage /sys/fs/cgroup/cpu.stat 2>/dev/null\n"
    (record,) = boxes(
        shell(f"{account}{POSES}i=0; while [ $i -lt 300000 ]; do i=$((i + 1)); done\n{account}")
    )
    assert record.usage is not None
    words = (Path(record.folder or "") / "log.txt").read_text().split()
    told = [int(words[at + 1]) / 1e6 for at, word in enumerate(words) if word == "usage_usec"]
    begin, end = told or [int(words[0]) / 1e9, int(words[-1]) / 1e9]
    # What the runtime used before the program stands in both readings, and in none of the usage.
    assert end - begin <= record.usage.cpu.total_seconds <= end + 0.01
    assert record.usage.cpu.total_seconds > 0.1


def test_a_recording_that_others_can_not_read_is_named(boxes: Boxes) -> None:
    boxes(shell(POSES))
    (bag,) = boxes.home.path.glob("variants/*/recording.bag")
    aside = bag.with_name("closed")
    shutil.copy2(bag, aside)  # it is linked to the recording of all tests
    aside.chmod(0o600)
    aside.replace(bag)
    (record,) = boxes(shell(POSES))
    assert record.reason is Reason.PREPARATION_FAILED
    assert "can't be read by user 65532" in (record.message or "")
    assert "chmod o+rX" in (record.message or "")


PLAYED = {"paces": ["Realtime"], "realtime": {"queue": 1, "drop": "Oldest"}}
POSES_OF_NODE = {"poses": {"topic": "/odometry", "type": "Odometry"}}
NODE = PLAYED | {"ros1": POSES_OF_NODE, "recording": ["Rosbag1"]}
NODE2 = PLAYED | {"ros2": POSES_OF_NODE, "recording": ["Mcap"]}
MADE_BY = "asked of no registry: in a checkout of SLAM Hive, images/build --tool buildah "


def test_no_registry_is_asked_for_an_image_of_ours_or_of_this_machine(
    boxes: Boxes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever owns such a name at a public one would have programs run here."""
    cases = {
        "localhost/nobody/has-this:7": "which is in no registry and not here: podman build or podman tag",
        "slamhive/nobody-has-this:7": f"{MADE_BY}slamhive/nobody-has-this:7 makes it",
        f"docker.io/slamhive/has-this@sha256:{7:064}": MADE_BY,
    }
    records = boxes(*(shell("", image=name) for name in cases))
    for record, (name, message) in zip(records, cases.items(), strict=True):
        assert record.reason is Reason.ALGORITHM_UNAVAILABLE
        assert f"needs the image {name}, which is" in (record.message or "")
        assert message in (record.message or "")
    assert not [line for line in boxes.told if "pull" in line]


@pytest.mark.parametrize(
    ("node", "variable"), [(NODE, "SLAMHIVE_PLAYER_IMAGE"), (NODE2, "SLAMHIVE_ROS2_PLAYER_IMAGE")]
)
def test_without_the_image_of_its_player_a_node_is_unavailable(
    boxes: Boxes, monkeypatch: pytest.MonkeyPatch, node: dict[str, Any], variable: str
) -> None:
    """Both before anything runs, and when it should: in the same words, with what makes the image."""
    monkeypatch.setenv(variable, "slamhive/no-player:1")
    fields = shell(POSES) | node
    (record,) = boxes(fields, input={"pace": "Realtime"})
    assert record.reason is Reason.ALGORITHM_UNAVAILABLE
    assert f"{MADE_BY}slamhive/no-player:1" in (record.message or "")
    assert not [line for line in boxes.told if "pull" in line]
    spec = AlgorithmSpec.model_validate(BASE | fields)
    entry: Any = SimpleNamespace(algorithm=SimpleNamespace(spec=spec))
    assert unavailable(entry) == record.message


def test_a_node_that_its_image_can_not_start_is_the_algorithms_fault(boxes: Boxes, bare: str) -> None:
    """It shares its player's processes, so the runtime starts it, where else a small first program does."""
    cases = {
        "bash": "cannot start bash: No such file or directory; it, or the interpreter",
        "/no": "cannot start /no: No such file or directory; it, or the interpreter",
        "/script": "cannot start /script: No such file or directory; it, or the interpreter",
        "/secret": "cannot start /secret: Permission denied; the image doesn't let",
    }
    nodes = [NODE | {"image": bare, "command": [program]} for program in cases]
    for record, message in zip(boxes(*nodes, input={"pace": "Realtime"}), cases.values(), strict=True):
        assert record.reason is Reason.ALGORITHM_FAILED, record.message
        assert (record.message or "").startswith(message)


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Registry]:
    """A registry with an image, to which podman may speak without TLS."""
    layout = tmp_path / "layout"
    subprocess.run(
        ["buildah", "push", "-q", f"docker.io/{SHELL}", f"oci:{layout}:1"], check=True, timeout=300
    )
    (manifest,) = json.loads((layout / "index.json").read_text())["manifests"]
    served = Registry(layout, manifest["digest"])
    settings = tmp_path / "registries.conf"
    settings.write_text(f'[[registry]]\nlocation = "localhost:{served.server_port}"\ninsecure = true\n')
    monkeypatch.setenv("CONTAINERS_REGISTRIES_CONF", str(settings))
    yield served
    served.shutdown()
    served.server_close()


def test_an_image_is_pulled_once_for_all_runs(boxes: Boxes, registry: Registry, podman: Engine) -> None:
    name = f"localhost:{registry.server_port}/slamhive/shell:1"
    unknown = f"localhost:{registry.server_port}/slamhive/shell:2"
    try:
        records = boxes(shell(POSES, image=name), shell(f"{POSES}true", image=name), shell("", image=unknown))
    finally:
        podman.call("rmi", "--force", name)
    assert [record.phase for record in records] == [Phase.SUCCEEDED, Phase.SUCCEEDED, Phase.FAILED]
    assert [line for line in boxes.told if "pulling" in line and name in line] == [
        f"pulling the image {name} (once)"
    ]
    assert records[2].reason is Reason.IMAGE_PULL_FAILED
    assert "manifest unknown" in (records[2].message or "")
    assert len([path for path in registry.asked if path.endswith("manifests/1")]) == 1


@pytest.fixture
def docker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, podman: Engine) -> None:
    """A docker with a daemon, as far as its commands go: they are podman's.

    The first question for a container fails, as podman's does where the container ends while it looks.
    There is an /slamhive/output/known once its supervisor has found its first process.
    """
    folder = tmp_path / "bin"
    folder.mkdir()
    told = json.dumps({"ID": "a", "MemoryLimit": True, "CPUSet": True, "PidsLimit": True})
    program = folder / "docker"
    program.write_text(f"""#!/bin/sh
[ "$1" = info ] && echo '{told}' && exit
[ "$1" = inspect ] && mkdir {folder}/asked 2>/dev/null && echo "no such process" >&2 && exit 125
if [ "$1" = start ]; then
    while kill -0 $$; do
        grep -q '"algorithm": {{' process.json && touch run/output/known && break
        sleep 0.05
    done >/dev/null 2>&1 &
fi
exec podman "$@"
""")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/sbin:/usr/bin:/sbin:/bin")
    engines._asked.cache_clear()


@pytest.mark.usefixtures("docker")
def test_docker_is_told_nothing_that_it_does_not_know(boxes: Boxes) -> None:
    boxes.choice = ContainerChoice.DOCKER
    good, bad, wrong = boxes(
        shell(f"{POSES}until [ -e /slamhive/output/known ]; do sleep 0.05; done"),
        shell("exit 3"),
        {"image": SHELL, "command": ["/no"]},
    )
    assert good.phase is Phase.SUCCEEDED, good.message
    assert good.usage is not None
    assert good.usage.source.startswith("cgroup")
    assert bad.message == "exit code 3"
    assert "cannot start /no: No such file or directory" in (wrong.message or "")
    supervised = json.loads((Path(good.folder or "") / "supervisor.json").read_text())
    assert supervised["contained"]["engine"] == ["docker"]
    assert supervised["contained"]["pidPath"] is None
