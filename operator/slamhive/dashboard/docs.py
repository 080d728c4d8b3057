# SPDX-License-Identifier: Apache-2.0
"""The API's description as a page without scripts: what FastAPI offers comes from a CDN."""

from __future__ import annotations

from html import escape
from typing import Any

_HEAD = """<!doctype html><html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width"><title>SLAM Hive: API</title></head><body>
<h1>SLAM Hive: API</h1>
<p>GET and HEAD only. <a href="/api/v1/openapi.json">openapi.json</a></p>
"""


def docs_page(document: dict[str, Any]) -> str:
    """Return an OpenAPI document as HTML."""
    parts = [_HEAD]
    for path, operations in document["paths"].items():
        operation = operations.get("get", {})
        parts.append(f"<h2><code>{escape(path)}</code></h2><p>{escape(operation.get('summary', ''))}. ")
        parts.append(f"{escape(operation.get('description', ''))}</p>")
        if operation.get("parameters"):
            parts.append("<dl>")
            parts += [_parameter(parameter) for parameter in operation["parameters"]]
            parts.append("</dl>")
    return "".join([*parts, "</body></html>\n"])


def _parameter(parameter: dict[str, Any]) -> str:
    schema = parameter.get("schema", {})
    told = [parameter.get("description") or ""]
    if parameter.get("required"):
        told.append("Needed.")
    if schema.get("default") is not None:
        told.append(f"Default: {schema['default']}.")
    return f"<dt><code>{escape(parameter['name'])}</code></dt><dd>{escape(' '.join(told).strip())}</dd>"
