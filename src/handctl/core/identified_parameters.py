"""Parameters that were identified from runs, and a hand description with these parameters."""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field, field_validator, model_validator

from handctl.core.tick_types import Vector
from handctl.document import Document
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content

TENDON_KEY_BY_PARAMETER = {
    "tendon_stiffness": "stiffness_N_per_m",
    "capstan": "friction_coefficient",
    "pretension": "pretension_N",
}
"""Key in the hand file's tendon table whose value each identified parameter replaces."""
MOTOR_KEY_BY_PARAMETER = {
    "motor_inertia": "inertia_kg_m2",
    "motor_viscous": "viscous_N_m_s_per_rad",
    "motor_coulomb": "coulomb_N_m",
}
"""Key in the hand file's motor table whose value each identified parameter replaces."""
DIGIT_KEY_BY_PARAMETER = {
    "spring_stiffness": "spring_stiffness_N_m_per_rad",
    "spring_preload": "spring_preload_rad",
    "joint_damping": "joint_damping_N_m_s_per_rad",
}
"""Key in the hand file's digit table whose values each identified parameter scales.

The identified parameter is a factor on the values of all joints of the digit.
"""
MOMENT_ARM_LENGTH_KEYS = ("polynomial_m", "arm_m")
"""Keys whose values are lengths, in the hand file's table of a moment arm that depends on the joint angle."""
PARAMETER_UNITS = {
    "torque_gain": "1", "motor_inertia": "kg m2", "motor_viscous": "N m s/rad", "motor_coulomb": "N m", "delay": "s",
    "tendon_stiffness": "N/m", "spring_stiffness": "x file", "spring_preload": "x file", "capstan": "1",
    "joint_damping": "x file", "moment_arm": "x file", "pretension": "N",
}  # fmt: skip
"""Unit of each parameter that can be identified. The unit ``x file`` is a factor on the value of the hand file.

``torque_gain`` is the torque at the spool per commanded torque. ``moment_arm`` is one factor on the
moment arms of a tendon about all its joints.
"""

NEW_NAME_BY_FORMER_NAME = {"rope_stiffness": "tendon_stiffness"}
"""Present name of a renamed parameter, by its name in earlier versions of handctl."""


class IdentifiedParameters(Document):
    """Identified parameters of a tendon, and of the motor and the digit of this tendon."""

    names: tuple[str, ...] = Field(min_length=1)
    """Names of the identified parameters, from ``PARAMETER_UNITS``."""
    values: tuple[float, ...]
    """Identified values, in the units of ``PARAMETER_UNITS``."""
    half_widths: tuple[float, ...]
    """Half widths of the 95 % confidence intervals of the values."""
    covariance: tuple[tuple[float, ...], ...]
    """Covariance of the values in their units. Rows and columns have the order of ``names``."""
    missing: tuple[str, ...] = ()
    """Parameters that the data of the runs cannot identify, each with the reason."""
    log: tuple[str, ...] = ()
    """Logs of the runs from which the values were identified."""
    made: str = ""
    """Date and time of the identification, ISO 8601, UTC."""

    @field_validator("names", mode="before")
    @classmethod
    def _replace_former_names(cls, parameter_names: object) -> object:
        """Replace the parameter names of earlier versions by the present names."""
        return (
            tuple(NEW_NAME_BY_FORMER_NAME.get(name, name) for name in parameter_names)
            if isinstance(parameter_names, list | tuple)
            else parameter_names
        )

    @model_validator(mode="after")
    def _check_shapes(self) -> "IdentifiedParameters":
        n = len(self.names)
        unknown_names = set(self.names) - PARAMETER_UNITS.keys()
        if unknown_names:
            raise ValueError(
                f"names from {', '.join(PARAMETER_UNITS)}, not {', '.join(sorted(unknown_names))}"
            )
        if not n == len(self.values) == len(self.half_widths) == len(self.covariance):
            raise ValueError("one value, half width and row of the covariance for every name")
        if any(len(row) != n for row in self.covariance):
            raise ValueError("a square covariance")
        return self

    def get(self, name: str, default: float) -> float:
        """Return the value of a parameter, or ``default`` if the parameter was not identified."""
        return self.values[self.names.index(name)] if name in self.names else default

    def merge_older_parameters(
        self, older_parameters: "IdentifiedParameters | None"
    ) -> "IdentifiedParameters":
        """Return the parameters of this identification, completed by parameters of an older identification.

        If a run identifies only a few parameters, the other parameters of the older identification
        are kept. Parameters from different runs are assumed to be uncorrelated.
        """
        other_parameters = (
            [i for i, name in enumerate(older_parameters.names) if name not in self.names]
            if older_parameters
            else []
        )
        if older_parameters is None or not other_parameters:
            return self
        n = len(self.names)
        m = len(other_parameters)
        combined_covariance = np.zeros((n + m, n + m))
        combined_covariance[:n, :n] = self.covariance
        combined_covariance[n:, n:] = np.array(older_parameters.covariance)[
            np.ix_(other_parameters, other_parameters)
        ]
        return self.model_copy(
            update={
                "names": self.names + tuple(older_parameters.names[i] for i in other_parameters),
                "values": self.values + tuple(older_parameters.values[i] for i in other_parameters),
                "half_widths": self.half_widths
                + tuple(older_parameters.half_widths[i] for i in other_parameters),
                "covariance": tuple(map(tuple, combined_covariance.tolist())),
                "log": tuple(dict.fromkeys((*self.log, *older_parameters.log))),
            }
        )


def identified_hand(hand: Hand, parameters_by_tendon: dict[str, IdentifiedParameters]) -> Hand:
    """Return a hand description in which identified parameters replace values of the hand file.

    Args:
        hand: description from the hand file.
        parameters_by_tendon: identified parameters of each tendon.

    Raises:
        ConfigError: an identified value is not allowed in a hand file.
    """
    content = copy.deepcopy(hand.content)
    for i, tendon in enumerate(hand.tendon):
        if tendon.name not in parameters_by_tendon:
            continue
        parameters = parameters_by_tendon[tendon.name]
        digit = next(
            d
            for d, name in enumerate(hand.digit_names)
            if _is_in_slice(hand.digit_tendons[name], i)
        )
        _replace_tendon_values(content["tendon"][i], TENDON_KEY_BY_PARAMETER, parameters)
        _scale_moment_arms(content["tendon"][i], parameters.get("moment_arm", 1.0))
        _replace_tendon_values(
            content["motor"][hand.motor_index[i]], MOTOR_KEY_BY_PARAMETER, parameters
        )
        _scale_digit_values(content["digit"][digit], parameters)
    return hand_from_content(content, f"{hand.name} as identified")


def torque_gain(hand: Hand, parameters_by_tendon: dict[str, IdentifiedParameters]) -> Vector:
    """Return the torque gain of each drive (N,).

    The torque gain of a drive is the torque at the spool divided by the commanded torque. If no run
    has identified the torque gain, the torque gain is 1.
    """
    return np.array(
        [
            parameters_by_tendon[t.name].get("torque_gain", 1.0)
            if t.name in parameters_by_tendon
            else 1.0
            for t in hand.tendon
        ]
    )


def check_identified(
    hand: Hand, parameters_by_tendon: dict[str, IdentifiedParameters], source: str
) -> None:
    """Check that the hand has every tendon that is named in the identified parameters.

    Raises:
        ConfigError: a tendon is unknown, or a torque gain is out of bounds.
    """
    for name, parameters in parameters_by_tendon.items():
        if name not in hand.tendon_names:
            raise ConfigError(
                "no such tendon", f"{source}: identified.{name}", ", ".join(hand.tendon_names)
            )
        if not 0.2 <= parameters.get("torque_gain", 1.0) <= 5.0:
            expected = "from 0.2 to 5"
            raise ConfigError(
                f"{parameters.get('torque_gain', 1.0):g}",
                f"{source}: identified.{name}.torque_gain",
                expected,
            )


def _is_in_slice(indices: slice, i: int) -> bool:
    return bool(indices.start <= i < indices.stop)


def _replace_tendon_values(
    tendon_table: dict[str, object],
    key_by_parameter: dict[str, str],
    known_parameters: IdentifiedParameters,
) -> None:
    for name, key in key_by_parameter.items():
        if name in known_parameters.names:
            tendon_table[key] = known_parameters.get(name, 0.0)


def _scale_moment_arms(tendon: dict[str, Any], factor: float) -> None:
    """Multiply the moment arms of a tendon by a factor.

    The moment arms can be numbers, polynomials, or tables of angles and moment arms.
    """
    if factor == 1.0:
        return
    for joint, ratio in tendon.get("excursion_ratio", {}).items():
        tendon["excursion_ratio"][joint] = factor * ratio
    for joint, arm in tendon["moment_arm_m"].items():
        if isinstance(arm, Mapping):
            lengths = {
                key: tuple(factor * value for value in arm[key])
                for key in MOMENT_ARM_LENGTH_KEYS
                if key in arm
            }
            tendon["moment_arm_m"][joint] = {**arm, **lengths}
        else:
            tendon["moment_arm_m"][joint] = factor * arm


def _scale_digit_values(
    digit_table: dict[str, tuple[float, ...]], known_parameters: IdentifiedParameters
) -> None:
    for name, key in DIGIT_KEY_BY_PARAMETER.items():
        factor = known_parameters.get(name, 1.0)
        digit_table[key] = tuple(value * factor for value in digit_table[key])
