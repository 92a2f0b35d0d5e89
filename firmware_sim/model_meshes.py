"""Meshes in a robot description, URDF or MJCF: files and places. The files are not read here."""

from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import mujoco  # type: ignore[import-untyped,unused-ignore]
import numpy as np

PACKAGE_PREFIX = "package://"
"""Start of a path within a ROS package."""
SCHEME_PREFIX = "file://"
"""Start of a path with a scheme."""


class BodyMesh(NamedTuple):
    """Mesh on a body.

    Attributes:
        body: number of the body, 0 for the world.
        file: path of the file.
        scale: (3,) factors from the unit of the file to metres.
        position: (3,) in the frame of the body [m].
        rotation: (3, 3) to the frame of the body.
    """

    body: int
    file: Path
    scale: Any
    position: Any
    rotation: Any


def urdf_files(root: ET.Element, folder: Path) -> dict[str, Path]:
    """Return the path of each mesh file of a URDF by its name in the URDF."""
    names = {mesh.get("filename", "") for mesh in root.iter("mesh")}
    return {name: _urdf_path(name, folder) for name in names if name}


def _urdf_path(name: str, folder: Path) -> Path:
    """Return the path of a mesh of a URDF. A package is a folder above the URDF or beside one."""
    if not name.startswith(PACKAGE_PREFIX):
        return folder / name.removeprefix(SCHEME_PREFIX)
    package, *parts = PurePath(name.removeprefix(PACKAGE_PREFIX)).parts
    places = [above.joinpath(*parts) for above in (folder, *folder.parents) if above.name == package]
    places += [above.joinpath(package, *parts) for above in (folder, *folder.parents)]
    places.append(folder / PurePath(name).name)
    return next((place for place in places if place.is_file()), folder.joinpath(*parts))


def urdf_meshes(root: ET.Element, folder: Path, model: Any) -> Iterator[BodyMesh]:
    """Yield the visual meshes of a URDF.

    Args:
        root: first element.
        folder: folder of the URDF.
        model: compiled model, with the bodies of all links but the root.
    """
    files = urdf_files(root, folder)
    for link in root.iter("link"):
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link.get("name", ""))
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None or not mesh.get("filename"):
                continue
            origin = visual.find("origin")
            place = {} if origin is None else origin.attrib
            turn = np.zeros(4)
            mujoco.mju_euler2Quat(turn, _numbers(place.get("rpy", "0 0 0")), "XYZ")
            yield BodyMesh(
                body=max(body, 0),
                file=files[mesh.get("filename", "")],
                scale=_numbers(mesh.get("scale", "1 1 1")),
                position=_numbers(place.get("xyz", "0 0 0")),
                rotation=rotation_of(turn),
            )


def _numbers(text: str) -> Any:
    """Return the three numbers of an attribute."""
    return np.array([float(word) for word in text.split()])


def mjcf_meshes(spec: Any, model: Any, folder: Path, notes: list[str]) -> Iterator[BodyMesh]:
    """Yield the meshes of a model of MJCF, those without contacts if a body has such meshes.

    Args:
        spec: source of the model.
        model: compiled model.
        folder: folder of the file.
        notes: one line is added for each mesh whose place a hand file cannot have.
    """
    geoms = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    visual = (model.geom_contype | model.geom_conaffinity) == 0
    bodies = {int(model.geom_bodyid[geom]) for geom in geoms if visual[geom]}
    assets = {mesh.id: mesh for mesh in spec.meshes}
    for geom in geoms.tolist():
        body = int(model.geom_bodyid[geom])
        asset = assets[int(model.geom_dataid[geom])]
        if not asset.file or (body in bodies and not visual[geom]):
            continue
        scale = np.array(asset.scale)
        reference = rotation_of(np.array(asset.refquat) / np.linalg.norm(asset.refquat))
        if np.ptp(scale) and not np.array_equal(reference, np.eye(3)):
            notes.append(f"mesh {asset.file} is not read: it is scaled differently along axes after a turn")
            continue
        # MuJoCo moves the vertices v to scale * reference^T (v - refpos), and then to the axes of their inertia.
        mesh = int(model.geom_dataid[geom])
        rotation = rotation_of(model.geom_quat[geom]) @ rotation_of(model.mesh_quat[mesh]).T
        origin = model.geom_pos[geom] - rotation @ model.mesh_pos[mesh]
        yield BodyMesh(
            body=body,
            file=folder / spec.meshdir / (PurePath(asset.file).name if spec.strippath else asset.file),
            scale=scale,
            position=origin - rotation @ (scale * (reference.T @ asset.refpos)),
            rotation=rotation @ reference.T,
        )


def rotation_of(quaternion: Any) -> Any:
    """Return the rotation of a quaternion, (3, 3)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
