"""Write the page ``docs/evidence/control.md``. Each benchmark writes one part of ``control.md``."""

from pathlib import Path

REPOSITORY_ROOT = Path(__file__).resolve().parents[2]
PAGE_FILE = REPOSITORY_ROOT / "docs" / "evidence" / "control.md"
FIGURES_FOLDER = REPOSITORY_ROOT / "docs" / "figures"
PAGE_HEAD = """# Benefit of each part of the controller

This page shows how much each part of the filter and of the control law reduces the errors of the simulated hand. Each
section was written by a benchmark, and names the command that runs this benchmark. The benchmarks run the controller in
lockstep with simulated drives and a simulated hand, which is also called the *plant*. All errors are differences from
the true values of the plant.

Nothing on this page was measured on hardware. The objects and the physical effects of the plant are fixed in the
benchmarks, and were not changed to improve a result. Results that are weak or negative are stated as well.
"""
PAGE_PART_ORDER = ("estimation", "tracking", "gravity", "force", "tip", "grasps")


def write_page_part(part_name: str, part_text: str) -> None:
    """Replace one part of ``docs/evidence/control.md`` by a Markdown text, and keep all other parts."""
    text_by_part = _page_parts(PAGE_FILE.read_text("utf-8")) if PAGE_FILE.exists() else {}
    text_by_part[part_name] = part_text.strip()
    ordered_parts = sorted(
        text_by_part,
        key=lambda name: (
            PAGE_PART_ORDER.index(name) if name in PAGE_PART_ORDER else len(PAGE_PART_ORDER)
        ),
    )
    blocks = [
        f"<!-- {name} -->\n{text_by_part[name]}\n<!-- end of {name} -->\n" for name in ordered_parts
    ]
    PAGE_FILE.write_text("\n".join([PAGE_HEAD, *blocks]), "utf-8")


def _page_parts(page_text: str) -> dict[str, str]:
    """Split the text of the page into its parts, and return the text of each part by its name."""
    text_by_part = {}
    for block in page_text.split("<!-- end of ")[:-1]:
        name, _, body = block.rpartition("<!-- ")[2].partition(" -->")
        text_by_part[name] = body.strip()
    return text_by_part


def markdown_table(column_titles: list[str], rows: list[list[str]]) -> str:
    """Format a Markdown table."""
    lines = [column_titles, ["---"] + ["---:"] * (len(column_titles) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
