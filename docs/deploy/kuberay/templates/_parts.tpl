{{/* The name of the Secret with the tokens. */}}
{{- define "secret" -}}
{{ .Values.secret | default .Release.Name }}
{{- end }}

{{/* The specification of a volume. */}}
{{- define "claim" -}}
accessModes: [ReadWriteOnce]
{{- with .class }}
storageClassName: {{ . }}
{{- end }}
resources:
  requests:
    storage: {{ .storage }}
{{- end }}

{{/* What all containers of Ray share. KubeRay adds the token, and the command of a node. */}}
{{- define "node" -}}
image: {{ .image }}
resources:
  requests: {cpu: {{ .size.cores | quote }}, memory: {{ .size.memory }}}
  limits: {memory: {{ .size.memory }}}
securityContext:
  allowPrivilegeEscalation: false
  runAsNonRoot: true
  runAsUser: 1000
volumeMounts:
  - name: shared-memory
    mountPath: /dev/shm
{{- end }}
