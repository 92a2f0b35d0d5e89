"""MuJoCo model of a hand and a scene as MJCF text. The world frame is the palm frame."""

import math
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from firmware_sim.description import Digit, Hand, LinkMesh, TendonSpec
from firmware_sim.scene.scene import GraspObject, Scene, Support

STEP_S = 0.5e-3
"""Time step of the plant [s]. Source: MODEL, section 6: 15 of 15 grasps hold at 0.5 ms with armature 1e-6 kg m2."""
HAND_FRICTION = 0.5
"""Sliding friction coefficient of links and palm in a scene without object."""

OBJECT_BIT = 1
"""Collision category of the object. Two geoms collide if the category of one is in the affinity of the other."""
FINGER_BIT = 2
"""Collision category of the digits on the first digit's side."""
OPPOSED_BIT = 4
"""Collision category of the digits that close against the first digit."""
PALM_BIT = 8
"""Collision category of the palm."""
TABLE_BIT = 16
"""Collision category of the table."""
PALM_DEPTH = 0.02
"""Depth of the palm [m].

The face of the palm is at the mount with the smallest x, usually at x = 0.
"""
PALM_MARGIN = 0.01
"""Extent of the palm beyond the outermost mounts [m]."""
LINK_SAMPLES = 9
"""Points along a link that are compared with the palm."""
TABLE_HALF_EXTENTS = (0.12, 0.12, 0.005)
"""Half extents of the table [m]."""
VISUAL_GROUP = 2
"""Group of meshes. Viewers show the groups 0 to 2."""
HIDDEN_GROUP = 3
"""Group of the shapes of links with a mesh."""
MAX_CONTACTS = 16
"""Contacts of one digit with the object that are measured, at most two for each link."""

_OPTIONS = f"""
  <compiler angle="degree" eulerseq="XYZ" autolimits="true"/>
  <option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" impratio="100" gravity="{{gravity}}">
    <flag island="disable" autoreset="disable"/>
  </option>
  <default>
    <geom condim="4" solref="0.004 1" solimp="0.95 0.99 0.001" friction="{{friction}} 0.005 0.0001"/>
    <joint type="hinge" solreflimit="0.002 1" solimplimit="0.99 0.9999 0.001"/>
  </default>
"""
"""Engine options and defaults. Source of the settings: see ``model_text``."""


def model_text(hand: Hand, scene: Scene, meshes: bool = False) -> str:
    """Build the model as MJCF.

    Joints have the hand's order: the first entries of qpos and qvel are the joints, the object's
    free joint follows. Contact is softer than in MODEL, section 6. With solref 0.002 the
    penetration of a grasp is less than the error of the collision detector, and contacts vanish for
    single steps. Source of the other settings: MODEL, section 6.

    Args:
        hand: the hand.
        scene: object and support.
        meshes: True for a model to draw: links with a mesh show it, and their capsules are in the
            hidden group. The meshes have neither mass nor contacts. The plant has none.
    """
    shown = {mesh.link: mesh for mesh in hand.meshes} if meshes else {}
    friction = scene.grasp_object.friction if scene.grasp_object else HAND_FRICTION
    options = _OPTIONS.format(gravity=_text(hand.gravity), friction=friction)
    opposed = dict(zip((digit.name for digit in hand.digits), opposed_digits(hand), strict=True))
    scene_bodies = (_grasp_object(scene.grasp_object) if scene.grasp_object else "") + (
        _table(scene.grasp_object, scene.support) if scene.grasp_object else ""
    )
    tendons = "".join(_tendon(tendon) for tendon in hand.every_tendon)
    sensors = "".join(_contact(hand, digit) for digit in hand.digits)
    if scene.load:
        sensors += "".join(_normal(hand, digit) for digit in hand.digits)
    head = f'<mujoco model="{hand.name}">{options}{_mesh_assets(shown)}'
    return (
        f"{head}<worldbody>\n{_palm(hand, '', opposed, shown)}\n{scene_bodies}</worldbody>\n"
        f"<tendon>{tendons}</tendon>\n<sensor>{sensors}</sensor>\n</mujoco>"
    )


def opposed_digits(hand: Hand) -> list[bool]:
    """Return True for each digit that closes against the first closing digit, such as the thumb."""
    first = _closing_direction(hand, hand.closing[0])
    return [float(first @ _closing_direction(hand, digit)) < 0.0 for digit in hand.digits]


def _closing_direction(hand: Hand, digit: Digit) -> Any:
    """Compute the y axis of the last link at rest, the side of flexion, in the palm frame."""
    direction = rest_poses(digit)[-1][1][:, 1]
    while digit.carrier:
        digit = next(one for one in hand.digits if one.name == digit.carrier)
        direction = rest_poses(digit)[-1][1] @ direction
    return direction


def rest_poses(digit: Digit) -> list[tuple[Any, Any]]:
    """Compute the pose of each link with all joints at zero, in the frame of the palm or of the carrying link.

    Returns:
        Position of the joint, shape (3,) [m], and rotation, shape (3, 3), of each link.
    """
    position = np.array(digit.position)
    rotation = _rotation(digit.rpy_deg)
    poses = []
    for length, turn in zip(digit.length, digit.joint_rpy_deg, strict=True):
        rotation = rotation @ _rotation(turn)
        poses.append((position, rotation))
        position = position + length * rotation[:, 0]
    return poses


def _rotation(rpy_deg: Sequence[float]) -> Any:
    """Compute the rotation of extrinsic roll, pitch and yaw [deg], shape (3, 3)."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in map(math.radians, rpy_deg))
    x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return z @ y @ x


def _text(values: Sequence[float]) -> str:
    return " ".join(repr(value) for value in values)


def palm_box(hand: Hand, carrier: str) -> tuple[Any, Any]:
    """Compute the palm: a square box behind the mounts of all digits on a link.

    Args:
        hand: the hand.
        carrier: digit whose last link carries the digits, empty for the palm.

    Returns:
        Centre and half extents, shape (3,) each [m].
    """
    mounts = np.array([digit.position for digit in hand.carried_by(carrier)])
    low = mounts.min(axis=0)
    high = mounts.max(axis=0)
    side = float((high - low)[1:].max()) / 2.0 + PALM_MARGIN
    centre = (low + high) / 2.0
    centre[0] = low[0] - PALM_DEPTH / 2.0
    return centre, np.array([PALM_DEPTH / 2.0, side, side])


def _mesh_assets(shown: dict[str, LinkMesh]) -> str:
    """Build the assets of the meshes, empty without meshes."""
    if not shown:
        return ""
    # The inertia of a shell is also defined for open surfaces, and has no effect.
    meshes = "".join(
        f'<mesh name="{link}" file={quoteattr(mesh.file)} scale="{_text(mesh.scale)}" inertia="shell"/>'
        for link, mesh in shown.items()
    )
    return f"<asset>{meshes}</asset>"


def _mesh_geom(mesh: LinkMesh | None) -> str:
    """Build the shape of a mesh without mass and contacts, empty without mesh."""
    if mesh is None:
        return ""
    return (
        f'<geom name="{mesh.link}_mesh" type="mesh" mesh="{mesh.link}" group="{VISUAL_GROUP}" mass="0"'
        f' contype="0" conaffinity="0" pos="{_text(mesh.position)}" euler="{_text(mesh.rpy_deg)}"/>'
    )


def _palm(hand: Hand, carrier: str, opposed: dict[str, bool], shown: dict[str, LinkMesh]) -> str:
    """Build the palm, or the box on the last link of a digit, with the digits on it."""
    centre, half = palm_box(hand, carrier)
    name = f"{carrier}_palm" if carrier else "palm"
    link = f"{carrier}_link{_last_link(hand, carrier)}" if carrier else "palm"
    box = (
        f'<geom name="{name}" type="box" size="{_text(half.tolist())}" pos="{_text(centre.tolist())}"'
        f' contype="{PALM_BIT}" conaffinity="{OBJECT_BIT}"{_hidden_if(link in shown)}/>'
    )
    mesh = "" if carrier else _mesh_geom(shown.get("palm"))
    digits = "\n".join(_digit(hand, digit, opposed, shown) for digit in hand.carried_by(carrier))
    return f"{box}{mesh}\n{digits}\n"


def _last_link(hand: Hand, name: str) -> int:
    """Return the number of links of a digit."""
    return next(len(digit.length) for digit in hand.digits if digit.name == name)


def _hidden_if(has_mesh: bool) -> str:
    """Return the attribute of a shape that a mesh replaces in pictures, empty without mesh."""
    return f' group="{HIDDEN_GROUP}"' if has_mesh else ""


def touches_palm(hand: Hand, digit: Digit) -> list[bool]:
    """Return, for each link of a digit, True if it overlaps at rest with the palm or the link that carries it.

    Such a link is hinged close to the palm and does not collide with it.
    """
    centre, half = palm_box(hand, digit.carrier)
    carrier = [one for one in hand.digits if one.name == digit.carrier]
    along = np.linspace(0.0, 1.0, LINK_SAMPLES)[:, None]
    overlaps = []
    for length, (position, rotation) in zip(digit.length, rest_poses(digit), strict=True):
        points = position + along * (length * rotation[:, 0])
        outside = np.maximum(np.abs(points - centre) - half, 0.0)
        overlap = bool((np.linalg.norm(outside, axis=1) <= digit.radius).any())
        for one in carrier:
            # The carrying link is a capsule along x of this frame.
            nearest = np.clip(points[:, :1], 0.0, one.length[-1]) * np.array([1.0, 0.0, 0.0])
            overlap |= bool((np.linalg.norm(points - nearest, axis=1) <= digit.radius + one.radius).any())
        overlaps.append(overlap)
    return overlaps


def _digit(hand: Hand, digit: Digit, opposed: dict[str, bool], shown: dict[str, LinkMesh]) -> str:
    """Build the nested bodies of a digit. Each link lies along its x axis with the hinge at its origin."""
    opening = f'<frame pos="{_text(digit.position)}" euler="{_text(digit.rpy_deg)}">'
    closing = "</frame>"
    near_palm = touches_palm(hand, digit)
    carries = bool(hand.carried_by(digit.name))
    last = len(digit.length) - 1
    for i, turn in enumerate(digit.joint_rpy_deg):
        offset = f"{digit.length[i - 1] if i else 0.0} 0 0"
        opening += f'<body name="{digit.name}_link{i + 1}" pos="{offset}" euler="{_text(turn)}">'
        bits = _carrier_bits() if carries else _digit_bits(opposed[digit.name], near_palm[i])
        # The link that carries the box ends at the face of the box.
        length = max(digit.length[i] - digit.radius, 0.0) if carries and i == last else digit.length[i]
        mesh = shown.get(f"{digit.name}_link{i + 1}")
        body = _body(digit, i, length, bits, mesh is not None)
        opening += f"{_joint(digit, i)}{body}{_mesh_geom(mesh)}\n"
        closing = "</body>" + closing
    return opening + (_palm(hand, digit.name, opposed, shown) if carries else "") + closing


def _digit_bits(opposed: bool, near_palm: bool) -> tuple[int, int]:
    """Return category and affinity of a link.

    A digit touches the object, the opposed digits, and the palm with the links away from it.
    """
    category, opposite = (OPPOSED_BIT, FINGER_BIT) if opposed else (FINGER_BIT, OPPOSED_BIT)
    return category, OBJECT_BIT | opposite | (0 if near_palm else PALM_BIT)


def _carrier_bits() -> tuple[int, int]:
    """Return category and affinity of a link of a digit that carries other digits.

    Both are equal to category and affinity of the palm.
    """
    return PALM_BIT, OBJECT_BIT


def _joint(digit: Digit, i: int) -> str:
    """Build the joint of link i."""
    return (
        f'<joint name="{digit.joints[i]}" axis="{_text(digit.axis[i])}"'
        f' range="{digit.joint_min_deg[i]} {digit.joint_max_deg[i]}" damping="{digit.damping[i]}"'
        f' armature="{digit.armature[i]}" stiffness="{digit.spring[i]}" springref="{-math.degrees(digit.preload[i])}"/>'
    )


def _body(digit: Digit, i: int, length: float, bits: tuple[int, int], has_mesh: bool) -> str:
    """Build inertia and collision geometry of link i: a capsule of a length [m], or a ball without length."""
    moments = digit.inertia[i]
    inertia = f'fullinertia="{_text(moments)}"' if any(moments[3:]) else f'diaginertia="{_text(moments[:3])}"'
    shape = f'type="capsule" fromto="0 0 0 {length} 0 0"' if length else 'type="sphere"'
    return (
        f'<inertial pos="{_text(digit.com[i])}" mass="{digit.mass[i]}" {inertia}/>'
        f'<geom {shape} size="{digit.radius}" contype="{bits[0]}" conaffinity="{bits[1]}"'
        f"{_hidden_if(has_mesh)}/>"
    )


def _tendon(tendon: TendonSpec) -> str:
    """Build a tendon without stiffness. The plant sets its damping at each step, see ``drivetrain``."""
    joints = "".join(f'<joint joint="{name}" coef="{arm}"/>' for name, arm in tendon.arms.items())
    return f'<fixed name="{tendon.name}" damping="{tendon.damping}">{joints}</fixed>'


def _contact(hand: Hand, digit: Digit) -> str:
    """Build the sensor of the net contact force on a digit."""
    return f'<contact name="contact/{digit.name}" {_touching(hand, digit)} num="1" reduce="netforce" data="force"/>'


def _normal(hand: Hand, digit: Digit) -> str:
    """Build the sensor of the contacts between a digit and the object. Axis 1 of a contact frame is the normal."""
    return (
        f'<contact name="normal/{digit.name}" {_touching(hand, digit)} geom2="object" num="{MAX_CONTACTS}"'
        ' reduce="maxforce" data="force"/>'
    )


def _touching(hand: Hand, digit: Digit) -> str:
    """Return the bodies of a digit for a contact sensor: all links, or the last one without the digits on it."""
    if hand.carried_by(digit.name):
        return f'body1="{digit.name}_link{len(digit.length)}"'
    return f'subtree1="{digit.name}_link1"'


def _grasp_object(grasp_object: GraspObject) -> str:
    """Build the free body of the object."""
    half = tuple(extent / 2.0 for extent in grasp_object.size)
    size = {"cylinder": (half[0], half[2]), "sphere": half[:1], "box": half}[grasp_object.shape]
    return (
        f'<body name="object" pos="{_text(grasp_object.position)}"><freejoint name="object"/>'
        f'<geom name="object" type="{grasp_object.shape}" size="{_text(size)}" mass="{grasp_object.mass}"'
        f' contype="{OBJECT_BIT}" conaffinity="{TABLE_BIT}"/></body>\n'
    )


def _table(grasp_object: GraspObject, support: Support | None) -> str:
    """Build the body of the table, empty without support."""
    if support is None:
        return ""
    x, y, z = table_position(grasp_object)
    size = _text(TABLE_HALF_EXTENTS)
    return (
        f'<body name="table" mocap="true" pos="{x} {y} {z}"><geom name="table" type="box" size="{size}"'
        f' contype="{TABLE_BIT}" conaffinity="{OBJECT_BIT}"/></body>\n'
    )


def shapes(scene: Scene) -> dict[str, dict[str, object]]:
    """Return shape and extents [m] of object and table, and the table's position [m], for those who draw them."""
    if scene.grasp_object is None:
        return {}
    grasp_object: dict[str, object] = {"shape": scene.grasp_object.shape, "size_m": scene.grasp_object.size}
    if scene.support is None:
        return {"object": grasp_object}
    size = tuple(2.0 * half for half in TABLE_HALF_EXTENTS)
    position = table_position(scene.grasp_object)
    return {"object": grasp_object, "table": {"shape": "box", "size_m": size, "position_m": position}}


def table_position(grasp_object: GraspObject) -> tuple[float, float, float]:
    """Return the centre of the table when the object rests on the table [m]."""
    x, y, z = grasp_object.position
    return (x, y, z - grasp_object.size[2] / 2.0 - TABLE_HALF_EXTENTS[2])
