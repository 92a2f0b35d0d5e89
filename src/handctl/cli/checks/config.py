"""``handctl config``: show a hand and its derived values, check its files, or export it for other tools."""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from handctl.cli.checks.rate_margin import force_warnings, rate_warnings
from handctl.cli.console.options import print_escaped, print_json
from handctl.cli.console.plan import find_calibration, gains_with_sources
from handctl.cli.console.verbosity import is_verbose
from handctl.controller.bus_load import bus_loads, bus_warnings
from handctl.controller.run_setup import (
    caution_lines,
    make_drives,
    make_sensors,
    unverified_protections,
)
from handctl.core.gains.gain_bounds import values_by_key
from handctl.core.gains.gains import packaged_gains
from handctl.core.identified_parameters import PARAMETER_UNITS
from handctl.drives.dbc_export import export_bus_dbc
from handctl.drives.protocol_registry import make_drive, missing_options
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.error_text import (
    SECTION_PATTERN,
    FileMistake,
    group_mistakes,
    with_paths_in_hand_file,
)
from handctl.hand.file.json_schema import hand_schema_text
from handctl.hand.file.templates import SCHEMA_WITHOUT_TEMPLATES, resolve_templates
from handctl.hand.formats.link_meshes import exported_meshes, mesh_mistakes
from handctl.hand.formats.mjcf import mjcf_text
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import (
    hand_from_content,
    hand_path,
    inspect_hand_content,
    load_hand,
    packaged_hands,
    parse_toml,
    read_toml,
)
from handctl.hand.readiness_checks import doubtful_values, moment_arm_fit_lines
from handctl.hand.tendon_strength import strength_warnings
from handctl.output_files import (
    FIGURE_SUFFIXES,
    check_output_path,
    path_with_suffix,
    write_text_atomically,
)
from handctl.programs.commission import idle_torque_warnings
from handctl.programs.default_task import grasp_warnings
from handctl.programs.task import load_task
from handctl.safety.missing_sensors import sensing_warnings
from handctl.session.exit_codes import ExitCode
from handctl.session.gains import PACKAGED_GAINS_SOURCE, GainsWithSources
from handctl.session.run_plan import (
    check_gain_margins,
    control_rate,
    highest_control_rate,
    protocol_hint_lines,
)
from handctl.session.task_loading import PACKAGED_TASKS_FOLDER, load_task_for_hand, task_path


def run(args: argparse.Namespace) -> int:
    """Run the selected subcommand of ``config``, and return the exit code."""
    if args.what == "list":
        return _print_packaged_files(args.json)
    if args.what == "init":
        from handctl.cli.checks.config_init import run as init

        return init(args)
    if args.what == "schema":
        return _write_schema(args)
    if args.what == "convert":
        return _convert_file(args)
    if args.what == "check" and (errors := _all_errors(args)):
        return _report_errors(args, errors)
    hand = load_hand(args.hand)
    if args.what == "export":
        return _export_hand(args, hand)
    if args.what == "show" and (args.graph or args.output):
        return _show_graph(args, hand)
    return _show_or_check_hand(args, hand)


def _all_errors(args: argparse.Namespace) -> list[str]:
    """Return one line for each error in a hand file and in the other files of the hand."""
    path = hand_path(args.hand)
    content = read_toml(path)
    hand, mistakes, origins = inspect_hand_content(content)
    option_mistakes = _missing_option_mistakes(content, origins)
    mistakes += option_mistakes
    if hand is not None:
        mistakes += group_mistakes(
            with_paths_in_hand_file(mesh_mistakes(hand, path.parent), origins)
        )
    errors = [mistake.error(str(path)) for mistake in mistakes]
    checks: list[Callable[[], object]] = []
    if hand is None:
        if args.task:
            checks.append(lambda: load_task(task_path(args.task)))
    elif not option_mistakes:
        checks = _file_checks(args, hand)
    for check in checks:
        try:
            check()
        except ConfigError as error:
            hand_section_match = SECTION_PATTERN.fullmatch(error.where)
            located_mistake = with_paths_in_hand_file(
                [FileMistake(error.what, error.where, error.right)], origins
            )
            errors.append(located_mistake[0].error(str(path)) if hand_section_match else error)
    key_paths = [error.where for error in errors]
    # If an error at a key of the hand file causes another error at the same key, only the first
    # error is reported.
    return [str(error) for i, error in enumerate(errors) if error.where not in key_paths[:i]]


def _missing_option_mistakes(
    content: Mapping[str, Any], origins: Mapping[str, str]
) -> list[FileMistake]:
    """Return one mistake for each option that the protocol of a motor requires and the hand file lacks.

    The function also reads a file with other mistakes, so that `config check` reports missing options
    together with the other mistakes.

    Args:
        content: parsed content of the hand file.
        origins: key path in the hand file, for each key path in the resolved content.
    """
    motors = resolve_templates(content).content.get("motor", [])
    mistakes = [
        FileMistake("missing", f"motor[{motor['name']}].options.{key}", expected)
        for motor in (motors if isinstance(motors, list) else [])
        if isinstance(motor, Mapping) and isinstance(motor.get("name"), str)
        for key, expected in missing_options(
            motor.get("protocol"), motor.get("options", {})
        ).items()
    ]
    return group_mistakes(with_paths_in_hand_file(mistakes, origins))


def _file_checks(args: argparse.Namespace, hand: Hand) -> list[Callable[[], object]]:
    """Return functions that check the files of a hand whose hand file is valid.

    Each function raises a ConfigError if it finds an error.
    """
    buses = hand.bus_names

    def check_task() -> None:
        """Check the task that the user has named.

        If no task is named, check the default task of the demo.
        """
        load_task_for_hand(args.task, hand)

    def check_calibration() -> None:
        """Check the calibration file that the user has named."""
        if args.calibration and not args.calibration.exists():
            raise ConfigError("no such file", str(args.calibration), "a calibration to check")
        find_calibration(args, hand)

    def check_design() -> None:
        """Check that the gains give a valid controller at the control rate of the hand."""
        check_gain_margins(
            hand, gains_with_sources(args, hand).gains, control_rate(None, hand, bus_loads(hand))
        )

    def check_scene() -> None:
        """Check that the hand can be simulated in the scene, if the user has named a scene."""
        if args.scene:
            # Only the check of the scene needs the module of the simulated hand, so this module is
            # imported here.
            from handctl.session.lockstep_simulation import SimulatorSettings

            SimulatorSettings(hand, args.scene).check_hand_constructible()

    drives = [partial(make_drive, motor, buses.index(motor.bus)) for motor in hand.motor]
    return [
        *drives,
        lambda: make_drives(hand),
        check_design,
        check_task,
        check_calibration,
        check_scene,
    ]


def _report_errors(args: argparse.Namespace, error_texts: list[str]) -> int:
    """Print one line for each error in the files of a hand, and return the exit code."""
    if args.json:
        print_json({"file": hand_path(args.hand).name, "errors": error_texts})
    for error in error_texts:
        print_escaped(f"handctl: {error}", error=True)
    return ExitCode.BAD_INPUT


def _show_graph(args: argparse.Namespace, hand: Hand) -> int:
    """Print the structure of a hand as text, or draw it as a picture."""
    from handctl.report.hand_graph import draw_hand, text_graph

    if not args.graph:
        raise ConfigError("no picture without it", "--output", "--graph with it")
    if args.output is None:
        print(text_graph(hand))
        return 0
    if args.output.suffix not in FIGURE_SUFFIXES:
        raise ConfigError(
            str(args.output), "--output", "a file ending in " + ", ".join(sorted(FIGURE_SUFFIXES))
        )
    check_output_path(args.output, "--output", Path(args.hand))
    draw_hand(args.output, hand)
    if args.json:
        print_json({"output": str(args.output)})
    else:
        print_escaped(
            f"{args.output}: {len(hand.digit)} digits, {len(hand.tendon)} tendons, {len(hand.bus)} buses"
        )
    return 0


def _show_or_check_hand(args: argparse.Namespace, hand: Hand) -> int:
    """Show a hand with its derived values and files, or check the hand."""
    sourced_gains = gains_with_sources(args, hand)
    if args.task:
        load_task_for_hand(args.task, hand)
    if args.calibration and not args.calibration.exists():
        raise ConfigError("no such file", str(args.calibration), "a calibration to check")
    calibration = _calibration_fields(args, hand)
    loads = bus_loads(hand)
    rate = highest_control_rate(loads)
    load = {bus_load.name: bus_load.load_at_rate(rate) for bus_load in loads}
    source = str(hand_path(args.hand).name)
    warnings = _hand_warnings(hand)
    if args.what == "check":
        # The default gains are already small enough for the control rate. At a low rate, a run may
        # fail with them, too, so that the warning is about the packaged gains.
        rate_gains = sourced_gains.gains if sourced_gains.file else packaged_gains(hand.name)
        warnings += rate_warnings(hand, rate_gains, rate)
        warnings += force_warnings(hand, sourced_gains.gains, rate)
    if args.json:
        print_json(
            {
                "file": source,
                "identity": hand.identity,
                "rate_hz": rate,
                "bus_load": load,
                "caveats": list(unverified_protections(make_drives(hand))),
                "warnings": warnings,
                "moment_arm_tables": list(moment_arm_fit_lines(hand)),
                "hand": hand.content,
                "gains": sourced_gains.gains.model_dump(by_alias=True),
                "gains_file": str(sourced_gains.file) if sourced_gains.file else "packaged",
                "gains_origins": sourced_gains.origins,
                "calibration": calibration,
            }
        )
        return 0
    if args.what == "show":
        print(f"# from {source}, identity {hand.identity[:16]}")
        print(hand.to_toml(), end="")
        print("\n".join(_gain_comment_lines(sourced_gains)))
        print("\n".join(f"# {line}" for line in _calibration_lines(calibration)))
    for text in caution_lines(make_drives(hand)):
        print(f"# caution: {text}")
    for text in protocol_hint_lines(hand) if is_verbose() else ():
        print(f"# hint: {text}")
    for text in warnings:
        print(f"# warning: {text}")
    for text in moment_arm_fit_lines(hand):
        print(f"# {text}")
    bus_loads_text = ", ".join(
        f"bus {name} {100 * fraction:.0f} %" for name, fraction in load.items()
    )
    print(
        f"# default rate {rate:g} Hz: {bus_loads_text}; gains: {_gains_text(sourced_gains)}; all files are valid"
    )
    return 0


def _gains_text(sourced_gains: GainsWithSources) -> str:
    """Return the path of the gains file, or a list of the gains that differ from the packaged gains."""
    if sourced_gains.file:
        return str(sourced_gains.file)
    values = values_by_key(sourced_gains.gains)
    changed_gains = [
        f", {key} = {values[key]:g} {origin}"
        for key, origin in sourced_gains.origins.items()
        if origin != PACKAGED_GAINS_SOURCE
    ]
    return PACKAGED_GAINS_SOURCE + "".join(changed_gains)


def _hand_warnings(hand: Hand) -> list[str]:
    """Return one line for each warning about a hand."""
    return [
        *doubtful_values(hand),
        *bus_warnings(hand),
        *strength_warnings(hand),
        *idle_torque_warnings(hand, make_drives(hand)),
        *sensing_warnings(hand),
        *grasp_warnings(hand),
    ]


def _gain_comment_lines(sourced_gains: GainsWithSources) -> list[str]:
    """Return TOML comments with the value and the origin of every gain.

    A hand file contains no gains, because gains belong in a separate file.
    """
    values = values_by_key(sourced_gains.gains)
    return [
        "",
        "# gains",
        *(f"# {key} = {value}  ({sourced_gains.origins[key]})" for key, value in values.items()),
    ]


def _calibration_fields(args: argparse.Namespace, hand: Hand) -> dict[str, Any]:
    """Return the calibration that a run would use, or the reason why there is no calibration.

    The calibration includes the identified parameters.
    """
    path, calibration, reason = find_calibration(args, hand)
    if calibration is None:
        return {"file": str(path), "problem": reason, "made": None, "identified": {}}
    identified = {
        tendon: {
            name: {
                "value": value,
                "half_width": width,
                "unit": PARAMETER_UNITS[name],
                "made": parameters.made,
            }
            for name, value, width in zip(
                parameters.names, parameters.values, parameters.half_widths, strict=True
            )
        }
        for tendon, parameters in calibration.identified.items()
    }
    return {"file": str(path), "problem": "", "made": calibration.made, "identified": identified}


def _calibration_lines(calibration_fields: dict[str, Any]) -> list[str]:
    """Return the fields of ``_calibration_fields`` as lines of text."""
    if calibration_fields["problem"]:
        return [f"calibration: {calibration_fields['problem']}"]
    return [f"calibration: {calibration_fields['file']}, made {calibration_fields['made']}"] + [
        f"{tendon}.{name} = {calibrated_value['value']:.5g} +- {calibrated_value['half_width']:.2g} "
        f"{calibrated_value['unit']}"
        f"  ({calibration_fields['file']}, identified {calibrated_value['made']})"
        for tendon, values in calibration_fields["identified"].items()
        for name, calibrated_value in values.items()
    ]


def _export_hand(args: argparse.Namespace, hand: Hand) -> int:
    """Write a description of a hand in the file format of another tool."""
    if args.dbc:
        return _export_buses(args, hand)
    if not (args.urdf or args.mjcf):
        raise ConfigError("no format", "export", "--dbc, --urdf or --mjcf")
    output = args.output or Path(f"{hand.name}.{'urdf' if args.urdf else 'xml'}")
    meshes = exported_meshes(hand, hand_path(args.hand).parent, output.parent)
    write_text_atomically(
        output, urdf_text(hand, meshes) if args.urdf else mjcf_text(hand, meshes), must_be_new=True
    )
    if args.json:
        print_json({"hand": hand.name, "output": str(output)})
    else:
        print_escaped(f"{output}: {len(hand.digit)} digits, {len(hand.joints)} joints")
    return 0


def _export_buses(args: argparse.Namespace, hand: Hand) -> int:
    """Write a DBC file for each bus of a hand.

    If the hand has several buses, the name of each DBC file contains the name of its bus.
    """
    output = args.output or Path(f"{hand.name}.dbc")
    drives = make_drives(hand)
    sensors = make_sensors(hand)
    buses = hand.bus_names
    written_paths = []
    for bus, name in enumerate(buses):
        path = output if len(buses) == 1 else path_with_suffix(output, f".{name}{output.suffix}")
        write_text_atomically(
            path,
            export_bus_dbc(bus, drives, sensors, hand.tendon_names, hand.joints),
            must_be_new=True,
        )
        written_paths.append({"bus": name, "output": str(path)})
    if args.json:
        print_json({"hand": hand.name, "files": written_paths})
    else:
        for written_path in written_paths:
            print_escaped(f"{written_path['output']}: bus {written_path['bus']}")
    return 0


def _write_schema(args: argparse.Namespace) -> int:
    """Print or write the JSON Schema of hand files."""
    text = hand_schema_text()
    if args.output is None:
        print(text, end="")
        return 0
    write_text_atomically(args.output, text, must_be_new=True)
    if args.json:
        print_json({"output": str(args.output)})
    else:
        print_escaped(f"{args.output}: begin a hand file with the line #:schema {args.output.name}")
    return 0


def _convert_file(args: argparse.Namespace) -> int:
    """Convert a hand file of schema 1 to schema 2, and write the new hand file."""
    from handctl.hand.file.schema_conversion import (
        convert_to_schema_2,  # tomlkit is imported here, because only this subcommand needs tomlkit
    )

    hand = load_hand(args.old)
    text = hand_path(args.old).read_text("utf-8")
    if parse_toml(text, str(args.old))["schema"] != SCHEMA_WITHOUT_TEMPLATES:
        raise ConfigError(
            "schema 2 already",
            f"{args.old}: schema",
            f"a file of schema {SCHEMA_WITHOUT_TEMPLATES}",
        )
    new_text = convert_to_schema_2(text, str(args.old))
    repeated_hand = hand_from_content(parse_toml(new_text, str(args.output)), str(args.output))
    if repeated_hand.identity != hand.identity:
        raise ConfigError(
            "describes another hand after its conversion",
            str(args.old),
            "a report of this as a bug",
        )
    write_text_atomically(args.output, new_text, must_be_new=True)
    lines = len(text.splitlines()), len(new_text.splitlines())
    if args.json:
        print_json({"output": str(args.output), "lines": lines, "identity": hand.identity})
    else:
        print_escaped(
            f"{args.output}: {lines[1]} lines instead of {lines[0]}, the same hand {hand.identity[:16]}"
        )
    return 0


def _print_packaged_files(as_json: bool) -> int:
    """Print the packaged hands and tasks."""
    tasks = sorted(path.name for path in PACKAGED_TASKS_FOLDER.glob("*.toml"))
    if as_json:
        print_json({"hands": list(packaged_hands()), "tasks": tasks})
    else:
        print("hands: " + ", ".join(packaged_hands()))
        print("tasks: " + ", ".join(tasks))
    return 0
