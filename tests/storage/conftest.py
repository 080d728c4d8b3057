# SPDX-License-Identifier: Apache-2.0
"""Places for objects, of each kind."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

from buckets import place, s3

__all__ = ["place", "s3"]
