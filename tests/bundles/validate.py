# SPDX-License-Identifier: Apache-2.0
"""Validates a crate without a network: ``python validate.py CRATE.zip``, where roc-validator is installed.

The JSON-LD context, which the validator asks the network for, is put into its cache from the copy beside this
file (RO-Crate 1.1.3, CC0).
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

import requests
from requests.adapters import HTTPAdapter
from requests_cache import CachedSession
from rocrate_validator import services
from rocrate_validator.models import Severity
from urllib3 import HTTPResponse

CONTEXT = Path(__file__).with_name("ro-crate-1.1-context.json")
ADDRESS = "https://w3id.org/ro/crate/1.1/context"


def keep_context(cache: Path) -> None:
    """Put the context into a cache, as if it had been fetched."""
    session = CachedSession(cache_name=str(cache), backend="sqlite", expire_after=-1)
    for accept in ("application/ld+json", "application/ld+json, application/json;q=0.9, */*;q=0.1", "*/*"):
        asked = requests.Request("GET", ADDRESS, headers={"Accept": accept}).prepare()
        raw = HTTPResponse(
            io.BytesIO(CONTEXT.read_bytes()),
            {"Content-Type": "application/ld+json"},
            200,
            preload_content=False,
            request_url=ADDRESS,
        )
        session.cache.save_response(HTTPAdapter().build_response(asked, raw))
    session.close()


def main() -> None:
    """Print what is wrong, a line each; the exit code says whether anything is."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "cache"
        keep_context(cache)
        result = services.validate(
            services.ValidationSettings(
                rocrate_uri=sys.argv[1],
                profile_identifier="process-run-crate-0.5",
                requirement_severity=Severity.REQUIRED,
                offline=True,
                cache_path=cache,
            )
        )
    for issue in result.get_issues():
        sys.stdout.write(f"{issue.check.identifier}: {issue.message}\n")
    sys.stdout.write(f"{len(result.executed_checks)} checks\n")
    sys.exit(not result.passed())


if __name__ == "__main__":
    main()
