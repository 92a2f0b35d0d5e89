"""Layout of the dashboard in the viewer Rerun."""

import numpy as np
import rerun.blueprint as rrb
from rerun.blueprint.components import BackgroundKind, Corner2D, LinkAxis, PanelState

from handctl.hand.file.section_models import Digit
from handctl.view.scene.chunk_arrays import RUN_TIME_TIMELINE
from handctl.view.scene.run_info import RunInfo

LINKED_TIME_AXIS = rrb.TimeAxis(link=LinkAxis.LinkToGlobal)
NO_LEGEND = rrb.PlotLegend(visible=False)
ROW_HEIGHT_FRACTIONS = [0.34, 0.44, 0.22]
"""Heights of the rows in the right column of the dashboard, as fractions of the column."""
LIVE_TIME_RANGE = rrb.VisibleTimeRange(
    RUN_TIME_TIMELINE,
    start=rrb.TimeRangeBoundary.cursor_relative(seconds=-12),
    end=rrb.TimeRangeBoundary.cursor_relative(seconds=0),
)
"""Time range that the plots show in the live view: the last twelve seconds."""
PlotTimeRange = list[rrb.VisibleTimeRange] | None
BACKGROUND_RGB = (17, 21, 27)
"""Background colour of the view of the hand: red, green, blue, 0 to 255."""
CAMERA_POSITION = (1.5, -0.75, 1.0)
"""Position of the camera relative to the hand, in lengths of the longest digit.

The camera is in front of the palm, on the side of the thumb, and above the hand.
"""


def dashboard_layout(run: RunInfo, is_live: bool = False) -> rrb.Blueprint:
    """Return the layout of the dashboard.

    The left side of the dashboard shows the hand, the timing and the log lines. The right side of
    the dashboard shows forces, joint angles and states. All plots share one time axis.

    Args:
        run: data about the run and the hand to show.
        is_live: True to show only the last seconds of the run. In the live view, the time axis
            moves with the run.
    """
    time_ranges = [LIVE_TIME_RANGE] if is_live else None
    left_column = rrb.Vertical(
        _hand_view(run), _timing_plots(run, time_ranges), _log_view(), row_shares=[0.56, 0.18, 0.26]
    )
    right_column = rrb.Vertical(
        _force_plots(time_ranges),
        _angle_plots(run, time_ranges),
        _state_timeline_view(time_ranges),
        row_shares=ROW_HEIGHT_FRACTIONS,
    )
    return rrb.Blueprint(
        rrb.Horizontal(left_column, right_column, column_shares=[0.40, 0.60]),
        rrb.TopPanel(state=PanelState.Hidden),
        rrb.BlueprintPanel(state=PanelState.Collapsed),
        rrb.SelectionPanel(state=PanelState.Collapsed),
        rrb.TimePanel(
            state=PanelState.Collapsed,
            timeline=RUN_TIME_TIMELINE,
            play_state="following" if is_live else None,
        ),
        auto_layout=False,
        auto_views=False,
    )


def _hand_view(run: RunInfo) -> rrb.Spatial3DView:
    """Return the three-dimensional view of the hand."""
    mounts = np.array([digit.mount_position_m for digit in run.hand.digit])
    view_centre = mounts.mean(axis=0) * (1, 0, 1) + run.longest_digit_m * np.array(
        [0.4, -0.05, -0.06]
    )
    shown_entities = (
        "object and table as in the simulator"
        if run.truth
        else "forces of the object on the fingertips"
    )
    return rrb.Spatial3DView(
        name=f"{run.hand.name}, {run.name}: {shown_entities}",
        contents=["+ /hand/**", "+ /force/**", "+ /true/**", "+ /tf/**", "+ /tf_static/**"],
        spatial_information=rrb.SpatialInformation(target_frame="palm"),
        background=rrb.Background(kind=BackgroundKind.SolidColor, color=BACKGROUND_RGB),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=view_centre + run.longest_digit_m * np.array(CAMERA_POSITION),
            look_target=view_centre,
            eye_up=(0, 0, 1),
        ),
    )


def _force_plots(time_ranges: PlotTimeRange) -> rrb.Horizontal:
    """Return the plots of tendon tensions and fingertip forces."""
    tensions = rrb.TimeSeriesView(
        name="Tendon tension [N], 1-sigma band",
        contents="/tension/**",
        axis_x=LINKED_TIME_AXIS,
        time_ranges=time_ranges,
        plot_legend=rrb.PlotLegend(Corner2D.LeftTop),
    )
    tips = rrb.TimeSeriesView(
        name="Fingertip force [N]",
        contents="/controller/tip_force",
        axis_x=LINKED_TIME_AXIS,
        time_ranges=time_ranges,
        plot_legend=rrb.PlotLegend(Corner2D.LeftTop),
    )
    return rrb.Horizontal(tensions, tips, column_shares=[0.6, 0.4])


def _angle_unit(digit: Digit) -> str:
    """Return the quantity and the unit of the joint positions of a digit, for the title of a plot."""
    units = tuple(dict.fromkeys(digit.display_units.names))
    return f"{'angles' if units == ('deg',) else 'positions'} [{', '.join(units)}]"


def _angle_plots(run: RunInfo, time_ranges: PlotTimeRange) -> rrb.Grid:
    """Return a plot of the joint angles of each digit."""
    plot_views = [
        rrb.TimeSeriesView(
            name=f"{digit.name} joint {_angle_unit(digit)}, grey: command",
            contents=f"/angle/{digit.name}/**",
            axis_x=LINKED_TIME_AXIS,
            time_ranges=time_ranges,
            plot_legend=NO_LEGEND,
        )
        for digit in run.hand.digit
    ]
    return rrb.Grid(*plot_views, grid_columns=2)


def _state_timeline_view(time_ranges: PlotTimeRange) -> rrb.StateTimelineView:
    """Return the lanes that show the grasp phase, the mode of the hand and the reaction to faults over time."""
    return rrb.StateTimelineView(
        name="Grasp phase, mode of the hand, safety",
        contents="/state/**",
        time_view=LINKED_TIME_AXIS,
        time_ranges=time_ranges,
    )


def _timing_plots(run: RunInfo, time_ranges: PlotTimeRange) -> rrb.Horizontal:
    """Return the plots of the lateness of the ticks and of the bus loads."""
    lateness_title = (
        "Tick late: never, in virtual time" if run.header.deterministic else "Tick late [us]"
    )
    return rrb.Horizontal(
        rrb.TimeSeriesView(
            name=lateness_title,
            contents="/loop/**",
            axis_x=LINKED_TIME_AXIS,
            time_ranges=time_ranges,
            plot_legend=NO_LEGEND,
        ),
        rrb.TimeSeriesView(
            name="Bus load, 0.1 s [%]",
            contents="/bus/**",
            axis_x=LINKED_TIME_AXIS,
            time_ranges=time_ranges,
            axis_y=rrb.ScalarAxis(range=(0.0, 105.0)),
        ),
    )


def _log_view() -> rrb.TextLogView:
    """Return the view of the log lines."""
    return rrb.TextLogView(
        name="Log",
        contents="/rosout",
        columns=rrb.TextLogColumns(
            timeline_columns=[RUN_TIME_TIMELINE], text_log_columns=["loglevel", "body"]
        ),
    )
