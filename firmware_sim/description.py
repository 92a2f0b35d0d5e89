"""What the simulator needs of a hand, read from its TOML file with the standard library only."""

import importlib.util
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any


class SimulatorError(ValueError):
    """Something the person who started the simulator can put right; its text is one line."""


@dataclass(frozen=True, slots=True)
class Digit:
    """One finger or thumb; tuples have one entry per joint."""

    name: str
    position: tuple[float, float, float]
    """Of the first hinge in the palm frame [m]."""
    rpy_deg: tuple[float, float, float]
    """Extrinsic x, y, z [deg]."""
    length: tuple[float, ...]
    com: tuple[float, ...]
    mass: tuple[float, ...]
    inertia: tuple[float, ...]
    """About the link's centre of mass, along the hinge [kg m2]."""
    radius: float
    joint_min_deg: tuple[float, ...]
    joint_max_deg: tuple[float, ...]
    damping: tuple[float, ...]
    armature: tuple[float, ...]
    spring: tuple[float, ...]
    """[N m/rad]."""
    preload: tuple[float, ...]
    """[rad]."""

    @property
    def joints(self) -> list[str]:
        """The joints' names, from the palm outwards."""
        return [f"{self.name}_j{i + 1}" for i in range(len(self.length))]


@dataclass(frozen=True, slots=True)
class TendonSpec:
    """One tendon: its routing, its rope and its friction."""

    name: str
    motor: str
    arms: dict[str, float]
    """Joint name to moment arm [m]."""
    stiffness: float
    damping: float
    knee: float
    """Tension up to which the rope is linear [N]."""
    beyond_ratio: float
    knee_width: float
    friction: float
    wrap: float


@dataclass(frozen=True, slots=True)
class MotorSpec:
    """One motor; quantities at the spool."""

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
    """Serial number of the drive; None: as its protocol's simulated drives have it."""
    torque_gain: float = 1.0
    """Torque that really appears over the torque that the drive believes; 1 unless perturbed."""


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """The sensor node."""

    bus: str
    sync_id: int
    base_id: int
    tendons: list[str]
    joints: list[str]
    joint_decimation: int
    tension_noise: float
    bias_drift: float
    """Random walk: its standard deviation after 100 s [N]."""
    joint_noise: float
    tension_bias: float = 0.0
    """Constant error of every load cell [N]; 0 unless perturbed."""


@dataclass(frozen=True, slots=True)
class Hand:
    """A whole hand."""

    name: str
    gravity: tuple[float, float, float]
    buses: list[str]
    bitrates: list[tuple[int, int]]
    """Of each bus: nominal and, for CAN FD or else 0, of the data phase [bit/s]."""
    digits: list[Digit]
    tendons: list[TendonSpec]
    motors: list[MotorSpec]
    sensors: SensorSpec | None

    @property
    def joints(self) -> list[str]:
        """All joints' names in the order of the digits."""
        return [joint for digit in self.digits for joint in digit.joints]


def find_hand(name_or_path: str) -> Path:
    """Return the file of a packaged hand (a bare name) or of a path.

    Raises:
        SimulatorError: there is no such file.
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
    """Read a hand file.

    Raises:
        SimulatorError: the file is missing, is not TOML, or lacks a key.
    """
    path = find_hand(name_or_path)
    try:
        return _hand(tomllib.loads(path.read_text("utf-8")))
    except OSError as error:
        raise SimulatorError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # also of a number without end, and of text that is not UTF-8
        raise SimulatorError(f"{path}: not TOML: {error}") from error
    except (KeyError, TypeError, AttributeError) as error:
        raise SimulatorError(f"{path}: not a complete hand: missing or wrong key {error}") from error


def _hand(raw: dict[str, Any]) -> Hand:
    sensors = raw.get("sensor_node")
    return Hand(
        name=raw["name"],
        gravity=tuple(raw["mount"]["gravity_m_s2"]),
        buses=[bus["name"] for bus in raw["bus"]],
        bitrates=[(bus["bitrate"], bus.get("data_bitrate") or 0) for bus in raw["bus"]],
        digits=[_digit(digit) for digit in raw["digit"]],
        tendons=[_tendon(tendon) for tendon in raw["tendon"]],
        motors=[_motor(motor) for motor in raw["motor"]],
        sensors=_sensors(sensors) if sensors else None,
    )


def _digit(raw: dict[str, Any]) -> Digit:
    return Digit(
        name=raw["name"],
        position=tuple(raw["mount_position_m"]),
        rpy_deg=tuple(raw["mount_rpy_deg"]),
        length=tuple(raw["link_length_m"]),
        com=tuple(raw["link_com_m"]),
        mass=tuple(raw["link_mass_kg"]),
        inertia=tuple(raw["link_inertia_kg_m2"]),
        radius=raw["link_radius_m"],
        joint_min_deg=tuple(raw["joint_min_deg"]),
        joint_max_deg=tuple(raw["joint_max_deg"]),
        damping=tuple(raw["joint_damping_N_m_s_per_rad"]),
        armature=tuple(raw["joint_armature_kg_m2"]),
        spring=tuple(raw["spring_stiffness_N_m_per_rad"]),
        preload=tuple(raw["spring_preload_rad"]),
    )


def _tendon(raw: dict[str, Any]) -> TendonSpec:
    return TendonSpec(
        name=raw["name"],
        motor=raw["motor"],
        arms=dict(raw["moment_arm_m"]),
        stiffness=raw["stiffness_N_per_m"],
        damping=raw["damping_N_s_per_m"],
        knee=raw["knee_N"],
        beyond_ratio=raw["stiffness_beyond_ratio"],
        knee_width=raw["knee_width_m"],
        friction=raw["friction_coefficient"],
        wrap=raw["wrap_angle_rad"],
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
        sync_id=raw["sync_id"],
        base_id=raw["base_id"],
        tendons=list(raw["tendons"]),
        joints=list(raw["joints"]),
        joint_decimation=raw["joint_decimation"],
        tension_noise=raw["tension_noise_N"],
        bias_drift=raw["tension_bias_drift_N"],
        joint_noise=raw["joint_noise_rad"],
    )
