# SPDX-License-Identifier: Apache-2.0
"""Variables that an algorithm's program is started with, on a workstation and in a pod."""

from __future__ import annotations

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "TBB_NUM_THREADS",
)
"""What numerical libraries ask for the number of their threads."""


def program_variables(*, run: str, seed: int, cores: int, home: str, scratch: str) -> dict[str, str]:
    """Return the variables that every algorithm has.

    Args:
        run: its run folder.
        seed: of the run.
        cores: processors that it may use.
        home: an empty folder of its own.
        scratch: another one, for temporary files.
    """
    return {
        "SLAMHIVE_RUN": run,
        "SLAMHIVE_SEED": str(seed),
        **dict.fromkeys(THREAD_VARIABLES, str(max(1, cores))),
        "OMP_WAIT_POLICY": "PASSIVE",  # threads that wait would count as the algorithm's CPU time
        "HOME": home,
        "TMPDIR": scratch,
        "LANG": "C.UTF-8",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONNOUSERSITE": "1",
    }
