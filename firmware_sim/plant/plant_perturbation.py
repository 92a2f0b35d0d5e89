"""Perturbation of the plant: factors by which parameters from the hand file are multiplied."""

import math
from dataclasses import replace

from firmware_sim.description.hand_description import (
    Digit,
    Hand,
    MotorSpec,
    SensorSpec,
    SimulatorError,
    TendonSpec,
)

PERTURBATION_KEYS = {
    "stiffness": "tendon stiffness",
    "damping": "damping of tendons, joints and rotors",
    "friction": "capstan friction coefficient of the tendons and Coulomb friction of the motors",
    "mass": "mass and inertia of the links",
    "spring": "stiffness of the return springs",
    "moment_arm": "moment arms of the tendons",
    "motor_inertia": "rotor inertia",
    "torque_constant": "true torque divided by the torque that the drive believes",
    "bias": "newtons added to every load cell (not a factor)",
    "noise": "noise of load cells and joint encoders",
}
"""Parameter that each key of ``--perturb`` multiplies."""


def perturbed_hand(hand: Hand, factors: dict[str, float]) -> Hand:
    """Multiply the parameters of a simulated plant by factors.

    Args:
        hand: description of the hand, as the hand file gives it.
        factors: factors by key of ``PERTURBATION_KEYS``. The value of the key ``bias`` is not a
            factor but an offset of the load cells [N].

    Returns:
        The description of the perturbed hand.

    Raises:
        SimulatorError: a key is unknown, a factor is negative or not finite, or the hand has text
            in place of a number.
    """
    for key, value in factors.items():
        if key not in PERTURBATION_KEYS:
            raise SimulatorError(
                f"--perturb: no such parameter: {key}; expected one of {', '.join(PERTURBATION_KEYS)}"
            )
        if not math.isfinite(value) or (value < 0 and key != "bias"):
            raise SimulatorError(f"--perturb: {key}={value:g}; expected a finite factor, 0 or more")
        if value == 0 and key in ("mass", "motor_inertia"):
            raise SimulatorError(f"--perturb: {key}=0; expected a factor above 0")
    f = {key: factors.get(key, 1.0) for key in PERTURBATION_KEYS}
    try:
        return replace(
            hand,
            digits=[_perturbed_digit(digit, f) for digit in hand.digits],
            tendons=[_perturbed_tendon(tendon, f) for tendon in hand.tendons],
            motors=[_perturbed_motor(motor, f) for motor in hand.motors],
            sensors=_perturbed_sensors(hand.sensors, f["noise"], factors.get("bias", 0.0))
            if hand.sensors
            else None,
        )
    except (ArithmeticError, TypeError) as error:
        raise SimulatorError(f"hand {hand.name}: a value is not a number: {error}") from error


def _scaled_values(values: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return tuple(value * factor for value in values)


def _perturbed_digit(digit: Digit, factors: dict[str, float]) -> Digit:
    return replace(
        digit,
        mass=_scaled_values(digit.mass, factors["mass"]),
        inertia=tuple(_scaled_values(moments, factors["mass"]) for moments in digit.inertia),
        damping=_scaled_values(digit.damping, factors["damping"]),
        spring=_scaled_values(digit.spring, factors["spring"]),
    )


def _perturbed_tendon(tendon: TendonSpec, factors: dict[str, float]) -> TendonSpec:
    return replace(
        tendon,
        arms={joint: arm * factors["moment_arm"] for joint, arm in tendon.arms.items()},
        curves={
            joint: replace(
                curve, coefficients=_scaled_values(curve.coefficients, factors["moment_arm"])
            )
            for joint, curve in tendon.curves.items()
        },
        stiffness=tendon.stiffness * factors["stiffness"],
        damping=tendon.damping * factors["damping"],
        friction=tendon.friction * factors["friction"],
    )


def _perturbed_motor(motor: MotorSpec, factors: dict[str, float]) -> MotorSpec:
    return replace(
        motor,
        inertia=motor.inertia * factors["motor_inertia"],
        viscous=motor.viscous * factors["damping"],
        coulomb=motor.coulomb * factors["friction"],
        torque_gain=factors["torque_constant"],
    )


def _perturbed_sensors(sensors: SensorSpec, noise: float, bias: float) -> SensorSpec:
    return replace(
        sensors,
        tension_noise=sensors.tension_noise * noise,
        joint_noise=sensors.joint_noise * noise,
        travel_noise=sensors.travel_noise * noise,
        tension_bias=bias,
    )
