"""Draw random names and sentences for a reader who does not know the repository.

``python tools/cold_reading.py sample FOLDER --seed 1`` writes three files: ``names.txt`` and
``sentences.txt`` for the reader, and ``key.json``. Half of the lines come from well-known projects
that are installed in the environment. The reader does not know which lines come from other
projects. The reader writes down the numbers of all lines that must be read twice. ``python
tools/cold_reading.py score FOLDER names 3,17,42`` counts the marked lines of both halves. Readers
are not equally strict, so compare the two counts with each other, and ignore their absolute values.
"""

import argparse
import ast
import json
import random
import re
import sysconfig
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[1]
OUR_FOLDERS = ("src/handctl", "firmware_sim", "tests", "benchmarks", "fuzz")
"""Folders of this repository whose subfolders form the groups of files."""
OTHER_PROJECTS = (
    "can", "cantools", "control", "mcap", "gymnasium", "rich", "click", "pluggy", "_pytest", "hypothesis", "grimp",
    "attr", "msgpack",
)  # fmt: skip
"""Packages of other projects. The program leaves out packages that are not installed."""
SHORTEST_NAME = 3
SENTENCE_WORDS = range(6, 45)
"""Permitted number of words of a sentence. Shorter sentences are mostly headings, and longer ones mostly lists."""


class Line(NamedTuple):
    """One line of a sample: a name or a sentence.

    Attributes:
        text: name with its kind, or sentence.
        project: project from which the line comes.
        path: file from which the line comes.
    """

    text: str
    project: str
    path: str


def main() -> None:
    """Write a sample of names and sentences, or count the lines that a reader has marked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = parser.add_subparsers(dest="action", required=True)
    sample = actions.add_parser("sample", help="write a sample")
    sample.add_argument("folder", type=Path, help="folder for the files of the sample")
    sample.add_argument("--seed", type=int, default=1, help="seed of the choice (default: 1)")
    sample.add_argument("--count", type=int, default=60, help="lines of each half (default: 60)")
    score = actions.add_parser("score", help="count the marked lines")
    score.add_argument("folder", type=Path, help="folder of the sample")
    score.add_argument("part", choices=("names", "sentences"), help="part that was read")
    score.add_argument("numbers", help="numbers of the marked lines, separated by commas")
    args = parser.parse_args()
    if args.action == "sample":
        write_sample(args.folder, args.seed, args.count)
    else:
        print_score(args.folder, args.part, [int(number) for number in args.numbers.split(",")])


def write_sample(folder: Path, seed: int, count: int) -> None:
    """Write the files of a sample.

    Args:
        folder: folder for the files.
        seed: seed of the random choice.
        count: number of lines of this repository, and of lines of other projects, in each file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    chance = random.Random(seed)
    key = {}
    for sample_part, find_lines in (("names", names_in_file), ("sentences", sentences_in_file)):
        lines = [
            *draw_lines(our_files(sample_part == "sentences"), find_lines, count, chance),
            *draw_lines(other_files(), find_lines, count, chance),
        ]
        chance.shuffle(lines)
        numbered = [f"{number}. {line.text}" for number, line in enumerate(lines, 1)]
        (folder / f"{sample_part}.txt").write_text("\n".join(numbered) + "\n", encoding="utf-8")
        key[sample_part] = lines
    (folder / "key.json").write_text(json.dumps(key, indent=1), encoding="utf-8")


def print_score(folder: Path, part: str, numbers: Sequence[int]) -> None:
    """Print the marked lines, and the number of marked lines for this repository and for the other projects."""
    lines = [Line(*row) for row in json.loads((folder / "key.json").read_text())[part]]
    marked = [lines[number - 1] for number in numbers]
    ours = [line for line in marked if line.project == "handctl"]
    print(f"handctl: {len(ours)} marked, other projects: {len(marked) - len(ours)}")
    for line in sorted(marked, key=lambda line: line.project != "handctl"):
        print(f"{line.project}: {line.text} ({line.path})")


def our_files(with_documents: bool) -> dict[str, list[Path]]:
    """Return a dictionary from each folder of this repository to the files of the folder."""
    groups: dict[str, list[Path]] = {}
    for folder in OUR_FOLDERS:
        for path in sorted((REPOSITORY / folder).rglob("*.py")):
            path_in_folder = path.relative_to(REPOSITORY / folder).parts
            group = f"{folder}/{path_in_folder[0]}" if len(path_in_folder) > 1 else folder
            groups.setdefault(group, []).append(path)
    if with_documents:
        for path in sorted((REPOSITORY / "docs").rglob("*.md")):
            groups.setdefault(str(path.parent.relative_to(REPOSITORY)), []).append(path)
    return groups


def other_files() -> dict[str, list[Path]]:
    """Return a dictionary from each installed package of another project to the files of the package."""
    packages = Path(sysconfig.get_path("purelib"))
    paths_of_project = {name: sorted((packages / name).rglob("*.py")) for name in OTHER_PROJECTS}
    return {name: paths for name, paths in paths_of_project.items() if paths}


def draw_lines(
    groups: dict[str, list[Path]],
    find_lines: Callable[[Path], Iterable[str]],
    count: int,
    chance: random.Random,
) -> list[Line]:
    """Draw random lines from all groups of files in turn. No text occurs twice in the drawn lines.

    Args:
        groups: files of each group.
        find_lines: function that returns the names or the sentences of a file.
        count: number of lines to draw.
        chance: source of random numbers.
    """
    texts = {
        group: [(text, path) for path in paths for text in find_lines(path)]
        for group, paths in groups.items()
    }
    texts = {group: pairs for group, pairs in texts.items() if pairs}
    drawn: dict[str, Line] = {}
    while len(drawn) < count:
        for group in chance.sample(sorted(texts), len(texts)):
            text, path = chance.choice(texts[group])
            ours = path.is_relative_to(REPOSITORY) and "site-packages" not in path.parts
            if len(drawn) < count:
                drawn.setdefault(text, Line(text, "handctl" if ours else group, path.name))
    return list(drawn.values())


def names_in_file(path: Path) -> list[str]:
    """Return all names that a file defines, each with its kind. Leave out tests of pytest."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    definitions = [
        ("module", path.stem),
        *(pair for node in ast.walk(tree) for pair in defined_names(node)),
    ]
    return sorted({
        f"`{name}` ({kind})"
        for kind, name in definitions
        if len(name) >= SHORTEST_NAME
        and name not in ("self", "cls")
        and not name.startswith(("__", "test_"))
    })  # fmt: skip


def defined_names(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield the kind and the name of each name that a node of a syntax tree defines."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            yield "function", node.name
            for argument in node.args.args + node.args.kwonlyargs:
                yield f"argument of {node.name}()", argument.arg
        case ast.ClassDef():
            yield "class", node.name
            for statement in node.body:
                if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
                    yield f"field of {node.name}", statement.target.id
        case ast.Assign():
            for target in node.targets:
                if isinstance(target, ast.Name):
                    yield "constant" if target.id.isupper() else "variable", target.id


def sentences_in_file(path: Path) -> list[str]:
    """Return the sentences of a document, or of the docstrings of a Python file."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return sentences_of_text(
            re.sub(r"```.*?```|^[|#>!].*?$", "", text, flags=re.DOTALL | re.MULTILINE)
        )
    nodes = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = [
        ast.get_docstring(node) or ""
        for node in ast.walk(ast.parse(text))
        if isinstance(node, nodes)
    ]
    return [sentence for docstring in docstrings for sentence in sentences_of_text(docstring)]


def sentences_of_text(text: str) -> list[str]:
    """Return the sentences of the ordinary paragraphs of a text."""
    sentences = []
    for paragraph in re.split(r"\n\s*\n", text):
        if re.search(r"^\s*([-*>|:.]|\w+:|>>>|\d+\.)", paragraph) or "::" in paragraph:
            continue
        joined = " ".join(paragraph.split())
        sentences += [
            sentence
            for sentence in re.split(r"(?<=[.?!]) (?=[A-Z`*])", joined)
            if len(sentence.split()) in SENTENCE_WORDS and sentence.endswith((".", "?", "!"))
        ]
    return sentences


if __name__ == "__main__":
    main()
