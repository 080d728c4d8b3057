# SPDX-License-Identifier: Apache-2.0
"""``slamhive gate``: runs of now against recorded ones, with an answer that a pull request is refused by."""
