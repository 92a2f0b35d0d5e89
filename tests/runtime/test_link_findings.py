"""Test which problems of a CAN interface handctl finds in the output of ``ip``.

The outputs of ``ip`` in the tests are invented, in the format of iproute2.
"""

import json

import pytest

from handctl.runtime.buses.adapter import UsbAdapter, read_adapter
from handctl.runtime.buses.interface_setup import interface_setup_commands
from handctl.runtime.buses.link_state import parse_link
from handctl.runtime.diagnostics.link_findings import (
    adapter_findings,
    interface_findings,
    missing_interface_finding,
)

MEGABIT_PER_S = 1_000_000


def link_json(**changed_values) -> str:
    """Return the output of ``ip -details -statistics -json`` about a good CAN interface, with some values changed."""
    data = {
        "state": "ERROR-ACTIVE",
        "berr_counter": {"tx": 0, "rx": 0},
        "restart_ms": 100,
        "bittiming": {"bitrate": MEGABIT_PER_S, "sample_point": "0.875"},
    } | changed_values.get("data", {})
    link = {
        "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "mtu": 16, "txqlen": 128, "link_type": "can",
        "linkinfo": {"info_kind": "can", "info_data": data,
                     "info_xstats": changed_values.get("xstats", {"bus_off": 0})},
        "stats64": {"rx": {"dropped": 0}, "tx": {"dropped": 0}},
    }  # fmt: skip
    return json.dumps([link | changed_values.get("link", {})])


def failed_findings(ip_output, data_bitrate=None):
    link = parse_link(ip_output)
    assert link is not None
    return [
        finding
        for finding in interface_findings("can0", link, MEGABIT_PER_S, data_bitrate)
        if not finding.is_good
    ]


def test_a_good_interface_has_only_good_findings():
    assert failed_findings(link_json()) == []
    fast_link = {"link": {"mtu": 72}, "data": {"data_bittiming": {"bitrate": 5 * MEGABIT_PER_S}}}
    assert failed_findings(link_json(**fast_link), 5 * MEGABIT_PER_S) == []


@pytest.mark.parametrize(
    ("changed_values", "finding_subject", "correction"),
    [
        ({"link": {"flags": ["NOARP"]}}, "is down", "sudo ip link set can0 up"),
        (
            {"data": {"bittiming": {"bitrate": 500_000}}},
            "500000, the hand needs 1000000",
            "bitrate 1000000",
        ),
        ({"data": {"bittiming": {}}}, "not set", "bitrate 1000000"),
        ({"link": {"txqlen": 10}}, "queue of 10", 'ATTR{tx_queue_len}="128"'),
        ({"data": {"state": "BUS-OFF"}}, "BUS-OFF", "sudo ip link set can0 type can restart"),
        ({"data": {"berr_counter": {"tx": 128, "rx": 0}}}, "128 sending", "120 ohm"),
        ({"data": {"restart_ms": 0}}, "0 ms after bus-off", "restart-ms 100"),
        (
            {"xstats": {"error_passive": 3, "arbitration_lost": 7}},
            "3 times error passive",
            "120 ohm",
        ),
        ({"link": {"stats64": {"tx": {"dropped": 9}}}}, "9 dropped transmit frames", "after a run"),
    ],
)
def test_each_finding_names_the_command_that_corrects_it(
    changed_values, finding_subject, correction
):
    (finding,) = failed_findings(link_json(**changed_values))
    assert finding_subject in finding.observation
    assert correction in finding.remedy


def test_missing_fd_is_found_where_the_hand_needs_it():
    texts = failed_findings(link_json(), 5 * MEGABIT_PER_S)
    assert ["does not carry CAN FD" in finding.observation for finding in texts] == [True, False]
    assert "dbitrate 5000000 fd on" in texts[0].remedy


@pytest.mark.parametrize("data_bitrate", [None, 5 * MEGABIT_PER_S])
def test_the_set_up_of_a_finding_is_that_of_bus_up(data_bitrate):
    """Reproduce a defect.

    The command that handctl proposed to set up a CAN interface did not set ``restart-ms``. After
    the user had executed the command, handctl demanded ``restart-ms`` in a second finding.
    """
    (finding, *_) = failed_findings(link_json(link={"flags": ["NOARP"]}), data_bitrate)
    commands = interface_setup_commands("can0", MEGABIT_PER_S, data_bitrate, interface_exists=True)
    assert finding.remedy.split(" && ") == ["sudo " + " ".join(command) for command in commands]
    assert "restart-ms 100" in finding.remedy


def test_lost_arbitration_alone_is_no_fault():
    assert failed_findings(link_json(xstats={"arbitration_lost": 7})) == []


def test_a_missing_interface_comes_with_the_command():
    assert "udev" in missing_interface_finding("can3", MEGABIT_PER_S, None).remedy
    assert "type vcan" in missing_interface_finding("vcan3", MEGABIT_PER_S, None).remedy


@pytest.mark.parametrize("ip_output", ["", "[]", "Device does not exist", "{"])
def test_invalid_output_of_ip_is_no_link(ip_output):
    assert parse_link(ip_output) is None


def usb_interface(folder, driver_name="gs_usb", usb_speed="12", serial_number="0042"):
    """Make a folder that imitates /sys/class/net, and return the path of this folder.

    The imitated folder contains only the interface can0, which belongs to a USB adapter.
    """
    usb = folder / "usb1" / "1-1"
    (usb / "1-1:1.0").mkdir(parents=True)
    (folder / "drivers" / driver_name).mkdir(parents=True)
    (usb / "1-1:1.0" / "driver").symlink_to(folder / "drivers" / driver_name)
    (usb / "speed").write_text(f"{usb_speed}\n")
    (usb / "serial").write_text(f"{serial_number}\n")
    (folder / "net" / "can0").mkdir(parents=True)
    (folder / "net" / "can0" / "device").symlink_to(usb / "1-1:1.0")
    return folder / "net"


def test_the_adapter_of_an_interface_is_read(tmp_path):
    network = usb_interface(tmp_path)
    assert read_adapter("can0", network) == UsbAdapter("gs_usb", 12.0, "0042")
    assert read_adapter("vcan0", network) is None


def test_a_controller_without_usb_has_no_speed(tmp_path):
    spi = tmp_path / "spi0.0"
    spi.mkdir()
    (tmp_path / "mcp251xfd").mkdir()
    (spi / "driver").symlink_to(tmp_path / "mcp251xfd")
    (tmp_path / "net" / "can0").mkdir(parents=True)
    (tmp_path / "net" / "can0" / "device").symlink_to(spi)
    assert read_adapter("can0", tmp_path / "net") == UsbAdapter("mcp251xfd", 0.0, "")


@pytest.mark.parametrize(
    ("adapter", "adapter_kind", "is_good", "expected_message"),
    [
        (UsbAdapter("gs_usb", 12.0, "0042"), "can", True, "at most 333 Hz"),
        (UsbAdapter("peak_usb", 480.0, "1"), "can", True, "USB 480 Mbit/s"),
        (UsbAdapter("mttcan"), "can", True, "driver mttcan"),
        (UsbAdapter("mcp251x"), "can", False, "two receive buffers"),
        (None, "slcan", False, "serial line"),
    ],
)
def test_each_adapter_type_has_a_finding(adapter, adapter_kind, is_good, expected_message):
    last_adapter_finding = adapter_findings("can0", adapter, adapter_kind, [])[-1]
    assert (
        last_adapter_finding.is_good,
        expected_message in last_adapter_finding.observation,
        bool(last_adapter_finding.remedy),
    ) == (
        is_good,
        True,
        not is_good,
    )


def test_a_virtual_interface_has_no_adapter():
    assert adapter_findings("vcan0", None, "vcan", ["can0"]) == []


def test_two_usb_adapters_get_names_by_their_serial_numbers():
    (_, name) = adapter_findings("can0", UsbAdapter("gs_usb", 480.0, "0042"), "can", ["can1"])
    assert 'ATTRS{serial}=="0042", NAME="can0"' in name.observation
