"""The description of a hand as the simulator needs it, read from its TOML file with the standard library only."""

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
    "joint_min_deg",
    "joint_max_deg",
    "joint_damping_N_m_s_per_rad",
    "joint_armature_kg_m2",
    "spring_stiffness_N_m_per_rad",
    "spring_preload_rad",
)
"""Keys of a digit with a list of one value per link.

In schema 2 a single number defines equal values.
"""


POWERS = 6
"""Number of coefficients of a moment arm that depends on the angle."""
TABLE_POWERS = 4
"""Largest number of coefficients for a table of moment arms."""


class SimulatorError(ValueError):
    """An error that the user of the simulator can correct, with a text of one line."""


@dataclass(frozen=True, slots=True)
class Digit:
    """One finger or thumb. Tuples have one entry for each joint.

    Attributes:
        name: name.
        carrier: digit whose last link carries this digit, empty for the palm.
        position: position of the first hinge in the palm frame, or in the frame of that link [m].
        rpy_deg: extrinsic roll, pitch, yaw [deg].
        length: length of each link [m], 0 where the axes of two joints meet.
        axis: axis of each joint in the link's frame.
        joint_rpy_deg: extrinsic roll, pitch, yaw of each link's frame at angle zero in the frame
            before, which is that of the mount for the first link [deg].
        com: centre of mass of each link, x, y, z in its frame [m].
        mass: mass of each link [kg].
        inertia: inertia of each link about its centre of mass, xx, yy, zz, xy, xz, yz in its frame
            [kg m2].
        radius: radius of the links [m].
        joint_min_deg: lower stop of each joint [deg].
        joint_max_deg: upper stop of each joint [deg].
        damping: damping of each joint [N m s/rad].
        armature: additional inertia of each joint [kg m2].
        spring: stiffness of each return spring [N m/rad].
        preload: preload angle of each return spring [rad].
    """

    name: str
    carrier: str
    position: tuple[float, float, float]
    rpy_deg: tuple[float, float, float]
    length: tuple[float, ...]
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

    @property
    def joints(self) -> list[str]:
        """Return the names of the joints, from the palm outwards."""
        return [f"{self.name}_j{i + 1}" for i in range(len(self.length))]


@dataclass(frozen=True, slots=True)
class LinkMesh:
    """A mesh that pictures show as a link or as the palm.

    Attributes:
        link: name of the link, ``palm`` for the palm.
        file: path of the file.
        scale: factors from the file's unit to metres, for x, y, z.
        position: position of the mesh in the link's frame [m].
        rpy_deg: extrinsic roll, pitch, yaw of the mesh [deg].
    """

    link: str
    file: str
    scale: tuple[float, ...]
    position: tuple[float, ...]
    rpy_deg: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ArmCurve:
    """Moment arm of a tendon at a joint by the joint angle.

    Beyond the limits of the joint the arm is constant.

    Attributes:
        low: smallest joint angle [rad].
        high: largest joint angle [rad].
        powers: ``POWERS`` coefficients of the polynomial by the angle in rad, constant first.
    """

    low: float
    high: float
    powers: tuple[float, ...]

    @property
    def opposite(self) -> "ArmCurve":
        """Return the arm of a tendon on the other side of the joint."""
        return replace(self, powers=tuple(-power for power in self.powers))

    @property
    def mean(self) -> float:
        """Return the mean over the joint's range [m]."""
        area = 0.0
        for i, power in enumerate(self.powers, 1):
            area += power * (self.high**i - self.low**i) / i
        return area / (self.high - self.low)


@dataclass(frozen=True, slots=True)
class TendonSpec:
    """One tendon: routing, elasticity and friction.

    Attributes:
        name: name.
        motor: name of its motor.
        arms: moment arm by joint name [m], the mean of one that depends on the angle.
        curves: moment arms that depend on the angle, by joint name.
        stiffness: stiffness up to the knee [N/m].
        damping: damping [N s/m].
        knee: maximum tension of the linear range [N].
        after_knee_ratio: stiffness far beyond the knee, divided by ``stiffness``.
        knee_width: width of the transition [m].
        friction: capstan friction coefficient.
        wrap: wrap angle before the first joint [rad].
        pretension: tension of both tendons of a spool pair at rest [N], 0 for a single tendon.
        winding: 1 if a positive spool angle winds the tendon, -1 if it pays the tendon out.
    """

    name: str
    motor: str
    arms: dict[str, float]
    stiffness: float
    damping: float
    knee: float
    after_knee_ratio: float
    knee_width: float
    friction: float
    wrap: float
    pretension: float = 0.0
    winding: int = 1
    curves: dict[str, ArmCurve] = field(default_factory=dict)

    @property
    def antagonist(self) -> "TendonSpec":
        """Return the second tendon of a spool pair: opposite winding and opposite arms."""
        arms = {joint: -arm for joint, arm in self.arms.items()}
        curves = {joint: curve.opposite for joint, curve in self.curves.items()}
        name = f"{self.name}_antagonist"
        return replace(self, name=name, arms=arms, curves=curves, winding=-self.winding)


@dataclass(frozen=True, slots=True)
class MotorSpec:
    """One motor. All quantities are at the spool.

    Attributes:
        name: name.
        protocol: protocol of the drive.
        bus: name of its bus.
        node_id: node number.
        spool_radius: radius of the spool [m].
        inertia: inertia of the rotor [kg m2].
        viscous: viscous friction [N m s/rad].
        coulomb: Coulomb friction [N m].
        torque_constant: torque constant [N m/A].
        torque_max: continuous torque limit [N m].
        torque_peak: peak torque [N m].
        position_range: position range [rad].
        velocity_range: velocity range [rad/s].
        direction: +1 or -1, sign between motor angle and spool angle.
        zero: encoder angle at theta = 0 of a homed hand [rad].
        options: options of the protocol.
        serial: serial number of the drive, None for the default of the protocol.
        torque_gain: true torque divided by the torque that the drive believes, 1 unless perturbed.
        top_speed: no-load speed at the supply voltage [rad/s], 0 for a motor without a speed limit.
        stall_torque: torque at standstill if only the supply voltage limited it [N m].
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
    zero: float
    options: dict[str, Any]
    serial: int | None = None
    torque_gain: float = 1.0
    top_speed: float = 0.0
    stall_torque: float = 0.0


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """The sensor node.

    Attributes:
        bus: name of its bus.
        sync_id: identifier of SYNC.
        base_id: identifier of the first tension frame.
        tendons: tendon of each load cell.
        joints: joint of each encoder.
        joint_decimation: SYNCs for each joint frame.
        tension_noise: standard deviation of a tension [N].
        bias_drift: standard deviation of a load cell's random walk after 100 s [N].
        joint_noise: standard deviation of a joint angle [rad].
        tension_bias: constant error of every load cell [N], 0 unless perturbed.
        node_ids: node number of each CiA 404 amplifier, empty for the sensor node of handctl.
        channels_per_node: channels of an amplifier.
        full_range: rated load of the load cells on amplifiers [N].
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
    tension_bias: float = 0.0
    node_ids: tuple[int, ...] = ()
    channels_per_node: int = 1
    full_range: float = 0.0


@dataclass(frozen=True, slots=True)
class Hand:
    """A whole hand.

    Attributes:
        name: name.
        gravity: gravity in the palm frame [m/s2].
        buses: names of the buses.
        bitrates: nominal bit rate and bit rate of the data phase of each bus [bit/s], 0 without CAN
            FD.
        digits: digits.
        tendons: tendons, the first one of each spool pair.
        motors: motors.
        sensors: sensor node, None without.
        meshes: meshes of links and palm, for pictures. The plant does not use the meshes, and the
            comparison of hands ignores them.
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

    def carried_by(self, carrier: str) -> list[Digit]:
        """Return the digits on the last link of another digit, or on the palm for an empty name."""
        return [digit for digit in self.digits if digit.carrier == carrier]

    @property
    def pairs(self) -> list[TendonSpec]:
        """Return the first tendon of each spool pair."""
        return [tendon for tendon in self.tendons if tendon.pretension]

    @property
    def every_tendon(self) -> list[TendonSpec]:
        """Return all tendons: after ``tendons`` the second one of each spool pair."""
        return [*self.tendons, *(tendon.antagonist for tendon in self.pairs)]

    @property
    def closing(self) -> list[Digit]:
        """Return the digits that close on an object: those that carry no other digit."""
        return [digit for digit in self.digits if not self.carried_by(digit.name)]

    @property
    def joints(self) -> list[str]:
        """Return the names of all joints in the order of the digits."""
        return [joint for digit in self.digits for joint in digit.joints]


def find_hand(name_or_path: str) -> Path:
    """Find the file of a hand.

    Args:
        name_or_path: packaged name or path of a .toml file.

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
        raise SimulatorError(f"no such hand: {name_or_path}; expected a packaged name such as jamia or a .toml file")
    return path


def load_hand(name_or_path: str) -> Hand:
    """Load a hand file.

    Raises:
        SimulatorError: the file is missing, is not TOML, or lacks a key.
    """
    path = find_hand(name_or_path)
    try:
        return _hand(_resolved(tomllib.loads(path.read_text("utf-8"))), path.parent)
    except OSError as error:
        raise SimulatorError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # The file has an endless number, or is not UTF-8.
        raise SimulatorError(f"{path}: not TOML: {error}") from error
    except (KeyError, TypeError, AttributeError) as error:
        raise SimulatorError(f"{path}: not a complete hand: missing or wrong key {error}") from error


def _resolved(raw: dict[str, Any]) -> dict[str, Any]:
    """Return a hand file of schema 2 with its defaults and templates replaced by values."""
    if raw.get("schema") != 2:
        return raw
    sections: dict[str, list[dict[str, Any]]] = {"digit": [], "tendon": [], "motor": []}
    for given in raw["digit"]:
        digit = _with_template(raw, "digit", given)
        name, links = digit["name"], len(digit["link_length_m"])
        motors = digit.pop("motor", {})
        for short, motor in motors.items():
            sections["motor"].append(_with_template(raw, "motor", motor) | {"name": f"{name}_{short}"})
        for short, entry in digit.pop("tendon", {}).items():
            tendon = _with_template(raw, "tendon", entry) | {"name": f"{name}_{short}"}
            if tendon["motor"] in motors:
                tendon["motor"] = f"{name}_{tendon['motor']}"
            arms = tendon["moment_arm_m"].items()
            tendon["moment_arm_m"] = {f"{name}_{j}" if re.fullmatch("j[0-9]+", j) else j: arm for j, arm in arms}
            sections["tendon"].append(tendon)
        listed = {
            key: [digit[key]] * links
            for key in (*PER_LINK_KEYS, "link_mesh_scale")
            if isinstance(digit.get(key), int | float)
        }
        sections["digit"].append(digit | listed)
    for kind in ("tendon", "motor"):
        sections[kind] += [_with_template(raw, kind, entry) for entry in raw.get(kind, [])]
    node = dict(raw["sensor_node"]) if "sensor_node" in raw else {}
    if node.get("tendons") == "all":
        node["tendons"] = [tendon["name"] for tendon in sections["tendon"]]
    if node.get("joints") == "all":
        digits = sections["digit"]
        node["joints"] = [f"{one['name']}_j{i + 1}" for one in digits for i in range(len(one["link_length_m"]))]
    return raw | sections | {"sensor_node": node}


def _with_template(raw: dict[str, Any], kind: str, entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry with missing keys taken from its template, then from the default of its kind."""
    default = raw.get("default", {}).get(kind, {})
    template = raw[f"{kind}_template"][entry["template"]] if "template" in entry else {}
    return _merged(_merged(default, template), entry)


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return two tables merged key by key. ``above`` wins."""
    tables = {key: _merged(below[key], value) for key, value in above.items()
              if isinstance(value, dict) and isinstance(below.get(key), dict)}  # fmt: skip
    return below | above | tables


def _hand(raw: dict[str, Any], folder: Path) -> Hand:
    sensors = raw.get("sensor_node")
    return Hand(
        name=raw["name"],
        gravity=tuple(raw["mount"]["gravity_m_s2"]),
        buses=[bus["name"] for bus in raw["bus"]],
        bitrates=[(bus["bitrate"], bus.get("data_bitrate") or 0) for bus in raw["bus"]],
        digits=[_digit(digit) for digit in raw["digit"]],
        tendons=[_tendon(tendon, _joint_ranges(raw)) for tendon in raw["tendon"]],
        motors=[_motor(motor) for motor in raw["motor"]],
        sensors=_sensors(sensors) if sensors and (sensors["tendons"] or sensors.get("joints")) else None,
        meshes=tuple(_meshes(raw, folder)),
    )


def _meshes(raw: dict[str, Any], folder: Path) -> Iterator[LinkMesh]:
    """Yield the meshes of a hand, with paths relative to the folder of its file."""
    mount = raw["mount"]
    pose_keys = ("scale", "position_m", "rpy_deg")
    if mount.get("palm_mesh"):
        pose = [mount.get(f"palm_mesh_{key}") for key in pose_keys]
        yield _mesh("palm", folder / mount["palm_mesh"], *pose)
    for digit in raw["digit"]:
        count = len(digit["link_length_m"])
        poses = [digit.get(f"link_mesh_{key}") or [None] * count for key in pose_keys]
        for i, file in enumerate(digit.get("link_mesh") or ()):
            if file:
                pose = [values[i] for values in poses]
                yield _mesh(f"{digit['name']}_link{i + 1}", folder / file, *pose)


def _mesh(link: str, file: Path, scale: Any, position: Any, rpy_deg: Any) -> LinkMesh:
    """Return a mesh. None means no scaling, no shift or no rotation."""
    factors = scale if isinstance(scale, list) else [1.0 if scale is None else scale] * 3
    return LinkMesh(
        link=link,
        file=str(file.absolute()),
        scale=tuple(factors),
        position=tuple(position or (0.0, 0.0, 0.0)),
        rpy_deg=tuple(rpy_deg or (0.0, 0.0, 0.0)),
    )


def _digit(raw: dict[str, Any]) -> Digit:
    count = len(raw["link_length_m"])
    no_springs = [0.0] * count
    for key in (*PER_LINK_KEYS, "joint_axis", "joint_rpy_deg"):
        if key in raw and len(raw[key]) != count:
            what = f"digit {raw['name']}: {key} has {len(raw[key])} values"
            raise SimulatorError(f"{what}; expected {count}, one per link")
    return Digit(
        name=raw["name"],
        carrier=raw.get("mount_on", ""),
        position=tuple(raw["mount_position_m"]),
        rpy_deg=tuple(raw["mount_rpy_deg"]),
        length=tuple(raw["link_length_m"]),
        axis=tuple(map(tuple, raw.get("joint_axis", [(0.0, 0.0, 1.0)] * count))),
        joint_rpy_deg=tuple(map(tuple, raw.get("joint_rpy_deg", [(0.0, 0.0, 0.0)] * count))),
        com=tuple((com, 0.0, 0.0) if isinstance(com, int | float) else tuple(com) for com in raw["link_com_m"]),
        mass=tuple(raw["link_mass_kg"]),
        inertia=tuple(_inertia(raw, i) for i in range(count)),
        radius=raw["link_radius_m"],
        joint_min_deg=tuple(raw["joint_min_deg"]),
        joint_max_deg=tuple(raw["joint_max_deg"]),
        damping=tuple(raw["joint_damping_N_m_s_per_rad"]),
        armature=tuple(raw["joint_armature_kg_m2"]),
        spring=tuple(raw.get("spring_stiffness_N_m_per_rad", no_springs)),
        preload=tuple(raw.get("spring_preload_rad", no_springs)),
    )


def _inertia(raw: dict[str, Any], i: int) -> tuple[float, ...]:
    """Return the six values of the inertia of link i.

    A single number is the moment of inertia of a round bar about y and z.
    """
    value = raw["link_inertia_kg_m2"][i]
    if isinstance(value, int | float):
        # No principal moment of a body is larger than the sum of the other two.
        along = min(raw["link_mass_kg"][i] * raw["link_radius_m"] ** 2 / 2, 2 * value)
        return (along, value, value, 0.0, 0.0, 0.0)
    return tuple(value) if len(value) == 6 else (*value, 0.0, 0.0, 0.0)


def _joint_ranges(raw: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the limits of each joint [rad]."""
    return {
        f"{digit['name']}_j{i + 1}": (math.radians(low), math.radians(high))
        for digit in raw["digit"]
        for i, low in enumerate(digit["joint_min_deg"])
        for high in digit["joint_max_deg"][i : i + 1]
    }


def _curve(raw: dict[str, list[float]], limits: tuple[float, float]) -> ArmCurve:
    """Return a moment arm that depends on the angle. A table becomes a polynomial of least squares.

    Args:
        raw: ``polynomial_m``, or ``angle_deg`` and ``arm_m``.
        limits: limits of the joint [rad].
    """
    powers = raw.get("polynomial_m")
    if powers is None:
        powers = _fit_polynomial([math.radians(angle) for angle in raw["angle_deg"]], raw["arm_m"])
    return ArmCurve(*limits, (*powers, *(0.0,) * (POWERS - len(powers))))


def _fit_polynomial(angles: list[float], arms: list[float]) -> list[float]:
    """Return the least-squares polynomial of a table, by the normal equations."""
    count = min(TABLE_POWERS, len(angles))
    rows = [
        [math.fsum(angle ** (i + j) for angle in angles) for j in range(count)]
        + [math.fsum(arm * angle**i for angle, arm in zip(angles, arms, strict=True))]
        for i in range(count)
    ]
    for k in range(count):
        # The matrix is symmetric and positive definite: elimination needs no other pivot.
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(count):
            if i != k:
                factor = rows[i][k]
                rows[i] = [value - factor * above for value, above in zip(rows[i], rows[k], strict=True)]
    return [row[count] for row in rows]


def _tendon(raw: dict[str, Any], ranges: dict[str, tuple[float, float]]) -> TendonSpec:
    given = raw["moment_arm_m"]
    curves = {
        joint: _curve(arm, ranges.get(joint, (0.0, 1.0))) for joint, arm in given.items() if isinstance(arm, dict)
    }
    return TendonSpec(
        name=raw["name"],
        motor=raw["motor"],
        arms=given | {joint: curve.mean for joint, curve in curves.items()},
        curves=curves,
        stiffness=raw["stiffness_N_per_m"],
        damping=raw["damping_N_s_per_m"],
        knee=raw["knee_N"],
        after_knee_ratio=raw["stiffness_beyond_ratio"],
        knee_width=raw["knee_width_m"],
        friction=raw["friction_coefficient"],
        wrap=raw["wrap_angle_rad"],
        pretension=raw.get("pretension_N", 0.0),
    )


def _motor(raw: dict[str, Any]) -> MotorSpec:
    return MotorSpec(
        name=raw["name"],
        protocol=raw["protocol"],
        bus=raw["bus"],
        node_id=raw["node_id"],
        spool_radius=raw["spool_radius_m"],
        inertia=raw["inertia_kg_m2"],
        viscous=raw["viscous_N_m_s_per_rad"],
        coulomb=raw["coulomb_N_m"],
        torque_constant=raw["torque_constant_N_m_per_A"],
        torque_max=raw["torque_max_N_m"],
        torque_peak=raw["torque_peak_N_m"],
        position_range=raw["position_range_rad"],
        velocity_range=raw["velocity_range_rad_s"],
        direction=raw["direction"],
        zero=raw["zero_rad"],
        options=dict(raw.get("options", {})),
    )


def _sensors(raw: dict[str, Any]) -> SensorSpec:
    return SensorSpec(
        bus=raw["bus"],
        sync_id=raw.get("sync_id", 0x080),
        base_id=raw.get("base_id", 0x1A0),
        tendons=list(raw["tendons"]),
        joints=list(raw.get("joints", ())),
        joint_decimation=raw.get("joint_decimation", 1),
        tension_noise=raw["tension_noise_N"],
        bias_drift=raw["tension_bias_drift_N"],
        joint_noise=raw.get("joint_noise_rad", 1e-3),
        node_ids=tuple(raw["node_ids"]) if raw.get("protocol") == "cia404" else (),
        channels_per_node=raw.get("channels_per_node", 1),
        full_range=raw["range_N"] if raw.get("protocol") == "cia404" else 0.0,
    )
