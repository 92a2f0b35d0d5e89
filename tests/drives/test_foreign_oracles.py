"""Compare the encoders and decoders of handctl with those of other software.

Frames of an ODrive are compared with ODrive's own DBC file. Frames of CiA 402 drives are compared
with the package canopen and the packaged EDS file.
"""

import struct
from pathlib import Path

import canopen
import cantools.database
import odrive_can
import pytest

from firmware_sim.bus.frame import REMOTE_FLAG, Frame
from firmware_sim.nodes.cia402.object_dictionary import EDS_PATH, ObjectDictionary
from firmware_sim.programs.drive import SimulatedDriveBench
from firmware_sim.programs.drive_types import drive_spec
from handctl.drives.canopen.setup import ObjectCheck
from handctl.drives.cia402 import settings as setup
from handctl.drives.odrive import codec

ODRIVE_NODE_ID = 3


@pytest.fixture(scope="module")
def vendor_dbc() -> cantools.database.can.Database:
    files = list(Path(odrive_can.__file__).parent.rglob("odrive-cansimple*0.6*.dbc"))
    assert files, "the package has lost its DBC"
    database = cantools.database.load_file(files[0])
    assert isinstance(database, cantools.database.can.Database)
    return database


@pytest.mark.parametrize(
    ("message_name", "command_number"),
    [
        ("Get_Version", codec.GET_VERSION),
        ("Heartbeat", codec.HEARTBEAT),
        ("Estop", codec.ESTOP),
        ("Set_Axis_State", codec.SET_AXIS_STATE),
        ("Get_Encoder_Estimates", codec.ENCODER_ESTIMATES),
        ("Set_Controller_Mode", codec.SET_MODE),
        ("Set_Input_Torque", codec.SET_TORQUE),
        ("Set_Limits", codec.SET_LIMITS),
        ("Get_Temperature", codec.TEMPERATURE),
        ("Clear_Errors", codec.CLEAR_ERRORS),
        ("Get_Torques", codec.TORQUES),
    ],
)
def test_identifiers_are_the_vendors(
    vendor_dbc: cantools.database.can.Database, message_name: str, command_number: int
) -> None:
    assert vendor_dbc.get_message_by_name(
        f"Axis{ODRIVE_NODE_ID}_{message_name}"
    ).frame_id == codec.message_id(ODRIVE_NODE_ID, command_number)


def test_payloads_are_the_vendors(vendor_dbc: cantools.database.can.Database) -> None:
    limits = vendor_dbc.decode_message(
        f"Axis{ODRIVE_NODE_ID}_Set_Limits", codec.encode_floats(12.5, 9.75)
    )
    assert list(limits.values()) == [12.5, 9.75]
    mode = vendor_dbc.decode_message(
        f"Axis{ODRIVE_NODE_ID}_Set_Controller_Mode",
        codec.encode_integers(1, 1),
        decode_choices=False,
    )
    assert list(mode.values()) == [1, 1]
    torque = vendor_dbc.decode_message(
        f"Axis{ODRIVE_NODE_ID}_Set_Input_Torque", codec.encode_floats(-0.5).ljust(8, b"\0")
    )
    assert next(iter(torque.values())) == -0.5


@pytest.mark.parametrize("error_bit", sorted(codec.ERROR_TEXTS))
def test_errors_are_the_vendors(vendor_dbc: cantools.database.can.Database, error_bit: int) -> None:
    data = struct.pack("<IBBBB", 1 << error_bit, codec.IDLE, 3, 0, 0)
    vendor_message = vendor_dbc.decode_message(
        f"Axis{ODRIVE_NODE_ID}_Heartbeat", data, decode_choices=False
    )
    heartbeat = codec.decode_heartbeat(data)
    assert (
        vendor_message["Axis_Error"],
        vendor_message["Axis_State"],
        vendor_message["Procedure_Result"],
    ) == heartbeat


def test_what_a_simulated_odrive_answers_is_a_message_of_the_vendor(
    vendor_dbc: cantools.database.can.Database,
) -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", ODRIVE_NODE_ID)])
    bench.advance(150_000_000)
    frames = bench.take_unsolicited_frames()
    for message in vendor_dbc.messages:
        if message.name.startswith(f"Axis{ODRIVE_NODE_ID}_Get_"):
            frames += bench.receive(Frame(message.frame_id | REMOTE_FLAG, b""))
    assert {frame.can_id & 0x1F for frame in frames} >= {
        0x00,
        0x01,
        0x03,
        0x09,
        0x14,
        0x15,
        0x17,
        0x1C,
    }
    for frame in frames:
        message = vendor_dbc.get_message_by_frame_id(frame.can_id)
        assert message.length == len(frame.data) == 8, message.name
        assert message.decode(frame.data)


def test_a_simulated_odrive_obeys_what_the_vendors_dbc_encodes(
    vendor_dbc: cantools.database.can.Database,
) -> None:
    bench = SimulatedDriveBench([drive_spec("odrive", ODRIVE_NODE_ID)])
    orders: list[tuple[str, dict[str, object]]] = [
        ("Set_Controller_Mode", {"Control_Mode": "TORQUE_CONTROL", "Input_Mode": "PASSTHROUGH"}),
        ("Set_Limits", {"Velocity_Limit": 20.0, "Current_Limit": 5.0}),
        ("Clear_Errors", {"Identify": 0}),
        ("Set_Axis_State", {"Axis_Requested_State": "CLOSED_LOOP_CONTROL"}),
        ("Set_Input_Torque", {"Input_Torque": 0.125}),
    ]
    for name, values in orders:
        message = vendor_dbc.get_message_by_name(f"Axis{ODRIVE_NODE_ID}_{name}")
        bench.receive(Frame(message.frame_id, message.encode(values)))
    assert bench.motors[0].servo.torque == 0.125
    (reply,) = bench.receive(
        Frame(codec.message_id(ODRIVE_NODE_ID, codec.TORQUES) | REMOTE_FLAG, b"")
    )
    assert vendor_dbc.decode_message(reply.can_id, reply.data)["Torque_Target"] == 0.125
    bench.receive(
        Frame(vendor_dbc.get_message_by_name(f"Axis{ODRIVE_NODE_ID}_Estop").frame_id, b"")
    )
    assert bench.motors[0].servo.torque == 0.0


def test_canopen_reads_the_shipped_eds_as_the_drive_does() -> None:
    foreign, own_dictionary = (
        canopen.import_od(str(EDS_PATH), ODRIVE_NODE_ID),
        ObjectDictionary(ODRIVE_NODE_ID),
    )
    for step in setup.required_steps(ODRIVE_NODE_ID, 400, 2000, 50, 50):
        entry = foreign[step.number]
        variable = (
            entry
            if isinstance(entry, canopen.objectdictionary.ODVariable)
            else entry[step.sub_index]
        )
        assert (
            len(variable)
            == 8 * step.size
            == 8 * own_dictionary.object_size((step.number, step.sub_index))
        )
        assert (
            variable.default == own_dictionary[step.number, step.sub_index] or step.number == 0x6076
        )
        assert variable.writable == (
            step.check in (ObjectCheck.WRITE, ObjectCheck.WRITE_IF_PRESENT)
        )
