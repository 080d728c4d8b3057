# SPDX-License-Identifier: Apache-2.0
"""``python -m slamhive_eval``: the command ``slamhive-eval`` where its script is not on the path."""

from __future__ import annotations

from slamhive_eval.command import main

main()
