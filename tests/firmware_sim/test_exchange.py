"""Test the compiled kernel that processes all frames of a tick in one call.

The compiled kernel gets the frames as packed records, and gives the same result as the Python code
of the simulated nodes. The Python code processes one frame after the other.
"""

import random
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from firmware_sim import compiled
from firmware_sim.bus.frame import BRS, ERROR_FLAG, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from firmware_sim.bus.frame_records import FRAME_DTYPE, frames_to_records, records_to_frames
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.nodes import cyclic_kernels
from firmware_sim.truth_file import read_truth
from handctl.hand.hand_loading import load_hand as described

TICK_NS = 2_000_000
FIRST_NODE = 0x10
TESTED_PROTOCOLS = ("mit", "odrive", "cia402")
OPTIONS_BY_PROTOCOL = {
    "mit": "",
    "odrive": "[motor.options]\nendpoint_enable_watchdog = 201\nendpoint_watchdog_timeout = 202\n"
    "endpoint_torque_max = 203\nendpoint_torque_min = 204\n",
    "cia402": "[motor.options]\nrated_torque_N_m = 0.4\ncounts_per_turn = 65536\n",
}


def hand_file(hand_folder: Path, protocols: tuple[str, ...], bus_count: int = 1) -> str:
    """Write the hand file of the packaged hand jamia with other drive protocols, and return the path of the file.

    If ``bus_count`` is 2, two drives of the hand are on the second bus.
    """
    text = described("jamia").to_toml()
    head, *motors = text.split("[[motor]]")
    for i, motor in enumerate(motors):
        protocol = protocols[i % len(protocols)]
        motor = re.sub(
            r"node_id = \d+", f"node_id = {FIRST_NODE + i}", motor.replace('"mit"', f'"{protocol}"')
        )
        motors[i] = (
            (motor if bus_count == 1 or i < 2 else motor.replace('"main"', '"second"'))
            + OPTIONS_BY_PROTOCOL[protocol]
            + "\n"
        )
    if bus_count == 2:
        head = head.replace(
            "[sensor_node]", '[[bus]]\nname = "second"\nbitrate = 1_000_000\n\n[sensor_node]'
        )
    path = hand_folder / "hand.toml"
    path.write_text("[[motor]]".join([head, *motors]))
    return str(path)


def enable_frames(protocol: str, node: int) -> list[tuple[int, bytes]]:
    """Return the frames that set up a drive and enable it to follow torque commands."""
    if protocol == "mit":
        return [(0x7FF, struct.pack("<HBBI", node, 0x55, 9, 4000)), (node, b"\xff" * 7 + b"\xfc")]
    if protocol == "odrive":
        endpoints = [struct.pack("<BHBB", 1, 201, 0, 1), struct.pack("<BHBf", 1, 202, 0, 0.2)]
        modes = [
            (node << 5 | 0x0B, struct.pack("<II", 1, 1)),
            (node << 5 | 0x07, struct.pack("<I", 8)),
        ]
        return [*[(node << 5 | 0x04, data) for data in endpoints], *modes]
    written = [(0x1400, 1, 4, 0x80000200 + node), (0x1600, 0, 1, 0), (0x1600, 1, 4, 0x60400010)]
    written += [(0x1600, 2, 4, 0x60710010), (0x1600, 0, 1, 2), (0x1400, 1, 4, 0x200 + node)]
    written += [(0x1800, 1, 4, 0x80000180 + node), (0x1A00, 0, 1, 0), (0x1A00, 1, 4, 0x60410010)]
    written += [
        (0x1A00, 2, 4, 0x60640020),
        (0x1A00, 3, 4, 0x60770010),
        (0x1A00, 0, 1, 3),
        (0x1800, 2, 1, 1),
    ]
    written += [
        (0x1800, 1, 4, 0x180 + node),
        (0x1016, 1, 4, 0x7F0064),
        (0x1017, 0, 2, 30),
        (0x6060, 0, 1, 10),
    ]
    sizes = {1: 0x2F, 2: 0x2B, 4: 0x23}
    sdo = [
        (0x600 + node, struct.pack("<BHBI", sizes[size], index, sub, value))
        for index, sub, size, value in written
    ]
    return [
        *sdo,
        (0x000, bytes((1, node))),
        *[(0x200 + node, struct.pack("<Hh", word, 0)) for word in (6, 7, 15)],
    ]


def frames_of_tick(protocol: str, node: int, tick_index: int) -> list[tuple[int, bytes]]:
    """Return the frames that a host sends to an enabled drive in tick k."""
    fraction = 0.2 + 0.1 * ((tick_index // 20) % 3)
    if protocol == "mit":
        code = round((0.8 * fraction + 0.8) * 4095 / 1.6)
        return [(node, (0x7FFF << 48 | 0x7FF << 36 | 0x010 << 12 | code).to_bytes(8, "big"))]
    if protocol == "odrive":
        return [
            (node << 5 | 0x0E, struct.pack("<f", 0.4 * fraction)),
            (node << 5 | 0x09 | REMOTE_FLAG, b""),
        ]
    return [
        (0x200 + node, struct.pack("<Hh", 0x0F, round(1000 * fraction))),
        *([(0x77F, b"\5")] if tick_index % 5 == 0 else []),
    ]


def disturb_frame(frame: Frame, rng: random.Random) -> list[Frame]:
    """Return the frames that arrive when one frame is sent on a disturbed bus.

    The disturbed bus loses, repeats or changes a small fraction of the frames. Most frames arrive
    unchanged.
    """
    can_id, data, flags, bus, t_ns = frame
    disturbed_frames = [
        [],
        [frame, frame],
        [Frame(can_id, data[:-1], flags, bus, t_ns)],
        [Frame(can_id, data, FDF | BRS, bus, t_ns)],
        [Frame(can_id, data + bytes(12), FDF, bus, t_ns)],
        [
            Frame(
                can_id ^ rng.choice((EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG, 1, 0x80)),
                data,
                flags,
                bus,
                t_ns,
            )
        ],
        [Frame(can_id, rng.randbytes(len(data)), flags, bus, t_ns)],
        [
            Frame(
                can_id,
                (b"\xff" * 7 + rng.choice((b"\xfb", b"\xfd", b"\xff")))[: len(data) or 8],
                flags,
                bus,
                t_ns,
            )
        ],
        [
            Frame(
                can_id,
                struct.pack("<f", rng.choice((float("nan"), float("inf"), 1e30))),
                flags,
                bus,
                t_ns,
            ),
            frame,
        ],
        [Frame(0x080, bytes((rng.randrange(256),)), 0, 0, t_ns), frame],
    ]
    return rng.choice(disturbed_frames) if rng.random() < 0.03 else [frame]


def frames_of_ticks(
    protocols: tuple[str, ...], tick_count: int, seed: int, bus_count: int = 1
) -> Iterator[list[Frame]]:
    """Yield the frames of each tick: first the set-up of the drives, and then commands.

    If the seed is not 0, some of the frames are disturbed.
    """
    rng = random.Random(seed)
    drives = [
        (protocols[i % len(protocols)], FIRST_NODE + i, int(bus_count == 2 and i >= 2))
        for i in range(4)
    ]
    for k in range(tick_count):
        frames = [Frame(0x080, bytes((k & 0xFF,)))]
        for protocol, node, bus in drives:
            sent_frames = (
                enable_frames(protocol, node)
                if k == 2
                else frames_of_tick(protocol, node, k)
                if k > 2
                else []
            )
            frames += [Frame(can_id, data, 0, bus, k) for can_id, data in sent_frames]
        yield (
            [sent_frame for frame in frames for sent_frame in disturb_frame(frame, rng)]
            if seed
            else frames
        )


EXCHANGE_CASES = [
    *[((protocol,), 1, seed) for protocol in TESTED_PROTOCOLS for seed in (0, 1, 2)],
    (("mit", "odrive", "cia402", "mit"), 1, 3),
    (("mit", "odrive", "cia402", "cia402"), 2, 4),
]


@pytest.mark.parametrize(("protocols", "bus_count", "seed"), EXCHANGE_CASES)
def test_the_kernel_answers_as_the_nodes_do(
    protocols: tuple[str, ...], bus_count: int, seed: int, tmp_path: Path
) -> None:
    hand = hand_file(tmp_path, protocols, bus_count)
    simulated_hands = [
        LockstepHand(hand, seed=3, truth_path=str(tmp_path / name)) for name in ("kernel", "nodes")
    ]
    simulated_hands[
        1
    ].world.faults.in_frames = True  # process every frame with the Python code of the nodes
    reply_count = 0
    for k, frames in enumerate(frames_of_ticks(protocols, 400, seed, bus_count)):
        replies, node_replies = (
            simulated_hand.step(k * TICK_NS, frames) for simulated_hand in simulated_hands
        )
        assert replies == node_replies, f"tick {k}"
        reply_count += len(replies)
    for simulated_hand in simulated_hands:
        simulated_hand.close()
    assert reply_count > 400 * 3
    truth_of_kernel, truth_of_nodes = (read_truth(tmp_path / name) for name in ("kernel", "nodes"))
    assert np.array_equal(truth_of_kernel.values, truth_of_nodes.values)
    assert (
        simulated_hands[0].world.foreign_frame_count == simulated_hands[1].world.foreign_frame_count
    )
    assert (
        simulated_hands[0].world.malformed_frame_count
        == simulated_hands[1].world.malformed_frame_count
    )
    if not seed:
        assert truth_of_kernel.column("tension/index_tendon").max() > 10.0, (
            "the drives follow their torques"
        )


@pytest.mark.parametrize("protocol", TESTED_PROTOCOLS)
def test_cyclic_frames_do_not_reach_the_nodes_one_by_one(protocol: str, tmp_path: Path) -> None:
    simulated_hand = LockstepHand(hand_file(tmp_path, (protocol,)), seed=3)
    received = []
    receive = simulated_hand.world.receive
    simulated_hand.world.receive = lambda frame: received.append(frame) or receive(frame)  # type: ignore[method-assign, func-returns-value]
    for k, frames in enumerate(frames_of_ticks((protocol,), 300, 0)):
        if k == 10:
            received.clear()
        simulated_hand.step(k * TICK_NS, frames)
    assert len(received) < 20, "nodes receive only the requests of temperatures, every 100 ms"


def test_records_are_frames() -> None:
    frames = [
        Frame(0x123, b"abc", FDF, 1, 5),
        Frame(0x1FFFFFFF | EXTENDED_FLAG, bytes(range(64)), FDF | BRS, 0, -1),
    ]
    records = frames_to_records(frames)
    assert records.dtype == FRAME_DTYPE
    assert FRAME_DTYPE.itemsize == 80
    assert records["length"].tolist() == [3, 64]
    assert records[0]["data"].tolist() == [*b"abc", *bytes(61)]
    assert records_to_frames(records) == frames
    assert records_to_frames(frames_to_records([])) == []


def test_exchange_takes_and_returns_records(tmp_path: Path) -> None:
    simulated_hands = [LockstepHand("jamia", seed=1), LockstepHand("jamia", seed=1)]
    frames = [Frame(0x080, b"\0"), *[Frame(node, bytes(8), BRS | FDF) for node in (1, 2, 3, 4)]]
    readonly_records = np.frombuffer(frames_to_records(frames).tobytes(), FRAME_DTYPE)
    for k in range(3):
        replies = simulated_hands[0].exchange(k * TICK_NS, readonly_records)
        assert replies.dtype == FRAME_DTYPE
        assert records_to_frames(replies) == simulated_hands[1].step(k * TICK_NS, frames)
        assert all(not row["data"][row["length"] :].any() for row in replies)
        assert np.all(np.diff(replies["t_ns"]) >= 0)
    assert len(simulated_hands[0].exchange(3 * TICK_NS, frames_to_records([]))) == 0


def test_memory_grows_for_every_answer() -> None:
    simulated_hand = LockstepHand("jamia", seed=1)
    frames = [Frame(node, bytes(8)) for node in (1, 2, 3, 4)] * 100
    reply_ids = [reply.can_id for reply in simulated_hand.step(0, frames)]
    assert reply_ids == [0x11, 0x12, 0x13, 0x14] * 100
    simulated_hand.inject("flood bus=main")
    assert len(simulated_hand.step(TICK_NS, frames)) > 400


def test_a_new_identifier_is_valid_from_the_next_frame() -> None:
    simulated_hand = LockstepHand("jamia", seed=1)
    simulated_hand.step(0, [Frame(2, bytes(8))])
    write = Frame(0x7FF, struct.pack("<HBBI", 2, 0x55, 8, 0x42))
    replies = simulated_hand.step(
        TICK_NS, [Frame(2, bytes(8)), write, Frame(2, bytes(8)), Frame(0x42, bytes(8))]
    )
    assert [reply.can_id for reply in replies] == [0x12] * 3
    assert simulated_hand.world.foreign_frame_count == 1


def test_a_wrong_bus_is_refused() -> None:
    simulated_hand = LockstepHand("jamia")
    with pytest.raises(IndexError):
        simulated_hand.step(0, [Frame(0x080, b"\0", 0, 1)])


def test_a_kernel_is_compiled_again_if_an_imported_module_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from firmware_sim.nodes.mit import codec

    modules = set(compiled._imported_kernels(cyclic_kernels).values())
    assert codec in modules
    digest_before = compiled._source_digest(modules)
    changed = tmp_path / "codec.py"
    changed.write_text(Path(codec.__file__).read_text() + "\n")
    monkeypatch.setattr(codec, "__file__", str(changed))
    assert compiled._source_digest(modules) != digest_before


def test_frames_in_every_second_row_of_an_array_are_read_correctly(tmp_path: Path) -> None:
    """The host can pass a part of an array whose records are not one after the other."""
    hands = [LockstepHand(hand_file(tmp_path, ("mit",)), homed=True) for _ in range(2)]
    nodes = range(FIRST_NODE, FIRST_NODE + 4)
    for hand in hands:
        hand.step(0, [Frame(*frame) for node in nodes for frame in enable_frames("mit", node)])
    commands = frames_to_records(
        [Frame(*frame) for node in nodes for frame in frames_of_tick("mit", node, 0)]
    )
    rows = np.zeros(2 * len(commands), FRAME_DTYPE)
    rows[::2] = commands
    answers, answers_to_rows = (
        hand.exchange(TICK_NS, frames)
        for hand, frames in zip(hands, (commands, rows[::2]), strict=True)
    )
    assert len(answers) == len(commands)
    assert answers.tobytes() == answers_to_rows.tobytes()
