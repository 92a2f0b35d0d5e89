"""Compare the errata of the paper with equations that sympy derives, and with numbers from separate arithmetic.

The tests also check that the errata contain every known misprint.
"""

from functools import cache

import numpy as np
import pytest
import sympy as sp

from handctl.hand.digit import DigitModel
from handctl.hand.dynamics import gravity_torque, inverse_dynamics
from handctl.paper import paper_data as src
from handctl.paper import sections
from handctl.paper.errata_item import ErrataItem, ErrataVerdict
from handctl.paper.model import equations, kinematics, lagrange, motion

PARAMETER_SYMBOLS = sp.symbols("I1:4 m1:4 L1:4 d1:4 g", positive=True)
ANGLE_FUNCTIONS = [sp.Function(f"f{i}")(sp.Symbol("t")) for i in (1, 2, 3)]
TIME_SYMBOL = sp.Symbol("t")
DERIVATIVE_SYMBOLS = {
    f"{'d' * order}th{i}": sp.Symbol(f"{'d' * order}th{i}") for order in range(3) for i in (1, 2, 3)
}
SYMBOL_BY_NAME = {str(symbol): symbol for symbol in PARAMETER_SYMBOLS} | DERIVATIVE_SYMBOLS


def symbolic_expression(formula_text: str) -> sp.Expr:
    return sp.sympify(formula_text, locals=SYMBOL_BY_NAME)


@cache
def derived_energies() -> tuple[list[sp.Expr], sp.Expr]:
    """Return the kinetic energy of each link and the potential energy, derived from the positions of the links."""
    i, m, length, d = (PARAMETER_SYMBOLS[k : k + 3] for k in (0, 3, 6, 9))
    kinetic_energies, potential, x, y = [], sp.Integer(0), sp.Integer(0), sp.Integer(0)
    for k, angle in enumerate(ANGLE_FUNCTIONS):
        cx, cy = x + d[k] * sp.cos(angle), y + d[k] * sp.sin(angle)
        squared_speed = sp.diff(cx, TIME_SYMBOL) ** 2 + sp.diff(cy, TIME_SYMBOL) ** 2
        kinetic_energies.append(
            m[k] * squared_speed / 2 + i[k] * sp.diff(angle, TIME_SYMBOL) ** 2 / 2
        )
        potential += m[k] * PARAMETER_SYMBOLS[-1] * cy
        x, y = x + length[k] * sp.cos(angle), y + length[k] * sp.sin(angle)
    return kinetic_energies, potential


def expression_in_symbols(expression: sp.Expr) -> sp.Expr:
    """Replace the joint angles as functions of time, and their derivatives, by symbols.

    Return the new expression.
    """
    for order in (2, 1, 0):
        expression = expression.subs(
            {
                sp.diff(angle, TIME_SYMBOL, order): DERIVATIVE_SYMBOLS[f"{'d' * order}th{k + 1}"]
                for k, angle in enumerate(ANGLE_FUNCTIONS)
            }
        )
    return sp.expand(sp.expand_trig(expression))


def sum_of_terms(terms: tuple[equations.EquationTerm, ...]) -> sp.Expr:
    return sp.expand(
        sp.expand_trig(sum(symbolic_expression(term.correct_form.text) for term in terms))
    )


def test_corrected_energies_are_those_of_three_links() -> None:
    kinetic_energies, potential = derived_energies()
    corrected_terms = (
        equations.KINETIC_TERMS_1,
        equations.KINETIC_TERMS_2,
        equations.KINETIC_TERMS_3,
    )
    for terms_of_link, derived in zip(corrected_terms, kinetic_energies, strict=True):
        assert sp.simplify(sum_of_terms(terms_of_link) - expression_in_symbols(derived)) == 0
    assert (
        sp.simplify(sum_of_terms(equations.POTENTIAL_TERMS) - expression_in_symbols(potential)) == 0
    )


@pytest.mark.parametrize("link_index", [0, 1, 2])
def test_corrected_torques_follow_from_the_lagrangian(link_index: int) -> None:
    kinetic_energies, potential = derived_energies()
    lagrangian, angle = sum(kinetic_energies) - potential, ANGLE_FUNCTIONS[link_index]
    torque = sp.diff(sp.diff(lagrangian, sp.diff(angle, TIME_SYMBOL)), TIME_SYMBOL) - sp.diff(
        lagrangian, angle
    )
    assert (
        sp.simplify(
            sum_of_terms(equations.TORQUE_TERMS[link_index]) - expression_in_symbols(torque)
        )
        == 0
    )


def test_the_thumb_equations_are_the_same_without_a_third_link() -> None:
    """If the third link has no mass and no inertia (m3 = I3 = 0), the finger equations describe a thumb with two links.

    The test sets m3 = I3 = 0 in the finger equations, and expects the torques of the thumb
    equations.
    """
    thumb = DigitModel.from_hand(src.paper_hand(), "thumb").with_gravity((0.0, -9.81, 0.0))
    rng = np.random.default_rng(3)
    states = {
        "g": 9.81,
        "I3": 0.0,
        "m3": 0.0,
        "L3": 1.0,
        "d3": 1.0,
        "th3": 0.3,
        "dth3": 5.0,
        "ddth3": 7.0,
    }
    for i in (0, 1):
        states |= {f"I{i + 1}": thumb.inertias[i, 2, 2], f"m{i + 1}": thumb.masses[i]}
        states |= {f"L{i + 1}": thumb.lengths[i], f"d{i + 1}": thumb.centres_of_mass[i, 0]}
    for _ in range(20):
        theta, rate, acceleration = rng.normal(size=(3, 2)) * np.array([[1.0], [10.0], [100.0]])
        for k in (0, 1):
            states |= {
                f"th{k + 1}": theta[k],
                f"dth{k + 1}": rate[k],
                f"ddth{k + 1}": acceleration[k],
            }
        handctl_torques = [
            sum(term.correct_form.evaluate(states) for term in equation_terms)
            for equation_terms in equations.TORQUE_TERMS[:2]
        ]
        q, dq, ddq = (np.diff(values, prepend=0.0) for values in (theta, rate, acceleration))
        tau = np.array(inverse_dynamics(thumb, q, dq, ddq)) - np.array(thumb.armature) * ddq
        assert np.allclose(
            [handctl_torques[0] + handctl_torques[1], handctl_torques[1]], tau, rtol=1e-9
        )


@pytest.mark.parametrize("errata_item", lagrange.term_errata(), ids=lambda item: item.id)
def test_each_verdict_on_a_term_agrees_with_sympy(errata_item: ErrataItem) -> None:
    equation_terms = [
        *equations.KINETIC_TERMS,
        *equations.POTENTIAL_TERMS,
        *sum(equations.TORQUE_TERMS, ()),
    ]
    term = next(term for term in equation_terms if term.id == errata_item.id)
    is_reading_equal = [
        sp.simplify(symbolic_expression(reading.text) - symbolic_expression(term.correct_form.text))
        == 0
        for reading in term.readings
    ]
    expected = (
        ErrataVerdict.EQUAL
        if all(is_reading_equal)
        else ErrataVerdict.WRONG
        if not any(is_reading_equal)
        else ErrataVerdict.UNDECIDABLE
    )
    assert errata_item.verdict == expected
    if errata_item.verdict == ErrataVerdict.WRONG:
        assert errata_item.deviation is not None
        assert errata_item.deviation > 0.1


def test_the_corrected_mass_matrix_is_symmetric_and_the_printed_one_is_not() -> None:
    def mass_matrix_of(formula_source: str) -> sp.Matrix:
        rows = []
        for equation_terms in equations.TORQUE_TERMS:
            torque = sum(
                symbolic_expression(
                    term.readings[0].text
                    if formula_source == "readings"
                    else term.correct_form.text
                )
                for term in equation_terms
            )
            rows.append([sp.diff(torque, DERIVATIVE_SYMBOLS[f"ddth{k}"]) for k in (1, 2, 3)])
        return sp.Matrix(rows)

    corrected_matrix, printed_matrix = mass_matrix_of("right"), mass_matrix_of("readings")
    assert (corrected_matrix - corrected_matrix.T).applyfunc(sp.simplify) == sp.zeros(3, 3)
    asymmetry = (printed_matrix - printed_matrix.T).applyfunc(sp.simplify)
    assert all(asymmetry[i, k] != 0 for i, k in ((0, 1), (0, 2), (1, 2)))


EXPECTED_ERRATA = {
    ErrataVerdict.WRONG: """
        eq4.own eq5.middle eq5.own eq5.cross23 eq5.cross13 eq6.link3 eq10.inertia eq10.coupling12 eq10.coupling13
        eq10.velocity12 eq10.velocity13 eq10.gravity eq11.coupling23 eq11.velocity12 eq11.velocity23 eq12.velocity13
        eq12.velocity23 sec7.axis sec7.lengths sec4-7.angles eq7-9.joint_torque sec5.wire sec5.area
        fig5.stress sec5.M1_label sec5.M2_label sec6.MT1_label payload.thumb_limit sec8.torque
        sec6.pulley sec1.fingers sec8.fingers sec8.control tendon.joint2 tendon.joint3
        coupling.tension coupling.freedom grip.balance payload.both_sides wire.bending grip.middle_link eq10.static
        eq10.sum eq11.sum eq12.sum eq10.symbols""",
    ErrataVerdict.UNDECIDABLE: "eq12.gravity fig5.knee abstract.joints_each sec3.palm sec7.complete",
    ErrataVerdict.ROUNDED: "sec5.tension sec5.torque sec6.tension sec6.torque abstract.wire abstract.payload",
    ErrataVerdict.TRUNCATED: "sec5.payload sec5.payload3 sec6.torque10",
    ErrataVerdict.EQUAL: """
        eq1.x eq2.y sec4.position eq3.all sec5.M1 sec5.M2 sec5.M3 sec6.MT1 sec6.MT2 abstract.joints tendon.joint1
        eq7-9.lagrange sec4.position_y fig2.chain sec7.absolute sec5.M3_label sec6.MT2_label sec5.moment_formula
        sec5.torque_formula sec5.payload_formula sec5.stress_formula sec5.wire_formula""",
}


def test_no_known_misprint_is_missing() -> None:
    verdict_by_id = {item.id: item.verdict for item in sections.page_errata(None)}
    for verdict, ids in EXPECTED_ERRATA.items():
        for id in ids.split():
            assert verdict_by_id[id] == verdict, id


def test_ids_are_unique_and_reasons_given() -> None:
    errata_items = sections.page_errata(None)
    assert len({item.id for item in errata_items}) == len(errata_items)
    for item in errata_items:
        assert item.printed
        assert item.where
        assert item.why.endswith((".", ")")), item.id
        assert item.evidence, item.id


@pytest.mark.parametrize(
    ("item_id", "expected_value"),
    [
        ("sec5.tension", 55 / 3),
        ("sec5.torque", 0.55 / 6),
        ("sec5.payload", 3 / 9.81),
        ("sec5.payload3", 9 / 9.81),
        ("sec5.wire", 0.858568),
        ("abstract.wire", 0.858568),
        ("abstract.payload", 9 / 9.81),
        ("eq10.static", 3.157447e-3),
        ("sec7.complete", 1.144456),
        ("sec8.torque", 10.30011),
        ("fig5.stress", 345.4545),
        ("sec6.pulley", 3.0),
        ("sec6.tension", 25 / 3),
        ("sec6.torque", 0.25 / 6),
        ("sec6.torque10", 0.416667),
        ("coupling.tension", 10.0),
        ("grip.balance", 18.0),
        ("payload.both_sides", 1.834862),
        ("payload.thumb_limit", 1.019368),
        ("wire.bending", 6.988),
        ("grip.middle_link", -93.34),
        ("abstract.joints", 11),
    ],
)
def test_items_have_the_known_values(item_id: str, expected_value: float) -> None:
    value_by_id = {item.id: item.computed for item in sections.page_errata(None)}
    assert value_by_id[item_id] == pytest.approx(expected_value, rel=1e-4)


@pytest.mark.parametrize("printed_number", ["1", "0.86"])
def test_a_printed_number_of_the_abstract_is_judged_once(printed_number: str) -> None:
    abstract_errata = [item for item in sections.page_errata(None) if item.where == "Abstract"]
    errata_ids = [item.id for item in abstract_errata if item.printed.split()[0] == printed_number]
    assert len(errata_ids) == 1


def test_the_joint_that_holds_the_straight_finger_carries_its_whole_weight() -> None:
    """The test computes the expected value tau_1 = g sum(m x) itself, without the dynamics code.

    In this formula, x is the distance of each centre of mass from joint 1.
    """
    digit = motion.upright_digit("index")
    joint_distances = np.concatenate(([0.0], np.cumsum(digit.lengths)[:-1]))
    expected_torque = 9.81 * float(
        np.array(digit.masses) @ (joint_distances + digit.centres_of_mass[:, 0])
    )
    item_by_id = {item.id: item for item in sections.page_errata(None)}
    assert item_by_id["eq10.static"].computed == pytest.approx(expected_torque, rel=1e-9)


def test_numbers_of_the_paper_are_judged_without_springs() -> None:
    """The hand in the paper has no springs, so its printed numbers do not contain torques of springs.

    The test compares the printed numbers with the torque that moves the links: inertia, Coriolis
    and gravity terms.
    """
    fast_motion_torques = motion.closing_torques("index", motion.CLOSING_DURATIONS_S[-1])
    links = sum(
        fast_motion_torques.torque_by_cause[torque_cause]
        for torque_cause in ("inertia", "Coriolis", "gravity")
    )
    item_by_id = {item.id: item for item in sections.page_errata(None)}
    assert item_by_id["sec7.complete"].computed == pytest.approx(
        float(np.abs(links).max()) / fast_motion_torques.moment_arm_m
    )
    assert item_by_id["sec8.torque"].computed == pytest.approx(1000.0 * float(np.abs(links).max()))


def test_no_erratum_denies_a_statement_that_the_paper_makes() -> None:
    item_by_id = {item.id: item for item in sections.page_errata(None)}
    assert "Never said" not in item_by_id["sec4-7.angles"].why
    assert "Section 7 states that its angles are absolute" in item_by_id["sec4-7.angles"].why


def test_torques_convert_between_relative_and_absolute_angles() -> None:
    """Test two formulas of the page about the paper: tau = S^T T for torques, M_q = S^T M_theta S for mass matrices.

    In relative joint angles, the torques are tau and the mass matrix is M_q. In absolute link
    angles, the torques are T and the mass matrix is M_theta. S is the lower triangular matrix of
    ones.
    """
    digit = lagrange.paper_finger()
    states = lagrange.finger_states(digit)
    tau, torque = (
        lagrange.joint_torques(digit, states),
        np.array(lagrange.model_torques(digit, states)).T,
    )
    s = np.tril(np.ones((3, 3)))
    assert np.allclose(tau, torque @ s, rtol=1e-12)


def test_inverse_kinematics_reaches_the_points_of_the_path() -> None:
    item = next(item for item in kinematics.kinematics_errata() if item.id == "sec4.inverse")
    assert item.deviation is not None
    assert item.deviation < 1e-12


def test_the_parts_of_a_closing_motion_add_up() -> None:
    fast_motion_torques, slow_motion_torques = (
        motion.closing_torques("index", 0.15),
        motion.closing_torques("index", 0.6),
    )
    assert fast_motion_torques.peak_tension("inertia") == pytest.approx(
        16.0 * slow_motion_torques.peak_tension("inertia"), rel=1e-6
    )
    assert fast_motion_torques.peak_tension("Coriolis") == pytest.approx(
        16.0 * slow_motion_torques.peak_tension("Coriolis"), rel=1e-6
    )
    assert fast_motion_torques.peak_tension("gravity") == pytest.approx(
        slow_motion_torques.peak_tension("gravity"), rel=1e-9
    )
    digit = motion.upright_digit("index")
    weight = sum(gravity_torque(digit, (0.0, 0.0, 0.0)))
    assert weight > 0.0
    assert fast_motion_torques.torque_by_cause["gravity"][0] == pytest.approx(weight)
