"""Tasks and trajectories: those that come with handctl and those of files, checked against the hand."""

from pathlib import Path

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.programs.task import Task, check_task, load_task, load_trajectory, shapes
from handctl.programs.task_checks import check_joint_range, check_speed, check_tip_force

TASKS = Path(__file__).parents[1] / "tasks"


def find_task(name: Path, hand: Hand) -> tuple[Task, bytes]:
    """A task file, from the path or from those that come with handctl, checked against the hand.

    Raises:
        ConfigError: there is none, or something in it is wrong.
    """
    path = name if name.exists() else TASKS / name.with_suffix(".toml").name
    if not path.exists():
        packaged = ", ".join(sorted(path.name for path in TASKS.glob("*.toml")))
        raise ConfigError("no such task", str(name), f"a task file, or one of {packaged}")
    task = load_task(path)
    check_suits(task, hand, str(name))
    return task, path.read_bytes()


def find_trajectory(path: Path, hand: Hand) -> Task:
    """A trajectory file as a task, checked against the hand.

    Raises:
        ConfigError: there is none, or something in it is wrong.
    """
    task = load_trajectory(path)
    check_suits(task, hand, str(path))
    return task


def check_suits(task: Task, hand: Hand, where: str) -> None:
    """Refuse a task that does not suit the hand.

    Raises:
        ConfigError: a digit, a number of angles, a tension or an angle that the hand does not have; a move too fast; a
            tip force of an underactuated digit.
    """
    check_task(task, hand.digit_names, min(tendon.tension_max_N for tendon in hand.tendon), where, shapes(hand))
    check_tip_force(task, hand, where)
    check_joint_range(task, hand, where)
    check_speed(task, hand.digit_names, where)
