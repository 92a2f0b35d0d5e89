"""MuJoCo model of a hand and a scene as MJCF text. The world frame is the palm frame."""

import math

from firmware_sim.description import Digit, Hand, TendonSpec
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
PALM_SIZE = (0.01, 0.035, 0.035)
"""Half extents of the palm [m]. Its face lies in the plane x = 0."""
TABLE_HALF = (0.12, 0.12, 0.005)
"""Half extents of the table [m]."""
CONTACTS = 8
"""Contacts of one digit with the object that are measured, at most two for each link."""

_OPTIONS = f"""
  <compiler angle="degree" eulerseq="XYZ" autolimits="true"/>
  <option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" impratio="100" gravity="{{gravity}}">
    <flag island="disable" autoreset="disable"/>
  </option>
  <default>
    <geom condim="4" solref="0.004 1" solimp="0.95 0.99 0.001" friction="{{friction}} 0.005 0.0001"/>
    <joint type="hinge" axis="0 0 1" solreflimit="0.002 1" solimplimit="0.99 0.9999 0.001"/>
  </default>
"""
"""Engine options and defaults. Source of the settings: see ``model_text``."""


def model_text(hand: Hand, scene: Scene) -> str:
    """Build the model as MJCF.

    Joints have the hand's order: the first entries of qpos and qvel are the joints, the object's
    free joint follows. Contact is softer than in MODEL, section 6. With solref 0.002 the
    penetration of a grasp is less than the error of the collision detector, and contacts vanish for
    single steps. Source of the other settings: MODEL, section 6.
    """
    friction = scene.grasp_object.friction if scene.grasp_object else HAND_FRICTION
    options = _OPTIONS.format(gravity=_text(hand.gravity), friction=friction)
    bodies = "\n".join(_digit(digit, opposed) for digit, opposed in zip(hand.digits, opposed_digits(hand), strict=True))
    scene_bodies = (_grasp_object(scene.grasp_object) if scene.grasp_object else "") + (
        _table(scene.grasp_object, scene.support) if scene.grasp_object else ""
    )
    tendons = "".join(_tendon(tendon) for tendon in hand.tendons)
    sensors = "".join(_contact(digit) for digit in hand.digits)
    if scene.load:
        sensors += "".join(_normal(digit) for digit in hand.digits)
    return (
        f'<mujoco model="{hand.name}">{options}<worldbody>\n{_palm()}\n{bodies}\n{scene_bodies}</worldbody>\n'
        f"<tendon>{tendons}</tendon>\n<sensor>{sensors}</sensor>\n</mujoco>"
    )


def opposed_digits(hand: Hand) -> list[bool]:
    """Return, for each digit, True if it closes against the first digit (as the thumb does)."""
    directions = [_closing_direction(digit) for digit in hand.digits]
    return [sum(a * b for a, b in zip(directions[0], direction, strict=True)) < 0.0 for direction in directions]


def _closing_direction(digit: Digit) -> tuple[float, float, float]:
    """Compute the digit's y axis in the palm frame from extrinsic roll, pitch and yaw."""
    roll, pitch, yaw = (math.radians(angle) for angle in digit.rpy_deg)
    x = math.sin(roll) * math.sin(pitch)
    y = math.cos(roll)
    z = math.sin(roll) * math.cos(pitch)
    return (x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw), z)


def _text(values: tuple[float, ...]) -> str:
    return " ".join(repr(value) for value in values)


def _palm() -> str:
    x, y, z = PALM_SIZE
    return (
        f'<geom name="palm" type="box" size="{x} {y} {z}" pos="{-x} 0 0" contype="{PALM_BIT}"'
        f' conaffinity="{OBJECT_BIT}"/>'
    )


def _digit(digit: Digit, opposed: bool) -> str:
    """Build the nested bodies of a digit. Each link lies along its x axis with the hinge at its origin."""
    opening = ""
    closing = ""
    for i, name in enumerate(digit.joints):
        pose = f'pos="{_text(digit.position)}" euler="{_text(digit.rpy_deg)}"' if i == 0 else _offset(digit, i)
        opening += f'<body name="{digit.name}_link{i + 1}" {pose}>{_link(digit, i, name, opposed)}\n'
        closing += "</body>"
    return opening + closing


def _offset(digit: Digit, i: int) -> str:
    return f'pos="{digit.length[i - 1]} 0 0"'


def _link(digit: Digit, i: int, joint: str, opposed: bool) -> str:
    """Build joint, inertia and collision geometry of one link."""
    inertia = digit.inertia[i]
    category, opposite = (OPPOSED_BIT, FINGER_BIT) if opposed else (FINGER_BIT, OPPOSED_BIT)
    # A digit touches the object and the opposed digits. The first link is hinged to the palm and
    # does not touch the palm.
    affinity = OBJECT_BIT | opposite | (PALM_BIT if i > 0 else 0)
    return (
        f'<joint name="{joint}" range="{digit.joint_min_deg[i]} {digit.joint_max_deg[i]}" damping="{digit.damping[i]}"'
        f' armature="{digit.armature[i]}" stiffness="{digit.spring[i]}" springref="{-math.degrees(digit.preload[i])}"/>'
        f'<inertial pos="{digit.com[i]} 0 0" mass="{digit.mass[i]}" diaginertia="{inertia} {inertia} {inertia}"/>'
        f'<geom type="capsule" fromto="0 0 0 {digit.length[i]} 0 0" size="{digit.radius}" contype="{category}"'
        f' conaffinity="{affinity}"/>'
    )


def _tendon(tendon: TendonSpec) -> str:
    """Build a tendon without stiffness. The plant sets its damping at each step, see ``drivetrain``."""
    joints = "".join(f'<joint joint="{name}" coef="{arm}"/>' for name, arm in tendon.arms.items())
    return f'<fixed name="{tendon.name}" damping="{tendon.damping}">{joints}</fixed>'


def _contact(digit: Digit) -> str:
    """Build the sensor of the net contact force on a digit."""
    return (
        f'<contact name="contact/{digit.name}" subtree1="{digit.name}_link1" num="1" reduce="netforce" data="force"/>'
    )


def _normal(digit: Digit) -> str:
    """Build the sensor of the contacts between a digit and the object. Axis 1 of a contact frame is the normal."""
    return (
        f'<contact name="normal/{digit.name}" subtree1="{digit.name}_link1" geom2="object" num="{CONTACTS}"'
        ' reduce="maxforce" data="force"/>'
    )


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
    return (
        f'<body name="table" mocap="true" pos="{x} {y} {z}"><geom name="table" type="box" size="{_text(TABLE_HALF)}"'
        f' contype="{TABLE_BIT}" conaffinity="{OBJECT_BIT}"/></body>\n'
    )


def table_position(grasp_object: GraspObject) -> tuple[float, float, float]:
    """Return the centre of the table when the object rests on the table [m]."""
    x, y, z = grasp_object.position
    return (x, y, z - grasp_object.size[2] / 2.0 - TABLE_HALF[2])
