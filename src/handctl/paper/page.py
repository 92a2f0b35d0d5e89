"""The page about the paper, in three forms: Markdown, an HTML file with the figures, and JSON values."""

import base64
import html
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from handctl.paper.errata_item import ErrataItem
from handctl.paper.sections import (
    INTRODUCTION_TEXT,
    PAGE_TITLE,
    PAPER_CITATION,
    PageSection,
    count_by_verdict,
)

FIGURES_FOLDER = "../figures"
"""Folder of the figures, relative to the folder of the Markdown page."""
FIGURE_FILE_PREFIX = "paper-"
"""Prefix of the names of the figure files."""
REGENERATE_COMMAND = (
    "handctl paper --markdown --figures docs/figures --results docs/evidence/paper-results.json"
)
"""Command that generates the page again."""
MEASURED_IN_SIMULATOR_COMMENT = (
    "<!-- measured in the simulator: differs in its last digits from machine to machine -->"
)
"""Comment before each section of the page whose content differs from machine to machine."""
FIGURE_CAPTIONS = {
    "fig1-hand": "Fig. 1: the hand from its description, half closed.",
    "fig2-model": "Fig. 2: kinematic model of a finger, with relative angles q and absolute angles θ.",
    "fig3-path": "Fig. 3: path of the tip (Eq. 1-2) and workspace, finger and thumb.",
    "fig4-statics": "Fig. 4 and 6: moments of a tip force, and moments of one tendon.",
    "fig5-force-displacement": "Fig. 5: measured curve of the tendon, with both printed knees and the stress limit.",
    "fig7-torques": "Fig. 7: torque of closing a digit by 60° per joint, by cause, at three speeds.",
    "fig7-eq10": "Eq. 10 as printed and corrected, for a closing finger.",
    "fig8-payload": "Payload along each axis for three cylinders, with the paper's formula and the friction bounds.",
}
"""Caption of each figure."""


def items_as_json(items: Sequence[ErrataItem]) -> list[dict[str, Any]]:
    """Return errata items as plain values for JSON."""
    return [
        {**asdict(item), "verdict": item.verdict.value, "evidence": list(item.evidence)}
        for item in items
    ]


def value_text(item: ErrataItem) -> str:
    """Return the correct value of an errata item as text.

    The text is a number with seven significant digits and the unit, or an expression.
    """
    if item.computed is None:
        return "—"
    text = item.computed if isinstance(item.computed, str) else f"{item.computed:.7g}"
    return f"{text} {item.unit}".rstrip()


def page_as_markdown(page_sections: Sequence[PageSection]) -> str:
    """Return the page as Markdown. The page refers to figures in the folder `FIGURES_FOLDER`."""
    rows = [item for section in page_sections for item in section.items]
    lines = [
        f"# {PAGE_TITLE}",
        "",
        _wrap_paragraph(PAPER_CITATION),
        "",
        _wrap_paragraph(INTRODUCTION_TEXT),
        "",
        _wrap_paragraph(_summary_text(rows)),
        "",
    ]
    for section in page_sections:
        lines += [MEASURED_IN_SIMULATOR_COMMENT] if section.measured else []
        lines += [f"## {section.title}", ""]
        for paragraph in section.text:
            lines += [_wrap_paragraph(paragraph), ""]
        for name in section.figures:
            lines += [
                f"![{FIGURE_CAPTIONS[name]}]({FIGURES_FOLDER}/{FIGURE_FILE_PREFIX}{name}.png)",
                "",
                f"*{FIGURE_CAPTIONS[name]}*",
                "",
            ]
        lines += _markdown_table(section.table)
        lines += ["| id | where | printed | right | verdict | why |", "|---|---|---|---|---|---|"]
        lines += [
            "| " + " | ".join(map(_escape_cell, _item_cells(item))) + " |" for item in section.items
        ]
        lines += [""]
    return "\n".join(lines)


def _markdown_table(number_table: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table of numbers as Markdown.

    The first line contains the titles of the columns. For an empty table, the result is empty.
    """
    if not number_table:
        return []
    titles, *rows = ("| " + " | ".join(row) + " |" for row in number_table)
    return [titles, "|" + "---|" * len(number_table[0]), *rows, ""]


def _summary_text(errata_items: list[ErrataItem]) -> str:
    """Return a text with the number of errata items for each verdict, and with the command that generates the page."""
    counts = ", ".join(
        f"{count} {verdict}" for verdict, count in count_by_verdict(errata_items).items()
    )
    return (
        f"Of {len(errata_items)} items: {counts}. The verdict `bound` means that the paper states a lower bound and a "
        f"larger value was reached. Regenerate this page with `{REGENERATE_COMMAND}`. "
        "Without the file of results the experiments run again."
    )


def _item_cells(item: ErrataItem) -> tuple[str, ...]:
    """Return the cells of the table row that describes an errata item."""
    off = (
        f" (deviation {item.deviation:.2g})"
        if item.deviation is not None and item.verdict != "equal"
        else ""
    )
    return (
        item.id,
        item.where,
        item.printed,
        value_text(item),
        f"**{item.verdict.value}**",
        item.why + off,
    )


def _escape_cell(text: str) -> str:
    """Return a cell of a table with the special characters of Markdown escaped.

    A bold cell is returned unchanged.
    """
    return text.replace("|", "\\|").replace("*", "\\*") if not text.startswith("**") else text


def _wrap_paragraph(paragraph: str) -> str:
    """Wrap a paragraph to lines of at most 118 characters."""
    return textwrap.fill(paragraph, 118, break_long_words=False, break_on_hyphens=False)


PAGE_STYLE = """
:root { color-scheme: light dark; --line: #8884; --soft: #8881; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.9rem; margin-bottom: .2rem } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line) }
table { border-collapse: collapse; width: 100%; font-size: .88rem } .wide { overflow-x: auto }
th, td { text-align: left; vertical-align: top; padding: .35rem .5rem; border-bottom: 1px solid var(--line) }
th { position: sticky; top: 0; background: Canvas } td:first-child { font-family: ui-monospace, monospace }
figure { margin: 1.5rem 0 } figure img { max-width: 100%; background: #fff; border-radius: 6px }
figcaption { font-size: .88rem; opacity: .75 }
.verdict { border-radius: 1rem; padding: .05rem .6rem; font-weight: 600; white-space: nowrap; color: #fff }
.equal { background: #2e7d4f } .rounded { background: #3b6fb6 } .truncated { background: #7a5fb5 }
.bound { background: #4d8f7a } .wrong { background: #b8382e } .undecidable { background: #8a6d1f }
"""


def page_as_html(page_sections: Sequence[PageSection], figures: Mapping[str, Path]) -> str:
    """Return the page as one HTML file that also contains the figures.

    Args:
        page_sections: sections of the page.
        figures: path of the SVG file of each figure.
    """
    rows = [item for section in page_sections for item in section.items]
    counts = " ".join(
        f"{_html_badge(verdict)} {count}" for verdict, count in count_by_verdict(rows).items()
    )
    body = [
        f"<h1>{PAGE_TITLE}</h1><p>{html.escape(PAPER_CITATION)}</p><p>{html.escape(INTRODUCTION_TEXT)}</p><p>{counts}</p>"
    ]
    for section in page_sections:
        body.append(f"<h2>{html.escape(section.title)}</h2>")
        body += [f"<p>{_html_paragraph(paragraph)}</p>" for paragraph in section.text]
        body += [_html_figure(name, figures[name]) for name in section.figures]
        body += [_html_numbers(section.table)] if section.table else []
        body.append(_html_items(section.items))
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{PAGE_TITLE}</title>'
    head = f'<!doctype html>\n<html lang="en"><head>{head}<style>{PAGE_STYLE}</style></head>'
    return f"{head}<body>{''.join(body)}</body></html>\n"


def _html_badge(verdict: str) -> str:
    """Return a verdict as a coloured label in HTML."""
    return f'<span class="verdict {verdict}">{verdict}</span>'


def _html_paragraph(paragraph: str) -> str:
    """Return a paragraph as HTML, where the code in backquotes is marked as code."""
    # If the paragraph is split at the backquotes, every second piece of text is code.
    text_parts = html.escape(paragraph).split("`")
    return "".join(
        f"<code>{text_part}</code>" if i % 2 else text_part
        for i, text_part in enumerate(text_parts)
    )


def _html_figure(name: str, path: Path) -> str:
    """Return a figure as HTML."""
    data = base64.b64encode(path.read_bytes()).decode()
    caption = html.escape(FIGURE_CAPTIONS[name])
    image = f'<img alt="{caption}" src="data:image/svg+xml;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def _html_numbers(number_table: Sequence[Sequence[str]]) -> str:
    """Return a table of numbers as HTML.

    The first row of the table contains the titles of the columns.
    """
    # The first row of the table contains the titles of the columns. The code below makes these
    # titles header cells.
    titles, *rows = (
        "".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in number_table
    )
    head = titles.replace("td>", "th>")
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _html_items(items: Sequence[ErrataItem]) -> str:
    """Return a table of errata items as HTML."""
    titles = "".join(
        f"<th>{name}</th>" for name in ("id", "where", "printed", "right", "verdict", "why")
    )
    rows = []
    for item in items:
        id, where, printed, corrected, _, reason = map(html.escape, _item_cells(item))
        cells = (id, where, printed, corrected, _html_badge(item.verdict.value), reason)
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return f'<div class="wide"><table><thead><tr>{titles}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
