# SPDX-License-Identifier: Apache-2.0
"""The sampler of a search, as those that drive one see it."""

from __future__ import annotations

import importlib.util
import itertools
import json
import math
import os
import select
import signal
import subprocess
import sys
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np

from slamhive.model.errors import SystemFault
from slamhive.model.extras import without
from slamhive.model.search import SearchMethod, Trial
from slamhive.sampling.limits import CPU_SECONDS, WALL_SECONDS
from slamhive.sampling.telling import TrialsTold, value_meant

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from slamhive.engine import TrialStanding
    from slamhive.model.search import Search
    from slamhive.plan.searching import SearchSpace

_TRIES = ((0, 1), (1, 3), (4, 12))
"""Suggestions that are asked for where those before were tried already: from which on, how many."""
_MOST_AROUND = 1_000
"""Settings around a suggestion that are looked at for one that wasn't tried."""
_NEEDS = {
    SearchMethod.SOBOL: ("scipy",),
    SearchMethod.TPE: ("optuna", "scipy"),
    SearchMethod.NSGA_II: ("optuna", "scipy"),
}


def require_sampler(method: SearchMethod) -> None:
    """Check that the libraries of a method are there.

    Raises:
        InputError: they are of an extra that isn't installed.
    """
    for package in _NEEDS.get(method, ()):
        if importlib.util.find_spec(package) is None:
            raise without(f"spec.search.method: {method}", package, "search")


class Proposer(Protocol):
    """Proposer of settings, as drivers of searches see it."""

    def propose(
        self,
        search: Search,
        space: SearchSpace,
        trials: Sequence[Trial],
        standings: Sequence[TrialStanding],
        told: int,
    ) -> Trial | None:
        """Return the next setting to try; None where all have been tried."""


class Sampler:
    """Proposals of settings, by a process of its own that begins at the first one and ends at `close`.

    A proposal follows from the search's seed, the trial's number and the results of the trials told, so
    that it is the same whenever it is asked for. Not for several threads at once.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._told: TrialsTold | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        process.wait()

    def propose(
        self,
        search: Search,
        space: SearchSpace,
        trials: Sequence[Trial],
        standings: Sequence[TrialStanding],
        told: int,
    ) -> Trial | None:
        """Return the next setting to try, one that none of the trials has; None where all have been tried.

        Args:
            search: its settings.
            space: what can be tried.
            trials: all trials so far.
            standings: where each stands.
            told: the results of all trials below this number are told.

        Raises:
            InputError: the method's libraries aren't installed.
            SystemFault: the process ended twice, or ran into its limits.
        """
        require_sampler(search.method)
        if self._told is None or self._told.space is not space:
            self._told = TrialsTold(space)
        tried = self._told.keys(trials)
        if space.size is not None and len(tried) >= space.size:
            return None
        asked, before = self._told.question(search), self._told.told(standings, told)
        learns = search.method in {SearchMethod.TPE, SearchMethod.NSGA_II}
        for begin, tries in _TRIES:
            found = self._answer(asked | {"begin": begin, "tries": tries}, before, search.method)
            # What a method that learns proposes again is where it is best: then the nearest one is tried.
            near = itertools.chain.from_iterable(_around(asked, one) for one in found) if learns else ()
            for numbers in itertools.chain(found, near):
                values = [value_meant(axis, value) for axis, value in zip(space.axes, numbers, strict=True)]
                if space.key(values) not in tried:
                    return Trial(values=space.canonical(values), told=told)
        untried = _untried(space, tried, [search.seed, len(trials)])
        return None if untried is None else Trial(values=space.canonical(untried), told=told)

    def _answer(self, asked: dict[str, Any], before: str, method: SearchMethod) -> list[list[float]]:
        line = f'{{"trials": {before}, {json.dumps(asked)[1:]}\n'.encode()
        problem = ""
        for _ in range(2):
            try:
                answer = self._exchange(line)
            except (OSError, EOFError, ValueError):
                problem = self._ended()
                continue
            if "found" in answer:
                return list(answer["found"])
            problem = answer["problem"]
            self.close()
        raise SystemFault(f"the sampler {method}: no proposal for trial {asked['number']}: {problem}")

    def _exchange(self, line: bytes) -> dict[str, Any]:
        """Return the process's answer.

        Raises:
            OSError, EOFError, ValueError: it ended, or stood still.
        """
        if self._process is None:
            self._process = subprocess.Popen(
                # -P: a json.py in the user's working folder is none of ours.
                [sys.executable, "-P", "-m", "slamhive.sampling"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        stdin, stdout = self._process.stdin, self._process.stdout
        if stdin is None or stdout is None:
            raise EOFError
        stdin.write(line)
        stdin.flush()
        if not select.select([stdout], [], [], WALL_SECONDS)[0]:
            raise EOFError
        answer = json.loads(stdout.readline())
        return dict(answer)

    def _ended(self) -> str:
        """Let go of a process that ended or stands still, and return a word why."""
        process = self._process
        if process is None:
            return "it can't be started"
        with suppress(subprocess.TimeoutExpired):
            process.wait(1)
        code = process.returncode
        self.close()
        if code is None:
            return f"no answer within {WALL_SECONDS:g} s"
        if code == -signal.SIGXCPU:
            return f"it takes more than {CPU_SECONDS} s of processor time"
        return f"its process ended ({code})"


def _around(asked: Mapping[str, Any], found: Sequence[float]) -> Iterator[list[float]]:
    """Yield a suggestion and then the settings around it, the nearest first, equally near ones by seed."""
    rng = np.random.default_rng([asked["seed"], asked["number"], _MOST_AROUND])
    ahead, seen = deque([tuple(found)]), {tuple(found)}
    while ahead and len(seen) < _MOST_AROUND:
        setting = ahead.popleft()
        yield list(setting)
        near: list[tuple[float, ...]] = []
        for place, (axis, value) in enumerate(zip(asked["axes"], setting, strict=True)):
            if axis["kind"] == "real":
                continue
            low, high = axis["low"], axis["high"]
            steps = range(low, high + 1) if axis["kind"] == "choice" else (value - 1, value + 1)
            near += [(*setting[:place], one, *setting[place + 1 :]) for one in steps if low <= one <= high]
        fresh = [one for one in near if one not in seen]
        seen.update(fresh)
        ahead += [fresh[place] for place in rng.permutation(len(fresh))]


def _untried(space: SearchSpace, tried: set[str], seed: Sequence[int]) -> list[Any] | None:
    """Return an untried setting of a space that has an end, at random by the seed; None without one."""
    if space.size is None:
        return None
    values = [
        axis.dimension.values
        if axis.ends is None
        else range(math.ceil(axis.ends[0]), math.floor(axis.ends[1]) + 1)
        for axis in space.axes
    ]
    rng = np.random.default_rng([*seed, sum(_TRIES[-1])])
    at, stride = int(rng.integers(space.size)), int(rng.integers(1, max(2, space.size)))
    while math.gcd(stride, space.size) > 1:
        stride += 1
    for _ in range(space.size):
        rest, setting = at, []
        for choices in values:
            rest, place = divmod(rest, len(choices))
            setting.append(choices[place])
        if space.key(setting) not in tried:
            return setting
        at = (at + stride) % space.size
    return None
