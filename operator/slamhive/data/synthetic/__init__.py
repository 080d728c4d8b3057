# SPDX-License-Identifier: Apache-2.0
"""Synthetic recordings with exact ground truth, made from a seed.

`generate` writes one; the standard ones are what the project's own figures and tests stand on.
"""

from slamhive.data.synthetic.generator import SyntheticOutput, generate
from slamhive.data.synthetic.standard import STANDARD_CAMERA, STANDARD_LIDAR, TRAINING_CAMERA

__all__ = ["STANDARD_CAMERA", "STANDARD_LIDAR", "TRAINING_CAMERA", "SyntheticOutput", "generate"]
