"""Test the page about the paper.

The Markdown page about the paper is up to date, the JSON result of ``handctl paper`` follows its
schema, and the HTML page needs no other file.
"""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from handctl.cli.main import main
from handctl.paper import page, sections
from handctl.paper.bench import experiments, payload
from handctl.paper.errata_item import ErrataVerdict

REPOSITORY_ROOT = Path(__file__).parents[2]
PAGE_FILE = REPOSITORY_ROOT / "docs" / "evidence" / "paper.md"


RESULTS_FILE = REPOSITORY_ROOT / "docs" / "evidence" / "paper-results.json"


def test_the_page_in_the_repository_is_the_generator_s(capsys: pytest.CaptureFixture[str]) -> None:
    """Every line of the stored page equals the same line of the generated page, even a line with measured values.

    If this test fails, regenerate the page with the command in the text of
    ``docs/evidence/paper.md``.
    """
    assert main(["paper", "--markdown", "--results", str(RESULTS_FILE)]) == 0
    assert (
        PAGE_FILE.read_text(encoding="utf-8").splitlines() == capsys.readouterr().out.splitlines()
    )


EMPTY_RESULTS = '{"payload": [], "force_displacement": {"ropes": []}}'


@pytest.mark.parametrize("results_text", ["", "{}", "[]", EMPTY_RESULTS, "[" * 9999])
def test_a_file_without_results_is_refused_in_a_line(
    results_text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "results.json"
    path.write_text(results_text)
    assert main(["paper", "--results", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "results.json" in error


def test_results_are_stored_with_six_significant_digits() -> None:
    rounded_results = experiments.rounded_results(
        {"a": [1.23456789, 7], "b": {"c": (0.000123456789, "x")}}
    )
    assert rounded_results == {"a": [1.23457, 7], "b": {"c": [0.000123457, "x"]}}


def test_page_has_every_measured_result(measured_results: dict[str, Any]) -> None:
    text = PAGE_FILE.read_text(encoding="utf-8")
    assert text.count(page.MEASURED_IN_SIMULATOR_COMMENT) == 2
    for item in sections.page_errata(measured_results):
        assert f"| {item.id} | " in text, item.id
    rows = re.findall(
        r"^\| (payload\.\w\.d\d+) \|.*\| ([\d.]+) kg(?: or more)? \| \*\*(\w+)\*\*",
        text,
        re.MULTILINE,
    )
    assert len(rows) == len(payload.DIAMETERS_MM) * len(payload.LOAD_DIRECTIONS)
    for _, carried_value, verdict in rows:
        assert 0.5 < float(carried_value) < 3.0
        assert verdict == (
            "bound"
            if float(carried_value) > 0.9155
            else "wrong"
            if float(carried_value) < 0.9145
            else "equal"
        )


def test_every_figure_of_the_page_exists(measured_results: dict[str, Any]) -> None:
    text = PAGE_FILE.read_text(encoding="utf-8")
    figure_names = re.findall(r"\]\((\.\./figures/paper-[\w-]+\.png)\)", text)
    assert len(figure_names) == len(set(figure_names)) == len(page.FIGURE_CAPTIONS)
    for name in figure_names:
        assert (PAGE_FILE.parent / name).stat().st_size > 20_000
        assert (PAGE_FILE.parent / name).with_suffix(".svg").is_file()


def test_markdown_tables_have_the_same_columns_everywhere(measured_results: dict[str, Any]) -> None:
    for line in page.page_as_markdown(sections.page_sections(measured_results)).splitlines():
        if line.startswith("| ") and " | **" in line:
            assert len(re.findall(r"(?<!\\)\|", line)) == 7, line


def test_json_is_a_list_of_items(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "--quick", "--json"]) == 0
    errata_items = json.loads(capsys.readouterr().out)
    assert isinstance(errata_items, list)
    assert len(errata_items) > 70
    for item in errata_items:
        assert item.keys() == {
            "id", "where", "printed", "computed", "unit", "verdict", "why", "evidence", "deviation",
        }  # fmt: skip
        assert re.fullmatch(r"[a-z0-9-]+\.\w+(\.\w+)?", item["id"]), item["id"]
        assert item["verdict"] in set(ErrataVerdict)
        assert isinstance(item["computed"], int | float | str | None)
        assert all(isinstance(item[key], str) for key in ("where", "printed", "unit", "why"))
        assert all(isinstance(evidence_text, str) for evidence_text in item["evidence"])
    expected_verdicts = set(ErrataVerdict) - {ErrataVerdict.LOWER_BOUND}
    assert {item["verdict"] for item in errata_items} == {
        verdict.value for verdict in expected_verdicts
    }
    wire = next(item for item in errata_items if item["id"] == "sec5.wire")
    assert wire["computed"] == 0.8585678096656324


def test_measured_items_are_judged_by_what_was_measured(measured_results: dict[str, Any]) -> None:
    item_by_id = {item.id: item for item in sections.page_errata(measured_results)}
    assert item_by_id["payload.z.d30"].verdict == ErrataVerdict.WRONG
    assert item_by_id["payload.z.d35"].verdict == ErrataVerdict.LOWER_BOUND
    assert item_by_id["payload.z.d40"].unit == "kg or more"
    assert "still held" in item_by_id["payload.z.d40"].why
    assert item_by_id["fig5.measured200"].computed == pytest.approx(200.0, abs=3.0)
    assert item_by_id["fig5.measured250"].computed is None
    assert "none up to" in item_by_id["fig5.measured250"].why


def test_html_page_loads_no_other_file(
    measured_results: dict[str, Any], drawn_figure_files: dict[str, Path]
) -> None:
    text = page.page_as_html(sections.page_sections(measured_results), drawn_figure_files)
    assert text.count("data:image/svg+xml;base64,") == len(page.FIGURE_CAPTIONS)
    links = re.findall(r"(?:src|href)=\"([^\"]{0,40})", text)
    assert all(link.startswith("data:") for link in links)
    for item in sections.page_errata(measured_results):
        assert f"<td>{item.id}</td>" in text
    assert "<script" not in text


def test_files_are_written_where_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report, export = tmp_path / "out.html", tmp_path / "export"
    assert main(["paper", "--quick", "--output", str(report), "--export", str(export)]) == 0
    shown_text = capsys.readouterr().out
    assert "wrong" in shown_text
    assert report.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert {path.name for path in export.iterdir()} == {"jamia.urdf", "jamia.xml"}


@pytest.mark.parametrize(
    "paper_options",
    [["--output", "/no/such/folder/x.html"], ["--figures", __file__], ["--jobs", "0"]],
)
def test_bad_arguments_are_one_line_before_any_work(
    paper_options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["paper", *paper_options]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "expected" in error
