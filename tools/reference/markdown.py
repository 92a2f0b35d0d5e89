"""Convert tables and google-style docstrings to Markdown."""

import ast
import html
import inspect
import re
import textwrap
from collections.abc import Iterable, Sequence

SECTION_PATTERN = re.compile(r"^(Args|Returns|Raises|Attributes|Source):\s*$|^(Source): (.*)$")
"""Pattern of the heading of a section in a docstring."""
ENTRY_PATTERN = re.compile(r"^    (\*{0,2}[\w, ]+): (.*)$")
"""Pattern of the first line of an entry for an argument or an exception in a docstring."""


def table_cell(text: object) -> str:
    """Return a text as the content of a cell in a Markdown table.

    Code with a vertical bar is written in HTML. In a Markdown table, the bar would need a
    backslash, and the page would show the backslash.
    """
    plain = " ".join(str(text).split())
    return re.sub(r"`([^`]*\|[^`]*)`", _code_with_bars, plain).replace("|", "\\|")


def _code_with_bars(match: re.Match[str]) -> str:
    """Return quoted code as HTML. A character reference replaces each vertical bar."""
    return "<code>" + html.escape(match[1], quote=False).replace("|", "&#124;") + "</code>"


def quoted_code(text: object) -> str:
    """Return a text as quoted code.

    Before the result is put into a table, ``table_cell`` must escape it.
    """
    return "`" + " ".join(str(text).split()) + "`"


def markdown_table(column_titles: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table of a head and rows."""
    lines = [
        column_titles,
        ["---"] * len(column_titles),
        *([table_cell(value) for value in row] for row in rows),
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def prose_markdown(text: str | None) -> str:
    """Return a docstring as Markdown prose. Each double backquote becomes a single backquote."""
    return inspect.cleandoc(text or "").replace("``", "`")


def docstring_markdown(value: object) -> str:
    """Return the docstring of an object as Markdown, with lists for its arguments, results and errors."""
    lines: list[str] = []
    listing = False
    for line in inspect.cleandoc(inspect.getdoc(value) or "").splitlines():
        if match := SECTION_PATTERN.match(line):
            listing = True
            lines += ["", f"**{match[1] or match[2]}:** {match[3] or ''}".rstrip(), ""]
        elif listing and (entry := ENTRY_PATTERN.match(line)):
            lines.append(f"- `{entry[1]}`: {entry[2]}")
        elif line and not line.startswith(" "):
            listing = False
            lines.append(line)
        else:
            lines.append(
                f"  {line.strip()}"
                if line.strip() and lines and lines[-1].startswith("- ")
                else line.strip()
            )
    return re.sub(r"\n{3,}", "\n\n", prose_markdown("\n".join(lines))).strip()


def attribute_docstrings(class_type: type) -> dict[str, str]:
    """Return a dictionary from each attribute of a class to the docstring below it.

    The docstrings are converted to Markdown prose.
    """
    body = ast.parse(textwrap.dedent(inspect.getsource(class_type))).body[0]
    assert isinstance(body, ast.ClassDef)
    texts: dict[str, str] = {}
    name = ""
    for node in body.body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                continue
            case ast.Expr(value=ast.Constant(value=str(text))) if name:
                texts[name] = prose_markdown(text)
    return texts
