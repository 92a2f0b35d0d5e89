"""Run a command where the SocketCAN interfaces vcan0 and vcan1 exist: ``python tests/vcan/uml_guest.py -- COMMAND...``.

If the kernel has vcan, the command runs in a network namespace. If the kernel has no vcan, the
command runs in a guest of user-mode Linux (Debian package user-mode-linux), which needs no special
rights. All files of the guest are on the disk of the host, except those in /dev/shm.
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

TIMED_OUT_STATUS, NO_EXIT_STATUS, NO_VCAN_STATUS = 124, 125, 126
"""Exit statuses of a command that took too long, of one that ended without a status, and of one without vcan."""
PACKAGE_BY_PROGRAM = {"linux.uml": "user-mode-linux", "ip": "iproute2", "insmod": "kmod"}
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
KERNEL_MODULES = Path("/usr/lib/uml/modules")
MEMORY_BYTES = 2 << 30
_guest_numbers = itertools.count()
MAKE_INTERFACES_SCRIPT = """\
set -e
for name in vcan0 vcan1; do
    ip link add dev $name type vcan
    ip link set $name mtu 72 # CAN FD; only possible while the interface is down
    ip link set $name up
done
ip link set lo up
"""


def vcan_access() -> tuple[str, str]:
    """Return the way in which the present machine provides vcan, "native" or "uml", and an empty reason.

    If the machine does not provide vcan, the way is an empty text, and the reason explains why vcan
    is missing.
    """
    if shutil.which("unshare") is not None:
        trial = subprocess.run(
            [*_namespace_command(), "bash", "-c", MAKE_INTERFACES_SCRIPT],
            capture_output=True,
            check=False,
            env=_environment(),
        )
        if trial.returncode == 0:
            return "native", ""
    for program, package in PACKAGE_BY_PROGRAM.items():
        if shutil.which(program, path=_environment()["PATH"]) is None:
            return (
                "",
                f"the kernel has no vcan, and {program} (Debian package {package}) is not installed",
            )
    if not _modules_folder().is_dir():
        return "", f"linux.uml is there, but not its modules in {_modules_folder()}"
    return "uml", ""


def run_with_vcan(
    command: Sequence[str],
    extra_env: Mapping[str, str] | None = None,
    timeout_s: float = 300.0,
    print_line: Callable[[str], None] = print,
) -> int:
    """Run a command with the interfaces vcan0 and vcan1.

    The command runs in the present folder, and with the environment variables of the calling
    process.

    Args:
        command: program and its arguments.
        extra_env: environment variables in addition to those of the calling process.
        timeout_s: time after which the whole guest system is killed [s].
        print_line: function that is called with each line of the command's output.

    Returns: The exit status of the command. If the command has no exit status, the returned status
    is TIMED_OUT_STATUS, NO_EXIT_STATUS or NO_VCAN_STATUS.
    """
    kind, reason = vcan_access()
    if not kind:
        print_line(f"no vcan: {reason}")
        return NO_VCAN_STATUS
    job_folder = Path(tempfile.mkdtemp(prefix="handctl-vcan-"))
    try:
        environment = {**_environment(), "PYTHONDONTWRITEBYTECODE": "1", **(extra_env or {})}
        if kind == "native":
            (job_folder / "run").write_text(_job_script(command, environment))
            return _run_natively(job_folder, timeout_s, print_line)
        environment |= {"TMPDIR": "/dev/shm", "HANDCTL_RUN_DIR": "/dev/shm/handctl"}
        (job_folder / "run").write_text(_job_script(command, environment))
        return _run_in_guest(job_folder, timeout_s, print_line)
    finally:
        shutil.rmtree(job_folder)


def _job_script(command: Sequence[str], environment: Mapping[str, str]) -> str:
    names = (
        name for name in environment if name.isidentifier() and name not in {"PWD", "SHLVL", "_"}
    )
    export_lines = "".join(f"export {name}={shlex.quote(environment[name])}\n" for name in names)
    return f"{MAKE_INTERFACES_SCRIPT}{export_lines}cd {shlex.quote(os.getcwd())}\nexec {shlex.join(command)}\n"


def _environment() -> dict[str, str]:
    """Return the environment variables of the present process.

    The variable PATH contains the folders of system programs, even for an ordinary user.
    """
    return {**os.environ, "PATH": f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}"}


def _namespace_command() -> list[str]:
    return ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]


@functools.cache
def _modules_folder() -> Path:
    version = subprocess.run(
        ["linux.uml", "--version"], capture_output=True, text=True, check=True, env=_environment()
    )
    return KERNEL_MODULES / version.stdout.strip()


def _run_natively(job_folder: Path, timeout_s: float, print_line: Callable[[str], None]) -> int:
    process = _start_process(
        [*_namespace_command(), "bash", str(job_folder / "run")], _environment()
    )
    try:
        for line in _read_lines(process, time.monotonic() + timeout_s):
            print_line(line)
        status = process.wait(timeout=10)
        # a shell reports the end by a signal in the same way
        return status if status >= 0 else 128 - status
    except TimeoutError:
        return TIMED_OUT_STATUS
    finally:
        _kill_process_group(process)


def _run_in_guest(job_folder: Path, timeout_s: float, print_line: Callable[[str], None]) -> int:
    with _pin_to_one_core():
        process = _start_process(
            _guest_command(job_folder), {**_environment(), "TMPDIR": _memory_folder()}
        )
    try:
        system_lines = _print_command_output(
            _read_lines(process, time.monotonic() + timeout_s), job_folder, print_line
        )
    except TimeoutError:
        return TIMED_OUT_STATUS
    finally:
        _kill_process_group(process)
    try:
        return int((job_folder / "rc").read_text())
    except FileNotFoundError:
        for line in system_lines:
            print_line(f"guest: {line}")
        return NO_EXIT_STATUS


@contextlib.contextmanager
def _pin_to_one_core() -> Iterator[None]:
    """Keep the child processes of the present thread on one core.

    Each new guest system gets the next core in turn. On the host, a guest consists of two processes
    that run alternately: the Linux kernel of the guest, and a program in the guest. Waking a
    process takes five times as long if the process is on a different core. With both processes on
    one core, a system call of the guest takes 20 us instead of 100 us.
    """
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[next(_guest_numbers) % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _guest_command(job_folder: Path) -> list[str]:
    init_program = Path(__file__).with_name("init").resolve()
    return [
        *_command_prefix_for_amx(job_folder),
        *(
            "linux.uml",
            f"mem={MEMORY_BYTES >> 20}M",
            "root=/dev/root",
            "rootfstype=hostfs",
            "rootflags=/",
            "rw",
        ),
        *(
            f"init={init_program}",
            "con=null",
            "con0=null,fd:1",
            "con1=null",
            "ssl=null",
            "quiet",
            "loglevel=3",
        ),
        *(f"uml_dir={job_folder}/", f"job={job_folder}", f"moddir={_modules_folder()}"),
    ]


def _command_prefix_for_amx(job_folder: Path) -> list[str]:
    """Return the command prefix that the guest system needs on a processor with AMX registers.

    User-mode Linux alone does not save the AMX registers of a processor. The command
    prefix sets LD_PRELOAD to a library with which user-mode Linux can run on a processor with AMX.
    On a processor without AMX, the returned list is empty.
    """
    if "amx_tile" not in Path("/proc/cpuinfo").read_text(
        encoding="utf-8"
    ).split() or not shutil.which("gcc"):
        return []
    library = job_folder / "xstate.so"
    source = Path(__file__).with_name("xstate.c").resolve()
    subprocess.run(["gcc", "-shared", "-fPIC", "-O2", "-o", str(library), str(source)], check=True)
    return ["env", f"LD_PRELOAD={library}"]


def _memory_folder() -> str:
    """Return the folder for the file that contains the memory of the guest system.

    The folder /dev/shm of a container often has only 64 MB, which is too small for the guest
    system.
    """
    memory_folder = Path("/dev/shm")
    is_large_enough = (
        memory_folder.is_dir() and shutil.disk_usage(memory_folder).free > MEMORY_BYTES
    )
    return (
        str(memory_folder)
        if is_large_enough and not os.statvfs(memory_folder).f_flag & os.ST_NOEXEC
        else tempfile.gettempdir()
    )


def _start_process(command: list[str], environment: dict[str, str]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def _kill_process_group(process: "subprocess.Popen[bytes]") -> None:
    """Kill every process of a guest system.

    User-mode Linux has one process on the host for each address space of the guest.
    """
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _read_lines(process: "subprocess.Popen[bytes]", deadline_s: float) -> Iterator[str]:
    assert process.stdout is not None
    pipe, incomplete_line = process.stdout.fileno(), b""
    while True:
        if not select.select([pipe], [], [], max(0.0, deadline_s - time.monotonic()))[0]:
            raise TimeoutError
        chunk = os.read(pipe, 1 << 16)
        *complete_lines, incomplete_line = (incomplete_line + chunk).split(b"\n")
        for line in [
            *complete_lines,
            *([incomplete_line] if incomplete_line and not chunk else []),
        ]:
            yield line.rstrip(b"\r").decode(errors="replace")
        if not chunk:
            return


def _print_command_output(
    lines: Iterator[str], job_folder: Path, print_line: Callable[[str], None]
) -> list[str]:
    """Report the lines that the command in a guest system prints.

    Returns: The other lines of the guest's output, before and after the lines of the command. The
    other lines come from the Linux kernel and from init.
    """
    system_lines: list[str] = []
    has_command_started = False
    for line in lines:
        if line.endswith(f"end {job_folder}"):
            if unfinished := line.removesuffix(f"end {job_folder}"):
                print_line(unfinished)
            return system_lines
        if has_command_started:
            print_line(line)
        elif line == f"begin {job_folder}":
            has_command_started = True
        else:
            system_lines.append(line)
    return system_lines


def main() -> int:
    parser = argparse.ArgumentParser(
        description="run a command beside the SocketCAN interfaces vcan0 and vcan1"
    )
    parser.add_argument(
        "--timeout", type=float, default=300.0, metavar="S", help="kill it after this time [s]"
    )
    parser.add_argument("command", nargs="+")
    arguments = parser.parse_args()
    return run_with_vcan(
        arguments.command,
        timeout_s=arguments.timeout,
        print_line=lambda line: print(line, flush=True),
    )


if __name__ == "__main__":
    sys.exit(main())
