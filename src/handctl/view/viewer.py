"""Viewer of the installed rerun-sdk package, run as a separate process.

The viewer accepts connections only from this machine.
"""

import ctypes
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from handctl.errors import ConfigError, HandctlError
from handctl.runtime.socket_paths import run_dir

LOOPBACK_ADDRESS = "127.0.0.1"
"""Address on which the viewer listens. Only programs on this machine can connect to the viewer."""
VULKAN_DRIVER_FOLDERS = (
    "/usr/share/vulkan/icd.d",
    "/etc/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
)
"""Folders in which Vulkan drivers install their description files."""
SOFTWARE_DRIVER_FILES = "lvp_icd*.json"
"""Pattern for the description file of Mesa's lavapipe, a Vulkan driver that draws on the processor.

Pictures drawn with lavapipe do not depend on a graphics card.
"""
VULKAN_PACKAGES = "libvulkan1 mesa-vulkan-drivers"
VIEWER_START_TIMEOUT_S = 30.0
"""Longest wait for the start of a viewer [s]."""
VIEWER_END_TIMEOUT_S = 5.0
"""Longest wait for the end of a viewer [s]."""
_ADDRESS_LINE_PATTERN = re.compile(rb"rerun\+http://[0-9.]+:\d+/proxy")
"""Pattern for the viewer's address in the output of the viewer."""


def viewer_path() -> Path:
    """Return the path of the viewer program in the package rerun-sdk.

    Raises:
        ConfigError: the package has no viewer.
    """
    import rerun_cli  # type: ignore[import-untyped]

    folder = Path(rerun_cli.__file__).parent
    for name in ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun"):
        if (folder / name).is_file():
            return folder / name
    raise ConfigError(
        "no viewer in the installed rerun-sdk", str(folder), "a complete rerun-sdk package"
    )


def software_vulkan() -> dict[str, str]:
    """Return the environment variables with which a viewer can draw without a screen.

    Returns:
        the variables by name. The mapping is empty if no variable is necessary.

    Raises:
        ConfigError: no Vulkan driver is installed.
    """
    if not sys.platform.startswith("linux"):
        return {}
    driver_files = _driver_files(SOFTWARE_DRIVER_FILES) or _driver_files("*.json")
    has_chosen_driver = any(
        os.environ.get(name) for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES")
    )
    if not _has_vulkan_loader() or not (driver_files or has_chosen_driver):
        raise ConfigError(
            "no Vulkan driver to draw with", "", f"the Debian packages {VULKAN_PACKAGES}"
        )
    return {} if has_chosen_driver else {"VK_ICD_FILENAMES": str(driver_files[0])}


def _driver_files(file_pattern: str) -> list[Path]:
    """Return the files in the Vulkan driver folders whose file names match a pattern."""
    return [
        path for folder in VULKAN_DRIVER_FOLDERS for path in sorted(Path(folder).glob(file_pattern))
    ]


def _has_vulkan_loader() -> bool:
    """Return True if the Vulkan loader is installed."""
    try:
        ctypes.CDLL("libvulkan.so.1")
    except OSError:
        return False
    return True


def check_screen_exists() -> None:
    """Raise an error if the desktop session has no screen on which a window could open.

    Raises:
        ConfigError: the desktop session has no screen.
    """
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise ConfigError(
            "no screen in this session", "DISPLAY", "a desktop; or use --picture or --save"
        )


@dataclass(frozen=True, slots=True)
class Viewer:
    """Running viewer process.

    Attributes:
        process: process of the viewer.
        url: address of the viewer.
    """

    process: "subprocess.Popen[bytes]"
    url: str

    def close_viewer(self) -> None:
        """Close the viewer, and wait until the process has ended."""
        self.process.terminate()
        try:
            self.process.wait(VIEWER_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@dataclass(frozen=True, slots=True)
class ViewerProcess:
    """Viewer process that is still starting.

    Attributes:
        process: process of the viewer.
        output_pipe: file with the text output of the viewer.
    """

    process: "subprocess.Popen[bytes]"
    output_pipe: IO[bytes]

    def wait_until_ready(self) -> Viewer:
        """Wait until the viewer listens, and return the viewer.

        If the viewer does not listen in time, kill the viewer.

        Raises:
            HandctlError: the viewer does not start.
        """
        url = ""
        try:
            url = _wait_for_url(self.process, self.output_pipe)
        finally:
            self.output_pipe.close()
            if not url:
                self.process.kill()
                self.process.wait()
        return Viewer(self.process, url)


def launch_viewer(viewer_arguments: Sequence[str], environment: dict[str, str]) -> ViewerProcess:
    """Start a viewer on a free port of this machine.

    The viewer sends no usage data to the makers of Rerun.

    The function does not wait until the viewer listens.

    The operating system chooses the port of the viewer. On Rerun's default port 9876, the viewer
    would also receive streams from other programs. A program that still streams to a closed viewer
    would then stream to the new viewer.

    Args:
        viewer_arguments: further arguments of the viewer's command.
        environment: environment variables in addition to the variables of this process.
    """
    viewer_program = str(viewer_path())
    settings = run_dir() / "viewer"
    settings.mkdir(mode=0o700, parents=True, exist_ok=True)
    # Only a file in the configuration folder of the viewer can disable the collection of usage
    # data.
    viewer_environment = (
        os.environ
        | {"XDG_CONFIG_HOME": str(settings), "NO_COLOR": "1", "RUST_LOG": "info"}
        | environment
    )
    subprocess.run(
        [viewer_program, "analytics", "disable"],
        env=viewer_environment,
        check=False,
        capture_output=True,
    )
    notes = tempfile.TemporaryFile()  # noqa: SIM115 (`ViewerProcess.wait_until_ready` closes it)
    command = [viewer_program, "--bind", LOOPBACK_ADDRESS, "--port", "0", *viewer_arguments]
    # The viewer runs in a process session of its own, so that Ctrl-C in the terminal does not
    # interrupt the viewer.
    process = subprocess.Popen(
        command,
        env=viewer_environment,
        stdin=subprocess.DEVNULL,
        stdout=notes,
        stderr=notes,
        start_new_session=True,
    )
    return ViewerProcess(process, notes)


def start_viewer(viewer_arguments: Sequence[str], environment: dict[str, str]) -> Viewer:
    """Start a viewer with `launch_viewer`, and wait until the viewer listens.

    Raises:
        HandctlError: the viewer does not start.
    """
    return launch_viewer(viewer_arguments, environment).wait_until_ready()


@contextmanager
def launched_viewer(
    viewer_arguments: Sequence[str], environment: dict[str, str]
) -> Iterator[ViewerProcess]:
    """Start a viewer with `launch_viewer`, for the duration of a context.

    At the end of the context, the viewer is closed, and the temporary files of the viewer are
    deleted.
    """
    with tempfile.TemporaryDirectory(
        prefix="handctl-viewer-", ignore_cleanup_errors=True
    ) as scratch:
        starting_viewer = launch_viewer(viewer_arguments, {"TMPDIR": scratch} | environment)
        try:
            yield starting_viewer
        finally:
            Viewer(starting_viewer.process, "").close_viewer()


@contextmanager
def running_viewer(
    viewer_arguments: Sequence[str], environment: dict[str, str]
) -> Iterator[Viewer]:
    """Start a viewer with `start_viewer`, for the duration of a context."""
    with launched_viewer(viewer_arguments, environment) as starting_viewer:
        yield starting_viewer.wait_until_ready()


def _wait_for_url(process: "subprocess.Popen[bytes]", stderr_pipe: IO[bytes]) -> str:
    """Wait until the output of the viewer shows the address of the viewer, and return the address.

    Raises:
        HandctlError: the viewer ended or has not opened its port within `VIEWER_START_TIMEOUT_S`.
    """
    remaining = VIEWER_START_TIMEOUT_S
    while remaining > 0:
        try:
            # The following call returns early if the viewer ends. If the viewer continues, the call
            # is the pause between two checks of the viewer's output.
            process.wait(0.05)
        except subprocess.TimeoutExpired:
            remaining -= 0.05
        stderr_pipe.seek(0)
        text = stderr_pipe.read()
        address_match = _ADDRESS_LINE_PATTERN.search(text)
        if address_match:
            return address_match.group().decode()
        if process.returncode is not None:
            last_line = text.decode(errors="replace").strip().splitlines()[-1:] or ["no output"]
            raise HandctlError(
                f"the viewer ended with code {process.returncode}: {last_line[0]}", "rerun", ""
            )
    raise HandctlError(
        f"the viewer has not opened its port within {VIEWER_START_TIMEOUT_S:g} s", "rerun", ""
    )
