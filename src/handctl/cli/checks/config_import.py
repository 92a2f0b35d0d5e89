"""``handctl config init --urdf`` and ``--mjcf``: write a new hand file from a robot description."""

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handctl.cli.console.options import print_escaped, print_json
from handctl.cli.console.questions import (
    DRIVE_AND_SENSOR_QUESTIONS,
    SPRING_ANSWER_FIELD,
    TENDON_QUESTIONS,
    HandQuestion,
    ask_motor_type,
    ask_question,
    check_terminal,
    write_new_hand_file,
)
from handctl.drives.motor_description import (
    PROTOCOL_TRAITS,
    check_protocol_given,
    options_with_motor_type,
)
from handctl.errors import ConfigError
from handctl.hand.file.error_text import FileMistake
from handctl.hand.file.imported_hand_file import (
    IMPORT_ANSWER_NAMES,
    ImportAnswers,
    ImportedHand,
    imported_hand_text,
    usable_tendons,
)
from handctl.hand.file.new_hand_file import check_name, check_springs, options_line
from handctl.hand.file.quantity_types import NAME_PATTERN, UNMEASURED_PLACEHOLDER
from handctl.hand.formats.link_meshes import read_triangles, relative_path
from handctl.hand.formats.model_tree import ModelLink, ModelMesh, digits_from_links
from handctl.hand.hand_loading import inspect_hand_content, parse_toml
from handctl.session.model_file import read_model_file

OPTIONS_WITHOUT_DESCRIPTION = ("fingers", "opposed", "links_mm", "width_mm", "palm_mm")
"""Options that are refused together with a robot description, because the description contains their values."""
NODE_NUMBERS = range(1, 128)
"""Valid node numbers."""
IMPORT_QUESTIONS = (
    *TENDON_QUESTIONS,
    *DRIVE_AND_SENSOR_QUESTIONS,
    HandQuestion("first_node", "Node number of the first drive of a bus", int, "a whole number"),
)
"""Questions about the values that a robot description lacks, in the order of asking.

If an answer to a question is empty, the hand file marks the requested value as missing.
"""


def run(args: argparse.Namespace) -> int:
    """Read a robot description, ask for missing values, and write the hand file and the JSON Schema of hand files."""
    kind = "urdf" if args.urdf else "mjcf"
    for option in OPTIONS_WITHOUT_DESCRIPTION:
        if getattr(args, option) is not None:
            name = option.removesuffix("_mm")
            raise ConfigError(f"given, and so is --{kind}", f"--{name}", "one of them")
    imported_hand, notes = read_hand_description(args.urdf or args.mjcf, kind, args.output.parent)
    tendons, unread = usable_tendons(imported_hand)
    import_answers = ImportAnswers(**{name: getattr(args, name) for name in IMPORT_ANSWER_NAMES})
    if not args.yes:
        import_answers = _ask_questions(
            import_answers, {"tendons", "pulley_mm"} if tendons else set()
        )
    _check_name_and_first_node(import_answers)
    if not tendons:
        check_springs(import_answers.tendons, import_answers.springs)
    check_protocol_given(import_answers.protocol, import_answers.motor_type)
    protocol_traits = PROTOCOL_TRAITS[import_answers.protocol] if import_answers.protocol else None
    options = ""
    if import_answers.protocol:
        drive_options = options_with_motor_type(import_answers.protocol, import_answers.motor_type)
        options = options_line(
            import_answers.protocol, drive_options, import_answers.cells != "none"
        )
    text = imported_hand_text(
        imported_hand,
        import_answers,
        options,
        protocol_traits is not None and protocol_traits.can_fd,
    )
    mistakes = inspect_hand_content(parse_toml(text, str(args.output))).mistakes
    missing_values = [mistake for mistake in mistakes if UNMEASURED_PLACEHOLDER in mistake.what]
    schema = write_new_hand_file(args.output, text)
    warnings = [*notes, *unread, *_unexpected_mistakes(mistakes, missing_values, args.output)]
    joints = sum(len(digit.joints) for digit in imported_hand.digits)
    if args.json:
        importable_values = {
            "digits": len(imported_hand.digits),
            "joints": joints,
            "missing": [missing_value.where for missing_value in missing_values],
        }
        print_json(
            {
                "output": str(args.output),
                "schema": str(schema),
                **importable_values,
                "warnings": warnings,
            }
        )
        return 0
    print_escaped(
        f"{args.output}: {len(imported_hand.digits)} digits, {joints} joints; "
        f"{len(missing_values)} values are still {UNMEASURED_PLACEHOLDER}"
    )
    print_escaped(f"{schema}: keys of a hand file, for completion in an editor")
    for warning in warnings:
        print_escaped(f"warning: {warning}")
    print_escaped(f"next: handctl config check --hand {args.output}, which lists what is missing")
    return 0


def read_hand_description(
    path: Path, kind: str, output_path: Path
) -> tuple[ImportedHand, list[str]]:
    """Read a robot description, and return the hand that this description contains.

    Args:
        path: file of the description.
        kind: ``urdf`` or ``mjcf``.
        output_path: folder in which the hand file will be written. The hand file contains the paths of
            meshes relative to this folder.

    Returns:
        the hand, and one line of text for each part of the description that the function did not
        use.

    Raises:
        ConfigError: the file cannot be read or does not describe a tree of hinges with inertia.
    """
    model = read_model_file(path, kind)
    notes = list(model["notes"])
    links = [
        ModelLink.from_plain_values(
            link, _mesh_of_link(link["name"], link["meshes"], output_path, notes)
        )
        for link in model["links"]
    ]
    digits, palm, origin = digits_from_links(links, str(path))
    palm_mesh = _mesh_of_link("the palm", model["palm_meshes"], output_path, notes)
    gravity = model["gravity"]
    name = re.sub(r"\W+", "_", model["name"])
    imported_hand = ImportedHand(
        source=path.name,
        name=name if NAME_PATTERN.fullmatch(name) and name != UNMEASURED_PLACEHOLDER else "mine",
        gravity=None if gravity is None else (palm.T @ np.array(gravity)).tolist(),
        palm=palm,
        digits=digits,
        tendons=model["tendons"],
        palm_mesh=palm_mesh and palm_mesh.seen_from_frame(palm, origin),
    )
    return imported_hand, notes


def _mesh_of_link(
    link_name: str, meshes: Sequence[Mapping[str, Any]], output_path: Path, notes: list[str]
) -> ModelMesh | None:
    """Return the largest of a link's meshes that are allowed in a hand file, or None if no mesh is allowed.

    For each mesh that is left out, add a line to the list ``notes``.
    """
    sizes: dict[int, float] = {}
    for i, mesh in enumerate(meshes):
        try:
            corners = read_triangles(Path(mesh["file"])) * np.abs(mesh["scale"])
            sizes[i] = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
        except ValueError as error:
            notes.append(f"mesh {Path(mesh['file']).name} of {link_name} is left out: {error}")
    if not sizes:
        return None
    largest = max(sizes, key=sizes.__getitem__)
    for i in sizes.keys() - {largest}:
        notes.append(
            f"mesh {Path(meshes[i]['file']).name} of {link_name} is left out: a link can have only one mesh"
        )
    chosen_mesh = ModelMesh.from_plain_values(meshes[largest])
    return replace(chosen_mesh, file=relative_path(Path(chosen_mesh.file), output_path))


def _ask_questions(import_answers: ImportAnswers, known_keys: set[str]) -> ImportAnswers:
    """Ask the questions that neither the options nor the description answer."""
    check_terminal()
    for question in IMPORT_QUESTIONS:
        if question.answer_field == SPRING_ANSWER_FIELD and import_answers.tendons == "one":
            continue  # if only one tendon closes a digit, springs must open it
        if (
            getattr(import_answers, question.answer_field) is None
            and question.answer_field not in known_keys
        ):
            import_answers = replace(
                import_answers,
                **{question.answer_field: ask_question(question, UNMEASURED_PLACEHOLDER, None)},
            )
    return replace(
        import_answers,
        motor_type=ask_motor_type(import_answers.protocol, import_answers.motor_type),
    )


def _check_name_and_first_node(import_answers: ImportAnswers) -> None:
    """Check the name of the hand and the first node number before the hand file is written.

    The check of the new hand file finds mistakes in the operator's other answers.

    Raises:
        ConfigError: the name or the node number is wrong.
    """
    if import_answers.name is not None:
        check_name(import_answers.name)
    if import_answers.first_node is not None and import_answers.first_node not in NODE_NUMBERS:
        raise ConfigError(
            f"{import_answers.first_node}",
            "--first-node",
            f"{NODE_NUMBERS[0]} to {NODE_NUMBERS[-1]}",
        )


def _unexpected_mistakes(
    mistakes: Iterable[FileMistake], missing_values: list[FileMistake], output_path: Path
) -> list[str]:
    """Return one line for each mistake in the new hand file.

    Values that are missing in the new hand file do not count as mistakes.
    """
    return [
        str(mistake.error(str(output_path)))
        for mistake in mistakes
        if mistake not in missing_values
    ]
