"""The rigid-body engine of the plant.

In the package ``plant``, only this module and the camera use MuJoCo.
"""

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped,unused-ignore]
import numpy as np

from firmware_sim.plant.mjcf import MAX_CONTACTS

_POSE_WITHOUT_OBJECT = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""Pose of the object in a scene without an object."""


class RigidBodyEngine:
    """The rigid bodies of the hand and the scene, with joints, springs, stops and contacts.

    All attributes that are arrays refer to MuJoCo's own memory.

    Attributes:
        step: function that advances MuJoCo by one time step.
        native: addresses of MuJoCo's step function and of its two arguments, for compiled code.
            None if compiled code cannot call the step function.
        q: joint angles [rad].
        dq: joint velocities [rad/s].
        applied: torques that tendons apply to the joints [N m].
        tendon_damping: damping of each tendon [N s/m].
        sensed: values of all sensors of the model.
    """

    def __init__(self, xml: str, joint_count: int) -> None:
        """Build the engine from a MuJoCo model.

        Args:
            xml: MuJoCo model of the hand and the scene, as MJCF text.
            joint_count: number of the hand's joints. The joints of the hand are the first degrees
                of freedom of the model.
        """
        self._model: Any = mujoco.MjModel.from_xml_string(xml)
        self._data: Any = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        model = self._model
        data = self._data
        n = joint_count
        self.step: Callable[[], None] = lambda: mujoco.mj_step(model, data)
        self.native = _mj_step_addresses(model, data)
        # The arrays below refer to MuJoCo's own memory, and are valid as long as the data object
        # exists.
        self.q: Any = data.qpos[:n]
        self.dq: Any = data.qvel[:n]
        self.applied: Any = data.qfrc_applied[:n]
        self.tendon_damping: Any = model.tendon_damping
        self.sensed: Any = data.sensordata
        self._object: Any = data.qpos[n : n + 7]
        self._object_velocity: Any = data.qvel[n : n + 6]
        self._table: Any = data.mocap_pos

    @property
    def has_object(self) -> bool:
        """Return True if the scene has an object."""
        return len(self._object) == 7

    def object_pose(self) -> list[float]:
        """Return the pose of the object: position x, y, z [m] and quaternion qw, qx, qy, qz.

        Without an object, the pose is the origin.
        """
        pose: list[float] = self.object_pose_array.tolist()
        return pose

    @property
    def object_pose_array(self) -> Any:
        """Return ``object_pose`` as an array, which can be MuJoCo's own memory."""
        return self._object if self.has_object else _POSE_WITHOUT_OBJECT

    def copy_pose(self, data: Any) -> None:
        """Copy the positions of all bodies into the data of another model of the same hand and scene."""
        data.qpos[:] = self._data.qpos
        data.mocap_pos[:] = self._data.mocap_pos

    def object_speed(self) -> float:
        """Return the speed of the centre of the object [m/s]. If there is no object, return 0."""
        if not self.has_object:
            return 0.0
        velocity = self._object_velocity[:3]
        return math.sqrt(velocity.dot(velocity))

    def make_force_reader(self, sensor_kind: str, digits: list[str]) -> Callable[[], list[float]]:
        """Build a function that returns the contact forces on the digits [N].

        Args:
            sensor_kind: ``grip`` for the forces of the object only, or ``contact`` for the forces
                of all bodies.
            digits: names of the digits.

        Returns:
            Function without arguments. The function returns the force on each digit in the palm
            frame: x, y, z of the first digit, then of the next digit.
        """
        index = self.force_components(sensor_kind, digits)
        data = self._data.sensordata
        # The sensor measures the force that the first body (the digit) exerts on the second body.
        # The code therefore changes the sign of the measured force, to get the force on the digit.
        return lambda: (-data[index]).tolist()  # type: ignore[no-any-return,unused-ignore]

    def force_components(self, sensor_kind: str, digits: list[str]) -> Any:
        """Return the index in ``sensed`` of each component of the forces on the digits, shape (3 digits,).

        The forces in ``sensed`` have the opposite sign of the forces on the digits. See
        ``make_force_reader``.
        """
        return np.array(
            [
                address + axis
                for address in self.force_indices(sensor_kind, digits)
                for axis in range(3)
            ]
        )

    def force_indices(self, sensor_kind: str, digits: list[str]) -> list[int]:
        """Return, for each digit, the index in ``sensed`` of the first component of its force.

        The forces in ``sensed`` have the opposite sign of the forces on the digits. See
        ``make_force_reader``.
        """
        return [self._first_value_index(f"{sensor_kind}/{digit}") for digit in digits]

    def normal_forces(self, digits: list[str]) -> Callable[[], list[float]]:
        """Build a function that returns the normal force between each digit and the object [N].

        The normal force of a digit is the sum over all contacts of the digit with the object.
        """
        first_sensor_indices = [self._first_value_index(f"normal/{digit}") for digit in digits]
        index = np.array(
            [
                [address + 3 * contact for contact in range(MAX_CONTACTS)]
                for address in first_sensor_indices
            ]
        )
        data = self._data.sensordata
        return lambda: np.abs(data[index]).sum(axis=1).tolist()  # type: ignore[no-any-return,unused-ignore]

    def _first_value_index(self, sensor_name: str) -> int:
        """Return the index in ``sensed`` of the first value of a sensor."""
        return int(self._model.sensor_adr[self._model.sensor(sensor_name).id])

    def set_timestep(self, step_s: float) -> None:
        """Set the length of the following time steps [s]."""
        self._model.opt.timestep = step_s

    def brake(self, joints: list[int], damping: float) -> Callable[[], None]:
        """Brake the given joints by a high damping [N m s/rad].

        Returns:
            Function that restores the damping that the joints had before.
        """
        damping_before = self._model.dof_damping[joints].copy()
        self._model.dof_damping[joints] = damping

        def release() -> None:
            self._model.dof_damping[joints] = damping_before

        return release

    def overlaps(self) -> dict[str, float]:
        """Return the depth by which the object overlaps each body that it touches [m].

        The keys of the returned dictionary are the names of the bodies. The dictionary does not
        contain the overlap of the object with the table.
        """
        model = self._model
        depths: dict[str, float] = {}
        for contact in self._data.contact:
            names = [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
            if "object" in names and "table" not in names:
                # In the MuJoCo model, the palm is a part of the world body.
                name = names[1 - names.index("object")].replace("world", "palm")
                depths[name] = max(depths.get(name, 0.0), -float(contact.dist))
        return depths

    def lower_table(self, distance: float, direction: tuple[float, float, float]) -> None:
        """Move the table of the scene by a distance [m] in the direction of a unit vector."""
        for axis, component in enumerate(direction):
            self._table[0, axis] += component * distance

    def set_joints(self, q: list[float], dq: list[float]) -> None:
        """Set the joint angles and joint velocities of the hand.

        Args:
            q: joint angles, shape (joints,) [rad].
            dq: joint velocities, shape (joints,) [rad/s].
        """
        self.q[:] = q
        self.dq[:] = dq
        mujoco.mj_forward(self._model, self._data)

    def push_object(self, force: list[float]) -> None:
        """Apply a constant force (x, y, z in the palm frame) to the centre of the object [N]."""
        self._data.xfrc_applied[self._model.body("object").id, :3] = force

    def set_friction(self, coefficient: float) -> None:
        """Set the sliding friction coefficient of all shapes."""
        self._model.geom_friction[:, 0] = coefficient

    def energy(self) -> float:
        """Return the sum of the kinetic and the potential energy of links, springs and object [J]."""
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        return float(self._data.energy.sum())

    def set_gravity(self, gravity: tuple[float, float, float]) -> None:
        """Set the acceleration of gravity in the palm frame [m/s2]."""
        self._model.opt.gravity[:] = gravity


def _mj_step_addresses(model: Any, data: Any) -> tuple[int, int, int] | None:
    """Return the addresses of MuJoCo's function ``mj_step``, of the model, and of the data.

    If compiled code calls the function by its address, an error inside MuJoCo ends the process.
    MuJoCo reports few errors, and reports no error if the plant diverges.
    """
    library = next(Path(mujoco.__file__).parent.glob("libmujoco*"), None)
    if library is None:
        return None
    step = ctypes.cast(ctypes.CDLL(str(library)).mj_step, ctypes.c_void_p).value
    return (step, model._address, data._address) if step else None
