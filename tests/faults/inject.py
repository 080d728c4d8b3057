# SPDX-License-Identifier: Apache-2.0
"""Inject faults of the disk at random writes of a sweep: ``python tests/faults/inject.py --faults 200``.

Half of them at any write, half at each kind of file and call in turn, as few files take most of the writes.
After each the sweep is run once more without a fault, and all must be as if there had been none. Prints what
became of them; a home in which something went wrong is kept, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path
from random import Random

from injecting import Fault, Injector
from scene import Outcome, Scene, form_of


def faults(scene: Scene, count: int, seed: int) -> list[Fault]:
    """Return random faults, the same for the same seed and the same writes."""
    random = Random(seed)
    calls = scene.undisturbed.calls
    kinds: dict[tuple[str, str], list[str]] = {}
    for call in calls:
        kinds.setdefault((call.name, form_of(call.path)), []).extend(call.kinds)
    counts = Counter((call.name, form_of(call.path)) for call in calls)
    places = sorted(kinds)
    random.shuffle(places)
    found = []
    for k in range(count):
        lasting = random.random() < 0.3
        if k % 2:
            number = random.randrange(len(calls))
            how = random.choice(calls[number].kinds)
            found.append(Fault(number + 1, how, lasting=lasting and how != "short"))
        else:
            place = places[k // 2 % len(places)]
            how = random.choice(sorted(set(kinds[place])))
            number = 1 + random.randrange(counts[place])
            found.append(Fault(number, how, lasting and how != "short", *place))
    return found


def main() -> int:
    """Inject, print and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--only", type=int, help="the one of this number")
    parser.add_argument("--list", action="store_true", help="print the kinds of writes alone")
    given = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="slamhive-faults-"))
    injector = Injector(folder)
    scene = Scene(folder, injector)
    print(f"{len(scene.undisturbed.calls)} writes; homes are in {folder}")
    if given.list:
        for (name, form), count in Counter(
            (c.name, form_of(c.path)) for c in scene.undisturbed.calls
        ).items():
            print(f"{count:6} {name:10} {form}")
        return 0
    table: Counter[tuple[str, str, str, str]] = Counter()
    bad = 0
    chosen = faults(scene, given.faults, given.seed)
    for number, fault in enumerate(chosen):
        if number < given.first or (given.only is not None and number != given.only):
            continue
        outcome = scene.inject(fault, table=number % 5 == 0)
        bad += bool(outcome.wrong)
        where = outcome.made[0] if outcome.made else None
        word = "WRONG" if outcome.wrong else outcome.word
        if where:
            table[where.name, form_of(where.path), where.what, word] += 1
        else:
            table["-", "-", "-", word] += 1
        _tell(number, outcome, word)
    print()
    for (name, form, what, word), count in sorted(table.items()):
        print(f"{count:4} {name:9} {what:7} {word:9} {form}")
    print(Counter(word for (*_, word), count in table.items() for _ in range(count)))
    return 1 if bad else 0


def _tell(number: int, outcome: Outcome, word: str) -> None:
    places = f"{outcome.made[0].name} {outcome.made[0].path}" if outcome.made else ""
    print(f"{number:4} {word:9} {outcome.fault}: {places} ({len(outcome.made)})", flush=True)
    for line in outcome.wrong:
        print(f"       ! {line}")
    told = [line for line in outcome.first.err.strip().splitlines() if line.strip()]
    for line in told[:8] if outcome.wrong else [line for line in told if "generating" not in line][-3:]:
        print(f"       | {line[:300]}")


if __name__ == "__main__":
    sys.exit(main())
