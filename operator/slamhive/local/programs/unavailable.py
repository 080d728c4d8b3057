# SPDX-License-Identifier: Apache-2.0
"""Words of all executors: that an algorithm can't run on this machine, or isn't wanted any more."""

from __future__ import annotations

from slamhive.model.errors import SlamHiveError


class Unavailable(SlamHiveError):  # noqa: N818 - a state that the user is told of
    """An algorithm can't run on this machine; the message says what it would take."""

    reason = "AlgorithmUnavailable"


class ImageMissing(SlamHiveError):  # noqa: N818 - as above
    """An algorithm's image can't be had; the message says why."""

    reason = "ImagePullFailed"


class GivenUp(BaseException):
    """End of the making of a dataset, recording or environment that nobody waits for; no run has failed."""
