"""Fuzzing targets for texts of one line.

A text of one line is either a request to a running controller, or the description of an injected
fault.
"""

from collections.abc import Callable
from pathlib import Path

from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.description.hand_description import load_hand as load_simulated_hand
from firmware_sim.faults.fault_text import FAULT_KINDS, parse_fault
from fuzz.document_mutation import ByteSource
from fuzz.file_targets import check_single_line_message
from handctl.programs.requests import parse_request

FuzzTarget = Callable[[bytes], bool]


def request_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that parses requests to a controller in the same way as a running controller does."""

    def target(data: bytes) -> bool:
        parsed_request = parse_request(data.decode("utf-8", "replace"))
        if isinstance(parsed_request, str):
            assert parsed_request.isprintable(), parsed_request
            return False
        return True

    return target


FAULT_TEXT_WORDS = ("node", "bus", "encoder", "joint", "cell", "tendon", "digit", "size", "p", "at", "for", "seed",
    "3", "main",
         "index_tendon", "thumb", "sensors", "3s", "20ms", "0x10", "nan", "1e400", "-1", "0.5", "1_0", "٣")  # fmt: skip


def fault_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target that parses descriptions of injected faults.

    The inputs are arbitrary bytes, or random sequences of words that occur in descriptions of
    faults.
    """
    hand = load_simulated_hand("jamia")

    def target(data: bytes) -> bool:
        source = ByteSource(data)
        if source.take_number(2):
            text = data[source.at :].decode("utf-8", "replace")
        else:
            text = list(FAULT_KINDS)[source.take_number(len(FAULT_KINDS))]
            while not source.is_empty:
                key = FAULT_TEXT_WORDS[source.take_number(len(FAULT_TEXT_WORDS))]
                text += f" {key}={FAULT_TEXT_WORDS[source.take_number(len(FAULT_TEXT_WORDS))]}"
        try:
            parse_fault(text, hand)
        except SimulatorError as error:
            check_single_line_message(error)
            return False
        return True

    return target
