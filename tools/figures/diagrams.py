"""Draw the diagrams of the documentation: architecture, control law, wiring, tendon, and modes of the hand."""

from typing import Any

from tools.figures.shapes import (
    draw_area,
    draw_arrow,
    draw_block,
    draw_circle,
    draw_note,
    new_plane,
)
from tools.figures.style import DIGIT_COLOURS, FAULT_COLOUR, INK_COLOUR


def architecture_diagram() -> Any:
    """Draw the architecture of handctl: the processes and files of a run."""
    figure, axes = new_plane(8.6, 4.6, (17.2, 9.2))
    draw_area(axes, (4.0, 2.7), (6.2, 6.2), "controller: one process, one thread")
    draw_block(axes, (0.2, 6.8), (3.0, 1.2), "command line\nrun, stop, gains set")
    draw_block(axes, (0.2, 4.9), (3.0, 1.2), "Python client\nhandctl.connect")
    draw_block(
        axes, (4.4, 6.5), (5.4, 1.5), "tick(): a pure function\nestimate · judge · decide · command"
    )
    draw_block(axes, (4.4, 4.7), (2.5, 1.2), "clock\nabsolute deadlines")
    draw_block(axes, (7.3, 4.7), (2.5, 1.2), "mailbox\nrequests, state")
    draw_block(axes, (4.4, 3.0), (5.4, 1.1), "buses: bytes in records of 80 bytes", "wire")
    draw_block(axes, (11.6, 6.6), (2.6, 1.3), "recorder\na process", "log")
    draw_block(axes, (11.6, 4.6), (2.6, 1.3), "log\nMCAP file", "log")
    draw_block(axes, (14.8, 6.6), (2.2, 1.3), "view, report\nexports", "log")
    draw_block(axes, (14.8, 4.6), (2.2, 1.3), "replay\nidentify, tune", "log")
    draw_block(axes, (4.0, 0.3), (4.4, 1.4), "hardware\ndrives, sensor node", "hardware")
    draw_block(
        axes,
        (9.2, 0.3),
        (5.0, 1.4),
        "firmware_sim: drives, sensors,\nMuJoCo; shares no code",
        "hardware",
    )
    draw_arrow(axes, [(3.2, 7.4), (3.7, 7.4), (3.7, 4.45), (8.5, 4.45), (8.5, 4.7)])
    draw_arrow(axes, [(3.2, 5.5), (3.7, 5.5)])
    draw_arrow(axes, [(5.6, 5.9), (5.6, 6.5)], "TickIn", (6.3, 6.2))
    draw_arrow(axes, [(8.5, 5.9), (8.5, 6.5)])
    draw_arrow(axes, [(5.2, 4.1), (5.2, 4.7)])
    draw_arrow(axes, [(4.4, 7.2), (4.2, 7.2), (4.2, 3.55), (4.4, 3.55)])
    draw_note(axes, (4.28, 4.3), "frames", fontsize=7)
    draw_arrow(axes, [(9.8, 7.25), (11.6, 7.25)], "every tick", (10.9, 7.45))
    draw_arrow(axes, [(12.9, 6.6), (12.9, 5.9)])
    draw_arrow(axes, [(14.2, 5.5), (14.5, 5.5), (14.5, 7.25), (14.8, 7.25)])
    draw_arrow(axes, [(14.2, 5.1), (14.8, 5.1)])
    draw_arrow(axes, [(5.6, 3.0), (5.6, 1.7)], "SocketCAN", (6.5, 2.25), two_heads=True)
    draw_arrow(
        axes,
        [(9.5, 3.0), (9.5, 1.7)],
        "embedded bus,\nvcan, or lockstep",
        (11.1, 2.25),
        two_heads=True,
    )
    return figure


def control_law_diagram() -> Any:
    """Draw the control law of a tendon as a block diagram, with the symbols of the equations."""
    figure, axes = new_plane(9.2, 5.9, (18.4, 11.8))
    draw_block(axes, (0.2, 6.4), (2.3, 1.3), "setpoint\n$q_d,\\ \\dot q_d,\\ \\ddot q_d$")
    draw_block(axes, (3.3, 6.4), (3.2, 1.3), "inverse dynamics\n$M\\ddot q_d + h(q_d,\\dot q_d)$")
    draw_block(axes, (7.3, 6.4), (3.0, 1.3), "allocation\n$R^T f = \\tau,\\ f \\geq f_{min}$")
    draw_block(axes, (11.1, 6.4), (2.4, 1.3), "pulley friction\n$f_0 = f / \\eta$")
    draw_block(axes, (3.3, 8.3), (3.2, 1.2), "excursion\n$s_d = R\\,q_d$")
    draw_block(
        axes,
        (7.3, 8.3),
        (6.2, 1.2),
        "motion feedback\n$(m_m + m_l)\\,[k\\,(s_d - s) + d\\,(\\dot s_d - v)] + K_f\\,(f_0 - \\hat f)$",
    )
    draw_block(axes, (7.3, 10.0), (6.2, 1.2), "feedforward of rotor and friction\n"
          "$c_i\\,m_m\\,\\ddot s_d + c_f\\,(b_m v + F(\\dot s_d))$")  # fmt: skip
    draw_block(
        axes,
        (7.3, 4.3),
        (6.2, 1.3),
        "tension loop (hold)\n$f_{set} + K\\,(f_{set} - \\hat f) - K_v v + \\int$",
        "safety",
    )
    draw_block(axes, (0.2, 4.3), (2.3, 1.3), "setpoint\ntension $f_{set}$")
    draw_circle(axes, (14.6, 7.05), 0.35, "host", "+")
    draw_block(
        axes, (15.4, 6.2), (2.8, 1.7), "limits, envelope\nof relaxing,\ncheck of frames", "safety"
    )
    draw_block(axes, (15.4, 3.9), (2.8, 1.3), "drive and spool\n$\\tau_m = r_a u$", "hardware")
    draw_block(axes, (15.4, 1.6), (2.8, 1.3), "tendon, digit,\nobject", "hardware")
    draw_block(
        axes,
        (4.9, 1.2),
        (6.3, 1.9),
        "tension filter, 7 states per tendon\n$\\hat f = k\\,(x - s - o)$,  $v$,  $s$,  $d$,  load-cell error\n"
        "encoder, load cell, joint encoder",
        "host",
    )
    draw_arrow(axes, [(2.5, 7.05), (3.3, 7.05)])
    draw_arrow(axes, [(2.9, 7.05), (2.9, 8.9), (3.3, 8.9)])
    draw_arrow(axes, [(6.5, 7.05), (7.3, 7.05)], "$\\tau$", (6.72, 7.3))
    draw_arrow(axes, [(10.3, 7.05), (11.1, 7.05)], "$f$", (10.7, 7.3))
    draw_arrow(axes, [(13.5, 7.05), (14.25, 7.05)], "$f_0$", (13.9, 7.3))
    draw_arrow(axes, [(6.5, 8.9), (7.3, 8.9)], "$s_d$", (6.7, 9.15))
    draw_arrow(axes, [(7.0, 8.9), (7.0, 10.6), (7.3, 10.6)])
    draw_arrow(axes, [(13.5, 10.6), (14.6, 10.6), (14.6, 7.4)])
    draw_arrow(axes, [(13.5, 8.9), (14.6, 8.9), (14.6, 7.4)])
    draw_arrow(axes, [(2.5, 4.95), (7.3, 4.95)], "$f_{set}$, rate limited")
    draw_arrow(axes, [(13.5, 4.95), (14.6, 4.95), (14.6, 6.7)])
    draw_arrow(axes, [(14.95, 7.05), (15.4, 7.05)], "$u$", (15.15, 7.3))
    draw_arrow(axes, [(16.8, 6.2), (16.8, 5.2)], "torque command\nover CAN", (15.7, 5.7))
    draw_arrow(axes, [(16.8, 3.9), (16.8, 2.9)], "tension $f_0$", (15.95, 3.4))
    draw_arrow(
        axes,
        [(15.4, 2.2), (11.2, 2.2)],
        "load cell, spool angle,\njoint angle: a tick old",
        (13.3, 1.75),
    )
    draw_arrow(axes, [(9.0, 3.1), (9.0, 4.3)], "$\\hat f,\\ v$", (9.75, 3.7))
    draw_arrow(
        axes, [(7.0, 3.1), (7.0, 7.9), (7.9, 7.9), (7.9, 8.3)], "$s,\\ v,\\ \\hat f$", (6.5, 5.7)
    )
    draw_note(
        axes,
        (0.2, 2.9),
        "$c_d\\,\\hat d$ is subtracted from $u$ in both\n"
        "forms. $\\hat d$: disturbance force that\nthe filter estimates",
    )
    draw_note(axes, (0.2, 0.5), "$m_m$, $m_l$: rotor and digit along the tendon.  $F$: friction at the planned speed.  "
         "$\\eta$: efficiency of the pulleys.\n$r_a$: spool radius.  "
         "$o$: stretch offset.  $x$: travel at the spool.", fontsize=8)  # fmt: skip
    return figure


def wiring_diagram() -> Any:
    """Draw the wiring of a hand on a bench: power, CAN, and the emergency stop."""
    figure, axes = new_plane(8.6, 4.4, (17.2, 8.8))
    draw_block(axes, (0.3, 6.6), (2.6, 1.3), "supply\ncurrent limit set", "wire")
    draw_block(axes, (4.0, 6.6), (2.8, 1.3), "emergency stop\nmushroom button", "safety")
    draw_block(axes, (7.9, 6.6), (2.4, 1.3), "contactor\nor relay", "safety")
    draw_block(axes, (11.4, 6.6), (2.4, 1.3), "brake resistor", "wire")
    draw_block(axes, (0.3, 2.6), (2.6, 1.5), "computer\nhandctl")
    draw_block(axes, (4.0, 2.6), (2.8, 1.5), "CAN adapter\ncan0", "wire")
    for i, (x, name) in enumerate(((7.9, "drive 1"), (10.3, "drive 2"), (12.7, "drive n"))):
        draw_block(axes, (x, 3.6), (1.9, 1.3), f"{name}\nown limit", "hardware")
        draw_arrow(axes, [(x + 0.6, 5.7), (x + 0.6, 4.9)], colour=FAULT_COLOUR)
        axes.plot([x + 0.95, x + 0.95], [3.6, 2.4], color=INK_COLOUR, linewidth=1.1)
        draw_note(axes, (x + 1.1, 3.0), f"node {i + 1}" if i < 2 else "node n", fontsize=7)
    draw_block(axes, (15.1, 3.6), (1.9, 1.3), "sensor node\nload cells", "hardware")
    axes.plot([16.05, 16.05], [3.6, 2.4], color=INK_COLOUR, linewidth=1.1)
    axes.plot([8.5, 13.3], [5.7, 5.7], color=FAULT_COLOUR, linewidth=1.6)
    draw_arrow(axes, [(2.9, 7.25), (4.0, 7.25)], colour=FAULT_COLOUR)
    draw_arrow(axes, [(6.8, 7.25), (7.9, 7.25)], "coil", (7.35, 7.5), colour=FAULT_COLOUR)
    draw_arrow(
        axes,
        [(1.6, 7.9), (1.6, 8.4), (9.1, 8.4), (9.1, 7.9)],
        "motor power",
        (5.4, 8.6),
        colour=FAULT_COLOUR,
    )
    axes.plot([9.1, 9.1], [6.6, 5.7], color=FAULT_COLOUR, linewidth=1.6)
    axes.plot([12.6, 12.6], [6.6, 5.7], color=FAULT_COLOUR, linewidth=1.6)
    draw_note(axes, (9.3, 6.15), "motor power, switched", color=FAULT_COLOUR)
    draw_arrow(axes, [(2.9, 3.35), (4.0, 3.35)], "USB", (3.45, 3.6), two_heads=True)
    axes.plot([5.4, 5.4], [2.6, 2.4], color=INK_COLOUR, linewidth=1.1)
    axes.plot([5.4, 16.6], [2.4, 2.4], color=INK_COLOUR, linewidth=2.2)
    for x in (5.4, 16.6):
        draw_block(axes, (x - 0.25, 1.2), (0.5, 0.9), "120\n$\\Omega$", "wire", 6.5)
        axes.plot([x, x], [2.1, 2.4], color=INK_COLOUR, linewidth=1.1)
    draw_note(
        axes,
        (11.0, 2.1),
        "CANH, CANL, GND: a line with two ends, short stubs",
        ha="center",
        va="top",
    )
    draw_note(
        axes,
        (0.3, 0.6),
        "The emergency stop cuts motor power only. Sensor node and adapter keep theirs, so that the "
        "log shows the stop.\n60 ohm between CANH and CANL with the power off. The drive's own current limit is set "
        "before a tendon is attached.",
        fontsize=8,
    )
    return figure


def tendon_diagram() -> Any:
    """Draw motor, spool, load cell, pulleys and joints of a digit, each with its symbol."""
    from matplotlib.patches import Arc

    figure, axes = new_plane(8.6, 2.9, (17.2, 5.8))
    draw_circle(axes, (1.8, 3.4), 1.0, "hardware")
    draw_circle(axes, (1.8, 3.4), 0.12, "wire")
    axes.add_patch(
        Arc((1.8, 3.4), 2.6, 2.6, theta1=100, theta2=200, color=INK_COLOUR, linewidth=1.0)
    )
    draw_note(axes, (0.1, 4.6), "$\\theta_m$, $\\tau_m$")
    draw_arrow(axes, [(1.8, 3.4), (2.5, 2.69)], "$r_a$", (2.35, 3.2))
    draw_note(axes, (1.8, 2.05), "motor and spool\nencoder, inertia $J_m$", ha="center", va="top")
    colour = DIGIT_COLOURS["index"]
    axes.plot([1.8, 4.0], [4.4, 4.4], color=colour, linewidth=2.2)
    draw_block(axes, (4.0, 4.0), (1.5, 0.8), "load cell", "log")
    axes.plot([5.5, 7.6], [4.4, 4.4], color=colour, linewidth=2.2)
    draw_note(axes, (4.75, 5.25), "tension $f_0$, measured here\nand commanded here", ha="center")
    draw_note(axes, (3.3, 3.75), "travel\n$x = r_a\\theta_m$", ha="center")
    axes.plot([6.9, 16.8], [2.6, 2.6], color="#9aa7b2", linewidth=1.0, linestyle=(0, (2, 2)))
    joints = ((8.0, 3.4), (11.0, 3.4), (13.9, 3.4))
    for n, (x, y) in enumerate(joints):
        end = joints[n + 1][0] if n < 2 else 16.3
        axes.plot([x, end], [y, y], color="#c5ced6", linewidth=11, solid_capstyle="round", zorder=0)
        draw_circle(axes, (x, y), 0.95 - 0.12 * n, "wire")
        draw_note(axes, (x, y - 0.1), f"$q_{n + 1}$", ha="center")
        draw_arrow(
            axes,
            [(x, y), (x + 0.62 - 0.08 * n, y + 0.66 - 0.08 * n)],
            f"$r_{n + 1}$",
            (x + 0.5, y + 0.25),
        )
        draw_note(axes, (x, y - 1.35), f"spring $k_{n + 1}$", ha="center")
    axes.plot(
        [7.6, 8.0, 10.9, 11.0, 13.85, 13.9, 15.6],
        [4.4, 4.36, 4.24, 4.23, 4.12, 4.11, 3.6],
        color=colour,
        linewidth=2.2,
    )
    draw_note(axes, (9.5, 4.75), "$f_1 = f_0\\,e^{-\\mu\\varphi_1}$", ha="center")
    draw_note(axes, (12.5, 4.6), "$f_2$", ha="center")
    draw_note(axes, (15.4, 4.3), "anchor")
    draw_arrow(axes, [(16.9, 4.9), (16.4, 3.8)], "contact $F$", (16.5, 5.15), colour=FAULT_COLOUR)
    draw_note(axes, (0.2, 0.55), "excursion $s = r_1 q_1 + r_2 q_2 + r_3 q_3 = R\\,q$     stretch $x - s - o$     "
         "joint torque $\\tau = R^T f$,  $f \\geq 0$\n"
         "friction: the joints get less tension than $f_0$ while the motor winds in, and more while it pays out",
         fontsize=8)  # fmt: skip
    return figure


def modes_diagram() -> Any:
    """Draw the modes of the hand, and the transitions from mode to mode."""
    figure, axes = new_plane(8.8, 4.0, (17.6, 8.0))
    row = {"SILENT": 0.3, "INVENTORY": 3.5, "READY": 6.9, "ARMING": 10.1, "ACTIVE": 13.3}
    texts = ("listen,\nsend nothing", "query, configure,\nread back", "all have\nanswered", "enable the\ndrives",
             "the program\nmoves the hand")  # fmt: skip
    for (name, x), text in zip(row.items(), texts, strict=True):
        draw_block(axes, (x, 6.0), (2.3, 1.5), f"{name}\n{text}", "host", 7.6)
    draw_block(axes, (13.3, 3.7), (2.3, 1.5), "RELAX\ntensions to 5 N", "safety", 7.6)
    draw_block(axes, (13.3, 1.4), (2.3, 1.5), "DISARM\ndisable, query", "safety", 7.6)
    draw_block(axes, (8.3, 3.0), (2.3, 1.5), "CUT\nno torque, now", "safety", 7.6)
    draw_block(axes, (3.5, 1.4), (2.3, 1.5), "DONE\nconfirmed off,\nor exit code 71", "log", 7.6)
    names = list(row)
    for first_mode, second_mode, text in zip(
        names, names[1:], ("0.5 s", "all answer", "armed", "enabled"), strict=False
    ):
        draw_arrow(axes, [(row[first_mode] + 2.3, 6.75), (row[second_mode], 6.75)])
        draw_note(
            axes,
            ((row[first_mode] + 2.3 + row[second_mode]) / 2.0, 7.05),
            text,
            ha="center",
            fontsize=6.5,
        )
    draw_arrow(axes, [(14.6, 6.0), (14.6, 5.2)], "stop, end\nor fault", (15.4, 5.6))
    draw_arrow(axes, [(14.6, 3.7), (14.6, 2.9)], "below 8 N\nor 1 s", (15.4, 3.3))
    draw_arrow(
        axes,
        [(13.3, 1.8), (5.8, 1.8)],
        "every drive confirms that it is disabled, or 1 s",
        (9.4, 1.58),
    )
    draw_arrow(
        axes,
        [(13.6, 6.0), (13.6, 5.55), (9.9, 5.55), (9.9, 4.5)],
        "cut, or a fault that cuts",
        (10.35, 5.75),
        FAULT_COLOUR,
    )
    draw_arrow(axes, [(13.3, 4.2), (10.6, 4.2)], "the same", (12.2, 4.4), FAULT_COLOUR)
    draw_arrow(axes, [(10.6, 3.4), (12.6, 3.4), (12.6, 2.5), (13.3, 2.5)], "0.1 s", (11.1, 3.6))
    draw_arrow(
        axes,
        [(11.6, 6.0), (11.6, 3.05), (13.0, 3.05), (13.0, 2.2), (13.3, 2.2)],
        "stop",
        (11.95, 4.85),
    )
    draw_arrow(
        axes,
        [(4.65, 6.0), (4.65, 2.9)],
        "a node is silent or differs,\nor a second controller",
        (6.4, 4.5),
    )
    draw_note(
        axes,
        (0.3, 0.6),
        "A latched fault ends in DONE, and only the operator clears it. No mode leads back to an earlier one.",
        fontsize=8,
    )
    return figure
