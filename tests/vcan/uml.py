"""Runs a command beside real SocketCAN interfaces vcan0 and vcan1: ``python tests/vcan/uml.py -- COMMAND...``.

Where the kernel has vcan, in a network namespace of its own; elsewhere in a guest of user-mode Linux (Debian's
package user-mode-linux), which needs no rights. In the guest /dev/shm is the only place that is not the host's disk.
"""

import argparse
import contextlib
import functools
import itertools
import os
import select
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

TIMED_OUT, NO_STATUS, NO_VCAN = 124, 125, 126
"""Status of a run that took too long, that ended without a status of its own, that could not start."""
PACKAGES = {"linux.uml": "user-mode-linux", "ip": "iproute2", "insmod": "kmod"}
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
MODULES = Path("/usr/lib/uml/modules")
MEMORY_BYTES = 2 << 30
_guests = itertools.count()
INTERFACES = """\
set -e
for name in vcan0 vcan1; do
    ip link add dev $name type vcan
    ip link set $name mtu 72 # CAN FD; only possible while the interface is down
    ip link set $name up
done
ip link set lo up
"""


def means() -> tuple[str, str]:
    """How a command can meet vcan here: ("native" | "uml" | "", why not if "")."""
    if shutil.which("unshare") is not None:
        trial = subprocess.run([*_namespace(), "bash", "-c", INTERFACES], capture_output=True, check=False, env=_env())
        if trial.returncode == 0:
            return "native", ""
    for program, package in PACKAGES.items():
        if shutil.which(program, path=_env()["PATH"]) is None:
            return "", f"the kernel has no vcan, and {program} (Debian package {package}) is not installed"
    if not _modules().is_dir():
        return "", f"linux.uml is there, but not its modules in {_modules()}"
    return "uml", ""


def run(
    command: Sequence[str],
    extra_env: Mapping[str, str] | None = None,
    timeout_s: float = 300.0,
    say: Callable[[str], None] = print,
) -> int:
    """Runs the command beside vcan0 and vcan1 in this folder and environment.

    Args:
        command: program and arguments.
        extra_env: variables on top of this process's.
        timeout_s: after this the whole guest is killed [s].
        say: is called with each line of the command's output.

    Returns:
        The command's exit status; TIMED_OUT, NO_STATUS or NO_VCAN if it has none.
    """
    kind, why_not = means()
    if not kind:
        say(f"no vcan: {why_not}")
        return NO_VCAN
    job = Path(tempfile.mkdtemp(prefix="handctl-vcan-"))
    try:
        environment = {**_env(), "PYTHONDONTWRITEBYTECODE": "1", **(extra_env or {})}
        if kind == "native":
            (job / "run").write_text(_job(command, environment))
            return _native(job, timeout_s, say)
        environment |= {"TMPDIR": "/dev/shm", "HANDCTL_RUN_DIR": "/dev/shm/handctl"}
        (job / "run").write_text(_job(command, environment))
        return _guest(job, timeout_s, say)
    finally:
        shutil.rmtree(job)


def _job(command: Sequence[str], environment: Mapping[str, str]) -> str:
    names = (name for name in environment if name.isidentifier() and name not in {"PWD", "SHLVL", "_"})
    exports = "".join(f"export {name}={shlex.quote(environment[name])}\n" for name in names)
    return f"{INTERFACES}{exports}cd {shlex.quote(os.getcwd())}\nexec {shlex.join(command)}\n"


def _env() -> dict[str, str]:
    """This process's environment, with the system's programs in reach also for a user without rights."""
    return {**os.environ, "PATH": f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}"}


def _namespace() -> list[str]:
    return ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]


@functools.cache
def _modules() -> Path:
    told = subprocess.run(["linux.uml", "--version"], capture_output=True, text=True, check=True, env=_env())
    return MODULES / told.stdout.strip()


def _native(job: Path, timeout_s: float, say: Callable[[str], None]) -> int:
    process = _start([*_namespace(), "bash", str(job / "run")], _env())
    try:
        for line in _lines(process, time.monotonic() + timeout_s):
            say(line)
        status = process.wait(timeout=10)
        return status if status >= 0 else 128 - status  # as a shell tells of a signal
    except TimeoutError:
        return TIMED_OUT
    finally:
        _kill_group(process)


def _guest(job: Path, timeout_s: float, say: Callable[[str], None]) -> int:
    with _on_one_core():
        process = _start(_guest_command(job), {**_env(), "TMPDIR": _room_for_memory()})
    try:
        unsaid = _say_job(_lines(process, time.monotonic() + timeout_s), job, say)
    except TimeoutError:
        return TIMED_OUT
    finally:
        _kill_group(process)
    try:
        return int((job / "rc").read_text())
    except FileNotFoundError:
        for line in unsaid:
            say(f"guest: {line}")
        return NO_STATUS


@contextlib.contextmanager
def _on_one_core() -> Iterator[None]:
    """What this thread starts stays on one core; another guest begins on the next.

    In a guest its kernel and a program of it run in turn, as processes of the host. To wake one on another core costs
    five times what it takes on the same: with both on one, a system call took 20 us instead of 100.
    """
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[next(_guests) % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _guest_command(job: Path) -> list[str]:
    init = Path(__file__).with_name("init").resolve()
    return [
        *_with_all_registers(job),
        *("linux.uml", f"mem={MEMORY_BYTES >> 20}M", "root=/dev/root", "rootfstype=hostfs", "rootflags=/", "rw"),
        *(f"init={init}", "con=null", "con0=null,fd:1", "con1=null", "ssl=null", "quiet", "loglevel=3"),
        *(f"uml_dir={job}/", f"job={job}", f"moddir={_modules()}"),
    ]


def _with_all_registers(job: Path) -> list[str]:
    """Return what goes before the guest's command on a processor with AMX, whose registers it does not save alone."""
    if "amx_tile" not in Path("/proc/cpuinfo").read_text(encoding="utf-8").split() or not shutil.which("gcc"):
        return []
    library = job / "xstate.so"
    source = Path(__file__).with_name("xstate.c").resolve()
    subprocess.run(["gcc", "-shared", "-fPIC", "-O2", "-o", str(library), str(source)], check=True)
    return ["env", f"LD_PRELOAD={library}"]


def _room_for_memory() -> str:
    """The folder for the file that is the guest's memory; containers often have a /dev/shm of 64 MB."""
    shared = Path("/dev/shm")
    roomy = shared.is_dir() and shutil.disk_usage(shared).free > MEMORY_BYTES
    return str(shared) if roomy and not os.statvfs(shared).f_flag & os.ST_NOEXEC else tempfile.gettempdir()


def _start(command: list[str], environment: dict[str, str]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def _kill_group(process: "subprocess.Popen[bytes]") -> None:
    """Ends every process of the run: user-mode Linux has one on the host for each address space of the guest."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _lines(process: "subprocess.Popen[bytes]", deadline_s: float) -> Iterator[str]:
    assert process.stdout is not None
    pipe, rest = process.stdout.fileno(), b""
    while True:
        if not select.select([pipe], [], [], max(0.0, deadline_s - time.monotonic()))[0]:
            raise TimeoutError
        chunk = os.read(pipe, 1 << 16)
        *whole, rest = (rest + chunk).split(b"\n")
        for line in [*whole, *([rest] if rest and not chunk else [])]:
            yield line.rstrip(b"\r").decode(errors="replace")
        if not chunk:
            return


def _say_job(lines: Iterator[str], job: Path, say: Callable[[str], None]) -> list[str]:
    """Passes on what the job printed; returns what came before and after, from the kernel and from init."""
    unsaid: list[str] = []
    begun = False
    for line in lines:
        if line.endswith(f"end {job}"):
            if unfinished := line.removesuffix(f"end {job}"):
                say(unfinished)
            return unsaid
        if begun:
            say(line)
        elif line == f"begin {job}":
            begun = True
        else:
            unsaid.append(line)
    return unsaid


def main() -> int:
    parser = argparse.ArgumentParser(description="run a command beside the SocketCAN interfaces vcan0 and vcan1")
    parser.add_argument("--timeout", type=float, default=300.0, metavar="S", help="kill it after this time [s]")
    parser.add_argument("command", nargs="+")
    arguments = parser.parse_args()
    return run(arguments.command, timeout_s=arguments.timeout, say=lambda line: print(line, flush=True))


if __name__ == "__main__":
    sys.exit(main())
