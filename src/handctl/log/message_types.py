"""Definitions of the message types in a log, in the notation of ROS 2 interfaces.

The names and fields of these types are part of the log format, and must not change.

Source of the fields: the ROS 2 interface packages common_interfaces, rcl_interfaces, geometry2,
can_msgs, ros2_socketcan_msgs and pal_statistics_msgs. Only the types of `handctl_msgs` are defined
by this project.
"""

from handctl.core.tick_types import HandMode
from handctl.safety.safety_action import SafetyAction

PHASE_NUMBERS = {
    name: number
    for number, name in enumerate((
        "idle", "start", "home", "tighten", "move", "close", "hold", "release", "open", "end", "live", "preshape",
        "silent", "inventory", "ready", "arming", "relax", "disarm", "cut", "done",
    ))
}  # fmt: skip
"""Number of each grasp phase in the log. A phase with another name is logged as OTHER_PHASE."""
OTHER_PHASE_NUMBER = 255


def _constant_definitions(values: dict[str, int]) -> str:
    """Return the definitions of the constants of a message type, one line for each constant."""
    return "".join(f"uint8 {name.upper()}={value}\n" for name, value in values.items())


_HEADER_FIELD = "std_msgs/Header header\n"

MESSAGE_DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "std_msgs/String": "string data\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": _HEADER_FIELD
    + "string child_frame_id\ngeometry_msgs/Transform transform\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/WrenchStamped": _HEADER_FIELD + "geometry_msgs/Wrench wrench\n",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "sensor_msgs/JointState": _HEADER_FIELD
    + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    "sensor_msgs/Temperature": _HEADER_FIELD + "float64 temperature\nfloat64 variance\n",
    "can_msgs/Frame": _HEADER_FIELD
    + "uint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\nuint8[8] data\n",
    "ros2_socketcan_msgs/FdFrame": _HEADER_FIELD
    + "uint32 id\nbool is_extended\nbool is_error\nuint8 len\nuint8[<=64] data\n",
    "pal_statistics_msgs/StatisticsNames": _HEADER_FIELD + "string[] names\nuint32 names_version\n",
    "pal_statistics_msgs/StatisticsValues": _HEADER_FIELD
    + "float64[] values\nuint32 names_version\n",
    "diagnostic_msgs/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/DiagnosticStatus": "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
    "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
    "diagnostic_msgs/DiagnosticArray": _HEADER_FIELD
    + "diagnostic_msgs/DiagnosticStatus[] status\n",
    "rcl_interfaces/Log": "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
    "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n",
    "rcl_interfaces/ParameterValue": "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\n"
    "string string_value\nbyte[] byte_array_value\nbool[] bool_array_value\nint64[] integer_array_value\n"
    "float64[] double_array_value\nstring[] string_array_value\n",
    "rcl_interfaces/Parameter": "string name\nrcl_interfaces/ParameterValue value\n",
    "rcl_interfaces/ParameterEvent": "builtin_interfaces/Time stamp\nstring node\n"
    "rcl_interfaces/Parameter[] new_parameters\nrcl_interfaces/Parameter[] changed_parameters\n"
    "rcl_interfaces/Parameter[] deleted_parameters\n",
    "handctl_msgs/GraspPhase": _constant_definitions(PHASE_NUMBERS | {"other": OTHER_PHASE_NUMBER})
    + _HEADER_FIELD
    + "uint8 phase\nstring name\n",
    "handctl_msgs/Mode": _constant_definitions({mode.name: mode.value for mode in HandMode})
    + _HEADER_FIELD
    + "uint8 mode\nstring name\n",
    "handctl_msgs/Action": _constant_definitions(
        {action.name: action.value for action in SafetyAction}
    )
    + _HEADER_FIELD
    + "uint8 action\nstring name\n",
    "handctl_msgs/CycleStats": "# period: start of this tick since the start of the last one [s]; late: start\n"
    "# after the schedule [s]; last_reply: latest frame since the last tick's start [s]; missed: ticks\n"
    "# skipped before this one; stale: age of each motor's feedback [s].\n"
    + _HEADER_FIELD
    + "float64 period\nfloat64 late\nfloat64 last_reply\nuint32 missed\nuint8 mode\nuint8 action\nfloat64[] stale\n",
    "handctl_msgs/Estimate": _HEADER_FIELD
    + "string[] name\nfloat64[] value\nfloat64[] variance\nstring[] unit\n",
    "handctl_msgs/CanFrame": "# flags: BRS 1, ESI 2, FDF 4; bus: index in the hand file; data: the first eight bytes.\n"
    "int64 t_ns\nuint32 can_id\nuint16 flags\nuint8 bus\nuint8 length\nuint8[8] data\n",
    "handctl_msgs/IoEvent": "string kind\nstring where\nint64 number\n",
    "handctl_msgs/Event": "string level\nstring name\nstring where\nstring text\n",
    "handctl_msgs/Chain": "# Hash of this tick's /tick and /controller/values and of the digest before it.\n"
    + _HEADER_FIELD
    + "uint8[8] digest\n",
    "handctl_msgs/ClockPair": "# Wall and monotonic clock at the same moment [ns]; a step of the wall shows here.\n"
    + _HEADER_FIELD
    + "int64 wall_ns\nint64 monotonic_ns\n",
    "handctl_msgs/StreamTarget": "# Target of a client as it arrived. number: rises with each target;\n"
    "# age: since it was sent [s]; name: joints, digits or tendons; value: angle [deg], tension or force [N].\n"
    + _HEADER_FIELD
    + "string stream\nint64 number\nfloat64 age\nstring[] name\nfloat64[] value\n",
    "handctl_msgs/Snapshot": "# The controller's state after tick k, for the code that wrote it.\n"
    + _HEADER_FIELD
    + "int64 k\nuint8[] data\n",
    "handctl_msgs/Tick": "# One tick exactly as the controller saw it (k .. late_ns, received, io_events,\n"
    "# requests) and decided it; what re-execution reads. long_data: bytes beyond the eighth of each longer\n"
    "# frame, in order.\n"
    "int64 k\nint64 t_ns\nint64 late_ns\nuint8[8] state_hash\nuint8 mode\nuint8 action\n"
    "handctl_msgs/CanFrame[] received\nhandctl_msgs/CanFrame[] sent\nuint8[] long_data\nstring phase\n"
    "handctl_msgs/IoEvent[] io_events\nstring[] requests\nhandctl_msgs/Event[] events\n",
}
"""Definition of each message type, by name."""

_DEFINITION_SEPARATOR = "=" * 80 + "\n"


def _collect_dependencies(name: str, collected_types: dict[str, None]) -> None:
    """Collect the message types that the definition of a message type uses.

    The search is depth-first, and each type is listed only once.

    Args:
        name: name of the message type.
        collected_types: the types collected so far, in order. This function adds further types to this list.
    """
    for line in MESSAGE_DEFINITIONS[name].splitlines():
        # In a line such as "uint8[<=64] data", the type stands before the bracket, and the name of
        # the field after it.
        field_type = line.split(" ")[0].split("[")[0]
        if field_type in MESSAGE_DEFINITIONS and field_type not in collected_types:
            collected_types[field_type] = None
            _collect_dependencies(field_type, collected_types)


def schema_text(name: str) -> str:
    """Return the definitions of a message type and of all types that it uses, in the encoding ros2msg of MCAP.

    Args:
        name: message type, for example "sensor_msgs/JointState".
    """
    types: dict[str, None] = {}
    _collect_dependencies(name, types)
    return MESSAGE_DEFINITIONS[name] + "".join(
        f"{_DEFINITION_SEPARATOR}MSG: {type_name}\n{MESSAGE_DEFINITIONS[type_name]}"
        for type_name in types
    )


def schema_name(name: str) -> str:
    """Return the name of a message type in ROS 2 notation, such as "sensor_msgs/msg/JointState"."""
    package, type_name = name.split("/")
    return f"{package}/msg/{type_name}"
