# SPDX-License-Identifier: Apache-2.0
"""Words of the documents on the catalogue: no family is missing, and examples of families are right."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from slamhive.model.catalogue import BAG, load_catalogue
from slamhive.model.dataset import Dataset, TruthTable

DOCS = Path(__file__).parents[2] / "docs"
FAMILY = re.compile(r"^```text\n(# (\w+)\.yaml\n.*?^layout:.*?)^```$", re.MULTILINE | re.DOTALL)


def rows(document: str, head: str) -> list[list[str]]:
    """Return the cells of a table of a document."""
    table = (DOCS / document).read_text().split(f"\n{head}\n")[1].split("\n\n")[0]
    return [line.strip("| ").split(" | ") for line in table.splitlines()[1:]]


def test_no_family_is_missing_in_the_table_of_families() -> None:
    named = [name for _, names in rows("datasets.md", "| sensors | families |") for name in names.split(", ")]
    assert sorted(named) == sorted(f"`{name}`" for name in load_catalogue())


def test_tables_of_ground_truth_are_those_of_the_catalogue() -> None:
    shown = {}
    for names, text in rows("datasets.md", "| data set | `table` |"):
        table = yaml.safe_load(text.strip("`"))
        TruthTable.model_validate(table)
        shown.update(dict.fromkeys(re.findall(r"`([a-z0-9-]+)`", names), table))
    said = {name: family.head.dataset.get("groundTruth", {}) for name, family in load_catalogue().items()}
    plain = {name: dict(truth["table"]) for name, truth in said.items() if "table" in truth}
    for table in plain.values():
        table.pop("delimiter", None)  # what the first line has
    assert shown == plain


def test_examples_of_families_follow_the_model(tmp_path: Path) -> None:
    examples = FAMILY.findall((DOCS / "develop" / "adding.md").read_text())
    for text, name in examples:
        (tmp_path / f"{name}.yaml").write_text(text)
    families = load_catalogue([tmp_path])
    assert {family.head.layout for family in families.values()} == {BAG, "Euroc"}
    for family in families.values():
        for name in family.rows:
            sequence = family.sequence_of(name)
            spec = {"catalogue": sequence.title, "attributes": sequence.attributes, **sequence.dataset}
            Dataset.model_validate({"metadata": {"name": "one"}, "spec": spec})
