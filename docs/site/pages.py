# SPDX-License-Identifier: Apache-2.0
"""Hook of mkdocs for the docs site: pages for documents outside docs/, and links that lead to them.

Documents link to one another and to files of the repository by relative paths, as GitHub shows them. On the
site a link to a document leads to its page, and one to any other file of the repository is its path.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "evaluator/README.md": "evaluator-readme.md",
    "tests/cluster/README.md": "test-cluster.md",
}
"""Documents outside docs/ by their path in the repository, and the name of their page."""

_SOURCES = {page: source for source, page in PAGES.items()}
_FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[(?P<text>[^\]]+)\]\((?P<path>[^)\s:#]+)(?P<anchor>#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of documents that are outside docs/."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: object) -> str:
    """Return a page's text with the links of the site.

    Raises:
        FileNotFoundError: it links to a file that the repository hasn't.
    """
    name = page.file.src_uri
    source = _SOURCES.get(name, f"docs/{name}")

    def link(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), found["path"]))
        if not (ROOT / target).exists():
            raise FileNotFoundError(f"{source}: it links to {target}, which is not there")
        to = PAGES.get(target) or target.removeprefix("docs/")
        if not files.get_file_from_path(to) or (to == target and target not in PAGES):
            return f"{found['text']} (`{target}`)"
        relative = posixpath.relpath(to, posixpath.dirname(name) or ".")
        return f"[{found['text']}]({relative}{found['anchor'] or ''})"

    parts = _FENCE.split(markdown)
    return "".join(part if part.startswith("```") else _LINK.sub(link, part) for part in parts)
