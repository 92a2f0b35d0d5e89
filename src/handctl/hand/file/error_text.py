"""Messages of validation errors in one line: file, key path, invalid value, and a valid value."""

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
"""Valid values for pydantic's structural errors, in TOML's terms. All other errors carry ``right``."""


def config_error(
    error: ValidationError, model: type[BaseModel], content: Mapping[str, Any], source: str
) -> ConfigError:
    """Return a validation error as a one-line error for the user.

    An unknown key is reported first. A misspelt key is also a missing key, and the spelling is the
    cause.

    Args:
        error: error raised by pydantic.
        model: model of the document, for the names of valid keys.
        content: validated content, for the names of list entries.
        source: name of the file.
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
    """Return a readable path: ``digit[index].link_mass_kg[1]``, with list entries by their names."""
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
    """Return a value in TOML's spelling, shortened if long."""
    text = str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _keys(model: type[BaseModel], location: Sequence[str | int]) -> list[str]:
    """Return the valid keys of the table at a location."""
    for part in location:
        if isinstance(part, str):
            model = next(m for m in _models(model.model_fields[part].annotation))
    return [field.alias or name for name, field in model.model_fields.items()]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models inside an annotation such as ``tuple[Digit, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in getattr(annotation, "__args__", ()) for model in _models(part)]


def _nearest(key: str, valid: list[str]) -> str:
    """Return the most similar valid key, or all valid keys."""
    near = difflib.get_close_matches(key, valid, n=1)
    return near[0] if near else "one of " + ", ".join(valid)
