"""Chunks that are valid for a whole run: names, colours and coordinate frames of the dashboard's entities."""

from collections.abc import Iterator, Sequence

import rerun as rr
from rerun.chunk import Chunk

from handctl.core.tick_types import TELEMETRY_AXES
from handctl.digit_colours import colour_numbers
from handctl.view.scene import palette
from handctl.view.scene.chunk_arrays import static_chunk
from handctl.view.scene.palette import Colour
from handctl.view.scene.run_info import RunInfo

ESTIMATE_LINE_WIDTH = 1.8
COMMAND_LINE_WIDTH = 1.0
LIMIT_LINE_WIDTH = 2.2
"""Width of the lines for tension limits [points].

The constants above are the widths of the lines for estimates and commands.
"""


def style_chunks(run: RunInfo) -> Iterator[Chunk]:
    """Yield the chunks that are valid for the whole run: names, colours and coordinate frames of the entities."""
    yield from _tension_styles(run)
    yield from _angle_styles(run)
    yield from _force_styles(run)
    yield from _state_styles()
    yield _line_style("/loop/late", ["late"], [palette.NEUTRAL_COLOUR], 1.2)
    buses = run.hand.bus_names
    yield _line_style(
        "/bus/load",
        buses,
        [
            palette.digit_colour(i).mixed_with(palette.NEUTRAL_COLOUR, 0.4)
            for i in range(len(buses))
        ],
        1.4,
    )
    for name, axis in TELEMETRY_AXES.items():
        names = run.header.axis_names(axis)
        yield _line_style(
            f"/controller/{name}", names, [palette.digit_colour(i) for i in range(len(names))], 1.2
        )


def _line_style(
    entity_path: str, line_names: Sequence[str], line_colours: Sequence[Colour], width: float
) -> Chunk:
    """Return the chunk with the style of the plot lines of an entity."""
    style = rr.SeriesLines.columns(
        names=list(line_names), colors=list(line_colours), widths=[width] * len(line_names)
    )
    return static_chunk(entity_path, style.partition([len(line_names)]))


def _band_style(
    entity_path: str, line_names: Sequence[str], line_colours: Sequence[Colour], unit: str
) -> Chunk:
    """Return the chunk that sets the style of plot lines with a band for the standard deviation."""
    style = rr.Measurements.columns(
        names=list(line_names),
        colors=list(line_colours),
        widths=[ESTIMATE_LINE_WIDTH] * len(line_names),
        units=[unit] * len(line_names),
    )
    return static_chunk(entity_path, style.partition([len(line_names)]))


def _tension_styles(run: RunInfo) -> Iterator[Chunk]:
    """Yield the styles of the tension plot.

    Lines of estimates have the colours of the digits, lines of commands are dimmed, and lines of
    limits are red.
    """
    names = run.hand.tendon_names
    # The tendons of each digit are one slice of the list of tendons. Each digit has its own colour,
    # and each tendon of the digit has a shade of that colour.
    tendon_slices = run.hand.digit_tendons.values()
    colours = [
        joint_colour
        for i, tendons in zip(colour_numbers(run.hand.digit_names), tendon_slices, strict=True)
        for joint_colour in palette.joint_colours(i, tendons.stop - tendons.start)
    ]
    yield _band_style("/tension/estimate", names, colours, "N")
    yield _line_style(
        "/tension/command",
        ["command"] * len(names),
        [palette.dimmed_colour(colour) for colour in colours],
        COMMAND_LINE_WIDTH,
    )
    limits = [f"limit {limit:g} N" for limit in run.tension_limits]
    yield _line_style(
        "/tension/limit", limits, [palette.LIMIT_COLOUR] * len(limits), LIMIT_LINE_WIDTH
    )


def _angle_styles(run: RunInfo) -> Iterator[Chunk]:
    """Yield the styles of the plots of joint angles."""
    for index, digit in zip(colour_numbers(run.hand.digit_names), run.hand.digit, strict=True):
        names = [name.removeprefix(f"{digit.name}_") for name in digit.joints]
        colours = palette.joint_colours(index, len(names))
        yield _line_style(f"/angle/{digit.name}/estimate", names, colours, ESTIMATE_LINE_WIDTH)
        command_names = [f"{name} command" for name in names]
        yield _line_style(
            f"/angle/{digit.name}/command",
            command_names,
            [palette.NEUTRAL_COLOUR] * len(names),
            COMMAND_LINE_WIDTH,
        )


def _force_styles(run: RunInfo) -> Iterator[Chunk]:
    """Yield the coordinate frames and the colours of the force arrows.

    Each arrow starts at the fingertip on which the force acts.
    """
    for index, digit in zip(
        colour_numbers(run.hand.digit_names), run.hand.digit_names, strict=True
    ):
        colour = palette.digit_colour(index).mixed_with(palette.WHITE, 0.3)
        yield static_chunk(f"/force/{digit}", rr.CoordinateFrame.columns(frame=[f"{digit}_tip"]))
        yield static_chunk(f"/force/{digit}", rr.Arrows3D.columns(colors=[colour]))


def _state_styles() -> Iterator[Chunk]:
    """Yield the names and colours of the states in the lanes of the dashboard."""
    for lane, colours in (
        ("phase", palette.PHASE_COLOURS),
        ("mode", palette.PHASE_COLOURS),
        ("safety", palette.ACTION_COLOURS),
    ):
        names = list(colours)
        style = rr.StateConfiguration.columns(
            values=names, labels=names, colors=list(colours.values())
        )
        yield static_chunk(f"/state/{lane}", style.partition([len(names)]))
