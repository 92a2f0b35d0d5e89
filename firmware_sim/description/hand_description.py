"""The simulator's description of a hand, which is read from the hand file.

To read the hand file, the module needs only the standard library of Python.
"""

import importlib.util
import math
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

PER_LINK_KEYS = (
    "link_com_m",
    "link_mass_kg",
    "link_inertia_kg_m2",
)
"""Keys of a digit whose value is a list with one value for each link.

In hand files of schema 2, a single number as value of such a key stands for equal values of all
links.
"""
JOINT_KEYS = {
    "joint_min_deg": "joint_min_m",
    "joint_max_deg": "joint_max_m",
    "joint_damping_N_m_s_per_rad": "joint_damping_N_s_per_m",
    "joint_armature_kg_m2": "joint_armature_kg",
    "spring_stiffness_N_m_per_rad": "spring_stiffness_N_per_m",
    "spring_preload_rad": "spring_preload_m",
}
"""For each key of a digit with values of hinges, the key with the values of prismatic joints."""
PRISMATIC = "prismatic"
"""Entry of ``joint_type`` for a joint that slides along its axis."""


MOMENT_ARM_COEFFICIENT_COUNT = 6
"""Number of polynomial coefficients of a moment arm that depends on the joint angle."""
MAX_FITTED_COEFFICIENTS = 4
"""Maximum number of polynomial coefficients fitted to a table of moment arms."""


class SimulatorError(ValueError):
    """An error that the user of the simulator can correct.

    The message of the error has a single line.
    """


@dataclass(frozen=True, slots=True)
class Digit:
    """One finger or thumb of a hand. Each tuple has one entry for each joint of the digit.

    The values of a prismatic joint have the unit m in place of rad and deg, N in place of N m, and
    kg in place of kg m2.

    Attributes:
        name: name of the digit.
        carrier: name of the digit whose last link carries this digit, or an empty text for a digit
            on the palm.
        position: position of the first joint in the palm frame, or in the frame of the last link of
            the carrying digit [m].
        rpy_deg: extrinsic roll, pitch and yaw of the digit's mount, in the same frame as
            ``position`` [deg].
        length: length of each link [m], or 0 for a link whose two joint axes intersect.
        prismatic: True for each joint that slides along its axis instead of turning.
        axis: axis of each joint, in the frame of the link that the joint moves.
        joint_rpy_deg: extrinsic roll, pitch and yaw of the frame of each link at joint angle zero,
            in the frame of the previous link [deg]. The rotation of the first link is relative to
            the frame of the mount.
        com: centre of mass of each link: x, y, z in the frame of the link [m].
        mass: mass of each link [kg].
        inertia: inertia of each link about the centre of mass of the link: xx, yy, zz, xy, xz, yz
            in the frame of the link [kg m2].
        radius: radius of the links of this digit [m].
        joint_min_deg: angle of the lower stop of each joint [deg].
        joint_max_deg: angle of the upper stop of each joint [deg].
        damping: viscous damping of each joint [N m s/rad].
        armature: inertia added at each joint axis [kg m2].
        spring: stiffness of the return spring of each joint [N m/rad].
        preload: preload angle of the return spring of each joint [rad].
        coupling: matrix of the joint angles per unit of each coordinate, with one row for each
            joint, empty for a digit with independent joints.
    """

    name: str
    carrier: str
    position: tuple[float, float, float]
    rpy_deg: tuple[float, float, float]
    length: tuple[float, ...]
    prismatic: tuple[bool, ...]
    axis: tuple[tuple[float, ...], ...]
    joint_rpy_deg: tuple[tuple[float, ...], ...]
    com: tuple[tuple[float, ...], ...]
    mass: tuple[float, ...]
    inertia: tuple[tuple[float, ...], ...]
    radius: float
    joint_min_deg: tuple[float, ...]
    joint_max_deg: tuple[float, ...]
    damping: tuple[float, ...]
    armature: tuple[float, ...]
    spring: tuple[float, ...]
    preload: tuple[float, ...]
    coupling: tuple[tuple[float, ...], ...] = ()

    @property
    def joints(self) -> list[str]:
        """Return the names of the digit's joints, from the palm to the tip."""
        return [f"{self.name}_j{i + 1}" for i in range(len(self.length))]


@dataclass(frozen=True, slots=True)
class LinkMesh:
    """A mesh that is drawn in place of a link or of the palm.

    Attributes:
        link: name of the link. The name ``palm`` stands for the palm.
        file: path of the mesh file.
        scale: factors from the unit of the mesh file to metres, for x, y, z.
        position: position of the mesh in the link's frame [m].
        rpy_deg: extrinsic roll, pitch and yaw of the mesh in the link's frame [deg].
    """

    link: str
    file: str
    scale: tuple[float, ...]
    position: tuple[float, ...]
    rpy_deg: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MomentArmCurve:
    """Moment arm of a tendon at a joint, as a function of the joint angle.

    At angles beyond the limits of the joint, the moment arm is constant.

    Attributes:
        low: smallest joint angle [rad].
        high: largest joint angle [rad].
        coefficients: ``MOMENT_ARM_COEFFICIENT_COUNT`` coefficients of the polynomial that gives the
            moment arm [m] for a joint angle [rad]. The constant term comes first.
    """

    low: float
    high: float
    coefficients: tuple[float, ...]

    @property
    def negated(self) -> "MomentArmCurve":
        """Return the curve with the opposite sign.

        The returned curve is the moment arm of a tendon that runs on the opposite side of the
        joint.
        """
        return replace(self, coefficients=tuple(-coefficient for coefficient in self.coefficients))

    @property
    def mean(self) -> float:
        """Return the moment arm, averaged over the range of the joint [m]."""
        area = 0.0
        for i, coefficient in enumerate(self.coefficients, 1):
            area += coefficient * (self.high**i - self.low**i) / i
        return area / (self.high - self.low)


@dataclass(frozen=True, slots=True)
class TendonSpec:
    """One tendon of a hand, with its path, elasticity and friction.

    Attributes:
        name: name of the tendon.
        motor: name of the motor that winds the tendon.
        arms: moment arm of the tendon at each joint [m], by the name of the joint. For a moment arm
            that depends on the joint angle, the value is the mean moment arm.
        curves: moment arms of the tendon that depend on the joint angle, by the name of the joint.
        stiffness: stiffness of the tendon at tensions below the knee [N/m].
        damping: viscous damping of the tendon [N s/m].
        knee: highest tension at which the stiffness is constant [N].
        stiffness_ratio_above_knee: stiffness at tensions far above the knee of the curve, divided by
            ``stiffness``.
        knee_width: width of the transition at the knee, as a difference of the tendon's elongation
            [m].
        friction: coefficient of friction between the tendon and its guides, for the capstan
            equation.
        wrap: wrap angle of the tendon before the first joint [rad].
        pretension: tension at rest in both tendons of a spool pair [N], or 0 for a single tendon.
        winding_sign: 1 if a positive spool angle winds the tendon up, and -1 if a positive spool
            angle pays the tendon out.
        curves: moment arms that depend on the joint angle, by the name of the joint.
        prismatic_joints: names of the prismatic joints. For a prismatic joint, the entry in
            ``arms`` is the excursion per motion of the joint [m/m]. The tendon does not bend at a
            prismatic joint.
    """

    name: str
    motor: str
    arms: dict[str, float]
    stiffness: float
    damping: float
    knee: float
    stiffness_ratio_above_knee: float
    knee_width: float
    friction: float
    wrap: float
    pretension: float = 0.0
    winding_sign: int = 1
    curves: dict[str, MomentArmCurve] = field(default_factory=dict)
    prismatic_joints: frozenset[str] = frozenset()

    @property
    def antagonist(self) -> "TendonSpec":
        """Return the second tendon of a spool pair.

        The second tendon of the pair is wound in the opposite direction. The moment arms of the
        second tendon have the opposite signs.
        """
        arms = {joint: -arm for joint, arm in self.arms.items()}
        curves = {joint: curve.negated for joint, curve in self.curves.items()}
        name = f"{self.name}_antagonist"
        return replace(self, name=name, arms=arms, curves=curves, winding_sign=-self.winding_sign)


@dataclass(frozen=True, slots=True)
class MotorSpec:
    """One motor of a hand. All quantities of the motor are given at the spool.

    Attributes:
        name: name of the motor.
        protocol: CAN protocol of the motor's drive.
        bus: name of the bus of the drive.
        node_id: node number of the drive on the bus.
        spool_radius: radius of the spool [m].
        inertia: moment of inertia of the rotor [kg m2].
        viscous: viscous friction of the motor [N m s/rad].
        coulomb: Coulomb friction of the motor [N m].
        torque_constant: torque of the motor per current [N m/A].
        torque_max: largest torque of the motor in continuous operation [N m].
        torque_peak: largest torque of the motor for a short time [N m].
        position_range: largest position that a CAN frame of the drive can contain [rad].
        velocity_range: largest velocity that a CAN frame of the drive can contain [rad/s].
        direction: +1 if the motor angle grows with the spool angle, and -1 if the motor angle
            falls.
        zero_angle: encoder angle at which the spool angle theta of a homed hand is 0 [rad].
        options: options of the drive's protocol.
        serial: serial number of the drive. If None, the drive has the default serial number
            of its protocol.
        torque_gain: true torque divided by the torque that the drive computes from its current. The
            torque gain is 1 for a plant without perturbation.
        top_speed: speed of the motor without load at the supply voltage [rad/s], or 0 if the speed
            is not limited.
        stall_torque: torque of the motor at standstill, if only the supply voltage limits the
            torque [N m].
    """

    name: str
    protocol: str
    bus: str
    node_id: int
    spool_radius: float
    inertia: float
    viscous: float
    coulomb: float
    torque_constant: float
    torque_max: float
    torque_peak: float
    position_range: float
    velocity_range: float
    direction: int
    zero_angle: float
    options: dict[str, Any]
    serial: int | None = None
    torque_gain: float = 1.0
    top_speed: float = 0.0
    stall_torque: float = 0.0


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """The sensor node of a hand, which sends tensions and joint angles.

    Attributes:
        bus: name of the bus of the sensor node.
        sync_id: identifier of the SYNC frame to which the node replies.
        base_id: identifier of the first frame with tensions.
        tendons: for each load cell, the name of its tendon.
        joints: for each joint encoder, the name of its joint.
        joint_decimation: number of SYNC frames for each frame with joint angles.
        tension_noise: standard deviation of the noise of a measured tension [N].
        bias_drift: standard deviation of the random drift of a load cell after 100 s [N].
        joint_noise: standard deviation of the noise of a measured joint angle [rad].
        travel_noise: standard deviation of the noise of a measured position of a prismatic joint
            [m].
        prismatic: names of the prismatic joints of the hand.
        tension_bias: constant error of every load cell [N], 0 unless the plant is perturbed.
        node_ids: node number of each CiA 404 amplifier, empty for the sensor node of handctl.
        channels_per_node: number of channels of each CiA 404 amplifier.
        rated_load: rated load of the load cells connected to CiA 404 amplifiers [N].
    """

    bus: str
    sync_id: int
    base_id: int
    tendons: list[str]
    joints: list[str]
    joint_decimation: int
    tension_noise: float
    bias_drift: float
    joint_noise: float
    travel_noise: float = 1e-5
    prismatic: frozenset[str] = frozenset()
    tension_bias: float = 0.0
    node_ids: tuple[int, ...] = ()
    channels_per_node: int = 1
    rated_load: float = 0.0


@dataclass(frozen=True, slots=True)
class Hand:
    """The description of a whole hand.

    Attributes:
        name: name of the hand.
        gravity: acceleration of gravity in the palm frame [m/s2].
        buses: names of the CAN buses of the hand.
        bitrates: nominal bit rate and data bit rate of each bus [bit/s]. The data bit rate is 0 for
            a bus without CAN FD.
        digits: all digits of the hand.
        tendons: all tendons of the hand, with only the first tendon of each spool pair.
        motors: all motors of the hand.
        sensors: sensor node of the hand. None for a hand without a sensor node.
        meshes: meshes of the links and of the palm, for pictures. The plant does not use the
            meshes, and the comparison of two hands ignores the meshes.
    """

    name: str
    gravity: tuple[float, float, float]
    buses: list[str]
    bitrates: list[tuple[int, int]]
    digits: list[Digit]
    tendons: list[TendonSpec]
    motors: list[MotorSpec]
    sensors: SensorSpec | None
    meshes: tuple[LinkMesh, ...] = field(default=(), compare=False)

    def digits_on_carrier(self, carrier: str) -> list[Digit]:
        """Return the digits mounted on the last link of the digit ``carrier``.

        An empty name stands for the palm.
        """
        return [digit for digit in self.digits if digit.carrier == carrier]

    @property
    def pairs(self) -> list[TendonSpec]:
        """Return the first tendon of each spool pair."""
        return [tendon for tendon in self.tendons if tendon.pretension]

    def has_spool_pairs(self, digit: Digit) -> bool:
        """Return True if spool pairs move the joints of the given digit."""
        return any(joint in tendon.arms for tendon in self.pairs for joint in digit.joints)

    @property
    def all_tendons(self) -> list[TendonSpec]:
        """Return all tendons: first the tendons in ``tendons``, then the second tendon of each spool pair."""
        return [*self.tendons, *(tendon.antagonist for tendon in self.pairs)]

    @property
    def closing_digits(self) -> list[Digit]:
        """Return the digits that can close on an object: the digits that carry no other digit."""
        return [digit for digit in self.digits if not self.digits_on_carrier(digit.name)]

    @property
    def joints(self) -> list[str]:
        """Return the names of all joints of the hand, digit by digit."""
        return [joint for digit in self.digits for joint in digit.joints]


def find_hand(name_or_path: str) -> Path:
    """Find the file of a hand by name or path.

    Args:
        name_or_path: name of a packaged hand, or path of a .toml file.

    Raises:
        SimulatorError: the file does not exist.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        spec = importlib.util.find_spec("handctl")
        roots = list(spec.submodule_search_locations or []) if spec else []
        candidates = [Path(root) / "hand" / "hands" / f"{name_or_path}.toml" for root in roots]
        path = next((candidate for candidate in candidates if candidate.is_file()), path)
    if not path.is_file():
        raise SimulatorError(
            f"no such hand: {name_or_path}; expected a packaged name such as jamia or a .toml file"
        )
    return path


def load_hand(name_or_path: str) -> Hand:
    """Load a hand file.

    Raises:
        SimulatorError: the hand file is missing, is not TOML, or lacks a key.
    """
    path = find_hand(name_or_path)
    try:
        return _parse_hand(_resolved_file(tomllib.loads(path.read_text("utf-8"))), path.parent)
    except OSError as error:
        raise SimulatorError(f"{path}: cannot be read: {error.strerror}") from error
    # The error below means that a number in the hand file is too long, or that the file is not in
    # UTF-8.
    except (ValueError, RecursionError) as error:
        raise SimulatorError(f"{path}: not TOML: {error}") from error
    except (KeyError, TypeError, AttributeError) as error:
        raise SimulatorError(
            f"{path}: not a complete hand: missing or wrong key {error}"
        ) from error


def _resolved_file(file_content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a hand file of schema 2, after all defaults and templates have been applied."""
    if file_content.get("schema") != 2:
        return file_content
    sections: dict[str, list[dict[str, Any]]] = {"digit": [], "tendon": [], "motor": []}
    for digit_section in file_content["digit"]:
        digit = _section_with_template(file_content, "digit", digit_section)
        name, links = digit["name"], len(digit["link_length_m"])
        motors = digit.pop("motor", {})
        for short_name, motor in motors.items():
            sections["motor"].append(
                _section_with_template(file_content, "motor", motor)
                | {"name": f"{name}_{short_name}"}
            )
        for short_name, entry in digit.pop("tendon", {}).items():
            tendon = _section_with_template(file_content, "tendon", entry) | {
                "name": f"{name}_{short_name}"
            }
            if tendon["motor"] in motors:
                tendon["motor"] = f"{name}_{tendon['motor']}"
            for key in {"moment_arm_m", "excursion_ratio"} & tendon.keys():
                tendon[key] = {
                    f"{name}_{j}" if re.fullmatch("j[0-9]+", j) else j: arm
                    for j, arm in tendon[key].items()
                }
            sections["tendon"].append(tendon)
        prismatic_count = digit.get("joint_type", []).count(PRISMATIC)
        counts = dict.fromkeys((*PER_LINK_KEYS, "link_mesh_scale"), links)
        counts |= dict.fromkeys(JOINT_KEYS, links - prismatic_count)
        counts |= dict.fromkeys(JOINT_KEYS.values(), prismatic_count)
        values_by_key = {
            key: [digit[key]] * count
            for key, count in counts.items()
            if isinstance(digit.get(key), int | float)
        }
        sections["digit"].append(digit | values_by_key)
    for kind in ("tendon", "motor"):
        sections[kind] += [
            _section_with_template(file_content, kind, entry)
            for entry in file_content.get(kind, [])
        ]
    node = dict(file_content["sensor_node"]) if "sensor_node" in file_content else {}
    if node.get("tendons") == "all":
        node["tendons"] = [tendon["name"] for tendon in sections["tendon"]]
    if node.get("joints") == "all":
        digits = sections["digit"]
        node["joints"] = [
            f"{digit_table['name']}_j{i + 1}"
            for digit_table in digits
            for i in range(len(digit_table["link_length_m"]))
        ]
    return file_content | sections | {"sensor_node": node}


def _section_with_template(
    file_content: dict[str, Any], section_kind: str, section: dict[str, Any]
) -> dict[str, Any]:
    """Return an entry of a hand file, with all missing keys filled in.

    If a key is missing in the entry, its value comes from the template of the entry. If a key is
    missing in both the entry and the template, its value comes from the defaults for entries of the
    kind ``section_kind``.
    """
    default = file_content.get("default", {}).get(section_kind, {})
    template = (
        file_content[f"{section_kind}_template"][section["template"]]
        if "template" in section
        else {}
    )
    return _merged_tables(_merged_tables(default, template), section)


def _merged_tables(base_table: dict[str, Any], override_table: dict[str, Any]) -> dict[str, Any]:
    """Merge two tables key by key.

    If both tables have a value for a key, the value of ``override_table`` is used.
    """
    tables = {key: _merged_tables(base_table[key], value) for key, value in override_table.items()
              if isinstance(value, dict) and isinstance(base_table.get(key), dict)}  # fmt: skip
    return base_table | override_table | tables


def _parse_hand(file_content: dict[str, Any], folder: Path) -> Hand:
    sensors = file_content.get("sensor_node")
    return Hand(
        name=file_content["name"],
        gravity=tuple(file_content["mount"]["gravity_m_s2"]),
        buses=[bus["name"] for bus in file_content["bus"]],
        bitrates=[(bus["bitrate"], bus.get("data_bitrate") or 0) for bus in file_content["bus"]],
        digits=[_parse_digit(digit) for digit in file_content["digit"]],
        tendons=[
            _parse_tendon(tendon, _joint_ranges(file_content)) for tendon in file_content["tendon"]
        ],
        motors=[_parse_motor(motor) for motor in file_content["motor"]],
        sensors=_parse_sensors(sensors, _prismatic_joints(file_content))
        if sensors and (sensors["tendons"] or sensors.get("joints"))
        else None,
        meshes=tuple(_parse_meshes(file_content, folder)),
    )


def _parse_meshes(file_content: dict[str, Any], folder: Path) -> Iterator[LinkMesh]:
    """Yield the meshes of a hand.

    A relative path of a mesh file starts at the folder of the hand file.
    """
    mount = file_content["mount"]
    pose_keys = ("scale", "position_m", "rpy_deg")
    if mount.get("palm_mesh"):
        pose = [mount.get(f"palm_mesh_{key}") for key in pose_keys]
        yield _make_mesh("palm", folder / mount["palm_mesh"], *pose)
    for digit in file_content["digit"]:
        count = len(digit["link_length_m"])
        poses = [digit.get(f"link_mesh_{key}") or [None] * count for key in pose_keys]
        for i, file in enumerate(digit.get("link_mesh") or ()):
            if file:
                pose = [values[i] for values in poses]
                yield _make_mesh(f"{digit['name']}_link{i + 1}", folder / file, *pose)


def _make_mesh(link_name: str, file: Path, scale: Any, position: Any, rpy_deg: Any) -> LinkMesh:
    """Return a mesh with the given placement.

    An argument that is None leaves the scale, the position or the rotation of the mesh unchanged.
    """
    factors = scale if isinstance(scale, list) else [1.0 if scale is None else scale] * 3
    return LinkMesh(
        link=link_name,
        file=str(file.absolute()),
        scale=tuple(factors),
        position=tuple(position or (0.0, 0.0, 0.0)),
        rpy_deg=tuple(rpy_deg or (0.0, 0.0, 0.0)),
    )


def _parse_digit(digit_section: dict[str, Any]) -> Digit:
    count = len(digit_section["link_length_m"])
    is_prismatic = _are_joints_prismatic(digit_section)
    prismatic_count = is_prismatic.count(True)
    expected = dict.fromkeys(
        (*PER_LINK_KEYS, "joint_type", "joint_axis", "joint_rpy_deg", "coupling"), count
    )
    expected |= dict.fromkeys(JOINT_KEYS, count - prismatic_count)
    expected |= dict.fromkeys(JOINT_KEYS.values(), prismatic_count)
    for key, number in expected.items():
        if key in digit_section and len(digit_section[key]) != number:
            problem_text = (
                f"digit {digit_section['name']}: {key} has {len(digit_section[key])} values"
            )
            counted_part = "link" if number == count else "joint of its type"
            raise SimulatorError(f"{problem_text}; expected {number}, one per {counted_part}")
    axes = [(0.0, 1.0, 0.0) if slide else (0.0, 0.0, 1.0) for slide in is_prismatic]
    return Digit(
        name=digit_section["name"],
        carrier=digit_section.get("mount_on", ""),
        position=tuple(digit_section["mount_position_m"]),
        rpy_deg=tuple(digit_section["mount_rpy_deg"]),
        length=tuple(digit_section["link_length_m"]),
        prismatic=tuple(is_prismatic),
        axis=tuple(map(tuple, digit_section.get("joint_axis", axes))),
        joint_rpy_deg=tuple(
            map(tuple, digit_section.get("joint_rpy_deg", [(0.0, 0.0, 0.0)] * count))
        ),
        com=tuple(
            (com, 0.0, 0.0) if isinstance(com, int | float) else tuple(com)
            for com in digit_section["link_com_m"]
        ),
        mass=tuple(digit_section["link_mass_kg"]),
        inertia=tuple(_link_inertia(digit_section, i) for i in range(count)),
        radius=digit_section["link_radius_m"],
        joint_min_deg=_joint_values(digit_section, "joint_min_deg"),
        joint_max_deg=_joint_values(digit_section, "joint_max_deg"),
        damping=_joint_values(digit_section, "joint_damping_N_m_s_per_rad"),
        armature=_joint_values(digit_section, "joint_armature_kg_m2"),
        spring=_joint_values(digit_section, "spring_stiffness_N_m_per_rad", 0.0),
        preload=_joint_values(digit_section, "spring_preload_rad", 0.0),
        coupling=tuple(map(tuple, digit_section.get("coupling", ()))),
    )


def _are_joints_prismatic(digit_section: dict[str, Any]) -> list[bool]:
    """Return a boolean value for each joint of a digit, True for a joint that slides along its axis."""
    kinds = digit_section.get("joint_type", ["revolute"] * len(digit_section["link_length_m"]))
    return [kind == PRISMATIC for kind in kinds]


def _joint_values(
    digit_section: dict[str, Any], key: str, default: float | None = None
) -> tuple[float, ...]:
    """Return a value for each joint of a digit.

    For a hinge, the value comes from the key ``key``. For a prismatic joint, the value comes from
    the key ``JOINT_KEYS[key]``. If the key is missing and no default is given, the function raises
    KeyError.
    """
    is_prismatic = _are_joints_prismatic(digit_section)
    lists = {}
    for slide, name in ((False, key), (True, JOINT_KEYS[key])):
        count = is_prismatic.count(slide)
        is_missing = name not in digit_section and (default is not None or not count)
        lists[slide] = iter([default or 0.0] * count if is_missing else digit_section[name])
    return tuple(next(lists[slide]) for slide in is_prismatic)


def _link_inertia(digit_section: dict[str, Any], i: int) -> tuple[float, ...]:
    """Return the inertia of link ``i`` of a digit: xx, yy, zz, xy, xz, yz [kg m2].

    A single number in the hand file is the moment of inertia of a round bar about the axes y and z.
    """
    value = digit_section["link_inertia_kg_m2"][i]
    if isinstance(value, int | float):
        # For any body, the largest principal moment of inertia is at most the sum of the other two
        # moments.
        axial_inertia = min(
            digit_section["link_mass_kg"][i] * digit_section["link_radius_m"] ** 2 / 2, 2 * value
        )
        return (axial_inertia, value, value, 0.0, 0.0, 0.0)
    return tuple(value) if len(value) == 6 else (*value, 0.0, 0.0, 0.0)


def _joint_ranges(digit_section: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the lower and the upper limit of each joint [rad], by the name of the joint."""
    return {
        f"{digit['name']}_j{i + 1}": (math.radians(low), math.radians(high))
        for digit in digit_section["digit"]
        for i, (low, high) in enumerate(
            zip(
                _joint_values(digit, "joint_min_deg"),
                _joint_values(digit, "joint_max_deg"),
                strict=True,
            )
        )
    }


def _parse_moment_arm_curve(
    curve_section: dict[str, list[float]], limits: tuple[float, float]
) -> MomentArmCurve:
    """Return the moment arm of a tendon as a function of the joint angle.

    If the hand file contains a table of moment arms, the function fits a polynomial to the table by
    least squares.

    Args:
        curve_section: entry of the hand file with ``polynomial_m``, or with ``angle_deg`` and ``arm_m``.
        limits: limits of the joint [rad].
    """
    coefficients = curve_section.get("polynomial_m")
    if coefficients is None:
        coefficients = _fit_polynomial(
            [math.radians(angle) for angle in curve_section["angle_deg"]], curve_section["arm_m"]
        )
    return MomentArmCurve(
        *limits, (*coefficients, *(0.0,) * (MOMENT_ARM_COEFFICIENT_COUNT - len(coefficients)))
    )


def _fit_polynomial(angles: list[float], arms: list[float]) -> list[float]:
    """Fit a polynomial to a table of moment arms by least squares, and return the coefficients."""
    count = min(MAX_FITTED_COEFFICIENTS, len(angles))
    rows = [
        [math.fsum(angle ** (i + j) for angle in angles) for j in range(count)]
        + [math.fsum(arm * angle**i for angle, arm in zip(angles, arms, strict=True))]
        for i in range(count)
    ]
    for k in range(count):
        # The matrix is symmetric and positive definite. So the Gaussian elimination does not need
        # to exchange rows.
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(count):
            if i != k:
                factor = rows[i][k]
                rows[i] = [
                    value - factor * pivot_value
                    for value, pivot_value in zip(rows[i], rows[k], strict=True)
                ]
    return [row[count] for row in rows]


def _parse_tendon(
    tendon_section: dict[str, Any], joint_ranges: dict[str, tuple[float, float]]
) -> TendonSpec:
    ratios = tendon_section.get("excursion_ratio", {})
    arm_sections = tendon_section.get("moment_arm_m", {}) | ratios
    curves = {
        joint: _parse_moment_arm_curve(arm, joint_ranges.get(joint, (0.0, 1.0)))
        for joint, arm in arm_sections.items()
        if isinstance(arm, dict)
    }
    return TendonSpec(
        name=tendon_section["name"],
        motor=tendon_section["motor"],
        arms=arm_sections | {joint: curve.mean for joint, curve in curves.items()},
        prismatic_joints=frozenset(ratios),
        curves=curves,
        stiffness=tendon_section["stiffness_N_per_m"],
        damping=tendon_section["damping_N_s_per_m"],
        knee=tendon_section["knee_N"],
        stiffness_ratio_above_knee=tendon_section["stiffness_beyond_ratio"],
        knee_width=tendon_section["knee_width_m"],
        friction=tendon_section["friction_coefficient"],
        wrap=tendon_section["wrap_angle_rad"],
        pretension=tendon_section.get("pretension_N", 0.0),
    )


def _parse_motor(motor_section: dict[str, Any]) -> MotorSpec:
    return MotorSpec(
        name=motor_section["name"],
        protocol=motor_section["protocol"],
        bus=motor_section["bus"],
        node_id=motor_section["node_id"],
        spool_radius=motor_section["spool_radius_m"],
        inertia=motor_section["inertia_kg_m2"],
        viscous=motor_section["viscous_N_m_s_per_rad"],
        coulomb=motor_section["coulomb_N_m"],
        torque_constant=motor_section["torque_constant_N_m_per_A"],
        torque_max=motor_section["torque_max_N_m"],
        torque_peak=motor_section["torque_peak_N_m"],
        position_range=motor_section["position_range_rad"],
        velocity_range=motor_section["velocity_range_rad_s"],
        direction=motor_section["direction"],
        zero_angle=motor_section["zero_rad"],
        options=dict(motor_section.get("options", {})),
    )


def _prismatic_joints(file_content: dict[str, Any]) -> frozenset[str]:
    """Return the names of the prismatic joints of a hand."""
    return frozenset(
        f"{digit['name']}_j{i + 1}"
        for digit in file_content["digit"]
        for i, is_prismatic in enumerate(_are_joints_prismatic(digit))
        if is_prismatic
    )


def _parse_sensors(sensor_section: dict[str, Any], prismatic: frozenset[str]) -> SensorSpec:
    return SensorSpec(
        bus=sensor_section["bus"],
        sync_id=sensor_section.get("sync_id", 0x080),
        base_id=sensor_section.get("base_id", 0x1A0),
        tendons=list(sensor_section["tendons"]),
        joints=list(sensor_section.get("joints", ())),
        joint_decimation=sensor_section.get("joint_decimation", 1),
        tension_noise=sensor_section["tension_noise_N"],
        bias_drift=sensor_section["tension_bias_drift_N"],
        joint_noise=sensor_section.get("joint_noise_rad", 1e-3),
        travel_noise=sensor_section.get("joint_noise_m", 1e-5),
        prismatic=prismatic,
        node_ids=tuple(sensor_section["node_ids"])
        if sensor_section.get("protocol") == "cia404"
        else (),
        channels_per_node=sensor_section.get("channels_per_node", 1),
        rated_load=sensor_section["range_N"] if sensor_section.get("protocol") == "cia404" else 0.0,
    )
