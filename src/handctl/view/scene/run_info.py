"""Data about the run and the hand of a log, for the converters and the layout of the dashboard."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import TELEMETRY_AXES
from handctl.hand.description import Hand
from handctl.hand.file.error_text import shortened_list
from handctl.log.attached_meshes import AttachedMesh, attached_meshes
from handctl.log.header import RunHeader
from handctl.log.read.hand_in_log import described_hand
from handctl.log.tick_batch import columns_of_fields, row_field_names
from handctl.printing import printable_text
from handctl.report.truth_record import TruthRecord

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RunInfo:
    """Data about one run of one hand.

    Attributes:
        header: header of the log, with names, control period and clock offset.
        hand: description of the hand from the log.
        name: name of the log for the user.
        truth: true values from the simulator during the run, or None.
    """

    header: RunHeader
    hand: Hand
    name: str
    truth: TruthRecord | None = None

    @classmethod
    def from_header(cls, header: RunHeader, name: str) -> "RunInfo":
        """Return the data about a run from the header of a log.

        Raises:
            LogError: the description of the hand and the header contain different names.
            ConfigError: the description in the log is not a valid hand.
        """
        location = f"{name}, attachment hand.toml"
        return cls(header, described_hand(header, location), printable_text(name))

    @cached_property
    def meshes(self) -> dict[str, AttachedMesh]:
        """Return the meshes that the log contains, by the name of the link."""
        return attached_meshes(self.hand, self.header.attachments)[0]

    @cached_property
    def missing_mesh_note(self) -> str:
        """Return a line about the meshes that the log lacks.

        The text is empty if no mesh is missing.
        """
        missing_meshes = attached_meshes(self.hand, self.header.attachments)[1]
        if not missing_meshes:
            return ""
        return f"capsules are drawn for {shortened_list(missing_meshes)}: the log does not have the meshes"

    @property
    def application_id(self) -> str:
        """Return the application id for Rerun. Rerun stores one layout of the dashboard for each application id."""
        return f"handctl_{self.hand.name}"

    def split_telemetry(self, telemetry_table: FloatArray) -> dict[str, FloatArray]:
        """Split rows of the topic /controller/values into the fields of the telemetry.

        Args:
            telemetry_table: (n, columns) rows of the topic.

        Returns:
            an array (n, names) for each field of the telemetry. If an older version of handctl
            wrote the log and did not know a telemetry field, the array of this field is NaN.
        """
        slices = columns_of_fields(
            self.header, row_field_names(self.header, telemetry_table.shape[1])
        )
        missing_names = {
            name: np.full((len(telemetry_table), len(self.header.axis_names(axis))), np.nan)
            for name, axis in _missing_fields(slices)
        }
        return {
            name: telemetry_table[:, columns_of_field] for name, columns_of_field in slices.items()
        } | missing_names

    @property
    def tension_limits(self) -> list[float]:
        """Return the distinct tension limits of the hand's tendons in rising order [N]."""
        return sorted({tendon.tension_max_N for tendon in self.hand.tendon})

    @property
    def longest_digit_m(self) -> float:
        """Return the length of the longest digit [m]."""
        return max(sum(digit.link_length_m) for digit in self.hand.digit)


def _missing_fields(field_slices: dict[str, slice]) -> list[tuple[str, str]]:
    """Return (name, axis) of each telemetry field that a log lacks.

    The axis names the components that have one value each in the field, for example ``joint``.
    """
    return [(name, axis) for name, axis in TELEMETRY_AXES.items() if name not in field_slices]
