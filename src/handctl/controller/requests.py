"""What people and programs may ask of a running controller: one JSON object a datagram, checked here.

Requests enter the tick as text, so that a log can be executed again with exactly what was asked.
"""

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError

from handctl.controller.task import SHORTEST_MOVE_S, Angle, Tension
from handctl.document import Document


class Arm(Document):
    """Enable the drives once everything has answered."""

    do: Literal["arm"]


class Stop(Document):
    """Relax the tensions, disable the drives, confirm, end."""

    do: Literal["stop"]


class Cut(Document):
    """Take the torque away at once."""

    do: Literal["cut"]


class Clear(Document):
    """Clear latched faults; a hand that they disarmed stays so."""

    do: Literal["clear"]


class MoveDigits(Document):
    """Move digits to joint angles; of a one-tendon digit the mean joint angle."""

    do: Literal["move"]
    angle_deg: dict[str, Angle]
    duration_s: float = Field(1.0, ge=SHORTEST_MOVE_S, le=600)


class HoldTension(Document):
    """Hold tensions, one for all tendons of a digit."""

    do: Literal["hold"]
    tension_N: dict[str, Tension]
    rate_N_per_s: float = Field(100.0, gt=0, le=5000)


class SetGains(Document):
    """Change gains of the running controller."""

    do: Literal["gains"]
    set: dict[str, float] = Field(min_length=1)
    """Key, e.g. ``motion.force_N``, to value; all of them or none."""


Request = Arm | Stop | Cut | Clear | MoveDigits | HoldTension | SetGains

_ADAPTER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])

LONGEST_LINE = 200


def parse_request(text: str) -> Request | str:
    """A request, or one line that says why it is none; whatever was sent, it can be printed."""
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        line = f"request {where}: {first['msg']}" if where else f"request: {first['msg']}"
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line[:LONGEST_LINE])
