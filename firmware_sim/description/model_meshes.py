"""Files and positions of the meshes in a robot description (URDF or MJCF).

The module does not read the mesh files themselves.
"""

from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import mujoco  # type: ignore[import-untyped,unused-ignore]
import numpy as np

PACKAGE_PREFIX = "package://"
"""Prefix of a mesh path within a ROS package."""
FILE_SCHEME_PREFIX = "file://"
"""Prefix of a mesh path that is given as a file URL."""


class BodyMesh(NamedTuple):
    """A mesh fixed to a body of the model.

    Attributes:
        body: number of the body, or 0 for the world body.
        file: path of the mesh file.
        scale: (3,) factors from the unit of the mesh file to metres.
        position: (3,) origin of the mesh in the frame of the body [m].
        rotation: (3, 3) rotation from the axes of the mesh file to the frame of the body.
    """

    body: int
    file: Path
    scale: Any
    position: Any
    rotation: Any


def urdf_files(xml_root: ET.Element, folder: Path) -> dict[str, Path]:
    """Return a dictionary from each name of a mesh file in a URDF to the path of the file."""
    names = {mesh.get("filename", "") for mesh in xml_root.iter("mesh")}
    return {name: _urdf_path(name, folder) for name in names if name}


def _urdf_path(name: str, folder: Path) -> Path:
    """Return the path of a mesh file of a URDF.

    If the name contains a ROS package, the function searches the package in all folders above the
    URDF.
    """
    if not name.startswith(PACKAGE_PREFIX):
        return folder / name.removeprefix(FILE_SCHEME_PREFIX)
    package, *path_parts = PurePath(name.removeprefix(PACKAGE_PREFIX)).parts
    possible_paths = [
        parent_folder.joinpath(*path_parts)
        for parent_folder in (folder, *folder.parents)
        if parent_folder.name == package
    ]
    possible_paths += [above.joinpath(package, *path_parts) for above in (folder, *folder.parents)]
    possible_paths.append(folder / PurePath(name).name)
    return next(
        (possible_path for possible_path in possible_paths if possible_path.is_file()),
        folder.joinpath(*path_parts),
    )


def urdf_meshes(xml_root: ET.Element, folder: Path, model: Any) -> Iterator[BodyMesh]:
    """Yield the visual meshes of a URDF.

    Args:
        xml_root: first XML element of the URDF.
        folder: folder of the URDF.
        model: compiled MuJoCo model, which has a body for each link except the root link.
    """
    files = urdf_files(xml_root, folder)
    for link in xml_root.iter("link"):
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link.get("name", ""))
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None or not mesh.get("filename"):
                continue
            origin = visual.find("origin")
            origin_attributes = {} if origin is None else origin.attrib
            turn = np.zeros(4)
            mujoco.mju_euler2Quat(
                turn, _three_numbers(origin_attributes.get("rpy", "0 0 0")), "XYZ"
            )
            yield BodyMesh(
                body=max(body, 0),
                file=files[mesh.get("filename", "")],
                scale=_three_numbers(mesh.get("scale", "1 1 1")),
                position=_three_numbers(origin_attributes.get("xyz", "0 0 0")),
                rotation=rotation_of_quaternion(turn),
            )


def _three_numbers(text: str) -> Any:
    """Return the three numbers in the text of an XML attribute."""
    return np.array([float(word) for word in text.split()])


def mjcf_meshes(model_spec: Any, model: Any, folder: Path, notes: list[str]) -> Iterator[BodyMesh]:
    """Yield the meshes of an MJCF model.

    A mesh without contacts is a visual mesh. If a body has visual meshes, the function yields only
    the visual meshes of the body.

    Args:
        model_spec: source of the model (``mujoco.MjSpec``).
        model: compiled model.
        folder: folder of the MJCF file.
        notes: list of notes for the user. The function adds a line for each mesh whose placement a
            hand file cannot express.
    """
    geoms = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    is_visual_geom = (model.geom_contype | model.geom_conaffinity) == 0
    bodies = {int(model.geom_bodyid[geom]) for geom in geoms if is_visual_geom[geom]}
    assets = {mesh.id: mesh for mesh in model_spec.meshes}
    for geom in geoms.tolist():
        body = int(model.geom_bodyid[geom])
        asset = assets[int(model.geom_dataid[geom])]
        if not asset.file or (body in bodies and not is_visual_geom[geom]):
            continue
        scale = np.array(asset.scale)
        reference = rotation_of_quaternion(np.array(asset.refquat) / np.linalg.norm(asset.refquat))
        if np.ptp(scale) and not np.array_equal(reference, np.eye(3)):
            notes.append(
                f"mesh {asset.file} is not read: it is scaled differently along axes after a turn"
            )
            continue
        # MuJoCo moves each vertex v of a mesh to scale * reference^T (v - refpos). Then MuJoCo
        # turns the mesh to the principal axes of the mesh's inertia.
        mesh = int(model.geom_dataid[geom])
        rotation = (
            rotation_of_quaternion(model.geom_quat[geom])
            @ rotation_of_quaternion(model.mesh_quat[mesh]).T
        )
        origin = model.geom_pos[geom] - rotation @ model.mesh_pos[mesh]
        yield BodyMesh(
            body=body,
            file=folder
            / model_spec.meshdir
            / (PurePath(asset.file).name if model_spec.strippath else asset.file),
            scale=scale,
            position=origin - rotation @ (scale * (reference.T @ asset.refpos)),
            rotation=rotation @ reference.T,
        )


def rotation_of_quaternion(quaternion: Any) -> Any:
    """Return the rotation matrix (3, 3) of a quaternion."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
