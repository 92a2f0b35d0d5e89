"""Describe your own hand in a hand file, show the error message about a mistake, and let the simulated hand grasp.

python own_hand.py writes mine.toml.
"""

from pathlib import Path

from handctl import ConfigError
from handctl.controller.run_setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import hand_path, load_hand
from handctl.programs.default_task import default_task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, simulate_controller

own_hand_path = Path("mine.toml")
own_hand_text = hand_path("jamia").read_text("utf-8").replace('name = "jamia"', 'name = "mine"', 1)
own_hand_path.write_text(own_hand_text.replace("link_length_m", "link_lenght_m", 1), "utf-8")
try:
    load_hand(own_hand_path)
except ConfigError as error:
    print("refused:", error)

own_hand_path.write_text(own_hand_text, "utf-8")
hand = load_hand(own_hand_path)
print(
    f"{hand.name}: {len(hand.joints)} joints, {len(hand.tendon)} tendons, {len(hand.motor)} motors"
)

task, _ = default_task(hand)  # phases: close until contact, hold, release, open
controller = make_controller(hand, Gains(), 500.0, TaskProgram(task), None, arm_at_once=True)
touching_digits: set[str] = set()


def note_contacts(entry, out):
    """Record which digits have touched the object in the run."""
    touching_digits.update(event.where for event in out.events if event.name == "contact")


state = simulate_controller(
    controller, SimulatorSettings(hand, "cylinder", homed=True), note_contacts
)
print("in contact:", ", ".join(sorted(touching_digits)))
print("result:", state.failure or "complete, relaxed and disarmed")
