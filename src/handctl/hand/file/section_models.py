"""Sections of a hand file as frozen pydantic models. Keys carry their units."""

import math
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from handctl.hand.file import mesh_value_types as mesh
from handctl.hand.file import quantity_types as qty
from handctl.hand.file.display_units import DisplayUnits


class Section(BaseModel):
    """Base class of all tables of a hand file. A table is immutable and accepts no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy of the section with the given fields replaced.

        pydantic also copies the cached properties, which belong to the old fields. This method
        deletes the cached properties in the copy, so that the copy computes new ones.
        """
        section_copy = super().model_copy(update=update, deep=deep)
        for name in section_copy.__dict__.keys() - type(self).model_fields.keys():
            del section_copy.__dict__[name]
        return section_copy


class Mount(Section):
    """Orientation of the palm in the world, and its mesh."""

    gravity_m_s2: tuple[qty.Gravity, qty.Gravity, qty.Gravity]
    """Gravitational acceleration in the palm frame: x out of the palm, y from thumb to fingers, z along the hinges."""
    palm_mesh: mesh.MeshFile | None = None
    """Mesh that viewers show as the palm, see ``link_mesh``. If absent, they show a box."""
    palm_mesh_scale: mesh.MeshScale | None = None
    """Factor from the unit of the mesh to metres, or factors for x, y, z.

    It is 1 if absent. A mesh in millimetres needs 0.001.
    """
    palm_mesh_position_m: tuple[mesh.MeshPosition, mesh.MeshPosition, mesh.MeshPosition] | None = (
        None
    )
    """Position of the mesh's origin in the palm frame. It is [0, 0, 0] if absent."""
    palm_mesh_rpy_deg: tuple[qty.MountAngle, qty.MountAngle, qty.MountAngle] | None = None
    """Orientation of the mesh in the palm frame, as in ``mount_rpy_deg``.

    It is [0, 0, 0] if absent.
    """


class Bus(Section):
    """CAN bus.

    The interface of the bus, for example can0, is named on the command line, and not in the file.
    """

    name: qty.Name
    """Name of the bus."""
    bitrate: qty.Bitrate
    """Bit rate of a classical bus, or of the arbitration phase of CAN FD [bit/s]."""
    data_bitrate: qty.Bitrate | None = None
    """Bit rate of the data phase of CAN FD. It is absent for a classical bus."""


HANDCTL_PROTOCOL = "handctl"
"""Protocol of the sensor node that handctl itself defines, see sensor_node.dbc."""
CIA404_PROTOCOL = "cia404"
"""Protocol of CANopen measuring amplifiers according to CiA 404."""
HANDCTL_NODE_KEYS = ("base_id", "joint_decimation", "joint_noise_rad", "joints")
"""Keys of ``SensorNode`` that only the protocol ``handctl`` has."""
CIA404_KEYS = ("node_ids", "channels_per_node", "range_N", "process_value", "decimal_digits")
"""Keys of ``SensorNode`` that only the protocol ``cia404`` has."""
TPDO_IDS = (0x180, 0x280, 0x380, 0x480)
"""Identifiers of TPDO 1 to 4.

The identifier of a device's TPDO is a number of ``TPDO_IDS`` plus the node number of the device.
Source: CiA 301, predefined connection set.
"""
CHANNELS_PER_TPDO = 2
"""Number of channels in a TPDO: 8 bytes hold two values of 32 bits."""


class SensorNode(Section):
    """Load cells that measure the tension of tendons between spool and first pulley, and joint encoders."""

    protocol: qty.SensorProtocol = HANDCTL_PROTOCOL
    """``handctl``: one node with load cells and joint encoders.

    ``cia404``: CANopen measuring amplifiers.
    """
    bus: qty.Name
    """Bus of the sensor node."""
    sync_id: qty.CanId = 0x080
    """CAN identifier of SYNC, required.

    The frame has one byte with the tick counter. CiA 404: the frame is empty, and the key is absent
    or 0x080.
    """
    base_id: qty.CanId = 0x1A0
    """CAN identifier of the first tension frame, required.

    Joint frames begin at ``base_id + 0x10``. CiA 404: the key is absent.

    A frame has five channels.
    """
    tendons: tuple[qty.Name, ...]
    """Tendon of each load cell, in the order of the channels.

    In schema 2, ``"all"`` stands for all tendons.
    """
    joints: tuple[qty.Name, ...] = ()
    """Joint of each encoder, in the order of the channels. If absent, there are no encoders.

    In schema 2, ``"all"`` stands for all joints. CiA 404: the key is absent.
    """
    joint_decimation: qty.JointDecimation = 1
    """Number of ticks from one frame of the joint encoders to the next, required with ``joints``.

    CiA 404: the key is absent.
    """
    tension_noise_N: qty.Force
    """Standard deviation of a load-cell sample."""
    tension_bias_drift_N: qty.Force
    """Standard deviation of the drift of a load cell after 100 s.

    The drift is modelled as a random walk.
    """
    joint_noise_rad: qty.JointNoise = 1e-3
    """Standard deviation of a joint-encoder sample, required with ``joints``.

    CiA 404: the key is absent.
    """
    joint_noise_m: qty.TravelNoise | None = None
    """Standard deviation of a joint-encoder sample of a prismatic joint, 1e-5 m if absent."""
    node_ids: tuple[qty.AmplifierId, ...] = ()
    """CiA 404: node number of each amplifier, required."""
    channels_per_node: qty.ChannelCount = 1
    """CiA 404: channels of an amplifier, 1 by default.

    The first amplifier has the first load cells of ``tendons``.
    """
    range_N: qty.PositiveForce | None = None
    """CiA 404: rated load of the load cells, required.

    A reading of this size, of either sign, is saturated (T06).
    """
    process_value: qty.ProcessValue = "int32"
    """CiA 404: ``int32`` (default) for object 0x9130, ``real32`` for object 0x6130."""
    decimal_digits: qty.DecimalDigits = 3
    """CiA 404, ``int32``: a count is 10^-digits newton (object 0x6132), 3 digits by default."""

    @property
    def is_cia404(self) -> bool:
        """Return True if CANopen amplifiers of the profile CiA 404 measure the tensions."""
        return self.protocol == CIA404_PROTOCOL

    @property
    def amplifier_channels(self) -> tuple[int, ...]:
        """Return, for each CiA 404 amplifier, the number of channels to which a load cell is connected."""
        size = self.channels_per_node
        return tuple(
            min(max(len(self.tendons) - size * i, 0), size)
            for i in range(len(self.node_ids) if self.is_cia404 else 0)
        )

    @property
    def tension_ids(self) -> tuple[int, ...]:
        """Return the CAN identifiers of the tension frames."""
        if self.is_cia404:
            return tuple(
                base + node_id
                for node_id, channels in zip(self.node_ids, self.amplifier_channels, strict=True)
                for base in TPDO_IDS[: math.ceil(channels / CHANNELS_PER_TPDO)]
            )
        return tuple(
            self.base_id + group
            for group in range(math.ceil(len(self.tendons) / CHANNELS_PER_FRAME))
        )

    @property
    def joint_ids(self) -> tuple[int, ...]:
        """Return the CAN identifiers of the joint frames."""
        groups = math.ceil(len(self.joints) / CHANNELS_PER_FRAME)
        return tuple(self.base_id + JOINT_FRAME_OFFSET + group for group in range(groups))


CHANNELS_PER_FRAME = 5
"""Number of channels in a frame: 8 bytes hold a counter of 4 bits and five channels of 12 bits.

Source: sensor_node.dbc.
"""
JOINT_FRAME_OFFSET = 0x10
"""Identifier of the first joint frame minus the identifier of the first tension frame.

Source: sensor_node.dbc.
"""


class StreamLimits(Section):
    """Limits of targets that a client streams to the hand."""

    speed_deg_s: qty.JointSpeed = 300.0
    """Largest joint speed.

    With faster random targets, digits hit each other until a tendon is slack.
    """
    acceleration_deg_s2: qty.JointAcceleration = 2_500.0
    """Largest joint acceleration. For comparison, a sine of 1 Hz and 20 degrees has 790 deg/s2."""
    tension_rate_N_per_s: qty.TensionRate = 1000.0
    """Largest rate of a streamed tension.

    For comparison, a grasp increases its tension by 300 N/s after a slip.
    """
    hold_after_ms: qty.StaleTime = 100.0
    """Age of the latest target after which the hand holds."""
    relax_after_ms: qty.StaleTime = 1000.0
    """Age of the latest target after which the hand relaxes."""


MAX_LINKS = 8
"""Largest number of links of a digit."""
SPRING_KEYS = ("spring_stiffness_N_m_per_rad", "spring_preload_rad")
"""Keys of the return springs of a digit. A digit without springs has neither of the two keys."""
PRISMATIC_SPRING_KEYS = ("spring_stiffness_N_per_m", "spring_preload_m")
"""Keys of the return springs of prismatic joints. A digit without springs at these joints has neither key."""
REVOLUTE_KEYS = (
    "joint_min_deg",
    "joint_max_deg",
    "joint_damping_N_m_s_per_rad",
    "joint_armature_kg_m2",
    *SPRING_KEYS,
)
"""Keys of a digit with a value per revolute joint."""
PRISMATIC_KEYS = (
    "joint_min_m",
    "joint_max_m",
    "joint_damping_N_s_per_m",
    "joint_armature_kg",
    *PRISMATIC_SPRING_KEYS,
)
"""Keys of a digit with a value per prismatic joint, in the order of the keys for revolute joints."""
PRISMATIC = "prismatic"
"""Name of the joint type whose link slides along the axis of the joint."""
DEFAULT_JOINT_NOISE_M = 1e-5
"""Standard deviation of a prismatic joint's encoder sample, if the hand file does not contain it [m]."""
Z_AXIS = (0.0, 0.0, 1.0)
"""Axis of a revolute joint in a digit without the key ``joint_axis``."""
Y_AXIS = (0.0, 1.0, 0.0)
"""Axis of a prismatic joint in a digit without the key ``joint_axis``. A positive position closes the digit."""


class Digit(Section):
    """Finger or thumb: a chain of links.

    Each link has a joint at its start. The frame of a link has its origin in the link's joint, and
    its x axis is along the link. Without ``joint_axis`` and ``joint_rpy_deg``, all hinges are along
    z. A positive angle flexes towards y. A prismatic joint (``joint_type``) moves its link along
    the joint's axis.

    Keys in degrees or radians, such as ``joint_max_deg``, have one value per revolute joint. Keys in
    metres, such as ``joint_max_m``, have one value per prismatic joint.
    """

    name: qty.Name
    """Name of the digit. Its joints are ``NAME_j1`` and so on, from the palm outwards."""
    mount_position_m: tuple[qty.Position, qty.Position, qty.Position]
    """Position of the first joint in the palm frame: x out of the palm, y from thumb to fingers."""
    mount_on: qty.Name | None = None
    """Digit whose last link carries this digit, such as a wrist.

    The key is absent if the palm carries the digit.

    ``mount_position_m`` and ``mount_rpy_deg`` are then in the frame of that link.
    """
    mount_rpy_deg: tuple[qty.MountAngle, qty.MountAngle, qty.MountAngle]
    """Roll, pitch, yaw about the fixed axes of the palm: Rz(yaw) Ry(pitch) Rx(roll)."""
    link_length_m: tuple[qty.Length, ...] = Field(min_length=1, max_length=MAX_LINKS)
    """Distance from the joint of a link to the next joint, or to the tip.

    It is 0 if the axes of the two joints meet.
    """
    joint_type: tuple[qty.JointType, ...] | None = None
    """Type of each joint, ``revolute`` or ``prismatic``. If absent, all joints are revolute."""
    joint_axis: (
        tuple[tuple[qty.DirectionComponent, qty.DirectionComponent, qty.DirectionComponent], ...]
        | None
    ) = None
    """Axis of each joint, as a unit vector in the frame of its link.

    If absent, all hinges are along z, [0, 0, 1], and all prismatic joints along y, [0, 1, 0]. The
    link of a prismatic joint moves along the axis for a positive position.
    """
    joint_rpy_deg: tuple[tuple[qty.MountAngle, qty.MountAngle, qty.MountAngle], ...] | None = None
    """Orientation of the frame of each link in the frame before, at angle zero, as in ``mount_rpy_deg``.

    The frame before the first link is that of the mount. If absent, all frames have the same
    orientation.
    """
    link_com_m: tuple[qty.CentreOfMass, ...]
    """Centre of mass in the link's frame: a distance along the link, or x, y, z."""
    link_mass_kg: tuple[qty.Mass, ...]
    """Mass of each link."""
    link_inertia_kg_m2: tuple[qty.LinkInertia, ...]
    """Inertia about the centre of mass: a number, [xx, yy, zz], or [xx, yy, zz, xy, xz, yz].

    A number is the inertia of a round bar about y and z. The inertia about x is that of a bar with
    the radius of the link.
    """
    link_radius_m: qty.Radius
    """Radius of the links, whose shapes are capsules."""
    joint_min_deg: tuple[qty.JointAngle, ...]
    """Open stop of each revolute joint."""
    joint_max_deg: tuple[qty.JointAngle, ...]
    """Closed stop of each revolute joint."""
    joint_damping_N_m_s_per_rad: tuple[qty.Damping, ...]
    """Viscous damping of each revolute joint."""
    joint_armature_kg_m2: tuple[qty.Armature, ...]
    """Inertia of each revolute joint itself, for example of pulley and pin."""
    spring_stiffness_N_m_per_rad: tuple[qty.SpringStiffness, ...]
    """Stiffness k of the return spring of each revolute joint."""
    spring_preload_rad: tuple[qty.SpringPreload, ...]
    """Spring torque is k (q + preload), against flexion."""
    joint_min_m: tuple[qty.JointTravel, ...] = ()
    """Open stop of each prismatic joint, required for such joints."""
    joint_max_m: tuple[qty.JointTravel, ...] = ()
    """Closed stop of each prismatic joint, required for such joints."""
    joint_damping_N_s_per_m: tuple[qty.TravelDamping, ...] = ()
    """Viscous damping of each prismatic joint, required for such joints."""
    joint_armature_kg: tuple[qty.TravelArmature, ...] = ()
    """Inertia of each prismatic joint itself, for example of pulleys, required for such joints."""
    spring_stiffness_N_per_m: tuple[qty.TravelStiffness, ...] = ()
    """Stiffness k of the return spring of each prismatic joint. Without springs the key is absent."""
    spring_preload_m: tuple[qty.TravelPreload, ...] = ()
    """Spring force is k (q + preload), against a positive motion. Without springs the key is absent."""
    coupling: tuple[tuple[qty.Coupling, ...], ...] | None = None
    """Matrix B of q = B theta, with a row for each joint, for a digit with fewer tendons than joints.

    If absent, the joints are independent. A coordinate theta moves joints of one type.
    """
    joint_rated_torque_N_m: tuple[qty.PositiveTorque, ...] | None = None
    """Largest torque that each revolute joint with its pin and links withstands.

    The key is absent if it is unknown.
    """
    joint_rated_force_N: tuple[qty.PositiveForce, ...] | None = None
    """Largest force along its axis that each prismatic joint withstands.

    The key is absent if it is unknown.
    """
    link_mesh: tuple[mesh.MeshFile, ...] | None = None
    """Mesh file that viewers show as each link, binary STL or OBJ, relative to the hand file.

    ``""`` stands for a capsule.

    Meshes have neither mass nor contacts. If the key is absent, all links are shown as capsules.
    """
    link_mesh_scale: tuple[mesh.MeshScale, ...] | None = None
    """Factor from the unit of each mesh to metres, or factors for x, y, z.

    It is 1 if absent. Meshes in millimetres need 0.001.
    """
    link_mesh_position_m: (
        tuple[tuple[mesh.MeshPosition, mesh.MeshPosition, mesh.MeshPosition], ...] | None
    ) = None
    """Position of the origin of each mesh in the frame of its link. It is [0, 0, 0] if absent."""
    link_mesh_rpy_deg: tuple[tuple[qty.MountAngle, qty.MountAngle, qty.MountAngle], ...] | None = (
        None
    )
    """Orientation of each mesh in the frame of its link, as in ``mount_rpy_deg``.

    It is [0, 0, 0] if absent.
    """

    @model_validator(mode="before")
    @classmethod
    def _add_default_springs(cls, section_content: Any) -> Any:
        """Add return springs with stiffness 0 to a digit without springs.

        A digit without springs is opened by antagonistic tendons. A digit without revolute joints
        needs no key of revolute joints.
        """
        if not isinstance(section_content, dict):
            return section_content
        links = section_content.get("link_length_m")
        types = section_content.get("joint_type")
        count = len(links) if isinstance(links, list | tuple) else 0
        kinds = list(types) if isinstance(types, list | tuple) else ["revolute"] * count
        prismatic_count = kinds.count(PRISMATIC)
        filled: dict[str, Any] = {}
        if kinds and "revolute" not in kinds:
            filled |= dict.fromkeys(REVOLUTE_KEYS, ())
        elif not section_content.keys() & set(SPRING_KEYS):
            filled |= dict.fromkeys(SPRING_KEYS, (0.0,) * max(count - prismatic_count, 0))
        if prismatic_count and not section_content.keys() & set(PRISMATIC_SPRING_KEYS):
            filled |= dict.fromkeys(PRISMATIC_SPRING_KEYS, (0.0,) * prismatic_count)
        return filled | section_content

    @property
    def is_prismatic(self) -> tuple[bool, ...]:
        """Return True for each prismatic joint and False for each revolute joint, in order from palm to tip."""
        if self.joint_type is None:
            return (False,) * len(self.link_length_m)
        return tuple(kind == PRISMATIC for kind in self.joint_type)

    @property
    def has_springs(self) -> bool:
        """Return True if a spring opens a joint of the digit, and False if tendons open the digit."""
        return any(self.joint_values("spring_stiffness_N_m_per_rad"))

    @property
    def axes(self) -> tuple[tuple[float, float, float], ...]:
        """Return the axis of each joint in the frame of the joint's link.

        The default axis is y for prismatic joints and z for hinges.
        """
        if self.joint_axis is not None:
            return self.joint_axis
        return tuple(
            Y_AXIS if joint_is_prismatic else Z_AXIS for joint_is_prismatic in self.is_prismatic
        )

    def joint_values(self, key: str) -> tuple[float, ...]:
        """Return the value of a quantity for each joint of the digit.

        The value of a revolute joint comes from ``key``, and the value of a prismatic joint from
        the corresponding key in metres.

        Args:
            key: one of ``REVOLUTE_KEYS``. The values of prismatic joints are in SI units. The
                values of revolute joints have the unit of the key.
        """
        revolute_values = iter(getattr(self, key))
        prismatic_values = iter(getattr(self, PRISMATIC_KEYS[REVOLUTE_KEYS.index(key)]))
        return tuple(
            next(prismatic_values if joint_is_prismatic else revolute_values)
            for joint_is_prismatic in self.is_prismatic
        )

    @property
    def display_units(self) -> DisplayUnits:
        """Return the units (n,) in which joint positions are displayed."""
        return DisplayUnits.of(self.is_prismatic)

    @property
    def joint_limits(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the smallest and the largest position [rad or m] of each joint."""
        units = self.display_units
        low, high = (
            tuple(np.where(self.is_prismatic, values, units.to_si_units(values)).tolist())
            for values in map(self.joint_values, REVOLUTE_KEYS[:2])
        )
        return low, high

    @property
    def displayed_joint_limits(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the smallest and the largest position of each joint in the displayed units, deg or mm."""
        units = self.display_units
        low, high = (
            tuple(np.where(self.is_prismatic, units.to_display_units(values), values).tolist())
            for values in map(self.joint_values, REVOLUTE_KEYS[:2])
        )
        return low, high

    @property
    def rated_loads(self) -> tuple[float, ...] | None:
        """Return the largest torque [N m] or force [N] that each joint withstands.

        Return None if the largest torque or force of a joint is not known.
        """
        rated_torques = self.joint_rated_torque_N_m
        rated_forces = self.joint_rated_force_N
        is_prismatic = self.is_prismatic
        if (rated_torques is None and not all(is_prismatic)) or (
            rated_forces is None and any(is_prismatic)
        ):
            return None
        values = iter(rated_torques or ()), iter(rated_forces or ())
        return tuple(next(values[slide]) for slide in is_prismatic)

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the digit's joints, in the order from the palm to the tip."""
        return tuple(f"{self.name}_j{i + 1}" for i in range(len(self.link_length_m)))


class Tendon(Section):
    """Tendon: path, material, and limits. Tensions are at the load cell."""

    name: qty.Name
    """Name of the tendon."""
    motor: qty.Name
    """Motor that winds the tendon."""
    moment_arm_m: dict[str, qty.MomentArm]
    """Moment arm of the tendon at each revolute joint that it crosses, which is a row of R.

    Positive arms flex the joint.

    A tendon crosses joints of one digit, and of digits that carry it, such as a wrist.

    An arm that depends on the joint's own angle is ``{ polynomial_m = [r0, r1, ..] }`` with at most
    six coefficients for an angle in rad, or a table ``{ angle_deg = [..], arm_m = [..] }`` over the
    range of the joint, which becomes a least-squares polynomial of degree 3.
    """
    excursion_ratio: dict[str, qty.ExcursionRatio] = Field(default_factory=dict)
    """Excursion of the tendon per motion of each prismatic joint that it moves, also entries of R.

    It is 1 for a tendon that pulls the link directly, and 2 for a pulley on the link. Positive
    ratios move the joint in its positive direction. The tendon turns by no angle at such a joint.
    """
    stiffness_N_per_m: qty.TendonStiffness
    """Stiffness of the whole path, below the knee."""
    damping_N_s_per_m: qty.TendonDamping
    """Damping of the whole path."""
    knee_N: qty.PositiveForce
    """Tension at which the stiffness changes."""
    stiffness_beyond_ratio: qty.StiffnessRatio
    """Stiffness beyond the knee divided by the stiffness below the knee."""
    knee_width_m: qty.KneeWidth
    """Length over which the stiffness changes."""
    friction_coefficient: qty.FrictionCoefficient
    """Friction coefficient of the pulleys."""
    wrap_angle_rad: qty.WrapAngle
    """Wrap angle between spool and first joint. The joint angles add to it."""
    rated_breaking_force_N: qty.PositiveForce
    """Breaking force of the tendon according to its data sheet."""
    tension_floor_N: qty.Force
    """Smallest commanded tension, which keeps the tendon on its pulleys."""
    tension_max_N: qty.PositiveForce
    """Largest commanded tension."""
    tension_trip_N: qty.PositiveForce
    """Tension limit: a single sample above it relaxes the hand (T03)."""
    drive_limit_N: qty.PositiveForce
    """Tension at the torque limit in the drive: ``torque_max_N_m`` / ``spool_radius_m``.

    A sample above it removes the torque at once (T03b).
    """
    pretension_N: qty.PositiveForce | None = None
    """Tension of both tendons of a spool pair at rest. The key is absent for a single tendon.

    A spool pair is two antagonistic tendons on one spool with opposite winding. ``moment_arm_m``
    has the arms of the tendon that a positive motor torque winds. The arms of the other tendon have
    the opposite sign.
    """

    @model_validator(mode="before")
    @classmethod
    def _add_default_tendon_keys(cls, section_content: Any) -> Any:
        """Add the keys that the hand file may omit for a tendon.

        A spool pair has a tension floor of 0, because its net tension can be positive or negative.
        A tendon that moves only prismatic joints has no moment arms.
        """
        if not isinstance(section_content, dict):
            return section_content
        if (
            section_content.get("pretension_N") is not None
            and "tension_floor_N" not in section_content
        ):
            section_content = section_content | {"tension_floor_N": 0.0}
        if section_content.get("excursion_ratio") and "moment_arm_m" not in section_content:
            section_content = section_content | {"moment_arm_m": {}}
        return section_content

    @property
    def arms(self) -> dict[str, Any]:
        """Return the tendon's moment arm [m], or excursion ratio for a prismatic joint, by the name of the joint."""
        return {**self.moment_arm_m, **self.excursion_ratio}

    def moment_arm_key(self, joint: str) -> str:
        """Return the key that contains the tendon's moment arm or excursion ratio at a joint."""
        return "excursion_ratio" if joint in self.excursion_ratio else "moment_arm_m"


class Motor(Section):
    """Motor with its drive. Quantities are at the spool, after the gear."""

    name: qty.Name
    """Name of the motor."""
    protocol: qty.Text
    """Protocol of the drive: ``mit``, ``odrive``, ``cia402``, ``moteus``, ``robstride``,
    ``robstride_mit`` or ``cubemars``."""
    bus: qty.Name
    """Bus of the drive."""
    node_id: qty.NodeId
    """Node number of the drive."""
    spool_radius_m: qty.Radius
    """Radius of the spool to the middle of the tendon."""
    inertia_kg_m2: qty.MotorInertia
    """Inertia of rotor and gear."""
    viscous_N_m_s_per_rad: qty.Damping
    """Viscous friction."""
    coulomb_N_m: qty.Torque
    """Coulomb friction."""
    torque_constant_N_m_per_A: qty.TorqueConstant
    """Torque per ampere."""
    torque_max_N_m: qty.PositiveTorque
    """Torque limit that handctl writes into the drive and reads back."""
    torque_peak_N_m: qty.PositiveTorque
    """Torque that the motor could make without this limit."""
    position_range_rad: qty.PositionRange
    """Largest absolute position that the drive's frames can represent."""
    velocity_range_rad_s: qty.SpeedRange
    """Largest absolute velocity that the drive's frames can represent."""
    direction: qty.Direction
    """1 if positive torque of the drive winds the tendon, else -1."""
    zero_rad: qty.MotorZeroAngle
    """Spool angle of the open hand, until a calibration replaces it."""
    watchdog_ms: qty.WatchdogTimeout
    """Time without a command after which the drive removes its torque."""
    options: qty.ProtocolOptions = Field(default_factory=dict)
    """Options of the protocol, such as ``reply_id``."""
    control: qty.MotorControl | None = None
    """``position`` if the drive closes the position loop of a motion.

    If absent, the mode is ``torque``.
    """
    kp_N_m_per_rad: qty.ServoStiffness | None = None
    """Stiffness of the drive's position loop.

    If it is absent, the stiffness follows from the gains ``motion``. A moteus requires it.
    """
    kd_N_m_s_per_rad: qty.ServoDamping | None = None
    """Damping of the drive's position loop.

    If it is absent, the damping ratio is that of the gains ``motion``. A moteus requires it.
    """

    @property
    def closes_position_loop(self) -> bool:
        """Return True if the position loop runs in the drive while the digit moves."""
        return self.control == "position"
