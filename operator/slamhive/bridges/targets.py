# SPDX-License-Identifier: Apache-2.0
"""Programs that runs are handed to."""

from __future__ import annotations

from slamhive.model.base import Choice


class BridgeTarget(Choice):
    """A program that runs are handed to."""

    TENSORBOARD = "tensorboard"
    MLFLOW = "mlflow"
    WANDB = "wandb"
    RERUN = "rerun"
