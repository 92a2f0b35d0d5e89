"""Questions of ``handctl config init`` on the terminal, and the files written from the answers."""

import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

from handctl.cli.console.options import print_escaped
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.errors import ConfigError
from handctl.hand.file.json_schema import hand_schema_text
from handctl.output_files import write_text_atomically

SCHEMA_FILE = "hand.schema.json"
"""Name of the JSON Schema file, next to a new hand file."""


class HandQuestion(NamedTuple):
    """Question that the operator is asked about a new hand.

    Attributes:
        answer_field: name of the field in the answers.
        question_text: text of the question, without the default.
        read_answer: function that converts the text of an answer to a value, or raises ValueError.
        expected_text: description of a valid answer, for error messages.
    """

    answer_field: str
    question_text: str
    read_answer: Callable[[str], Any]
    expected_text: str


def reader_of_allowed_words(allowed_words: Collection[str]) -> Callable[[str], str]:
    """Return a function that accepts only the given words as an answer.

    For any text that is not among the given words, the returned function raises ValueError.
    """

    def read_choice(text: str) -> str:
        if text not in allowed_words:
            raise ValueError(text)
        return text

    return read_choice


TENDON_QUESTIONS = (
    HandQuestion("tendons", "Tendons of a digit: one, or one for each joint (one, each)",
                 reader_of_allowed_words(("one", "each")), "one or each"),
    HandQuestion("pulley_mm", "Moment arm of the tendons at the joints [mm]", float, "a number"),
    HandQuestion("spool_mm", "Radius of the spools, to the middle of the tendon [mm]", float, "a number"),
    HandQuestion("tension_N", "Largest tension that a tendon may be commanded [N]", float, "a number"),
    HandQuestion("strength_N", "Rated breaking force of the tendons [N]", float, "a number"),
)  # fmt: skip
"""Questions about the tendons of every new hand, in order."""
read_all_or_none = reader_of_allowed_words(("all", "none"))
"""Function that reads the answer ``all`` or ``none`` to a question about all tendons or all joints."""
SPRING_ANSWER_FIELD = "springs"
"""Field of the question about springs. The question is left out for digits that need springs."""
DRIVE_AND_SENSOR_QUESTIONS = (
    HandQuestion("cells", "Load cells at the tendons (all, none)", read_all_or_none, "all or none"),
    HandQuestion("encoders", "Encoders at the joints (all, none)", read_all_or_none, "all or none"),
    HandQuestion(
        SPRING_ANSWER_FIELD,
        "Return springs at the joints; without them, a tendon more opens each digit (all, none)",
        read_all_or_none,
        "all or none",
    ),
    HandQuestion(
        "protocol",
        f"Protocol of the drives ({', '.join(PROTOCOL_TRAITS)})",
        reader_of_allowed_words(PROTOCOL_TRAITS),
        ", ".join(PROTOCOL_TRAITS),
    ),
)
"""Questions about the sensors, springs and drives of every new hand, in order."""


def write_new_hand_file(output_path: Path, text: str) -> Path:
    """Write a new hand file.

    If the folder contains no JSON Schema of hand files yet, also write the schema into the folder.
    Return the path of the schema.
    """
    schema = output_path.parent / SCHEMA_FILE
    write_text_atomically(output_path, text, must_be_new=True)
    if not schema.exists():
        write_text_atomically(schema, hand_schema_text(), must_be_new=True)
    return schema


def check_terminal() -> None:
    """Check that there is a terminal at which an operator can answer questions.

    Raises:
        ConfigError: standard input is not a terminal.
    """
    if not (sys.stdin and sys.stdin.isatty()):
        raise ConfigError(
            "nobody can answer the questions: no terminal", "config init", "--yes, and options"
        )


def ask_question(question: HandQuestion, default_text: str, default_answer: Any) -> Any:
    """Ask a question until the answer is valid or empty.

    Return the answer. If the answer is empty, return the default.
    """
    while True:
        text = input(f"{question.question_text} [{default_text}]: ").strip()
        if not text:
            return default_answer
        try:
            return question.read_answer(text)
        except ValueError:
            print_escaped(f"{text!r}; expected {question.expected_text}")


def ask_motor_type(protocol: str | None, answer: str | None) -> str | None:
    """Ask for the type of the motors, unless the type is known or the protocol does not need the type.

    Args:
        protocol: protocol of the drives. None if the protocol is unknown.
        answer: motor type that an option gives, or None.

    Returns:
        the motor type, or None if the operator gives no answer.
    """
    motor_types = PROTOCOL_TRAITS[protocol].motor_types if protocol else ()
    if answer is not None or not motor_types:
        return answer
    names = ", ".join(motor_types)
    question = HandQuestion(
        "motor_type", f"Type of the motors ({names})", reader_of_allowed_words(motor_types), names
    )
    default = PROTOCOL_TRAITS[protocol or ""].options["motor_type"]
    return str(ask_question(question, default, default))
