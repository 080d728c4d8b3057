# SPDX-License-Identifier: Apache-2.0
"""Command that prints which modules the tests cover by less than 80 %, lines and branches, and why.

``make coverage`` calls it after the tests with the report of ``coverage json``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

ENOUGH = 80.0
REASONS: dict[str, str] = {}
"""Reasons why modules are covered by less, by their path in the checkout."""


def table(covered: dict[str, float]) -> str:
    """Return a line for each module below what is enough, the least first, with its reason.

    Args:
        covered: percent by path.

    >>> print(table({"a.py": 79.9, "b.py": 12, "c.py": 80}))
      12 %  b.py: no reason is given
      79 %  a.py: no reason is given
    2 of 3 modules are covered by less than 80 %
    """
    low = sorted((percent, path) for path, percent in covered.items() if percent < ENOUGH)
    lines = [
        f"{int(percent):4} %  {path}: {REASONS.get(path, 'no reason is given')}" for percent, path in low
    ]
    outdated = sorted(path for path in REASONS if covered.get(path, 100.0) >= ENOUGH)
    lines += [f"{path}: its reason is given in vain" for path in outdated]
    return "\n".join([*lines, f"{len(low)} of {len(covered)} modules are covered by less than {ENOUGH:g} %"])


def main() -> None:
    """Print the table of a report."""
    files = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["files"]
    print(table({path: found["summary"]["percent_covered"] for path, found in files.items()}))  # noqa: T201


if __name__ == "__main__":
    main()
