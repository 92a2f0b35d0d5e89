"""Renamed options.

If the user writes an old spelling, the error message gives the new spelling. The table of renamed
options in docs/reference/command-line.md has the same rows.
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


def new_spelling(verb: str, option: str) -> str:
    """Return the new spelling of an option.

    Args:
        verb: command and subcommand, for example ``tune design``.
        option: option in the user's spelling.

    Returns:
        the new spelling. The text is empty if the option was not renamed.
    """
    return RENAMED_OPTIONS.get(verb, {}).get(option, "")
