"""Requests to a running controller.

Each request is one JSON object in a datagram. This module checks the JSON object of a request.

A request enters the tick as text, so that the same requests can be executed again from a log.
Streamed targets are frequent and must reach the drives quickly. A target therefore arrives as a
binary datagram, which is decoded before the target enters the tick. The tick record in the log
stores a target as text.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from handctl.core.tick_types import StreamTarget, TickRequest
from handctl.document import Document
from handctl.programs.task import SHORTEST_MOVE_S, AngleDeg, Task, TensionN

MAX_VALUES_PER_TARGET = 64
"""Largest number of values of a streamed target."""
SHORTEST_LEASE_S, LONGEST_LEASE_S = 0.2, 3600.0
"""Shortest and longest lease: the silence after which a client counts as lost [s]."""


class RequestBase(Document):
    """Fields of every request."""

    by: str = Field("", max_length=40, pattern=r"^[\w.-]*$")
    """Sender of the request, e.g. a program and a number.

    By this text, the sender recognises the answer.
    """


class ArmRequest(RequestBase):
    """Enable the drives after every node has replied."""

    do: Literal["arm"]


class StopRequest(RequestBase):
    """Relax the tensions, disable the drives, confirm that the drives are disabled, and end the run."""

    do: Literal["stop"]


class CutTorqueRequest(RequestBase):
    """Remove the torque at once."""

    do: Literal["cut"]


class ClearFaultsRequest(RequestBase):
    """Clear latched faults. The request does not arm a hand that a fault has disarmed."""

    do: Literal["clear"]


class CommandRequestBase(RequestBase):
    """Fields of a request that moves the hand. Only one client at a time commands the hand."""

    client: str = Field("", max_length=40, pattern=r"^[\w.-]*$")
    """Name of the client that commands the hand.

    All requests without a name count as one client.
    """
    take_over: bool = False
    """True to take the command over from another client."""
    lease_s: float | None = Field(None, ge=SHORTEST_LEASE_S, le=LONGEST_LEASE_S)
    """Longest silence of this client [s].

    Each command and each `alive` restarts this time. After this time, moving digits come to rest, and after twice this
    time the hand relaxes. If it is not given, the last goal applies without a time limit."""


class KeepAliveRequest(RequestBase):
    """Report that a client is still alive.

    The request starts the lease of the client again. The field `lease_s` of the client's last
    command contains the time of the lease [s].
    """

    do: Literal["alive"]
    client: str = Field(max_length=40, pattern=r"^[\w.-]*$")
    """Name of the client that is alive. A client that does not command the hand is ignored."""


class MoveDigitsRequest(CommandRequestBase):
    """Move digits or joints to angles. The angle of a digit applies to all its joints."""

    do: Literal["move"]
    angle_deg: dict[str, AngleDeg] = Field(min_length=1)
    """Angle by the name of a digit, or by the name of a joint in the hand file."""
    duration_s: float = Field(1.0, ge=SHORTEST_MOVE_S, le=600)


class StopMotionRequest(CommandRequestBase):
    """Bring the moving digits to rest at their present positions.

    A digit that holds a tension continues to hold the tension.
    """

    do: Literal["stay"]


class GiveUpCommandRequest(CommandRequestBase):
    """Give the command back. The digits come to rest, and another client may then command the hand."""

    do: Literal["leave"]


class OpenStreamRequest(CommandRequestBase):
    """Begin a stream of targets. If a stream is already open, the new stream replaces it."""

    do: Literal["stream"]
    stream: str = Field(min_length=1, max_length=40, pattern=r"^[\w.-]*$")
    """Name of the stream, which every target repeats."""
    space: Literal["joint", "digit", "tension", "tip_force"]
    """Meaning of a target.

    It is an angle for each joint [deg], one angle for all joints of a digit [deg], a tension for
    each tendon [N], or a force at the tip of a digit [N].
    """
    names: tuple[str, ...] = Field(min_length=1, max_length=MAX_VALUES_PER_TARGET)
    """Names of the values of a target, in the order of the values."""
    rate_Hz: float = Field(ge=1, le=1000)
    """Rate at which the client sends targets."""
    interpolation: Literal["linear", "minimum_jerk"] = "linear"
    """Motion from one target to the next. Tensions and forces are always linear."""
    stiffness_N_m_per_rad: float | None = Field(None, gt=0, le=1000)
    """Stiffness of the joints against a push [N m/rad].

    By default, the digits have the full stiffness of the gains.
    """
    damping_ratio: float = Field(1.0, ge=0.5, le=2)
    """Damping ratio of joints with this stiffness, as a multiple of the damping ratio of the gains."""


class GraspRequest(CommandRequestBase):
    """Carry out a task up to its first hold phase, and hold until the request ``release`` arrives."""

    do: Literal["grasp"]
    task: Task
    """The task, as in a task file."""


class ReleaseGraspRequest(CommandRequestBase):
    """End the hold phase of a task, and carry out the remaining phases of the task."""

    do: Literal["release"]


class CloseStreamRequest(CommandRequestBase):
    """End a stream. The digits of the stream come to rest at their present positions."""

    do: Literal["stream_end"]
    stream: str = Field(max_length=40)
    """Name of the stream."""


class HoldTensionRequest(CommandRequestBase):
    """Hold tensions. The tension of a digit applies to all its tendons."""

    do: Literal["hold"]
    tension_N: dict[str, TensionN] = Field(min_length=1)
    rate_N_per_s: float = Field(100.0, gt=0, le=5000)


class SetGainsRequest(RequestBase):
    """Change gains of the running controller."""

    do: Literal["gains"]
    set: dict[str, float] = Field(min_length=1)
    """Value by key, e.g. `motion.force_N`. If one value is refused, no value is applied."""


Request = (
    ArmRequest | StopRequest | CutTorqueRequest | ClearFaultsRequest | MoveDigitsRequest | HoldTensionRequest
    | StopMotionRequest | GiveUpCommandRequest
    | GraspRequest | ReleaseGraspRequest | OpenStreamRequest
    | CloseStreamRequest | KeepAliveRequest | SetGainsRequest
)  # fmt: skip

_ACCEPTED_PREFIX = "asked: "
_REQUEST_ADAPTER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])

MAX_REFUSAL_TEXT_LENGTH = 200
"""Largest length of a line with the reason for refusing a request [characters]."""
REFUSAL_EVENT_PREFIX = "refused: "
"""Prefix of the event of a refused request."""


def describe_request(request: Request) -> str:
    """Return the event text of an accepted request.

    In the list of events, the events of a request come after its event text, and before the event
    text of the next request.
    """
    return f"{_ACCEPTED_PREFIX}{request.do}" + (f" by {request.by}" if request.by else "")


def events_for_request(
    sender_name: str, event_lines: Iterable[Mapping[str, Any]]
) -> list[str] | None:
    """Return the texts of the events that a sender's request has caused.

    Return None if the tick has no request of the sender.

    Args:
        sender_name: sender of the request.
        event_lines: events of the tick, as in a status line.
    """
    texts: list[str] | None = None
    for text in [event["text"] for event in event_lines if event["name"] == "request"]:
        if text.startswith(_ACCEPTED_PREFIX):
            if texts is not None:
                break
            texts = [] if text.endswith(f" by {sender_name}") else None
        elif texts is not None:
            texts.append(text)
    return texts


_TARGET_REQUEST_PREFIX = '{"do": "target", '
"""Beginning of the request text of a target, for a quick test. Targets come hundreds of times a second."""


def target_request_text(target: StreamTarget) -> str:
    """Return a streamed target as the text of a request.

    The request text contains the exact values of the target.
    """
    stream, number, sent_ns, values = target
    values_text = json.dumps(list(values))
    start = f'{_TARGET_REQUEST_PREFIX}"stream": "{stream}", "n": {number}'
    return f'{start}, "sent_ns": {sent_ns}, "values": {values_text}}}'


def request_text(request: TickRequest) -> str:
    """Return the JSON text of a request to the controller."""
    return target_request_text(request) if isinstance(request, StreamTarget) else request


def is_stream_target(text: str) -> bool:
    """Return True if the text of a request contains a target of a stream."""
    return text.startswith(_TARGET_REQUEST_PREFIX)


def requests_and_stream_targets(
    requests: tuple[TickRequest, ...],
) -> tuple[tuple[str, ...], tuple[TickRequest, ...]]:
    """Divide requests into targets of streams and other requests.

    Return two tuples: the other requests, and the targets. Requests and targets keep their original
    order.
    """
    other_requests = list[str]()
    targets = list[TickRequest]()
    for request in requests:
        if isinstance(request, StreamTarget) or is_stream_target(request):
            targets.append(request)
        else:
            other_requests.append(request)
    return tuple(other_requests), tuple(targets)


_KEEP_ALIVE_PREFIX = '{"do": "alive", '
"""Beginning of the request text of a ``KeepAliveRequest``."""


def keep_alive_text(client: str) -> str:
    """Return the text of the request that renews the lease of a client, see ``KeepAliveRequest``."""
    return f'{_KEEP_ALIVE_PREFIX}"client": "{client}"}}'


def is_routine_request(request: TickRequest) -> bool:
    """Return True for a request that clients send many times during a run.

    Routine requests are streamed targets and the requests ``KeepAliveRequest``.
    """
    if isinstance(request, StreamTarget):
        return True
    return is_stream_target(request) or request.startswith(_KEEP_ALIVE_PREFIX)


def parse_target(request: TickRequest) -> StreamTarget | None:
    """Return the streamed target that a request contains.

    Return None if the request contains no target, or an integer of more than 64 bits.
    """
    if isinstance(request, StreamTarget):
        return request
    try:
        fields = json.loads(request)
        stream, number, sent_ns = fields["stream"], fields["n"], fields["sent_ns"]
        values = tuple([float(value) for value in fields["values"]])
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None
    expected = isinstance(stream, str) and _is_int64(number) and _is_int64(sent_ns)
    return StreamTarget(stream, number, sent_ns, values) if expected else None


def _is_int64(value: object) -> bool:
    """Return True for an integer of at most 64 bits. The state block of the controller has 64 bits for an integer."""
    return type(value) is int and -(2**63) <= value < 2**63


def parse_request(text: str) -> Request | str:
    """Parse a request. If the request is invalid, return a line of text with the reason.

    The line with the reason contains only printable characters, even if the datagram contains other
    characters.
    """
    try:
        return _REQUEST_ADAPTER.validate_json(text)
    except ValidationError as error:
        first_error = error.errors(include_url=False)[0]
        location = ".".join(str(key_or_index) for key_or_index in first_error["loc"])
        line = (
            f"request {location}: {first_error['msg']}"
            if location
            else f"request: {first_error['msg']}"
        )
        return "".join(
            c if c.isprintable() else ascii(c)[1:-1] for c in line[:MAX_REFUSAL_TEXT_LENGTH]
        )
