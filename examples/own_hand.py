"""Describe your own hand in a file, print the message about a mistake in the file, and grasp with the simulated hand.

python own_hand.py writes mine.toml.
"""

from pathlib import Path

from handctl import ConfigError
from handctl.controller.setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.hand.load import hand_path, load_hand
from handctl.programs.default_task import default_task
from handctl.programs.grasp import TaskProgram
from handctl.session.simulate import SimulatorSettings, simulate_controller

mine = Path("mine.toml")
text = hand_path("jamia").read_text("utf-8").replace('name = "jamia"', 'name = "mine"', 1)
mine.write_text(text.replace("link_length_m", "link_lenght_m", 1), "utf-8")
try:
    load_hand(mine)
except ConfigError as error:
    print("refused:", error)

mine.write_text(text, "utf-8")
hand = load_hand(mine)
print(
    f"{hand.name}: {len(hand.joints)} joints, {len(hand.tendon)} tendons, {len(hand.motor)} motors"
)

task, _ = default_task(hand)  # close until contact, hold, release, open
controller = make_controller(hand, Gains(), 500.0, TaskProgram(task), None, arm_at_once=True)
touching: set[str] = set()


def see(entry, out):
    """Collect the digits that have been in contact."""
    touching.update(event.where for event in out.events if event.name == "contact")


state = simulate_controller(controller, SimulatorSettings(hand, "cylinder", homed=True), see)
print("in contact:", ", ".join(sorted(touching)))
print("result:", state.failure or "complete, relaxed and disarmed")
