"""The MuJoCo model of a hand and a scene, as text in the format MJCF.

The world frame of the model is the palm frame.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from firmware_sim.description.hand_description import Digit, Hand, LinkMesh, TendonSpec
from firmware_sim.scene.scene import GraspObject, Scene, SinkingTable

STEP_S = 0.5e-3
"""Time step of the plant [s]. Source: MODEL, section 6: 15 of 15 grasps hold at 0.5 ms with armature 1e-6 kg m2."""
HAND_FRICTION_COEFFICIENT = 0.5
"""Sliding friction coefficient of links and palm in scenes without an object."""

OBJECT_COLLISION_BIT = 1
"""Collision category of the object.

Two shapes collide if the category of one shape is in the affinity of the other shape.
"""
FINGER_COLLISION_BIT = 2
"""Collision category of the digits that close from the same side as the first digit."""
OPPOSED_DIGIT_COLLISION_BIT = 4
"""Collision category of the digits that close against the first digit."""
PALM_COLLISION_BIT = 8
"""Collision category of the palm."""
TABLE_COLLISION_BIT = 16
"""Collision category of the table."""
PALM_DEPTH_M = 0.02
"""Depth of the palm box [m].

The front face of the palm is at the digit mount with the smallest x, usually at x = 0.
"""
PALM_MARGIN_M = 0.01
"""Distance by which the palm extends beyond the outermost digit mounts [m]."""
SAMPLES_PER_LINK = 9
"""Number of points along a link for the check of overlap with the palm."""
MIN_PLATE_GRAVITY_FRACTION = 0.1
"""Fraction of gravity along an axis above which a plate of the table supports the object along this axis.

An object on a plane that is tilted by 6 deg neither slides nor tips over.
"""
TABLE_HALF_EXTENTS = (0.12, 0.12, 0.005)
"""Half extents of the table along x, y, z [m]."""
VISUAL_GEOM_GROUP = 2
"""MuJoCo group of the meshes. Viewers show the groups 0 to 2."""
COLLISION_GEOM_GROUP = 3
"""MuJoCo group of the shapes that meshes replace in pictures. Viewers do not show the group 3."""
ZERO_FACTOR_TOLERANCE = 1e-9
"""Largest factor of a joint in a loopback tendon that counts as 0."""
COUPLING_STIFFNESS = 'solref="0.004 1" solimp="0.99 0.999 0.001"'
"""Stiffness of the constraint that keeps the length of a loopback tendon.

The constraint is at least as stiff as the contacts.
"""
MAX_CONTACTS = 16
"""Maximum number of measured contacts between a digit and the object.

MuJoCo makes at most two contacts for each link.
"""

_OPTIONS = f"""
  <compiler angle="degree" eulerseq="XYZ" autolimits="true"/>
  <option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" impratio="100" gravity="{{gravity}}">
    <flag island="disable" autoreset="disable"/>
  </option>
  <default>
    <geom condim="4" solref="0.004 1" solimp="0.95 0.99 0.001" friction="{{friction}} 0.005 0.0001"/>
    <joint type="hinge" solreflimit="0.002 1" solimplimit="0.99 0.9999 0.001"/>
    <default class="palm">
      <geom contype="{{palm_category}}" conaffinity="{OBJECT_COLLISION_BIT}"/>
    </default>
  </default>
"""
"""Options and defaults of the engine. The function ``model_text`` states the source of the settings."""


def model_text(hand: Hand, scene: Scene, meshes: bool = False) -> str:
    """Build the model of a hand and a scene as MJCF text.

    The joints in the model have the same order as in the hand. In qpos and qvel, the joints of the
    hand come first, and the free joint of the object follows. The contacts in the model are softer
    than in the source (MODEL, section 6), which gives a solref of 0.002. With a solref of 0.002,
    the penetration in a grasp would be less than the error of the collision detector, so contacts
    would vanish for single steps. Section 6 of the document MODEL is also the source of all other
    MuJoCo settings.

    Args:
        hand: description of the hand.
        scene: object and support, as the scene file describes them.
        meshes: True for a model that is drawn. In this model, links with a mesh show the mesh, and
            the capsules of these links are in the hidden group. Meshes have neither mass nor
            contacts. The plant uses a model without meshes.
    """
    mesh_by_link = {mesh.link: mesh for mesh in hand.meshes} if meshes else {}
    friction = scene.grasp_object.friction if scene.grasp_object else HAND_FRICTION_COEFFICIENT
    options = _OPTIONS.format(
        gravity=_numbers_text(hand.gravity),
        friction=friction,
        palm_category=PALM_COLLISION_BIT if scene.palm_contact else 0,
    )
    is_digit_opposed = dict(
        zip((digit.name for digit in hand.digits), opposed_digits(hand), strict=True)
    )
    scene_bodies = (_object_element(scene.grasp_object) if scene.grasp_object else "") + (
        _table_element(scene.grasp_object, scene.support, hand.gravity)
        if scene.grasp_object
        else ""
    )
    tendons = "".join(_tendon_element(tendon) for tendon in hand.all_tendons)
    loopback_by_name = {
        name: text
        for digit in hand.digits
        for name, text in _loopback_elements(hand, digit).items()
    }
    sensors = "".join(_contact_sensor(hand, digit) for digit in hand.digits)
    if scene.load:
        sensors += "".join(_normal_force_sensor(hand, digit) for digit in hand.digits)
    palm = _palm_element(hand, "", is_digit_opposed, mesh_by_link)
    model_start = f'<mujoco model="{hand.name}">{options}{_mesh_assets(mesh_by_link)}'
    return (
        f"{model_start}<worldbody>\n{palm}\n{scene_bodies}</worldbody>\n"
        f"<tendon>{tendons}{''.join(loopback_by_name.values())}</tendon>\n{_equality_element(loopback_by_name)}"
        f"<sensor>{sensors}</sensor>\n</mujoco>"
    )


def opposed_digits(hand: Hand) -> list[bool]:
    """Return one flag for each digit: True if the digit closes in the opposite direction to the first finger.

    The first finger is the first digit that can close. For example, the flag is True for a thumb
    that closes against the first finger.
    """
    first_closing_direction = _closing_direction(hand, hand.closing_digits[0])
    return [
        float(first_closing_direction @ _closing_direction(hand, digit)) < 0.0
        for digit in hand.digits
    ]


def _closing_direction(hand: Hand, digit: Digit) -> Any:
    """Compute the direction in which a digit closes, in the palm frame.

    The closing direction is the y axis of the last link with all joints at zero.
    """
    direction = link_poses_at_zero(digit)[-1][1][:, 1]
    while digit.carrier:
        digit = next(
            carrier_digit for carrier_digit in hand.digits if carrier_digit.name == digit.carrier
        )
        direction = link_poses_at_zero(digit)[-1][1] @ direction
    return direction


def link_poses_at_zero(digit: Digit) -> list[tuple[Any, Any]]:
    """Compute the pose of each link of a digit with all joints at zero.

    Returns:
        Position of the joint, shape (3,) [m], and rotation, shape (3, 3), of each link. Position
        and rotation are given in the palm frame, or in the frame of the link that carries the
        digit.
    """
    position = np.array(digit.position)
    rotation = _rotation_of_rpy(digit.rpy_deg)
    poses = []
    for length, turn in zip(digit.length, digit.joint_rpy_deg, strict=True):
        rotation = rotation @ _rotation_of_rpy(turn)
        poses.append((position, rotation))
        position = position + length * rotation[:, 0]
    return poses


def _rotation_of_rpy(rpy_deg: Sequence[float]) -> Any:
    """Compute the rotation matrix of extrinsic roll, pitch and yaw [deg], shape (3, 3)."""
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(angle), math.cos(angle)) for angle in map(math.radians, rpy_deg)
    )
    x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return z @ y @ x


def _numbers_text(values: Sequence[float]) -> str:
    return " ".join(repr(value) for value in values)


def palm_box(hand: Hand, carrier: str) -> tuple[Any, Any]:
    """Compute the box of a palm, or of a link that carries digits: a square box behind the mounts of the digits.

    Args:
        hand: the hand.
        carrier: name of the digit whose last link carries other digits, or an empty text for the
            palm.

    Returns:
        Centre and half lengths of the box, each of shape (3,) [m].
    """
    mounts = np.array([digit.position for digit in hand.digits_on_carrier(carrier)])
    low = mounts.min(axis=0)
    high = mounts.max(axis=0)
    side = float((high - low)[1:].max()) / 2.0 + PALM_MARGIN_M
    centre = (low + high) / 2.0
    centre[0] = low[0] - PALM_DEPTH_M / 2.0
    return centre, np.array([PALM_DEPTH_M / 2.0, side, side])


def _mesh_assets(meshes_by_link: dict[str, LinkMesh]) -> str:
    """Build the MJCF assets of the meshes. Without meshes, the text is empty."""
    if not meshes_by_link:
        return ""
    # The setting inertia="shell" works for closed and for open surfaces. The inertia of a mesh has
    # no effect, because meshes have no mass.
    meshes = "".join(
        f'<mesh name="{link}" file={quoteattr(mesh.file)} scale="{_numbers_text(mesh.scale)}" inertia="shell"/>'
        for link, mesh in meshes_by_link.items()
    )
    return f"<asset>{meshes}</asset>"


def _mesh_geom(mesh: LinkMesh | None) -> str:
    """Build the MJCF shape that draws a mesh, without mass and without contacts.

    Without a mesh, the text is empty.
    """
    if mesh is None:
        return ""
    return (
        f'<geom name="{mesh.link}_mesh" type="mesh" mesh="{mesh.link}" group="{VISUAL_GEOM_GROUP}" mass="0"'
        f' contype="0" conaffinity="0" pos="{_numbers_text(mesh.position)}" euler="{_numbers_text(mesh.rpy_deg)}"/>'
    )


def _palm_element(
    hand: Hand, carrier: str, is_digit_opposed: dict[str, bool], meshes_by_link: dict[str, LinkMesh]
) -> str:
    """Build the palm with all attached digits.

    If ``carrier`` is the name of a digit, the palm is a box on the last link of this digit.
    """
    centre, half_sizes = palm_box(hand, carrier)
    name = f"{carrier}_palm" if carrier else "palm"
    link = f"{carrier}_link{_last_link_number(hand, carrier)}" if carrier else "palm"
    box = (
        f'<geom name="{name}" class="palm" type="box" size="{_numbers_text(half_sizes.tolist())}" '
        f'pos="{_numbers_text(centre.tolist())}"'
        f"{_group_attribute(link in meshes_by_link)}/>"
    )
    mesh = "" if carrier else _mesh_geom(meshes_by_link.get("palm"))
    digits = "\n".join(
        _digit_element(hand, digit, is_digit_opposed, meshes_by_link)
        for digit in hand.digits_on_carrier(carrier)
    )
    return f"{box}{mesh}\n{digits}\n"


def _last_link_number(hand: Hand, digit_name: str) -> int:
    """Return the number of the last link of a digit, counted from 1."""
    return next(len(digit.length) for digit in hand.digits if digit.name == digit_name)


def _group_attribute(has_mesh: bool) -> str:
    """Return the MJCF attribute that hides a shape in pictures because a mesh replaces the shape.

    Without a mesh, the text is empty.
    """
    return f' group="{COLLISION_GEOM_GROUP}"' if has_mesh else ""


def find_links_at_palm(hand: Hand, digit: Digit) -> list[bool]:
    """Find the links of a digit that must not collide with the palm or with the carrier of the digit.

    The result has one value per link. The value is True if, while all joints are at zero, the link
    overlaps the palm or the link that carries the digit. A link overlaps the palm if its hinge is
    close to the palm.
    """
    centre, half_sizes = palm_box(hand, digit.carrier)
    carrier_digits = [
        carrier_digit for carrier_digit in hand.digits if carrier_digit.name == digit.carrier
    ]
    fractions = np.linspace(0.0, 1.0, SAMPLES_PER_LINK)[:, None]
    overlaps = []
    for length, (position, rotation) in zip(digit.length, link_poses_at_zero(digit), strict=True):
        points = position + fractions * (length * rotation[:, 0])
        distance_outside = np.maximum(np.abs(points - centre) - half_sizes, 0.0)
        is_overlapping = bool((np.linalg.norm(distance_outside, axis=1) <= digit.radius).any())
        for carrier_digit in carrier_digits:
            # The link that carries the digit is a capsule along the x axis of its own frame.
            nearest_points = np.clip(points[:, :1], 0.0, carrier_digit.length[-1]) * np.array(
                [1.0, 0.0, 0.0]
            )
            is_overlapping |= bool(
                (
                    np.linalg.norm(points - nearest_points, axis=1)
                    <= digit.radius + carrier_digit.radius
                ).any()
            )
        overlaps.append(is_overlapping)
    return overlaps


def _digit_element(
    hand: Hand, digit: Digit, is_digit_opposed: dict[str, bool], meshes_by_link: dict[str, LinkMesh]
) -> str:
    """Build the nested bodies of a digit.

    Each link lies along the x axis of the link's frame, with the hinge at the origin.
    """
    opening_tag = (
        f'<frame pos="{_numbers_text(digit.position)}" euler="{_numbers_text(digit.rpy_deg)}">'
    )
    closing_tag = "</frame>"
    is_near_palm = find_links_at_palm(hand, digit)
    is_carrier = bool(hand.digits_on_carrier(digit.name))
    last_link = len(digit.length) - 1
    for i, turn in enumerate(digit.joint_rpy_deg):
        offset = f"{digit.length[i - 1] if i else 0.0} 0 0"
        opening_tag += (
            f'<body name="{digit.name}_link{i + 1}" pos="{offset}" euler="{_numbers_text(turn)}">'
        )
        collision_bits = (
            _collision_bits_of_carrier()
            if is_carrier
            else _collision_bits_of_digit(is_digit_opposed[digit.name], is_near_palm[i])
        )
        # A link that carries other digits ends at the face of the box on which these digits are
        # mounted.
        length = (
            max(digit.length[i] - digit.radius, 0.0)
            if is_carrier and i == last_link
            else digit.length[i]
        )
        mesh = meshes_by_link.get(f"{digit.name}_link{i + 1}")
        body = _link_geometry(digit, i, length, collision_bits, mesh is not None)
        opening_tag += f"{_joint_element(digit, i)}{body}{_mesh_geom(mesh)}\n"
        closing_tag = "</body>" + closing_tag
    return (
        opening_tag
        + (_palm_element(hand, digit.name, is_digit_opposed, meshes_by_link) if is_carrier else "")
        + closing_tag
    )


def _collision_bits_of_digit(is_opposed: bool, is_near_palm: bool) -> tuple[int, int]:
    """Return the collision category and the collision affinity of a link.

    All links of a digit touch the object and the opposed digits. A link that overlaps the palm
    while all joints are at zero never touches the palm.
    """
    category, opposite_category = (
        (OPPOSED_DIGIT_COLLISION_BIT, FINGER_COLLISION_BIT)
        if is_opposed
        else (FINGER_COLLISION_BIT, OPPOSED_DIGIT_COLLISION_BIT)
    )
    return category, OBJECT_COLLISION_BIT | opposite_category | (
        0 if is_near_palm else PALM_COLLISION_BIT
    )


def _collision_bits_of_carrier() -> tuple[int, int]:
    """Return the collision category and the collision affinity of the links of a digit that carries other digits.

    In MuJoCo, the category is ``contype`` and the affinity is ``conaffinity``. A digit that carries
    other digits, such as a wrist, collides with the same bodies as the palm.
    """
    return PALM_COLLISION_BIT, OBJECT_COLLISION_BIT


def _joint_element(digit: Digit, i: int) -> str:
    """Build the joint of link ``i`` of a digit."""
    # Angles of hinges are in degrees. Positions of prismatic joints are in m.
    rest_position = -digit.preload[i] if digit.prismatic[i] else -math.degrees(digit.preload[i])
    kind = ' type="slide"' if digit.prismatic[i] else ""
    return (
        f'<joint name="{digit.joints[i]}"{kind} axis="{_numbers_text(digit.axis[i])}"'
        f' range="{digit.joint_min_deg[i]} {digit.joint_max_deg[i]}" damping="{digit.damping[i]}"'
        f' armature="{digit.armature[i]}" stiffness="{digit.spring[i]}" springref="{rest_position}"/>'
    )


def _link_geometry(
    digit: Digit, i: int, length: float, collision_bits: tuple[int, int], has_mesh: bool
) -> str:
    """Build inertia and collision shape of link ``i``.

    The shape is a capsule of the given length [m], or a ball if the length is 0.
    """
    moments = digit.inertia[i]
    inertia = (
        f'fullinertia="{_numbers_text(moments)}"'
        if any(moments[3:])
        else f'diaginertia="{_numbers_text(moments[:3])}"'
    )
    shape = f'type="capsule" fromto="0 0 0 {length} 0 0"' if length else 'type="sphere"'
    return (
        f'<inertial pos="{_numbers_text(digit.com[i])}" mass="{digit.mass[i]}" {inertia}/>'
        f'<geom {shape} size="{digit.radius}" contype="{collision_bits[0]}" conaffinity="{collision_bits[1]}"'
        f"{_group_attribute(has_mesh)}/>"
    )


def _tendon_element(tendon: TendonSpec) -> str:
    """Build the MuJoCo element of a tendon. The element has no stiffness.

    The plant sets the damping of the tendon in each step, see ``drivetrain``.
    """
    joints = "".join(f'<joint joint="{name}" coef="{arm}"/>' for name, arm in tendon.arms.items())
    return f'<fixed name="{tendon.name}" damping="{tendon.damping}">{joints}</fixed>'


def _loopback_elements(hand: Hand, digit: Digit) -> dict[str, str]:
    """Build the loopback tendons of a digit with spool pairs.

    A spool pair is two antagonistic tendons on one spool. A digit with spool pairs has no springs.
    Spool pairs alone would allow coupled joints to turn against each other. In a real hand, a
    loopback tendon or a bar between the joints prevents this motion.

    The model has loopback tendons, so that the joint angles q follow the coupling matrix B of the
    digit. Let c be a vector with B^T c = 0. The coupling keeps the weighted sum c^T q constant. For
    each vector c, the model has a loopback tendon with the length c^T q. ``_equality_element``
    keeps this length constant.

    Returns:
        The loopback tendons by name. In the model, the loopback tendons come after the tendons of
        ``Hand.all_tendons``.
    """
    if not digit.coupling or not hand.has_spool_pairs(digit):
        return {}
    left_vectors, values, _ = np.linalg.svd(np.array(digit.coupling))
    tendons = {}
    for i, row in enumerate(left_vectors[:, len(values) :].T.tolist()):
        joints = "".join(
            f'<joint joint="{joint}" coef="{factor}"/>'
            for joint, factor in zip(digit.joints, row, strict=True)
            if abs(factor) > ZERO_FACTOR_TOLERANCE
        )
        name = f"{digit.name}_loopback{i + 1}"
        tendons[name] = f'<fixed name="{name}">{joints}</fixed>'
    return tendons


def _equality_element(loopback_names: Iterable[str]) -> str:
    """Build the constraints that keep the lengths of the loopback tendons constant.

    Without loopback tendons, the returned text is empty.
    """
    constraints = "".join(
        f'<tendon tendon1="{name}" {COUPLING_STIFFNESS}/>' for name in loopback_names
    )
    return f"<equality>{constraints}</equality>\n" if constraints else ""


def _contact_sensor(hand: Hand, digit: Digit) -> str:
    """Build the MuJoCo sensor that measures the total contact force on a digit."""
    return (
        f'<contact name="contact/{digit.name}" {_contact_bodies_attribute(hand, digit)} '
        'num="1" reduce="netforce" data="force"/>'
    )


def _normal_force_sensor(hand: Hand, digit: Digit) -> str:
    """Build the MuJoCo sensor that measures the contact forces between a digit and the object.

    Axis 1 of each measured force is along the normal of the contact.
    """
    return (
        f'<contact name="normal/{digit.name}" {_contact_bodies_attribute(hand, digit)} geom2="object"'
        f' num="{MAX_CONTACTS}"'
        ' reduce="maxforce" data="force"/>'
    )


def _contact_bodies_attribute(hand: Hand, digit: Digit) -> str:
    """Return the MJCF attribute that selects the bodies whose contacts a sensor measures.

    The sensor measures the contacts of all links of a digit, but only of the last link if the digit
    carries other digits.
    """
    if hand.digits_on_carrier(digit.name):
        return f'body1="{digit.name}_link{len(digit.length)}"'
    return f'subtree1="{digit.name}_link1"'


def _object_element(grasp_object: GraspObject) -> str:
    """Build the object as a free body."""
    half_sizes = tuple(extent / 2.0 for extent in grasp_object.size)
    size = {
        "cylinder": (half_sizes[0], half_sizes[2]),
        "sphere": half_sizes[:1],
        "box": half_sizes,
    }[grasp_object.shape]
    return (
        f'<body name="object" pos="{_numbers_text(grasp_object.position)}"><freejoint name="object"/>'
        f'<geom name="object" type="{grasp_object.shape}" size="{_numbers_text(size)}" mass="{grasp_object.mass}"'
        f' contype="{OBJECT_COLLISION_BIT}" conaffinity="{TABLE_COLLISION_BIT}"/></body>\n'
    )


def _table_element(
    grasp_object: GraspObject, support: SinkingTable | None, gravity: Sequence[float]
) -> str:
    """Build the table under the object. If the scene has no support, the returned text is empty.

    The first plate of the table is perpendicular to the axis of the palm frame along which gravity
    is largest. If gravity is not parallel to this axis, the table has further plates, which keep
    the object from sliding and from tipping over.
    """
    if support is None:
        return ""
    position = table_position(grasp_object, gravity)
    plates = ""
    for i, (normal, sign) in enumerate(_support_directions(gravity)):
        offset = np.subtract(_plate_position(grasp_object, normal, sign), position)
        position_attribute = "" if i == 0 else f' pos="{_numbers_text(offset.tolist())}"'
        size = _numbers_text(_plate_half_extents(normal))
        plates += (
            f'<geom name="{"table" if i == 0 else f"table{i + 1}"}" type="box"{position_attribute} size="{size}"'
            f' contype="{TABLE_COLLISION_BIT}" conaffinity="{OBJECT_COLLISION_BIT}"/>'
        )
    x, y, z = position
    return f'<body name="table" mocap="true" pos="{x} {y} {z}">{plates}</body>\n'


def scene_shapes(scene: Scene, gravity: Sequence[float]) -> dict[str, dict[str, object]]:
    """Return the shapes and lengths [m] of object and table, for drawing.

    For the table, the result also contains the position of its first plate [m], and the direction
    in which the table sinks.

    Args:
        scene: object and support, as the scene file describes them.
        gravity: acceleration of gravity in the palm frame (3,) [m/s2].
    """
    if scene.grasp_object is None:
        return {}
    grasp_object: dict[str, object] = {
        "shape": scene.grasp_object.shape,
        "size_m": scene.grasp_object.size,
    }
    if scene.support is None:
        return {"object": grasp_object}
    normal, _ = _support_directions(gravity)[0]
    size = tuple(2.0 * half_size for half_size in _plate_half_extents(normal))
    position = table_position(scene.grasp_object, gravity)
    return {
        "object": grasp_object,
        "table": {
            "shape": "box",
            "size_m": size,
            "position_m": position,
            "sink_direction": sink_direction(gravity),
        },
    }


def table_position(
    grasp_object: GraspObject, gravity: Sequence[float]
) -> tuple[float, float, float]:
    """Return the centre of the table at the start, when the object lies on the table [m].

    Args:
        grasp_object: object of the scene.
        gravity: acceleration of gravity in the palm frame (3,) [m/s2].
    """
    return _plate_position(grasp_object, *_support_directions(gravity)[0])


def sink_direction(gravity: Sequence[float]) -> tuple[float, float, float]:
    """Return the direction in which the table sinks: that of gravity, or -z without gravity.

    Args:
        gravity: acceleration of gravity in the palm frame (3,) [m/s2].
    """
    norm = math.hypot(*gravity)
    if norm == 0.0:
        return (0.0, 0.0, -1.0)
    x, y, z = (value / norm for value in gravity)
    return (x, y, z)


def _support_directions(gravity: Sequence[float]) -> list[tuple[int, float]]:
    """Return the axes of the palm frame along which a plate supports the object.

    Each item of the result is the index of an axis, and the sign of gravity's component along this
    axis. The first item is the axis along which gravity is largest.
    """
    direction = sink_direction(gravity)
    axes = sorted(range(3), key=lambda i: -abs(direction[i]))
    return [
        (i, math.copysign(1.0, direction[i]))
        for i in axes
        if i == axes[0] or abs(direction[i]) > MIN_PLATE_GRAVITY_FRACTION
    ]


def _plate_position(
    grasp_object: GraspObject, normal: int, sign: float
) -> tuple[float, float, float]:
    """Return the centre of a plate that is perpendicular to an axis and touches the object [m].

    Args:
        grasp_object: object of the scene.
        normal: index of the axis that is perpendicular to the plate.
        sign: 1 for the side of the positive axis, and -1 for the other side.
    """
    position = list(grasp_object.position)
    position[normal] += sign * (grasp_object.size[normal] / 2.0 + TABLE_HALF_EXTENTS[2])
    x, y, z = position
    return (x, y, z)


def _plate_half_extents(normal: int) -> tuple[float, float, float]:
    """Return the half lengths of a plate that is perpendicular to the given axis of the palm frame [m]."""
    width, _, thickness = TABLE_HALF_EXTENTS
    x, y, z = (thickness if i == normal else width for i in range(3))
    return (x, y, z)
