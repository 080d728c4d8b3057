# SPDX-License-Identifier: Apache-2.0
"""Build hook of the distribution slamhive, called by hatchling: it needs slamhive-eval of the same version.

The version is written once, in evaluator/slamhive_eval/__init__.py.
"""

from __future__ import annotations

from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


class Dependencies(MetadataHookInterface):
    """The dependencies that pyproject.toml lists for this hook, and the evaluator."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Write the dependencies into the distribution's metadata."""
        evaluator = f"slamhive-eval=={metadata['version']}"
        metadata["dependencies"] = [evaluator, *self.config["dependencies"]]
