# SPDX-License-Identifier: Apache-2.0
# Prints one value of config.yaml: awk -v wanted=dataset.recording.path -f settings.awk config.yaml
# Enough of YAML for that file: blocks by indentation of two, one key a line.
/^ *(#|$|-)/ { next }
{
    match($0, /^ */)
    depth = RLENGTH / 2
    text = substr($0, RLENGTH + 1)
    colon = index(text, ":")
    if (!colon) next
    key[depth] = substr(text, 1, colon - 1)
    path = key[0]
    for (i = 1; i <= depth; i++) path = path "." key[i]
    if (path != wanted) next
    value = substr(text, colon + 2)
    gsub(/^['"]|['"]$/, "", value)
    print value
    exit
}
