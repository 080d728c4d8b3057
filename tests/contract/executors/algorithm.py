# SPDX-License-Identifier: Apache-2.0
"""An algorithm that behaves as its parameter says, with nothing but what every executor gives it.

That is the run folder of the contract, environment variables, and Python's standard library: its text is an
adapter on a workstation and what ``python3 -c`` is given in an image. What follows from each behaviour stands
in table.py.

Whatever it fills is bounded, so that a fault of ours doesn't fill the machine.
"""

import os
import signal
import sys
from contextlib import suppress

MIB = 1 << 20
START_SECONDS = 1600000000
"""Beginning of the recording."""
POSES = 100
WAYPOINTS = (
    *((5.8, 0.1), (5.8, 0.1), (5.8, 0.1), (5.8, 0.1), (5.8, 0.4), (4.9, 2.0)),
    *((2.2, 3.4), (1.7, 3.5), (1.7, 3.5), (1.7, 3.5), (1.7, 3.5)),
)
"""Positions of the sensor at each full second, m."""
NO_POSE = "# nothing was tracked\n"
BEFORE_CONFIGURATION = "404"
"""The seed, a variable of its environment, by which it ends before it has read anything."""

FLAT = (
    '{"framesOffered": 9, "framesProcessed": 8, "lost": 0.1234567890123, "map": " voxels ", "closed": true}'
)
NESTED = '{"latencySeconds": {"mean": 1e-7, "tail": {"p95": 0.2, "worst": {"at": 3}}}}'
METRICS = {
    "metrics-plain": FLAT,
    "metrics-nested": NESTED,
    "metrics-nothing": '{"a": null, "b": {}, "c": {"d": null}}',
    "metrics-lists": '{"a": [1], "b": {"c": [2], "d": 2}}',
    "metrics-infinite": '{"a": NaN, "b": {"c": -Infinity}, "d": 1e400, "e": 1}',
    "metrics-large-number": f'{{"a": {2**60}, "b": {2**53}}}',
    "metrics-100-keys": "{" + ", ".join(f'"k{number:02}": {number}' for number in range(100)) + "}",
    "metrics-long-texts": "{"
    + ", ".join([*(f'"k{number}": "{"v" * 190}"' for number in range(20)), '"last": 1'])
    + "}",
    "metrics-long-name": f'{{"{"n" * 150}": 1, "a": 2}}',
    "metrics-terminal": (
        '{"a\\u001b[31m": 1, "b": "\\u001b[31mred", "c\\ud800": 1, "d": "\\ud800\\u0000", "e": 1}'
    ),
    "metrics-deep": '{"a":' * 700 + "1" + "}" * 700,
    "metrics-no-object": "[1, 2]",
    "metrics-half": '{"a": 1',
    "metrics-brackets": "[" * (4 * MIB),
    "metrics-too-large": f'{{"a": "{"b" * (4 * MIB)}"}}',
}
"""Content of metrics.json beside a sound trajectory."""


def lines(count: int = POSES) -> list[str]:
    """Return poses at 10 Hz on about the path of the sensor, without turns."""
    found = []
    for k in range(count):
        (x, y), (x_next, y_next), share = WAYPOINTS[k // 10], WAYPOINTS[k // 10 + 1], k % 10 / 10
        place = f"{x + share * (x_next - x):.3f} {y + share * (y_next - y):.3f}"
        found.append(f"{START_SECONDS + k / 10:.1f} {place} 0 0 0 0 1\n")
    return found


def rows(form: str, count: int = POSES, every: int = 1) -> str:
    """Return the same poses with other numbers around them."""
    places = [line.split()[1:3] for line in lines()]
    found = []
    for k in range(0, count, every):
        x, y = places[k % POSES]
        found.append(form.format(k=k, x=x, y=y, ns=(START_SECONDS * 10 + k) * 10**8) + "\n")
    return "".join(found)


KITTI = "1 0 0 {x} 0 1 0 {y} 0 0 1 0"
EUROC = "{ns},-{x},-{y},0,1,0,0,0,9,9,9"
"""The world in the sensor's frame: inverted."""
TABLE = "a,{k},{x},{y},0,0,0,0,1"
TABLE_NAMES = "remark,frame,px,py,pz,i,j,k,r\n"
KEYFRAMES = "{ns}.0 {x} {y} 0 0 0 0 1"
KITTI_FILE, EUROC_FILE, TABLE_FILE = "poses/kitti.txt", "poses.csv", "table.csv"
KEYFRAMES_FILE = "KeyFrameTrajectory.txt"


def elsewhere() -> str:
    """Return poses of another time."""
    return "".join(line.replace("16", "17", 1) for line in lines())


def write(name: str, text: str) -> None:
    """Write a file of the output folder."""
    with open(f"output/{name}", "w") as file:
        file.write(text)


def trajectory(text: str) -> None:
    write("trajectory.txt", text)


def poses(count: int = POSES) -> None:
    trajectory("".join(lines(count)))


def say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def end_by(number: int) -> None:
    os.kill(os.getpid(), number)


def sleep() -> None:
    while True:
        signal.pause()


def child(*, session: bool = False) -> None:
    """Start a program that stays."""
    argv = ["/bin/sleep", "86400"]
    quiet = [(os.POSIX_SPAWN_OPEN, number, "/dev/null", os.O_RDWR, 0) for number in range(3)]
    os.posix_spawn(argv[0], argv, os.environ, file_actions=quiet, setsid=session)


def well() -> None:
    poses()
    write(
        "metrics.json", '{"framesOffered": 100, "framesProcessed": 99, "framesDropped": 1, "keyframes": 12}'
    )


def crash_before_first_pose() -> None:
    say("the voxel map is empty")
    sys.exit(3)


def crash_between_poses() -> None:
    poses(POSES // 2)
    with open("output/trajectory.txt", "a") as file:
        file.write("1600000005.0 5.")
    say("lost the map after 50 poses")
    sys.exit(4)


def crash_after_last_pose() -> None:
    well()
    say("the map can't be saved")
    sys.exit(5)


def exit_code(code: int) -> None:
    poses()
    sys.exit(code)


def deaf() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sleep()


def memory() -> None:
    hog = []
    while len(hog) < 4096:
        hog.append(bytearray(b"\1") * MIB)
    sleep()


def forks() -> None:
    for _ in range(400):
        child()
    say("400 children")
    sleep()


def orphans() -> None:
    """Leave children in sessions of their own, which go on when this program has ended well."""
    for _ in range(3):
        child(session=True)
    poses()


def log() -> None:
    """Print more than is kept of a log, and not end."""
    for _ in range(256):
        sys.stdout.write("a line that says nothing, again and again, until the disk is full of it\n" * 14500)
    sleep()


def outside() -> None:
    """Try to write where nothing of a run's own is."""
    places = (
        *(
            "neighbour",
            "config.yaml",
            "dataset/poses",
            "assets/weights",
            "../neighbour",
            "output/../../neighbour",
        ),
        *("/opt/neighbour", "/etc/passwd", "/slamhive-run/summary.json", "/sys/fs/cgroup/cgroup.procs"),
    )
    for place in places:
        try:
            with open(place, "a") as file:
                file.write("intruder\n")
        except OSError:
            continue
        say(f"wrote to {place}")
        sys.exit(6)
    say("nothing outside of the output can be written")
    sys.exit(5)


def with_a_number_that_is_none() -> None:
    found = (line.split(" ", 2) for line in lines())
    trajectory("".join(f"{stamp} nan {rest}" for stamp, _, rest in found))


def garbage() -> None:
    with open("output/trajectory.txt", "wb") as file:
        file.write(bytes(range(256)) * 256)


def endless_line() -> None:
    with open("output/trajectory.txt", "wb") as file:
        file.writelines(b"7" * MIB for _ in range(64))


def vast_trajectory() -> None:
    trajectory("")
    os.truncate("output/trajectory.txt", (512 << 20) + 1)


def kitti(text: str = "") -> None:
    """Write poses in a file of its own, without stamps."""
    os.mkdir("output/poses")
    write(KITTI_FILE, text or rows(KITTI))


def turned(row: int) -> str:
    """Return poses of which one has no rotation."""
    found = rows(KITTI).splitlines(keepends=True)
    found[row] = found[row].replace("1 0 0", "1 1 0", 1)
    return "".join(found)


def in_the_way() -> None:
    kitti()
    os.mkdir("output/trajectory.txt")


def instead_of_kitti(*deed: object) -> None:
    """Write the contract's own file, and perhaps put something else in place of the one that is declared."""
    poses()
    os.mkdir("output/poses")
    for make, *arguments in filter(None, [deed]):
        make(*arguments, f"output/{KITTI_FILE}")


def folder_is_a_link() -> None:
    """Lead to a file by a folder that is none."""
    kitti()
    os.rename("output/poses", "output/hidden")
    os.symlink("hidden", "output/poses")


def kitti_and_crash() -> None:
    kitti()
    sys.exit(4)


def table(names: str = TABLE_NAMES, keyframes: str = KEYFRAMES) -> None:
    write(TABLE_FILE, names + rows(TABLE))
    if keyframes:
        write(KEYFRAMES_FILE, rows(keyframes, every=8))


def compressed(name: str, text: str) -> None:
    import gzip

    with open(f"output/{name}", "wb") as file:
        file.write(gzip.compress(text.encode()))


def flood() -> None:
    """Write more than the memory limit: what the kernel keeps of files is no memory of the algorithm."""
    poses()
    with open("output/map.bin", "wb") as file:
        file.writelines(bytes(MIB) for _ in range(256))


def output_too_large() -> None:
    """Let the output grow beyond 8 GiB, without a block on the disk."""
    write("map.bin", "")
    os.truncate("output/map.bin", (8 << 30) + 1)
    sleep()


def refused(*deeds: tuple) -> None:
    """Do what the executor may refuse, which the algorithm puts up with."""
    for deed, *arguments in deeds:
        with suppress(OSError):
            deed(*arguments)


def output_is_a_link() -> None:
    poses()
    os.unlink("output/trajectory.txt")
    refused((os.rmdir, "output"), (os.symlink, "/etc", "output"))


def removes_its_folder() -> None:
    import shutil

    poses()
    here = os.getcwd()
    os.chdir("/")
    shutil.rmtree(here, ignore_errors=True)


def folder_as_summary() -> None:
    poses()
    refused((os.mkdir, "../summary.json"))


def folder_as_process_record() -> None:
    poses()
    while os.path.exists("../process.json"):
        with open("../process.json") as file:
            if f'"pid": {os.getpid()},' in file.read():  # no more is written to it
                break
    refused((os.unlink, "../process.json"), (os.mkdir, "../process.json"))


def folders_1500_deep() -> None:
    poses()
    place = os.open("output", os.O_RDONLY)
    for _ in range(1500):
        os.mkdir("d", dir_fd=place)
        below = os.open("d", os.O_RDONLY, dir_fd=place)
        os.close(place)
        place = below


def locked_folders() -> None:
    poses()
    os.makedirs("output/locked/inner")
    os.chmod("output/locked", 0)


def locked_output() -> None:
    poses()
    refused((os.chmod, "output", 0))


def with_metrics(text: str) -> None:
    poses()
    write("metrics.json", text)


ACTS = {
    "well": well,
    "crash-before-configuration": lambda: None,
    "crash-before-first-pose": crash_before_first_pose,
    "crash-between-poses": crash_between_poses,
    "crash-after-last-pose": crash_after_last_pose,
    "exit-1": lambda: exit_code(1),
    "exit-137": lambda: exit_code(137),
    "exit-255": lambda: exit_code(255),
    "segfault": lambda: end_by(signal.SIGSEGV),
    "abort": lambda: end_by(signal.SIGABRT),
    "killed": lambda: end_by(signal.SIGKILL),
    "terminated": lambda: end_by(signal.SIGTERM),
    "real-time-signal": lambda: end_by(signal.SIGRTMIN + 3),
    "hang": sleep,
    "deaf": deaf,
    "forks": forks,
    "log": log,
    "memory": memory,
    "orphans": orphans,
    "outside": outside,
    "not-a-number": with_a_number_that_is_none,
    "words": lambda: trajectory("I was never trained\n"),
    "unsorted": lambda: trajectory("".join(lines()[::-1])),
    "garbage": garbage,
    "endless-line": endless_line,
    "vast-trajectory": vast_trajectory,
    "compressed-trajectory": lambda: compressed("trajectory.txt", "".join(lines())),
    "link": lambda: os.symlink("/etc/passwd", "output/trajectory.txt"),
    "fifo": lambda: os.mkfifo("output/trajectory.txt"),
    "folder": lambda: os.mkdir("output/trajectory.txt"),
    "no-trajectory": lambda: write("poses.txt", "".join(lines())),
    "nothing": lambda: None,
    "empty-trajectory": lambda: trajectory(""),
    "lost": lambda: trajectory(NO_POSE),
    "elsewhere": lambda: trajectory(elsewhere()),
    "compressed-segments": lambda: (poses(), compressed("segments.csv", "start,end\n")),
    "kitti": kitti,
    "kitti-and-crash": kitti_and_crash,
    "kitti-lost": lambda: kitti(NO_POSE),
    "kitti-too-many": lambda: kitti(rows(KITTI, POSES + 1)),
    "kitti-no-rotation": lambda: kitti(turned(50)),
    "kitti-as-tum": lambda: kitti("".join(lines())),
    "kitti-in-the-way": in_the_way,
    "kitti-missing": instead_of_kitti,
    "kitti-link": lambda: instead_of_kitti(os.symlink, "/etc/passwd"),
    "kitti-fifo": lambda: instead_of_kitti(os.mkfifo),
    "kitti-folder-is-a-link": folder_is_a_link,
    "euroc-inverted": lambda: write(EUROC_FILE, "#timestamp\n" + rows(EUROC)),
    "euroc-in-seconds": lambda: write(EUROC_FILE, "".join(lines()).replace(" ", ",")),
    "table-and-keyframes": table,
    "table-without-keyframes": lambda: table(keyframes=""),
    "online": lambda: (poses(), write("trajectory.online.txt", "".join(lines()[:60]))),
    "online-is-a-link": lambda: (poses(), os.symlink("/etc/passwd", "output/trajectory.online.txt")),
    "table-without-a-column": lambda: table(TABLE_NAMES.replace("frame", "time")),
    "flood": flood,
    "output-too-large": output_too_large,
    "folder-as-samples": lambda: (poses(), os.mkdir("output/usage.csv")),
    "output-is-a-link": output_is_a_link,
    "removes-its-folder": removes_its_folder,
    "folder-as-summary": folder_as_summary,
    "folder-as-process-record": folder_as_process_record,
    "folders-1500-deep": folders_1500_deep,
    "locked-folders": locked_folders,
    "locked-output": locked_output,
    **{name: lambda text=text: with_metrics(text) for name, text in METRICS.items()},
}


def main() -> None:
    """Behave as config.yaml says."""
    if os.environ["SLAMHIVE_SEED"] == BEFORE_CONFIGURATION:
        sys.exit("no graphics card was found")
    os.chdir(os.environ["SLAMHIVE_RUN"])
    with open("config.yaml") as file:
        (name,) = [line.split()[1] for line in file if line.startswith("  behaviour: ")]
    ACTS[name]()


if __name__ == "__main__":
    main()
