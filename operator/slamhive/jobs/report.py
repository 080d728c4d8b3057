# SPDX-License-Identifier: Apache-2.0
"""Program of a Job that makes lines of the log from another evaluator's ``output/results.jsonl``.

A line of that file is an object with the ``name`` (or ``uid``) of a run and either

- ``result``: an object with ``outcome``, ``coverage`` and ``values``, as our own evaluator writes it,
- ``error``: a sentence that says why the run could not be measured,
- or the outcome, coverage and values side by side: ``{"name": "a", "outcome": "Tracked", "ate": {...}}``.

Of several lines of a run the last one counts. NaN and infinity, which JSON doesn't have, become null.
"""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from slamhive.jobs.lines import encode_all
from slamhive.jobs.opening import read_bytes
from slamhive.jobs.program import arguments, parse, read_request, run_program
from slamhive.jobs.requests import EvaluateRequest
from slamhive.model.errors import InputError
from slamhive.model.reported import problem_of_values
from slamhive.model.results import Outcome, Result

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

RESULTS = "results.jsonl"
_FILE_BYTES = 64 << 20
_VALUES_BYTES = 64 << 10
"""Results become part of an object of the API server, which holds 1.5 MiB in all."""
_STRAYS = 20
_NAMES = ("uid", "name", "run")


def main(argv: Sequence[str] | None = None) -> int:
    """Report the lines of an evaluator."""
    options = arguments("Report what another evaluator found.").parse_args(argv)
    return run_program(lambda: _work(options.root))


def _work(root: Path) -> str:
    request = parse(EvaluateRequest, read_request(root), "request")
    text = read_bytes(root / "output", RESULTS, _FILE_BYTES).decode("utf-8", "replace")
    records = report(request, text)
    for line in encode_all(records):
        sys.stdout.write(line)
    sys.stdout.flush()
    failures = sum("error" in record for record in records)
    return json.dumps({"v": 1, "runs": len(request.runs), "failed": failures})


def report(request: EvaluateRequest, text: str) -> list[dict[str, Any]]:
    """Return a record for each run of a request, and then one for each line that belongs to none.

    Args:
        request: what was to be measured.
        text: what the evaluator wrote.
    """
    runs = {str(run.get(key)): run for run in request.runs for key in ("uid", "name")}
    found: dict[str, dict[str, Any]] = {}
    strays: list[dict[str, Any]] = []
    for number, line in _lines(text):
        content = _parse(line)
        where = f"{RESULTS}, line {number}"
        if content is None:
            strays.append({"uid": None, "name": None, "error": f"{where}: is no JSON object"})
            continue
        name = next((content[key] for key in _NAMES if isinstance(content.get(key), str)), "")
        run = runs.get(name)
        if run is None:
            sentence = f"{where}: {name[:300]!r} is no run of this evaluation"
            strays.append({"uid": None, "name": name[:300] or None, "error": sentence})
            continue
        identity = {"uid": run["uid"], "name": run["name"]}
        found[run["uid"]] = identity | _content(content, request.evaluation, where)
    missing = f"the evaluator wrote no line for it into {RESULTS}"
    records = [
        found.get(str(run.get("uid"))) or {"uid": run.get("uid"), "name": run.get("name"), "error": missing}
        for run in request.runs
    ]
    return records + strays[:_STRAYS]


def _lines(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            yield number, line


def _parse(line: str) -> dict[str, Any] | None:
    try:
        found = json.loads(line, parse_constant=lambda _: None, parse_float=_finite)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _finite(text: str) -> float | None:
    number = float(text)
    return number if abs(number) < float("inf") else None


def _content(line: Mapping[str, Any], evaluation: str | None, where: str) -> dict[str, Any]:
    """Return the report of a line on its run, in our own form."""
    if "error" in line:
        return {"error": str(line["error"])[:1000]}
    given = line.get("result", line)
    try:
        return {"result": _result(given, evaluation, where).as_json()}
    except InputError as error:
        return {"error": str(error)}
    except (ValueError, RecursionError):
        return {"error": f"{where}: values are nested too deep"}


def _result(given: Any, evaluation: str | None, where: str) -> Result:
    if not isinstance(given, dict):
        raise InputError(f"{where}: result: must be an object")
    outcome = given.get("outcome")
    if outcome not in list(Outcome):
        raise InputError(f"{where}: outcome: {outcome!r} is not one of {', '.join(Outcome)}")
    beside = {key: item for key, item in given.items() if key not in {*_NAMES, *Result.model_fields}}
    values = given.get("values", {})
    if not isinstance(values, dict):
        raise InputError(f"{where}: values: must be an object")
    values = beside | values
    problem = problem_of_values(values)
    if problem:
        raise InputError(f"{where}: {problem}")
    size = len(json.dumps(values))
    if size > _VALUES_BYTES:
        raise InputError(f"{where}: values take {size} bytes, at most {_VALUES_BYTES} are kept of a run")
    fields = {"outcome": outcome, "coverage": given.get("coverage"), "values": values}
    named = evaluation or str(given.get("evaluation") or "custom")
    return parse(Result, fields | {"evaluation": named}, where)


if __name__ == "__main__":
    sys.exit(main())
