"""Make pictures that show how gains are tuned, and a picture of a report.

Commands of handctl draw the pictures. Pages of the documentation site show the same commands.
"""

import contextlib
import io
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from handctl.cli.main import main
from tools.figures import runs

DETUNED_GAINS = """schema = 1
[motion]
position_error_m = 1.8e-3
speed_error_m_s = 9.3e-3
[tension]
tension_error_N = 1.33
speed_error_m_s = 0.09
integral_per_s = 9.0
[filter]
motor_disturbance_N = 0.36
"""
UNSTABLE_GAINS = "schema = 1\n[motion]\nforce_N = 450.0\n[tension]\nforce_N = 300.0\n"
"""Gains with which the control loops oscillate."""
PERTURBATION_FACTORS = (
    "stiffness=0.8",
    "spring=1.2",
    "friction=1.25",
    "motor_inertia=0.8",
    "torque_constant=1.1",
)
OTHER_HAND = ("stiffness=0.7", "friction=1.3", "motor_inertia=0.7")
"""Factors that change the parameters of the simulated hands on the page *Tune a hand*."""
BROWSER_COMMANDS = ("chromium", "chromium-browser", "google-chrome")
PAGE_SIZE = (1100, 2080)
"""Width and height of the picture of a report page [pixels]."""


HAND_VIEW = (2, 66, 638, 500)
"""Left, upper, right and lower edge of the view of the hand within the picture of the viewer [pixels]."""


def call_handctl(folder: Path, *words: str, codes: tuple[int, ...] = (0,)) -> None:
    """Execute a command of handctl in a folder.

    Raises:
        RuntimeError: the exit code of the command is not in ``codes``.
    """
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        code = main([*words])
    if code not in codes:
        raise RuntimeError(f"handctl {' '.join(words)} returned {code}")


@contextlib.contextmanager
def empty_folder(folder: Path, name: str) -> Iterator[Path]:
    """Yield a folder for a run.

    The folder contains only two gains files, and no files of earlier runs.
    """
    path = folder / name
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir(parents=True)
    (path / "detuned.toml").write_text(DETUNED_GAINS, encoding="utf-8")
    (path / "wild.toml").write_text(UNSTABLE_GAINS, encoding="utf-8")
    yield path


def identify_picture(folder: Path) -> Path:
    """Identify a simulated index finger whose parameters differ from the hand file.

    Return the path of the picture that shows the identified parameters.
    """
    with empty_folder(folder, "identify") as path:
        call_handctl(path, "identify", "--hand", "jamia", "--lockstep", "--seed", "7", "--digits", "index", "--perturb",
             *PERTURBATION_FACTORS, "--log", "identify.mcap")  # fmt: skip
        return next(path.glob("*.png"))


def design_picture(folder: Path) -> Path:
    """Design gains that have stability margins. The initial gains of the design have no stability margins.

    Return the path of the picture of the design.
    """
    with empty_folder(folder, "design") as path:
        call_handctl(
            path,
            "tune",
            "design",
            "--hand",
            "jamia",
            "--gains",
            "detuned.toml",
            "--output",
            "design.toml",
        )
        return path / "design.png"


def return_picture(folder: Path) -> Path:
    """Verify gains that make the control loops oscillate, and return the path of the picture of the run.

    In the run, the controller returns to the old gains.
    """
    with empty_folder(folder, "return") as path:
        call_handctl(
            path,
            "tune",
            "verify",
            "wild.toml",
            "--hand",
            "jamia",
            "--lockstep",
            "--log",
            "return.mcap",
            codes=(1,),
        )
        return path / "return.png"


def search_picture(folder: Path) -> Path:
    """Search for gains in 24 trials, and return the path of the picture of the search."""
    with empty_folder(folder, "search") as path:
        call_handctl(path, "tune", "search", "--hand", "jamia", "--gains", "detuned.toml", "--plants", "2",
            "--trials", "24",
             "--jobs", "1", "--study", "jamia.study", "--output", "search.toml")  # fmt: skip
        return path / "search.png"


def verify_picture(folder: Path) -> Path:
    """Verify the result of the search for gains on a simulated hand with other parameters.

    If the search has no result yet, run the search before the verification.
    """
    gains_file = folder / "search" / "search.toml"
    if not gains_file.exists():
        search_picture(folder)
    with empty_folder(folder, "verify") as path:
        call_handctl(path, "tune", "verify", str(gains_file), "--hand", "jamia", "--gains",
             "detuned.toml", "--lockstep", "--perturb", *OTHER_HAND, "--log", "verify.mcap", codes=(0, 1))  # fmt: skip
        return path / "verify.png"


def pair_picture(folder: Path) -> Path:
    """Return the path of the picture that `handctl demo` draws for a hand with two tendons per motor."""
    with empty_folder(folder, "orca_like") as path:
        call_handctl(
            path,
            "demo",
            "--lockstep",
            "--hand",
            "orca_like",
            "--seed",
            "0",
            "--log",
            "orca_like.mcap",
        )
        return path / "orca_like.png"


def mesh_picture(folder: Path) -> Path:
    """Draw how the viewer shows a hand that has meshes and holds an object.

    The viewer needs a Vulkan driver.
    """
    from PIL import Image

    with empty_folder(folder, "meshes") as path:
        call_handctl(
            path, "demo", "--lockstep", "--hand", "t42", "--seed", "0", "--log", "t42.mcap"
        )
        call_handctl(path, "view", "t42.mcap", "--picture", "meshes.png")
        picture = path / "meshes.png"
        with Image.open(picture) as dashboard:
            hand_picture = dashboard.crop(HAND_VIEW)
        hand_picture.save(picture)
        return picture


def find_browser() -> str | None:
    """Return the path of the browser Chromium, or None if it is not installed."""
    return next(filter(None, map(shutil.which, BROWSER_COMMANDS)), None)


def report_picture(folder: Path) -> Path:
    """Take a picture of the upper part of a report on `handctl demo` in a browser.

    Raises:
        RuntimeError: the present machine has no browser Chromium.
    """
    runs.grasp_run(folder)
    page, picture = folder / "grasp.html", folder / "report.png"
    call_handctl(folder, "report", "grasp.mcap", "--output", page.name)
    browser = find_browser()
    if browser is None:
        raise RuntimeError(f"the picture of the report needs one of {', '.join(BROWSER_COMMANDS)}")
    words = (browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
    size = "{},{}".format(*PAGE_SIZE)
    subprocess.run([*words, f"--window-size={size}", f"--screenshot={picture}", page.as_uri()], check=True,
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
    return picture
