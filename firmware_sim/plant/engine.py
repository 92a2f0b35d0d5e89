"""MuJoCo, met in this module only; the rest of the simulator sees lists of floats."""

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped,unused-ignore]
import numpy as np

from firmware_sim.plant.mjcf import CONTACTS


class Engine:
    """Rigid bodies, joints, springs, stops and contact.

    Attributes:
        step: advance by one step.
        native: addresses of MuJoCo's step and of its two arguments, for compiled code; None if there are none.
        q, dq: angles [rad] and velocities [rad/s] of the joints. applied: torques on them [N m].
        rope_damping: of each tendon [N s/m]. sensed: values of all sensors. All five are MuJoCo's own memory.
    """

    def __init__(self, xml: str, joint_count: int) -> None:
        """Args: the model; how many of its first degrees of freedom are the hand's."""
        self._model: Any = mujoco.MjModel.from_xml_string(xml)
        self._data: Any = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        model, data, n = self._model, self._data, joint_count
        self.step: Callable[[], None] = lambda: mujoco.mj_step(model, data)
        self.native = _native(model, data)
        # views into MuJoCo's own memory: they stay valid for the life of the data
        self.q: Any = data.qpos[:n]
        self.dq: Any = data.qvel[:n]
        self.applied: Any = data.qfrc_applied[:n]
        self.rope_damping: Any = model.tendon_damping
        self.sensed: Any = data.sensordata
        self._object: Any = data.qpos[n : n + 7]
        self._object_velocity: Any = data.qvel[n : n + 6]
        self._table: Any = data.mocap_pos

    @property
    def has_object(self) -> bool:
        """Whether the scene has an object."""
        return len(self._object) == 7

    def object_pose(self) -> list[float]:
        """Return x, y, z [m] and qw, qx, qy, qz of the object; of the origin if there is none."""
        return self._object.tolist() if self.has_object else [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]

    def object_speed(self) -> float:
        """Return the speed of the object's centre [m/s]; 0 if there is none."""
        return float(np.linalg.norm(self._object_velocity[:3])) if self.has_object else 0.0

    def forces_on(self, kind: str, digits: list[str]) -> Callable[[], list[float]]:
        """Return a function that gives x, y, z of the contact force on each digit in the palm frame [N], as one list.

        Args:
            kind: ``grip`` (of the object) or ``contact`` (of anything).
            digits: names.
        """
        index = np.array([address + axis for address in self.force_places(kind, digits) for axis in range(3)])
        data = self._data.sensordata
        # the sensor gives the force of the first body on the second
        return lambda: (-data[index]).tolist()  # type: ignore[no-any-return,unused-ignore]

    def force_places(self, kind: str, digits: list[str]) -> list[int]:
        """Return where in ``sensed`` the force of each digit begins, with the opposite sign; see ``forces_on``."""
        return [self._sensor(f"{kind}/{digit}") for digit in digits]

    def normal_forces(self, digits: list[str]) -> Callable[[], list[float]]:
        """Return a function that gives the sum of the normal forces between each digit and the object [N]."""
        first = [self._sensor(f"normal/{digit}") for digit in digits]
        index = np.array([[address + 3 * contact for contact in range(CONTACTS)] for address in first])
        data = self._data.sensordata
        return lambda: np.abs(data[index]).sum(axis=1).tolist()  # type: ignore[no-any-return,unused-ignore]

    def _sensor(self, name: str) -> int:
        return int(self._model.sensor_adr[self._model.sensor(name).id])

    def set_timestep(self, step_s: float) -> None:
        """Change the length of the next steps [s]."""
        self._model.opt.timestep = step_s

    def brake(self, joints: list[int], damping: float) -> Callable[[], None]:
        """Damp joints so much [N m s/rad] that they stand; returns what lets them go."""
        before = self._model.dof_damping[joints].copy()
        self._model.dof_damping[joints] = damping

        def let_go() -> None:
            self._model.dof_damping[joints] = before

        return let_go

    def lower_table(self, distance: float) -> None:
        """Move the table down [m]."""
        self._table[0, 2] -= distance

    def set_joints(self, q: list[float], dq: list[float]) -> None:
        """Put the hand into a state: shapes (joints,) [rad] and [rad/s]."""
        self.q[:], self.dq[:] = q, dq
        mujoco.mj_forward(self._model, self._data)

    def push_object(self, force: list[float]) -> None:
        """Apply a constant force at the object's centre, x, y, z in the palm frame [N]."""
        self._data.xfrc_applied[self._model.body("object").id, :3] = force

    def set_friction(self, coefficient: float) -> None:
        """Change the sliding coefficient of everything."""
        self._model.geom_friction[:, 0] = coefficient

    def energy(self) -> float:
        """Return kinetic and potential energy of links, springs and object [J]."""
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        return float(self._data.energy.sum())

    def set_gravity(self, gravity: tuple[float, float, float]) -> None:
        """Change gravity in the palm frame [m/s2]."""
        self._model.opt.gravity[:] = gravity


def _native(model: Any, data: Any) -> tuple[int, int, int] | None:
    """Return the addresses of ``mj_step`` in the library that the bindings use, and of the model and the data.

    An error of MuJoCo's own (it reports few, and none of a plant that diverges) ends the process when it is called so.
    """
    library = next(Path(mujoco.__file__).parent.glob("libmujoco*"), None)
    if library is None:
        return None
    step = ctypes.cast(ctypes.CDLL(str(library)).mj_step, ctypes.c_void_p).value
    return (step, model._address, data._address) if step else None
