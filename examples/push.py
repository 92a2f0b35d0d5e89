"""Push an object that a simulated hand holds, and compare the push forces at two stiffnesses of the grip.

python push.py writes push.png.
"""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handctl.controller.run_setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings

PUSH_SCENE = """
name = "push"
[object]
shape = "cylinder"
diameter_m = 0.035
length_m = 0.093
mass_kg = 0.15
friction = 0.5
position_m = [0.0195, 0.0, 0.0]
[support]
drop_when = "never"
[load]
direction = [1.0, 0.0, 0.0]  # out of the palm
start_s = 3.5                # after power-up
rate_N_per_s = 8.0
"""
PUSH_START_S, PUSH_RATE_N_PER_S, LARGEST_PUSH_N, SHOWN_MOTION_MM = 3.5, 8.0, 8.0, 3.0


def push_task(stiffness_N_per_mm):
    """Return a task in which the hand closes on an object and holds it.

    In the hold phase, the tension of a tendon rises when the object pulls this tendon out.
    """
    hold_phase = {
        "kind": "hold",
        "tension_N": 12.0,
        "stiffness_N_per_mm": stiffness_N_per_mm,
        "duration_s": 8.0,
    }
    close_phase = {
        "kind": "close",
        "angle_deg": 85.0,
        "speed_deg_s": 100.0,
        "contact_tension_N": 12.0,
    }
    return Task.model_validate(
        {"schema": 1, "name": "push", "description": "push", "phase": (close_phase, hold_phase)}
    )


figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
hand = load_hand("jamia")
for stiffness in (0.0, 30.0):
    controller = make_controller(
        hand, Gains(), 500.0, TaskProgram(push_task(stiffness)), None, arm_at_once=True
    )
    force, object_position = [], []
    with SimulatorSettings(hand, PUSH_SCENE, homed=True).begin_run(controller) as run:
        for entry, _ in run.run_ticks(PUSH_START_S + LARGEST_PUSH_N / PUSH_RATE_N_PER_S):
            force.append(max(0.0, PUSH_RATE_N_PER_S * (entry.t_ns / 1e9 - PUSH_START_S)))
            object_position.append(run.simulated_hand.world.plant.engine.object_pose()[0])
    is_pushed = np.array(force) > 0.0
    force_now = np.array(force)[is_pushed]  # [N]
    moved_mm = 1e3 * (
        np.array(object_position)[is_pushed] - object_position[int(np.argmax(is_pushed))]
    )
    end_index = int(np.argmax(moved_mm > SHOWN_MOTION_MM))
    axes.plot(
        moved_mm[:end_index], force_now[:end_index], label=f"{stiffness:g} N/mm at each tendon"
    )
    print(
        f"stiffness {stiffness:g} N/mm: {force_now[end_index]:.1f} N move the object by {SHOWN_MOTION_MM:g} mm"
    )
axes.set(xlabel="displacement of the object [mm]", ylabel="force out of the palm [N]")
axes.set_title("A push on a held cylinder")
axes.legend()
figure.savefig("push.png", dpi=120)
