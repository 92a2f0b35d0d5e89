"""Test that each figure contains the version of handctl, is shown on a page, and is small enough."""

import re
from pathlib import Path

import pytest

from tools.figures.__main__ import DIAGRAMS, PICTURES, PLOTS
from tools.figures.gif import MAX_FILE_BYTES
from tools.figures.style import CREATOR_TEXT, FIGURES_FOLDER, drawn_by

REPOSITORY_ROOT = Path(__file__).parents[2]
FIGURE_FILES = sorted([f"{name}.{kind}" for name in (*DIAGRAMS, *PLOTS) for kind in ("svg", "png")]
              + [f"{name}.png" for name in PICTURES] + ["grasp.gif"]
              + [path.name for path in FIGURES_FOLDER.glob("paper-*")])  # fmt: skip
PAGE_TEXTS = [
    path.read_text(encoding="utf-8")
    for path in (REPOSITORY_ROOT / "README.md", *(REPOSITORY_ROOT / "docs").rglob("*.md"))
]
MAX_FIGURE_BYTES = 700_000
"""Largest size of a figure that is not animated [bytes]."""


@pytest.mark.parametrize("figure_name", FIGURE_FILES)
def test_a_figure_is_of_this_version(figure_name: str) -> None:
    assert drawn_by(FIGURES_FOLDER / figure_name) == CREATOR_TEXT, "run make figures"


@pytest.mark.parametrize("figure_name", FIGURE_FILES)
def test_a_figure_is_small_and_used(figure_name: str) -> None:
    assert (FIGURES_FOLDER / figure_name).stat().st_size < (
        MAX_FILE_BYTES if figure_name.endswith(".gif") else MAX_FIGURE_BYTES
    )
    base_name = figure_name.partition(".")[0]
    assert any(re.search(rf"figures/{base_name}\.(svg|png|gif)", text) for text in PAGE_TEXTS)


def test_every_figure_in_the_folder_is_used() -> None:
    unused_figures = [
        path.name
        for path in FIGURES_FOLDER.iterdir()
        if not any(path.stem in text for text in PAGE_TEXTS)
    ]
    assert unused_figures == []
