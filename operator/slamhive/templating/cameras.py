# SPDX-License-Identifier: Apache-2.0
"""Cameras in the words of the programs that are configured: intrinsics by name, and whole blocks of them.

The field's names for one and the same thing: a pinhole with equidistant distortion is KANNALA_BRANDT to
camodocal (VINS), KannalaBrandt8 to ORB-SLAM3 and pinhole with equi to Kalibr.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.templating.numbers import HelperProblem, number, plain, shown

if TYPE_CHECKING:
    from collections.abc import Mapping

_RADIAL_TANGENTIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_EQUIDISTANT = ("k1", "k2", "k3", "k4")
_KANNALA_BRANDT = ("k2", "k3", "k4", "k5")


def camera_fields(view: Mapping[str, Any], role: str, scale: float = 1.0) -> dict[str, Any]:
    """Return a camera's intrinsics by name.

    Args:
        view: the sensor as config.yaml has it.
        role: its role, for sentences.
        scale: by which the program itself scales images: the centre of the first pixel is 0, so that
            f' = f·s and c' = (c + 0.5)·s − 0.5, with s of the whole pixels that come out.

    Returns:
        ``model`` (Pinhole, Mei or Equidistant, which is a pinhole with equidistant distortion),
        ``distortion``, ``width`` and ``height`` in whole pixels, ``fx fy cx cy`` in pixels, ``xi`` of the
        Mei model, ``k1 k2 p1 p2 k3`` (``k4 k5 k6`` of the rational model) or ``k1 k2 k3 k4`` of the
        equidistant one, 0 where not given, and ``fps`` in Hz where known.
    """
    found = view.get("camera")
    if not isinstance(found, dict):
        raise HelperProblem(f"the sensor {role!r} has no intrinsics")
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale <= 16:
        raise HelperProblem(f"scale must be above 0 and at most 16, not {shown(scale)}")
    width, height = (max(1, round(found[name] * scale)) for name in ("width", "height"))
    sx, sy = width / found["width"], height / found["height"]
    distortion = found.get("distortion", "None")
    model = found.get("model", "Pinhole")
    fields: dict[str, Any] = {
        "model": "Equidistant" if (model, distortion) == ("Pinhole", "Equidistant") else model,
        "distortion": distortion,
        "width": width,
        "height": height,
        "fx": found["fx"] * sx,
        "fy": found["fy"] * sy,
        "cx": (found["cx"] + 0.5) * sx - 0.5,
        "cy": (found["cy"] + 0.5) * sy - 0.5,
    }
    if scale == 1:  # by no rounding error off
        fields |= {name: found[name] for name in ("fx", "fy", "cx", "cy")}
    if found.get("xi") is not None:
        fields["xi"] = found["xi"]
    if view.get("rate") is not None:
        fields["fps"] = view["rate"]
    names = _EQUIDISTANT if distortion == "Equidistant" else _RADIAL_TANGENTIAL[:5]
    given = dict(
        zip(_RADIAL_TANGENTIAL if len(names) == 5 else names, found.get("coefficients") or [], strict=False)
    )
    return fields | dict.fromkeys(names, 0.0) | given


def camodocal(fields: Mapping[str, Any], role: str) -> str:
    """Return the lines of a camera's file as camodocal reads it (VINS-Mono and VINS-Fusion).

    ``model_type`` is PINHOLE, MEI (γ = f, u₀ v₀ = c, mirror ξ) or KANNALA_BRANDT, whose k2 to k5 are the
    equidistant model's k1 to k4.
    """
    c = fields
    lines = [f"camera_name: {role}", f"image_width: {c['width']}", f"image_height: {c['height']}"]
    if c["model"] == "Equidistant":
        names = [*zip(_KANNALA_BRANDT, _EQUIDISTANT, strict=True)]
        names += [("mu", "fx"), ("mv", "fy"), ("u0", "cx"), ("v0", "cy")]
        return _block([("model_type", "KANNALA_BRANDT")], lines, {"projection_parameters": names}, c)
    _four_coefficients(c, role, "camodocal's models take")
    distortion = [(name, name) for name in _RADIAL_TANGENTIAL[:4]]
    if c["model"] == "Mei":
        parts = {
            "mirror_parameters": [("xi", "xi")],
            "distortion_parameters": distortion,
            "projection_parameters": [("gamma1", "fx"), ("gamma2", "fy"), ("u0", "cx"), ("v0", "cy")],
        }
        return _block([("model_type", "MEI")], lines, parts, c)
    projection = [(name, name) for name in ("fx", "fy", "cx", "cy")]
    parts = {"distortion_parameters": distortion, "projection_parameters": projection}
    return _block([("model_type", "PINHOLE")], lines, parts, c)


def orb_slam_camera(fields: Mapping[str, Any], role: str, name: str = "Camera1") -> str:
    """Return the lines of a camera in ORB-SLAM's settings: ``NAME.fx`` to ``NAME.k3``, each with a point.

    Distortion is k1 k2 p1 p2 k3 (k3 where it isn't 0), or k1 to k4 of KannalaBrandt8. ``Camera.type``,
    size and rate are one's own lines: they stand once a file.

    Args:
        fields: as `camera_fields` returns them.
        role: for sentences.
        name: ``Camera1`` and ``Camera2`` of ORB-SLAM3, ``Camera`` of ORB-SLAM2.
    """
    if fields["model"] == "Mei" or any(fields.get(word) for word in ("k4", "k5", "k6") if "p1" in fields):
        raise HelperProblem(f"orb_slam_camera: {role!r} is {_named(fields)}, which ORB-SLAM has no model for")
    names = [
        "fx",
        "fy",
        "cx",
        "cy",
        *(_EQUIDISTANT if fields["model"] == "Equidistant" else _RADIAL_TANGENTIAL[:4]),
    ]
    if fields["model"] != "Equidistant" and fields["k3"]:
        names.append("k3")
    return "\n".join(f"{name}.{word}: {number(float(fields[word]))}" for word in names)


def kalibr_camera(fields: Mapping[str, Any], role: str) -> dict[str, Any]:
    """Return one camera's entry in a Kalibr camchain but for transforms and topic.

    ``pinhole`` has intrinsics fx fy cx cy, ``omni`` xi fx fy cx cy; distortion is ``radtan`` (k1 k2 p1 p2),
    ``equidistant`` (k1 to k4) or ``none``.
    """
    intrinsics = [float(fields[word]) for word in ("fx", "fy", "cx", "cy")]
    if fields["model"] == "Mei":
        intrinsics = [float(fields.get("xi", 0.0)), *intrinsics]
    if fields["distortion"] == "Equidistant":
        model, names = "equidistant", _EQUIDISTANT
    else:
        _four_coefficients(fields, role, "Kalibr's radtan takes")
        names = _RADIAL_TANGENTIAL[:4]
        model = "none" if fields["distortion"] == "None" else "radtan"
    return {
        "camera_model": "omni" if fields["model"] == "Mei" else "pinhole",
        "intrinsics": intrinsics,
        "distortion_model": model,
        "distortion_coeffs": [] if model == "none" else [float(fields[word]) for word in names],
        "resolution": [fields["width"], fields["height"]],
    }


def _four_coefficients(fields: Mapping[str, Any], role: str, who: str) -> None:
    more = [word for word in ("k3", "k4", "k5", "k6") if fields.get(word)]
    if fields["distortion"] == "Equidistant" or more:
        raise HelperProblem(f"{who} k1 k2 p1 p2 alone, and {role!r} is {_named(fields)}")


def _named(fields: Mapping[str, Any]) -> str:
    more = [
        f"{word} = {number(float(fields[word]))}" for word in ("k3", "k4", "k5", "k6") if fields.get(word)
    ]
    return " ".join([f"{fields['model']} with {fields['distortion']} distortion", *more[:1]])


def _block(
    head: list[tuple[str, str]],
    lines: list[str],
    parts: Mapping[str, list[tuple[str, str]]],
    c: Mapping[str, Any],
) -> str:
    text = [f"{key}: {value}" for key, value in head] + lines
    for part, names in parts.items():
        text.append(f"{part}:")
        text += [f"   {theirs}: {plain(float(c.get(ours, 0.0)))}" for theirs, ours in names]
    return "\n".join(text)
