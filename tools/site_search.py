"""Change the site search through a hook of mkdocs.

The search ranks pages with answers first, and leaves one page out.
"""

from typing import Any

SEARCH_BOOSTS = {
    "how-to/stop.md": 10.0, "how-to/why-a-run-ended.md": 3.0, "how-to/adapters.md": 3.0, "reference/topics.md": 4.0,
    "reference/faults.md": 3.0, "how-to/adding-a-drive.md": 2.0, "how-to/other-tools.md": 3.0,
}  # fmt: skip
"""Factor that multiplies the search score of a page."""
EXCLUDED_PAGES = ("evidence/lookups.md",)
"""Pages that the search leaves out, because they quote questions without the answers."""


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Set the rank of a page in the site search.

    Front matter at the start of a page could also set the rank of this page, but GitHub would show
    it.
    """
    path = page.file.src_uri
    if path in SEARCH_BOOSTS:
        page.meta.setdefault("search", {"boost": SEARCH_BOOSTS[path]})
    if path in EXCLUDED_PAGES:
        page.meta.setdefault("search", {"exclude": True})
    return markdown
