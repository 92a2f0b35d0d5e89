"""The page about the paper: its sections in order, each with a text, figures and items."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from handctl.paper.bench import force_displacement, payload
from handctl.paper.item import Item, Verdict
from handctl.paper.model import assumptions, kinematics, lagrange, motion, statics, text

TITLE = "The source paper, all of it"
REFERENCE = (
    'S. Hussain and M. Suhaib, "Mathematical Modeling Of Four Finger Robotic Grippers", Department of Mechanical '
    "Engineering, Jamia Millia Islamia, New Delhi."
)
INTRODUCTION = (
    "This project's hand comes from this paper. Its model is sound in the main, its print full of errors. Each item "
    "below is something that it prints: an equation's term, a number, a claim. What is right beside it is computed "
    "from the paper's own lengths, radii and forces; the verdict is derived from the two, by exact arithmetic for "
    "numbers, by Lagrange's equations at random states for formulas (and by sympy in the tests), and by experiment in "
    "the simulator for what the paper claims of the hand."
)


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page.

    Attributes:
        title: heading.
        text: paragraphs.
        figures: names of figures.
        items: rows of its table.
        measured: whether it rests on experiments.
        table: a table of numbers before the items, its titles first.
    """

    title: str
    text: tuple[str, ...]
    figures: tuple[str, ...]
    items: tuple[Item, ...]
    measured: bool = False
    table: tuple[tuple[str, ...], ...] = ()


def sections(measured: Mapping[str, Any] | None) -> tuple[Section, ...]:
    """All sections; without experiments those that need none.

    Args:
        measured: results of ``experiments.measure``.
    """
    fixed = (_hand(), _kinematics(), _statics(), _dynamics(), _assumptions())
    return fixed if measured is None else (*fixed, _bench(measured), _payload(measured))


def items(measured: Mapping[str, Any] | None) -> list[Item]:
    """All items of the page."""
    return [item for section in sections(measured) for item in section.items]


def tally(rows: list[Item]) -> dict[str, int]:
    """How many items there are of each verdict."""
    return {verdict.value: sum(item.verdict == verdict for item in rows) for verdict in Verdict}


def _hand() -> Section:
    return Section(
        "The hand (sections 1, 3 and 8, Fig. 1)",
        (
            "Three fingers of 30, 15 and 10 mm stand against a thumb of 15 and 10 mm; all hinges are parallel. One "
            "motor and one tendon move each digit. `handctl paper --export DIR` writes the hand as URDF and MJCF.",
        ),
        ("fig1-hand",),
        tuple(text.items()),
    )


def _kinematics() -> Section:
    return Section(
        "Kinematics (section 4, Eq. 1-2, Fig. 2 and 3)",
        (
            "Two kinds of angle share the letter θ in the paper (section 7 says that its own are absolute) and are "
            "kept apart here: q is the angle of a joint, relative to the link before; θ is the angle of a link with "
            "the x-axis. θ = S q with S lower triangular of ones, so θ₁ = q₁, θ₂ = q₁ + q₂, θ₃ = q₁ + q₂ + q₃. By "
            "virtual work torques transform the other way round: τ = Sᵀ T for the torques at the joints, with T of "
            "Eq. 7 to 12, and M_q = Sᵀ M_θ S.",
            "Eq. 1-2 are in q, with q₁ = q₂ = q₃ = θ. The tip then runs on a curve; were the joints independent it "
            "would reach the shaded area.",
        ),
        ("fig2-model", "fig3-path"),
        tuple(kinematics.items()),
    )


def _statics() -> Section:
    return Section(
        "Statics (sections 5 and 6, Fig. 4 and 6)",
        (
            "A force F across the tip of the straight digit makes a moment at each joint. The tendon's tension is "
            "taken from joint 1 alone, the motor's torque from the tension, the payload from Coulomb's friction, the "
            "wire from its allowable stress.",
        ),
        ("fig4-statics",),
        tuple(statics.items()),
    )


def _dynamics() -> Section:
    rows = (*lagrange.term_items(), *lagrange.equation_items(), *motion.items())
    return Section(
        "Dynamics (section 7, Eq. 3-12, Fig. 7)",
        (
            "Energies and equations of motion in absolute angles θ, term by term. `deviation` is the largest "
            "difference between print and right at 200 random states, relative to the largest right value. With "
            "a = (m₂ d₂ + m₃ L₂) L₁, b = m₃ L₁ d₃, e = m₃ L₂ d₃, the corrected equations are those of Eq. 10 to 12 "
            "below; the thumb's are the same with m₃ = I₃ = 0.",
            "The figures show the closing of a digit by 60° a joint, in a vertical plane. The links' own dynamics, "
            "which is all that Eq. 3-12 describe, is a few percent of the torque. This project's springs and rotor "
            "make the rest.",
        ),
        ("fig7-torques", "fig7-eq10"),
        rows,
    )


def _assumptions() -> Section:
    return Section(
        "What the model assumes and does not say",
        ("Not misprints: places where the paper's parts contradict each other or mechanics.",),
        (),
        tuple(assumptions.items()),
    )


def _bench(measured: Mapping[str, Any]) -> Section:
    return Section(
        "Force and displacement, measured (section 5, Fig. 5)",
        (
            "Two fingers of the simulator's bench hand are clamped, and their tendons pulled to 242 N by the "
            "controller over the simulated bus; displacement is what the motors' encoders say, force what the load "
            "cells say. One rope was given section 5's knee, the other the abstract's. The softening beyond the knee "
            "is a parameter of the simulator: the paper prints no data.",
        ),
        ("fig5-force-displacement",),
        tuple(force_displacement.items(measured["force_displacement"])),
        measured=True,
    )


def _payload(measured: Mapping[str, Any]) -> Section:
    return Section(
        "Payload, measured (section 5)",
        (
            "The controller grips a cylinder so that each finger presses with 6 N (sum of its normal forces in the "
            "plant), friction 0.5. Then a force at the object's centre grows by 4 N/s until the object creeps faster "
            "than 1 mm/s or has moved by 2 mm; along z its weight of 0.05 kg counts, too. The hand is upright, the "
            "palm helps. Beside it the paper's 0.915 kg, friction on both sides as if fingers and thumb stood opposite "
            "each other, and Coulomb's bound with the normal forces that were there when loading began; loading "
            "changes them.",
        ),
        ("fig8-payload",),
        tuple(payload.items(measured["payload"])),
        measured=True,
        table=payload.table(measured["payload"]),
    )
