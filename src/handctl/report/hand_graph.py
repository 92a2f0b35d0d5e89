"""Picture of the structure of a hand.

The picture contains the buses, the motors with their spools, the load cells, the tendons, and the
joints with encoders. The picture shows each digit as a chain of links. Below the chain, the picture
has a row for each tendon of the digit. The row of a tendon shows the bus, the motor, the spool, the
load cell, and then the joints that the tendon crosses. The moment arm of the tendon is written at
each joint.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from handctl.hand.description import Hand
from handctl.hand.file.section_models import Digit, Tendon
from handctl.hand.moment_arms import moment_arm_polynomial, moment_arms_at
from handctl.output_files import save_figure
from handctl.printing import printable_text

BUS_COLOURS = ("#3b6fb6", "#d9822b", "#3c9d5d", "#b8436f", "#7a5fb5", "#8a8a2a")
"""Colours of the buses, in the order of the hand file."""
FLEXOR_COLOUR = "#333333"
EXTENSOR_COLOUR = "#d01c1c"
LINK_COLOUR = "#b9c3cf"
LOAD_CELL_COLOUR = "#d9822b"
ENCODER_COLOUR = "#3c9d5d"
"""Colour of the joint encoders.

The constants above are the colours of flexors, extensors, links and load cells.
"""
MOTOR_COLUMN_X = 0.0
LOAD_CELL_COLUMN_X = 1.5
FIRST_JOINT_COLUMN_X = 3.0
JOINT_SPACING = 1.7
BUS_SPACING = 0.35
"""Horizontal distance of two buses in the picture.

The constants above are the columns of the motor, the load cell and the first joint, and the
distance between two joints.
"""
ROW_HEIGHT_IN = 0.42
"""Height of a row of the picture [inch]."""


def draw_hand(path: Path, hand: Hand) -> None:
    """Draw the picture of a hand as PNG, SVG or PDF, according to the suffix of the file.

    Args:
        path: path of the file to write.
        hand: hand to draw.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = sum(1.6 + len(_digit_tendons(hand, digit)) for digit in hand.digit) + 1.0
    joints = max(len(digit.joints) for digit in hand.digit)
    left_edge_x = MOTOR_COLUMN_X - 1.6 - BUS_SPACING * len(hand.bus)
    right_edge_x = FIRST_JOINT_COLUMN_X + JOINT_SPACING * joints + 0.6
    figure = Figure(
        figsize=(1.05 * (right_edge_x - left_edge_x), ROW_HEIGHT_IN * rows + 0.5),
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_xlim(left_edge_x, right_edge_x)
    axes.set_ylim(-rows, 0.4)
    axes.set_axis_off()
    title = printable_text(f"{hand.name}: {hand.description}", 100)
    axes.set_title(title, fontsize=10, loc="left", parse_math=False)
    bus_ends = {name: [0.0, 0.0] for name in hand.bus_names}
    y = -_sensor_node(axes, hand)
    for digit in hand.digit:
        y = _draw_digit(axes, hand, digit, y, bus_ends) - 0.6
    _draw_buses(axes, hand, bus_ends)
    save_figure(figure, path)


def text_graph(hand: Hand) -> str:
    """Return the structure of a hand as text, with one line for each tendon."""
    node = hand.sensor_node
    lines = []
    for bus in hand.bus:
        data_phase_text = (
            f", data phase {bus.data_bitrate / 1e6:g} Mbit/s" if bus.data_bitrate else ""
        )
        motors = sum(motor.bus == bus.name for motor in hand.motor)
        sensors = ""
        if node.bus == bus.name:
            counts = f"{len(node.tendons)} load cells and {len(node.joints)} joint encoders"
            sensors = f", {_sensors_text(hand)} with {counts}"
        lines.append(
            f"bus {bus.name}: {bus.bitrate / 1e6:g} Mbit/s{data_phase_text}, {motors} motors{sensors}"
        )
    for digit in hand.digit:
        joints = " - ".join(
            f"{'(' if joint in node.joints else ''}j{i + 1}{')' if joint in node.joints else ''} {1e3 * length:g} mm"
            for i, (joint, length) in enumerate(zip(digit.joints, digit.link_length_m, strict=True))
        )
        lines += ["", f"{digit.name}: {joints}"]
        for tendon in _digit_tendons(hand, digit):
            motor = hand.motor_of_tendon(tendon.name)
            cell = " -[load cell]" if tendon.name in node.tendons else ""
            moment_arms_text = "  ".join(
                f"{joint.removeprefix(f'{digit.name}_')} {_moment_arm_text(hand, tendon, joint, '+')}"
                for joint in tendon.arms
            )
            drive = (
                f"{motor.bus}:{motor.node_id} {motor.protocol} "
                f"{motor.name} (spool {1e3 * motor.spool_radius_m:g} mm)"
            )
            lines.append(f"  {drive}{cell}- {_tendon_label(tendon)}: {moment_arms_text}")
    if any(joint in node.joints for joint in hand.joints):
        lines += ["", "(j1): a joint with an encoder"]
    return "\n".join(lines)


def _sensors_text(hand: Hand) -> str:
    """Return the kind of a hand's sensor node as text."""
    node = hand.sensor_node
    if not node.is_cia404:
        return "sensor node"
    return f"CiA 404 amplifiers {', '.join(f'0x{number:02X}' for number in node.node_ids)}"


def _moment_arm_text(hand: Hand, tendon: Tendon, joint: str, sign: str = "") -> str:
    """Return a moment arm in mm as text.

    If ``sign`` is "+", a positive moment arm is written with a plus sign.

    If the moment arm depends on the joint angle, the text contains the values at both joint limits.
    """
    arm = tendon.arms[joint]
    if joint in tendon.excursion_ratio:
        return f"{arm:{sign}g} m/m"
    if not isinstance(arm, dict):
        return f"{1e3 * arm:{sign}g} mm"
    limits = hand.joint_limits[:, [hand.joints.index(joint)]]
    moment_arms_at_joint_limits = moment_arms_at(
        moment_arm_polynomial(arm)[None, None], limits, limits
    ).ravel()
    return f"{1e3 * moment_arms_at_joint_limits[0]:{sign}.3g}..{1e3 * moment_arms_at_joint_limits[1]:.3g} mm"


def _digit_tendons(hand: Hand, digit: Digit) -> list[Tendon]:
    """Return the tendons that cross at least one joint of a digit."""
    return [tendon for tendon in hand.tendon if not tendon.arms.keys().isdisjoint(digit.joints)]


def _tendon_label(tendon: Tendon) -> str:
    """Return the label of a tendon.

    For a tendon in a spool pair, the label contains the name and the pretension of the tendon. For
    any other tendon, the label contains only the name.
    """
    if tendon.pretension_N is None:
        return tendon.name
    return f"{tendon.name}, pair, {tendon.pretension_N:g} N"


def _joint_xs(digit: Digit) -> Iterator[tuple[str, float]]:
    """Yield the name of each joint of a digit, with the column of the joint in the picture."""
    for i, joint in enumerate(digit.joints):
        yield joint, FIRST_JOINT_COLUMN_X + JOINT_SPACING * i


def _sensor_node(axes: Any, hand: Hand) -> float:
    """Draw the legend for load cells and joint encoders, and return the height of the legend in rows."""
    node = hand.sensor_node
    text = f"{_sensors_text(hand)} on {node.bus}, SYNC 0x{node.sync_id:X}: {len(node.tendons)} load cells"
    axes.plot(FIRST_JOINT_COLUMN_X, -0.1, "s", color=LOAD_CELL_COLOUR, markersize=7)
    axes.text(FIRST_JOINT_COLUMN_X + 0.2, -0.1, text, va="center", fontsize=7.5)
    axes.plot(
        FIRST_JOINT_COLUMN_X,
        -0.6,
        "o",
        color="white",
        markeredgecolor=ENCODER_COLOUR,
        markeredgewidth=2,
        markersize=8,
    )
    axes.text(
        FIRST_JOINT_COLUMN_X + 0.2,
        -0.6,
        f"{len(node.joints)} joint encoders",
        va="center",
        fontsize=7.5,
    )
    return 1.5


def _draw_digit(
    axes: Any, hand: Hand, digit: Digit, y: float, line_ends: dict[str, list[float]]
) -> float:
    """Draw a digit at row ``y``, draw its tendons below the digit, and return the next free row."""
    columns = dict(_joint_xs(digit))
    axes.text(
        FIRST_JOINT_COLUMN_X - 0.35,
        y,
        digit.name,
        ha="right",
        va="center",
        fontsize=9,
        weight="bold",
    )
    for (joint, x), length in zip(columns.items(), digit.link_length_m, strict=True):
        axes.plot(
            [x, x + JOINT_SPACING],
            [y, y],
            color=LINK_COLOUR,
            linewidth=7,
            solid_capstyle="round",
            zorder=1,
        )
        axes.text(
            x + JOINT_SPACING / 2,
            y,
            f"{1e3 * length:g} mm",
            ha="center",
            va="center",
            fontsize=7,
            zorder=3,
        )
        edge_colour, width = (
            (ENCODER_COLOUR, 2.0) if joint in hand.sensor_node.joints else ("#555555", 1.0)
        )
        axes.plot(
            x,
            y,
            "o",
            color="white",
            markeredgecolor=edge_colour,
            markeredgewidth=width,
            markersize=9,
            zorder=3,
        )
        axes.text(
            x, y + 0.35, joint.removeprefix(f"{digit.name}_"), ha="center", va="center", fontsize=7
        )
    for tendon in _digit_tendons(hand, digit):
        y -= 1.0
        _draw_tendon(axes, hand, tendon, columns, y)
        motor = hand.motor_of_tendon(tendon.name)
        line_ends[motor.bus][0] = line_ends[motor.bus][0] or y
        line_ends[motor.bus][1] = y
    return y - 1.0


def _draw_tendon(
    axes: Any, hand: Hand, tendon: Tendon, column_x: dict[str, float], y: float
) -> None:
    """Draw the row of a tendon, from the bus of the motor to the last joint that the tendon crosses."""
    motor = hand.motor_of_tendon(tendon.name)
    bus = hand.bus_names.index(motor.bus)
    colour = BUS_COLOURS[bus % len(BUS_COLOURS)]
    mean_moment_arms = hand.moment_arms[hand.tendon.index(tendon)]
    moment_arm_by_joint = {
        joint: mean_moment_arms[hand.joints.index(joint)]
        for joint in tendon.arms
        if joint in column_x
    }
    last_column = max(column_x[joint] for joint in moment_arm_by_joint)
    axes.plot([_bus_x(bus), MOTOR_COLUMN_X], [y, y], color=colour, linewidth=1.2, zorder=1)
    axes.plot(
        [MOTOR_COLUMN_X, last_column + 0.45], [y, y], color=FLEXOR_COLOUR, linewidth=1.0, zorder=1
    )
    axes.plot(last_column + 0.45, y, "|", color=FLEXOR_COLOUR, markersize=8)
    axes.plot(
        MOTOR_COLUMN_X,
        y,
        "o",
        color="white",
        markeredgecolor=colour,
        markeredgewidth=1.6,
        markersize=15,
        zorder=2,
    )
    axes.text(MOTOR_COLUMN_X, y, f"{motor.node_id}", ha="center", va="center", fontsize=7, zorder=3)
    motor_text = f"{motor.name}, {motor.protocol}, spool {1e3 * motor.spool_radius_m:g} mm"
    axes.text(MOTOR_COLUMN_X + 0.2, y + 0.25, motor_text, ha="left", va="center", fontsize=6.5)
    if tendon.name in hand.sensor_node.tendons:
        axes.plot(LOAD_CELL_COLUMN_X, y, "s", color=LOAD_CELL_COLOUR, markersize=7, zorder=2)
    axes.text(
        LOAD_CELL_COLUMN_X + 0.15,
        y - 0.27,
        _tendon_label(tendon),
        ha="left",
        va="center",
        fontsize=6.5,
    )
    for joint, arm in moment_arm_by_joint.items():
        # The moment arm of a flexor is written below the joint, and the moment arm of an extensor
        # above it.
        side = -1.0 if arm > 0.0 else 1.0
        joint_colour = FLEXOR_COLOUR if arm > 0.0 else EXTENSOR_COLOUR
        axes.plot(column_x[joint], y, "o", color=joint_colour, markersize=4.5, zorder=2)
        axes.text(
            column_x[joint], y + 0.3 * side, _moment_arm_text(hand, tendon, joint), ha="center", va="center",
            fontsize=7, color=joint_colour,
        )  # fmt: skip


def _bus_x(bus: int) -> float:
    """Return the column of a bus in the picture."""
    return MOTOR_COLUMN_X - 0.9 - BUS_SPACING * bus


def _draw_buses(axes: Any, hand: Hand, line_ends: dict[str, list[float]]) -> None:
    """Draw each bus as a vertical line that connects the motors on the bus.

    The name and the bit rates of the bus are written next to the line.
    """
    for i, bus in enumerate(hand.bus):
        x = _bus_x(i)
        top_y, bottom = line_ends[bus.name]
        colour = BUS_COLOURS[i % len(BUS_COLOURS)]
        axes.plot(
            [x, x], [top_y + 0.4, bottom - 0.4], color=colour, linewidth=3, solid_capstyle="round"
        )
        rates = f"{bus.bitrate / 1e6:g}" + (
            f"/{bus.data_bitrate / 1e6:g}" if bus.data_bitrate else ""
        )
        label = f"{bus.name}, {rates} Mbit/s"
        axes.text(
            x - 0.12,
            (top_y + bottom) / 2,
            label,
            rotation=90,
            ha="right",
            va="center",
            fontsize=7.5,
            color=colour,
        )
