"""Compute the error of a reference filter that is optimal for a fixed noise model.

The error of the reference filter is not a lower bound. A filter that is made for a hand with less
noise, or that has more inputs, can have a smaller error.

The filter has seven states per tendon: travel and speed at the spool, excursion and excursion rate
at the joints, two disturbance forces, and the stretch offset. One disturbance force acts on the
motor, and the other on the joint. Both disturbance forces and the stretch offset are Gauss-Markov
processes. The filter measures the tension by the load cell, and the travel at the spool by the
motor encoder. Constants of this module describe the disturbances. The filter is computed either for
a digit that moves freely against its springs, or for a digit that presses on a stiff object.
``scipy`` computes the reference filter, independently of the filter design in the controller.
"""

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from handctl.core.hand_model import HandModel

MOTOR_NOISE_N_M = 10e-3
MOTOR_CORRELATION_TIME_S = 0.05
JOINT_NOISE_N_M = 5e-3
JOINT_CORRELATION_TIME_S = 0.02
STRETCH_OFFSET_SIGMA_M = 0.2e-3
OFFSET_CORRELATION_TIME_S = 60.0
CONTACT_STIFFNESS_N_M_PER_RAD = 40.0
"""Stiffness with which a held object resists the motion of each joint of a digit [N m/rad].

Source of all constants in this module: MODEL, section 5.
"""
CELL_DRIFT_VARIANCE_N2_PER_S = 1.0 / 100.0
"""Variance rate of the load-cell drift, which is a random walk of 1 N in 100 s.

No filter can observe the drift of a taut tendon's load cell.
"""
STATE_SCALE = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1.0, 1.0, 1e-5])


def reference_sigma(
    model: HandModel, tendon_index: int, is_digit_held: bool, uses_motor_encoder: bool = True
) -> tuple[float, float]:
    """Return the standard deviation of the tension of a tendon at two times [N].

    The first result is the standard deviation of the tension at the time of the last load-cell
    reading. The second result is the standard deviation of the present tension. The controller
    estimates the present tension, one control period after the load-cell reading. The benchmark
    compares the error of the controller's estimate with both standard deviations.

    Args:
        model: hand and control rate.
        tendon_index: index of the tendon.
        is_digit_held: True if the digit presses on an object.
        uses_motor_encoder: True if the filter uses both the encoder of the motor and the load cell. False if
            the filter uses only the load cell.
    """
    tendon_constants = model.tendon_constants
    arm = float(np.abs(model.hand.moment_arms[tendon_index]).sum())
    spring = (
        CONTACT_STIFFNESS_N_M_PER_RAD / arm**2
        if is_digit_held
        else tendon_constants.load_stiffness[tendon_index]
    )
    k = tendon_constants.stiffness[tendon_index]
    c = tendon_constants.damping[tendon_index]
    m = tendon_constants.motor_mass[tendon_index]
    load = tendon_constants.load_mass[tendon_index]
    tension = np.array([k, c, -k, -c, 0.0, 0.0, -k])
    A = np.zeros((7, 7))
    A[0, 1] = A[2, 3] = 1.0
    A[1] = -tension / m
    A[1, 1] -= tendon_constants.motor_damping[tendon_index] / m
    A[1, 4] = 1.0 / m
    A[3] = tension / load
    A[3, 2] -= spring / load
    A[3, 3] -= tendon_constants.load_damping[tendon_index] / load
    A[3, 5] = 1.0 / load
    A[4, 4] = -1.0 / MOTOR_CORRELATION_TIME_S
    A[5, 5] = -1.0 / JOINT_CORRELATION_TIME_S
    A[6, 6] = -1.0 / OFFSET_CORRELATION_TIME_S
    sigma = (
        MOTOR_NOISE_N_M / tendon_constants.spool_radius[tendon_index],
        JOINT_NOISE_N_M / arm,
        STRETCH_OFFSET_SIGMA_M,
    )
    noise = [0.0] * 4 + [
        2.0 * s**2 / t
        for s, t in zip(
            sigma,
            (MOTOR_CORRELATION_TIME_S, JOINT_CORRELATION_TIME_S, OFFSET_CORRELATION_TIME_S),
            strict=True,
        )
    ]
    A = A * STATE_SCALE / STATE_SCALE[:, None]
    Q = np.diag(noise) / np.outer(STATE_SCALE, STATE_SCALE)
    van_loan_matrix = expm(np.block([[-A, Q], [np.zeros((7, 7)), A.T]]) * model.period)
    F = van_loan_matrix[7:, 7:].T
    H = np.vstack((np.eye(7)[0], tension)) * STATE_SCALE
    R = np.diag(
        [
            (tendon_constants.encoder_step[tendon_index] / np.sqrt(6.0)) ** 2,
            tendon_constants.tension_noise[tendon_index] ** 2,
        ]
    )
    rows = [0, 1] if uses_motor_encoder else [1]
    measurement_sigma = np.sqrt(np.diag(R)[rows])
    P = solve_discrete_are(
        F.T,
        (H[rows] / measurement_sigma[:, None]).T,
        F @ van_loan_matrix[:7, 7:],
        np.eye(len(rows)),
    )
    measurement_rows = H[rows] / measurement_sigma[:, None]
    row = tension * STATE_SCALE
    gain = (
        P
        @ measurement_rows.T
        @ np.linalg.inv(measurement_rows @ P @ measurement_rows.T + np.eye(len(rows)))
    )
    return float(np.sqrt(row @ (P - gain @ measurement_rows @ P) @ row)), float(
        np.sqrt(row @ P @ row)
    )
