"""``handctl config init``: write a new hand file from options, and ask the operator for missing values."""

import argparse
from dataclasses import fields, replace

from handctl.cli.console.options import print_escaped, print_json
from handctl.cli.console.questions import (
    DRIVE_AND_SENSOR_QUESTIONS,
    SCHEMA_FILE,
    SPRING_ANSWER_FIELD,
    TENDON_QUESTIONS,
    HandQuestion,
    ask_motor_type,
    ask_question,
    check_terminal,
    write_new_hand_file,
)
from handctl.drives.motor_description import PROTOCOL_TRAITS, options_with_motor_type
from handctl.errors import ConfigError
from handctl.hand.file.new_hand_file import (
    NewHandAnswers,
    check_new_hand_answers,
    new_hand_text,
    opposition_warnings,
    palm_warnings,
)
from handctl.hand.hand_loading import inspect_hand_content, parse_toml
from handctl.programs.default_task import grasp_warnings


def lengths_from_text(text: str) -> tuple[float, ...]:
    """Parse a text such as ``40,30``, and return the lengths [mm]."""
    return tuple(float(length_text) for length_text in text.replace(",", " ").split())


HAND_QUESTIONS = (
    HandQuestion("name", "Name of the hand", str, "a word"),
    HandQuestion("fingers", "Digits on one side", int, "a whole number"),
    HandQuestion(
        "opposed", "Digits that close against them, as a thumb does", int, "a whole number"
    ),
    HandQuestion(
        "links_mm",
        "Length of each link, from the palm outwards [mm]",
        lengths_from_text,
        "numbers, e.g. 40,30",
    ),
    HandQuestion("width_mm", "Width of the links [mm]", float, "a number"),
    HandQuestion("palm_mm", "Distance between the two sides of the palm [mm]", float, "a number"),
    *TENDON_QUESTIONS,
    *DRIVE_AND_SENSOR_QUESTIONS,
)
"""Questions about a new hand, in the order of asking.

If an option already answers a question, the question is skipped.
"""
OPTIONS_WITH_DESCRIPTION = ("first_node",)
"""Options that are valid only for a hand imported from a robot description."""
SCALED_DEFAULT_BY_KEY = {"palm_mm": "palm", "pulley_mm": "joint_moment_arm_mm"}
"""Fields whose default is computed, each with the attribute of the answers that computes the default.

The computed default is proportional to other answers.
"""


def run(args: argparse.Namespace) -> int:
    """Ask the questions that no option answers, and write the hand file and the JSON Schema of hand files."""
    if args.urdf or args.mjcf:
        from handctl.cli.checks.config_import import run as from_description

        return from_description(args)
    for option in OPTIONS_WITH_DESCRIPTION:
        if getattr(args, option) is not None:
            raise ConfigError(
                "only for an imported hand",
                f"--{option.replace('_', '-')}",
                "--urdf or --mjcf with it",
            )
    answer_by_field = {field.name: getattr(args, field.name) for field in fields(NewHandAnswers)}
    hand_answers = replace(
        NewHandAnswers(),
        **{name: value for name, value in answer_by_field.items() if value is not None},
    )
    if not args.yes:
        hand_answers = _ask_questions(args, hand_answers)
    check_new_hand_answers(hand_answers)
    options = options_with_motor_type(hand_answers.protocol, hand_answers.motor_type)
    can_fd = PROTOCOL_TRAITS[hand_answers.protocol].can_fd
    text = f"#:schema {SCHEMA_FILE}\n" + new_hand_text(hand_answers, options, can_fd)
    inspected_hand = inspect_hand_content(parse_toml(text, str(args.output)))
    if inspected_hand.mistakes or inspected_hand.hand is None:
        raise inspected_hand.mistakes[0].error("the answers")
    warnings = [
        *opposition_warnings(hand_answers),
        *palm_warnings(hand_answers),
        *grasp_warnings(inspected_hand.hand),
    ]
    schema = write_new_hand_file(args.output, text)
    assumed_count = sum("ASSUMED" in line for line in text.splitlines()) - 1
    if args.json:
        print_json(
            {
                "output": str(args.output),
                "schema": str(schema),
                "assumed": assumed_count,
                "warnings": warnings,
            }
        )
        return 0
    print_escaped(
        f"{args.output}: {hand_answers.fingers + hand_answers.opposed} digits; {assumed_count} lines are marked ASSUMED"
    )
    print_escaped(f"{schema}: keys of a hand file, for completion in an editor")
    for text in warnings:
        print_escaped(f"warning: {text}")
    print_escaped(
        f"next: handctl config check --hand {args.output}; handctl demo --lockstep --hand {args.output}"
    )
    return 0


def _ask_questions(args: argparse.Namespace, hand_answers: NewHandAnswers) -> NewHandAnswers:
    """Ask the questions that no option answers. An empty answer selects the default.

    Raises:
        ConfigError: standard input is not a terminal, so no operator can answer.
    """
    check_terminal()
    for question in HAND_QUESTIONS:
        if getattr(args, question.answer_field) is not None:
            continue
        if question.answer_field == SPRING_ANSWER_FIELD and hand_answers.tendons == "one":
            continue  # if only one tendon closes a digit, springs must open it
        default = getattr(
            hand_answers, SCALED_DEFAULT_BY_KEY.get(question.answer_field, question.answer_field)
        )
        default_text = (
            ",".join(f"{default_value:g}" for default_value in default)
            if isinstance(default, tuple)
            else str(default)
        )
        default_text = f"{default:.3g}" if isinstance(default, float) else default_text
        hand_answers = replace(
            hand_answers, **{question.answer_field: ask_question(question, default_text, default)}
        )
    return replace(
        hand_answers, motor_type=ask_motor_type(hand_answers.protocol, hand_answers.motor_type)
    )
