"""The CCSDS Attitude Ephemeris Message (AEM, CCSDS 504.0-B-1 and -B-2), in KVN and XML, read by `ccsds-ndm`.

What an AEM says is heeded: the direction from REF_FRAME_A to REF_FRAME_B, in version 1 turned by
ATTITUDE_DIR; the place of the scalar part (QUATERNION_TYPE); TIME_SYSTEM; the axes of angular velocities
(ANGVEL_FRAME). Its quaternions are passive, as ours: "from A to B" gives a vector's components in B from
those in A (504.0-B-1 and -B-2, annex on the conversion to direction cosines). One of the frames has to be
inertial (ICRF, GCRF, EME2000), the other one the body's; what else there is, is refused by its name. Between
the attitudes holds what `sampled` says, whatever INTERPOLATION_METHOD recommends.
"""

from __future__ import annotations

import math
import warnings
from typing import Any
from xml.sax.saxutils import escape

import erfa
import numpy as np

from . import quaternion
from .epochs import SCALES, tai_ns_of
from .sampled import TruthSample

_BIAS = np.asarray(erfa.bp00(2451545.0, 0.0)[0])  # ICRS to the mean equator and equinox of J2000.0: 23 mas
_FROM_ICRS = {
    **dict.fromkeys(("ICRF", "ICRS", "GCRF", "ICRF1", "ICRF2", "ICRF3"), quaternion.IDENTITY),
    **dict.fromkeys(("EME2000", "J2000"), quaternion.from_matrix(_BIAS)),
}
_BODIES = ("SC_BODY", "SC_", "STARTRACKER", "ST_", "STR", "INSTRUMENT", "SENSOR", "CAMERA", "AST")
#: attitude type -> what the package calls its states in versions 1 and 2
_STATES = {
    "QUATERNION": ("quaternion_state", "quaternion_ephemeris"),
    "QUATERNION/ANGVEL": ("quaternion_ang_vel",),
}


class MissingPackageError(ValueError):
    """The package that reads these files is not installed."""


def is_aem(text: str) -> bool:
    """Whether a file's text begins like an AEM."""
    head = text[:4096].lstrip("\ufeff \t\r\n")
    return head.startswith("CCSDS_AEM_VERS") or (head.startswith("<") and ("<aem" in head or "<ndm" in head))


def samples_of_aem(text: str, start_tai_ns: int) -> list[TruthSample]:
    """The samples of an AEM; ``start_tai_ns``: the date of power-on. Their "sensor" is the file's body.

    Raises:
        ValueError: names what is wrong or not supported, and what is allowed.
    """
    message = _parsed(text.removeprefix("\ufeff"))
    body = getattr(message, "body", None)
    segments = getattr(body, "segment", None)
    if type(message).__name__ not in ("Aem", "AemType") or not isinstance(segments, list):
        raise ValueError(f"a CCSDS message {type(message).__name__}; allowed is an AEM")
    if len(segments) != 1:
        raise ValueError(
            f"{len(segments)} segments, between which nothing may be interpolated; allowed is an AEM of one"
        )
    return _samples(segments[0].metadata, segments[0].data.attitude_state, start_tai_ns)


def _parsed(text: str) -> Any:
    try:
        from ccsds_ndm.ndm_io import NdmIo  # here: an extra, and half a second to import
    except ImportError as error:
        raise MissingPackageError(
            "reading an AEM needs the package ccsds-ndm: pip install 'st-emulator[aem]'"
        ) from error
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("XML with a document type; allowed is XML without")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of a value that is none, which it would hand on as a text
            return NdmIo().from_string(_as_xml(text) if _is_kvn_2(text) else text)
    except Exception as error:  # whatever its parsers raise: it is the file
        told = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"no AEM that can be read ({told[:120]})") from error


def _samples(meta: Any, states: list[Any], start_tai_ns: int) -> list[TruthSample]:
    kind = _word(meta.attitude_type)
    if kind not in _STATES:
        raise ValueError(f"ATTITUDE_TYPE = {kind}; allowed are {', '.join(_STATES)}")
    scale = _word(meta.time_system)
    if scale not in SCALES:
        raise ValueError(f"TIME_SYSTEM = {scale}; allowed are {', '.join(SCALES)}")
    from_icrs, inertial_first = _frames(str(meta.ref_frame_a), str(meta.ref_frame_b))
    # from A to B is from the inertial frame to the body where A is the inertial one
    to_body = inertial_first
    if _word(getattr(meta, "attitude_dir", None) or "A2B") == "B2A":
        to_body = not to_body
    found = []
    for number, state in enumerate(states, start=1):
        held = next((v for name in _STATES[kind] if (v := getattr(state, name, None)) is not None), None)
        if held is None:
            raise ValueError(f"attitude {number}: is not of ATTITUDE_TYPE {kind}")
        try:
            parts = held.quaternion
            q = np.array([float(parts.q1), float(parts.q2), float(parts.q3), float(parts.qc)])
            if not 0.99 < float(np.linalg.norm(q)) < 1.01:
                raise ValueError(f"quaternion {q.tolist()}; allowed is one of length 1")
            q = q if to_body else quaternion.conjugate(q)
            rate = None
            if kind == "QUATERNION/ANGVEL":
                rate = _rate(held.ang_vel, q, meta, inertial_first)
            found.append(
                TruthSample(
                    tai_ns_of(str(held.epoch), scale) - start_tai_ns,
                    quaternion.multiply(q, from_icrs),  # type: ignore[arg-type]  # it takes arrays as well
                    rate,
                )
            )
        except (ValueError, TypeError, AttributeError) as error:
            raise ValueError(f"attitude {number}: {error}") from error
    return found


def _frames(a: str, b: str) -> tuple[Any, bool]:
    """(quaternion from ICRS to the inertial frame, whether that is frame A)."""
    inertial = [name for name in (a, b) if name.strip().upper() in _FROM_ICRS]
    if len(inertial) != 1:
        raise ValueError(
            f"REF_FRAME_A = {a}, REF_FRAME_B = {b}; allowed is one of {', '.join(_FROM_ICRS)} and the "
            "frame of the body"
        )
    body = b if inertial[0] == a else a
    if not body.strip().upper().startswith(_BODIES):
        raise ValueError(
            f"frame {body}; allowed beside {inertial[0]} is a frame of the body, such as SC_BODY_1, "
            "INSTRUMENT_A or STARTRACKER_1"
        )
    return _FROM_ICRS[inertial[0].strip().upper()], inertial[0] == a


def _rate(given: Any, q_to_body: Any, meta: Any, inertial_first: bool) -> Any:
    """Of the body relative to the inertial frame, rad/s, body axes."""
    values = []
    for axis in "xyz":
        part = getattr(given, f"angvel_{axis}")
        units = _word(getattr(part, "units", None) or "deg/s").lower()
        if units != "deg/s":
            raise ValueError(f"ANGVEL_{axis.upper()} in {units}; allowed is deg/s")
        values.append(math.radians(float(getattr(part, "value", part))))
    rate = np.array(values)
    if not inertial_first:
        rate = -rate  # an AEM's is that of frame B relative to A
    frame = str(meta.angvel_frame or "")
    body, inertial = (
        (meta.ref_frame_b, meta.ref_frame_a) if inertial_first else (meta.ref_frame_a, meta.ref_frame_b)
    )
    if frame == body:
        return rate
    if frame == inertial:
        return quaternion.rotate(q_to_body, rate)
    raise ValueError(f"ANGVEL_FRAME = {frame or 'missing'}; allowed are {body} and {inertial}")


def _word(value: Any) -> str:
    return str(getattr(value, "value", value)).upper()


# -- version 2 in KVN, which the package (3.1.1) reads in XML alone: the same message in XML


def _is_kvn_2(text: str) -> bool:
    head = text.lstrip()
    return head.startswith("CCSDS_AEM_VERS") and head.split("\n", 1)[0].partition("=")[2].strip() == "2.0"


_DATA = {
    "QUATERNION": ("quaternionEphemeris", ()),
    "QUATERNION/ANGVEL": ("quaternionAngVel", ("ANGVEL_X", "ANGVEL_Y", "ANGVEL_Z")),
}


def _as_xml(text: str) -> str:
    """The XML of a message in KVN. ValueError for lines that are none."""
    header: list[str] = []
    segments: list[str] = []
    block: str | None = None
    kind = ""
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("COMMENT"):
            continue
        if line in ("META_START", "META_STOP", "DATA_START", "DATA_STOP"):
            block = line.removesuffix("_START") if line.endswith("_START") else None
            tag = "metadata" if line.startswith("META") else "data"
            opening = {"META_START": "<segment><metadata>", "DATA_START": "<data>"}
            segments.append(opening.get(line) or f"</{tag}>" + ("</segment>" if tag == "data" else ""))
        elif block == "DATA":
            segments.append(_state(line, kind, number))
        else:
            key, equals, value = (part.strip() for part in line.partition("="))
            if not equals or not key.replace("_", "").isalnum():
                raise ValueError(f"line {number}: {line!r:.40}; allowed is KEYWORD = value")
            if key == "ATTITUDE_TYPE":
                kind = value.upper()
                if kind not in _DATA:
                    raise ValueError(f"ATTITUDE_TYPE = {value}; allowed are {', '.join(_DATA)}")
            (header if block is None else segments).append(f"<{key}>{escape(value)}</{key}>")
    return (
        '<?xml version="1.0" encoding="UTF-8"?><aem id="CCSDS_AEM_VERS" version="2.0"><header>'
        + "".join(header[1:])
        + "</header><body>"
        + "".join(segments)
        + "</body></aem>"
    )


def _state(line: str, kind: str, number: int) -> str:
    if kind not in _DATA:
        raise ValueError(f"line {number}: data before an ATTITUDE_TYPE")
    tag, more = _DATA[kind]
    values = line.split()
    if len(values) != 5 + len(more):
        raise ValueError(f"line {number}: {len(values)} values; allowed are {5 + len(more)} for {kind}")
    epoch, *numbers = (escape(value) for value in values)
    parts = "".join(f"<{n}>{v}</{n}>" for n, v in zip(("Q1", "Q2", "Q3", "QC"), numbers[:4], strict=True))
    rates = "".join(f'<{n} units="deg/s">{v}</{n}>' for n, v in zip(more, numbers[4:], strict=True))
    rates = f"<angVel>{rates}</angVel>" if rates else ""
    return (
        f"<attitudeState><{tag}><EPOCH>{epoch}</EPOCH><quaternion>{parts}</quaternion>{rates}</{tag}>"
        "</attitudeState>"
    )
