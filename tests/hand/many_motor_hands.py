"""Hands that have more motors than the packaged hands.

The functions of this module make hands with many motors from the packaged hand jamia11.
"""

from typing import Any

from handctl.hand.hand_loading import hand_content


def fifteen_motor_hand() -> dict[str, Any]:
    """Return the description of a hand with five fingers.

    Each finger has three joints, and each joint has its own motor. The returned hand is jamia11
    without its thumb and with two more fingers.
    """
    raw = hand_content("jamia11")
    entries_by_section = {
        name: [section for section in raw[name] if "thumb" not in section["name"]]
        for name in ("digit", "tendon", "motor")
    }
    for number, name in enumerate(("little", "outer")):
        for section, entries in entries_by_section.items():
            entries += [
                _renamed_section(entry, name) for entry in raw[section] if "index" in entry["name"]
            ]
        entries_by_section["digit"][-1]["mount_position_m"] = [0.0, 0.025, -0.04 - 0.02 * number]
    for node, motor in enumerate(entries_by_section["motor"], start=1):
        motor["node_id"] = node
    tendons, joints = [tendon["name"] for tendon in entries_by_section["tendon"]], []
    for digit in entries_by_section["digit"]:
        joints += [f"{digit['name']}_j{i + 1}" for i in range(len(digit["link_length_m"]))]
    node = raw["sensor_node"] | {"tendons": tendons, "joints": joints}
    return raw | entries_by_section | {"name": "fifteen", "sensor_node": node}


def _renamed_section(section: Any, finger_name: str) -> Any:
    """Copy a section of a hand file, and replace the finger name "index" by another finger name."""
    if isinstance(section, dict):
        return {
            _renamed_section(key, finger_name): _renamed_section(value, finger_name)
            for key, value in section.items()
        }
    if isinstance(section, list):
        return [_renamed_section(value, finger_name) for value in section]
    return section.replace("index", finger_name) if isinstance(section, str) else section
