"""Loading of tasks, trajectories and scenes.

Tasks, trajectories and scenes either belong to the package handctl, or are files of the user.

Each task is checked against the hand.
"""

from contextlib import suppress
from pathlib import Path

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.programs.default_task import CYLINDER_SCENE, default_scene, default_task
from handctl.programs.task import Task, load_task, load_trajectory
from handctl.programs.task_checks import check_task_for_hand

PACKAGED_TASKS_FOLDER = Path(__file__).parents[1] / "tasks"


PACKAGED_GRASP_FILE = Path("grasp.toml")
"""Name of the packaged grasp.

A hand can execute the packaged grasp if it has all digits that the grasp moves.
"""


def load_task_for_hand(name: Path | None, hand: Hand) -> tuple[Task, bytes]:
    """Load a task by its path or its packaged name, and check that the hand can execute the task.

    If no name is given, the packaged grasp is loaded. For a hand without the digits of the packaged
    grasp, a default task is generated.

    Raises:
        ConfigError: the task does not exist, or its content is wrong.
    """
    if name is None:
        with suppress(ConfigError):
            return load_task_for_hand(PACKAGED_GRASP_FILE, hand)
        task, text = default_task(hand)
        check_task_for_hand(task, hand, "default task")
        return task, text.encode()
    path = task_path(name)
    task = load_task(path)
    check_task_for_hand(task, hand, str(name))
    return task, path.read_bytes()


def scene_for_hand(name: str | None, hand: Hand) -> str:
    """Return the scene of a simulated hand.

    If no name is given, the result is the scene of the packaged task `grasp`, or the scene of the
    default task.
    """
    if name is not None:
        return name
    with suppress(ConfigError):
        load_task_for_hand(PACKAGED_GRASP_FILE, hand)
        return CYLINDER_SCENE
    return default_scene(hand)


def task_path(name: Path) -> Path:
    """Return the path of a task file, given by path or packaged name.

    Only a name without a folder, such as ``grasp`` or ``grasp.toml``, can mean a packaged task. A
    path with a folder never means a packaged task, even if the file of the path is missing.

    Raises:
        ConfigError: the task does not exist.
    """
    if name.exists():
        return name
    packaged_paths = {path.stem: path for path in sorted(PACKAGED_TASKS_FOLDER.glob("*.toml"))}
    is_packaged_name = name.name == str(name) and name.suffix in ("", ".toml")
    if not is_packaged_name or name.stem not in packaged_paths:
        names = ", ".join(path.name for path in packaged_paths.values())
        raise ConfigError("no such task", str(name), f"a task file, or one of {names}")
    return packaged_paths[name.stem]


def load_trajectory_for_hand(path: Path, hand: Hand) -> Task:
    """Load a trajectory file as a task, and check that the hand can execute the task.

    Raises:
        ConfigError: the file does not exist, or its content is wrong.
    """
    task = load_trajectory(path)
    check_task_for_hand(task, hand, str(path))
    return task
