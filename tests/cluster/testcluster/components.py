# SPDX-License-Identifier: Apache-2.0
"""The command line and the settings of each program of the cluster."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Any

from testcluster.pki import NODE
from testcluster.programs import path_of

if TYPE_CHECKING:
    from testcluster.places import Instance

PAUSE_IMAGE = "localhost/pause:1"


def etcd(instance: Instance) -> list[str]:
    """The store; nobody outside reaches its address, and it needn't survive a power cut."""
    return [
        str(path_of("etcd")),
        f"--data-dir={instance.folder}/etcd",
        "--listen-client-urls=http://127.0.0.1:2379",
        "--advertise-client-urls=http://127.0.0.1:2379",
        "--listen-peer-urls=http://127.0.0.1:2380",
        "--unsafe-no-fsync",
        "--quota-backend-bytes=8589934592",
        "--log-level=warn",
    ]


def apiserver(instance: Instance) -> list[str]:
    """The API server, with the aggregation that the metrics API needs."""
    pki, addresses = instance.pki, instance.addresses()
    return [
        str(path_of("kube-apiserver")),
        "--etcd-servers=http://127.0.0.1:2379",
        f"--advertise-address={addresses.node}",
        f"--bind-address={addresses.node}",
        "--secure-port=6443",
        f"--tls-cert-file={pki}/apiserver.crt",
        f"--tls-private-key-file={pki}/apiserver.key",
        f"--client-ca-file={pki}/ca.crt",
        f"--kubelet-client-certificate={pki}/to-kubelet.crt",
        f"--kubelet-client-key={pki}/to-kubelet.key",
        f"--kubelet-certificate-authority={pki}/ca.crt",
        "--kubelet-preferred-address-types=InternalIP",
        f"--service-account-key-file={pki}/accounts.pub",
        f"--service-account-signing-key-file={pki}/accounts.key",
        "--service-account-issuer=https://kubernetes.default.svc",
        f"--service-cluster-ip-range={addresses.services}",
        "--authorization-mode=Node,RBAC",
        "--enable-admission-plugins=NodeRestriction",
        "--allow-privileged=true",
        "--enable-aggregator-routing=true",
        f"--requestheader-client-ca-file={pki}/front-ca.crt",
        "--requestheader-allowed-names=front-proxy",
        "--requestheader-extra-headers-prefix=X-Remote-Extra-",
        "--requestheader-group-headers=X-Remote-Group",
        "--requestheader-username-headers=X-Remote-User",
        f"--proxy-client-cert-file={pki}/front-proxy.crt",
        f"--proxy-client-key-file={pki}/front-proxy.key",
    ]


def controller_manager(instance: Instance) -> list[str]:
    """The controllers, with limits that let Jobs be made as fast as the machine can."""
    return [
        str(path_of("kube-controller-manager")),
        f"--kubeconfig={instance.folder}/controller-manager.kubeconfig",
        f"--service-account-private-key-file={instance.pki}/accounts.key",
        f"--root-ca-file={instance.pki}/ca.crt",
        "--use-service-account-credentials=true",
        "--leader-elect=false",
        "--bind-address=127.0.0.1",
        "--kube-api-qps=200",
        "--kube-api-burst=400",
        "--concurrent-job-syncs=20",
    ]


def scheduler(instance: Instance) -> list[str]:
    """The scheduler."""
    return [
        str(path_of("kube-scheduler")),
        f"--kubeconfig={instance.folder}/scheduler.kubeconfig",
        "--leader-elect=false",
        "--bind-address=127.0.0.1",
        "--kube-api-qps=200",
        "--kube-api-burst=400",
    ]


def containerd(instance: Instance) -> list[str]:
    """Debian's containerd, all its state in the instance's folder."""
    folder = instance.folder
    # Lowering a process' oom_score_adj takes CAP_SYS_RESOURCE, which root in a virtual machine may lack.
    (folder / "containerd.toml").write_text(f"""\
version = 2
root = "{folder}/containerd"
state = "/run/slamhive-containerd"
[grpc]
  address = "{instance.containerd}"
[plugins."io.containerd.internal.v1.opt"]
  path = "{folder}/opt"
[plugins."io.containerd.grpc.v1.cri"]
  sandbox_image = "{PAUSE_IMAGE}"
  restrict_oom_score_adj = true
[plugins."io.containerd.grpc.v1.cri".containerd]
  snapshotter = "overlayfs"
[plugins."io.containerd.grpc.v1.cri".containerd.runtimes.runc]
  runtime_type = "io.containerd.runc.v2"
[plugins."io.containerd.grpc.v1.cri".containerd.runtimes.changed]
  runtime_type = "io.containerd.runc.v2"
[plugins."io.containerd.grpc.v1.cri".containerd.runtimes.changed.options]
  BinaryName = "{instance.changed_runtime}"
[plugins."io.containerd.grpc.v1.cri".cni]
  bin_dir = "/usr/lib/cni"
  conf_dir = "{folder}/cni"
""")
    ipam = {
        "type": "host-local",
        "dataDir": "/run/slamhive-addresses",
        "ranges": [[{"subnet": instance.addresses().pods}]],
        "routes": [{"dst": "0.0.0.0/0"}],
    }
    bridge = {"type": "bridge", "bridge": "cni0", "isGateway": True, "ipMasq": False, "hairpinMode": True}
    plugins = [bridge | {"ipam": ipam}, {"type": "portmap", "capabilities": {"portMappings": True}}]
    (folder / "cni").mkdir(exist_ok=True)
    network = {"cniVersion": "1.0.0", "name": "pods", "plugins": plugins}
    (folder / "cni" / "10-pods.conflist").write_text(json.dumps(network))
    return ["containerd", "-c", f"{folder}/containerd.toml"]


def kubelet(instance: Instance) -> list[str]:
    """The node's agent; it never collects images, as none can be pulled again."""
    folder, pki, addresses = instance.folder, instance.pki, instance.addresses()
    settings: dict[str, Any] = {
        "apiVersion": "kubelet.config.k8s.io/v1beta1",
        "kind": "KubeletConfiguration",
        "authentication": {
            "anonymous": {"enabled": False},
            "webhook": {"enabled": True},
            "x509": {"clientCAFile": f"{pki}/ca.crt"},
        },
        "authorization": {"mode": "Webhook"},
        "cgroupDriver": "cgroupfs",
        "cgroupRoot": f"/{addresses.cgroup}",
        "failSwapOn": False,
        "containerRuntimeEndpoint": f"unix://{instance.containerd}",
        "tlsCertFile": f"{pki}/kubelet.crt",
        "tlsPrivateKeyFile": f"{pki}/kubelet.key",
        "address": addresses.node,
        "clusterDomain": "cluster.local",
        "resolvConf": "",
        "podLogsDir": f"{folder}/pods-log",
        "volumePluginDir": f"{folder}/volume-plugins",
        "makeIPTablesUtilChains": False,
        "imageGCHighThresholdPercent": 100,
        "imageGCLowThresholdPercent": 99,
        "evictionHard": {"memory.available": "100Mi", "nodefs.available": "1%", "imagefs.available": "1%"},
        "shutdownGracePeriod": "0s",
    }
    (folder / "kubelet.json").write_text(json.dumps(settings, indent=1))
    return [
        str(path_of("kubelet")),
        f"--kubeconfig={folder}/kubelet.kubeconfig",
        f"--config={folder}/kubelet.json",
        f"--hostname-override={NODE}",
        f"--node-ip={addresses.node}",
        f"--root-dir={folder}/kubelet",
    ]


def proxy(instance: Instance) -> list[str]:
    """Services, in the packet filter of the cluster's own network; no setting of the kernel is changed."""
    return [
        str(path_of("kube-proxy")),
        f"--kubeconfig={instance.folder}/proxy.kubeconfig",
        f"--hostname-override={NODE}",
        f"--cluster-cidr={instance.addresses().pods}",
        "--proxy-mode=iptables",
        "--iptables-localhost-nodeports=false",
        "--conntrack-max-per-core=0",
        "--conntrack-tcp-timeout-established=0s",
        "--conntrack-tcp-timeout-close-wait=0s",
    ]


def metrics_server(instance: Instance) -> list[str]:
    """The metrics API."""
    admin = f"{instance.folder}/admin.kubeconfig"
    return [
        str(path_of("metrics-server")),
        f"--kubeconfig={admin}",
        f"--authentication-kubeconfig={admin}",
        f"--authorization-kubeconfig={admin}",
        "--secure-port=4443",
        f"--bind-address={instance.addresses().node}",
        f"--cert-dir={instance.folder}/metrics-server",
        f"--kubelet-certificate-authority={instance.pki}/ca.crt",
        "--metric-resolution=15s",
        "--kubelet-preferred-address-types=InternalIP",
    ]


def kueue(instance: Instance) -> list[str]:
    """Kueue's controller, for Jobs alone, without its webhooks: Jobs that are made suspended need none.

    It looks for the certificates of its figures in one folder below /etc, which is laid there for it alone.
    """
    folder = instance.folder / "kueue"
    certificates = folder / "etc" / "kueue" / "metrics" / "certs"
    certificates.mkdir(parents=True, exist_ok=True)
    for kind in ("crt", "key"):
        shutil.copyfile(instance.pki / f"apiserver.{kind}", certificates / f"tls.{kind}")
    settings: dict[str, Any] = {
        "apiVersion": "config.kueue.x-k8s.io/v1beta2",
        "kind": "Configuration",
        "namespace": "kube-system",
        "health": {"healthProbeBindAddress": "127.0.0.1:8081"},
        "metrics": {"bindAddress": "127.0.0.1:8443"},
        "webhook": {"host": "127.0.0.1", "port": 9443, "certDir": str(certificates)},
        "leaderElection": {"leaderElect": False},
        "internalCertManagement": {"enable": False},
        "clientConnection": {"qps": 500, "burst": 1000},
        "featureGates": {"VisibilityOnDemand": False, "MultiKueue": False},
        "integrations": {"frameworks": ["batch/job"]},
    }
    (folder / "kueue.json").write_text(json.dumps(settings, indent=1))
    lay = 'mount -t overlay overlay -o lowerdir="$0":/etc /etc && exec "$@"'
    return [
        *("unshare", "--mount", "sh", "-c", lay, str(folder / "etc")),
        *(str(path_of("kueue")), f"--config={folder}/kueue.json"),
        f"--kubeconfig={instance.folder}/admin.kubeconfig",
    ]


def metrics_objects(instance: Instance) -> list[dict[str, Any]]:
    """Return the Service, endpoints and APIService by which the API server asks the metrics server."""
    name, namespace = "metrics-server", "kube-system"
    service = {"name": name, "namespace": namespace, "port": 443}
    return [
        {
            "apiVersion": "v1",
            "kind": "Service",
            "metadata": {"name": name, "namespace": namespace},
            "spec": {"clusterIP": "None", "ports": [{"port": 443, "targetPort": 4443}]},
        },
        {
            "apiVersion": "discovery.k8s.io/v1",
            "kind": "EndpointSlice",
            "metadata": {
                "name": f"{name}-host",
                "namespace": namespace,
                "labels": {"kubernetes.io/service-name": name},
            },
            "addressType": "IPv4",
            "ports": [{"port": 4443, "protocol": "TCP"}],
            "endpoints": [{"addresses": [instance.addresses().node], "conditions": {"ready": True}}],
        },
        {
            "apiVersion": "apiregistration.k8s.io/v1",
            "kind": "APIService",
            "metadata": {"name": "v1beta1.metrics.k8s.io"},
            "spec": {
                "group": "metrics.k8s.io",
                "version": "v1beta1",
                "groupPriorityMinimum": 100,
                "versionPriority": 100,
                "insecureSkipTLSVerify": True,
                "service": service,
            },
        },
    ]
