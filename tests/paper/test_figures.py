"""Test the pictures that ``handctl paper`` draws of the source paper's results.

No figure is empty, the axes of each figure have names, and the figures mark the numbers that the
paper prints.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from handctl.paper import page
from handctl.paper.figures.all_figures import figure_contents
from handctl.paper.model import kinematics


@pytest.fixture
def figures_folder(drawn_figure_files: dict[str, Path]) -> Path:
    assert drawn_figure_files.keys() == page.FIGURE_CAPTIONS.keys()
    return drawn_figure_files["fig1-hand"].parent


@pytest.mark.parametrize("figure_name", list(page.FIGURE_CAPTIONS))
def test_pictures_have_content_and_full_resolution(figures_folder: Path, figure_name: str) -> None:
    picture = imread(figures_folder / f"paper-{figure_name}.png")[..., :3]
    height, width, _ = picture.shape
    assert width > 1100
    assert height > 500
    is_drawn = (picture < 0.9).any(axis=2)
    assert 0.01 < is_drawn.mean() < 0.6
    assert is_drawn[:, : width // 2].mean() > 0.005
    assert is_drawn[:, width // 2 :].mean() > 0.005
    assert len(np.unique((picture * 15).astype(int).reshape(-1, 3), axis=0)) > 30, (
        "the picture has more than 30 colours"
    )


@pytest.mark.parametrize("figure_name", list(page.FIGURE_CAPTIONS))
def test_nothing_is_drawn_outside_of_the_picture(figures_folder: Path, figure_name: str) -> None:
    """The border of a picture has no dark pixels.

    A text that extends beyond the picture would make pixels at the border dark.
    """
    picture = imread(figures_folder / f"paper-{figure_name}.png")[..., :3]
    frame = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert frame.min() > 0.99


@pytest.mark.parametrize("figure_name", list(page.FIGURE_CAPTIONS))
def test_svg_is_the_same_each_time_and_names_no_place(
    figures_folder: Path, figure_name: str
) -> None:
    text = (figures_folder / f"paper-{figure_name}.svg").read_text(encoding="utf-8")
    assert "<dc:date>" not in text
    assert not re.search(r"/(home|tmp|work)/", text)
    assert text.count("<path") > 20


def test_units_and_printed_values_are_in_the_figures(figures_folder: Path) -> None:
    """The test reads the texts from the comments of the SVG, because matplotlib draws the texts as paths."""
    expected = {
        "fig2-model": ["X [mm]", "L₁ = 30 mm", "L₃ = 10 mm", "palm"],
        "fig3-path": ["X [mm]", "Y [mm]", "55 mm"],
        "fig4-statics": ["55F", "25F", "10F", "T = 18.33F"],
        "fig5-force-displacement": [
            "displacement of the tendon at the spool [mm]",
            "200 N",
            "250 N",
            "190 MPa",
        ],
        "fig7-torques": [
            "torque [mN m]",
            "tension [N]",
            "inertia",
            "Coriolis",
            "gravity",
            "springs",
            "motor inertia",
        ],
        "fig8-payload": ["payload [kg]", "0.915 kg", "1.835 kg"],
    }
    for name, texts in expected.items():
        drawn_text = (figures_folder / f"paper-{name}.svg").read_text(encoding="utf-8")
        for text in texts:
            assert text in drawn_text, (name, text)


def test_without_experiments_the_measured_figures_are_left_out() -> None:
    contents = figure_contents(None)
    assert page.FIGURE_CAPTIONS.keys() - contents.keys() == {
        "fig5-force-displacement",
        "fig8-payload",
    }


def test_the_path_lies_in_the_workspace_and_the_workspace_in_reach() -> None:
    for name, reach in (("index", 55.0), ("thumb", 25.0)):
        tips = kinematics.reachable_tips(name, 25)
        assert np.linalg.norm(tips, axis=1).max() == pytest.approx(reach)
        for path_point in kinematics.fingertip_path(name, np.radians(np.linspace(0.0, 100.0, 11))):
            assert np.linalg.norm(tips - path_point, axis=1).min() < 2.0
    first_fingertip_path = kinematics.fingertip_path("index", np.array([0.0, np.pi / 2]))
    assert first_fingertip_path == pytest.approx(np.array([[55.0, 0.0], [-15.0, 20.0]]), abs=1e-9)
