{{- /* SPDX-License-Identifier: Apache-2.0 */ -}}

{{- /* Names leave room for suffixes: a CronJob's name has 52 characters at most. */ -}}
{{- define "slamhive.fullname" -}}
{{- $name := .Values.fullnameOverride | default (contains "slamhive" .Release.Name | ternary .Release.Name (printf "%s-slamhive" .Release.Name)) -}}
{{- $name | trunc 40 | trimSuffix "-" -}}
{{- end -}}

{{- /* Namespaces of the release, its own first, as a JSON list. */ -}}
{{- define "slamhive.namespaces" -}}
{{- prepend .Values.workspaces .Release.Namespace | uniq | toJson -}}
{{- end -}}

{{- define "slamhive.selector" -}}
app.kubernetes.io/name: slamhive
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .component }}
{{- end -}}

{{- define "slamhive.labels" -}}
{{ include "slamhive.selector" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
app.kubernetes.io/part-of: slamhive
helm.sh/chart: {{ printf "%s-%s" .root.Chart.Name .root.Chart.Version | replace "+" "_" }}
{{- with .root.Values.commonLabels }}
{{ toYaml . }}
{{- end }}
{{- end -}}

{{- /* name and namespace and labels: dict root component name namespace */ -}}
{{- define "slamhive.metadata" -}}
name: {{ include "slamhive.fullname" .root }}-{{ .name | default .component }}
namespace: {{ .namespace | default .root.Release.Namespace }}
labels:
  {{- include "slamhive.labels" . | nindent 2 }}
{{- end -}}

{{- define "slamhive.image" -}}
{{- if .image.digest -}}
{{ .image.repository }}@{{ .image.digest }}
{{- else -}}
{{ .image.repository }}:{{ .image.tag | default .root.Chart.AppVersion }}
{{- end -}}
{{- end -}}

{{- define "slamhive.claim" -}}
{{- $volume := index .root.Values.volumes .name -}}
{{- $volume.existingClaim | default (printf "%s-%s" (include "slamhive.fullname" .root) .name) -}}
{{- end -}}

{{- /* What all of our pods have in common, by the restricted Pod Security standard. */ -}}
{{- define "slamhive.podSecurity" -}}
enableServiceLinks: false
securityContext:
  runAsNonRoot: true
  runAsUser: {{ .Values.uid }}
  runAsGroup: {{ .Values.uid }}
  fsGroup: {{ .Values.uid }}
  fsGroupChangePolicy: OnRootMismatch
  seccompProfile: {type: RuntimeDefault}
{{- with .Values.imagePullSecrets }}
imagePullSecrets:
  {{- range . }}
  - name: {{ . }}
  {{- end }}
{{- end }}
{{- end -}}

{{- define "slamhive.container" -}}
image: {{ include "slamhive.image" (dict "root" . "image" .Values.image) }}
imagePullPolicy: {{ .Values.image.pullPolicy }}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
env:
  - {name: HOME, value: /tmp}
  # There is no account of that number in the image, and libraries ask for its name.
  - {name: USER, value: slamhive}
  - {name: PYTHONDONTWRITEBYTECODE, value: "1"}
{{- end -}}

{{- /* Where a pod goes: one of .Values.operator, .Values.dashboard, .Values.runs */ -}}
{{- define "slamhive.placement" -}}
{{- with .nodeSelector }}
nodeSelector:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .tolerations }}
tolerations:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .affinity }}
affinity:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .priorityClassName }}
priorityClassName: {{ . }}
{{- end }}
{{- end -}}

{{- /* The archive: path of the file with its URL, and how a pod comes by it. */ -}}
{{- define "slamhive.archiveUrlFile" -}}
{{- if .Values.archive.existingSecret -}}
/etc/slamhive-archive/url
{{- else if .Values.archive.sqlite.enabled -}}
/etc/slamhive/archive-url
{{- end -}}
{{- end -}}

{{- define "slamhive.archiveMounts" -}}
{{- if .Values.archive.existingSecret -}}
- {name: archive-url, mountPath: /etc/slamhive-archive, readOnly: true}
{{- else if .Values.archive.sqlite.enabled -}}
- {name: archive, mountPath: /slamhive/archive}
{{- end -}}
{{- end -}}

{{- /* dict root read; who only reads has an account of its own, if there is one. */ -}}
{{- define "slamhive.archiveVolumes" -}}
{{- $archive := .root.Values.archive -}}
{{- if $archive.existingSecret -}}
- name: archive-url
  secret:
    secretName: {{ .read | default false | ternary ($archive.readSecret | default $archive.existingSecret) $archive.existingSecret }}
    defaultMode: 0440
    items:
      - {key: {{ $archive.key | quote }}, path: url}
{{- else if $archive.sqlite.enabled -}}
- name: archive
  persistentVolumeClaim:
    claimName: {{ include "slamhive.claim" (dict "root" .root "name" "archive") }}
{{- end -}}
{{- end -}}

{{- /* Object storage that run folders are moved to: its settings, its Secret, and how a pod comes by both.
dict root read; who only reads has keys of its own, if there are some. */ -}}
{{- define "slamhive.store" -}}
{{- $offload := .Values.volumes.results.offload -}}
url: {{ $offload.url | quote }}
{{- with $offload.options }}
options:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- end -}}

{{- define "slamhive.storeSecret" -}}
{{- $offload := .root.Values.volumes.results.offload -}}
{{- .read | default false | ternary ($offload.readSecret | default $offload.secret) $offload.secret -}}
{{- end -}}

{{- define "slamhive.storeMounts" -}}
- {name: store, mountPath: /etc/slamhive-store, readOnly: true}
{{- if include "slamhive.storeSecret" . }}
- {name: store-secret, mountPath: /etc/slamhive-store-secret, readOnly: true}
{{- end }}
{{- end -}}

{{- define "slamhive.storeVolumes" -}}
- name: store
  configMap: {name: {{ include "slamhive.fullname" .root }}-store}
{{- with include "slamhive.storeSecret" . }}
- name: store-secret
  secret: {secretName: {{ . }}, defaultMode: 0440}
{{- end }}
{{- end -}}

{{- /* Components that walk over the volumes, as a JSON list: collector and offloader. */ -}}
{{- define "slamhive.walkers" -}}
{{- $found := list -}}
{{- if .Values.collector.enabled -}}{{- $found = append $found "collector" -}}{{- end -}}
{{- if .Values.volumes.results.offload.url -}}{{- $found = append $found "offloader" -}}{{- end -}}
{{- toJson $found -}}
{{- end -}}

{{- /* What no schema can say. */ -}}
{{- define "slamhive.check" -}}
{{- if and .Values.archive.existingSecret .Values.archive.sqlite.enabled -}}
{{- fail "archive: existingSecret and sqlite.enabled exclude each other; allowed: one of them" -}}
{{- end -}}
{{- if and .Values.archive.readSecret (not .Values.archive.existingSecret) -}}
{{- fail "archive.readSecret: the operator needs an account that may write; allowed: with archive.existingSecret" -}}
{{- end -}}
{{- if and .Values.archive.sqlite.enabled .Values.workspaces -}}
{{- fail "archive.sqlite.enabled: a file can't be shared with the workspaces; allowed: archive.existingSecret with the URL of a database, or no workspaces" -}}
{{- end -}}
{{- range $name, $volume := .Values.volumes -}}
{{- if and $volume.existingClaim $volume.local.path -}}
{{- fail (printf "volumes.%s: existingClaim and local.path exclude each other; allowed: one of them" $name) -}}
{{- end -}}
{{- if and $volume.local.path $volume.storageClassName -}}
{{- fail (printf "volumes.%s: local.path makes a volume without a class; allowed: no storageClassName with it" $name) -}}
{{- end -}}
{{- end -}}
{{- with .Values.volumes.results.offload -}}
{{- if and .url (not $.Values.archive.existingSecret) (not $.Values.archive.sqlite.enabled) -}}
{{- fail "volumes.results.offload.url: only runs that are in an archive are moved; allowed: with archive.existingSecret or archive.sqlite.enabled" -}}
{{- end -}}
{{- if and .readSecret (not .secret) -}}
{{- fail "volumes.results.offload.readSecret: the offloader needs keys that may write; allowed: with volumes.results.offload.secret" -}}
{{- end -}}
{{- end -}}
{{- if and .Values.dashboard.ingress.enabled (not .Values.dashboard.ingress.host) -}}
{{- fail "dashboard.ingress.host: needed where dashboard.ingress.enabled" -}}
{{- end -}}
{{- range (lookup "apps/v1" "Deployment" .Release.Namespace "").items -}}
{{- $labels := .metadata.labels | default dict -}}
{{- if and (eq (get $labels "app.kubernetes.io/name") "slamhive") (eq (get $labels "app.kubernetes.io/component") "operator") (ne (get $labels "app.kubernetes.io/instance") $.Release.Name) -}}
{{- fail (printf "namespace %s: the release %s has an operator here already; allowed: one release a namespace" $.Release.Namespace (get $labels "app.kubernetes.io/instance")) -}}
{{- end -}}
{{- end -}}
{{- end -}}
