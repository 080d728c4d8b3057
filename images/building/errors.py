# SPDX-License-Identifier: Apache-2.0
"""The one error of this package."""


class BuildError(Exception):
    """Something that the user can mend; its text is the sentence that says how."""
