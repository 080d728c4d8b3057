# SPDX-License-Identifier: Apache-2.0
"""The entry point of ``slamhive-eval``: what must happen before numpy is imported, and how errors leave.

Exit codes: 0 done, 1 some of many pairs failed (``batch``), 2 wrong input with one sentence on stderr,
130 interrupted.
"""

from __future__ import annotations

import gc
import os
import sys
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        arguments: Words after the program's name; None for those of the process, which then ends here.

    Returns:
        The exit code.
    """
    # More BLAS threads cost 0.1 s at start and serve 3×3 matrices nothing; their number is read on import.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if arguments is None:
        gc.disable()  # imports leave no garbage, but looking for it takes a tenth of the start
        _end(_run(None))
    return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    from slamhive_eval import subcommands  # noqa: PLC0415 - its commands import numpy
    from slamhive_eval.errors import EvaluationError  # noqa: PLC0415

    try:
        return subcommands.run(arguments)
    except EvaluationError as error:
        sys.stderr.write(f"slamhive-eval: {error}\n")
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # whoever read our output has seen enough
        return 0


def _end(code: int) -> NoReturn:
    """End the process at once: taking down numpy piece by piece is a tenth of a small evaluation."""
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except BrokenPipeError:
        pass
    except OSError as error:
        os.write(2, f"slamhive-eval: the output can't be written: {error.strerror or error}\n".encode())
        code = 2
    os._exit(code)


if __name__ == "__main__":
    main()
