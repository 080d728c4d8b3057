# SPDX-License-Identifier: Apache-2.0
# Reads records of a ROS 1 bag (format 2.0), given as bytes by `od -An -v -tu1 -w1`, and prints of each
#   op 3, the bag's header         index POSITION      where connections and chunks are listed
#   op 7, a connection             topic NUMBER NAME
#   op 6, what is said of a chunk  chunk POSITION
#   op 4, the index of a chunk     stamp SECONDS NANOSECONDS of each message of the connection `wanted`
#   op 5, a chunk                  skip BYTES          from the start of its record to its end
{ byte[n++] = $1 }

function number(at, size,    value, i) {
    for (i = size - 1; i >= 0; i--) value = value * 256 + byte[at + i]
    return value
}

function text(at, size,    value, i) {
    for (i = 0; i < size; i++) value = value sprintf("%c", byte[at + i])
    return value
}

# Where each field of a record's header stands and how long it is, by name.
function fields(at, end,    size, equals) {
    split("", place); split("", length_of)
    while (at < end) {
        size = number(at, 4)
        at += 4
        for (equals = at; byte[equals] != 61; equals++) if (equals >= end) exit 1
        place[text(at, equals - at)] = equals + 1
        length_of[text(at, equals - at)] = size - (equals + 1 - at)
        at += size
    }
}

END {
    at = 0
    while (at + 4 <= n) {
        body = at + 4 + number(at, 4)
        if (body + 4 > n) exit
        fields(at + 4, body)
        size = number(body, 4)
        op = byte[place["op"]]
        if (op == 5) { print "skip", body + 4 + size - at; exit }
        if (body + 4 + size > n && op != 3) exit
        if (op == 3) print "index", number(place["index_pos"], 8)
        if (op == 7) print "topic", number(place["conn"], 4), text(place["topic"], length_of["topic"])
        if (op == 6) print "chunk", number(place["chunk_pos"], 8)
        if (op == 4 && number(place["conn"], 4) == wanted)
            for (i = 0; i < number(place["count"], 4); i++)
                printf "stamp %d %d\n", number(body + 4 + 12 * i, 4), number(body + 8 + 12 * i, 4)
        at = body + 4 + size
    }
}
