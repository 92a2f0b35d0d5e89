"""Change the site search through a hook of mkdocs.

Pages that answer questions get a higher rank in the search. The search excludes one page.
"""

from typing import Any

SEARCH_BOOSTS = {
    "how-to/stop.md": 10.0, "how-to/why-a-run-ended.md": 3.0, "how-to/adapters.md": 3.0, "reference/topics.md": 4.0,
    "reference/faults.md": 3.0, "how-to/adding-a-drive.md": 2.0, "how-to/other-tools.md": 3.0,
}  # fmt: skip
"""Factor that multiplies the search score of a page, by the path of the page."""
EXCLUDED_PAGES = ("evidence/lookups.md",)
"""Pages that the search leaves out, because they quote questions without the answers."""


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Set the rank of a page in the site search.

    The front matter of a page could also set the rank. However, GitHub would show the front matter
    to readers.
    """
    path = page.file.src_uri
    if path in SEARCH_BOOSTS:
        page.meta.setdefault("search", {"boost": SEARCH_BOOSTS[path]})
    if path in EXCLUDED_PAGES:
        page.meta.setdefault("search", {"exclude": True})
    return markdown
