# SPDX-License-Identifier: Apache-2.0
"""Message types by their names: those that are installed, and others for bytes alone."""

from __future__ import annotations

import ctypes
import re
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from slamhive.playback.protocol import PlayError

_DIGEST = re.compile(r"RIHS01_([0-9a-f]{64})")


def message_type(name: str, digest: str = "") -> type:
    """Return the class of a message type.

    Args:
        name: Such as sensor_msgs/msg/Imu.
        digest: Its hash as ROS 2 has it (RIHS01), for one that isn't installed.

    Raises:
        PlayError: It isn't installed, and can't be made.
    """
    package, _, short = name.partition("/msg/")
    try:
        found: type = getattr(import_module(f"{package}.msg"), short)
    except (ImportError, AttributeError):
        return _bytes_type(package, short, digest)
    # Debian's packages of ROS 1 have these names too, and a Python of the system finds them.
    return found if hasattr(type(found), "_TYPE_SUPPORT") else _bytes_type(package, short, digest)


def is_by_name(kind: type) -> bool:
    """Tell whether a class stands for a type that isn't installed, by its name alone."""
    return kind.__module__ == __name__


def forget_errors() -> None:
    """Forget the errors of a search for a type's support that ended well.

    ROS 2 keeps the last one, and would print pages of it beside the next.
    """
    with suppress(OSError, AttributeError, StopIteration):
        lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
        path = next(line.split(maxsplit=5)[5] for line in lines if "/librcutils" in line)
        ctypes.CDLL(path).rcutils_reset_error()


class _TypeSupport(ctypes.Structure):
    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("digest", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("package", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("functions", ctypes.c_void_p * 5),
    )


class _Digest(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


_Find = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_Tell = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
_FAST = b"rosidl_typesupport_fastrtps_c"
_kept: list[object] = []


def _bytes_type(package: str, short: str, digest: str) -> type:
    """Return a class for publishing and taking a type's messages as bytes, by its name alone.

    A message that goes over the wire as bytes needs nothing of its type but the name and the hash. The
    support of a type that is installed is copied, with the names of the other (rosidl of Kilted: older
    releases ask for another support too, which names can't make).
    """
    name = f"{package}/msg/{short}"
    found = _DIGEST.fullmatch(digest)
    from geometry_msgs.msg import PoseArray  # type: ignore[import-not-found] # noqa: PLC0415

    meta: Any = type(PoseArray)
    meta.__import_type_support__()
    get, make = ctypes.pythonapi.PyCapsule_GetPointer, ctypes.pythonapi.PyCapsule_New
    get.restype, get.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    base = get(vars(meta)["_TYPE_SUPPORT"], None)
    inner = _Find(_TypeSupport.from_address(base).find)(base, _FAST)
    if not inner:
        raise PlayError(f"the type {name} isn't installed here: install the package {package} of ROS 2")
    support = _TypeSupport.from_buffer_copy(_TypeSupport.from_address(inner))
    callbacks = _Callbacks.from_buffer_copy(_Callbacks.from_address(support.data))
    callbacks.package = callbacks.package.replace(b"geometry_msgs", package.encode())
    callbacks.name = short.encode()
    told = _Digest(1, (ctypes.c_uint8 * 32)(*bytes.fromhex(found[1] if found else "00" * 32)))
    find = _Find(lambda _, which: ctypes.addressof(support) if which == _FAST else None)
    tell = _Tell(lambda _: ctypes.addressof(told))
    support.data = ctypes.addressof(callbacks)
    support.find = ctypes.cast(find, ctypes.c_void_p)
    support.digest = ctypes.cast(tell, ctypes.c_void_p)
    _kept.append((support, callbacks, told, find, tell))
    fields = ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE")
    same = {field: getattr(meta, field) for field in fields}
    capsule = make(ctypes.addressof(support), None, None)
    return type(f"Metaclass_{short}", (type,), {**same, "_TYPE_SUPPORT": capsule})(short, (), {})  # type: ignore[no-any-return]
