# SPDX-License-Identifier: Apache-2.0
"""Messages of /tf for a node on the wheels, which have no tf2_msgs: a type by its name, and its CDR."""

import ctypes
import struct

from geometry_msgs.msg import PoseArray

HASH = "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
FIND = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
HASHED = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
WANTED = b"rosidl_typesupport_fastrtps_c"
kept = []  # what C points to


class Support(ctypes.Structure):
    """rosidl_message_type_support_t of ROS 2 Kilted."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        *((name, ctypes.c_void_p) for name in ("data", "find", "hashed", "description", "sources")),
    )


class Callbacks(ctypes.Structure):
    """message_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("rest", ctypes.c_void_p * 5),
    )


class Digest(ctypes.Structure):
    """rosidl_type_hash_t."""

    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


def named_type() -> type:
    """Return tf2_msgs/msg/TFMessage, made of another type's support: bytes alone can be published of it."""
    meta = type(PoseArray)
    meta.__import_type_support__()
    get, new = ctypes.pythonapi.PyCapsule_GetPointer, ctypes.pythonapi.PyCapsule_New
    get.restype, get.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    new.restype, new.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    base = get(meta._TYPE_SUPPORT, None)
    support = Support.from_buffer_copy(
        Support.from_address(FIND(Support.from_address(base).find)(base, WANTED))
    )
    callbacks = Callbacks.from_buffer_copy(Callbacks.from_address(support.data))
    callbacks.namespace, callbacks.name = b"tf2_msgs::msg", b"TFMessage"
    digest = Digest(1, (ctypes.c_uint8 * 32)(*bytes.fromhex(HASH)))
    find = FIND(lambda _, which: ctypes.addressof(support) if which == WANTED else None)
    hashed = HASHED(lambda _: ctypes.addressof(digest))
    support.data = ctypes.addressof(callbacks)
    support.find, support.hashed = (ctypes.cast(one, ctypes.c_void_p) for one in (find, hashed))
    kept.extend((support, callbacks, digest, find, hashed))
    names = ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE")
    members = {name: getattr(meta, name) for name in names}
    members["_TYPE_SUPPORT"] = new(ctypes.addressof(support), None, None)
    return type("NamedMeta", (type,), members)("TFMessage", (), {})


TransformMessage = named_type()


def transforms(*items: tuple) -> bytes:
    """Return a message of transforms: stamp, parent, child and translation of each; none is turned."""
    body = struct.pack("<I", len(items))
    for stamp, parent, child, place in items:
        body = padded(body, 4) + struct.pack("<iI", stamp.sec, stamp.nanosec)
        for text in (parent, child):
            raw = text.encode() + b"\0"
            body = padded(body, 4) + struct.pack("<I", len(raw)) + raw
        body = padded(body, 8) + struct.pack("<7d", *place, 0.0, 0.0, 0.0, 1.0)
    return b"\0\1\0\0" + body


def padded(body: bytes, size: int) -> bytes:
    return body + bytes(-len(body) % size)
