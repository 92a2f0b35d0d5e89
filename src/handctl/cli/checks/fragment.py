"""A piece of a hand file for drives that were found: what they told, and places for what only a person can measure."""

from collections.abc import Mapping, Sequence

from handctl.drives.discovery import DiscoveredNode
from handctl.drives.registry import PROTOCOLS

Entry = tuple[str, object, str]
"""Key, value, comment."""
ASKED = "yours: "
TORQUE_TOP = 50.0
"""Largest torque that a hand file takes [N m]."""
RATED_N_M, COUNTS = 0.1, 65536


def fragment(buses: Mapping[str, Sequence[DiscoveredNode]], bitrate: int, data_bitrate: int | None) -> str:
    """``[[bus]]`` and ``[[motor]]`` sections of what was found.

    Args:
        buses: drives by the name of their bus.
        bitrate, data_bitrate: nominal, and of CAN FD's data phase [bit/s].
    """
    lines = ["# From `handctl scan`. What a drive told is marked so; measure the rest before arming."]
    for name in buses:
        rates: list[Entry] = [("name", name, ""), ("bitrate", bitrate, "")]
        if data_bitrate:
            rates.append(("data_bitrate", data_bitrate, ""))
        lines += ["", "[[bus]]", *map(_line, rates)]
    for bus, found in buses.items():
        for drive in found:
            if drive.protocol in PROTOCOLS and 0 < drive.node_id <= 0x7F:
                lines += ["", *_motor(bus, drive)]
    return "\n".join(lines) + "\n"


def _motor(bus: str, drive: DiscoveredNode) -> list[str]:
    told, settings = "told by the drive", drive.settings
    torque = min(settings.get("torque_max_N_m", 0.1), TORQUE_TOP)
    entries: list[Entry] = [
        ("name", f"{bus}_{drive.protocol}_{drive.node_id}", ASKED + "a name"),
        ("protocol", drive.protocol, ""),
        ("bus", bus, ""),
        ("node_id", drive.node_id, told),
        ("spool_radius_m", 0.005, ASKED + "measure"),
        ("inertia_kg_m2", 1.3e-4, ASKED + "of rotor and gear, at the spool"),
        ("viscous_N_m_s_per_rad", 1e-3, ASKED + "measure"),
        ("coulomb_N_m", 0.015, ASKED + "measure"),
        ("torque_constant_N_m_per_A", 0.26, ASKED + "data sheet, at the spool"),
        ("torque_max_N_m", torque, _source("torque_max_N_m", settings, "begin small")),
        ("torque_peak_N_m", torque, ASKED + "what the motor itself can do"),
        ("position_range_rad", settings.get("position_range_rad", 12.5), _source("position_range_rad", settings, "")),
        ("velocity_range_rad_s", settings.get("velocity_range_rad_s", 30.0),
         _source("velocity_range_rad_s", settings, "limit of the drive")),
        ("direction", 1, ASKED + "-1 if positive torque unwinds"),
        ("zero_rad", 0.0, ""),
        ("watchdog_ms", 50, ""),
    ]  # fmt: skip
    options = _options(drive)
    notes = [f"# {note}" for note in drive.notes]
    return ["[[motor]]", *notes, *map(_line, entries), *(["[motor.options]", *map(_line, options)] if options else [])]


def _source(key: str, settings: Mapping[str, float], hint: str) -> str:
    return "told by the drive" if key in settings else ASKED + hint if hint else ""


def _options(drive: DiscoveredNode) -> list[Entry]:
    entries: list[Entry] = [(key, value, "told by the drive") for key, value in drive.options.items()]
    if drive.protocol == "cia402":
        for key, value, where in (("rated_torque_N_m", RATED_N_M, "0x6076"), ("counts_per_turn", COUNTS, "0x608F")):
            if key not in drive.options:
                entries.append((key, value, f"{ASKED}{where} and the data sheet"))
    return entries


def _line(entry: Entry) -> str:
    key, value, comment = entry
    text = str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else repr(value)
    return f"{key} = {text}" + (f"    # {comment}" if comment else "")
