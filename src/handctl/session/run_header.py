"""Header of a run's log.

The header describes the hand, the gains, the software, the machine and the settings of a run.
"""

import functools
import platform
import sys
import time
from importlib.metadata import Distribution, distributions, version

from handctl.controller import run_setup
from handctl.controller.tick import Controller
from handctl.hand.formats.urdf import urdf_text
from handctl.log.code_identity import code_identity
from handctl.log.header import RunHeader
from handctl.runtime.clocks.realtime_priority import GrantedPriority
from handctl.session.run_plan import RunPlan

LOCKSTEP_START_TIME_S = 0.0
"""UNIX time that a log gives as the start of a lockstep run [s].

The start time is constant, so that equal lockstep runs have equal logs.
"""


def run_header(
    plan: RunPlan, controller: Controller, priority: GrantedPriority | None, lockstep: bool
) -> RunHeader:
    """Return the header of a run's log, with all data that are known before the first tick."""
    hand = plan.hand
    attachments = {
        "hand.toml": hand.to_toml().encode(),
        "hand.urdf": urdf_text(hand).encode(),
        run_setup.SETUP_ATTACHMENT_NAME: run_setup.RunSetup.from_controller(
            controller, plan.rate_hz
        )
        .model_dump_json(by_alias=True, indent=2)
        .encode(),
        "gains.json": plan.gains.model_dump_json(by_alias=True, indent=2).encode(),
        "pip-freeze.txt": "\n".join(installed_packages()).encode(),
        **plan.attachments,
    }
    wall_clock = {
        "host": platform.node(),
        "kernel": platform.release(),
        "python": sys.version.split()[0],
        "priority": str(priority),
        "started": time.strftime(
            "%Y-%m-%dT%H:%M:%SZ", time.gmtime(LOCKSTEP_START_TIME_S if lockstep else None)
        ),
    }
    metadata = {
        "version": version("handctl"),
        "code": code_identity(),
        "hand": hand.name,
        "identity": hand.identity,
        "bus": " ".join(plan.buses) or "lockstep",
        "rate_hz": f"{plan.rate_hz:g}",
        "time_scale": f"{plan.time_scale:g}",
    }
    if caveats := run_setup.unverified_protections(controller.drives):
        metadata["caveats"] = "; ".join(caveats)
    return RunHeader.from_hand(
        hand.to_toml(),
        plan.period_ns,
        offset_ns=0 if lockstep else time.time_ns(),
        metadata=metadata,
        gains=_flatten_table(plan.gains.model_dump(by_alias=True)),
        attachments=attachments,
        wall=wall_clock,
        deterministic=lockstep,
    )


@functools.cache
def installed_packages() -> tuple[str, ...]:
    """Return the name and version (NAME==VERSION) of every installed Python package, in alphabetical order."""
    return tuple(sorted({_name_and_version(distribution) for distribution in distributions()}))


def _name_and_version(distribution: Distribution) -> str:
    """Return the name and version (NAME==VERSION) of an installed Python package.

    The function reads only two lines of the package's metadata file: the name and the version. The
    parser of ``importlib.metadata`` reads the whole metadata file, and takes ten times as long.
    """
    lines = (
        distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or ""
    ).splitlines()
    values = [
        next((line[len(key) :] for line in lines if line.startswith(key)), "")
        for key in ("Name: ", "Version: ")
    ]
    return "==".join(values) if all(values) else f"{distribution.name}=={distribution.version}"


def _flatten_table(nested_table: dict[str, object], key_prefix: str = "") -> dict[str, str]:
    flat: dict[str, str] = {}
    for key, value in nested_table.items():
        flat |= (
            _flatten_table(value, f"{key_prefix}{key}.")
            if isinstance(value, dict)
            else {f"{key_prefix}{key}": str(value)}
        )
    return flat
