"""Conversion of the controller's objects to plain values and back.

The state hash and the snapshots use the plain values. Plain values consist of numbers, strings,
bytes and tuples only. A named tuple or dataclass becomes a tuple that begins with the name of the
type. The plain values of equal objects are serialized to equal bytes. The bytes are the same
whether an object contains one part twice or two equal copies of the part.
``object_from_plain_data`` creates only objects of registered types, so a log cannot create objects
of other types.
"""

import enum
import functools
import json
import marshal
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from pydantic import BaseModel

MARSHAL_VERSION = 2
"""Version of the format of ``marshal``.

Version 2 is the last version of the format that writes no references to shared values.
"""
ARRAY_MARK, MODEL_MARK, BYTES_MARK = ":array", ":model", ":bytes"
"""Marks that replace the type name in the plain form of arrays, pydantic models and bytes."""
LOGGED_NAME_BY_TYPE = {
    "controller.pending_gains.PendingGains": "controller.coming.Coming",
    "drives.contract.DriveTarget": "drives.contract.Want",
    "controller.controller_state.ControllerDecisions": "controller.state.Decisions",
    "controller.controller_state.ClientLease": "controller.state.Lease",
    "core.control_law.digit_goal.DigitGoal": "core.law.goal.DigitGoal",
    "core.control_law.trajectory.MinimumJerk": "core.law.trajectory.MinimumJerk",
    "core.control_law.digit_goal.GoalKind": "core.law.goal.Kind",
    "safety.tick_verdict.LatchedFault": "safety.judge.Latched",
    "safety.tick_verdict.ReportedFault": "safety.judge.Counting",
    "core.control_law.trajectory.StreamedTrajectory": "core.law.trajectory.Streamed",
    "core.control_law.trajectory.BlendTrajectory": "core.law.trajectory.Blend",
    "core.control_law.trajectory.CurveTrajectory": "core.law.trajectory.Curve",
    "core.control_law.trajectory.SampledTrajectory": "core.law.trajectory.Sample",
    "core.control_law.trajectory.ChirpTrajectory": "core.law.trajectory.Chirp",
    "programs.excitation.SwingTrajectory": "programs.excite.Swing",
    "programs.stream_plans.StreamPlan": "programs.streams.StreamPlan",
    "programs.program.ProgramProgress": "programs.program.Progress",
    "programs.grip.GripState": "programs.grip.Grip",
    "drives.contract.DrivePhase": "drives.contract.Phase",
    "drives.readback.ReadbackCursor": "drives.readback.Walk",
    "drives.readback.RecheckCursor": "drives.readback.Recheck",
    "drives.moteus.settings.DiagnosticChannel": "drives.moteus.settings.Channel",
    "drives.mit.progress.MitProgress": "drives.mit.progress.Progress",
    "drives.mit.cubemars.CubemarsProgress": "drives.mit.cubemars.Progress",
    "drives.odrive.progress.OdriveProgress": "drives.odrive.progress.Progress",
    "drives.cia402.progress.Cia402Progress": "drives.cia402.progress.Progress",
}
"""First name of each renamed type, by its present name.

Hashes and snapshots in logs contain the first name of each type.
"""
_TYPE_BY_LOGGED_NAME: dict[str, type] = {}
_TYPES_WITHOUT_CONVERSION = frozenset((type(None), bool, int, float, str, bytes))


@functools.cache
def logged_type_name(type_: type) -> str:
    """Return the name of a type in plain values.

    The name consists of the module and the class name that the type had when it was introduced.
    """
    name = f"{type_.__module__.removeprefix('handctl.')}.{type_.__qualname__}"
    return ":" + LOGGED_NAME_BY_TYPE.get(name, name)


def register_restorable_types(*types: type) -> None:
    """Register types whose objects ``object_from_plain_data`` is allowed to create."""
    _TYPE_BY_LOGGED_NAME.update({logged_type_name(type_): type_ for type_ in types})


def to_plain_data(value: Any) -> Any:
    """Convert a value to plain values: numbers, strings, bytes and tuples of these.

    Raises:
        TypeError: a part of the value is neither plain nor a named tuple, dataclass, array,
            enumeration or model.
    """
    kind: type = type(value)
    if kind in _TYPES_WITHOUT_CONVERSION:
        return value
    if isinstance(value, tuple):
        # The code below runs in the ticks in which settings of drives are read. For speed, no
        # function is called for an item that is already plain.
        elements = [
            element if type(element) in _TYPES_WITHOUT_CONVERSION else to_plain_data(element)
            for element in value
        ]
        return (logged_type_name(kind), *elements) if hasattr(value, "_fields") else tuple(elements)
    if isinstance(value, enum.IntEnum):
        return (logged_type_name(kind), int(value))
    if isinstance(value, np.ndarray):
        return (ARRAY_MARK, value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes())
    if isinstance(value, BaseModel):
        return (MODEL_MARK, logged_type_name(type(value)), value.model_dump_json(by_alias=True))
    if is_dataclass(value) and not isinstance(value, type):
        field_values = tuple(
            [to_plain_data(getattr(value, field.name)) for field in fields(value) if field.init]
        )
        return (logged_type_name(type(value)), *field_values)
    raise TypeError(f"{type(value).__name__} is no plain value")


def serialized_bytes(value: Any) -> bytes:
    """Convert a value to plain values, and serialize these to bytes."""
    return marshal.dumps(to_plain_data(value), MARSHAL_VERSION)


def join_serialized_items(items: Sequence[bytes]) -> bytes:
    """Return ``serialized_bytes`` of a tuple, joined from ``serialized_bytes`` of its items."""
    # In version 2 of the format of ``marshal``, a tuple is a mark, the number of items, and the
    # items.
    return b"(" + len(items).to_bytes(4, "little") + b"".join(items)


def json_from_serialized_bytes(serialized_data: bytes) -> bytes:
    """Convert the result of ``serialized_bytes`` to JSON.

    A value of type ``bytes`` becomes a mark and hexadecimal digits. The data must come from handctl
    itself, because ``marshal`` does not check them.
    """
    return json.dumps(
        marshal.loads(serialized_data), separators=(",", ":"), default=_json_value_of_bytes
    ).encode()


def _json_value_of_bytes(value: object) -> tuple[str, str]:
    """Return the text ``BYTES_MARK`` and the bytes as a hexadecimal text, because JSON has no type for bytes."""
    assert isinstance(value, bytes)
    return BYTES_MARK, value.hex()


@functools.cache
def _serialized_name_and_field_reader(
    type_: type,
) -> tuple[bytes, Callable[[Any], tuple[Any, ...]]]:
    """Return the serialized name of a dataclass, and a function that reads the fields of an object.

    The dataclass has at least two fields.
    """
    names = [field.name for field in fields(type_) if field.init]
    return serialized_bytes(logged_type_name(type_)), attrgetter(*names)


def join_serialized_fields(
    value: Any, serialize_fields: Callable[[Sequence[Any]], list[bytes]]
) -> bytes:
    """Return ``serialized_bytes(value)`` for an object of a dataclass, joined from the bytes of its fields.

    ``serialize_fields`` can take the bytes of a field from a cache. With a cache, the function is
    fast if most fields of ``value`` are the same objects as in the last call.

    Args:
        value: object of a dataclass.
        serialize_fields: function that returns ``serialized_bytes`` of each field.
    """
    kind: type = type(value)
    name, read_fields = _serialized_name_and_field_reader(kind)
    return join_serialized_items([name, *serialize_fields(read_fields(value))])


def object_from_plain_data(value: Any) -> Any:
    """Return the object that a plain value represents.

    The function also accepts lists from JSON in place of tuples.

    Raises:
        ValueError: a type is not registered, or the value does not fit the type.
    """
    if not isinstance(value, tuple | list):
        return value
    if not value or not isinstance(value[0], str) or not value[0].startswith(":"):
        return tuple([object_from_plain_data(element) for element in value])
    mark, *arguments = value
    if mark == ARRAY_MARK:
        kind, shape, data = arguments
        return np.frombuffer(object_from_plain_data(data), np.dtype(kind)).reshape(shape).copy()
    if mark == BYTES_MARK:
        return bytes.fromhex(arguments[0])
    if mark == MODEL_MARK:
        model: Any = _registered_type(arguments[0])
        return model.model_validate_json(arguments[1])
    registered_type: Any = _registered_type(mark)
    try:
        return registered_type(*[object_from_plain_data(argument) for argument in arguments])
    except TypeError as error:
        raise ValueError(f"{mark[1:]} cannot be restored: {error}") from None


def _registered_type(name: str) -> type:
    if name not in _TYPE_BY_LOGGED_NAME:
        raise ValueError(f"a snapshot names the type {name[1:]!r}, which none may hold")
    return _TYPE_BY_LOGGED_NAME[name]
