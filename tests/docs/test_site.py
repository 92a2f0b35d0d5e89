"""Test that the documentation site builds without network access and without warnings.

The pages of the site load nothing from other servers.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

REPOSITORY_ROOT = Path(__file__).parents[2]
EXTERNAL_RESOURCE_PATTERN = re.compile(
    r"<(?:script|img|iframe)[^>]*src=\"https?:[^\"]+|<link[^>]*rel=\"stylesheet\"[^>]*https?:[^\"]+"
)
"""Pattern of HTML elements whose content a browser would load from another server."""


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    words = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--quiet",
        "--strict",
        "--site-dir",
        str(tmp_path / "site"),
    ]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "http_proxy": "http://127.0.0.1:9"}
    build_process = subprocess.run(
        words, cwd=REPOSITORY_ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert build_process.returncode == 0, build_process.stderr
    assert build_process.stderr == ""
    page_paths = sorted((tmp_path / "site").rglob("*.html"))
    assert (
        len(page_paths) == len(list((REPOSITORY_ROOT / "docs").rglob("*.md"))) + 1
    )  # the site has one page more than the documents: the error page 404.html
    texts = [page.read_text(encoding="utf-8") for page in page_paths]
    assert [match[0] for text in texts for match in EXTERNAL_RESOURCE_PATTERN.finditer(text)] == []
    # If there is no empty line before a list, the list becomes a part of the paragraph above.
    paragraphs = [
        paragraph for text in texts for paragraph in re.findall(r"<p>(.*?)</p>", text, re.DOTALL)
    ]
    assert [
        paragraph[-200:]
        for paragraph in paragraphs
        if re.search(r"^(- |\d+\. |\|)", paragraph, re.MULTILINE)
    ] == []
