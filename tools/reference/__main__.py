"""Write the generated blocks in docs/ and the JSON Schema of hand files: ``python -m tools.reference [--check]``."""

import argparse
import sys
from pathlib import Path

from handctl.hand.file.json_schema import hand_schema_text
from tools.reference.blocks import stale_pages, written_pages

REPOSITORY_ROOT = Path(__file__).parents[2]
SCHEMA_FILE = REPOSITORY_ROOT / "src" / "handctl" / "hand" / "hand.schema.json"
"""Path of the JSON Schema of hand files. Editors use this schema."""


def main() -> int:
    """Write or check the generated pages and the JSON Schema. Return the exit code."""
    parser = argparse.ArgumentParser(
        description="Write the generated blocks of the pages in docs/."
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing, and return 1 if a page is stale"
    )
    if parser.parse_args().check:
        outdated_pages = [*stale_pages(REPOSITORY_ROOT)]
        if SCHEMA_FILE.read_text("utf-8") != hand_schema_text():
            outdated_pages.append(str(SCHEMA_FILE.relative_to(REPOSITORY_ROOT)))
        for page in outdated_pages:
            print(f"{page}: stale; run python -m tools.reference", file=sys.stderr)
        return 1 if outdated_pages else 0
    for page in written_pages(REPOSITORY_ROOT):
        print(page)
    if SCHEMA_FILE.read_text("utf-8") != hand_schema_text():
        SCHEMA_FILE.write_text(hand_schema_text(), "utf-8")
        print(SCHEMA_FILE.relative_to(REPOSITORY_ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
