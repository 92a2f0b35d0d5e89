"""Test valid and invalid requests to the control loop.

No datagram that another program sends to the controller can stop the control loop.
"""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.programs.requests import (
    ArmRequest,
    ClearFaultsRequest,
    CutTorqueRequest,
    HoldTensionRequest,
    MoveDigitsRequest,
    StopRequest,
    events_for_request,
    parse_request,
)
from handctl.runtime.mailbox import MAX_REQUEST_BYTES

VALID_REQUESTS = [
    ('{"do": "arm"}', ArmRequest),
    ('{"do": "stop"}', StopRequest),
    ('{"do": "cut"}', CutTorqueRequest),
    ('{"do": "clear"}', ClearFaultsRequest),
    ('{"do": "move", "angle_deg": {"index": 30}}', MoveDigitsRequest),
    (
        '{"do": "hold", "tension_N": {"index": 20.5, "thumb": 0}, "rate_N_per_s": 10}',
        HoldTensionRequest,
    ),
]


@pytest.mark.parametrize(("request_text", "request_class"), VALID_REQUESTS)
def test_valid_requests_are_parsed(request_text: str, request_class: type) -> None:
    assert isinstance(parse_request(request_text), request_class)


def test_numbers_arrive_as_they_were_sent() -> None:
    request = parse_request(
        '{"do": "move", "angle_deg": {"index": 30, "x": -1.5}, "duration_s": 2.5}'
    )
    assert isinstance(request, MoveDigitsRequest)
    assert request.angle_deg == {"index": 30.0, "x": -1.5}
    assert request.duration_s == 2.5


INVALID_REQUESTS = [
    "",
    "stop",
    "[]",
    "null",
    "3",
    '"stop"',
    '{"do": "dance"}',
    '{"do": "stop", "now": true}',
    '{"do": "Stop"}',
    '{"do": null}',
    "{}",
    '{"do": "move"}',
    '{"do": "move", "angle_deg": {"index": 1e999}}',
    '{"do": "move", "angle_deg": {"index": NaN}}',
    '{"do": "move", "angle_deg": {"index": -Infinity}}',
    '{"do": "move", "angle_deg": {"index": true}}',
    '{"do": "move", "angle_deg": {"index": "30"}}',
    '{"do": "move", "angle_deg": {"index": 151}}',
    '{"do": "move", "angle_deg": {"index": 30}, "duration_s": 0}',
    '{"do": "move", "angle_deg": {"index": 30}, "duration_s": 0.049}',
    '{"do": "move", "angle_deg": {"index": 30}, "duration_s": 1e-300}',
    '{"do": "move", "angle_deg": {}}',
    '{"do": "hold", "tension_N": {}}',
    '{"do": "move", "angle_deg": 30}',
    '{"do": "hold", "tension_N": {"index": -0.1}}',
    '{"do": "hold", "tension_N": {"index": 1001}}',
    '{"do": "hold", "tension_N": {"index": 5}, "rate_N_per_s": 0}',
    '{"do": "stop"} {"do": "stop"}',
    '{"do": "move", "angle_deg": {"\\ud800": "x"}}',
    '{"do": "move", "angle_deg": {"\\u001b[2J\\n": "x"}}',
    "[" * MAX_REQUEST_BYTES,
    '{"a":' * (MAX_REQUEST_BYTES // 5),
    '{"do": "move", "angle_deg": {"' + "x" * 4000 + '": "x"}}',
    "9" * MAX_REQUEST_BYTES,
]


@pytest.mark.parametrize("request_text", INVALID_REQUESTS)
def test_bad_requests_become_one_printable_line(request_text: str) -> None:
    line = parse_request(request_text)
    assert isinstance(line, str)
    assert line.startswith("request")
    assert line.isprintable(), "it goes into the log and to a terminal"
    assert len(line) < 300
    line.encode()


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)
almost_valid_requests = st.fixed_dictionaries(
    {"do": st.sampled_from(["arm", "stop", "cut", "clear", "move", "hold"])},
    optional={
        "angle_deg": json_values,
        "tension_N": json_values,
        "duration_s": json_values,
        "rate_N_per_s": json_values,
    },
)


@given(
    st.text()
    | json_values.map(json.dumps)
    | almost_valid_requests.map(json.dumps)
    | st.binary().map(lambda b: b.decode("utf-8", "replace"))
)
def test_nothing_raises_and_every_number_is_finite(request_text: str) -> None:
    request = parse_request(request_text)
    if isinstance(request, str):
        assert request.isprintable()
    elif isinstance(request, MoveDigitsRequest):
        assert all(
            math.isfinite(value) for value in (*request.angle_deg.values(), request.duration_s)
        )
    elif isinstance(request, HoldTensionRequest):
        assert all(
            math.isfinite(value) for value in (*request.tension_N.values(), request.rate_N_per_s)
        )


def test_events_of_a_request_end_at_the_next_request() -> None:
    texts = [
        "asked: move",
        "refused: a",
        "asked: hold by b",
        "hold index 3",
        "more",
        "asked: move by c",
        "refused: c",
    ]
    events = [
        {"name": "fault", "text": "T01"},
        *({"name": "request", "text": text} for text in texts),
    ]
    assert events_for_request("b", events) == ["hold index 3", "more"]
    assert events_for_request("c", events) == ["refused: c"]
    assert events_for_request("nobody", events) is None
    assert events_for_request("b", []) is None


@pytest.mark.parametrize("sender_name", ["a b", "x" * 41, "\n", "é!"])
def test_sender_name_is_one_short_word(sender_name: str) -> None:
    assert parse_request(json.dumps({"do": "stop", "by": "handctl-1.2_x"})) == StopRequest(
        do="stop", by="handctl-1.2_x"
    )
    assert isinstance(parse_request(json.dumps({"do": "stop", "by": sender_name})), str)
