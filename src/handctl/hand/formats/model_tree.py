"""Digits of a hand, built from the tree of links of a robot description.

In a robot description, the frames of the links can have any orientation.

In a hand file, a digit is a chain of links. The x axis of each link's frame is along the link, and
passes through the next joint. If the x axis of a frame in the robot description is not along the
link, this module turns the frame.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np

from handctl.errors import ConfigError
from handctl.hand.digit import Array
from handctl.hand.file.quantity_types import NAME_PATTERN
from handctl.hand.file.section_models import MAX_LINKS

MAX_ANGLE_TO_LINK_RAD = 1e-6
"""Largest angle between a link and the x axis of its frame [rad].

If the angle between a link and its x axis is larger, the frame of the link is turned.
"""
INTERSECTION_TOLERANCE_M = 1e-7
"""Largest distance of two joints whose axes count as meeting in a point [m]."""
MIN_FLEXION_COMPONENT = 0.7
"""Smallest component along y of the direction in which the tip moves.

If the tip moves with a smaller component along y, the frame of the digit's last link is turned.
"""
NEGATIVE_FLEXION_RATIO = 0.1
"""Ratio of joint limits that shows the direction of flexion.

A joint flexes towards negative angles if its upper limit is at most NEGATIVE_FLEXION_RATIO times
the negative of its lower limit.
"""
MIN_FORWARD_COMPONENT = 0.7
"""Smallest component along x of the mean direction of the digits.

If the digits point along x with a smaller component, the palm frame is turned.
"""
MAX_MOUNT_OFFSET_M = 0.005
"""Largest distance of the foremost digit mount from the plane x = 0 [m].

If the foremost mount is farther from the plane, the palm frame is shifted.
"""
MAX_PARALLEL_SINE = 0.1
"""Largest sine of the angle between a link and its joint axis at which the link counts as parallel to the axis."""
TIP_NAME_PATTERN = re.compile(r"tip|end", re.IGNORECASE)
"""Pattern in the name of a frame that marks the end of a digit."""
JOINT_SUFFIX = re.compile(r"[\W_]*(joint|link|j|l)?[\W_]*[0-9]*[\W_]*$", re.IGNORECASE)
"""Pattern of the end of a joint's name, after the name of its digit."""


@dataclass(frozen=True, eq=False)
class ModelMesh:
    """Mesh of a link in a robot description.

    Attributes:
        file: path of the mesh file.
        scale: factors from the unit of the file to metres (3,).
        position: origin of the mesh in the frame of the link (3,) [m].
        rotation: rotation from the frame of the mesh to the frame of the link (3, 3).
    """

    file: str
    scale: Array
    position: Array
    rotation: Array

    @staticmethod
    def from_plain_values(values: Mapping[str, Any]) -> "ModelMesh":
        """Build a mesh of the robot description from plain values."""
        return ModelMesh(
            file=values["file"],
            scale=np.array(values["scale"], dtype=float),
            position=np.array(values["position"], dtype=float),
            rotation=np.array(values["rotation"], dtype=float),
        )

    def seen_from_frame(self, frame_rotation: Array, frame_origin: Array) -> "ModelMesh":
        """Return a copy of the mesh, with the pose of the mesh expressed in another frame of the link.

        The arguments give the rotation (3, 3) and the origin (3,) [m] of the other frame in the
        present frame.
        """
        return replace(
            self,
            position=frame_rotation.T @ (self.position - frame_origin),
            rotation=frame_rotation.T @ self.rotation,
        )


@dataclass(frozen=True, eq=False)
class ModelLink:
    """Link of a robot description, together with the joint at the start of the link.

    The origin of the link's frame is in this joint.

    Attributes:
        name: name of the link in the description.
        joint: name of the joint in the description.
        parent: index of the parent link, -1 for the root.
        position: origin of the link in the frame of the parent (3,) [m].
        rotation: rotation from the frame of the link to that of the parent, at joint angle zero (3,
            3).
        is_prismatic: True if the link slides along the axis of the joint. The values of a prismatic
            joint are in m, N and kg in place of rad, N m and kg m2.
        axis: axis of the joint in the frame of the link (3,).
        is_reversed: True if the axis was reversed, because the joint flexes towards negative angles
            of the description.
        leader: name of the joint that this joint follows, None for an independent joint.
        leader_ratio: angle of this joint divided by that of the leader, in the description.
        range: smallest and largest angle of the joint [rad], None for a joint without limits.
        damping: damping of the joint [N m s/rad].
        armature: additional inertia of the joint [kg m2].
        stiffness: stiffness of the joint's spring [N m/rad].
        rest: joint angle at which the spring makes no torque [rad].
        mass: mass of the link [kg].
        com: centre of mass in the frame of the link (3,) [m].
        inertia: inertia about the centre of mass, in the frame of the link (3, 3) [kg m2].
        frames: origins of the named frames on the link, in the frame of the link, (3,) each [m].
        points: corners of boxes around the shapes of the link, (n, 3) [m].
        radius: half width of the shapes of the link [m], None for a link without shapes.
        mesh: mesh that shows the link, None for a link without a mesh.
    """

    name: str
    joint: str
    parent: int
    position: Array
    rotation: Array
    is_prismatic: bool
    axis: Array
    is_reversed: bool
    leader: str | None
    leader_ratio: float
    range: tuple[float, float] | None
    damping: float
    armature: float
    stiffness: float
    rest: float
    mass: float
    com: Array
    inertia: Array
    frames: Mapping[str, Array]
    points: Array
    radius: float | None
    mesh: ModelMesh | None

    @staticmethod
    def from_plain_values(values: Mapping[str, Any], mesh: ModelMesh | None) -> "ModelLink":
        """Build a link of the robot description from plain values and its mesh.

        The axis of a joint that flexes towards negative angles is reversed.
        """
        axis = np.array(values["axis"], dtype=float)
        rest_angle = float(values["rest"])
        limits = (
            None
            if values["range"] is None
            else (float(values["range"][0]), float(values["range"][1]))
        )
        is_reversed = (
            limits is not None
            and limits[0] < 0.0
            and limits[1] <= NEGATIVE_FLEXION_RATIO * -limits[0]
        )
        leader, leader_ratio = values["follows"] or (None, 1.0)
        if is_reversed and limits is not None:
            limits = (-limits[1], -limits[0])
            axis = -axis
            rest_angle = -rest_angle
        return ModelLink(
            name=values["name"],
            joint=values["joint"],
            parent=values["parent"],
            position=np.array(values["position"], dtype=float),
            rotation=np.array(values["rotation"], dtype=float),
            is_prismatic=bool(values["prismatic"]),
            axis=axis,
            is_reversed=is_reversed,
            leader=leader,
            leader_ratio=float(leader_ratio),
            range=limits,
            damping=float(values["damping"]),
            armature=float(values["armature"]),
            stiffness=float(values["stiffness"]),
            rest=rest_angle,
            mass=float(values["mass"]),
            com=np.array(values["com"], dtype=float),
            inertia=np.array(values["inertia"], dtype=float),
            frames={
                name: np.array(frame_origin, dtype=float)
                for name, frame_origin in values["frames"].items()
            },
            points=np.array(values["points"], dtype=float).reshape(-1, 3),
            radius=values["radius"],
            mesh=mesh,
        )


@dataclass(frozen=True, eq=False)
class ModelDigit:
    """Digit that was read from a chain of links of a robot description. The link frames are those of a hand file.

    Attributes:
        name: name of the digit.
        carrier: name of the digit whose last link carries this digit, None for the palm.
        joints: names of the joints in the description.
        position: position of the first joint in the frame of the carrier (3,) [m].
        rotation: rotation from the frame of the first link to the frame of the carrier (3, 3).
        turns: rotation (n - 1, 3, 3) from the frame of each link, except the first, to the frame of
            the link before it.
        lengths: length of each link (n,) [m].
        axes: axis of each joint in the frame of its link (n, 3).
        links: the links of the digit in the robot description.
        centres_of_mass: centre of mass of each link in its frame (n, 3) [m].
        inertias: inertia of each link about its centre of mass (n, 3, 3) [kg m2].
        meshes: mesh of each link, or None for a link without a mesh.
    """

    name: str
    carrier: str | None
    joints: tuple[str, ...]
    position: Array
    rotation: Array
    turns: Array
    lengths: Array
    axes: Array
    links: tuple[ModelLink, ...]
    centres_of_mass: Array
    inertias: Array
    meshes: tuple[ModelMesh | None, ...]

    @property
    def coupling(self) -> Array:
        """Return the coupling matrix (n, n_c), which maps the angles of the independent joints to all joint angles.

        A joint that follows a joint of another digit counts as independent.
        """
        leaders = [
            self.joints.index(link.leader) if link.leader in self.joints else None
            for link in self.links
        ]
        columns = [i for i, leader in enumerate(leaders) if leader is None]
        matrix = np.zeros((len(self.links), len(columns)))
        for i in range(len(self.links)):
            ratio, joint, leader = 1.0, i, leaders[i]
            # A leader can itself follow another joint. The loop has a limited number of steps, so
            # it also ends if joints follow each other in a circle.
            for _ in leaders:
                if leader is None:
                    break
                signs = (
                    -1.0 if self.links[joint].is_reversed != self.links[leader].is_reversed else 1.0
                )
                ratio *= signs * self.links[joint].leader_ratio
                joint, leader = leader, leaders[leader]
            if joint in columns:
                matrix[i, columns.index(joint)] = ratio
        return matrix


@dataclass(frozen=True)
class _LinkChain:
    """Chain of links.

    ``carrier`` is the index of the chain on which this chain is mounted. ``link_indices`` are the
    indices of the links in this chain.
    """

    name: str
    carrier: int | None
    link_indices: tuple[int, ...]


def digits_from_links(
    links: Sequence[ModelLink], source_name: str
) -> tuple[tuple[ModelDigit, ...], Array, Array]:
    """Return the digits that the link tree of a robot description contains, and the frame of the palm.

    Each digit comes after the digit that carries it.

    The palm frame of the hand is the root frame of the description. If the digits do not point
    along the x axis of the root frame, the palm frame is turned by multiples of 90 degrees. The
    palm frame is also shifted if the foremost mount of a digit is far from the plane x = 0. After
    the shift, the foremost mount lies in the plane x = 0.

    Args:
        links: all links, where the parent of a link comes before the link.
        source_name: name of the description, for error messages.

    Returns:
        The digits, and the rotation (3, 3) and origin (3,) [m] of the palm frame in the root frame.

    Raises:
        ConfigError: the robot description does not show where a digit ends.
    """
    chains = list(_link_chains(links))
    frames = _link_frames(links, chains, source_name)
    palm, origin = _palm_frame(links, chains, frames)
    digits = []
    for chain in chains:
        base_link_index, *other_link_indices = chain.link_indices
        base = palm if chain.carrier is None else frames[chains[chain.carrier].link_indices[-1]][0]
        position_from_carrier = links[base_link_index].position - (
            origin if chain.carrier is None else 0.0
        )
        turns = [
            frames[links[i].parent][0].T @ links[i].rotation @ frames[i][0]
            for i in other_link_indices
        ]
        link_frames = [frames[i][0] for i in chain.link_indices]
        bodies = [links[i] for i in chain.link_indices]
        digits.append(
            ModelDigit(
                name=chain.name,
                carrier=None if chain.carrier is None else chains[chain.carrier].name,
                joints=tuple(link.joint for link in bodies),
                position=base.T @ position_from_carrier,
                rotation=base.T @ links[base_link_index].rotation @ frames[base_link_index][0],
                turns=np.array(turns).reshape(-1, 3, 3),
                lengths=np.array([frames[i][1] for i in chain.link_indices]),
                axes=np.array(
                    [turn.T @ link.axis for turn, link in zip(link_frames, bodies, strict=True)]
                ),
                links=tuple(bodies),
                centres_of_mass=np.array(
                    [turn.T @ link.com for turn, link in zip(link_frames, bodies, strict=True)]
                ),
                inertias=np.array(
                    [
                        turn.T @ link.inertia @ turn
                        for turn, link in zip(link_frames, bodies, strict=True)
                    ]
                ),
                meshes=tuple(
                    link.mesh and link.mesh.seen_from_frame(turn, np.zeros(3))
                    for turn, link in zip(link_frames, bodies, strict=True)
                ),
            )
        )
    return tuple(digits), palm, origin


def _link_chains(links: Sequence[ModelLink]) -> Iterator[_LinkChain]:
    """Yield the chains of a tree of links.

    A chain ends where the tree branches, and after ``MAX_LINKS`` links.
    """
    children = {
        i: [j for j, link in enumerate(links) if link.parent == i] for i in range(-1, len(links))
    }
    names: set[str] = set()
    count = 0
    pending_links: list[tuple[int, int | None]] = [(i, None) for i in reversed(children[-1])]
    while pending_links:
        first_link, carrier = pending_links.pop()
        link_indices = [first_link]
        while len(children[link_indices[-1]]) == 1 and len(link_indices) < MAX_LINKS:
            link_indices += children[link_indices[-1]]
        name = _digit_name([links[i] for i in link_indices], names, count)
        names.add(name)
        yield _LinkChain(name, carrier, tuple(link_indices))
        pending_links += [(i, count) for i in reversed(children[link_indices[-1]])]
        count += 1


def _digit_name(links: Sequence[ModelLink], used_names: set[str], digit_count: int) -> str:
    """Return a name for a digit that no other digit has.

    The name is the common beginning of the names of all joints or links in the digit. If the common
    beginning is empty, invalid as a name or already used, the digit is named ``digit_1``,
    ``digit_2`` and so on.
    """
    for names in ([link.joint for link in links], [link.name for link in links]):
        common_prefix = names[0]
        for name in names[1:]:
            common_prefix = common_prefix[
                : next(
                    (
                        i
                        for i, (a, b) in enumerate(zip(common_prefix, name, strict=False))
                        if a != b
                    ),
                    None,
                )
            ]
            common_prefix = common_prefix[: len(name)]
        common_prefix = re.sub(r"\W", "_", JOINT_SUFFIX.sub("", common_prefix))
        if NAME_PATTERN.fullmatch(common_prefix) and common_prefix not in used_names:
            return common_prefix
    return next(
        name
        for i in range(len(used_names) + 1)
        if (name := f"digit_{digit_count + 1 + i}") not in used_names
    )


def _link_frames(
    links: Sequence[ModelLink], chains: Sequence[_LinkChain], source_name: str
) -> dict[int, tuple[Array, float]]:
    """Return for each link the rotation (3, 3) of its frame in the hand file, and its length [m].

    The rotation is relative to the frame that the link has in the robot description.
    """
    frames = {}
    for chain in chains:
        for i, following in zip(chain.link_indices, chain.link_indices[1:], strict=False):
            frames[i] = _link_frame(links[i], links[following].position, is_last_link=False)
        last_link_index = chain.link_indices[-1]
        frames[last_link_index] = _link_frame(
            links[last_link_index],
            _link_end(links, last_link_index, f"{source_name}: digit {chain.name}"),
            is_last_link=True,
        )
    return frames


def _link_frame(link: ModelLink, link_end: Array, is_last_link: bool) -> tuple[Array, float]:
    """Return the length of a link [m], and a frame whose x axis points to the end of the link."""
    length = float(np.linalg.norm(link_end))
    if length < INTERSECTION_TOLERANCE_M:
        return np.eye(3), 0.0
    x = link_end / length
    # A sliding link moves like a hinge whose axis is perpendicular to the sliding axis and to the
    # link.
    axis = np.cross(x, link.axis) if link.is_prismatic else link.axis
    motion = np.cross(axis, x)
    if (
        np.linalg.norm(x[1:]) < MAX_ANGLE_TO_LINK_RAD
        and x[0] > 0.0
        and not (is_last_link and motion[1] < MIN_FLEXION_COMPONENT)
    ):
        return np.eye(3), length
    z = axis - (axis @ x) * x
    if np.linalg.norm(z) < MAX_PARALLEL_SINE:
        # The axis of the joint is parallel to the link, so that the z axis can have any direction
        # perpendicular to the link.
        z = np.eye(3)[int(np.argmin(np.abs(x)))]
        z = z - (z @ x) * x
    z = z / np.linalg.norm(z)
    return np.column_stack((x, np.cross(z, x), z)), length


def _link_end(links: Sequence[ModelLink], i: int, location: str) -> Array:
    """Return the end (3,) [m] of the last link of a digit, in the frame of this link.

    Raises:
        ConfigError: neither a named frame nor a shape shows where the link ends.
    """
    link = links[i]
    distant_frames = {
        name: frame_origin
        for name, frame_origin in link.frames.items()
        if np.linalg.norm(frame_origin) > INTERSECTION_TOLERANCE_M
    }
    tip_positions = [
        frame_origin
        for name, frame_origin in distant_frames.items()
        if TIP_NAME_PATTERN.search(name)
    ]
    if tip_positions:
        return tip_positions[0]
    carried_digit_positions = [
        other_link.position for other_link in links if other_link.parent == i
    ]
    if carried_digit_positions:
        # A link that carries digits has no fingertip, so that any point that differs from the joint
        # can be the end of the link.
        return (
            np.mean(carried_digit_positions, axis=0)
            if np.linalg.norm(np.mean(carried_digit_positions, axis=0)) > INTERSECTION_TOLERANCE_M
            else carried_digit_positions[0]
        )
    if not len(link.points) and distant_frames:
        return next(iter(distant_frames.values()))
    if not len(link.points):
        problem_text = f"neither a frame nor a shape tells where its last link {link.name} ends"
        raise ConfigError(problem_text, location, f"a fixed link or site {link.name}_tip")
    # The end of the link is on the line from the joint to the middle of the link's shapes, at the
    # distance of the farthest corner of the shapes.
    centre_of_shapes = (link.points.min(axis=0) + link.points.max(axis=0)) / 2
    perpendicular_part = centre_of_shapes - (centre_of_shapes @ link.axis) * link.axis
    direction = (
        perpendicular_part
        if np.linalg.norm(perpendicular_part) > INTERSECTION_TOLERANCE_M
        else centre_of_shapes
    )
    direction = direction / np.linalg.norm(direction)
    return np.asarray(direction * (link.points @ direction).max())


def _palm_frame(
    links: Sequence[ModelLink],
    chains: Sequence[_LinkChain],
    frame_of_link: Mapping[int, tuple[Array, float]],
) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and the origin (3,) [m] of the palm frame in the root frame.

    The x axis of the palm frame points out of the palm, along the digits. The y axis points from
    the thumb to the fingers. The first digit closes in the negative direction of the y axis.
    """
    frames_of_digits: list[tuple[Array, Array]] = []
    for link in links:
        position, rotation = (
            (np.zeros(3), np.eye(3)) if link.parent < 0 else frames_of_digits[link.parent]
        )
        frames_of_digits.append((position + rotation @ link.position, rotation @ link.rotation))
    carriers = {chain.carrier for chain in chains}
    fingers = [chain for i, chain in enumerate(chains) if i not in carriers]
    mounts = np.array([frames_of_digits[chain.link_indices[0]][0] for chain in fingers])
    mean_direction = np.zeros(3)
    for chain, mount in zip(fingers, mounts, strict=True):
        last_link_index = chain.link_indices[-1]
        position, rotation = frames_of_digits[last_link_index]
        palm_axis = (
            position
            + rotation @ frame_of_link[last_link_index][0][:, 0] * frame_of_link[last_link_index][1]
            - mount
        )
        mean_direction += palm_axis / np.linalg.norm(palm_axis) / len(fingers)
    last_link_index = fingers[0].link_indices[-1]
    closing_axis = frames_of_digits[last_link_index][1] @ frame_of_link[last_link_index][0][:, 1]
    palm = np.eye(3)
    if mean_direction[0] < MIN_FORWARD_COMPONENT * np.linalg.norm(mean_direction):
        palm = max(
            _right_angle_rotations(),
            key=lambda turn: float(2 * turn[:, 0] @ mean_direction - turn[:, 1] @ closing_axis),
        )
    elif carriers != {None}:
        return palm, np.zeros(3)
    mount_depths = mounts @ palm[:, 0]
    origin = (
        palm[:, 0] * mount_depths.max()
        if abs(mount_depths.max()) > MAX_MOUNT_OFFSET_M
        else np.zeros(3)
    )
    if not np.array_equal(palm, np.eye(3)):
        # The origin of the palm frame is in the middle of the mounts, at the point of the palm that
        # faces the object.
        origin = origin + (np.eye(3) - np.outer(palm[:, 0], palm[:, 0])) @ mounts.mean(axis=0)
    return palm, origin


def _right_angle_rotations() -> Iterator[Array]:
    """Yield all 24 rotations (3, 3) that map each coordinate axis to a coordinate axis."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[order, range(3)] = signs
            if np.linalg.det(turn) > 0.0:
                yield turn
