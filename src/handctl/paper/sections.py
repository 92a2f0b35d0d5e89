"""Sections of the page about the paper, in the order of the page.

Each section has text, figures and errata items.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from handctl.paper.bench import force_displacement, payload
from handctl.paper.errata_item import ErrataItem, ErrataVerdict
from handctl.paper.model import assumptions, kinematics, lagrange, motion, paper_statements, statics

PAGE_TITLE = "Source paper"
PAPER_CITATION = (
    'S. Hussain and M. Suhaib, "Mathematical Modeling Of Four Finger Robotic Grippers", Department of Mechanical '
    "Engineering, Jamia Millia Islamia, New Delhi."
)
INTRODUCTION_TEXT = (
    "The hand `jamia` of this project comes from this paper. The model of the paper is mostly right, but the printed "
    "formulas and numbers have many errors. Each item below is one printed statement: a term of an equation, a number, "
    "a claim. The correct value beside it is computed from the paper's own lengths, radii and forces. The verdict "
    "follows from the printed and the correct value: by exact arithmetic for numbers, by Lagrange's equations at "
    "random states for formulas (and by sympy in the tests), and by experiment in the simulator for claims about the "
    "hand."
)


@dataclass(frozen=True, slots=True)
class PageSection:
    """Section of the page about the paper.

    Attributes:
        title: heading of the section.
        text: paragraphs of the section.
        figures: names of the figures in the section.
        items: errata items of the section. Each item is a row of the table of errata.
        measured: True if the section shows results of simulated experiments.
        table: table of numbers before the errata items. The first row contains the titles of the
            columns.
    """

    title: str
    text: tuple[str, ...]
    figures: tuple[str, ...]
    items: tuple[ErrataItem, ...]
    measured: bool = False
    table: tuple[tuple[str, ...], ...] = ()


def page_sections(experiment_results: Mapping[str, Any] | None) -> tuple[PageSection, ...]:
    """Return all sections of the page.

    Without results of experiments, the returned list does not contain the sections about
    measurements.

    Args:
        experiment_results: results of `experiments.run_experiments`, or None.
    """
    fixed_sections = (
        _hand_section(),
        _kinematics_section(),
        _statics_section(),
        _dynamics_section(),
        _assumptions_section(),
    )
    return (
        fixed_sections
        if experiment_results is None
        else (
            *fixed_sections,
            _bench_section(experiment_results),
            _payload_section(experiment_results),
        )
    )


def page_errata(experiment_results: Mapping[str, Any] | None) -> list[ErrataItem]:
    """Return all errata items of the page."""
    return [item for section in page_sections(experiment_results) for item in section.items]


def count_by_verdict(errata_items: list[ErrataItem]) -> dict[str, int]:
    """Return the number of errata items for each verdict."""
    return {
        verdict.value: sum(item.verdict == verdict for item in errata_items)
        for verdict in ErrataVerdict
    }


def _hand_section() -> PageSection:
    return PageSection(
        "The hand (sections 1, 3 and 8, Fig. 1)",
        (
            "Three fingers of 30, 15 and 10 mm stand against a thumb of 15 and 10 mm; all hinges are parallel. One "
            "motor and one tendon move each digit. `handctl paper --export DIR` writes the hand as URDF and MJCF.",
        ),
        ("fig1-hand",),
        tuple(paper_statements.text_errata()),
    )


def _kinematics_section() -> PageSection:
    return PageSection(
        "Kinematics (section 4, Eq. 1-2, Fig. 2 and 3)",
        (
            "The paper uses the letter θ for two kinds of angle. Section 7 states that its angles are absolute. Here q "
            "is the angle of a joint, relative to the link before, and θ is the angle of a link with the x-axis. θ = S "
            "q with S lower triangular of ones, so θ₁ = q₁, θ₂ = q₁ + q₂, θ₃ = q₁ + q₂ + q₃. By virtual work, torques "
            "transform in the opposite direction: the torques at the joints are τ = Sᵀ T, with T of Eq. 7 to 12, "
            "and the mass matrix is M_q = Sᵀ M_θ S.",
            "Eq. 1-2 contain the joint angle q, with q₁ = q₂ = q₃ = θ. The tip then moves on a curve. With independent "
            "joints it would reach the shaded area.",
        ),
        ("fig2-model", "fig3-path"),
        tuple(kinematics.kinematics_errata()),
    )


def _statics_section() -> PageSection:
    return PageSection(
        "Statics (sections 5 and 6, Fig. 4 and 6)",
        (
            "A force F across the tip of the straight digit causes a moment at each joint. The paper computes the "
            "tension of the tendon from joint 1 alone, the motor torque from the tension, the payload from Coulomb "
            "friction, and the wire diameter from the allowable stress.",
        ),
        ("fig4-statics",),
        tuple(statics.statics_errata()),
    )


def _dynamics_section() -> PageSection:
    rows = (*lagrange.term_errata(), *lagrange.equation_errata(), *motion.motion_errata())
    return PageSection(
        "Dynamics (section 7, Eq. 3-12, Fig. 7)",
        (
            "The table compares energies and equations of motion in absolute angles θ, term by term. `deviation` is "
            "the largest difference between the printed and the correct value at 200 random states, relative to the "
            "largest correct value. With a = (m₂ d₂ + m₃ L₂) L₁, b = m₃ L₁ d₃, e = m₃ L₂ d₃, the corrected equations "
            "are those of Eq. 10 to 12 below. The equations of the thumb are the same with m₃ = I₃ = 0.",
            "The figures show the closing of a digit by 60° per joint, in a vertical plane. Eq. 3-12 describe the "
            "dynamics of the links only, which are a few percent of the torque. The springs and the rotor of "
            "this project cause the rest.",
        ),
        ("fig7-torques", "fig7-eq10"),
        rows,
    )


def _assumptions_section() -> PageSection:
    return PageSection(
        "Assumptions that the model does not state",
        (
            "These items are no misprints, but parts of the paper that contradict each other or the laws of mechanics.",
        ),
        (),
        tuple(assumptions.assumption_errata()),
    )


def _bench_section(experiment_results: Mapping[str, Any]) -> PageSection:
    return PageSection(
        "Force and displacement, measured (section 5, Fig. 5)",
        (
            "Two fingers of the simulator's bench hand are clamped, and the controller pulls their tendons to "
            f"{force_displacement.MAX_PULL_N:g} N over the simulated bus. The encoders of the motors measure the "
            "displacement, and the load cells measure the force. One tendon has the knee of section 5, and the "
            "other has the knee of the abstract. The "
            "softening beyond the knee is a parameter of the simulator, because the paper prints no data.",
        ),
        ("fig5-force-displacement",),
        tuple(force_displacement.knee_errata(experiment_results["force_displacement"])),
        measured=True,
    )


def _payload_section(experiment_results: Mapping[str, Any]) -> PageSection:
    return PageSection(
        "Payload, measured (section 5)",
        (
            "The controller grips a cylinder so that each finger presses with 6 N (sum of its normal forces in the "
            "plant). The coefficient of friction is 0.5. Then a force at the object's centre grows by 4 N/s until the "
            "object creeps faster than 1 mm/s or has moved by 2 mm. Along z the weight of the object (0.05 kg) acts as "
            "well.",
            "The hand is upright, and the palm carries a part of the load. The table also has the 0.915 kg of the "
            "paper, the payload with friction on both sides as if fingers and thumb were opposite each other, and the "
            "Coulomb bound with the normal forces at the beginning of the load. The load changes the normal forces.",
        ),
        ("fig8-payload",),
        tuple(payload.payload_errata(experiment_results["payload"])),
        measured=True,
        table=payload.payload_table(experiment_results["payload"]),
    )
