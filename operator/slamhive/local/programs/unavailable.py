# SPDX-License-Identifier: Apache-2.0
"""The word of all executors that an algorithm can't run on this machine."""

from __future__ import annotations

from slamhive.model.errors import SlamHiveError


class Unavailable(SlamHiveError):  # noqa: N818 - a state that the user is told of
    """An algorithm can't run on this machine; the message says what it would take."""

    reason = "AlgorithmUnavailable"


class ImageMissing(SlamHiveError):  # noqa: N818 - as above
    """An algorithm's image can't be had; the message says why."""

    reason = "ImagePullFailed"
