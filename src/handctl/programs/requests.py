"""What people and programs may ask of a running controller: one JSON object a datagram, checked here.

Requests enter the tick as text, so that a log can be executed again with exactly what was asked.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from handctl.document import Document
from handctl.programs.task import SHORTEST_MOVE_S, Angle, Tension


class Asked(Document):
    """What every request may say besides."""

    by: str = Field("", max_length=40, pattern=r"^[\w.-]*$")
    """Who asks, e.g. a program and its number: whoever hears what the controller says then knows to whom."""


class Arm(Asked):
    """Enable the drives once everything has answered."""

    do: Literal["arm"]


class Stop(Asked):
    """Relax the tensions, disable the drives, confirm, end."""

    do: Literal["stop"]


class Cut(Asked):
    """Take the torque away at once."""

    do: Literal["cut"]


class Clear(Asked):
    """Clear latched faults; a hand that they disarmed stays so."""

    do: Literal["clear"]


class MoveDigits(Asked):
    """Move digits to joint angles; of a one-tendon digit the mean joint angle."""

    do: Literal["move"]
    angle_deg: dict[str, Angle] = Field(min_length=1)
    duration_s: float = Field(1.0, ge=SHORTEST_MOVE_S, le=600)


class HoldTension(Asked):
    """Hold tensions, one for all tendons of a digit."""

    do: Literal["hold"]
    tension_N: dict[str, Tension] = Field(min_length=1)
    rate_N_per_s: float = Field(100.0, gt=0, le=5000)


class SetGains(Asked):
    """Change gains of the running controller."""

    do: Literal["gains"]
    set: dict[str, float] = Field(min_length=1)
    """Key, e.g. ``motion.force_N``, to value; all of them or none."""


Request = Arm | Stop | Cut | Clear | MoveDigits | HoldTension | SetGains

_TAKEN = "asked: "
_ADAPTER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])

LONGEST_LINE = 200
REFUSED = "refused: "
"""How the text of an event begins that says that a request is not carried out."""


def taken(request: Request) -> str:
    """Text of the event with which a request is taken; what follows up to the next such is of this one."""
    return f"{_TAKEN}{request.do}" + (f" by {request.by}" if request.by else "")


def said_of(by: str, events: Iterable[Mapping[str, Any]]) -> list[str] | None:
    """What a tick says of the request of one who asks; None if there is none of theirs in it.

    Args:
        by: who asked.
        events: of the tick, as a status line has them.
    """
    found: list[str] | None = None
    for text in [event["text"] for event in events if event["name"] == "request"]:
        if text.startswith(_TAKEN):
            if found is not None:
                break
            found = [] if text.endswith(f" by {by}") else None
        elif found is not None:
            found.append(text)
    return found


def parse_request(text: str) -> Request | str:
    """A request, or one line that says why it is none; whatever was sent, it can be printed."""
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        line = f"request {where}: {first['msg']}" if where else f"request: {first['msg']}"
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line[:LONGEST_LINE])
