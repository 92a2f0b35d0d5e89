"""What the drives of all motors say, as columns: one look at each drive, however many ask for its numbers."""

from typing import NamedTuple

from handctl.drives.contract import DriveState, Phase


class Motors(NamedTuple):
    """The fields of ``DriveState``, each over the M motors."""

    phase: tuple[Phase, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    torque: tuple[float, ...]
    temperature: tuple[float, ...]
    feedback_t_ns: tuple[int, ...]
    feedback_count: tuple[int, ...]
    error: tuple[int, ...]
    error_text: tuple[str, ...]
    misread: tuple[int, ...]
    private: tuple[tuple[object, ...], ...]

    @staticmethod
    def of(drives: tuple[DriveState, ...]) -> "Motors":
        """Columns of the drives' states."""
        return Motors(*zip(*drives, strict=True))
