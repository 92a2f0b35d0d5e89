"""The site is built without the network, a warning is an error, and no page fetches from elsewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FETCHED = re.compile(r"<(?:script|img|iframe)[^>]*src=\"https?:[^\"]+|<link[^>]*rel=\"stylesheet\"[^>]*https?:[^\"]+")
"""Elements that a browser would fetch from another host."""


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "http_proxy": "http://127.0.0.1:9"}
    built = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert built.stderr == ""
    made = sorted((tmp_path / "site").rglob("*.html"))
    assert len(made) == len(list((ROOT / "docs").rglob("*.md"))) + 1  # and the page of a wrong address
    fetched = [match[0] for page in made for match in FETCHED.finditer(page.read_text(encoding="utf-8"))]
    assert fetched == []
