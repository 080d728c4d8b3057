# SPDX-License-Identifier: Apache-2.0
"""Build of the container images: what `make images` and `images/build` run.

Standard library alone, but for the lists of packages (cyclonedx-python-lib).
"""
