"""Test ``handctl tune`` and ``handctl identify`` with command lines that a user or a program would use.

In most tests, fake functions replace the computations of ``tune`` and ``identify``.
"""

import json
import shlex
from argparse import ArgumentParser, Namespace
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.cli.tuning.arguments import identify
from handctl.cli.tuning.tune_verify import _print_rounds
from handctl.core.calibration import Calibration, TendonCalibration
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.log.write.log_writer import LogWriter
from handctl.session.calibration import load_calibration, write_calibration
from handctl.tune.gains_verification import BlockedDigit, GainsRollback
from handctl.tune.scoring import GainScore
from handctl.tune.search.gain_search import SearchResult, SearchTrial
from tests.cli.command_refusals import refusal_line

GOLDEN_LOG = str(Path(__file__).parents[2] / "logs" / "golden" / "jamia-grasp.mcap")
CANDIDATE_ARGS = Namespace(candidate="new.toml", hand="jamia")


@pytest.fixture
def fake_search(monkeypatch):
    """Replace the search for gains by a fake search that returns at once.

    Return the list to which the fake search adds each of its trials.
    """
    trials = []
    monkeypatch.setattr(
        "handctl.tune.search.gain_search.run_search",
        lambda *words: SearchResult.from_trials(tuple(trials)),
    )
    monkeypatch.setattr("handctl.cli.tuning.tune_search._designed_gains", lambda *words: ())
    return trials


def test_a_search_without_a_good_trial_prints_json(fake_search, work_folder, capsys):
    fake_search.append(SearchTrial(0, {}, GainScore(1.0, 2.0, 3.0, 60.0, 0.5)))
    assert main(["tune", "search", "--plants", "1", "--trials", "1", "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert (result["trials"], result["good"], result["best"], result["gains"]) == (1, 0, None, None)
    assert not (work_folder / "jamia.search.toml").exists()


@pytest.mark.parametrize("command_words", [(), ("--json",)])
def test_a_design_without_stable_gains_writes_nothing(
    work_folder, capsys, monkeypatch, command_words
):
    def raise_value_error(*command_words):
        raise ValueError("no authority keeps the margins")

    monkeypatch.setattr("handctl.tune.loops.gain_design.design_gains", raise_value_error)
    assert main(["tune", "design", "--plants", "1", *command_words]) == 1
    output = capsys.readouterr()
    assert (
        output.err == "handctl: tune design: no authority keeps the margins; nothing is written\n"
    )
    assert not command_words or json.loads(output.out)["gains"] is None
    assert not list(work_folder.iterdir())


def test_poles_that_are_not_stable_in_simulation_are_not_written(work_folder, capsys, monkeypatch):
    monkeypatch.setattr(
        "handctl.tune.loops.step_tests.RestTest._simulate",
        lambda self, model: ": plant 1 of 1 swings by 9 N",
    )
    assert main(["tune", "design", "--plants", "1", "--poles-Hz", "5,25"]) == 1
    assert (
        "not stable on every plant: plant 1 of 1 swings by 9 N; nothing is written"
        in capsys.readouterr().err
    )
    assert not list(work_folder.iterdir())


@pytest.mark.parametrize("command_words", [(), ("--json",)])
def test_a_design_tells_why_the_old_gains_do_not_come_to_rest(
    work_folder, capsys, monkeypatch, command_words
):
    """Reproduce a defect: ``tune design`` gave no reason why the old gains had no stability margins.

    The table of ``tune design`` showed "none" for both stability margins of the old gains.
    """
    oscillation_message = "the plant with 0.5 of the friction swings by 2.3 N held"
    reasons = {7e-4: f": {oscillation_message}"}
    monkeypatch.setattr(
        "handctl.tune.loops.step_tests.RestTest._simulate",
        lambda self, model: reasons.get(model.gains.motion.position_error_m, ""),
    )
    command = ["tune", "design", "--plants", "1", "--gain", "motion.position_error_m=7e-4"]
    assert main([*command, "--poles-Hz", "2,25", *command_words]) in (0, 1)
    output = capsys.readouterr().out
    if command_words:
        assert json.loads(output)["not_at_rest_before"] == oscillation_message
        return
    assert (
        f"before: in simulation the hand does not come to rest: {oscillation_message}\n" in output
    )
    assert "not at rest\u2192" in output
    assert "none" not in output


def gain_score(tracking_error):
    return GainScore(tracking_error, 2.0, 3.0, 60.0, 0.0)


def test_a_measure_is_worse_only_beyond_its_spread():
    from handctl.tune.gains_verification import compare_rounds

    runs = [
        [gain_score(1.0), gain_score(1.0 + 0.01 * i), *[gain_score(3.0 + 0.01 * i)] * 3]
        for i in range(3)
    ]
    assert [round_row.verdict for round_row in compare_rounds(runs)] == [
        "worse",
        "same",
        "same",
        "same",
    ]
    assert compare_rounds([runs[0]])[0].verdict == "worse"
    noisy_runs = [
        [gain_score(1.0), gain_score(1.0), *[gain_score(new_score)] * 3]
        for new_score in (0.5, 1.0, 2.0)
    ]
    assert compare_rounds(noisy_runs)[0].verdict == "same"


@pytest.mark.parametrize(("accepts_worse_gains", "exit_code"), [(False, 1), (True, 0)])
def test_gains_that_are_worse_are_verified_only_if_that_is_accepted(
    capsys, accepts_worse_gains, exit_code
):
    from handctl.cli.tuning.tune_verify import _report_verification

    rounds = [gain_score(1.0), gain_score(1.0), gain_score(3.0), gain_score(3.0), gain_score(3.0)]
    run = {"through": True, "returned": None, "failure": "", "rounds": rounds, "judged_by": "truth"}
    run |= {"log": "l", "picture": "p", "stopped": "", "amplitudes": (0.3, 1.0, 0.3, 0.6, 1.0)}
    args = Namespace(
        candidate="new.toml", hand="jamia", accept_worse=accepts_worse_gains, json=False
    )
    assert _report_verification(args, [run] * 3, SimpleNamespace(exit_code=0)) == exit_code
    output = capsys.readouterr().out
    assert "tracking: worse, 1.00 -> 3.00 deg" in output
    assert ("gains apply" in output) == accepts_worse_gains
    assert ("--accept-worse" in output) != accepts_worse_gains
    last_line = output.splitlines()[-1]
    assert last_line.startswith(
        "verified; " if accepts_worse_gains else "not verified: tracking worse than"
    )


@pytest.mark.parametrize(
    ("failure_text", "rollback", "blocked", "expected_reason"),
    [
        ("T01 torn", None, None, "the run failed: T01 torn"),
        ("", GainsRollback(1.0, 500, 0.6, "safety: HOLD"), None, "safety: HOLD at amplitude 0.6"),
        (
            "",
            None,
            BlockedDigit("index", ("thumb",), "17 deg", 1.0, 0.35),
            "index is blocked by thumb at 17 deg: the amplitude is too large for this hand; "
            "try --amplitude 0.35",
        ),
        ("", None, None, "the run ended in round 1 of 5"),
    ],
)
def test_the_last_line_of_a_verification_is_its_verdict(
    capsys, failure_text, rollback, blocked, expected_reason
):
    """Reproduce a defect: `tune verify` printed no verdict about the new gains if the run returned to the old gains."""
    from handctl.cli.tuning.tune_verify import _report_verification, _stop_reason

    amplitudes = (0.3, 1.0, 0.3, 0.6, 1.0)
    observer = SimpleNamespace(rollback=rollback, blocked=blocked, amplitudes=amplitudes)
    run = {
        "through": False,
        "stopped": _stop_reason(failure_text, observer, 1),
        "amplitudes": amplitudes,
        "returned": asdict(rollback) if rollback else None,
        "failure": failure_text,
        "rounds": [gain_score(1.0)],
        "judged_by": "truth",
        "log": "l",
        "picture": "p",
    }
    for as_json in (False, True):
        args = Namespace(candidate="new.toml", hand="jamia", accept_worse=True, json=as_json)
        assert _report_verification(args, [run], SimpleNamespace(exit_code=0)) == 1
        output = capsys.readouterr().out
        if as_json:
            assert (json.loads(output)["verified"], json.loads(output)["why_not"]) == (
                False,
                expected_reason,
            )
        else:
            assert output.splitlines()[-1] == f"not verified: {expected_reason}"


def test_an_existing_commissioning_log_is_accepted(work_folder):
    from handctl.session.run_plan import commissioning_log_path

    first_log = commissioning_log_path(work_folder / "run.mcap")
    assert first_log.name == "run.commission.mcap"
    first_log.write_text("")
    assert commissioning_log_path(work_folder / "run.mcap").name == "run.commission-2.mcap"


def test_a_digit_whose_sweep_touches_another_digit_is_blocked():
    from handctl.core.tick_types import TickEvent
    from handctl.log.read.timeline import LoggedEvent, PhaseChange
    from handctl.tune.identify.identify import blocked_digits

    event = LoggedEvent(
        50, 10**9, TickEvent("info", "blocked", "middle", "middle is blocked: 7.0 N")
    )
    phases = [
        PhaseChange(0, 0, "start"),
        PhaseChange(40, 0, "index sweep"),
        PhaseChange(60, 0, "ring sweep"),
    ]
    assert list(blocked_digits(SimpleNamespace(events=[event], phases=phases))) == ["index"]
    assert blocked_digits(SimpleNamespace(events=[], phases=phases)) == {}


def test_springs_too_weak_to_stretch_against_are_refused_in_one_line(work_folder, capsys):
    text = (
        load_hand("jamia")
        .to_toml()
        .replace("spring_preload_rad = [", "spring_preload_rad = [0.01, 0.01, 0.01]#[", 1)
    )
    (work_folder / "weak.toml").write_text(text)
    error_line = refusal_line(capsys, "identify", "--lockstep", "--hand", "weak.toml", "--dry-run")
    assert "digit[index].spring_preload_rad: the springs open the joints with" in error_line


def test_units_in_brackets_are_no_markup(fake_search, capsys):
    fake_search.append(SearchTrial(0, {}, GainScore(1.0, 2.0, 3.0, 60.0, -0.5)))
    assert (
        main(["tune", "search", "--plants", "1", "--trials", "1", "--study", "[bold].study"]) == 0
    )
    output = capsys.readouterr().out
    assert "[deg rms]" in output
    assert "[bold].study" in output
    _print_rounds(
        {
            "judged_by": "truth",
            "returned": None,
            "amplitudes": (1.0,),
            "verified": True,
            "failure": "",
            "log": "l",
            "picture": "p",
        },
        (),
        CANDIDATE_ARGS,
    )
    assert "[deg]" in capsys.readouterr().out


@pytest.mark.parametrize(
    "command_words",
    [
        ("identify", "--lockstep"),
        ("identify", "--from-log", GOLDEN_LOG),
        ("tune", "verify", "new.toml", "--lockstep"),
        ("commission", "--bus", "local:nobody"),
        ("jog", "index", "--tension", "8", "--bus", "local:nobody"),
        ("demo", "--lockstep"),
        ("replay", "drive", GOLDEN_LOG, "--bus", "local:nobody"),
    ],
)
def test_a_dry_run_writes_nothing_and_answers_in_json(work_folder, capsys, command_words):
    (work_folder / "new.toml").write_text("schema = 1\n")
    assert main([*command_words, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["hand"] == "jamia"
    assert [path.name for path in work_folder.iterdir()] == ["new.toml"]


@pytest.mark.parametrize(
    "command_words",
    [(), ("--from-log", GOLDEN_LOG, "--lockstep"), ("--lockstep", "--bus", "local:nobody")],
)
def test_an_identification_refuses_two_sources(capsys, command_words):
    assert "expected one of them" in refusal_line(capsys, "identify", *command_words)


def jamia_calibration(is_simulated: bool = False) -> Calibration:
    """Return a calibration of the packaged hand jamia without identified parameters."""
    hand = load_hand("jamia")
    tendon_calibration = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    return Calibration(
        hand="jamia", identity=hand.identity, made="2026-01-01T00:00:00+00:00",
        tendon=dict.fromkeys(hand.tendon_names, tendon_calibration), simulated=is_simulated,
    )  # fmt: skip


def test_a_calibration_in_lockstep_does_not_replace_the_real_one(work_folder, capsys, monkeypatch):
    calibration_path = work_folder / "jamia.calibration.toml"
    calibration = jamia_calibration()
    write_calibration(calibration_path, calibration)
    content_before, ended_run = (
        calibration_path.read_bytes(),
        SimpleNamespace(failure="", progress=SimpleNamespace(finished=True)),
    )
    outcome = SimpleNamespace(state=ended_run, raise_if_not_finished=lambda where: None)
    monkeypatch.setattr(
        "handctl.cli.tuning.identify._identify_in_lockstep", lambda *words: (calibration, outcome)
    )
    monkeypatch.setattr("handctl.cli.tuning.identify.RunLog", lambda log: nullcontext())
    monkeypatch.setattr("handctl.cli.tuning.identify.identify_tendons", lambda *words: {})
    assert main(["identify", "--lockstep", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["calibration"] == "jamia.lockstep.calibration.toml"
    assert calibration_path.read_bytes() == content_before
    assert main(["identify", "--lockstep", "--calibration", calibration_path.name, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["calibration"] == calibration_path.name


def result_of_digit(
    digit_name, spring_stiffness, blocked_text="", contact_text="", names=("tendon_stiffness",)
):
    """Return an invented result, as ``identify`` would return it for one tendon.

    ``blocked_text`` is the text about a blocked digit. ``contact_text`` is the text about a contact
    that the digit makes while the identification moves the digit to and fro.
    """
    from handctl.tune.identify.fit_tendon import PARAMETER_NAMES
    from handctl.tune.identify.identify import TendonResult

    values = dict.fromkeys(PARAMETER_NAMES, 1.0) | {"tendon_stiffness": spring_stiffness}
    problem = SimpleNamespace(parameter_scales=np.ones(len(PARAMETER_NAMES)))
    fit = SimpleNamespace(
        problem=problem,
        covariance=np.eye(len(PARAMETER_NAMES)),
        parameter_values=values,
        half_widths=values,
    )
    judged = SimpleNamespace(names=names, missing=())
    spectrum = (np.zeros(1), np.zeros(1))
    return TendonResult(
        SimpleNamespace(digit=digit_name, tendon=f"{digit_name}_tendon"),
        fit,
        judged,
        1.0,
        spectrum,
        blocked_event_text=blocked_text,
        contact_text=contact_text,
    )


def _replace_identification(monkeypatch, calibration, digit_results):
    """Replace the identification of ``handctl identify --lockstep`` by given results.

    ``identify`` then uses the argument ``calibration`` as its calibration, and ``digit_results`` as
    the results of the digits.
    """
    outcome = SimpleNamespace(raise_if_not_finished=lambda where: None)
    monkeypatch.setattr(
        "handctl.cli.tuning.identify._identify_in_lockstep", lambda *words: (calibration, outcome)
    )
    monkeypatch.setattr("handctl.cli.tuning.identify.RunLog", lambda log: nullcontext())
    monkeypatch.setattr(
        "handctl.cli.tuning.identify.identify_tendons", lambda *words: digit_results
    )
    monkeypatch.setattr("handctl.cli.tuning.identify._draw_pictures", lambda *words: [])
    monkeypatch.setattr("handctl.cli.tuning.identify.result_table", lambda *words: [])


def test_for_a_digit_in_contact_only_motor_and_tendon_are_written(work_folder, capsys, monkeypatch):
    """One output line names the digit, the parameters that are not written, the reason, and the user's next command."""
    hand, path = load_hand("jamia"), work_folder / "own.toml"
    calibration = jamia_calibration()
    names, why = ("tendon_stiffness", "spring_stiffness", "capstan"), "from 14 deg on it takes more"
    result_by_tendon = {
        "middle_tendon": result_of_digit("middle", 9e4, contact_text=why, names=names)
    }
    _replace_identification(monkeypatch, calibration, result_by_tendon)
    assert main(["identify", "--lockstep", "--calibration", "own.toml", "--log", "x.mcap"]) == 1
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "not kept" in line]
    begin = f"handctl: springs and friction of middle are not kept: {why}; expected a digit"
    assert line.startswith(begin)
    assert load_calibration(path, hand).identified["middle_tendon"].names == ("tendon_stiffness",)
    monkeypatch.setattr("handctl.cli.tuning.identify._result_fields", lambda *words: {})
    assert (
        main(["identify", "--lockstep", "--calibration", "own.toml", "--log", "x.mcap", "--json"])
        == 1
    )
    assert json.loads(capsys.readouterr().out)["met"] == {"middle": why}


@pytest.mark.parametrize(
    ("result_fields", "expected_reason"),
    [
        ({"contact_text": "more load"}, "no parameter was identified"),
        ({"blocked_text": "middle is blocked"}, "every digit was blocked"),
    ],
)
def test_the_reason_why_no_calibration_is_written_is_true(
    work_folder, capsys, monkeypatch, result_fields, expected_reason
):
    """Reproduce a defect: the output gave a wrong reason why no calibration is written.

    The output gave the reason "there is no own.toml: handctl commission first", although the hand
    was commissioned.
    """
    calibration = jamia_calibration()
    write_calibration(work_folder / "own.toml", calibration)
    result = result_of_digit("index", 9e4, names=("spring_stiffness",), **result_fields)
    _replace_identification(monkeypatch, calibration, {"index_tendon": result})
    assert main(["identify", "--lockstep", "--calibration", "own.toml", "--log", "x.mcap"]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == f"no calibration written: {expected_reason}"


@pytest.mark.parametrize("coherence", [0.08, 0.18, 0.25])
def test_values_of_a_low_coherence_are_not_kept(work_folder, capsys, monkeypatch, coherence):
    """Reproduce a defect: ``identify`` stored parameters that it had identified at a coherence of only 0.08."""
    hand, path = load_hand("jamia"), work_folder / "own.toml"
    calibration = jamia_calibration()
    names = ("tendon_stiffness", "motor_inertia", "delay")
    result = replace(result_of_digit("middle", 9e4, names=names), coherence=coherence)
    _replace_identification(monkeypatch, calibration, {"middle_tendon": result})
    assert main(["identify", "--lockstep", "--calibration", "own.toml", "--log", "x.mcap"]) == 0
    output = capsys.readouterr()
    has_enough_coherence = coherence > 0.2
    kept_parameters = load_calibration(path, hand).identified["middle_tendon"].names
    assert kept_parameters == (names if has_enough_coherence else ("tendon_stiffness",))
    assert ("tune search" in output.out) == has_enough_coherence
    assert ("not worth using" in output.err) != has_enough_coherence


@pytest.mark.parametrize("blocked_digits", [(), ("ring",), ("ring", "thumb")])
def test_a_fit_of_a_blocked_digit_is_not_written(work_folder, capsys, monkeypatch, blocked_digits):
    """Reproduce a defect: while fingers touched each other, a spring parameter of 3.05 was identified and stored.

    The true value of the spring parameter is 1.2.
    """
    hand, path = load_hand("jamia"), work_folder / "own.toml"
    calibration = jamia_calibration()
    entry = result_of_digit("index", 9e4).calibration_entry(Path("a"), "t")
    earlier_calibration = calibration.model_copy(update={"identified": {"index_tendon": entry}})
    write_calibration(path, earlier_calibration)
    known_content = path.read_bytes()
    result_by_tendon = {f"{name}_tendon": result_of_digit(name, 8e4) for name in blocked_digits}
    result_by_tendon["index_tendon"] = result_of_digit(
        "index", 3.05e5, "middle is blocked: 7.0 N at 3.1 s, in its sweep"
    )
    _replace_identification(monkeypatch, calibration, result_by_tendon)
    assert main(["identify", "--lockstep", "--calibration", "own.toml", "--log", "x.mcap"]) == 1
    output = capsys.readouterr()
    assert "no parameters of index are kept: middle is blocked" in output.err
    stored_parameters = load_calibration(path, hand).identified
    assert stored_parameters["index_tendon"].values == (9e4,)
    assert {
        name: parameters.values
        for name, parameters in stored_parameters.items()
        if name != "index_tendon"
    } == {f"{name}_tendon": (8e4,) for name in blocked_digits}
    assert blocked_digits or path.read_bytes() == known_content


@pytest.mark.parametrize(
    "command_words", [("--output", "x.png"), ("--output", "x.toml", "--picture", "./x.toml")]
)
@pytest.mark.parametrize("tune_command", ["design", "search"])
def test_gains_and_picture_are_two_files(work_folder, capsys, tune_command, command_words):
    """The command refuses equal names for gain file and picture, because the picture would overwrite the gains."""
    assert "the name of the picture" in refusal_line(
        capsys, "tune", tune_command, "--plants", "1", *command_words
    )
    assert not list(work_folder.iterdir())


@pytest.mark.parametrize(
    "file_name", ["jamia.calibration.toml", "jamia.gains.toml", "mine.study", "jamia.study"]
)
@pytest.mark.parametrize("option_name", ["--output", "--picture"])
def test_tuning_overwrites_no_other_file_of_the_hand(work_folder, capsys, file_name, option_name):
    (work_folder / "mine.study").write_text("mine")
    words = (
        "tune",
        "search",
        "--plants",
        "1",
        "--trials",
        "1",
        "--study",
        "mine.study",
        option_name,
        file_name,
    )
    assert "expected another name" in refusal_line(capsys, *words)
    assert (work_folder / "mine.study").read_text() == "mine"


def test_a_log_of_a_simulated_hand_is_not_used_for_the_real_hand(work_folder, capsys):
    assert main(["identify", "--from-log", GOLDEN_LOG, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["calibration"] == "jamia.lockstep.calibration.toml"
    real = work_folder / "real.mcap"
    with RunLog(Path(GOLDEN_LOG)) as log:
        LogWriter(
            real, replace(log.header, deterministic=False), lambda *arguments: None, 1
        ).finish("finished", 0)
    assert "is of a simulated hand" in refusal_line(
        capsys, "identify", "--from-log", str(real), "--from-log", GOLDEN_LOG
    )


def test_repeated_options_are_collected():
    parser = ArgumentParser()
    identify(parser)
    words = "--lockstep --perturb stiffness=0.8 --perturb friction=1.3 --digits index --digits ring"
    args = parser.parse_args(words.split())
    assert args.perturb == ["stiffness=0.8", "friction=1.3"]
    assert args.digits == ["index", "ring"]


@pytest.mark.parametrize(
    ("command_words", "expected_message"),
    [
        (
            ("identify", "--from-log", GOLDEN_LOG, "--digits", "thumb"),
            "--digits: together with --from-log",
        ),
        (("identify", "--lockstep", "--seed", "-1"), "--seed: -1; expected 0 or more"),
        (("identify", "--lockstep", "--time-scale", "0.5"), "--time-scale: only with --bus"),
        (("tune", "verify", "new.toml", "--lockstep", "--clear"), "--clear: only with --bus"),
        (("tune", "design", "--damping", "nan"), "--damping: nan; expected only with --poles-Hz"),
        (("tune", "design", "--poles-Hz", ""), "--poles-Hz: ''; expected two numbers"),
        (("bus", "plan", "--hand", ""), "no such hand or file"),
        (("bus", "plan", "--rate", "1e-300"), "--rate: 1e-300; expected 1 to 10000 Hz"),
    ],
)
def test_options_that_do_not_fit_together_are_refused(
    work_folder, capsys, command_words, expected_message
):
    assert expected_message in refusal_line(capsys, *command_words)


COMMANDS_WITH_PERTURB_OPTION = [
    ("identify", "--lockstep", "--dry-run"),
    ("tune", "design", "--plants", "1"),
    ("tune", "search", "--plants", "1", "--trials", "1"),
    ("tune", "verify", "new.toml", "--lockstep", "--dry-run"),
    ("demo", "--lockstep", "--dry-run"),
]
"""Commands with the option ``--perturb`` that simulate the hand in their own process.

The command ``sim`` is not in this list, because it starts a simulator and has its own test.
"""


@pytest.mark.parametrize(
    "cli_verb", COMMANDS_WITH_PERTURB_OPTION, ids=lambda words: "-".join(words[:2])
)
@pytest.mark.parametrize(
    ("command_words", "expected_message"),
    [
        (
            ("luck=2",),
            "--perturb: no such parameter: luck; expected one of stiffness, damping, friction",
        ),
        (("mass=0",), "--perturb: mass=0; expected a factor above 0"),
        (("friction=-1",), "--perturb: friction=-1; expected a finite factor, 0 or more"),
        (("mass",), "--perturb: 'mass'; expected KEY=NUMBER, e.g. stiffness=0.8"),
        (("mass=2", "mass=3"), "--perturb: mass is given twice; expected one value for each"),
        (
            ("mass=2", "--perturb", "mass=3"),
            "--perturb: mass is given twice; expected one value for each",
        ),
    ],
)
def test_a_wrong_perturbation_is_one_line_in_every_verb(
    work_folder, capsys, cli_verb, command_words, expected_message
):
    (work_folder / "new.toml").write_text("schema = 1\n")
    assert expected_message in refusal_line(capsys, *cli_verb, "--perturb", *command_words)
    assert [path.name for path in work_folder.iterdir()] == ["new.toml"]


@pytest.mark.parametrize(
    ("command_words", "expected_message"),
    [
        ("luck=2", "--perturb: no such parameter: luck; expected one of"),
        ("mass=2 mass=3", "--perturb: mass is given twice"),
    ],
)
def test_the_simulator_refuses_the_same_perturbations(capsys, command_words, expected_message):
    from firmware_sim.__main__ import main as simulate

    assert (
        simulate(
            [
                "--hand",
                "jamia",
                "--bus",
                "local:nobody",
                "--dry-run",
                "--perturb",
                *command_words.split(),
            ]
        )
        == 2
    )
    err = capsys.readouterr().err
    assert expected_message in err
    assert err.count("\n") == 1


def next_command(printed_output):
    """Return the words after ``next: handctl`` in the output of a command."""
    [line] = [line for line in printed_output.splitlines() if line.startswith("next: handctl ")]
    return shlex.split(line)[2:]


def test_the_printed_next_command_has_the_options_of_the_same_hand(capsys):
    from handctl.cli.tuning.identify import _search_command
    from handctl.cli.tuning.tune_files import verify_command

    given_options = {
        "hand": "my hand.toml",
        "gains": Path("a b.toml"),
        "gain": ["motion.force_N=16"],
        "rate": 250.0,
    }
    args = Namespace(
        **given_options, perturb=["stiffness=0.8", "friction=1.3"], fit=Path("x.calibration.toml")
    )
    hand_options = "--gains 'a b.toml' --gain motion.force_N=16 --rate 250 --perturb stiffness=0.8 friction=1.3"
    head = "handctl tune search --hand 'my hand.toml' --calibration x.calibration.toml "
    assert _search_command(args, Path("x.calibration.toml")) == head + hand_options
    head = "handctl tune verify new.toml --lockstep --hand 'my hand.toml' --calibration x.calibration.toml "
    assert verify_command(args, Path("new.toml")) == head + hand_options


@pytest.mark.parametrize("calibration_file", [None, Path("x.calibration.toml")])
def test_plants_are_perturbed_unless_the_perturbed_hand_was_identified(calibration_file):
    from handctl.cli.tuning.tune_files import ensemble_of_tuned_hand

    args = Namespace(
        hand="jamia",
        perturb=["stiffness=0.5", "torque_constant=1.1"],
        plants=3,
        seed=0,
        fit=calibration_file,
    )
    unperturbed_ensemble = ensemble_of_tuned_hand(Namespace(**vars(args) | {"perturb": []}), {}, 8)
    factors = {"stiffness": 0.5, "torque_constant": 1.1} if calibration_file is None else {}
    expected = tuple(
        plant_factors | {key: plant_factors.get(key, 1.0) * x for key, x in factors.items()}
        for plant_factors in unperturbed_ensemble
    )
    assert ensemble_of_tuned_hand(args, {}, 8) == expected


@pytest.mark.nightly
def test_parameters_identified_in_lockstep_are_tuned_verified_and_applied_in_lockstep(
    work_folder, capsys
):
    """Each command of this test was proposed in the output of the previous command.

    The test adds a few options to the proposed commands, for example ``--trials 2``.
    """
    words = "identify --lockstep --digits index --seed 7 --perturb stiffness=0.8 friction=1.2 --log id.mcap"
    assert main(words.split()) == 0
    words = next_command(capsys.readouterr().out)
    assert words[:2] == ["tune", "search"]
    assert words[-3:] == ["--perturb", "stiffness=0.8", "friction=1.2"]
    assert main([*words, "--plants", "1", "--trials", "2"]) == 0
    words = next_command(capsys.readouterr().out)
    assert words[:4] == ["tune", "verify", "jamia.search.toml", "--lockstep"]
    assert words[words.index("--calibration") + 1] == "jamia.lockstep.calibration.toml"
    assert words[-3:] == ["--perturb", "stiffness=0.8", "friction=1.2"]
    assert main([*words, "--seeds", "1", "--accept-worse", "--log", "verify.mcap"]) == 0
    [line] = [line for line in capsys.readouterr().out.splitlines() if "gains apply" in line]
    assert main(shlex.split(line.partition("handctl ")[2])) == 0
    assert (work_folder / "jamia.gains.toml").exists()


@pytest.mark.parametrize(
    ("bus", "other"),
    [("local:lab", False), ("socketcan:vcan0 socketcan:vcan1", False), ("socketcan:can0", True)],
)
def test_a_log_does_not_change_the_calibration_of_another_hand(
    work_folder, capsys, monkeypatch, bus, other
):
    """Reproduce a defect: a log of a simulated bus changed the identified parameters of the real hand."""
    calibration = jamia_calibration(is_simulated=other)
    write_calibration(Path("jamia.calibration.toml"), calibration)
    content_before = Path("jamia.calibration.toml").read_bytes()
    with RunLog(Path(GOLDEN_LOG)) as log:
        header = replace(
            log.header, deterministic=False, metadata={**log.header.metadata, "bus": bus}
        )
        LogWriter(Path("run.mcap"), header, lambda *arguments: None, 1).finish("finished", 0)
    monkeypatch.setattr("handctl.cli.tuning.identify.identify_tendons", lambda *words: {})
    kinds = ("a real hand", "a simulated hand") if other else ("a simulated hand", "a real hand")
    assert refusal_line(capsys, "identify", "--from-log", "run.mcap") == (
        f"handctl: run.mcap: is of {kinds[0]}; "
        f"expected --calibration FILE, because jamia.calibration.toml is of {kinds[1]}\n"
    )
    assert Path("jamia.calibration.toml").read_bytes() == content_before
    assert main(["identify", "--from-log", "run.mcap", "--no-write"]) == 0
    write_calibration(
        Path("jamia.calibration.toml"), calibration.model_copy(update={"simulated": not other})
    )
    assert main(["identify", "--from-log", "run.mcap"]) == 0
    assert "calibration written to jamia.calibration.toml" in capsys.readouterr().out
