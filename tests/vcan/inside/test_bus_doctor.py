"""Test that ``handctl bus doctor`` and ``scan`` report the real state of a SocketCAN interface."""

import json
import subprocess

import pytest

from handctl.cli.main import main
from handctl.runtime.buses.link_state import read_link
from tests.drives.bench_process import run_simulated_drives


def test_the_kernel_s_interfaces_are_read() -> None:
    link = read_link("vcan0")
    assert link is not None
    assert (link.is_up, link.kind, link.is_fd, link.bitrate, link.controller_state) == (
        True,
        "vcan",
        True,
        None,
        "",
    )
    assert link.tx_queue_frames >= 32
    assert read_link("vcan7") is None


def test_an_interface_that_is_down_or_absent_comes_with_the_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    subprocess.run(["ip", "link", "set", "vcan1", "down"], check=True)
    try:
        assert main(["bus", "doctor", "--bus", "socketcan:vcan1"]) == 1
        output = capsys.readouterr().out
        assert "sudo ip link set vcan1 up" in output
        assert "link add" not in output, "an existing interface is not added again"
    finally:
        subprocess.run(["ip", "link", "set", "vcan1", "up"], check=True)
    assert main(["bus", "doctor", "--bus", "socketcan:vcan7"]) == 1
    assert "sudo ip link add vcan7 type vcan" in capsys.readouterr().out


def test_a_short_queue_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    subprocess.run(["ip", "link", "set", "vcan1", "txqueuelen", "10"], check=True)
    try:
        assert main(["bus", "doctor", "--bus", "socketcan:vcan1"]) == 1
        assert "txqueuelen 128" in capsys.readouterr().out
    finally:
        subprocess.run(["ip", "link", "set", "vcan1", "txqueuelen", "1000"], check=True)


def test_nodes_are_listed_with_their_latency(capsys: pytest.CaptureFixture[str]) -> None:
    with run_simulated_drives("socketcan:vcan0", "cia402", "--ids", "32"):
        main(["bus", "doctor", "--bus", "socketcan:vcan0", "--json"])
        (bus,) = json.loads(capsys.readouterr().out)["buses"]
        assert main(["scan", "--bus", "socketcan:vcan0", "--json"]) == 0
    assert bus["nodes"][0]["answers"] == 20
    (node,) = json.loads(capsys.readouterr().out)["buses"][0]["nodes"]
    assert (node["protocol"], node["serial"]) == ("cia402", "0x53494d20")


def test_bus_up_makes_an_interface_and_sets_it_up(capsys: pytest.CaptureFixture[str]) -> None:
    try:
        assert (
            main(["bus", "up", "--bus", "socketcan:vcan7", "--data-bitrate", "5000000", "--yes"])
            == 0
        )
        link = read_link("vcan7")
        assert link is not None
        assert (link.is_up, link.kind, link.is_fd, link.tx_queue_frames) == (
            True,
            "vcan",
            True,
            128,
        )
        assert main(["bus", "up", "--bus", "socketcan:vcan7", "--yes"]) == 0, (
            "a second call succeeds"
        )
        assert "ip link set vcan7 down" in capsys.readouterr().out
    finally:
        subprocess.run(["ip", "link", "del", "vcan7"], check=True)
