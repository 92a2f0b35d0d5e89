"""Sections of a hand file as frozen pydantic models. Keys carry their units."""

import math

from pydantic import BaseModel, ConfigDict, Field

from handctl.hand.file import quantities as qty


class Section(BaseModel):
    """Table of the file: frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class Mount(Section):
    """Orientation of the palm in the world."""

    gravity_m_s2: tuple[qty.Gravity, qty.Gravity, qty.Gravity]
    """Gravity in the palm frame: x out of the palm, y from thumb to fingers, z along the hinges."""


class Bus(Section):
    """CAN bus. The command line names its interface."""

    name: qty.Name
    bitrate: qty.Bitrate
    data_bitrate: qty.Bitrate | None = None
    """Bit rate of CAN FD's data phase, absent for a classical bus."""


class SensorNode(Section):
    """Sensor node with load cells between spool and first pulley, and joint encoders."""

    bus: qty.Name
    sync_id: qty.CanId
    """Identifier of SYNC, one byte with the tick counter. The node samples at SYNC."""
    base_id: qty.CanId
    """First identifier of tension frames. Joint frames begin at ``base_id + 0x10``. A frame has five channels."""
    tendons: tuple[qty.Name, ...]
    joints: tuple[qty.Name, ...]
    joint_decimation: qty.Decimation
    tension_noise_N: qty.Force
    tension_bias_drift_N: qty.Force
    """Random walk, per 100 s."""
    joint_noise_rad: qty.JointNoise

    @property
    def tension_ids(self) -> tuple[int, ...]:
        """Return the identifiers of the tension frames."""
        return tuple(self.base_id + group for group in range(math.ceil(len(self.tendons) / CHANNELS_PER_FRAME)))

    @property
    def joint_ids(self) -> tuple[int, ...]:
        """Return the identifiers of the joint frames."""
        groups = math.ceil(len(self.joints) / CHANNELS_PER_FRAME)
        return tuple(self.base_id + JOINT_FRAME_OFFSET + group for group in range(groups))


CHANNELS_PER_FRAME = 5
"""Channels of 12 bits beside the counter of 4 bits in 8 bytes. Source: sensor_node.dbc."""
JOINT_FRAME_OFFSET = 0x10
"""Distance of joint frame from tension frame identifiers. Source: sensor_node.dbc."""


MAX_LINKS = 8
"""Largest number of links of a digit."""


class Digit(Section):
    """Finger or thumb: a chain of links with a hinge before each.

    The frame of a link has its origin in the link's joint and x along the link. Without
    ``joint_axis`` and ``joint_rpy_deg`` all hinges are along z, and a positive angle flexes towards y.
    """

    name: qty.Name
    mount_position_m: tuple[qty.Position, qty.Position, qty.Position]
    mount_rpy_deg: tuple[qty.MountAngle, qty.MountAngle, qty.MountAngle]
    """Roll, pitch, yaw about the fixed axes of the palm: Rz(yaw) Ry(pitch) Rx(roll)."""
    link_length_m: tuple[qty.Length, ...] = Field(min_length=1, max_length=MAX_LINKS)
    """Distance from a link's joint to the next joint, or to the tip. 0 if the axes of two joints meet."""
    joint_axis: tuple[tuple[qty.Direction3, qty.Direction3, qty.Direction3], ...] | None = None
    """Unit vector of each hinge in the link's frame. Absent for hinges along z, [0, 0, 1]."""
    joint_rpy_deg: tuple[tuple[qty.MountAngle, qty.MountAngle, qty.MountAngle], ...] | None = None
    """Orientation of each link's frame in the frame before it at angle zero, as ``mount_rpy_deg``.

    The frame before the first link is that of the mount. Absent for equal orientation.
    """
    link_com_m: tuple[qty.CentreOfMass, ...]
    """Centre of mass in the link's frame: a distance along the link, or x, y, z."""
    link_mass_kg: tuple[qty.Mass, ...]
    link_inertia_kg_m2: tuple[qty.LinkInertia, ...]
    """Inertia about the centre of mass: a number, [xx, yy, zz], or [xx, yy, zz, xy, xz, yz].

    A number is the inertia of a round bar about y and z. About x it is that of the bar's radius.
    """
    link_radius_m: qty.Radius
    joint_min_deg: tuple[qty.JointAngle, ...]
    joint_max_deg: tuple[qty.JointAngle, ...]
    joint_damping_N_m_s_per_rad: tuple[qty.Damping, ...]
    joint_armature_kg_m2: tuple[qty.Armature, ...]
    spring_stiffness_N_m_per_rad: tuple[qty.SpringStiffness, ...]
    spring_preload_rad: tuple[qty.Preload, ...]
    """Spring torque is k (q + preload), against flexion."""
    coupling: tuple[tuple[qty.Coupling, ...], ...] | None = None
    """B of q = B theta, one row per joint, for a digit with fewer tendons than joints.

    Absent for independent joints.
    """
    joint_rated_torque_N_m: tuple[qty.PositiveTorque, ...] | None = None
    """Torque limit of each joint with its pin and links, absent if unknown."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the joint names from the palm outwards."""
        return tuple(f"{self.name}_j{i + 1}" for i in range(len(self.link_length_m)))


class Tendon(Section):
    """Tendon: path, material, and limits. Tensions are at the load cell."""

    name: qty.Name
    motor: qty.Name
    moment_arm_m: dict[str, qty.MomentArm]
    """Row of R, by joint. The tendon does not cross absent joints. Positive arms flex."""
    stiffness_N_per_m: qty.TendonStiffness
    damping_N_s_per_m: qty.TendonDamping
    knee_N: qty.PositiveForce
    stiffness_beyond_ratio: qty.StiffnessRatio
    knee_width_m: qty.KneeWidth
    friction_coefficient: qty.FrictionCoefficient
    wrap_angle_rad: qty.Wrap
    rated_breaking_force_N: qty.PositiveForce
    tension_floor_N: qty.Force
    tension_max_N: qty.PositiveForce
    tension_trip_N: qty.PositiveForce
    drive_limit_N: qty.PositiveForce


class Motor(Section):
    """Motor with its drive. Quantities are at the spool, after the gear."""

    name: qty.Name
    protocol: qty.Name
    bus: qty.Name
    node_id: qty.NodeId
    spool_radius_m: qty.Radius
    inertia_kg_m2: qty.MotorInertia
    viscous_N_m_s_per_rad: qty.Damping
    coulomb_N_m: qty.Torque
    torque_constant_N_m_per_A: qty.TorqueConstant
    torque_max_N_m: qty.PositiveTorque
    torque_peak_N_m: qty.PositiveTorque
    position_range_rad: qty.PositionRange
    velocity_range_rad_s: qty.SpeedRange
    direction: qty.Direction
    """1 if positive torque of the drive winds the tendon, else -1."""
    zero_rad: qty.Zero
    watchdog_ms: qty.Watchdog
    options: qty.Options = Field(default_factory=dict)
    """Options of the protocol, such as ``reply_id``."""
