"""Checks of section 4 of the paper: Eq. 1 and 2, the angles in these equations, and the reach of a fingertip."""

from collections.abc import Callable

import numpy as np

from handctl.hand.digit import Array, DigitModel
from handctl.hand.inverse_kinematics import inverse_kinematics
from handctl.hand.kinematics import from_palm_frame, joint_points
from handctl.paper import paper_data as src
from handctl.paper.errata_item import ErrataItem
from handctl.paper.model.expression import Expression
from handctl.paper.model.lagrange import RELATIVE_TOLERANCE, relative_deviation
from handctl.paper.verdicts import verdict_of_statement

EQUATION_1 = Expression("30*cos(theta) + 15*cos(2*theta) + 10*cos(3*theta)")
EQUATION_2 = Expression("30*sin(theta) + 15*sin(2*theta) + 10*sin(3*theta)")
SAMPLED_ANGLES_RAD = np.linspace(-1.0, 2.0, 61)
"""Joint angles at which Eq. 1 and 2 are compared with the path of the fingertip [rad]."""


def paper_digit(name: str) -> DigitModel:
    """Return the model of a digit of the paper's hand."""
    return DigitModel.from_hand(src.paper_hand(), name)


def points_in_plane(model: DigitModel, q: Array) -> Array:
    """Return the positions (n + 1, 2) [m] of the joints and the tip in the plane of a digit."""
    return from_palm_frame(model, joint_points(model, q))[:, :2]


def kinematics_errata() -> list[ErrataItem]:
    """Return the errata items about kinematics: Eq. 1-2, the meaning of their angles, and the inverse kinematics."""
    return [
        _check_hinge_chain(),
        *_check_general_position(),
        *_check_paths(),
        _check_kind_of_angle(),
        _check_absolute_angles(),
        _check_inverse_kinematics(),
    ]


def fingertip_path(name: str, angles: Array) -> Array:
    """Return the positions (angles, 2) [mm] of a fingertip when all joints of the digit have the same angle."""
    model = paper_digit(name)
    return 1000.0 * np.array(
        [points_in_plane(model, np.full(model.joint_count, angle))[-1] for angle in angles]
    )


def reachable_tips(name: str, samples_per_joint: int) -> Array:
    """Return the tip positions (points, 2) [mm] that a digit could reach if its joints moved independently."""
    model = paper_digit(name)
    axes = [
        np.linspace(low, high, samples_per_joint)
        for low, high in zip(model.joint_min, model.joint_max, strict=True)
    ]
    # The absolute angle of a link is the sum of the joint angles up to this link.
    link_angles = np.cumsum(
        np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes)), axis=1
    )
    lengths = 1000.0 * np.array(model.lengths)
    return np.column_stack((np.cos(link_angles) @ lengths, np.sin(link_angles) @ lengths))


def _check_paths() -> list[ErrataItem]:
    """Check whether Eq. 1 and 2 give the path of the fingertip."""
    tips = fingertip_path("index", SAMPLED_ANGLES_RAD)
    thumb = " + ".join(
        f"{length} cos {'' if i == 0 else i + 1}θ"
        for i, length in enumerate(_lengths_text("thumb"))
    )
    reason = (
        f"With equal joint angles q₁ = q₂ = q₃ = θ. The equations of the thumb are not printed. They are "
        f"X = {thumb}, and the same with sines."
    )
    rows = (
        ("eq1.x", "Eq. 1", "X", EQUATION_1, tips[:, 0]),
        ("eq2.y", "Eq. 2", "Y", EQUATION_2, tips[:, 1]),
    )
    items_of_path = []
    for id, location, axis, printed_expression, correct_expression in rows:
        deviation = relative_deviation(
            printed_expression.evaluate({"theta": SAMPLED_ANGLES_RAD}), correct_expression
        )
        equation_text = f"{axis} = {printed_expression.as_typeset_text()}"
        items_of_path.append(
            ErrataItem(
                id,
                location,
                equation_text,
                equation_text,
                "mm",
                verdict_of_statement(deviation < RELATIVE_TOLERANCE),
                reason,
                ("forward kinematics",),
                deviation,
            )
        )
    return items_of_path


def _lengths_text(name: str) -> list[str]:
    """Return a text with the lengths [mm] of a digit's links."""
    return [
        str(length)
        for length in src.exact_millimetres(src.paper_hand().digit_named(name).link_length_m)
    ]


def _check_general_position() -> list[ErrataItem]:
    """Check the formula of section 4 for the position of the fingertip, at random joint angles.

    Section 4 of the paper states the coordinates x and y of the fingertip. The formula for x is
    L1 cos q1 + L2 cos(q1 + q2) + .., and the formula for y has sines in place of the cosines.
    """
    model = paper_digit("index")
    generator = np.random.default_rng(1)
    rows = generator.uniform(-2.0, 2.0, (100, 3))
    lengths = {f"L{i + 1}": length for i, length in enumerate(model.lengths)}
    angles = {f"q{i + 1}": rows[:, i] for i in range(3)}
    tips = np.array([points_in_plane(model, q)[-1] for q in rows])
    items_of_components = []
    components = (("sec4.position", "X", "cos"), ("sec4.position_y", "Y", "sin"))
    for (id, axis, wave), correct_expression in zip(components, tips.T, strict=True):
        printed_expression = Expression(
            f"L1*{wave}(q1) + L2*{wave}(q1 + q2) + L3*{wave}(q1 + q2 + q3)"
        )
        deviation = relative_deviation(
            printed_expression.evaluate({**lengths, **angles}), correct_expression
        )
        items_of_components.append(
            ErrataItem(
                id, "Sec. 4", f"L₁ {wave} θ₁, L₂ {wave}(θ₁ + θ₂), L₃ {wave}(θ₁ + θ₂ + θ₃)",
                f"{axis} = {printed_expression.as_typeset_text()}", "mm",
                verdict_of_statement(deviation < RELATIVE_TOLERANCE),
                "The angles are relative to the link before, as q in this project.", ("forward kinematics",), deviation,
            )
        )  # fmt: skip
    return items_of_components


def _check_hinge_chain() -> ErrataItem:
    """Check whether the chain of hinges in Fig. 2 stays in one plane, and whether the links keep their lengths."""
    model = paper_digit("index")
    generator = np.random.default_rng(3)
    largest_deviation = 0.0
    for q in generator.uniform(-2.0, 2.0, (100, 3)):
        nodes = joint_points(model, q)
        steps = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
        largest_deviation = max(
            largest_deviation,
            float(np.ptp(nodes[:, 2])),
            float(np.abs(steps - model.lengths).max()),
        )
    return ErrataItem(
        "fig2.chain", "Fig. 2, Sec. 4", "each joint turns about z, x and y are locked; links L₁, L₂, L₃ in series",
        "three parallel hinges", "", verdict_of_statement(largest_deviation < RELATIVE_TOLERANCE),
        "At 100 random poses all joints and the tip stay in the finger's plane, at the links' lengths from each other. "
        "The figure below is drawn from the hand's description.", ("forward kinematics",))  # fmt: skip


def _check_kind_of_angle() -> ErrataItem:
    """Check whether Eq. 6 and Eq. 1-2 can be true with the same kind of angle, relative or absolute.

    Eq. 6 gives the potential energy only with absolute angles, but Eq. 1-2 are true only with
    relative angles.
    """
    model = paper_digit("index")
    q = np.array([0.3, 0.5, 0.7])
    link_angles = np.cumsum(q)
    height: Callable[[Array], float] = lambda theta: float(np.array(model.lengths) @ np.sin(theta))  # noqa: E731
    tip = float(points_in_plane(model, q)[-1][1])
    is_equal = abs(height(q) - tip) < RELATIVE_TOLERANCE
    return ErrataItem(
        "sec4-7.angles", "Sec. 4 against Sec. 7", "θ₁, θ₂, θ₃ in both", "θ = S q, S lower triangular of ones", "",
        verdict_of_statement(is_equal),
        "One letter stands for two kinds of angle. In section 4 it is the angle between neighbouring links (q here), "
        "as the sums of angles show. Section 7 states that its angles are absolute. The paper never converts the "
        f"angles. At q = 0.3, 0.5, 0.7 rad the sines of Eq. 6 give a tip height of {1000 * height(q):.2f} mm with the "
        f"angles of section 4, and {1000 * height(link_angles):.2f} mm with absolute angles. The equations of "
        f"section 4 give {1000 * tip:.2f} mm.",
        ("forward kinematics",))  # fmt: skip


def _check_absolute_angles() -> ErrataItem:
    """Check whether the heights in Eq. 6 are correct for absolute angles, as section 7 states."""
    model = paper_digit("index")
    q = np.array([0.3, 0.5, 0.7])
    height = 1000.0 * float(np.array(model.lengths) @ np.sin(np.cumsum(q)))
    tip = 1000.0 * float(points_in_plane(model, q)[-1][1])
    return ErrataItem(
        "sec7.absolute", "Sec. 7", "θ₁, θ₂ and θ₃ absolute angles with the x-axis", "the angles of Eq. 3 to 12", "",
        verdict_of_statement(abs(height - tip) < RELATIVE_TOLERANCE),
        f"With absolute angles, the sines of Eq. 6 give a tip height of {height:.2f} mm at q = 0.3, 0.5, 0.7 rad, as "
        "forward kinematics does.", ("forward kinematics",))  # fmt: skip


def _check_inverse_kinematics() -> ErrataItem:
    """Check the inverse kinematics, which the paper does not print.

    If the joint angles of a solution are put into the forward kinematics, the result must be the
    given position of the tip.
    """
    model = paper_digit("index")
    generator = np.random.default_rng(2)
    largest_deviation = 0.0
    for q in generator.uniform(0.05, 1.7, (200, 3)):
        tip = points_in_plane(model, q)[-1]
        x, y = tip.tolist()
        solutions = inverse_kinematics(model, x, y, float(q.sum()))
        largest_deviation = max(
            largest_deviation,
            *(
                float(np.abs(points_in_plane(model, np.array(solution))[-1] - tip).max())
                for solution in solutions
            ),
        )
    return ErrataItem(
        "sec4.inverse", "Sec. 4", "(not printed)", "forward(inverse(X, Y, θ)) = (X, Y, θ)", "",
        verdict_of_statement(largest_deviation < 1e-12),
        "Forward kinematics of every solution of the inverse kinematics (closed form) returns the tip, at 200 random "
        "poses.",
        ("forward kinematics",), largest_deviation)  # fmt: skip
