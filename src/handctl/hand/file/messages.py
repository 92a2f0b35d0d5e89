"""What pydantic finds wrong, as one line: file, key path, offending value, and what would be right."""

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from handctl.errors import ConfigError

EXPECTED = {
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "too_short": "at least {min_length} values",
    "too_long": "at most {max_length} values",
}
"""What pydantic's structural errors ask for, in the words of TOML; the rest are our own and carry ``right``."""


def config_error(
    error: ValidationError, model: type[BaseModel], content: Mapping[str, Any], source: str
) -> ConfigError:
    """Turn a validation error into the line for a person.

    An unknown key is told before anything else: a misspelt key is also a missing one, and the spelling is the cause.

    Args:
        error: as raised by pydantic.
        model: the document's model, for the names of valid keys.
        content: what was validated, for the names of list entries.
        source: file name.
    """
    details = error.errors(include_url=False)
    detail = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    where = f"{source}: {key_path(content, detail['loc'])}"
    if detail["type"] == "extra_forbidden":
        return ConfigError("unknown key", where, _nearest(str(detail["loc"][-1]), _keys(model, detail["loc"][:-1])))
    if detail["type"] == "missing":
        return ConfigError("missing", where, "a value")
    context = {"right": detail["msg"], **detail.get("ctx", {})}
    return ConfigError(shown(detail["input"]), where, EXPECTED.get(detail["type"], "{right}").format(**context))


def key_path(content: Any, location: Sequence[str | int]) -> str:
    """Path as a person would say it: ``digit[index].link_mass_kg[1]``, list entries by name where they have one."""
    path = ""
    for part in location:
        try:
            content = content[part]
        except (KeyError, IndexError, TypeError):
            content = None
        if isinstance(part, int):
            name = content.get("name") if isinstance(content, Mapping) else None
            path += f"[{name if isinstance(name, str) and name else part}]"
        else:
            path += f".{part}" if path else part
    return path


def shown(value: Any) -> str:
    """A value as TOML writes it, cut short if long."""
    text = str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _keys(model: type[BaseModel], location: Sequence[str | int]) -> list[str]:
    """Valid keys of the table at a location."""
    for part in location:
        if isinstance(part, str):
            model = next(m for m in _models(model.model_fields[part].annotation))
    return [field.alias or name for name, field in model.model_fields.items()]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Models inside an annotation such as ``tuple[Digit, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in getattr(annotation, "__args__", ()) for model in _models(part)]


def _nearest(key: str, valid: list[str]) -> str:
    """The valid key that was probably meant, or all of them."""
    near = difflib.get_close_matches(key, valid, n=1)
    return near[0] if near else "one of " + ", ".join(valid)
