"""``handctl doctor``: check the permissions and devices of this machine, and print a remedy for each problem."""

import argparse
import platform
import shutil
import socket
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from handctl.cli.console.options import print_json
from handctl.cli.console.verbosity import is_quiet, is_verbose, print_detail
from handctl.errors import BusError
from handctl.extras import installed_by_extra
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.clocks.realtime_priority import (
    GrantedPriority,
    realtime_priority,
    request_priority,
    restore_priority,
)
from handctl.runtime.socket_paths import run_dir
from handctl.session.exit_codes import ExitCode

WAKEUP_TEST_S = 1.0
"""Time for which the lateness of wake-ups is measured [s]."""
WAKEUP_PERIOD_NS = 1_000_000
"""Time between the deadlines of two wake-ups [ns]."""
MAX_WAKEUP_LATENESS_S = 0.002
"""Lateness of a wake-up at which the check of the wake-ups fails [s].

The limit is the control period at a control rate of 500 Hz.
"""


def run(args: argparse.Namespace) -> int:
    """Check the process priority, CAN, the viewer and the disk space of this machine.

    Return 1 if a problem was found.
    """
    findings = [
        _check_priority(),
        _check_locked_memory(),
        _check_wakeups(),
        _check_socketcan(),
        _check_interfaces(),
        _check_vulkan(),
        _optional_package_finding(),
        _check_disk_space(),
    ]
    if args.json:
        rows = [
            {"what": subject, "good": is_good, "fix": remedy}
            for subject, is_good, remedy in findings
        ]
        print_json({"findings": rows} | _version_fields())
    else:
        _print_findings(findings)
    return ExitCode.DONE if all(good for _, good, _ in findings) else ExitCode.FAILED


def _print_findings(findings: Sequence["DoctorFinding"]) -> None:
    """Print the findings about this machine.

    With ``--quiet``, good findings are left out. With ``--verbose``, the versions of the software
    are added.
    """
    for subject, is_good, remedy in findings:
        if not (is_good and is_quiet()):
            print(
                f"{'ok ' if is_good else '-- '} {subject}"
                + ("" if is_good else f"\n      {remedy}")
            )
    if is_verbose():
        for name, value in _version_fields().items():
            print_detail(f"{name}: {value}")


DoctorFinding = tuple[str, bool, str]


def _version_fields() -> dict[str, object]:
    """Return the data for a bug report: versions, operating system and installed optional packages."""
    return {
        "version": version("handctl"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "extras": installed_by_extra(),
    }


def _optional_package_finding() -> DoctorFinding:
    missing_names = [extra for extra, installed in installed_by_extra().items() if not installed]
    return (
        f"optional packages; not installed: {', '.join(missing_names) or 'none'}",
        True,
        "",
    )  # the controller itself needs no optional packages


def _granted_priority() -> GrantedPriority:
    """Request and release real-time priority, and return the priority that the system granted."""
    granted_priority = request_priority()
    restore_priority()
    return granted_priority


def _check_priority() -> DoctorFinding:
    has_realtime = _granted_priority().is_realtime
    return (
        "real-time priority (SCHED_FIFO)",
        has_realtime,
        "allow it: ulimit -r 60, or a line 'USER - rtprio 60' in limits.conf",
    )


def _check_locked_memory() -> DoctorFinding:
    is_memory_locked = _granted_priority().is_memory_locked
    return (
        "locked memory",
        is_memory_locked,
        "allow it: ulimit -l unlimited, or a line 'USER - memlock unlimited' in limits.conf",
    )


def _check_wakeups() -> DoctorFinding:
    """Measure how late the system wakes a process, and check whether a hypervisor has taken processor time away."""
    ticks = _cpu_and_steal_ticks()
    clock = RealClock(WAKEUP_PERIOD_NS)
    with realtime_priority(clock.processors):
        clock.start()
        latest_ns = max(clock.wait(k) for k in range(int(WAKEUP_TEST_S * 1e9) // WAKEUP_PERIOD_NS))
    max_lateness_s = latest_ns / 1e9
    total, stolen = (
        ticks_after - ticks_before
        for ticks_before, ticks_after in zip(ticks, _cpu_and_steal_ticks(), strict=True)
    )
    steal_text = (
        f", a hypervisor took {100 * stolen / total:.1f} % of the processor" if stolen else ""
    )
    return (
        f"wake-ups at most {1e3 * max_lateness_s:.1f} ms late in {WAKEUP_TEST_S:g} s{steal_text}",
        max_lateness_s < MAX_WAKEUP_LATENESS_S,
        "end other programs, or use a computer that is no virtual machine; slow a simulated hand: "
        "handctl sim --time-scale 0.3",
    )


def _cpu_and_steal_ticks() -> tuple[int, int]:
    """Return two processor times since the start of the system, each summed over all cores.

    The first value is the total processor time. The second value is the processor time that a
    hypervisor gave to other virtual machines. The unit of both times is the clock tick of the
    kernel. In ``/proc/stat``, the time that a hypervisor gave away is called ``steal`` (Linux
    ``proc_stat(5)``). On systems other than Linux, both times are 0.
    """
    try:
        first_line = Path("/proc/stat").read_text().splitlines()[0]
    except OSError:
        return 0, 0
    ticks = [int(word) for word in first_line.split()[1:9]]
    return sum(ticks), ticks[7]


def _check_socketcan() -> DoctorFinding:
    remedy = "the kernel has no CAN: use local:NAME, or load it with 'modprobe can can_raw vcan'"
    if not hasattr(socket, "AF_CAN"):
        return "SocketCAN", False, "only Linux has it: use local:NAME or a python-can interface"
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return "SocketCAN", False, remedy
    return "SocketCAN", True, ""


def _check_interfaces() -> DoctorFinding:
    network_folder = Path("/sys/class/net")
    names = [
        path.name
        for path in network_folder.glob("*")
        if (path / "type").exists() and (path / "type").read_text().strip() == "280"
    ]
    remedy = "plug one in, or: ip link add vcan0 type vcan && ip link set vcan0 up"
    return f"CAN interfaces: {', '.join(sorted(names)) or 'none'}", bool(names), remedy


def _check_vulkan() -> DoctorFinding:
    has_driver = (
        bool(list(Path("/usr/share/vulkan/icd.d").glob("*.json"))) or sys.platform != "linux"
    )
    return (
        "Vulkan driver for pictures of the viewer",
        has_driver,
        "install libvulkan1 and mesa-vulkan-drivers",
    )


def _check_disk_space() -> DoctorFinding:
    try:
        folder = run_dir()
    except BusError as error:
        return "sockets out of other users' reach", False, str(error)
    free_bytes = shutil.disk_usage(Path.cwd()).free
    return (
        f"{free_bytes / 1e9:.1f} GB free for logs, sockets in {folder}",
        free_bytes > 1e9,
        "make room: a run takes about 1 MB a second",
    )
