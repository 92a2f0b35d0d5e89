"""Define simulated hands that differ from the controller's model by known factors.

``PHASES_TO_CONTACT`` defines the first phases of a task, in which the hand closes until it touches
the object.
"""

PLANT_FACTORS: dict[str, dict[str, float]] = {
    "as known": {},
    "stiffness +20 %": {"stiffness": 1.2},
    "stiffness -20 %": {"stiffness": 0.8},
    "mass +20 %": {"mass": 1.2},
    "mass -20 %": {"mass": 0.8},
    "friction +50 %": {"friction": 1.5},
    "friction -50 %": {"friction": 0.5},
    "bias 1 N": {"bias": 1.0},
}
FURTHER_PLANT_FACTORS: dict[str, dict[str, float]] = {
    "stiffness +50 %": {"stiffness": 1.5},
    "stiffness -50 %": {"stiffness": 0.5},
    "friction +100 %": {"friction": 2.0},
}
"""Further simulated hands. Only the benchmark of the tension estimate uses these hands."""
PHASES_TO_CONTACT = (
    {"kind": "move", "name": "preshape", "angle_deg": {"index": 18.0, "middle": 18.0, "ring": 18.0, "thumb": 3.0},
     "duration_s": 0.4},
    {"kind": "close", "name": "close", "angle_deg": 85.0, "speed_deg_s": 60.0, "contact_tension_N": 14.0},
)  # fmt: skip
"""Phases of a task that precede its hold phase."""
