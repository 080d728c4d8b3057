# SPDX-License-Identifier: Apache-2.0
"""Settings files of algorithms, rendered from templates: by a process of its own that the kernel bounds."""

from slamhive.templating.placing import place_files
from slamhive.templating.process import RenderedFile, render

__all__ = ["RenderedFile", "place_files", "render"]
