"""Test the page docs/reference/tasks.md.

The examples of a task and of a scene on the page docs/reference/tasks.md are valid. The tables of
the page docs/reference/tasks.md contain only keys that exist.
"""

import re
from pathlib import Path

from firmware_sim.scene.scene import load_scene
from handctl.hand.hand_loading import load_hand, packaged_hands
from handctl.programs.task import ClosePhase, FollowPhase, HoldPhase, MovePhase, ReleasePhase
from handctl.session.task_loading import load_task_for_hand

REPOSITORY = Path(__file__).parents[2]
TASKS_PAGE = (REPOSITORY / "docs" / "reference" / "tasks.md").read_text("utf-8")
TOML_BLOCKS = re.findall(r"```toml\n(.*?)```", TASKS_PAGE, re.S)


def test_the_example_suits_every_jamia(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(TOML_BLOCKS[0])
    for name in (name for name in packaged_hands() if name.startswith("jamia")):
        task, _ = load_task_for_hand(path, load_hand(name))
        assert [phase.kind for phase in task.phase] == ["move", "close", "hold", "release", "move"]


def test_scene_of_the_page_is_valid(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(TOML_BLOCKS[1])
    assert len(load_scene(str(path)).stages) == 1


def test_every_packaged_task_and_its_scenes_are_named() -> None:
    tasks = {path.stem for path in (REPOSITORY / "src" / "handctl" / "tasks").glob("*.toml")}
    rows = re.findall(r"^\| `([\w-]+)` \|.*\| (`.*`) \|$", TASKS_PAGE, re.M)
    assert {name for name, _ in rows} == tasks
    for _, scenes in rows:
        for scene in re.findall(r"`([\w:]+)`", scenes):
            assert load_scene(scene).grasp_object is not None, scene


def test_every_key_of_every_phase_is_named() -> None:
    for kind in (MovePhase, ClosePhase, HoldPhase, ReleasePhase, FollowPhase):
        for key in kind.model_fields.keys() - {"kind", "name"}:
            assert f"`{key}`" in TASKS_PAGE, (kind.__name__, key)
