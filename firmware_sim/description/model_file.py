"""Read the links in a robot description (URDF or MJCF) with MuJoCo.

The returned values are plain Python values, without MuJoCo objects.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any
from xml.etree import ElementTree as ET

import mujoco  # type: ignore[import-untyped,unused-ignore]
import numpy as np

from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.description.model_meshes import (
    BodyMesh,
    mjcf_meshes,
    rotation_of_quaternion,
    urdf_files,
    urdf_meshes,
)
from firmware_sim.printing import one_line_message

ROOT_TAGS = {"urdf": "robot", "mjcf": "mujoco"}
"""Tag of the first XML element of each format."""
POLYNOMIAL_LENGTH = 5
"""Number of coefficients of a polynomial that couples two joints in MuJoCo."""
MODEL_SUFFIXES = (".urdf", ".xml")
"""Suffixes of model files that MuJoCo reads."""
URDF_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
"""Joint types of URDF that a hand can have."""
UNSUPPORTED_JOINT_TYPES = {
    mujoco.mjtJoint.mjJNT_FREE: "a floating joint",
    mujoco.mjtJoint.mjJNT_BALL: "a ball joint",
}
"""Joint types of MuJoCo that a hand cannot have."""
ROUND_SHAPES = (
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_SPHERE,
)
"""Shapes from which the radius of a link is taken. The preferred shapes come first."""
BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
"""Corners (8, 3) of a box around the origin, whose edges have the length 2."""


def read_model_file(path: str, file_format: str) -> dict[str, Any]:
    """Read the tree of links of a hand from a URDF or MJCF file.

    All returned poses belong to joint angles of zero, as in the file. Bodies that are fixed to each
    other become a single link. The frame of a link has its origin at the joint of the link.

    Args:
        path: path of the URDF or MJCF file.
        file_format: ``urdf`` or ``mjcf``.

    Returns:
        Plain values in a table:

        - ``name``: name of the model.
        - ``gravity``: (3,) acceleration of gravity in the root frame [m/s2]. None if the file
          format has no gravity.
        - ``palm``: (3,) origin of each named frame fixed to the root, by name [m].
        - ``palm_meshes``: meshes fixed to the root, in the same form as the ``meshes`` of
          a link.
        - ``links``: one table for each link, see ``_link_values``. Parents come first. The
          entry ``follows`` has the name of the joint that the joint of the link follows, and the
          ratio of the two angles. It is None for an independent joint. The
          ``meshes`` of a link are tables with ``file``, ``scale`` (3,), ``position`` (3,) [m] and
          ``rotation`` (3, 3) in the frame of the link.
        - ``tendons``: for each tendon, its name, moment arms by joint [m], motor or None,
          maximum tension [N] or None, and ``pulls_both_ways``, which is True if the motor commands
          positive and negative forces.
        - ``notes``: one line for each element of the file that was not read.

    Raises:
        SimulatorError: the file is not readable, or does not describe a tree of links with inertia
            and hinges.
    """
    root = _parsed_root(path, file_format)
    if file_format == "urdf":
        _check_joint_types(root, path)
    notes: list[str] = []
    spec, model = _compiled_model(path, file_format, root, notes)
    _check_structure(model, path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jointed_bodies = [body for body in range(1, model.nbody) if model.body_jntnum[body]]
    folder = Path(path).absolute().parent
    urdf = file_format == "urdf"
    visual_meshes = (
        urdf_meshes(root, folder, model) if urdf else mjcf_meshes(spec, model, folder, notes)
    )
    meshes = list(visual_meshes)
    links = [_link_values(model, data, jointed_bodies, body, path) for body in jointed_bodies]
    coupled_joints = _coupled_joints(model, root)
    for link in links:
        link["follows"] = coupled_joints.get(link["joint"])
    for body, link in zip(jointed_bodies, links, strict=True):
        axes = data.xmat[body].reshape(3, 3)
        link_origin = data.xanchor[model.body_jntadr[body]]
        link["meshes"] = _mesh_values(meshes, model, data, body, link_origin, axes)
    return {
        "name": root.get("name") or root.get("model") or Path(path).stem,
        "gravity": model.opt.gravity.tolist() if file_format == "mjcf" else None,
        "palm": _frame_origins(model, data, 0, np.zeros(3), np.eye(3)),
        "palm_meshes": _mesh_values(meshes, model, data, 0, np.zeros(3), np.eye(3)),
        "links": links,
        "tendons": _tendon_values(model, notes),
        "notes": notes,
    }


def _parsed_root(path: str, file_format: str) -> ET.Element:
    """Parse the XML of a model file, check its first element and return the element."""
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise SimulatorError(
            f"{path}: cannot be read: {error.strerror}; expected a readable file"
        ) from None
    except (ET.ParseError, UnicodeError, ValueError) as error:
        raise SimulatorError(
            f"{path}: not XML: {error}; expected {_format_name(file_format)}"
        ) from None
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise SimulatorError(f"{path}: xacro; expected the URDF that the command xacro makes of it")
    if root.tag != ROOT_TAGS[file_format]:
        other_tag = next(
            (f": give it with --{name}" for name, tag in ROOT_TAGS.items() if tag == root.tag), ""
        )
        raise SimulatorError(
            f"{path}: its first element is <{root.tag}>; expected {_format_name(file_format)}{other_tag}"
        )
    return root


def _format_name(file_format: str) -> str:
    return f"{file_format.upper()}, with the first element <{ROOT_TAGS[file_format]}>"


def _check_joint_types(xml_root: ET.Element, path: str) -> None:
    """Refuse a URDF with joints that a hand cannot have.

    MuJoCo would read some unsupported joints as joints of another type, without an error.
    """
    for joint in xml_root.iter("joint"):
        kind = joint.get("type")
        if kind is not None and kind not in URDF_JOINT_TYPES:
            problem_text = f"joint {joint.get('name')} is {kind}"
            raise SimulatorError(f"{path}: {problem_text}; expected {', '.join(URDF_JOINT_TYPES)}")
        mimic = joint.find("mimic")
        if mimic is not None and float(mimic.get("offset", 0.0)) != 0.0:
            raise SimulatorError(
                f"{path}: joint {joint.get('name')} follows {mimic.get('joint')} with an offset; "
                "expected an angle that is proportional to the angle of the other joint"
            )


def _compiled_model(
    path: str, file_format: str, xml_root: ET.Element, notes: list[str]
) -> tuple[Any, Any]:
    """Compile a model file with MuJoCo, without merging bodies that are fixed to each other.

    If a mesh cannot be read, the model contains no shapes with meshes.
    """
    try:
        spec = _parsed_spec(path)
        spec.compiler.fusestatic = False
        spec.compiler.discardvisual = False
        if file_format == "urdf":
            # In a URDF, separate elements give the inertia of a link. The inertia does not follow
            # from the shapes of the link.
            spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
            _name_mesh_files(spec, xml_root, Path(path).absolute().parent)
        try:
            return spec, _compile_spec(spec)
        except ValueError as error:
            if not _remove_meshes(spec):
                raise
            model = _compile_spec(spec)
            notes.append(f"shapes of meshes are not read: {_first_line(error)}")
            return spec, model
    except (UnicodeError, ValueError) as error:
        raise SimulatorError(f"{path}: {_first_line(error)}") from None


def _name_mesh_files(model_spec: Any, xml_root: ET.Element, folder: Path) -> None:
    """Replace the names of meshes in a URDF by the paths of the mesh files.

    MuJoCo itself finds no files in ROS packages, and ignores the folder in the name of a mesh.
    """
    path_by_name = {
        PurePath(name).name: mesh_path for name, mesh_path in urdf_files(xml_root, folder).items()
    }
    for mesh in model_spec.meshes:
        mesh.file = str(path_by_name.get(PurePath(mesh.file).name, mesh.file))
    model_spec.strippath = False


def _compile_spec(model_spec: Any) -> Any:
    """Compile a model, and suppress the warnings of MuJoCo.

    MuJoCo warns about the dynamics of the model, but this module does not use the dynamics. The
    printed warnings would add lines to an error message that must have a single line.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return model_spec.compile()


def _parsed_spec(path: str) -> Any:
    """Parse a model file.

    If the suffix of the file is not in ``MODEL_SUFFIXES``, MuJoCo receives the content of the file
    as text.
    """
    if Path(path).suffix in MODEL_SUFFIXES:
        return mujoco.MjSpec.from_file(path)
    spec = mujoco.MjSpec.from_string(Path(path).read_text(encoding="utf-8"))
    spec.modelfiledir = str(Path(path).parent)
    return spec


def _remove_meshes(model_spec: Any) -> bool:
    """Remove all shapes with meshes, and all images, from a model.

    If the model has no meshes and no images, return False.
    """
    shapes = [geom for geom in model_spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]
    mesh_parts = [*shapes, *model_spec.meshes, *model_spec.textures]
    for geom in model_spec.geoms:
        geom.material = ""
    for model_part in [*mesh_parts, *model_spec.materials]:
        model_spec.delete(model_part)
    return bool(mesh_parts)


def _first_line(mujoco_error: Exception) -> str:
    """Return the message of a MuJoCo error in one line."""
    text = " ".join(str(mujoco_error).split()).removeprefix("Error: ")
    if "moving bodies" in text:
        text += "; expected a mass and an inertia for each link that moves"
    return one_line_message(text)


def _check_structure(model: Any, path: str) -> None:
    """Check that the bodies of a model form a tree, and that each moving body has exactly one joint."""
    if model.njnt == 0:
        raise SimulatorError(f"{path}: no joints; expected a hand with hinges or prismatic joints")
    for joint in range(model.njnt):
        unsupported_type = UNSUPPORTED_JOINT_TYPES.get(mujoco.mjtJoint(int(model.jnt_type[joint])))
        if unsupported_type:
            raise SimulatorError(
                f"{path}: {_joint_name(model, joint)} is {unsupported_type}; expected hinges or prismatic joints"
            )
    for body in range(model.nbody):
        if model.body_jntnum[body] > 1:
            problem_text = f"body {model.body(body).name} has {model.body_jntnum[body]} joints"
            raise SimulatorError(
                f"{path}: {problem_text}; expected one joint for each body, with a body of some mass between"
            )
    for equality in range(model.neq):
        if _is_proportional_coupling(model, equality):
            continue
        name = model.equality(equality).name or str(equality)
        raise SimulatorError(
            f"{path}: the equality {name} closes a loop, or does not make an angle proportional to another angle; "
            "expected a tree, and joints that follow other joints with a constant ratio"
        )


def _is_proportional_coupling(model: Any, equality: int) -> bool:
    """Return True if an equality constraint makes the angle of a joint proportional to another joint angle."""
    if model.eq_type[equality] != mujoco.mjtEq.mjEQ_JOINT or model.eq_obj2id[equality] < 0:
        return False
    offset, ratio, *other_coefficients = model.eq_data[equality, :POLYNOMIAL_LENGTH].tolist()
    return bool(offset == 0.0 and ratio != 0.0 and not any(other_coefficients))


def _coupled_joints(model: Any, xml_root: ET.Element) -> dict[str, tuple[str, float]]:
    """Return, for each coupled joint, the joint that it follows and the ratio of the two angles.

    The couplings come from equality constraints of an MJCF file, and from mimic joints of a URDF.
    """
    coupled_joints = {
        _joint_name(model, int(model.eq_obj1id[equality])): (
            _joint_name(model, int(model.eq_obj2id[equality])),
            float(model.eq_data[equality, 1]),
        )
        for equality in range(model.neq)
    }
    for joint in xml_root.iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            leader = str(mimic.get("joint"))
            coupled_joints[str(joint.get("name"))] = leader, float(mimic.get("multiplier", 1.0))
    return coupled_joints


def _joint_name(model: Any, joint: int) -> str:
    return model.joint(joint).name or f"joint_{joint + 1}"


def _fixed_bodies(model: Any, root_body: int) -> list[int]:
    """Return a body and all bodies fixed to it."""
    return [body for body in range(model.nbody) if model.body_weldid[body] == root_body]


def _link_values(
    model: Any, model_data: Any, root_bodies: list[int], body_id: int, path: str
) -> dict[str, Any]:
    """Return one link of the model.

    Returns:
        Plain values in a table:

        - ``name``: name of the body, and ``joint``: name of the body's joint.
        - ``parent``: index of the parent in the list of links, -1 for the root.
        - ``position`` (3,) [m] and ``rotation`` (3, 3) of the link in the frame of its parent.
        - ``prismatic``: True if the joint slides along its axis. The values of a prismatic joint
          are in m, N and kg in place of rad, N m and kg m2.
        - ``axis``: (3,) axis of the joint in the frame of the link.
        - ``range``: (2,) limits of the joint [rad]. None for a joint without limits.
        - ``damping``, ``armature`` and ``stiffness`` of the joint, and ``rest``: angle at which the
          spring of the joint makes no torque [rad].
        - ``mass`` [kg], ``com``: (3,) centre of mass [m], ``inertia``: (3, 3) about the centre of
          mass [kg m2].
        - ``frames``: (3,) origin of each named frame fixed to the link, by name [m].
        - ``points``: (n, 3) corners of the boxes around the shapes of the link [m].
        - ``radius``: half of the width of the shapes of the link [m]. None for a link without
          shapes.
    """
    joint = int(model.body_jntadr[body_id])
    dof = int(model.jnt_dofadr[joint])
    link_origin = model_data.xanchor[joint].copy()
    rotation = model_data.xmat[body_id].reshape(3, 3).copy()
    parent_body = int(model.body_weldid[model.body_parentid[body_id]])
    parent_origin, parent_rotation = np.zeros(3), np.eye(3)
    if parent_body:
        parent_origin = model_data.xanchor[model.body_jntadr[parent_body]]
        parent_rotation = model_data.xmat[parent_body].reshape(3, 3)
    zero = float(model.qpos0[model.jnt_qposadr[joint]])
    mass, com, inertia = _link_inertia(
        model, model_data, _fixed_bodies(model, body_id), link_origin, rotation
    )
    if mass <= 0.0:
        raise SimulatorError(
            f"{path}: link {model.body(body_id).name} has no mass; expected its mass and its inertia"
        )
    points, radius = _shape_corners(
        model, model_data, _fixed_bodies(model, body_id), link_origin, rotation
    )
    return {
        "name": model.body(body_id).name,
        "joint": _joint_name(model, joint),
        "parent": root_bodies.index(parent_body) if parent_body else -1,
        "position": (parent_rotation.T @ (link_origin - parent_origin)).tolist(),
        "rotation": (parent_rotation.T @ rotation).tolist(),
        "prismatic": bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE),
        "axis": (rotation.T @ model_data.xaxis[joint]).tolist(),
        "range": (model.jnt_range[joint] - zero).tolist() if model.jnt_limited[joint] else None,
        "damping": float(np.ravel(model.dof_damping[dof])[0]),
        "armature": float(model.dof_armature[dof]),
        "stiffness": float(np.ravel(model.jnt_stiffness[joint])[0]),
        "rest": float(model.qpos_spring[model.jnt_qposadr[joint]]) - zero,
        "mass": mass,
        "com": com,
        "inertia": inertia,
        "frames": _frame_origins(model, model_data, body_id, link_origin, rotation),
        "points": points,
        "radius": radius,
    }


def _mesh_values(
    meshes: Sequence[BodyMesh],
    model: Any,
    model_data: Any,
    root_body: int,
    link_origin: Any,
    link_rotation: Any,
) -> list[dict[str, Any]]:
    """Return the meshes of a link as plain values.

    The poses of the meshes are given in the frame of the link.
    """
    mesh_sections = []
    members = _fixed_bodies(model, root_body)
    for mesh in meshes:
        if mesh.body in members:
            axes = model_data.xmat[mesh.body].reshape(3, 3)
            mesh_position = model_data.xpos[mesh.body] + axes @ mesh.position - link_origin
            mesh_sections.append({
                "file": str(mesh.file),
                "scale": mesh.scale.tolist(),
                "position": (link_rotation.T @ mesh_position).tolist(),
                "rotation": (link_rotation.T @ axes @ mesh.rotation).tolist(),
            })  # fmt: skip
    return mesh_sections


def _link_inertia(
    model: Any, model_data: Any, body_ids: list[int], link_origin: Any, link_rotation: Any
) -> tuple[float, list[float], list[list[float]]]:
    """Return mass, centre of mass and central inertia of bodies fixed to each other, in the frame of a link."""
    masses = model.body_mass[body_ids]
    mass = float(masses.sum())
    if mass <= 0.0:
        return 0.0, [], []
    centre = masses @ model_data.xipos[body_ids] / mass
    total_inertia = np.zeros((3, 3))
    for body in body_ids:
        axes = model_data.ximat[body].reshape(3, 3)
        offset_from_centre = model_data.xipos[body] - centre
        # Steiner's theorem converts the inertia of each body to the common centre of mass.
        total_inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        total_inertia += model.body_mass[body] * (
            offset_from_centre @ offset_from_centre * np.eye(3)
            - np.outer(offset_from_centre, offset_from_centre)
        )
    return (
        mass,
        (link_rotation.T @ (centre - link_origin)).tolist(),
        (link_rotation.T @ total_inertia @ link_rotation).tolist(),
    )


def _frame_origins(
    model: Any, model_data: Any, root_body: int, link_origin: Any, link_rotation: Any
) -> dict[str, list[float]]:
    """Return a dictionary with the origins of the named bodies and sites of a link.

    The keys are the names. Each origin (3,) is given in the frame of the link [m].
    """
    members = _fixed_bodies(model, root_body)
    origin_by_body = {
        model.body(body).name: model_data.xpos[body] for body in members if body != root_body
    }
    # MuJoCo computes the positions of sites only in its first step. So this function computes the
    # positions of the sites.
    for site in range(model.nsite):
        body = int(model.site_bodyid[site])
        if body in members:
            origin_by_body[model.site(site).name] = (
                model_data.xpos[body] + model_data.xmat[body].reshape(3, 3) @ model.site_pos[site]
            )
    return {
        name: (link_rotation.T @ (body_origin - link_origin)).tolist()
        for name, body_origin in origin_by_body.items()
        if name
    }


def _shape_corners(
    model: Any, model_data: Any, body_ids: list[int], link_origin: Any, link_rotation: Any
) -> tuple[list[list[float]], float | None]:
    """Return the corners (n, 3) of the boxes around the shapes of a link, and the radius of the link [m].

    The radius is the largest half width of the shapes of one kind: the first kind in
    ``ROUND_SHAPES`` that the link has. If the link has none of these kinds, the radius is the
    largest half width of all its shapes. If the link has no shapes, the list of corners is empty,
    and the radius is None.
    """
    corners: list[Any] = []
    radii: dict[int, float] = {}
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        if body not in body_ids or kind in (
            mujoco.mjtGeom.mjGEOM_PLANE,
            mujoco.mjtGeom.mjGEOM_HFIELD,
        ):
            continue
        centre, half_sizes = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        axes = model_data.xmat[body].reshape(3, 3) @ rotation_of_quaternion(model.geom_quat[geom])
        geom_position = (
            model_data.xpos[body] + model_data.xmat[body].reshape(3, 3) @ model.geom_pos[geom]
        )
        corners.append(
            (geom_position + (centre + BOX_CORNERS * half_sizes) @ axes.T - link_origin)
            @ link_rotation
        )
        shape_rank = ROUND_SHAPES.index(kind) if kind in ROUND_SHAPES else len(ROUND_SHAPES)
        half_width = (
            float(model.geom_size[geom, 0])
            if kind in ROUND_SHAPES
            else float(np.sort(half_sizes)[:2].mean())
        )
        radii[shape_rank] = max(radii.get(shape_rank, 0.0), half_width)
    if not corners:
        return [], None
    return np.vstack(corners).tolist(), radii[min(radii)]


def _tendon_values(model: Any, notes: list[str]) -> list[dict[str, Any]]:
    """Return the tendons that have constant moment arms.

    The result contains the moment arms and the motor of each tendon.
    """
    tendon_sections = []
    for tendon in range(model.ntendon):
        name = model.tendon(tendon).name or f"tendon_{tendon + 1}"
        first_wrap = int(model.tendon_adr[tendon])
        wrap_indices = range(first_wrap, first_wrap + int(model.tendon_num[tendon]))
        if any(
            model.wrap_type[wrap_index] != mujoco.mjtWrap.mjWRAP_JOINT
            for wrap_index in wrap_indices
        ):
            notes.append(
                f"tendon {name} is not read: its path is given by points, and its moment arms change"
            )
            continue
        arms = {
            _joint_name(model, int(model.wrap_objid[wrap_index])): float(model.wrap_prm[wrap_index])
            for wrap_index in wrap_indices
        }
        motors = [
            actuator
            for actuator in range(model.nu)
            if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON
            and model.actuator_trnid[actuator, 0] == tendon
        ]
        tendon_sections.append({"name": name, "arms": arms, **_actuator_values(model, motors)})
    return tendon_sections


def _actuator_values(model: Any, motors: list[int]) -> dict[str, Any]:
    """Return a tendon's motor, the motor's largest tension [N], and True if the motor pulls in both directions.

    The motor and the largest tension are None unless the tendon has exactly one actuator. The
    largest tension is None unless the actuator commands a force of limited range. The value
    ``pulls_both_ways`` is True if the range of the force contains negative forces. A single tendon
    cannot push. An actuator with negative forces therefore belongs to two antagonistic tendons on
    one spool.
    """
    if len(motors) != 1:
        return {"motor": None, "tension_max": None, "pulls_both_ways": False}
    motor = motors[0]
    is_force_driven = (
        model.actuator_gaintype[motor] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_ctrllimited[motor]
    )
    scale = float(model.actuator_gainprm[motor, 0] * model.actuator_gear[motor, 0])
    min_force, max_force = sorted(scale * model.actuator_ctrlrange[motor])
    return {
        "motor": model.actuator(motor).name or None,
        "tension_max": float(max_force) if is_force_driven else None,
        "pulls_both_ways": bool(is_force_driven and min_force < 0.0 < max_force),
    }
