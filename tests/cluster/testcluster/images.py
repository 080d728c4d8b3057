# SPDX-License-Identifier: Apache-2.0
"""Container images without a registry: a small one made here, and any that buildah has built."""

from __future__ import annotations

import hashlib
import io
import json
import platform
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from testcluster.components import PAUSE_IMAGE
from testcluster.errors import ClusterError
from testcluster.programs import path_of

if TYPE_CHECKING:
    from testcluster.places import Instance

_MACHINES = {"x86_64": "amd64", "aarch64": "arm64"}


def _tar(files: dict[str, tuple[bytes, int]]) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, (content, mode) in files.items():
            entry = tarfile.TarInfo(name)
            entry.size, entry.mode = len(content), mode
            archive.addfile(entry, io.BytesIO(content))
    return buffer.getvalue()


def archive(name: str, files: dict[str, tuple[bytes, int]], entrypoint: list[str]) -> bytes:
    """Return an OCI archive of an image with one layer.

    Args:
        name: the image's full name with its tag.
        files: content and mode of each file by its path, without a leading slash.
        entrypoint: the program and its arguments.
    """
    layer = _tar(files)
    blobs: dict[str, tuple[bytes, int]] = {}

    def blob(content: bytes, kind: str) -> dict[str, Any]:
        digest = hashlib.sha256(content).hexdigest()
        blobs[f"blobs/sha256/{digest}"] = (content, 0o644)
        return {
            "mediaType": f"application/vnd.oci.image.{kind}",
            "digest": f"sha256:{digest}",
            "size": len(content),
        }

    layers = [blob(layer, "layer.v1.tar")]
    config = {
        "architecture": _MACHINES.get(platform.machine(), platform.machine()),
        "os": "linux",
        "config": {"Entrypoint": entrypoint},
        "rootfs": {"type": "layers", "diff_ids": [item["digest"] for item in layers]},
    }
    manifest = {
        "schemaVersion": 2,
        "mediaType": "application/vnd.oci.image.manifest.v1+json",
        "config": blob(json.dumps(config).encode(), "config.v1+json"),
        "layers": layers,
    }
    entry = blob(json.dumps(manifest).encode(), "manifest.v1+json")
    names = {"io.containerd.image.name": name, "org.opencontainers.image.ref.name": name}
    index = {"schemaVersion": 2, "manifests": [entry | {"annotations": names}]}
    return _tar(
        {
            "oci-layout": (b'{"imageLayoutVersion": "1.0.0"}', 0o644),
            "index.json": (json.dumps(index).encode(), 0o644),
            **blobs,
        }
    )


def pause() -> bytes:
    """Return the archive of the image that holds a pod's namespaces."""
    return archive(PAUSE_IMAGE, {"pause": (path_of("pause").read_bytes(), 0o755)}, ["/pause"])


def load(instance: Instance, source: bytes | Path) -> None:
    """Put an archive of images into a node's containerd.

    Raises:
        ClusterError: it is no such archive, or there is no node.
    """
    content = source if isinstance(source, bytes) else None
    path = "-" if isinstance(source, bytes) else str(source)
    # Without its server it would wait for ever, and whoever started it may be killed.
    alone = ("setpriv", "--pdeathsig", "KILL")
    command = [*alone, "ctr", "-a", str(instance.containerd), "-n", "k8s.io", "images", "import", path]
    result = subprocess.run(command, input=content, capture_output=True, check=False)
    if result.returncode:
        raise ClusterError(f"cannot load an image: {result.stderr.decode().strip()[-500:]}")


def full_name(name: str) -> str:
    """Return the name under which a kubelet looks for an image, as the registry's client reads short ones.

    >>> full_name("slamhive/x:1"), full_name("x:1"), full_name("localhost/x:1")
    ('docker.io/slamhive/x:1', 'docker.io/library/x:1', 'localhost/x:1')
    """
    first, slash, _ = name.partition("/")
    if not slash:
        return f"docker.io/library/{name}"
    return name if first == "localhost" or {".", ":"} & set(first) else f"docker.io/{name}"


def load_built(instance: Instance, name: str) -> None:
    """Put an image that buildah built here into a node's containerd.

    Raises:
        ClusterError: there is no buildah, no such image or no node.
    """
    if not shutil.which("buildah"):
        raise ClusterError("loading images takes buildah: apt-get install buildah")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.tar"
        # Unlike an OCI archive, it has its layers as they are: compressing them takes longer than all else.
        command = ["buildah", "push", "-q", name, f"docker-archive:{path}:{full_name(name)}"]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode:
            raise ClusterError(f"cannot export the image {name}: {result.stderr.strip()[-500:]}")
        load(instance, path)
