"""Generated run in which a hand moves plausibly, for tests of the log and for trials of the viewer.

Command: `python tests/log/synthetic_run.py OUT.mcap [--hand jamia|jamia11] [--seconds 10] [--rate 500]`.

Three fingers and the thumb tighten their tendons, close, and touch an object one after the other.
The digits hold the object at a rising tension, release it, and open. The run contains a drive that
becomes warm, a bus error, a change of a gain, and a late frame.
"""

import argparse
import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from handctl.core.tick_types import (
    TELEMETRY_AXES,
    HandMode,
    IoEvent,
    Telemetry,
    TickEvent,
    TickIn,
    TickOut,
)
from handctl.drives.contract import DrivePhase
from handctl.drives.frame import Frame
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand
from handctl.log.header import RunHeader
from handctl.log.tick_packing import pack_tick_record
from handctl.log.topics.state_topics import moment_arms
from handctl.log.write.recorder import Recorder
from handctl.safety.safety_action import SafetyAction

PHASE_END_FRACTIONS = (
    ("start", 0.02),
    ("tighten", 0.08),
    ("close", 0.40),
    ("hold", 0.75),
    ("release", 0.85),
    ("open", 0.98),
)
"""Phases of the run, each with the fraction of the run at which it ends. The last phase, "end", is not in the list.
"""


def synthetic_header(
    hand_name: str = "jamia", rate_hz: int = 500, **other_fields: object
) -> RunHeader:
    """Create the header of a deterministic run of a packaged hand."""
    hand = load_hand(hand_name)
    attachments = {
        "gains.toml": b"[motion]\nposition_error_m = 6e-4\n",
        "initial_state": bytes(range(64)),
        "hand.urdf": urdf_text(hand).encode(),
    }
    header_fields: dict[str, object] = {
        "metadata": {"hand": hand_name, "note": "synthetic", "seed": "0"},
        "gains": {"motion.position_error_m": "0.0006", "tension.rate_N_per_s": "200.0"},
        "attachments": attachments,
        "deterministic": True,
    }
    return RunHeader.from_hand(hand.to_toml(), 10**9 // rate_hz, **(header_fields | other_fields))


def _phase_name_at(run_fraction: float) -> str:
    return next((name for name, end in PHASE_END_FRACTIONS if run_fraction < end), "end")


class SyntheticRunTicks:
    """The ticks of a generated run. Equal seeds give equal ticks."""

    def __init__(self, run_header: RunHeader, duration_s: float, seed: int = 0) -> None:
        self.run, self.ticks = run_header, round(duration_s * 1e9 / run_header.period_ns)
        self._random = np.random.default_rng(seed)
        self._arms = moment_arms(run_header)
        self._digit_of = [
            next(d for d, name in enumerate(run_header.digits) if j.startswith(name))
            for j in run_header.joints
        ]
        self._tendon_digit = [
            next(d for d, name in enumerate(run_header.digits) if t.startswith(name))
            for t in run_header.tendons
        ]
        self._hash = hashlib.blake2b(digest_size=8)

    def __iter__(self) -> Iterator[tuple[TickIn, TickOut]]:
        previous_phase = ""
        for k in range(self.ticks):
            fraction = k / max(self.ticks, 1)
            telemetry = self._telemetry(k, fraction)
            phase = _phase_name_at(fraction)
            tick_in = self._tick_input(k, telemetry)
            events = (TickEvent("info", "phase", "", phase),) if phase != previous_phase else ()
            if k == self.ticks // 3:
                events += (TickEvent("info", "gain", "motion.position_error_m", "0.0008"),)
            if k == self.ticks // 2:
                events += (
                    TickEvent(
                        "warn", "contact", self.run.digits[0], "touched earlier than planned"
                    ),
                )
            previous_phase = phase
            mode = (
                HandMode.READY
                if fraction < 0.02
                else HandMode.ACTIVE
                if fraction < 0.98
                else HandMode.DISARM
            )
            action = SafetyAction.WARN if 0.5 <= fraction < 0.51 else SafetyAction.PASS
            self._hash.update(telemetry.to_bytes())
            frames = self._sent_frames(k, telemetry)
            yield (
                tick_in,
                TickOut(frames, mode, phase, action, telemetry, events, self._hash.digest()),
            )

    def _closing_fraction(self, run_fraction: float) -> float:
        """Return how far the hand is closed: 0 is open, and 1 is closed.

        ``run_fraction`` is the elapsed fraction of the run.
        """
        closing_progress = float(np.clip((run_fraction - 0.08) / 0.32, 0, 1))
        opening_progress = float(np.clip((run_fraction - 0.85) / 0.13, 0, 1))
        closed = closing_progress * closing_progress * (3 - 2 * closing_progress)
        return closed * (1 - opening_progress * opening_progress * (3 - 2 * opening_progress))

    def _telemetry(self, tick_index: int, run_fraction: float) -> Telemetry:
        run, period = self.run, self.run.period_ns * 1e-9
        goal = np.full(len(run.joints), 1.2 * self._closing_fraction(run_fraction))
        stop = 0.75 + 0.1 * np.array(self._digit_of)
        q = np.minimum(goal, stop) + 2e-4 * self._random.standard_normal(len(goal))
        angles_before = np.minimum(
            1.2 * self._closing_fraction(run_fraction - 1 / self.ticks), stop
        )
        dq = (np.minimum(goal, stop) - angles_before) / period
        contact_depth = np.array(
            [
                max(0.0, 1.2 * self._closing_fraction(run_fraction) - (0.75 + 0.1 * d))
                for d in range(len(run.digits))
            ]
        )
        tension = (
            6.0
            + 3.0 * np.sin(2 * np.pi * 2 * run_fraction)
            + 60.0 * contact_depth[self._tendon_digit]
        )
        noise = self._random.standard_normal(len(tension))
        measured_tension = np.round((tension + 0.3 * noise + 6) / 0.0625) * 0.0625 - 6
        excursion = self._arms @ q
        motor = excursion[: len(run.motors)] / 0.005 + tension / 1e5 / 0.005
        phase = DrivePhase.READY if run_fraction < 0.02 else DrivePhase.ENABLED
        motor_temperature = 30 + 15 * run_fraction * (np.arange(len(run.motors)) == 0)
        values: dict[str, np.ndarray] = {
            "q": q, "dq": dq, "q_goal": goal, "dq_goal": dq, "joint_torque": self._arms.T @ tension,
            "joint_encoder": q.round(3) if tick_index % 4 == 0 else np.full(len(q), np.nan),
            "excursion": excursion, "excursion_rate": self._arms @ dq, "tension": tension,
            "tension_sigma": np.full(len(tension), 0.25) + 0.1 * (tick_index < 20), "tension_raw": measured_tension,
            "tension_goal": tension + 0.5, "stretch_offset": 1e-5 * np.sin(run_fraction) * np.ones(len(tension)),
            "innovation": measured_tension - tension, "nis": ((measured_tension - tension) / 0.3) ** 2,
            "external_tension": 60.0 * contact_depth[self._tendon_digit], "motor_position": motor,
            "motor_velocity": np.gradient(motor), "motor_torque": 0.005 * tension,
            "motor_torque_goal": 0.005 * (tension + 0.5), "motor_temperature": motor_temperature,
            "motor_age": np.full(len(motor), period), "drive_phase": np.full(len(motor), float(phase)),
            "tip_force": 3.0 * contact_depth, "contact": (contact_depth > 0.01).astype(float),
            "q_sigma": 0.002 + 0.3 * contact_depth[np.array(self._digit_of)],
            "tip_force_sigma": 0.1 + 0.5 * contact_depth,
        }  # fmt: skip
        return Telemetry(**{name: np.asarray(values[name], float) for name in TELEMETRY_AXES})

    def _tick_input(self, tick_index: int, telemetry: Telemetry) -> TickIn:
        t_ns, frames = tick_index * self.run.period_ns, []
        if tick_index:
            previous_tick_ns = t_ns - self.run.period_ns
            for index, motor in enumerate(telemetry.motor_position):
                word = int(np.clip((motor + 12.5) / 25 * 65535, 0, 65535))
                data = bytes((index + 1, word >> 8, word & 255, 0x80, 0, 0x80, 30, 30))
                frames.append(
                    Frame(0x11 + index, data, 0, 0, previous_tick_ns + 150_000 + 120_000 * index)
                )
            tension_code = int(np.clip((telemetry.tension_raw[0] + 6) / 0.0625, 0, 4095))
            frames.append(
                Frame(0x1A0, tension_code.to_bytes(7, "little"), 0, 0, previous_tick_ns + 90_000)
            )
        io_events = (
            (IoEvent("enobufs", self.run.buses[0], 3),) if tick_index == self.ticks // 2 else ()
        )
        requests = ('{"do": "arm"}',) if tick_index == 5 else ()
        return TickIn(
            tick_index,
            t_ns,
            int(self._random.integers(0, 40_000)),
            tuple(frames),
            io_events,
            requests,
        )

    def _sent_frames(self, tick_index: int, telemetry: Telemetry) -> tuple[Frame, ...]:
        frames = [Frame(0x080, bytes((tick_index & 0xFF,)))]
        for index, torque in enumerate(telemetry.motor_torque_goal):
            word = int(np.clip((torque + 0.8) / 1.6 * 4095, 0, 4095))
            frames.append(
                Frame(index + 1, bytes((0x7F, 0xFF, 0x7F, 0xF0, 0, 0, word >> 8, word & 255)))
            )
        return tuple(frames)


def write_synthetic_run(
    log_path: Path, run_header: RunHeader, duration_s: float, seed: int = 0
) -> dict[str, object]:
    """Record a generated run with a real recorder, and return the summary that the recorder gives."""
    recorder = Recorder.start(log_path, run_header)
    for tick_in, out in SyntheticRunTicks(run_header, duration_s, seed):
        recorder.send_record(pack_tick_record(tick_in, out))
    return recorder.close("finished")


def main() -> None:
    """Write the log of the synthetic run that the options on the command line describe."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path, help="log to write")
    parser.add_argument("--hand", default="jamia", help="packaged hand (default: jamia)")
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="duration of the run [s] (default: 10)"
    )
    parser.add_argument("--rate", type=int, default=500, help="control rate [Hz] (default: 500)")
    options = parser.parse_args()
    print(
        write_synthetic_run(
            options.path, synthetic_header(options.hand, options.rate), options.seconds
        )
    )


if __name__ == "__main__":
    main()
