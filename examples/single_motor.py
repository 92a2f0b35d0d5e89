"""Turn a single motor by one radian with a proportional-derivative (PD) loop.

The motor of this example belongs to no hand and moves no tendon.

Start in another terminal: python -m firmware_sim drive mit --ids 1 --bus local:bench
When the motor is ready, start: python single_motor.py

The shaft of a real motor must be free. Change the torque limit and the bus of the motor in the
first constants of the program.
"""

from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.protocol_registry import make_drive
from handctl.hand.file.section_models import Motor
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig
from handctl.runtime.mailbox import bus_lock

BUS_SPEC, TORQUE_LIMIT_N_M, WATCHDOG_MS = "local:bench", 0.1, 100
STIFFNESS_N_M_PER_RAD, DAMPING_N_M_S_PER_RAD = 0.5, 0.02
MOTOR_SPEC = Motor.model_validate({
    "name": "motor", "protocol": "mit", "bus": "bench", "node_id": 1, "direction": 1, "zero_rad": 0.0,
    "spool_radius_m": 0.005, "inertia_kg_m2": 1e-4, "viscous_N_m_s_per_rad": 0.0, "coulomb_N_m": 0.0,
    "torque_constant_N_m_per_A": 0.1, "torque_max_N_m": TORQUE_LIMIT_N_M, "torque_peak_N_m": TORQUE_LIMIT_N_M,
    "position_range_rad": 12.5, "velocity_range_rad_s": 30.0, "watchdog_ms": WATCHDOG_MS,
})  # fmt: skip

with bus_lock(BUS_SPEC):  # only one host is allowed to use the bus
    clock = RealClock(PERIOD_NS)
    bus = open_bus(BUS_SPEC, 0, 1_000_000, convert_time=clock.convert_to_run_time)
    rig = DriveRig(make_drive(MOTOR_SPEC, 0), bus, clock)
    try:
        if not rig.run_until(DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, 5.0):
            raise SystemExit(
                f"the drive is not ready: {rig.state.error_text or rig.state.phase.name}"
            )
        if not rig.run_until(
            DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 1.0
        ):
            raise SystemExit(
                f"the drive does not enable: {rig.state.error_text or rig.state.phase.name}"
            )
        goal = rig.state.position + 1.0
        for tick in range(400):  # 2 s
            state = rig.state
            torque = (
                STIFFNESS_N_M_PER_RAD * (goal - state.position)
                - DAMPING_N_M_S_PER_RAD * state.velocity
            )
            rig.run_tick(DriveTarget.ENABLE, max(-TORQUE_LIMIT_N_M, min(TORQUE_LIMIT_N_M, torque)))
            if tick % 50 == 0:
                print(
                    f"{tick * PERIOD_NS / 1e9:4.2f} s: {goal - rig.state.position:+.3f} rad to go"
                )
    finally:
        is_disabled = rig.confirm_disabled(WATCHDOG_MS / 1e3)
        bus.close()
print(
    "the drive has confirmed that it is off"
    if is_disabled
    else "REMOVE THE POWER: the drive has not confirmed it is off"
)
raise SystemExit(0 if is_disabled else 71)
