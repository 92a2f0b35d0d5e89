"""Count private words and hard phrases in names, docstrings and documents, and compare the counts with limits.

``python tools/language.py`` is a part of ``make lint``. The program prints a line for each count
above its limit and exits 1. ``--table`` prints all counts. ``--places COUNT FOLDER`` prints each
place that contributes to a count. ``--tighten`` lowers the limits in ``language_limits.toml`` to
the current counts. No option raises a limit. A private word is a word that only this project uses.
The counts are only a hint, and a reader must judge whether a sentence is plain.
"""

import argparse
import ast
import io
import re
import sys
import tokenize
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

REPOSITORY_ROOT = Path(__file__).parents[1]
LANGUAGE_TERMS = tomllib.loads(
    Path(__file__).with_name("language_terms.toml").read_text(encoding="utf-8")
)
LIMITS_FILE = Path(__file__).with_name("language_limits.toml")
COUNTED_FOLDERS = ("src", "firmware_sim", "tests", "benchmarks", "fuzz", "tools")
DOCUMENTS_NAME = "documents"
"""Name under which the program counts all Markdown files together."""

QUANTITY_PER_COUNT = {
    "names": ("name words", 1000),
    "openers": ("docstrings", 100),
    "what": ("words", 1000),
    "semicolons": ("words", 1000),
    "pronouns": ("words", 100),
    "riddles": ("words", 1000),
    "ropes": ("words", 1000),
    "tuples": ("lines", 1000),
    "long_lines": ("lines", 100),
    "repeated_classes": ("", 1),
}
"""For each count of words or phrases, the quantity by which it is divided, and a factor that multiplies the ratio.

The program does not divide a count without a quantity.
"""
LONG_LINE_CHARACTERS = 100
"""A source line with more characters than this constant counts as long."""
LIMITS_PER_UNIT = 2
"""Limits are multiples of 1 / LIMITS_PER_UNIT.

If the limits had finer steps, a single new sentence could exceed a limit.
"""

_WORD_PATTERN = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+")
_PROSE_PATTERNS = {
    name: re.compile(pattern, re.IGNORECASE) for name, pattern in LANGUAGE_TERMS["prose"].items()
}
_DOCSTRING_VERBS = set(LANGUAGE_TERMS["verbs"]["words"].split())
_CODE_PATTERN = re.compile(
    r"^```.*?^```|`[^`\n]*`|^\|.*?$|\*\*[^*\n]+:\*\*", re.MULTILINE | re.DOTALL
)
"""Pattern of the parts of a Markdown document that are no prose: code, rows of tables, and labels in bold."""


@dataclass
class FolderTally:
    """Counts of hard words and phrases in one folder.

    Attributes:
        counts: number of hard words and phrases for each key of ``QUANTITY_PER_COUNT``.
        totals: total number of each quantity in ``QUANTITY_PER_COUNT``, such as words. A ratio is a
            count divided by the total of the quantity.
        places: ``file:line: finding`` of each count.
    """

    counts: Counter[str] = field(default_factory=Counter)
    totals: Counter[str] = field(default_factory=Counter)
    places: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    def add(self, count_name: str, location: str, finding: str, times: int = 1) -> None:
        """Add findings (hard words or phrases) of one kind at one place of a file."""
        self.counts[count_name] += times
        if times:
            self.places[count_name].append(f"{location}: {finding}")

    def ratio(self, count_name: str) -> float:
        """Return how often a kind of finding occurs, for example per 1000 words.

        The constant ``QUANTITY_PER_COUNT`` contains the unit of each ratio.
        """
        quantity, factor = QUANTITY_PER_COUNT[count_name]
        return (
            factor * self.counts[count_name] / max(self.totals[quantity], 1)
            if quantity
            else self.counts[count_name]
        )


def count_prose(tally: FolderTally, text: str, location: str) -> None:
    """Count the words and the hard phrases of a docstring or document."""
    tally.totals["words"] += len(re.findall(r"[A-Za-z']+", text))
    for name, pattern in _PROSE_PATTERNS.items():
        matches = pattern.findall(text)
        tally.add(name, location, f"{len(matches)} in the text", len(matches))


def count_module(tally: FolderTally, tree: ast.Module, text: str, name: str) -> None:
    """Count hard words and phrases in the names, docstrings and lines of a module.

    Args:
        tally: counts of the folder, to which this function adds the findings.
        tree: parsed module.
        text: source of the module.
        name: path of the module, which the places of findings contain.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    tally.totals["lines"] += len(lines)
    for number, line in enumerate(text.splitlines(), 1):
        tally.add(
            "long_lines",
            f"{name}:{number}",
            f"{len(line)} characters",
            len(line) > LONG_LINE_CHARACTERS,
        )
    for node in ast.walk(tree):
        location = f"{name}:{getattr(node, 'lineno', 1)}"
        for defined in _defined_names(node):
            words = [word.lower() for word in _WORD_PATTERN.findall(defined)]
            tally.totals["name words"] += len(words)
            for word in words:
                tally.add(
                    "names",
                    location,
                    f"{defined}: say {LANGUAGE_TERMS['names'].get(word)}",
                    word in LANGUAGE_TERMS["names"],
                )
        tally.add("tuples", location, "assignments in parallel", _is_parallel(node))
        _count_docstring(tally, node, location)
    for text in _attribute_docs(tree):
        count_prose(tally, text, name)


def _defined_names(node: ast.AST) -> list[str]:
    """Return the names that a node of a syntax tree defines."""
    match node:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            return [name]
        case (
            ast.arg(arg=name)
            | ast.Name(id=name, ctx=ast.Store())
            | ast.Attribute(attr=name, ctx=ast.Store())
        ):
            return [name]
    return []


def _is_parallel(node: ast.AST) -> bool:
    """Return True for an assignment such as ``a, b = x, y``. Return False for a swap of two variables."""
    match node:
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
            return {ast.unparse(each) for each in targets} != {ast.unparse(each) for each in values}
    return False


def _count_docstring(tally: FolderTally, node: ast.AST, location: str) -> None:
    """Count hard words and phrases in the docstring of a module, class or function.

    Docstrings of functions must begin with a verb.
    """
    if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        return
    text = ast.get_docstring(node) or ""
    count_prose(tally, text, location)
    first_word = re.match(r"\W*([A-Za-z-]+)", text)
    if first_word and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        word = first_word[1].lower()
        tally.totals["docstrings"] += 1
        tally.add(
            "openers",
            location,
            f"begins with {word!r}",
            not {word, word.removesuffix("s")} & _DOCSTRING_VERBS,
        )


def _attribute_docs(tree: ast.Module) -> Iterator[str]:
    """Yield the documentation strings below constants and attributes."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for statement in body[1:] if isinstance(body, list) else ():
            match statement:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    yield text


def comments(text: str) -> int:
    """Return the number of comments in a module.

    Leave out comments that are directives for tools.
    """
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(
        token.type == tokenize.COMMENT and not re.search("noqa|type:|fmt:", token.string)
        for token in tokens
    )


def count_folder(folder: Path) -> FolderTally:
    """Count the hard words and phrases in all modules of a folder."""
    tally, classes = FolderTally(), defaultdict(list)
    for path in sorted(folder.rglob("*.py")):
        text, name = path.read_text(encoding="utf-8"), path.relative_to(folder.parent).as_posix()
        tree = ast.parse(text)
        count_module(tally, tree, text, name)
        tally.totals["comments"] += comments(text)
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                classes[node.name].append(name)
    for name, places in classes.items():
        tally.add(
            "repeated_classes",
            places[0],
            f"{name} is also in {', '.join(places[1:])}",
            len(places) > 1,
        )
    return tally


def count_documents(repository_folder: Path) -> FolderTally:
    """Count the hard words and phrases in the Markdown documents at the top of the project and in ``docs``."""
    tally = FolderTally()
    for path in sorted([*repository_folder.glob("*.md"), *repository_folder.glob("docs/**/*.md")]):
        count_prose(
            tally,
            _CODE_PATTERN.sub(" ", path.read_text(encoding="utf-8")),
            path.relative_to(repository_folder).as_posix(),
        )
    return tally


def count_all_folders(repository_folder: Path) -> dict[str, FolderTally]:
    """Count the hard words and phrases in every folder and in the documents."""
    folders = {
        name: count_folder(repository_folder / name)
        for name in COUNTED_FOLDERS
        if (repository_folder / name).is_dir()
    }
    return folders | {DOCUMENTS_NAME: count_documents(repository_folder)}


def count_ratios(tally: FolderTally) -> dict[str, float]:
    """Divide each count by its quantity, and return the ratios, rounded up to a multiple of one half.

    ``QUANTITY_PER_COUNT`` names the quantity of each count, such as the number of words. A count is
    left out if the quantity of the count is zero in the folder.
    """
    measured = [
        count
        for count, (quantity, _) in QUANTITY_PER_COUNT.items()
        if not quantity or tally.totals[quantity]
    ]
    return {
        count: -(-round(tally.ratio(count) * LIMITS_PER_UNIT, 6) // 1) / LIMITS_PER_UNIT
        for count in measured
    }


Limits = dict[str, dict[str, float]]


def limit_excesses(tallies: dict[str, FolderTally], limits: Limits) -> Iterator[str]:
    """Yield a line for each count above its limit.

    For a folder that has no limits in the limits file, all limits are zero.
    """
    for name, tally in tallies.items():
        for count, ratio in count_ratios(tally).items():
            limit = limits.get(name, {}).get(count, 0.0)
            if ratio > limit:
                unit = (
                    f" per {QUANTITY_PER_COUNT[count][1]} {QUANTITY_PER_COUNT[count][0]}"
                    if QUANTITY_PER_COUNT[count][0]
                    else ""
                )
                where = f"python tools/language.py --places {count} {name}"
                yield f"{name}: {count} {ratio:g}{unit}, at most {limit:g}; see {where}"


def lowered_limits(tallies: dict[str, FolderTally], limits: Limits) -> Limits:
    """Return new limits. Each new limit is the lower value of the current ratio and the old limit."""
    return {
        name: {
            count: min(ratio, limits.get(name, {}).get(count, ratio))
            for count, ratio in count_ratios(tally).items()
        }
        for name, tally in tallies.items()
    }


def to_toml(limits: Limits) -> str:
    """Return limits as the text of a TOML file."""
    head = "# Written by `python tools/language.py --tighten`, which only lowers limits. Ratios as in PER there.\n"
    sections = (
        f"\n[{name}]\n" + "".join(f"{count} = {limit:g}\n" for count, limit in counts.items())
        for name, counts in limits.items()
    )
    return head + "".join(sections)


def print_table(tallies: dict[str, FolderTally]) -> None:
    """Print a table of all counts, with a row for each count and a column for each folder."""
    print(f"{'':30}" + "".join(f"{name:>13}" for name in tallies))
    for count, (quantity, factor) in QUANTITY_PER_COUNT.items():
        label = f"{count} / {factor} {quantity}" if quantity else count
        cells = (
            f"{tally.ratio(count):.1f}" if count in count_ratios(tally) else "-"
            for tally in tallies.values()
        )
        print(f"{label:30}" + "".join(f"{cell:>13}" for cell in cells))
    commented = (
        1000 * tally.totals["comments"] / max(tally.totals["lines"], 1)
        for tally in tallies.values()
    )
    print(f"{'comments / 1000 lines':30}" + "".join(f"{ratio:13.1f}" for ratio in commented))


def main(words: list[str] | None = None) -> int:
    """Compare the counts with their limits, or execute the requested option. Return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--table", action="store_true", help="print all counts")
    parser.add_argument(
        "--places", nargs=2, metavar=("COUNT", "FOLDER"), help="print where a count comes from"
    )
    tighten = "lower the limit of each rule to its present number of findings"
    parser.add_argument("--tighten", action="store_true", help=tighten)
    args = parser.parse_args(words)
    tallies = count_all_folders(REPOSITORY_ROOT)
    if args.table:
        print_table(tallies)
        return 0
    if args.places:
        count, folder = args.places
        if count not in QUANTITY_PER_COUNT or folder not in tallies:
            parser.error(
                f"--places takes one of {', '.join(QUANTITY_PER_COUNT)} and one of {', '.join(tallies)}"
            )
        print(*tallies[folder].places[count], sep="\n")
        return 0
    limits: Limits = (
        tomllib.loads(LIMITS_FILE.read_text(encoding="utf-8")) if LIMITS_FILE.exists() else {}
    )
    if args.tighten:
        LIMITS_FILE.write_text(to_toml(lowered_limits(tallies, limits)), encoding="utf-8")
        return 0
    lines = list(limit_excesses(tallies, limits))
    print(*lines, sep="\n", end="\n" * bool(lines), file=sys.stderr)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
