# SPDX-License-Identifier: Apache-2.0
"""The operator's settings: one YAML file, written by the chart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Self

import yaml
from pydantic import Field, StringConstraints, ValidationError, model_validator

from slamhive.model.base import Choice, Duration, Model, Quantity, explain
from slamhive.model.errors import InputError
from slamhive.model.sweep import MOST_WEIGHT
from slamhive.monitor.spec import OUTPUT_FILES, OUTPUT_LIMIT

PassedLabel = Annotated[
    str,
    StringConstraints(
        pattern=r"^([a-z0-9]([-a-z0-9.]*[a-z0-9])?/)?([A-Za-z0-9]([-A-Za-z0-9_.]*[A-Za-z0-9])?)?$",
        min_length=1,
        max_length=317,
    ),
]
"""Name of a label, or with a slash at its end a prefix of names."""

VariableName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=253)]

NamespaceName = Annotated[
    str, StringConstraints(pattern=r"^[a-z0-9]([-a-z0-9]*[a-z0-9])?$", min_length=1, max_length=63)
]


class PullPolicy(Choice):
    """Policies that say when the kubelet pulls an image."""

    ALWAYS = "Always"
    IF_NOT_PRESENT = "IfNotPresent"
    NEVER = "Never"


class LogFormat(Choice):
    """Formats of the operator's log."""

    PLAIN = "plain"
    JSON = "json"


class Claim(Model):
    """A volume by its PersistentVolumeClaim."""

    claim: str = Field(min_length=1, max_length=253)


class Volumes(Model):
    """Volumes of results and datasets, by their PersistentVolumeClaims."""

    results: Claim
    data: Claim


class StoreReference(Model):
    """Object storage that run folders were moved to, by what tells pods of it in each namespace."""

    config_map: str = Field(min_length=1, max_length=253)
    """ConfigMap with its settings: store.yaml."""
    secret: str = Field(default="", max_length=253)
    """Secret with options that only read, by their names."""


class PodSettings(Model):
    """Settings that every pod of ours gets, such as node selector, tolerations and service account."""

    node_selector: dict[str, str] = Field(default_factory=dict)
    tolerations: list[dict[str, Any]] = Field(default_factory=list)
    affinity: dict[str, Any] = Field(default_factory=dict)
    runtime_class_name: str | None = None
    image_pull_secrets: list[str | dict[str, str]] = Field(default_factory=list)
    priority_class_name: str | None = None
    service_account_name: str | None = None
    gpu_resource: str = "nvidia.com/gpu"


class EvaluationJobs(Model):
    """Settings of the Jobs that evaluate trajectories: batches, number in parallel, CPU and memory."""

    batch_size: int = Field(default=200, ge=1, le=200)
    delay_seconds: float = Field(default=2.0, ge=0)
    parallel_jobs: int = Field(default=2, ge=1)
    cpu: Quantity = "500m"
    memory: Quantity = "1Gi"


class PreparationJobs(Model):
    """Settings of the Jobs that prepare variants of datasets, such as CPU, memory and time limit."""

    parallel_jobs: int = Field(default=2, ge=1)
    cpu: Quantity = "1"
    memory: Quantity = "2Gi"
    timeout: Duration = "6h"
    catalogue: str = Field(default="", max_length=253)
    """ConfigMap, in each namespace, with further families of sequences."""
    certificates: str = Field(default="", max_length=253)
    """ConfigMap, in each namespace, with certificates of further authorities."""
    environment: dict[VariableName, str] = Field(default_factory=dict)


class MetricsSettings(Model):
    """Settings of the Prometheus metrics: port, interval of live figures, label with the run's name."""

    port: int = Field(default=9090, ge=0, le=65535)
    interval_seconds: float = Field(default=15.0, gt=0)
    run_name_label: bool = False


class HealthSettings(Model):
    """Settings of the operator's health server, which the kubelet asks."""

    port: int = Field(default=8080, ge=0, le=65535)


class NamespaceSharing(Model):
    """Settings of a namespace's share: its weight, most runs in flight, and a budget of CPU hours."""

    weight: int | None = Field(default=None, ge=1, le=MOST_WEIGHT)
    slots: int | None = Field(default=None, ge=0)
    cpu_hours: float | None = Field(default=None, ge=0)


class SharingSettings(Model):
    """Settings of how Sweeps share the cluster: slots over all namespaces, and what holds for one of them."""

    slots: int | None = Field(default=None, ge=1)
    namespaces: dict[NamespaceName, NamespaceSharing] = Field(default_factory=dict)
    read_nodes: bool = False
    read_priority_classes: bool = False
    waiting_pods: int = Field(default=1, ge=1, le=1000)


class Settings(Model):
    """All settings; the chart's values.yaml documents each."""

    namespaces: list[NamespaceName] = Field(min_length=1)
    image: str = Field(min_length=1)
    evaluator_image: str | None = None
    player_image: str | None = None
    ros2_player_image: str | None = None
    image_pull_policy: PullPolicy = PullPolicy.IF_NOT_PRESENT
    volumes: Volumes
    store: StoreReference | None = None
    archive_url_file: Path | None = None
    cluster_name: str = ""
    pods: PodSettings = PodSettings()
    uid: int = Field(default=65532, ge=1, le=2**31 - 1)
    default_parallelism: int = Field(default=8, ge=1)
    image_pull_grace_seconds: float = Field(default=120.0, ge=0)
    refusal_grace_seconds: float = Field(default=120.0, ge=0)
    evaluation: EvaluationJobs = EvaluationJobs()
    preparation: PreparationJobs = PreparationJobs()
    variants_limit: Quantity = "100Gi"
    metrics: MetricsSettings = MetricsSettings()
    health: HealthSettings = HealthSettings()
    sharing: SharingSettings = SharingSettings()
    sweep_write_seconds: float = Field(default=2.0, ge=0)
    relist_seconds: float = Field(default=600.0, gt=0)
    workers: int = Field(default=8, ge=1, le=256)
    max_runs_without_archive: int = Field(default=5000, ge=1)
    passed_labels: list[PassedLabel] = Field(default_factory=lambda: ["kueue.x-k8s.io/"])
    custom_evaluators: bool = True
    output_limit: Quantity = OUTPUT_LIMIT
    output_files: int = Field(default=OUTPUT_FILES, ge=1)
    log_format: LogFormat = LogFormat.PLAIN
    log_level: str = Field(default="INFO", pattern="^(DEBUG|INFO|WARNING|ERROR)$")

    @model_validator(mode="after")
    def _shared_among_namespaces(self) -> Self:
        strange = [name for name in self.sharing.namespaces if name not in self.namespaces]
        if strange:
            raise ValueError(
                f"sharing.namespaces: {strange[0]!r} is none of this operator's namespaces, "
                f"these are: {', '.join(self.namespaces)}"
            )
        return self

    @property
    def measuring_image(self) -> str:
        """Image that measures finished runs: one of its own, or the operator's."""
        return self.evaluator_image or self.image

    @property
    def player_images(self) -> dict[int, str | None]:
        """Images that play to ROS nodes, by the ROS that these are of."""
        return {1: self.player_image, 2: self.ros2_player_image}


def load(path: Path) -> Settings:
    """Read the settings.

    Raises:
        InputError: a sentence that names the file, the field and what is allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the operator's settings cannot be read: {error}") from None
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        where = "" if line is None else f", line {line + 1}"
        raise InputError(f"{path}{where}: not valid YAML: {getattr(error, 'problem', error)}") from None
    try:
        return Settings.model_validate(content if content is not None else {})
    except ValidationError as error:
        raise InputError("\n".join(f"{path}: {_told(mistake)}" for mistake in error.errors())) from None


def _told(mistake: Any) -> str:
    field = ".".join(str(part) for part in mistake["loc"])
    if mistake["type"] == "extra_forbidden":
        return f"{field}: unknown setting"
    return f"{field or 'the file'}: {explain(mistake)}"
