"""Types of the values in a hand file. Each type has a range of values that are plausible for a robot hand.

The plausible ranges include the values of all usual hands, but not values in wrong units. For
example, a link length that the user gives in millimetres is too large by a factor of 1000.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

POLYNOMIAL_COEFFICIENTS = 6
"""Number of coefficients of the polynomial of each moment arm.

The units of the coefficients are [m], [m/rad], [m/rad^2] and so on.
"""
NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Pattern of valid names of hands, digits, tendons, motors, and buses."""
UNMEASURED_PLACEHOLDER = "TODO"
"""Placeholder for a value that is not yet measured or chosen.

The checks of a hand file refuse the text ``TODO`` for every key.
"""


def validation_error(valid_value: str) -> PydanticCustomError:
    """Return a validation error whose text contains a valid value.

    The module ``error_text`` prints the valid value after the invalid value.
    """
    return PydanticCustomError("hand", "expected {right}", {"right": valid_value})


@dataclass(frozen=True, eq=False)
class CheckedType:
    """Validator for one type of value, given both as a function and as a JSON Schema.

    pydantic uses the function ``check``. Editors use the JSON Schema ``schema``.

    Attributes:
        check: function that returns a valid value, and raises an error for an invalid value.
        schema: JSON Schema of the valid values.
    """

    check: Callable[[Any], Any]
    schema: Mapping[str, Any]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the schema with which pydantic validates a value."""
        return core_schema.no_info_before_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(
        self, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON Schema of valid values."""
        return dict(self.schema)


@dataclass(frozen=True)
class NumberRange:
    """Check that a value is a finite real number within [low, high].

    Attributes:
        low: smallest plausible value.
        high: largest plausible value.
        unit: unit of the value and of the limits.
        hint: question about the likely cause of a value that is too large, such as "in metres?".
    """

    low: float
    high: float
    unit: str = ""
    hint: str = ""

    def __call__(self, value: Any) -> float:
        """Check the value, and return it as a float."""
        expected = f"a number from {self.low:g} to {self.high:g} {self.unit}".rstrip()
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise validation_error(expected)
        # The comparison is negated, so that the check also refuses NaN.
        if not self.low <= value <= self.high:
            raise validation_error(
                f"{expected} ({self.hint})" if self.hint and value > self.high else expected
            )
        return float(value)

    @property
    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the numbers in the range."""
        return {"type": "number", "minimum": self.low, "maximum": self.high}


def number_in_range(minimum: float, maximum: float, unit: str = "", hint: str = "") -> CheckedType:
    """Return a validator for numbers between two limits, see ``NumberRange``."""
    number = NumberRange(minimum, maximum, unit, hint)
    return CheckedType(number, number.schema)


def integer_in_range(minimum: int, maximum: int) -> CheckedType:
    """Return a validator for integers between two limits."""

    def check_value(value: Any) -> int:
        """Return the value if it is valid."""
        if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
            raise validation_error(f"a whole number from {minimum} to {maximum}")
        return value

    return CheckedType(check_value, {"type": "integer", "minimum": minimum, "maximum": maximum})


def text_choice(*allowed_words: str) -> CheckedType:
    """Return a validator for texts that must be one of the given words."""

    def check_value(value: Any) -> str:
        """Return the value if it is one of the given words."""
        if not isinstance(value, str) or value not in allowed_words:
            raise validation_error(" or ".join(f'"{word}"' for word in allowed_words))
        return value

    return CheckedType(check_value, {"enum": list(allowed_words)})


def _check_direction(value: Any) -> int:
    """Return the value if it is a valid direction, which is 1 or -1."""
    if isinstance(value, bool) or not isinstance(value, int) or value not in (1, -1):
        raise validation_error("1 or -1")
    return value


def _check_name(value: Any) -> str:
    """Return the value if it is a valid name."""
    if (
        not isinstance(value, str)
        or not NAME_PATTERN.fullmatch(value)
        or value == UNMEASURED_PLACEHOLDER
    ):
        raise validation_error("a name of letters, digits and _ that begins with a letter")
    return value


def _check_string(value: Any) -> str:
    """Return the value if it is a valid string."""
    if not isinstance(value, str):
        raise validation_error("a string")
    return value


def _check_options(value: Any) -> dict[str, bool | int | float | str]:
    """Check that a value is a table of finite numbers, strings and booleans, and return it."""
    if not isinstance(value, dict):
        raise validation_error("a table")
    # The comparison is negated, so that the check also refuses NaN and infinity.
    for key, entry in value.items():
        if not isinstance(entry, bool | int | float | str) or (
            isinstance(entry, float) and not abs(entry) < 1e300
        ):
            raise validation_error(f"finite numbers, strings and booleans; {key} is none of them")
    return value


def zero_or_number_in_range(minimum: float, maximum: float, unit: str, hint: str) -> CheckedType:
    """Return a validator for numbers that must be 0 or between two limits, see ``NumberRange``."""
    number = NumberRange(minimum, maximum, unit, hint)

    def check_value(value: Any) -> float:
        """Check the value, and return it as a float."""
        is_zero = isinstance(value, int | float) and not isinstance(value, bool) and value == 0
        if is_zero:
            return 0.0
        try:
            return number(value)
        except PydanticCustomError as error:
            raise validation_error(f"0 or {(error.context or {})['right']}") from None

    return CheckedType(check_value, {"anyOf": [{"const": 0}, number.schema]})


def number_or_list(
    number_range: NumberRange, entry_range: NumberRange, *allowed_counts: int
) -> CheckedType:
    """Return a validator for values that are a number or a list of numbers.

    Args:
        number_range: check of a single number.
        entry_range: check for each number in a list.
        allowed_counts: valid lengths of a list.
    """
    expected = (
        f"a number, or a list of {' or '.join(str(count) for count in allowed_counts)} numbers"
    )

    def check_value(value: Any) -> float | tuple[float, ...]:
        """Return the number as a float, or the list as a tuple of floats."""
        if not isinstance(value, list | tuple):
            return number_range(value)
        if len(value) not in allowed_counts:
            raise validation_error(expected)
        return tuple(entry_range(element) for element in value)

    lists = [
        {"type": "array", "items": entry_range.schema, "minItems": count, "maxItems": count}
        for count in allowed_counts
    ]
    return CheckedType(check_value, {"anyOf": [number_range.schema, *lists]})


MOMENT_ARM_RANGE = NumberRange(-0.05, 0.05, "m", "in metres?")
"""Range of a constant moment arm of a tendon at a joint."""


MOMENT_ARM_FORMS = "{ polynomial_m = [r0, r1, ..] } of the joint angle in rad, or { angle_deg = [..], arm_m = [..] }"
"""Text for messages about the valid forms of a moment arm that depends on the joint angle."""
MAX_TABLE_ENTRIES = 1000
"""Largest number of entries in a table of moment arms."""


def _check_moment_arm(value: Any) -> float | dict[str, tuple[float, ...]]:
    """Return the value if it is a valid moment arm: a number, a polynomial, or a table."""
    if isinstance(value, list | tuple):
        raise validation_error(
            f"a number from {MOMENT_ARM_RANGE.low:g} to {MOMENT_ARM_RANGE.high:g} m, {MOMENT_ARM_FORMS}"
        )
    if not isinstance(value, Mapping):
        return MOMENT_ARM_RANGE(value)
    if set(value) == {"polynomial_m"}:
        return {
            "polynomial_m": _checked_numbers(
                value["polynomial_m"], "polynomial_m", 1, POLYNOMIAL_COEFFICIENTS, 1.0
            )
        }
    if set(value) != {"angle_deg", "arm_m"}:
        raise validation_error(MOMENT_ARM_FORMS)
    angle = _checked_numbers(value["angle_deg"], "angle_deg", 2, MAX_TABLE_ENTRIES, 360.0)
    arm = _checked_numbers(value["arm_m"], "arm_m", 2, MAX_TABLE_ENTRIES, MOMENT_ARM_RANGE.high)
    if len(angle) != len(arm):
        raise validation_error(
            f"an arm_m for each angle_deg, and there are {len(arm)} for {len(angle)}"
        )
    if any(upper_angle <= lower_angle for lower_angle, upper_angle in pairwise(angle)):
        raise validation_error("rising values of angle_deg")
    return {"angle_deg": angle, "arm_m": arm}


def _checked_numbers(
    values: Any, key: str, min_length: int, max_length: int, max_magnitude: float
) -> tuple[float, ...]:
    """Check the length of a list and the magnitude of the numbers in the list, and return the list."""
    expected = f"{min_length} to {max_length} numbers from {-max_magnitude:g} to {max_magnitude:g} in {key}"
    if not isinstance(values, list | tuple) or not min_length <= len(values) <= max_length:
        raise validation_error(expected)
    # The comparison is negated, so that the check also refuses NaN.
    if any(
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not abs(value) <= max_magnitude
        for value in values
    ):
        raise validation_error(expected)
    return tuple(float(value) for value in values)


def _list_schema(min_length: int, max_length: int, max_magnitude: float) -> dict[str, Any]:
    """Return the JSON Schema of the lists that ``_checked_numbers`` accepts."""
    entry = {"type": "number", "minimum": -max_magnitude, "maximum": max_magnitude}
    return {"type": "array", "items": entry, "minItems": min_length, "maxItems": max_length}


def _table_schema(**list_schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a table of lists. The table must contain each of the given keys and no other key."""
    return {
        "type": "object",
        "properties": list_schemas,
        "required": list(list_schemas),
        "additionalProperties": False,
    }


MOMENT_ARM_SCHEMA = {"anyOf": [
    MOMENT_ARM_RANGE.schema,
    _table_schema(polynomial_m=_list_schema(1, POLYNOMIAL_COEFFICIENTS, 1.0)),
    _table_schema(
        angle_deg=_list_schema(2, MAX_TABLE_ENTRIES, 360.0),
        arm_m=_list_schema(2, MAX_TABLE_ENTRIES, MOMENT_ARM_RANGE.high),
    ),
]}  # fmt: skip


Name = Annotated[
    str, CheckedType(_check_name, {"type": "string", "pattern": f"^{NAME_PATTERN.pattern}$"})
]
Text = Annotated[str, CheckedType(_check_string, {"type": "string"})]
Direction = Annotated[int, CheckedType(_check_direction, {"enum": [1, -1]})]
ProtocolOptions = Annotated[
    dict[str, bool | int | float | str],
    CheckedType(
        _check_options,
        {"type": "object", "additionalProperties": {"type": ["boolean", "number", "string"]}},
    ),
]

JointType = Annotated[str, text_choice("revolute", "prismatic")]
MotorControl = Annotated[str, text_choice("torque", "position")]
SensorProtocol = Annotated[str, text_choice("handctl", "cia404")]
ProcessValue = Annotated[str, text_choice("int32", "real32")]

Length = Annotated[float, zero_or_number_in_range(1e-3, 0.2, "m", "in metres?")]
"""Length of a link. The length of the link between two joints is 0 if their axes intersect."""
CentreOfMass = Annotated[
    float | tuple[float, float, float],
    number_or_list(
        NumberRange(0.0, 0.2, "m", "in metres?"), NumberRange(-0.2, 0.2, "m", "in metres?"), 3
    ),
]
DirectionComponent = Annotated[float, number_in_range(-1.0, 1.0)]
Radius = Annotated[float, number_in_range(5e-4, 0.05, "m", "in metres?")]
MomentArm = Annotated[
    float | dict[str, tuple[float, ...]], CheckedType(_check_moment_arm, MOMENT_ARM_SCHEMA)
]
Position = Annotated[float, number_in_range(-0.5, 0.5, "m", "in metres?")]
Mass = Annotated[float, number_in_range(1e-5, 0.5, "kg", "in kilograms?")]
LinkInertia = Annotated[
    float | tuple[float, ...],
    number_or_list(
        NumberRange(1e-12, 1e-3, "kg m2", "in kg m2?"),
        NumberRange(-1e-3, 1e-3, "kg m2", "in kg m2?"),
        3,
        6,
    ),
]
Armature = Annotated[float, number_in_range(0.0, 1e-3, "kg m2", "in kg m2?")]
MotorInertia = Annotated[float, number_in_range(1e-8, 1e-1, "kg m2", "in kg m2, at the spool?")]
JointAngle = Annotated[float, number_in_range(-180.0, 180.0, "deg")]
MountAngle = Annotated[float, number_in_range(-360.0, 360.0, "deg")]
JointTravel = Annotated[float, number_in_range(-0.1, 0.1, "m", "in metres?")]
"""Position of a prismatic joint. The frame of a joint encoder can represent every position in the range."""
ExcursionRatio = Annotated[float, number_in_range(-5.0, 5.0, "", "in metres of tendon per metre?")]
TravelPreload = Annotated[float, number_in_range(0.0, 0.2, "m", "in metres?")]
TravelDamping = Annotated[float, number_in_range(0.0, 1000.0, "N s/m")]
TravelArmature = Annotated[float, number_in_range(0.0, 1.0, "kg", "in kilograms?")]
TravelStiffness = Annotated[float, number_in_range(0.0, 1e5, "N/m", "in N/m?")]
TravelNoise = Annotated[float, number_in_range(1e-9, 5e-3, "m", "in metres?")]
SpringPreload = Annotated[float, number_in_range(0.0, 6.3, "rad", "in radians?")]
WrapAngle = Annotated[float, number_in_range(0.0, 20.0, "rad", "in radians?")]
MotorZeroAngle = Annotated[float, number_in_range(-100.0, 100.0, "rad", "in radians?")]
MAX_POSITION_RANGE_RAD = 1000.0
"""Largest position range of a drive, and largest absolute motor position [rad]."""
PositionRange = Annotated[float, number_in_range(0.1, MAX_POSITION_RANGE_RAD, "rad", "in radians?")]
MAX_SPEED_RANGE_RAD_S = 1000.0
"""Largest speed range of a drive [rad/s]."""
SpeedRange = Annotated[float, number_in_range(0.1, MAX_SPEED_RANGE_RAD_S, "rad/s", "in rad/s?")]
Damping = Annotated[float, number_in_range(0.0, 0.1, "N m s/rad")]
ServoStiffness = Annotated[float, number_in_range(1e-3, 5000.0, "N m/rad", "at the spool?")]
ServoDamping = Annotated[float, number_in_range(0.0, 100.0, "N m s/rad", "at the spool?")]
SpringStiffness = Annotated[float, number_in_range(0.0, 10.0, "N m/rad", "in N m per radian?")]
Gravity = Annotated[float, number_in_range(-20.0, 20.0, "m/s2")]
Coupling = Annotated[float, number_in_range(-10.0, 10.0)]
Force = Annotated[float, number_in_range(0.0, 5000.0, "N", "in newtons?")]
PositiveForce = Annotated[float, number_in_range(0.1, 5000.0, "N", "in newtons?")]
TendonStiffness = Annotated[float, number_in_range(1e3, 1e7, "N/m", "in N/m?")]
TendonDamping = Annotated[float, number_in_range(0.0, 1e4, "N s/m")]
StiffnessRatio = Annotated[float, number_in_range(0.01, 10.0)]
KneeWidth = Annotated[float, number_in_range(1e-6, 0.01, "m", "in metres?")]
FrictionCoefficient = Annotated[float, number_in_range(0.0, 1.0)]
MIN_TORQUE_LIMIT_N_M = 1e-3
"""Smallest torque limit of a motor that a hand file allows [N m]."""
MAX_TORQUE_N_M = 50.0
"""Largest torque that a hand file allows [N m]."""
Torque = Annotated[float, number_in_range(0.0, MAX_TORQUE_N_M, "N m", "in N m?")]
PositiveTorque = Annotated[
    float, number_in_range(MIN_TORQUE_LIMIT_N_M, MAX_TORQUE_N_M, "N m", "in N m?")
]
TorqueConstant = Annotated[float, number_in_range(1e-4, 50.0, "N m/A", "at the spool?")]
JointNoise = Annotated[float, number_in_range(1e-7, 0.5, "rad", "in radians?")]
JointSpeed = Annotated[float, number_in_range(1.0, 3000.0, "deg/s", "in degrees?")]
JointAcceleration = Annotated[float, number_in_range(10.0, 1e6, "deg/s2", "in degrees?")]
TensionRate = Annotated[float, number_in_range(1.0, 1e5, "N/s")]
StaleTime = Annotated[float, number_in_range(1.0, 60_000.0, "ms", "in milliseconds?")]
# Smallest and largest accepted bit rate, for classical CAN and for the data phase of CAN FD
# [bit/s].
MIN_BITRATE_BIT_S = 10_000
MAX_BITRATE_BIT_S = 8_000_000
Bitrate = Annotated[int, integer_in_range(MIN_BITRATE_BIT_S, MAX_BITRATE_BIT_S)]
NodeId = Annotated[int, integer_in_range(1, 0x7F)]
CanId = Annotated[int, integer_in_range(1, 0x7FF)]
AmplifierId = Annotated[int, integer_in_range(1, 0x7E)]
"""Node number of a CANopen device. 0x7F is the node number of handctl itself."""
ChannelCount = Annotated[int, integer_in_range(1, 8)]
DecimalDigits = Annotated[int, integer_in_range(0, 6)]
JointDecimation = Annotated[int, integer_in_range(1, 256)]
WatchdogTimeout = Annotated[int, integer_in_range(1, 10_000)]
SchemaNumber = Annotated[int, integer_in_range(1, 1)]
