"""``handctl gains``: show, compare, apply and roll back the gains of a hand, even while the hand runs."""

import argparse
import itertools
from pathlib import Path
from typing import Any

from handctl.cli.console.buses import controller_bus
from handctl.cli.console.options import print_escaped, print_json
from handctl.cli.console.plan import default_gains, gains_with_sources, print_notice
from handctl.cli.console.verbosity import is_quiet
from handctl.core.gains.gain_bounds import (
    GainBounds,
    changed_gain_values,
    checked_gain_bounds,
    gains_with_values,
    values_by_key,
)
from handctl.core.gains.gains import Gains, GainsProvenance, load_gains_file, packaged_gains
from handctl.errors import ConfigError, UnconfirmedError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.programs.requests import REFUSAL_EVENT_PREFIX
from handctl.session.exit_codes import ExitCode
from handctl.session.gains import gain_assignments, read_gains_for_hand
from handctl.session.run_plan import check_gain_margins
from handctl.tune.gains_store import GainsStore, StoredGains

GAIN_CHANGE_TIMEOUT_S = 3.0
"""Longest time until a running controller uses new gains, including the design with the new gains [s]."""


def run(args: argparse.Namespace) -> int:
    """Run the selected subcommand of ``gains``, and return the exit code."""
    if args.what == "set":
        return _change_live_gains(args)
    function_by_subcommand = {
        "show": _show_gains,
        "diff": _print_diff,
        "apply": _apply_file,
        "rollback": _roll_back,
        "log": _print_history,
    }
    return function_by_subcommand[args.what](args, load_hand(args.hand))


def _show_gains(args: argparse.Namespace, hand: Hand) -> int:
    """Print the value, the source, the meaning and the bounds of every gain."""
    gains_and_sources = gains_with_sources(args, hand)
    values = values_by_key(gains_and_sources.gains)
    gain_bounds = {key: checked_gain_bounds(key, value, "gains") for key, value in values.items()}
    provenance = gains_and_sources.provenance
    if args.json:
        rows = {
            key: {
                "value": value,
                "origin": gains_and_sources.origins[key],
                "bounds": str(gain_bounds[key]),
                "live": gain_bounds[key].is_changeable_live,
                "meaning": gain_meaning(gain_bounds[key]),
            }
            for key, value in values.items()
        }
        print_json({"hand": hand.name, "gains": rows, "provenance": provenance.model_dump()})
        return ExitCode.DONE
    print_escaped(
        f"# gains of {hand.name}: {gains_and_sources.file or 'packaged'}"
        + _provenance_text(provenance)
    )
    for key, value in values.items():
        when = (
            "changes at any time"
            if gain_bounds[key].is_changeable_live
            else "changes before arming"
        )
        print_escaped(f"{key:<38} {value:<10g} {gains_and_sources.origins[key]}")
        if not is_quiet():
            print_escaped(
                f"    {gain_meaning(gain_bounds[key])} {str(gain_bounds[key]).capitalize()}, {when}."
            )
    return ExitCode.DONE


def gain_meaning(gain: GainBounds) -> str:
    """Return the meaning and the unit of a gain.

    The meaning and the unit come from the first line of the gain's description.
    """
    return gain.meaning.partition("\n")[0]


def _provenance_text(provenance: GainsProvenance) -> str:
    """Return a phrase with the history number, the date and the sources of gains."""
    sources = [*provenance.log, *filter(None, (provenance.fit, provenance.study, provenance.note))]
    number = f", number {provenance.number}" if provenance.number else ""
    date_text = f", made {provenance.made}" if provenance.made else ""
    return number + date_text + (f", from {', '.join(sources)}" if sources else "")


def _print_diff(args: argparse.Namespace, hand: Hand) -> int:
    """Print the differences between two sets of gains.

    Raises:
        ConfigError: more than two sets of gains are named.
    """
    sides = {0: ["packaged", "present"], 1: ["present", *args.sides], 2: args.sides}.get(
        len(args.sides)
    )
    if sides is None:
        raise ConfigError(f"{len(args.sides)} sides", "gains diff", "at most two")
    old_gains, new_gains = (_gains_to_compare(word, hand) for word in sides)
    changed = changed_gain_values(old_gains, new_gains)
    if args.json:
        print_json({"sides": sides, "changed": changed})
        return ExitCode.DONE
    for key, (old_value, new_value) in changed.items():
        print(f"{key:<38} {old_value:g} -> {new_value:g}")
    print(
        f"{len(changed)} of {len(values_by_key(new_gains))} gains differ between {sides[0]} and {sides[1]}"
    )
    return ExitCode.DONE


def _gains_to_compare(gains_name: str, hand: Hand) -> Gains:
    """Return the set of gains with the name ``gains_name``.

    The name of a set of gains is "packaged", "present", a number in the history, a log, or a gains
    file.

    Raises:
        ConfigError: the history contains no entry with this number.
    """
    store = GainsStore(hand.name)
    if gains_name == "packaged":
        return packaged_gains(hand.name)
    if gains_name == "present":
        present_gains = store.present_gains()
        return present_gains.gains if present_gains else default_gains(hand)
    if gains_name.isdecimal():
        entries = {str(entry.number): entry.file.gains for entry in store.history_entries()}
        if gains_name.lstrip("0") not in entries:
            raise ConfigError(
                f"no gains number {gains_name}",
                str(store.history_folder),
                "one that handctl gains log lists",
            )
        return entries[gains_name.lstrip("0")]
    if gains_name.endswith(".mcap"):
        from handctl.log.read.reader import RunLog
        from handctl.replay.controller_rebuild import logged_gains

        with RunLog(Path(gains_name)) as log:
            return logged_gains(log)
    return load_gains_file(Path(gains_name)).gains


def _apply_file(args: argparse.Namespace, hand: Hand) -> int:
    """Replace the present gains of the hand by the gains in a file."""
    file = read_gains_for_hand(hand, args.file, print_notice)
    check_gain_margins(hand, file.gains)
    options = {
        "fit": args.fit,
        "study": args.study,
        "note": args.note,
        "log": tuple(map(str, args.log)),
    }
    provenance = file.provenance.model_copy(
        update={key: value for key, value in options.items() if value}
    )
    store = GainsStore(hand.name, hand.identity)
    _rename_unusable_gains(store)
    return _report_stored_gains(args, store, store.apply_gains(file.gains, provenance).provenance)


def _roll_back(args: argparse.Namespace, hand: Hand) -> int:
    """Restore gains from the history: the gains with the given number, or by default the previous gains.

    If the command line gives no number and the file of the present gains cannot be used, restore
    the newest entry of the history.
    """
    store = GainsStore(hand.name, hand.identity, default_gains=default_gains(hand))
    entries = store.history_entries()
    newest_number = entries[-1].number if entries else 0
    to = newest_number if _rename_unusable_gains(store) and args.to is None else args.to
    return _report_stored_gains(args, store, store.roll_back(to).provenance)


def _rename_unusable_gains(store: GainsStore) -> bool:
    """Rename the file of the present gains if it is unusable, and report the new name of the file.

    Return True if a file was renamed.
    """
    renamed_path = store.rename_damaged_file()
    if renamed_path:
        print_escaped(
            f"handctl: {store.path} cannot be used, and was renamed to {renamed_path}", error=True
        )
    return bool(renamed_path)


def _report_stored_gains(
    args: argparse.Namespace, store: GainsStore, provenance: GainsProvenance
) -> int:
    if args.json:
        print_json({"file": str(store.path), "provenance": provenance.model_dump()})
    else:
        print_escaped(f"{store.path}{_provenance_text(provenance)}")
    return ExitCode.DONE


def _print_history(args: argparse.Namespace, hand: Hand) -> int:
    """Print the history of the gains applied to the hand, and mark the present entry."""
    store = GainsStore(hand.name)
    entries = store.history_entries()
    try:
        present = store.present_gains()
    except ConfigError as error:
        print_escaped(
            f"handctl: {error}; handctl gains rollback brings back number {entries[-1].number if entries else 0}",
            True,
        )
        present = None
    if args.json:
        print_json(
            {
                "present": _gains_number(present),
                "entries": [entry.file.provenance.model_dump() for entry in entries],
            }
        )
        return ExitCode.DONE
    for entry in entries:
        present_mark = "*" if entry.number == _gains_number(present) else " "
        print_escaped(f"{present_mark} {entry.number:>4}  {_history_line(entry, entries)}")
    print(
        f"{len(entries)} applied; present: {_gains_number(present) or 'packaged' if present is None else store.path}"
    )
    return ExitCode.DONE


def _gains_number(stored_gains: Any) -> int:
    return stored_gains.provenance.number if stored_gains else 0


def _history_line(entry: StoredGains, stored_gains: list[StoredGains]) -> str:
    """Return a history entry as one line: date, sources, and the names of the first three changed gains."""
    gains_by_number = {
        stored_entry.number: stored_entry.file.gains for stored_entry in stored_gains
    }
    replaced_gains = gains_by_number.get(
        entry.file.provenance.replaces, packaged_gains(entry.file.provenance.hand)
    )
    changed = list(changed_gain_values(replaced_gains, entry.file.gains))
    first_changes = ", ".join(changed[:3]) + (" .." if len(changed) > 3 else "")
    time_and_sources = _provenance_text(entry.file.provenance).partition(", made ")[2]
    return time_and_sources + (
        f"; changes {first_changes}" if first_changes else "; changes nothing"
    )


def _change_live_gains(args: argparse.Namespace) -> int:
    """Change gains of a running controller, and return the exit code.

    An invalid value raises an error before a request is sent.
    """
    from handctl.runtime.confirmed_requests import (
        open_watcher,
        report_absent_controller,
        send_with_confirmation,
    )

    values = gain_assignments(args.values, "gains set")
    gains_with_values(Gains(), values, "gains set", is_live=True)
    bus = controller_bus(args)
    watcher = open_watcher(bus, "gains")
    try:
        watcher.request_status_line(GAIN_CHANGE_TIMEOUT_S)
        with report_absent_controller(bus):
            line, texts = send_with_confirmation(watcher, {"do": "gains", "set": values})
        for text in texts:
            _raise_refusal(text)
        confirmed_values = _wait_for_answers(watcher, values, line)
    finally:
        watcher.close()
    if args.json:
        print_json({"bus": bus, "set": confirmed_values})
    else:
        print(
            "\n".join(f"{key} = {text}" for key, text in confirmed_values.items())
            or "no change: these gains are in use"
        )
    return ExitCode.DONE


def _wait_for_answers(
    watcher: Any, requested_values: dict[str, float], first_status_line: dict[str, Any]
) -> dict[str, str]:
    """Wait until the controller has answered a request to change gains.

    Return the event text of each changed gain.

    Raises:
        ConfigError: the controller refuses the gains.
        UnconfirmedError: the controller does not confirm the gains in time.
    """
    texts: dict[str, str] = {}
    for line in itertools.chain((first_status_line,), watcher.status_lines(GAIN_CHANGE_TIMEOUT_S)):
        for event in line["events"]:
            if event["name"] == "gain" and event["where"] in requested_values:
                texts[event["where"]] = event["text"]
            if event["name"] == "gains":
                _raise_refusal(event["text"])
                return texts
    raise UnconfirmedError(watcher.name, "gains", "received, but not confirmed")


def _raise_refusal(text: str) -> None:
    """Raise an error if the text of an event says that the controller has refused a request.

    Raises:
        ConfigError: the controller refused the request.
    """
    if text.startswith(REFUSAL_EVENT_PREFIX):
        raise ConfigError(text.removeprefix(REFUSAL_EVENT_PREFIX), "the controller")
