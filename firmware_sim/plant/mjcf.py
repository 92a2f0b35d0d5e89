"""A hand and a scene as a MuJoCo model in text; the world frame is the palm frame."""

import math

from firmware_sim.description import Digit, Hand, TendonSpec
from firmware_sim.scene.scene import Scene, Support, Thing

STEP_S = 0.5e-3
"""Time step of the plant [s]. Source: MODEL, section 6: 15 of 15 grasps hold at 0.5 ms with armature 1e-6 kg m2."""
HAND_FRICTION = 0.5
"""Sliding coefficient of links and palm where the scene names none."""

OBJECT_BIT, FINGER_BIT, OPPOSED_BIT, PALM_BIT, TABLE_BIT = 1, 2, 4, 8, 16
PALM_SIZE = (0.01, 0.035, 0.035)
"""Half extents [m]; its face lies in the plane x = 0."""
TABLE_HALF = (0.12, 0.12, 0.005)
CONTACTS = 8
"""Contacts of one digit with the object that are measured; two a link at most."""

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


def model_text(hand: Hand, scene: Scene) -> str:
    """Return the model as MJCF.

    Joints come in the hand's order, so the first entries of qpos and qvel are the joints; the object's free joint
    follows. Source of the settings: MODEL, section 6; contact is softer than there, for with solref 0.002 a grasp's
    depth of contact is less than the collision detector's own error, and contacts vanish for single steps.
    """
    friction = scene.thing.friction if scene.thing else HAND_FRICTION
    options = _OPTIONS.format(gravity=_text(hand.gravity), friction=friction)
    bodies = "\n".join(_digit(digit, opposed) for digit, opposed in zip(hand.digits, opposed_digits(hand), strict=True))
    things = (_thing(scene.thing) if scene.thing else "") + (_table(scene.thing, scene.support) if scene.thing else "")
    tendons = "".join(_tendon(tendon) for tendon in hand.tendons)
    sensors = "".join(_contact(digit) for digit in hand.digits)
    if scene.load:
        sensors += "".join(_normal(digit) for digit in hand.digits)
    return (
        f'<mujoco model="{hand.name}">{options}<worldbody>\n{_palm()}\n{bodies}\n{things}</worldbody>\n'
        f"<tendon>{tendons}</tendon>\n<sensor>{sensors}</sensor>\n</mujoco>"
    )


def opposed_digits(hand: Hand) -> list[bool]:
    """Return, for each digit, whether it closes against the first one (as the thumb does)."""
    directions = [_closing_direction(digit) for digit in hand.digits]
    return [sum(a * b for a, b in zip(directions[0], direction, strict=True)) < 0.0 for direction in directions]


def _closing_direction(digit: Digit) -> tuple[float, float, float]:
    """Return the digit's y axis in the palm frame, for extrinsic roll, pitch, yaw."""
    roll, pitch, yaw = (math.radians(angle) for angle in digit.rpy_deg)
    x, y, z = math.sin(roll) * math.sin(pitch), math.cos(roll), math.sin(roll) * math.cos(pitch)
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
    """Nested bodies: each link lies along its x axis, hinge at its origin."""
    opening, closing = "", ""
    for i, name in enumerate(digit.joints):
        place = f'pos="{_text(digit.position)}" euler="{_text(digit.rpy_deg)}"' if i == 0 else _offset(digit, i)
        opening += f'<body name="{digit.name}_link{i + 1}" {place}>{_link(digit, i, name, opposed)}\n'
        closing += "</body>"
    return opening + closing


def _offset(digit: Digit, i: int) -> str:
    return f'pos="{digit.length[i - 1]} 0 0"'


def _link(digit: Digit, i: int, joint: str, opposed: bool) -> str:
    inertia = digit.inertia[i]
    own, other = (OPPOSED_BIT, FINGER_BIT) if opposed else (FINGER_BIT, OPPOSED_BIT)
    touches = OBJECT_BIT | other | (PALM_BIT if i > 0 else 0)
    return (
        f'<joint name="{joint}" range="{digit.joint_min_deg[i]} {digit.joint_max_deg[i]}" damping="{digit.damping[i]}"'
        f' armature="{digit.armature[i]}" stiffness="{digit.spring[i]}" springref="{-math.degrees(digit.preload[i])}"/>'
        f'<inertial pos="{digit.com[i]} 0 0" mass="{digit.mass[i]}" diaginertia="{inertia} {inertia} {inertia}"/>'
        f'<geom type="capsule" fromto="0 0 0 {digit.length[i]} 0 0" size="{digit.radius}" contype="{own}"'
        f' conaffinity="{touches}"/>'
    )


def _tendon(tendon: TendonSpec) -> str:
    """A tendon without stiffness, whose damping the plant sets at each step to integrate its own law implicitly."""
    joints = "".join(f'<joint joint="{name}" coef="{arm}"/>' for name, arm in tendon.arms.items())
    return f'<fixed name="{tendon.name}" damping="{tendon.damping}">{joints}</fixed>'


def _contact(digit: Digit) -> str:
    """The net force of everything that touches the digit."""
    return (
        f'<contact name="contact/{digit.name}" subtree1="{digit.name}_link1" num="1" reduce="netforce" data="force"/>'
    )


def _normal(digit: Digit) -> str:
    """Each contact of the digit with the object in its own frame, whose first axis is the normal."""
    return (
        f'<contact name="normal/{digit.name}" subtree1="{digit.name}_link1" geom2="object" num="{CONTACTS}"'
        ' reduce="maxforce" data="force"/>'
    )


def _thing(thing: Thing) -> str:
    half = tuple(extent / 2.0 for extent in thing.size)
    size = {"cylinder": (half[0], half[2]), "sphere": half[:1], "box": half}[thing.shape]
    return (
        f'<body name="object" pos="{_text(thing.position)}"><freejoint name="object"/>'
        f'<geom name="object" type="{thing.shape}" size="{_text(size)}" mass="{thing.mass}" contype="{OBJECT_BIT}"'
        f' conaffinity="{TABLE_BIT}"/></body>\n'
    )


def _table(thing: Thing, support: Support | None) -> str:
    if support is None:
        return ""
    x, y, z = table_position(thing)
    return (
        f'<body name="table" mocap="true" pos="{x} {y} {z}"><geom name="table" type="box" size="{_text(TABLE_HALF)}"'
        f' contype="{TABLE_BIT}" conaffinity="{OBJECT_BIT}"/></body>\n'
    )


def table_position(thing: Thing) -> tuple[float, float, float]:
    """Return where the table's centre stands when the object rests on it [m]."""
    x, y, z = thing.position
    return (x, y, z - thing.size[2] / 2.0 - TABLE_HALF[2])
