"""Optional packages that each command of handctl needs.

handctl checks the optional packages before the command begins, and reports a missing package.
"""

import argparse

VERBS_WITHOUT_CONTROLLER = frozenset({"stop", "clear", "view", "log", "bus", "scan", "doctor"})
"""Commands that neither compute a tick of the controller nor draw a picture with matplotlib.

The exceptions ``bus plan`` and ``bus watch`` compute ticks of the controller.
"""


def optional_packages(verb: str, args: argparse.Namespace) -> tuple[str, ...]:
    """Return the import names of the optional packages that a command line needs.

    Args:
        verb: name of the command.
        args: parsed arguments of the command.
    """
    packages: list[str] = []
    if verb == "view" or getattr(args, "view", False):
        packages.append("rerun")
    if _needs_simulator(verb, args):
        packages.append("mujoco")
    if verb == "tune" and args.kind == "search":
        packages += ["optuna", *["distributed"] * bool(args.scheduler)]
    if "mujoco" not in packages and _needs_controller(verb, args):
        packages.append("numba")
    if getattr(args, "dataset", None) is not None:
        packages.append("pyarrow")
    if verb == "log" and args.what == "export":
        packages += {"rrd": ["rerun"], "parquet": ["pyarrow"], "lerobot": ["pyarrow"]}.get(
            args.format, []
        )
    return tuple(packages)


def _needs_controller(verb: str, args: argparse.Namespace) -> bool:
    """Return True if a command line needs the optional packages of the controller (the extra ``controller``)."""
    if verb == "bus":
        return args.what in ("plan", "watch")
    return verb not in VERBS_WITHOUT_CONTROLLER


def _needs_simulator(verb: str, args: argparse.Namespace) -> bool:
    """Return True if a command line starts a simulated hand."""
    if verb in ("demo", "sim") or getattr(args, "lockstep", False):
        return True
    if verb == "config":
        return bool(args.what == "init" and (args.urdf or args.mjcf))
    # If the file of results exists, the results are read from this file, without a simulation.
    if verb == "paper":
        return not (args.quick or (args.results and args.results.exists()))
    return (verb == "fault" and args.action in ("campaign", "sequences")) or (
        verb == "tune" and args.kind == "search"
    )
