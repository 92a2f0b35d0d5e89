"""Generate the block about the Python API from the names that the package ``handctl`` exports."""

import inspect
import re
from collections.abc import Iterator

import handctl
from tools.reference.markdown import docstring_markdown

ARRAY_PATTERN = re.compile(r"numpy\.ndarray\[.*?, numpy\.dtype\[[\w.]*(?:\[\w+\])?\]\]")
"""Pattern of an array type, as the module inspect writes it.

The reference pages show NDArray instead.
"""


def exported_name_sections() -> str:
    """Return a section for each exported name: first functions, then classes, then errors."""
    exported = [getattr(handctl, name) for name in handctl.__all__]
    errors = [
        value for value in exported if isinstance(value, type) and issubclass(value, Exception)
    ]
    classes = [value for value in exported if isinstance(value, type) and value not in errors]
    functions = [value for value in exported if value not in errors and value not in classes]
    sections = ["## Functions"]
    for function in functions:
        sections += [
            f"### handctl.{function.__name__}",
            _signature_block(function),
            docstring_markdown(function),
        ]
    sections.append("## Classes")
    for kind in classes:
        sections += [
            f"### handctl.{kind.__name__}",
            docstring_markdown(kind),
            *_method_sections(kind),
        ]
    sections.append("## Errors")
    for error in errors:
        bases = ", ".join(f"`{base.__name__}`" for base in error.__bases__)
        sections += [
            f"### handctl.{error.__name__}",
            f"A kind of {bases}.",
            docstring_markdown(error),
        ]
    return "\n\n".join(sections)


def _method_sections(kind: type) -> Iterator[str]:
    """Yield a section for each public method or property of a class."""
    for name, member in vars(kind).items():
        if name.startswith("_"):
            continue
        if isinstance(member, property):
            yield from (f"#### {kind.__name__}.{name}", docstring_markdown(member))
        elif inspect.isfunction(member):
            yield from (
                f"#### {kind.__name__}.{name}",
                _signature_block(member),
                docstring_markdown(member),
            )


def _signature_block(function: object) -> str:
    """Return the signature of a function as code.

    A long signature is written with one argument per line.
    """
    assert inspect.isfunction(function)
    signature = inspect.signature(function)
    shown_parameters = [p for p in signature.parameters.values() if p.name != "self"]
    name, result = function.__name__, inspect.formatannotation(signature.return_annotation)
    result = result.strip("'")
    signature_text = str(
        signature.replace(parameters=shown_parameters, return_annotation=inspect.Signature.empty)
    )
    signature_text = signature_text.replace("collections.abc.", "").replace("typing.", "")
    signature_text = ARRAY_PATTERN.sub("NDArray", signature_text)
    line = f"{name}{signature_text} -> {result}"
    if len(line) > 90:
        inner_definition = signature_text[1:-1].replace(", ", ",\n    ")
        # A comma inside the brackets of a type does not separate arguments.
        line = f"{name}(\n    {_rejoin_brackets(inner_definition)},\n) -> {result}"
    return f"```python\n{line}\n```"


def _rejoin_brackets(text: str) -> str:
    """Join lines of a signature again if the signature was divided between an opening and a closing bracket."""
    lines: list[str] = []
    for line in text.split(",\n    "):
        if lines and lines[-1].count("[") > lines[-1].count("]"):
            lines[-1] += f", {line}"
        else:
            lines.append(line)
    return ",\n    ".join(lines)
