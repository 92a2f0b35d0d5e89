"""Small mesh files for tests, and hands that use them."""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from handctl.hand.description import Hand
from handctl.hand.formats.link_meshes import PALM_LINK, meshes_of_hand
from handctl.hand.formats.mesh_file import mesh_triangles
from handctl.hand.hand_loading import hand_from_content, load_hand
from handctl.hand.kinematics import joint_positions, link_rotations
from handctl.hand.link_tree import LinkTree
from tools.meshes.solids import stl

TETRAHEDRON_CORNERS = np.array(
    [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.02]]
)
"""Corners of a tetrahedron [m]."""
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
MESH_SCALE = (1e-3, -2e-3, 1e-3)
MESH_POSITION_M = (0.004, -0.003, 0.002)
MESH_RPY_DEG = (20.0, -35.0, 110.0)


def tetrahedron_triangles() -> NDArray[np.float64]:
    """Return the corners of the triangles of a tetrahedron (4, 3, 3) [m]."""
    return TETRAHEDRON_CORNERS[TETRAHEDRON_FACES]


def tetrahedron_obj(scale: float = 1.0, mixes_face_notations: bool = False) -> bytes:
    """Return the tetrahedron as the text of an OBJ file.

    With ``mixes_face_notations``, the faces of the tetrahedron use all notations that OBJ has for a
    corner. MuJoCo cannot read a file in which the notations are mixed.
    """
    lines = [
        "# a tetrahedron",
        "mtllib none.mtl",
        *(f"v {x} {y} {z}" for x, y, z in scale * TETRAHEDRON_CORNERS),
        "vn 0 0 1",
    ]
    lines += ["vt 0 0", "f 1/1/1 3/1/1 2/1/1", "f -4//1 -3//1 -1//1", "f 1/1 4/1 3/1", "f 2 3 4"]
    if not mixes_face_notations:
        lines[-4:] = [
            "f 1//1 3//1 2//1",
            "f -4//1 -3//1 -1//1",
            "f 1//1 4//1 3//1",
            "f 2//1 3//1 4//1",
        ]
    return "\n".join(lines).encode()


def write_meshes(mesh_folder: Path) -> None:
    """Write three mesh files of the tetrahedron.

    The file ``m.stl`` is in metres. The files ``sub/mm.stl`` and ``sub/mm.obj`` are in millimetres.
    """
    (mesh_folder / "sub").mkdir()
    (mesh_folder / "m.stl").write_bytes(stl(tetrahedron_triangles()))
    (mesh_folder / "sub" / "mm.stl").write_bytes(stl(1e3 * tetrahedron_triangles()))
    (mesh_folder / "sub" / "mm.obj").write_bytes(tetrahedron_obj(1e3))


def hand_with_meshes(hand_name: str) -> Hand:
    """Return a packaged hand whose palm and links have the meshes of ``write_meshes``.

    The first link of a digit with several links has no mesh.

    The mesh on the last link of each digit has a scale factor and a pose relative to the link.
    """
    content = hand_without_meshes(hand_name).content
    content["mount"] = content["mount"] | {
        "palm_mesh": "m.stl",
        "palm_mesh_position_m": [-0.01, 0.0, 0.0],
    }
    for d, digit in enumerate(content["digit"]):
        count = len(digit["link_length_m"])
        last_mesh = f"sub/mm.{'stl' if d % 2 else 'obj'}"
        digit["link_mesh"] = ["m.stl"] * (count - 1) + [last_mesh]
        if count > 1:
            digit["link_mesh"][0] = ""
        digit["link_mesh_scale"] = [1.0] * (count - 1) + [list(MESH_SCALE)]
        digit["link_mesh_position_m"] = [[0.0, 0.0, 0.0]] * (count - 1) + [list(MESH_POSITION_M)]
        digit["link_mesh_rpy_deg"] = [[0.0, 0.0, 0.0]] * (count - 1) + [list(MESH_RPY_DEG)]
    return hand_from_content(content, hand_name)


def hand_without_meshes(hand_name: str) -> Hand:
    """Return a packaged hand without meshes."""
    content = load_hand(hand_name).content
    content["mount"] = {key: value for key, value in content["mount"].items() if "mesh" not in key}
    content["digit"] = [
        {key: value for key, value in digit.items() if "mesh" not in key}
        for digit in content["digit"]
    ]
    return hand_from_content(content, hand_name)


def corners_by_link(model: mujoco.MjModel, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return the corners of each link's mesh in the palm frame [m], as MuJoCo places them."""
    data = mujoco.MjData(model)
    data.qpos[: len(q)] = q
    mujoco.mj_kinematics(model, data)
    corners_of_link = {}
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.geom_dataid[geom]
        first_vertex, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        corners = model.mesh_vert[first_vertex : first_vertex + count]
        body = model.body(model.geom_bodyid[geom]).name
        corners_in_world = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        corners_of_link[PALM_LINK if body == "world" else body] = corners_in_world
    return corners_of_link


def corners_of_hand(hand, mesh_folder: Path, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return the corners of each link's mesh in the palm frame [m], as the kinematics of handctl places them."""
    poses = {PALM_LINK: (np.zeros(3), np.eye(3))}
    tree = LinkTree.from_hand(hand)
    all_poses = tree.poses(q)
    for digit in tree.digits:
        poses_of_digit = all_poses[digit.joints]
        for i, pose in enumerate(
            zip(joint_positions(poses_of_digit), link_rotations(poses_of_digit), strict=True)
        ):
            poses[f"{digit.name}_link{i + 1}"] = pose
    corners_of_link = {}
    for mesh in meshes_of_hand(hand):
        position, rotation = poses[mesh.link]
        content = (mesh_folder / mesh.file).read_bytes()
        corners_of_link[mesh.link] = (
            mesh.to_link_frame(mesh_triangles(content, mesh.suffix)) @ rotation.T + position
        )
    return corners_of_link


def assert_same_corners(
    computed_corners: dict[str, np.ndarray], expected_corners: dict[str, np.ndarray]
) -> None:
    """Assert that two sets of mesh corners agree for each link.

    Each corner of one set must be at most a micrometre away from a corner of the other set.
    """
    assert computed_corners.keys() == expected_corners.keys()
    for link, corners in expected_corners.items():
        distance = np.linalg.norm(
            corners.reshape(-1, 1, 3) - computed_corners[link].reshape(1, -1, 3), axis=-1
        )
        assert distance.min(axis=1).max() < 1e-6, link
        assert distance.min(axis=0).max() < 1e-6, link
