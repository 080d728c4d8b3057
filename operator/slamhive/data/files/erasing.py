# SPDX-License-Identifier: Apache-2.0
"""Removal of what algorithms left: folders nested thousands deep, or locked."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def erase(path: Path) -> bool:
    """Remove a file or a tree, however deep it is and whatever its folders allow.

    Returns:
        Whether it is gone; what could not be removed is said on standard error.

    Raises:
        OSError: it is a file or link, and can't be removed.
    """
    if path.is_symlink() or not path.is_dir():
        path.unlink()
        return True
    # Neither follows links inside. An algorithm may have locked its folders, which are ours all the same.
    subprocess.run(["chmod", "-R", "u+rwX", "--", str(path)], check=False, stderr=subprocess.DEVNULL)
    return subprocess.run(["rm", "-rf", "--", str(path)], check=False).returncode == 0
