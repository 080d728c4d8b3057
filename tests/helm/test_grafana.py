# SPDX-License-Identifier: Apache-2.0
"""The Grafana dashboard asks for metrics that exist, with labels that they have."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.kube.metrics import Metrics, PodLabels
from slamhive.kube.queue import Queue

if TYPE_CHECKING:
    from collections.abc import Iterator

FILE = Path(__file__).parents[2] / "helm" / "slamhive" / "files" / "grafana-dashboard.json"
DASHBOARD: dict[str, Any] = json.loads(FILE.read_text())
PANELS = [panel for panel in DASHBOARD["panels"] if panel["type"] != "row"]
FUNCTIONS = {"sum", "by", "rate", "increase", "histogram_quantile", "label_values"}
ADDED = {"le", "job", "pod"}
"""Labels of histograms, and those that Prometheus adds."""


@cache
def series() -> dict[str, set[str]]:
    """Labels by name of all series that the operator can have."""
    metrics = Metrics()
    metrics.live.show("uid", PodLabels("lab", "study", "kiss-icp", "hall", "0", "run"), 1.0, 1.0)
    metrics.watch_queue(Queue())
    metrics.watch_phases(lambda: {("lab", "Running"): 1})
    usage = {"cpu": {"seconds": 1.0}, "memory": {"peakBytes": 1}, "wallSeconds": 1.0}
    metrics.record_finished("kiss-icp", "hall", {"phase": "Failed", "reason": "OutOfMemory", "usage": usage})
    metrics.record_result("kiss-icp", "hall", {"outcome": "Tracked", "ate": {"rmse": 0.1}})
    metrics.count_call("list", "pods", "200")
    metrics.count_error("queue", "fault")
    metrics.observe_reconcile("MappingRun", "done", 0.1)
    found: dict[str, set[str]] = {}
    for family in metrics.registry.collect():
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def queries() -> Iterator[tuple[str, str]]:
    for panel in PANELS:
        for target in panel["targets"]:
            yield panel["title"], target["expr"]
    for variable in DASHBOARD["templating"]["list"]:
        if variable["type"] == "query":
            yield variable["name"], variable["query"]["query"]


@pytest.mark.parametrize(("title", "query"), [*queries()])
def test_queries_name_what_there_is(title: str, query: str) -> None:
    bare = re.sub(r'"[^"]*"', "", query)
    assert bare.count("(") == bare.count(")")
    (metric,) = {name for name in re.findall(r"[a-z_]{3,}", bare) if name in series()}
    labels = re.findall(r"(\w+)=~?", bare)
    labels += [one for group in re.findall(r"by \(([^)]*)\)", bare) for one in group.split(", ")]
    labels += re.findall(r"label_values\(.*, (\w+)\)", bare)
    assert {*labels} <= series()[metric] | ADDED
    words = {*re.findall(r"\b[a-z_]{2,}\b", re.sub(r"\$\w+|\{[^}]*\}|by \([^)]*\)|, \w+\)", "", bare))}
    assert words <= FUNCTIONS | {metric}


@pytest.mark.parametrize("panel", PANELS, ids=lambda panel: panel["title"])
def test_legends_use_labels_that_the_query_keeps(panel: dict[str, Any]) -> None:
    assert panel["description"].endswith(".")
    assert panel["fieldConfig"]["defaults"]["unit"]
    for target in panel["targets"]:
        wanted = {*re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])}
        grouped = re.findall(r"by \(([^)]*)\)", target["expr"])
        (metric,) = {name for name in re.findall(r"[a-z_]{3,}", target["expr"]) if name in series()}
        kept = {*grouped[0].split(", ")} if grouped else series()[metric] | ADDED
        assert wanted <= (set() if "sum(" in target["expr"] else kept)


def test_every_series_of_ours_is_shown() -> None:
    shown = " ".join(query for _, query in queries())
    families = {re.sub(r"_(bucket|count|sum|total|created)$", "", name) for name in series()}
    assert {name for name in families if name.startswith("slamhive_") and name not in shown} == set()


def test_panels_have_their_own_place() -> None:
    taken: set[tuple[int, int]] = set()
    for panel in DASHBOARD["panels"]:
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert max(x for x, _ in cells) < 24
        assert not cells & taken
        taken |= cells
    assert len({panel["id"] for panel in DASHBOARD["panels"]}) == len(DASHBOARD["panels"])
    assert DASHBOARD["uid"]


def test_it_reaches_the_chart(helm: Any) -> None:
    objects = helm.objects("--set", "metrics.grafanaDashboard.enabled=true")
    (found,) = (one for one in objects if one["metadata"]["name"] == "slamhive-grafana")
    assert json.loads(found["data"]["slamhive.json"]) == DASHBOARD
    assert found["metadata"]["labels"]["grafana_dashboard"] == "1"
