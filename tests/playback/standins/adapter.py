# SPDX-License-Identifier: Apache-2.0
"""Adapter of the stand-ins: it runs the rendered run.sh, as a container's command would."""

import os
import sys
from pathlib import Path

own = Path(__file__).parent
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), str(own / "bin"), os.environ["PATH"]])
os.environ["PYTHONPATH"] = os.pathsep.join([str(own), os.environ.get("PYTHONPATH", "")])
os.environ["STANDIN_EXPECTED"] = str(own / "expected.json")
os.environ["BASH_ENV"] = os.devnull  # a ROS of this machine's own would go before the stand-ins
script = Path(os.environ["SLAMHIVE_FILES"]) / "run.sh"
os.execvp("bash", ["bash", str(script)])  # noqa: S606
