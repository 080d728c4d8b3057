# SPDX-License-Identifier: Apache-2.0
"""Certificates and kubeconfigs of one cluster, made by openssl when it begins and gone when it ends."""

from __future__ import annotations

import base64
import json
import subprocess
from typing import TYPE_CHECKING

from testcluster.errors import ClusterError

if TYPE_CHECKING:
    from pathlib import Path

    from testcluster.places import Instance

_NAMES = ("localhost", "kubernetes", "kubernetes.default", "kubernetes.default.svc")
_ACCOUNTS = ("admin", "controller-manager", "scheduler", "kubelet", "proxy")
NODE = "node1"


def _openssl(*arguments: str) -> None:
    result = subprocess.run(["openssl", *arguments], capture_output=True, text=True, check=False)
    if result.returncode:
        raise ClusterError(f"openssl {arguments[0]} failed: {result.stderr.strip()}")


def _key(path: Path) -> None:
    _openssl("genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256", "-out", str(path))


def _authority(folder: Path, name: str) -> None:
    _key(folder / f"{name}.key")
    _openssl(
        *("req", "-x509", "-new", "-key", str(folder / f"{name}.key"), "-days", "30"),
        *("-subj", f"/CN={name}", "-out", str(folder / f"{name}.crt")),
    )


def _certificate(folder: Path, name: str, subject: str, authority: str, alternatives: str) -> None:
    _key(folder / f"{name}.key")
    request, extensions = folder / f"{name}.csr", folder / f"{name}.ext"
    extensions.write_text(f"subjectAltName={alternatives}\n")
    _openssl("req", "-new", "-key", str(folder / f"{name}.key"), "-subj", subject, "-out", str(request))
    _openssl(
        *("x509", "-req", "-in", str(request), "-days", "30", "-extfile", str(extensions)),
        *("-CA", str(folder / f"{authority}.crt"), "-CAkey", str(folder / f"{authority}.key")),
        *("-CAcreateserial", "-out", str(folder / f"{name}.crt")),
    )


def make(instance: Instance) -> None:
    """Write the certificates and kubeconfigs of a new cluster."""
    folder, addresses = instance.pki, instance.addresses()
    folder.mkdir(mode=0o700)
    _authority(folder, "ca")
    _authority(folder, "front-ca")
    _key(folder / "accounts.key")
    _openssl("pkey", "-in", str(folder / "accounts.key"), "-pubout", "-out", str(folder / "accounts.pub"))
    numbers = ("127.0.0.1", addresses.node, addresses.first_service)
    server = ",".join([*(f"DNS:{name}" for name in _NAMES), *(f"IP:{number}" for number in numbers)])
    for name, subject, authority, alternatives in (
        ("apiserver", "/CN=kube-apiserver", "ca", server),
        ("admin", "/O=system:masters/CN=admin", "ca", "DNS:admin"),
        ("controller-manager", "/CN=system:kube-controller-manager", "ca", "DNS:controller-manager"),
        ("scheduler", "/CN=system:kube-scheduler", "ca", "DNS:scheduler"),
        ("kubelet", f"/O=system:nodes/CN=system:node:{NODE}", "ca", f"DNS:{NODE},IP:{addresses.node}"),
        ("proxy", "/CN=system:kube-proxy", "ca", "DNS:proxy"),
        ("to-kubelet", "/O=system:masters/CN=apiserver-to-kubelet", "ca", "DNS:to-kubelet"),
        ("front-proxy", "/CN=front-proxy", "front-ca", "DNS:front-proxy"),
    ):
        _certificate(folder, name, subject, authority, alternatives)
    for name in _ACCOUNTS:
        path = instance.folder / f"{name}.kubeconfig"
        path.touch(mode=0o600)
        path.write_text(_kubeconfig(folder, name, addresses.node))


def _kubeconfig(folder: Path, name: str, address: str) -> str:
    def data(file: str) -> str:
        return base64.b64encode((folder / file).read_bytes()).decode()

    cluster = {"server": f"https://{address}:6443", "certificate-authority-data": data("ca.crt")}
    user = {"client-certificate-data": data(f"{name}.crt"), "client-key-data": data(f"{name}.key")}
    config = {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": "slamhive-test", "cluster": cluster}],
        "users": [{"name": name, "user": user}],
        "contexts": [{"name": "slamhive-test", "context": {"cluster": "slamhive-test", "user": name}}],
        "current-context": "slamhive-test",
    }
    return json.dumps(config, indent=1) + "\n"
