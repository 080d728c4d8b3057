# SPDX-License-Identifier: Apache-2.0
"""Program in a run's pod that renders the algorithm's settings files before anything else starts.

``python3 -P -m slamhive.jobs.render``, with ``request/request.json``, the unified configuration at
``configuration/config.yaml`` and the run folder at ``run``: what it renders goes to ``run/files``, which the
algorithm sees read-only.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import yaml

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.jobs.program import arguments, parse, read_request, run_program
from slamhive.jobs.requests import RenderRequest
from slamhive.model.configuration import RunConfiguration
from slamhive.model.results import Reason
from slamhive.templating import place_files, render

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def main(argv: Sequence[str] | None = None) -> int:
    """Render what the request asks for."""
    options = arguments("Render an algorithm's settings files.").parse_args(argv)
    return run_program(lambda: _work(options.root), refusal=Reason.INVALID_PARAMETERS)


def _work(root: Path) -> str:
    request = parse(RenderRequest, read_request(root), "request")
    text = (root / "configuration" / "config.yaml").read_bytes()
    told = parse(RunConfiguration, yaml.load(text, Loader=_Loader), "config.yaml").as_json()  # noqa: S506
    templates = [(file.path, file.template) for file in request.files]
    rendered = render(templates, told, request.run, f"{request.run}/{SETTINGS_FOLDER}")
    place_files(rendered, root / "run" / SETTINGS_FOLDER)
    return ""


if __name__ == "__main__":
    sys.exit(main())
