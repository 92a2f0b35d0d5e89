"""Test that every link in the documents leads to an existing page and heading.

The navigation of the site contains every page.
"""

import re
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
import yaml

REPOSITORY_ROOT = Path(__file__).parents[2]
DOCS_FOLDER = REPOSITORY_ROOT / "docs"
DOCUMENTS = sorted([*REPOSITORY_ROOT.glob("*.md"), *DOCS_FOLDER.rglob("*.md")])
CODE_PATTERN = re.compile(r"^```.*?^```$|``.*?``|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK_PATTERN = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")


def heading_anchors(document_path: Path) -> set[str]:
    """Return the anchors of a document's headings."""
    headings = re.findall(
        r"^#+ (.*)$",
        re.sub(r"^```.*?^```$", "", document_path.read_text(), flags=re.M | re.S),
        re.MULTILINE,
    )
    plain = (
        re.sub(r"[^\w\s-]", "", heading.replace("`", "")).strip().lower() for heading in headings
    )
    return {re.sub(r"[\s-]+", "-", text) for text in plain}


@pytest.mark.parametrize(
    "path", DOCUMENTS, ids=lambda path: path.relative_to(REPOSITORY_ROOT).as_posix()
)
def test_every_link_leads_somewhere(path: Path) -> None:
    dead_links = []
    for match in LINK_PATTERN.finditer(CODE_PATTERN.sub("", path.read_text(encoding="utf-8"))):
        name, _, anchor = (match[1] or match[2]).partition("#")
        if re.match(r"[a-z]+:", name):
            continue
        target = path.parent / name if name else path
        if not target.exists() or (anchor and anchor not in heading_anchors(target)):
            dead_links.append(match[1])
    assert dead_links == []


def navigation_pages(navigation_entry: Any) -> list[str]:
    """Return all pages in a part of the site's navigation."""
    if isinstance(navigation_entry, str):
        return [navigation_entry]
    nested_entries = (
        navigation_entry.values() if isinstance(navigation_entry, dict) else navigation_entry
    )
    return [page for entry in nested_entries for page in navigation_pages(entry)]


def navigation_titles(navigation_entry: Any) -> dict[str, str]:
    """Return the title of each page in a part of the site's navigation, except for pages without a title."""
    if isinstance(navigation_entry, str):
        return {}
    if isinstance(navigation_entry, list):
        return {
            page: title
            for inner_entry in navigation_entry
            for page, title in navigation_titles(inner_entry).items()
        }
    title_by_page = {
        value: key for key, value in navigation_entry.items() if isinstance(value, str)
    }
    return title_by_page | {
        page: title
        for inner_entry in navigation_entry.values()
        for page, title in navigation_titles(inner_entry).items()
    }


def test_a_page_has_the_same_title_everywhere() -> None:
    title_by_page = navigation_titles(
        yaml.safe_load((REPOSITORY_ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    )
    assert len(set(title_by_page.values())) == len(title_by_page)
    for page, title in title_by_page.items():
        assert (
            re.findall(r"^# (.*)$", (DOCS_FOLDER / page).read_text(encoding="utf-8"), re.MULTILINE)[
                0
            ]
            == title
        ), page
    for index in DOCS_FOLDER.glob("*/index.md"):
        rows = re.findall(
            r"^\|.*\[([^\]]+)\]\(([\w-]+\.md)\)", index.read_text(encoding="utf-8"), re.MULTILINE
        )
        title_by_linked_page = {f"{index.parent.name}/{page}": title for title, page in rows}
        assert title_by_linked_page == {page: title_by_page[page] for page in title_by_linked_page}
        assert set(title_by_linked_page) == {
            page for page in title_by_page if page.startswith(f"{index.parent.name}/")
        }


def test_every_page_is_in_the_navigation_once() -> None:
    settings = yaml.safe_load((REPOSITORY_ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    listed_pages = navigation_pages(settings["nav"])
    unlisted_page_patterns = settings["not_in_nav"].split()
    pages = {path.relative_to(DOCS_FOLDER).as_posix() for path in DOCS_FOLDER.rglob("*.md")}
    assert len(set(listed_pages)) == len(listed_pages)
    assert set(listed_pages) <= pages
    unlisted_pages = {
        page
        for page in pages - set(listed_pages)
        if not any(fnmatch(f"/{page}", page_pattern) for page_pattern in unlisted_page_patterns)
    }
    assert unlisted_pages == set()
