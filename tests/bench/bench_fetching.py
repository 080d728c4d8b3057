# SPDX-License-Identifier: Apache-2.0
"""Fetching beside curl, killed 30 times on the way, and the list of a catalogue of 1,000 sequences.

Run: python tests/bench/bench_fetching.py
"""

from __future__ import annotations

import hashlib
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "data" / "datalab"))

from serving import Site, make_certificate, serving

MEBIBYTE = 1 << 20
SIZE = 768 * MEBIBYTE
KILLS = 30
PIECE = 8 * MEBIBYTE
ROUNDS = 5
FETCH = """
import sys
from pathlib import Path
from slamhive.data.files import fetching
fetching.PAUSES = (0.0,) * 8
pieces = Path(sys.argv[4]).read_text().split() if len(sys.argv) > 4 else []
size = 8 << 20 if pieces else 0
wanted = fetching.WantedFile([sys.argv[1]], "bench", sys.argv[3] or None, piece_bytes=size, pieces=pieces)
fetching.fetch_file(wanted, Path(sys.argv[2]))
"""
LIST = """
import resource
from slamhive.cli.main import main
try:
    main()
finally:
    used = resource.getrusage(resource.RUSAGE_SELF)
    open({file!r}, "w").write(str(used.ru_utime + used.ru_stime))
"""


def rate_beside_curl(site: Site, folder: Path, sha256: str) -> None:
    """Print rates and CPU seconds of all, in turn, by a server in a process of its own."""
    url, place = f"{site.url}/large.bin", folder / "fetched"
    # Brought to disk, as what slamhive has fetched is.
    summed = f"curl -sS {url} | tee {place} | openssl dgst -sha256 > {os.devnull} && sync {place}"
    commands = {
        "curl, sync": ["sh", "-c", f"curl -sS -o {place} {url} && sync {place}"],
        "curl | openssl dgst -sha256, sync": ["sh", "-c", summed],
        "slamhive": [sys.executable, "-c", FETCH, url, str(place), sha256],
        # What an interpreter takes to start is no rate.
        "start": [sys.executable, "-c", FETCH, f"{site.url}/empty.bin", str(place), ""],
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    for _ in range(ROUNDS):
        for name, command in commands.items():
            times[name].append(_timed(command))
            place.unlink()
    least = {name: tuple(map(min, zip(*found, strict=True))) for name, found in times.items()}
    wall, cpu = (least["slamhive"][k] - least["start"][k] for k in (0, 1))
    peers = [
        f"{SIZE / wall / 1e6:.0f} MB/s, {cpu:.2f} CPU s",
        *(
            f"{name}: {SIZE / found[0] / 1e6:.0f} MB/s, {found[1]:.2f} CPU s, ratio {found[0] / wall:.2f}"
            for name, found in least.items()
            if name.startswith("curl")
        ),
    ]
    print(f"fetch with checksum · {' · '.join(peers)} · limit 0.9 of the first")


def killed(site: Site, folder: Path, content: Path, sha256: str) -> None:
    """Print what came of a fetch that is killed, dropped and sent a wrong byte on the way."""
    place, sums = folder / "killed", folder / "sums"
    with content.open("rb") as file:
        sums.write_text(
            "\n".join(hashlib.sha256(block).hexdigest() for block in iter(lambda: file.read(PIECE), b""))
        )
    command = [sys.executable, "-c", FETCH, f"{site.url}/large.bin", str(place), sha256, str(sums)]
    chance = random.Random(7)
    site.sent, site.wrong = 0, {"/large.bin": SIZE // 3}
    done = kills = 0
    while kills < KILLS:
        until = site.sent + chance.randrange(1, 2 * SIZE // KILLS)
        site.drops = [chance.randrange(1, 2 * SIZE // KILLS)] if chance.random() < 0.3 else []
        process = subprocess.Popen(command)
        while site.sent < until and process.poll() is None:
            time.sleep(0.001)
        if process.poll() is not None:
            done += 1
            break
        process.kill()
        process.wait()
        kills += 1
    subprocess.run(command, check=True)
    with place.open("rb") as file:
        right = hashlib.file_digest(file, "sha256").hexdigest() == sha256
    print(
        f"killed {kills} times, drops, a wrong byte · {'right' if right else 'WRONG'}, "
        f"{site.sent / SIZE:.2f} of its size sent · limit 1.2"
    )


def listed(folder: Path) -> None:
    """Print what listing 1,000 sequences takes, and what of it is the command's start."""
    families = folder / "families"
    families.mkdir()
    for number in range(20):
        about = "place: hall, difficulty: easy, durationSeconds"
        rows = "\n".join(
            f"  seq_{k:02d}: {{sizes: {{archive: {k + 1}000000}}, attributes: {{{about}: {k}}}}}"
            for k in range(37)
        )
        (families / f"family{number}.yaml").write_text(
            f"name: family{number}\ntitle: Family {number}\nhomepage: https://localhost/\nlicense: CC0-1.0\n"
            "cite: Nobody\nlayout: Euroc\nsensors: {left: Camera, right: Camera, imu: Imu}\n"
            "attributes: {indoor: true}\n"
            'parts: {archive: {url: "https://localhost/{sequence}.zip", members: [mav0]}}\n'
            f"sequences:\n{rows}\n"
        )
    environment = os.environ | {"SLAMHIVE_CATALOGUE": str(families), "SLAMHIVE_HOME": str(folder / "home")}
    seconds = {}
    for words in (("list", "--available"), ("list",)):
        used = []
        code = LIST.format(file=str(folder / "seconds"))
        for _ in range(5):
            command = [sys.executable, "-c", code, "dataset", *words]
            subprocess.run(command, env=environment, check=True, capture_output=True)
            used.append(float((folder / "seconds").read_text()))
        seconds[words] = min(used)
    whole, base = seconds["list", "--available"], seconds["list",]
    own = f"{whole:.2f} s, of it {whole - base:.2f} s for the list"
    print(f"list {20 * 37 + 260:,} sequences, CPU · {own} · limits 0.6 s, 0.3 s")


def _timed(command: list[str]) -> tuple[float, float]:
    """Run a command; return its wall seconds and its CPU seconds."""
    begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - begin, cpu


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        served = folder / "served"
        served.mkdir()
        content = served / "large.bin"
        with content.open("wb") as file:
            for _ in range(SIZE // MEBIBYTE):
                file.write(os.urandom(MEBIBYTE))
        (served / "empty.bin").write_bytes(b"")
        with content.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        certificate = make_certificate(folder)
        os.environ["SSL_CERT_FILE"] = os.environ["CURL_CA_BUNDLE"] = str(certificate[0])
        with serving(Site(served), *certificate) as site:
            rate_beside_curl(site, folder, sha256)
            killed(site, folder, content, sha256)
        listed(folder)
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(f"most memory of a process · {used >> 10} MiB")


if __name__ == "__main__":
    main()
