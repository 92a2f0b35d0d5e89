"""Part of a hand file that describes the drives found by a scan.

This part of the hand file contains the values that the drives report. The values that the user must
measure are marked in this part of the hand file.
"""

from collections.abc import Mapping, Sequence

from handctl.drives.discovery import DiscoveredNode
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES
from handctl.hand.file.quantity_types import MAX_TORQUE_N_M
from handctl.hand.file.section_models import CIA404_PROTOCOL

SnippetEntry = tuple[str, object, str]
"""Key, value and comment of one line of the hand file."""
USER_VALUE_COMMENT = "yours: "
DRIVE_LIMIT_HINT = "begin small, drive_limit_N x spool_radius_m"
DEFAULT_RATED_TORQUE_N_M = 0.1
ENCODER_COUNTS = 65536


def hand_file_snippet(
    buses: Mapping[str, Sequence[DiscoveredNode]], bitrate: int, data_bitrate: int | None
) -> str:
    """Return the ``[[bus]]`` and ``[[motor]]`` sections of a hand file for the scanned drives.

    Args:
        buses: drives found on each bus, by name of the bus.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: bit rate of the data phase of CAN FD [bit/s], or None.
    """
    lines = [
        "# From `handctl scan`. Values that a drive reported are marked; measure the others before arming."
    ]
    for name in buses:
        rates: list[SnippetEntry] = [("name", name, ""), ("bitrate", bitrate, "")]
        if data_bitrate:
            rates.append(("data_bitrate", data_bitrate, ""))
        lines += ["", "[[bus]]", *map(_toml_line, rates)]
    for bus, nodes in buses.items():
        for drive in nodes:
            if drive.protocol in PROTOCOL_ENTRIES and 0 < drive.node_id <= 0x7F:
                lines += ["", *_motor_section(bus, drive)]
    for bus, nodes in buses.items():
        amplifiers = [node for node in nodes if node.protocol == CIA404_PROTOCOL]
        if amplifiers:
            lines += ["", *_amplifier_section(bus, amplifiers)]
    return "\n".join(lines) + "\n"


def _amplifier_section(bus: str, amplifiers: Sequence[DiscoveredNode]) -> list[str]:
    """Return the section of a hand file that describes the load cells of the measuring amplifiers on a bus."""
    channels = min(int(node.options.get("channels_per_node", 1)) for node in amplifiers)
    entries: list[SnippetEntry] = [
        ("protocol", CIA404_PROTOCOL, ""),
        ("bus", bus, ""),
        ("channels_per_node", channels, "reported by the amplifier"),
        ("range_N", 300.0, USER_VALUE_COMMENT + "rated load of the load cells"),
        ("tension_noise_N", 0.5, USER_VALUE_COMMENT + "measure"),
        ("tension_bias_drift_N", 1.0, USER_VALUE_COMMENT + "data sheet, in 100 s"),
    ]
    numbers = ", ".join(f"0x{node.node_id:02X}" for node in amplifiers)
    return [
        "[sensor_node]",
        *map(_toml_line, entries),
        f"node_ids = [{numbers}]",
        f"tendons = []    # {USER_VALUE_COMMENT}the tendon of each channel, in this order",
    ]


def _motor_section(bus: str, drive: DiscoveredNode) -> list[str]:
    source_text = "reported by the drive"
    settings = drive.settings
    torque = min(settings.get("torque_max_N_m", 0.1), MAX_TORQUE_N_M)
    entries: list[SnippetEntry] = [
        ("name", f"{bus}_{drive.protocol}_{drive.node_id}", USER_VALUE_COMMENT + "a name"),
        ("protocol", drive.protocol, ""),
        ("bus", bus, ""),
        ("node_id", drive.node_id, source_text),
        ("spool_radius_m", 0.005, USER_VALUE_COMMENT + "measure"),
        ("inertia_kg_m2", 1.3e-4, USER_VALUE_COMMENT + "of rotor and gear, at the spool"),
        ("viscous_N_m_s_per_rad", 1e-3, USER_VALUE_COMMENT + "measure"),
        ("coulomb_N_m", 0.015, USER_VALUE_COMMENT + "measure"),
        ("torque_constant_N_m_per_A", 0.26, USER_VALUE_COMMENT + "data sheet, at the spool"),
        ("torque_max_N_m", torque, _torque_source(settings)),
        ("torque_peak_N_m", torque, USER_VALUE_COMMENT + "what the motor itself can do"),
        ("position_range_rad", settings.get("position_range_rad", 12.5),
         _source_comment("position_range_rad", settings, "")),
        ("velocity_range_rad_s", settings.get("velocity_range_rad_s", 30.0),
         _source_comment("velocity_range_rad_s", settings, "limit of the drive")),
        ("direction", 1, USER_VALUE_COMMENT + "-1 if positive torque unwinds"),
        ("zero_rad", 0.0, ""),
        ("watchdog_ms", 50, ""),
    ]  # fmt: skip
    options = _option_lines(drive)
    notes = [f"# {note}" for note in drive.notes]
    return [
        "[[motor]]",
        *notes,
        *map(_toml_line, entries),
        *(["[motor.options]", *map(_toml_line, options)] if options else []),
    ]


def _source_comment(key: str, settings: Mapping[str, float], hint: str) -> str:
    return "reported by the drive" if key in settings else USER_VALUE_COMMENT + hint if hint else ""


def _torque_source(settings: Mapping[str, float]) -> str:
    """Return the comment that the hand file contains next to the torque limit.

    The largest torque that a drive reports is the full scale of its torque values. For a first
    torque limit, the full scale is too large.
    """
    reported_torque = settings.get("torque_max_N_m", 0.0)
    if not reported_torque:
        return USER_VALUE_COMMENT + DRIVE_LIMIT_HINT
    source = "full scale reported by the drive"
    if reported_torque > MAX_TORQUE_N_M:
        source = f"the drive reports the full scale {reported_torque:g}, a hand file takes at most {MAX_TORQUE_N_M:g}"
    return f"{source}; {USER_VALUE_COMMENT}{DRIVE_LIMIT_HINT}"


def _option_lines(drive: DiscoveredNode) -> list[SnippetEntry]:
    entries: list[SnippetEntry] = [
        (key, value, drive.origins.get(key, "reported by the drive"))
        for key, value in drive.options.items()
    ]
    if drive.protocol == "cia402":
        for key, value, location in (
            ("rated_torque_N_m", DEFAULT_RATED_TORQUE_N_M, "0x6076"),
            ("counts_per_turn", ENCODER_COUNTS, "0x608F"),
        ):
            if key not in drive.options:
                entries.append((key, value, f"{USER_VALUE_COMMENT}{location} and the data sheet"))
    return entries


def _toml_line(entry: SnippetEntry) -> str:
    key, value, comment = entry
    text = (
        str(value).lower()
        if isinstance(value, bool)
        else f'"{value}"'
        if isinstance(value, str)
        else repr(value)
    )
    return f"{key} = {text}" + (f"    # {comment}" if comment else "")
