"""Break a tendon of a moving simulated hand, and print the reaction of the controller.

python inject_fault.py runs in lockstep. The command handctl fault inject "snap tendon=index_tendon"
injects the same fault into a simulated hand that runs in real time.
"""

import json

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller

model = HandModel.from_hand(load_hand("jamia"), Gains(), 500.0)
with SimulatorSettings("jamia", seed=1, homed=True).begin_run(
    homed_controller(model, LiveProgram())
) as run:
    run.run_until(lambda out: out.phase == "live", 5.0)
    run.run_tick(
        requests=(json.dumps({"do": "move", "angle_deg": {"index": 60.0}, "duration_s": 1.0}),)
    )
    run.run_until(lambda out: out.telemetry.q[0] > 0.5, 2.0)
    broken_s = run.k * model.period
    run.simulated_hand.inject("snap tendon=index_tendon")
    for entry, out in run.run_ticks(broken_s + 5.0):
        for event in out.events:
            if event.name in ("fault", "mode"):
                print(
                    f"{1e3 * (entry.t_ns / 1e9 - broken_s):6.0f} ms after the break  {event.text}"
                )
        if out.mode == HandMode.DONE:
            break
print("failure:", run.state.failure)
