"""Renamed options. An old spelling is refused with one line that gives the new spelling.

The table in docs/reference/command-line.md has the same rows.
"""

RENAMED = {
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
"""New spelling of each old option, by verb and sub-verb."""


def new_spelling(verb: str, option: str) -> str:
    """Return the new spelling of an option.

    Args:
        verb: verb and sub-verb, for example ``tune design``.
        option: option as the user wrote it.

    Returns:
        The new spelling, empty if the option was not renamed.
    """
    return RENAMED.get(verb, {}).get(option, "")
