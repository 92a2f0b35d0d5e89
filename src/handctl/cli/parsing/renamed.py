"""Options that were renamed: the old spelling is refused with one line that names the new one.

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
"""Verb and sub-verb, to the new spelling of each old option."""


def new_spelling(verb: str, option: str) -> str:
    """Return the new spelling of an option.

    Args:
        verb: verb and sub-verb, for example ``tune design``.
        option: as a user wrote it.

    Returns:
        The new spelling, empty if the option was not renamed.
    """
    return RENAMED.get(verb, {}).get(option, "")
