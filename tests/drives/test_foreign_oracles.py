"""Codecs against what others wrote: the vendor's DBC of ODrive, and canopen's reading of the shipped EDS file.

Both packages are development dependencies; without them these tests are skipped.
"""

import importlib.util
import struct
from pathlib import Path

import cantools.database
import pytest

from firmware_sim.nodes.cia402_dictionary import EDS, Dictionary
from handctl.drives import cia402_setup as setup
from handctl.drives import odrive_codec as codec

NODE = 3


@pytest.fixture(scope="module")
def dbc() -> cantools.database.can.Database:
    spec = importlib.util.find_spec("odrive_can")
    if spec is None or spec.submodule_search_locations is None:
        pytest.skip("odrive-can is not installed")
    files = [path for root in spec.submodule_search_locations for path in Path(root).rglob("odrive-cansimple*0.6*.dbc")]
    assert files, "the package has lost its DBC"
    database = cantools.database.load_file(files[0])
    assert isinstance(database, cantools.database.can.Database)
    return database


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("Get_Version", codec.GET_VERSION),
        ("Heartbeat", codec.HEARTBEAT),
        ("Estop", codec.ESTOP),
        ("Set_Axis_State", codec.SET_AXIS_STATE),
        ("Get_Encoder_Estimates", codec.ENCODER),
        ("Set_Controller_Mode", codec.SET_MODE),
        ("Set_Input_Torque", codec.SET_TORQUE),
        ("Set_Limits", codec.SET_LIMITS),
        ("Get_Temperature", codec.TEMPERATURE),
        ("Clear_Errors", codec.CLEAR_ERRORS),
        ("Get_Torques", codec.TORQUES),
    ],
)
def test_identifiers_are_the_vendors(dbc: cantools.database.can.Database, name: str, command: int) -> None:
    assert dbc.get_message_by_name(f"Axis{NODE}_{name}").frame_id == codec.can_id(NODE, command)


def test_payloads_are_the_vendors(dbc: cantools.database.can.Database) -> None:
    limits = dbc.decode_message(f"Axis{NODE}_Set_Limits", codec.floats(12.5, 9.75))
    assert list(limits.values()) == [12.5, 9.75]
    mode = dbc.decode_message(f"Axis{NODE}_Set_Controller_Mode", codec.integers(1, 1), decode_choices=False)
    assert list(mode.values()) == [1, 1]
    torque = dbc.decode_message(f"Axis{NODE}_Set_Input_Torque", codec.floats(-0.5).ljust(8, b"\0"))
    assert next(iter(torque.values())) == -0.5


@pytest.mark.parametrize("bit", sorted(codec.ERRORS))
def test_errors_are_the_vendors(dbc: cantools.database.can.Database, bit: int) -> None:
    data = struct.pack("<IBBBB", 1 << bit, codec.IDLE, 3, 0, 0)
    known = dbc.decode_message(f"Axis{NODE}_Heartbeat", data, decode_choices=False)
    beat = codec.heartbeat(data)
    assert (known["Axis_Error"], known["Axis_State"], known["Procedure_Result"]) == beat


def test_canopen_reads_the_shipped_eds_as_the_drive_does() -> None:
    canopen = pytest.importorskip("canopen")
    foreign, ours = canopen.import_od(str(EDS), NODE), Dictionary(NODE)
    for step in setup.steps(NODE, 400, 2000, 50, 50):
        entry = foreign[step.number]
        variable = entry if isinstance(entry, canopen.objectdictionary.ODVariable) else entry[step.sub]
        assert len(variable) == 8 * step.size == 8 * ours.size((step.number, step.sub))
        assert variable.default == ours[step.number, step.sub] or step.number == 0x6076
        assert variable.writable == (step.check >= setup.Check.WRITE)
