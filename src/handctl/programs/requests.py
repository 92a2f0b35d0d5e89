"""Requests to a running controller: one JSON object per datagram, validated here.

Requests enter the tick as text, so a log is re-executed with exactly the same requests.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from handctl.document import Document
from handctl.programs.task import SHORTEST_MOVE_S, Angle, Tension


class RequestBase(Document):
    """Fields of every request."""

    by: str = Field("", max_length=40, pattern=r"^[\w.-]*$")
    """Sender of the request, e.g. a program and a number, for the sender to recognise the answer."""


class Arm(RequestBase):
    """Enable the drives once every node has replied."""

    do: Literal["arm"]


class Stop(RequestBase):
    """Relax the tensions, disable the drives, confirm, and end the run."""

    do: Literal["stop"]


class Cut(RequestBase):
    """Remove the torque at once."""

    do: Literal["cut"]


class Clear(RequestBase):
    """Clear latched faults. A hand that they disarmed stays disarmed."""

    do: Literal["clear"]


class MoveDigits(RequestBase):
    """Move digits to joint angles, a one-tendon digit by the mean joint angle."""

    do: Literal["move"]
    angle_deg: dict[str, Angle] = Field(min_length=1)
    duration_s: float = Field(1.0, ge=SHORTEST_MOVE_S, le=600)


class HoldTension(RequestBase):
    """Hold tensions, one for all tendons of a digit."""

    do: Literal["hold"]
    tension_N: dict[str, Tension] = Field(min_length=1)
    rate_N_per_s: float = Field(100.0, gt=0, le=5000)


class SetGains(RequestBase):
    """Change gains of the running controller."""

    do: Literal["gains"]
    set: dict[str, float] = Field(min_length=1)
    """Value by key, e.g. `motion.force_N`. All values are applied, or none."""


Request = Arm | Stop | Cut | Clear | MoveDigits | HoldTension | SetGains

_PREFIX = "asked: "
_ADAPTER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])

LONGEST_LINE = 200
"""Longest line that quotes a refused request [characters]."""
REFUSED = "refused: "
"""Prefix of the event of a refused request."""


def describe_request(request: Request) -> str:
    """Return the event text of an accepted request.

    Request events up to the next text of this form belong to the same request.
    """
    return f"{_PREFIX}{request.do}" + (f" by {request.by}" if request.by else "")


def events_for_request(by: str, events: Iterable[Mapping[str, Any]]) -> list[str] | None:
    """Return the event texts of one sender's request, None if this tick has no request of the sender.

    Args:
        by: sender.
        events: events of the tick, as in a status line.
    """
    texts: list[str] | None = None
    for text in [event["text"] for event in events if event["name"] == "request"]:
        if text.startswith(_PREFIX):
            if texts is not None:
                break
            texts = [] if text.endswith(f" by {by}") else None
        elif texts is not None:
            texts.append(text)
    return texts


def parse_request(text: str) -> Request | str:
    """Parse a request, and return a line with the reason if it is invalid.

    The line is printable whatever the datagram contained.
    """
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        line = f"request {where}: {first['msg']}" if where else f"request: {first['msg']}"
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line[:LONGEST_LINE])
