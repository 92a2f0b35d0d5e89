"""Hook of mkdocs: pages with answers are first in the search, and the search page is left out."""

from typing import Any

BOOST = {
    "how-to/stop.md": 10.0, "how-to/why-a-run-ended.md": 3.0, "how-to/adapters.md": 3.0, "reference/topics.md": 4.0,
    "reference/faults.md": 3.0, "how-to/adding-a-drive.md": 2.0, "how-to/other-tools.md": 3.0,
}  # fmt: skip
"""Factor of a page's score in the search."""
EXCLUDED = ("evidence/lookups.md",)
"""Pages that the search leaves out, because they quote questions without answering them."""


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Set the rank of a page. Front matter in the page could do the same, but GitHub would show it."""
    path = page.file.src_uri
    if path in BOOST:
        page.meta.setdefault("search", {"boost": BOOST[path]})
    if path in EXCLUDED:
        page.meta.setdefault("search", {"exclude": True})
    return markdown
