"""Options of the command line that have been renamed.

If a user writes the old name of an option, an error message gives the new name. The table of
renamed options in docs/reference/command-line.md has the same rows as the table RENAMED_OPTIONS.
"""

RENAMED_OPTIONS = {
    "bus plan": {"--detail": "--verbose"},
    "conformance": {"--drive": "--protocol"},
    "fault campaign": {"--report": "--output"},
    "fault sequences": {"--report": "--output"},
    "gains apply": {"--fit": "--calibration"},
    "identify": {"--from": "--from-log"},
    "paper": {"--report": "--output"},
    "replay execute": {"--workers": "--jobs"},
    "tune design": {"--fit": "--calibration", "--out": "--output"},
    "tune search": {"--fit": "--calibration", "--out": "--output", "--workers": "--jobs"},
    "view": {"--png": "--picture"},
}
"""New spelling of each renamed option, by command and subcommand."""


def new_option_name(verb: str, option: str) -> str:
    """Return the new name of an option.

    Args:
        verb: command and subcommand, for example ``tune design``.
        option: option in the user's spelling.

    Returns:
        the new name, or an empty text if the option was not renamed.
    """
    return RENAMED_OPTIONS.get(verb, {}).get(option, "")
