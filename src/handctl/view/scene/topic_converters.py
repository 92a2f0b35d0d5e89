"""Conversion of the topics of a log to the entities of the dashboard.

Entities: /hand/<link>/<part>, /force/<digit>, /tension/{estimate,command,limit},
/angle/<digit>/{estimate,command}, /state/{phase,mode,safety}, /loop/late, /bus/load,
/controller/<field>. Rerun itself converts /tf, /tf_static, /rosout and the temperatures.
"""

from collections.abc import Callable, Iterator

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from handctl.core.tick_types import TELEMETRY_AXES
from handctl.view.scene.bus_load_calculator import BusLoadCalculator
from handctl.view.scene.chunk_arrays import (
    FloatArray,
    chunk_with_run_times,
    column_as_array,
    decoded_messages,
    temporal_chunk,
    times_since_start,
)
from handctl.view.scene.geometry import solid_shape_chunks
from handctl.view.scene.run_info import RunInfo

ARROW_LENGTH_M_PER_N = 0.008
"""Length of a force arrow for each newton of force [m/N]."""
ARROW_RADIUS_M = 0.0013
"""Radius of a force arrow [m]."""
LIMIT_DISPLAY_FRACTION = 0.6
"""Fraction of a tension limit that a tension must reach so that the limit is drawn."""
MIN_ARROW_FORCE_N = 0.05
"""Smallest force drawn as an arrow [N]."""

ChunkConverter = Callable[[Chunk], Iterator[Chunk]]
"""Function that converts a chunk of one topic to chunks for the dashboard."""

STATE_TOPICS = {
    "/grasp/phase": "/state/phase",
    "/controller/mode": "/state/mode",
    "/safety/action": "/state/safety",
}
"""Entity of the dashboard for each topic whose messages name a state."""


class TopicConverters:
    """Converter of chunks of a log to chunks for the dashboard.

    The topic of a chunk determines the conversion.
    """

    def __init__(self, run: RunInfo) -> None:
        """Choose the function that converts the chunks of each topic.

        Args:
            run: data about the run and the hand of the log.
        """
        self._run = run
        self._offset = run.header.offset_ns
        self._load = BusLoadCalculator(run)
        self._converters: dict[str, ChunkConverter] = {
            "/controller/values": self._convert_telemetry,
            "/cycle": self._convert_cycle,
            "/tick": self._convert_tick,
            **dict.fromkeys(STATE_TOPICS, self._convert_state),
        }
        self._native = ("/tf", "/tf_static", "/rosout", "/actuator/")

    @property
    def topics(self) -> list[str]:
        """Return regular expressions for the topics to convert."""
        exact_topics = [*self._converters, "/tf", "/tf_static", "/rosout", "/robot_description"]
        return [f"^{topic}$" for topic in exact_topics] + ["^/actuator/.*/temperature$"]

    def __call__(self, chunk: Chunk) -> Iterator[Chunk]:
        """Convert a chunk of the log, and yield the resulting chunks for the dashboard."""
        entity_path = chunk.entity_path
        if "/visual_geometries/" in entity_path:
            yield from solid_shape_chunks(chunk, self._run)
        elif not chunk.timeline_names:
            return
        elif entity_path in self._converters:
            yield from self._converters[entity_path](chunk)
        elif entity_path.startswith(self._native):
            yield chunk_with_run_times(chunk, self._offset)

    def _convert_telemetry(self, chunk: Chunk) -> Iterator[Chunk]:
        """Convert the telemetry of the controller to plots, force arrows and single values."""
        messages = decoded_messages(chunk)
        if messages is None:
            return
        table = column_as_array(messages.field("values"))
        times = times_since_start(chunk, self._offset)
        values_of_field = self._run.split_telemetry(table)
        yield temporal_chunk(
            "/tension/estimate",
            times,
            lines_with_uncertainty_band(
                values_of_field["tension"], values_of_field["tension_sigma"]
            ),
        )
        yield temporal_chunk("/tension/command", times, plot_lines(values_of_field["tension_goal"]))
        limits = limits_near_tensions(self._run.tension_limits, values_of_field["tension"])
        if not np.isnan(limits).all():
            drawn_lines = plot_lines(np.tile(limits, (2, 1)))
            yield temporal_chunk("/tension/limit", times[[0, -1]], drawn_lines)
        for digit, joints in self._run.hand.digit_joints.items():
            factor = self._run.hand.display_units.factor[joints]
            angle = factor * values_of_field["q"][:, joints]
            # Without an encoder, the standard deviation of a joint angle is about 20 deg. A band of
            # 20 deg would cover the plot. Therefore the plot of the angles shows no band. The plot
            # of the signal q_sigma shows the standard deviation of each joint angle.
            yield temporal_chunk(f"/angle/{digit}/estimate", times, plot_lines(angle))
            yield temporal_chunk(
                f"/angle/{digit}/command",
                times,
                plot_lines(factor * values_of_field["q_goal"][:, joints]),
            )
        for index, digit in enumerate(self._run.hand.digit_names):
            yield temporal_chunk(
                f"/force/{digit}", times, force_arrows(values_of_field["tip_force"][:, index])
            )
        for name in TELEMETRY_AXES:
            yield temporal_chunk(f"/controller/{name}", times, plot_lines(values_of_field[name]))

    def _convert_cycle(self, chunk: Chunk) -> Iterator[Chunk]:
        """Convert the lateness of each tick to a plot line [us]."""
        messages = decoded_messages(chunk)
        if messages is not None:
            lateness_us = np.asarray(messages.field("late"), np.float64) * 1e6
            yield temporal_chunk(
                "/loop/late",
                times_since_start(chunk, self._offset),
                plot_lines(lateness_us[:, None]),
            )

    def _convert_tick(self, chunk: Chunk) -> Iterator[Chunk]:
        """Convert the CAN frames of each tick to the load of each bus [%]."""
        messages = decoded_messages(chunk)
        if messages is not None:
            bus_loads_percent = 100 * self._load.loads_of_ticks(messages)
            yield temporal_chunk(
                "/bus/load", times_since_start(chunk, self._offset), plot_lines(bus_loads_percent)
            )

    def _convert_state(self, chunk: Chunk) -> Iterator[Chunk]:
        """Convert messages that contain the name of a state to a lane of the dashboard."""
        messages = decoded_messages(chunk)
        if messages is not None:
            state_names = messages.field("name").to_pylist()
            entity_path = STATE_TOPICS[chunk.entity_path]
            yield temporal_chunk(
                entity_path,
                times_since_start(chunk, self._offset),
                rr.StateChange.columns(state=state_names),
            )


def limits_near_tensions(tension_limits: list[float], tension: FloatArray) -> FloatArray:
    """Return the tension limits (n,) [N], with NaN in place of each limit far above all tensions.

    A plot chooses its range so that all its lines are visible. A line at a very high limit would
    leave little room for the lines of the tensions.
    """
    largest = float(np.fmax.reduce(tension, axis=None, initial=0.0))
    return np.array(
        [x if largest >= LIMIT_DISPLAY_FRACTION * x else np.nan for x in tension_limits]
    )


def lines_with_uncertainty_band(
    line_values: FloatArray, sigma: FloatArray
) -> rr.ComponentColumnList:
    """Return values (n, lines) as plot lines with a band of one standard deviation.

    The band has a gap where the standard deviation is unknown.
    """
    band_columns = rr.Measurements.columns(
        values=line_values.ravel(), variances=np.nan_to_num(sigma**2).ravel()
    )
    return band_columns.partition([line_values.shape[1]] * len(line_values))


def plot_lines(line_values: FloatArray) -> rr.ComponentColumnList:
    """Return values (n, lines) as plot lines without a band."""
    return rr.Scalars.columns(scalars=line_values.ravel()).partition(
        [line_values.shape[1]] * len(line_values)
    )


def force_arrows(force: FloatArray) -> rr.ComponentColumnList:
    """Return the forces of the object on a fingertip (n,) [N] as arrows in the coordinate frame of the tip."""
    shown_force = np.where(force >= MIN_ARROW_FORCE_N, force, 0.0)
    force_vectors = np.zeros((len(force), 3))
    # A closing tip moves along +y of its own frame, so the object pushes the tip along -y.
    force_vectors[:, 1] = -ARROW_LENGTH_M_PER_N * shown_force
    labels = [f"{value:.1f} N" if value else "" for value in shown_force.tolist()]
    radii = np.where(shown_force > 0, ARROW_RADIUS_M, 0.0)
    return rr.Arrows3D.columns(vectors=force_vectors, labels=labels, radii=radii)
