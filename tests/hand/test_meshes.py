"""Test the meshes of links and palm.

The tests cover valid and refused mesh files, the pose of a mesh on its link, and the export of
meshes. Meshes have no effect on the dynamics.
"""

import re
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest

from firmware_sim.description.hand_description import load_hand as simulated_hand
from firmware_sim.plant.mjcf import COLLISION_GEOM_GROUP, VISUAL_GEOM_GROUP, model_text
from firmware_sim.scene.scene import load_scene
from handctl.errors import ConfigError
from handctl.hand.file.json_schema import hand_schema
from handctl.hand.formats.link_meshes import (
    PALM_LINK,
    exported_meshes,
    mesh_mistakes,
    meshes_of_hand,
    with_meshes_from,
)
from handctl.hand.formats.mesh_file import mesh_triangles
from handctl.hand.formats.mjcf import mjcf_text
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import (
    hand_content,
    hand_from_content,
    load_hand,
    packaged_hands,
    parse_toml,
)
from tests.hand.mesh_files import (
    assert_same_corners,
    corners_by_link,
    corners_of_hand,
    hand_with_meshes,
    hand_without_meshes,
    tetrahedron_obj,
    tetrahedron_triangles,
    write_meshes,
)
from tools.meshes.__main__ import packaged_mesh_files
from tools.meshes.solids import stl


@pytest.fixture
def mesh_folder(tmp_path: Path) -> Path:
    write_meshes(tmp_path)
    return tmp_path


def test_a_binary_stl_and_an_obj_have_the_same_triangles() -> None:
    assert mesh_triangles(stl(tetrahedron_triangles()), ".stl") == pytest.approx(
        tetrahedron_triangles(), abs=1e-9
    )
    assert mesh_triangles(tetrahedron_obj(), ".OBJ") == pytest.approx(tetrahedron_triangles())
    assert mesh_triangles(tetrahedron_obj(mixes_face_notations=True), ".obj") == pytest.approx(
        tetrahedron_triangles()
    )


def test_a_face_of_more_corners_is_a_fan() -> None:
    text = b"v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\nf 1 2 3 4 5\n"
    assert len(mesh_triangles(text, ".obj")) == 3


def test_pictures_have_the_same_triangles_as_mujoco() -> None:
    for path, content in packaged_mesh_files():
        asset = f'<asset><mesh name="m" file="{path}"/></asset>'
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco>{asset}<worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>'
        )
        assert model.mesh_facenum[0] == len(mesh_triangles(content, ".stl"))


INVALID_MESH_FILES: dict[str, tuple[str, bytes, str]] = {
    "text": (
        "a.stl",
        b"solid a\nfacet normal 0 0 1\n" * 9,
        "an STL in text form; expected a binary STL",
    ),
    "short": (
        "a.stl",
        stl(tetrahedron_triangles())[:-1],
        "283 bytes for 4 triangles; expected a binary STL of 84 bytes and 50",
    ),
    "no header": ("a.stl", b"abc", "3 bytes; expected a binary STL"),
    "empty file": ("a.stl", b"", "0 bytes; expected a binary STL"),
    "no triangles": (
        "a.stl",
        stl(tetrahedron_triangles())[:80] + bytes(4),
        "no triangles; expected a mesh with at least one",
    ),
    "not finite": ("a.stl", stl(tetrahedron_triangles() * np.nan), "a corner that is not finite"),
    "no faces": ("a.obj", b"v 0 0 0\n", "no triangles"),
    "not an OBJ": (
        "a.obj",
        b"\x00\x01 f x\nf x y z\n",
        "line 2 is 'f x y z'; expected an OBJ with v and f lines",
    ),
    "a vertex that is not there": ("a.obj", b"v 0 0 0\nf 1 2 3\n", "a face with vertex 3 of 1"),
    "a vertex before the first": ("a.obj", b"v 0 0 0\nf -1 -2 -3\n", "line 2 is 'f -1 -2 -3'"),
    "two coordinates": ("a.obj", b"v 0 0\n", "line 1 is 'v 0 0'"),
    "too many": (
        "a.stl",
        stl(np.repeat(tetrahedron_triangles(), 50_001, axis=0)),
        "200004 triangles; expected at most 200000",
    ),
}


@pytest.mark.parametrize("mistake_kind", INVALID_MESH_FILES)
def test_a_file_that_is_no_mesh_is_named_with_what_is_right(
    tmp_path: Path, mistake_kind: str
) -> None:
    file, content, text = INVALID_MESH_FILES[mistake_kind]
    (tmp_path / file).write_bytes(content)
    hand = hand_with_mesh_keys("t42", link_mesh=["", file])
    (left_mistake, _) = mesh_mistakes(hand, tmp_path)
    assert text in f"{left_mistake.what}; expected {left_mistake.right}"
    assert left_mistake.where == "digit[left].link_mesh[1]"


def hand_with_mesh_keys(hand_name: str, **mesh_keys: object):
    """Return a packaged hand in which every digit has the mesh keys ``mesh_keys``."""
    content = hand_without_meshes(hand_name).content
    content["digit"] = [digit | mesh_keys for digit in content["digit"]]
    return hand_from_content(content, hand_name)


def test_a_missing_and_a_large_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.stl").mkdir()
    with (tmp_path / "large.stl").open("wb") as large_file:
        large_file.truncate(17 << 20)
    hand = hand_with_mesh_keys("t42", link_mesh=["folder.stl", "large.stl"])
    mistakes = [*mesh_mistakes(hand, tmp_path), *mesh_mistakes(hand, tmp_path / "elsewhere")]
    assert [mistake.what for mistake in mistakes] == 2 * [
        '"folder.stl": no such file',
        '"large.stl": 18 MB',
    ] + [
        '"folder.stl": no such file',
        '"large.stl": no such file',
    ] * 2


@pytest.mark.parametrize(
    ("mesh_keys", "expected_message"),
    [
        (
            {"link_mesh": ["sub/mm.stl", ""]},
            "30 m long; at most 1 m; link_mesh_scale = 0.001 if the mesh",
        ),
        (
            {"link_mesh": ["m.stl", ""], "link_mesh_scale": [1e-3, 1.0]},
            "3e-05 m long; at least 0.0005 m; is link",
        ),
        (
            {"link_mesh": ["m.stl", ""], "link_mesh_position_m": [[1.0, 0, 0], [0, 0, 0]]},
            "1.03 m away from its link;",
        ),
        (
            {"link_mesh": ["m.stl", ""], "link_mesh_scale": [1000.0, 1.0]},
            "30 m long; at most 1 m; link_mesh_scale = 0.001 if",
        ),
        (
            {"link_mesh": ["sub/mm.obj", ""], "link_mesh_scale": [1000.0, 1.0]},
            "3e+04 m long; at most 1 m",
        ),
    ],
)
def test_an_absurd_size_is_refused(
    mesh_folder: Path, mesh_keys: dict[str, object], expected_message: str
) -> None:
    (left_mistake, right_mistake) = mesh_mistakes(
        hand_with_mesh_keys("t42", **mesh_keys), mesh_folder
    )
    assert expected_message in f"{left_mistake.what}; {left_mistake.right}"
    assert right_mistake.where == "digit[right].link_mesh[0]"


@pytest.mark.parametrize(
    ("mesh_keys", "expected_message"),
    [
        (
            {"link_mesh": ["a.stl"]},
            "digit[left].link_mesh: 1 values; expected 2, one per link_length_m",
        ),
        (
            {"link_mesh": ["a.glb", ""]},
            'digit[left].link_mesh[0]: "a.glb"; expected a file of type .stl or .obj',
        ),
        (
            {"link_mesh": ["a", ""]},
            'digit[left].link_mesh[0]: "a"; expected a file of type .stl or .obj',
        ),
        ({"link_mesh": ["a\n.stl", ""]}, 'digit[left].link_mesh[0]: "a'),
        (
            {"link_mesh": [1, ""]},
            "digit[left].link_mesh[0]: 1; expected a file of type .stl or .obj",
        ),
        ({"link_mesh": "a.stl"}, 'digit[left].link_mesh: "a.stl"; expected a list'),
        (
            {"link_mesh_scale": [1.0, 1.0]},
            "digit[left].link_mesh_scale: given without link_mesh; expected link_mesh",
        ),
        (
            {"link_mesh": ["a.stl", ""], "link_mesh_scale": [1.0]},
            "digit[left].link_mesh_scale: 1 values; expected 2",
        ),
        (
            {"link_mesh": ["a.stl", ""], "link_mesh_scale": [0, 1.0]},
            "link_mesh_scale[0]: 0; expected a number from",
        ),
        (
            {"link_mesh": ["a.stl", ""], "link_mesh_scale": [[0, 1, 1], 1]},
            "link_mesh_scale[0]: a factor of 0;",
        ),
        (
            {"link_mesh": ["a.stl", ""], "link_mesh_scale": [[1, 1], 1]},
            "expected a number, or a list of 3 numbers",
        ),
        (
            {"link_mesh": ["a.stl", ""], "link_mesh_position_m": [[9, 0, 0], [0, 0, 0]]},
            "(in metres?)",
        ),
        (
            {"link_mesh": ["a.stl", ""], "link_mesh_rpy_deg": [[0, 0, 0]]},
            "link_mesh_rpy_deg: 1 values; expected 2",
        ),
    ],
)
def test_keys_of_meshes_are_checked(mesh_keys: dict[str, object], expected_message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected_message)):
        hand_with_mesh_keys("t42", **mesh_keys)


@pytest.mark.parametrize(
    ("mesh_keys", "expected_message"),
    [
        (
            {"palm_mesh": "palm.glb"},
            'mount.palm_mesh: "palm.glb"; expected a file of type .stl or .obj',
        ),
        (
            {"palm_mesh_scale": 1.0},
            "mount.palm_mesh_scale: given without palm_mesh; expected palm_mesh as well",
        ),
        (
            {"palm_mesh": "a.stl", "palm_mesh_scale": [1, 0, 1]},
            "mount.palm_mesh_scale: a factor of 0; expected",
        ),
    ],
)
def test_keys_of_the_palm_are_checked(mesh_keys: dict[str, object], expected_message: str) -> None:
    content = hand_without_meshes("t42").content
    with pytest.raises(ConfigError, match=re.escape(expected_message)):
        hand_from_content(content | {"mount": content["mount"] | mesh_keys}, "t42")


def test_one_scale_holds_for_all_links() -> None:
    assert {mesh.scale for mesh in meshes_of_hand(load_hand("t42"))} == {(1e-3,) * 3}
    assert hand_content("t42")["digit"][0]["link_mesh_scale"] == [1e-3, 1e-3]
    scale = hand_schema()["definitions"]["DigitValues"]["properties"]["link_mesh_scale"]
    assert [kind.get("type") for kind in scale["anyOf"]][-1] == "array"


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_meshes_survive_the_log_and_leave_the_identity(hand_name: str) -> None:
    hand = hand_with_meshes(hand_name)
    assert hand_from_content(parse_toml(hand.to_toml(), hand_name), hand_name) == hand
    assert hand.identity == hand_without_meshes(hand_name).identity == load_hand(hand_name).identity
    links = {PALM_LINK} | {
        f"{digit.name}_link{i + 1}" for digit in hand.digit for i in range(len(digit.joints)) if i
    }
    assert {mesh.link for mesh in meshes_of_hand(hand)} >= links


def test_packaged_meshes_are_those_of_their_script() -> None:
    for path, content in packaged_mesh_files():
        assert path.read_bytes() == content, f"{path.name}: run python -m tools.meshes"
    hand = load_hand("t42")
    mesh_folder = Path(next(packaged_mesh_files())[0]).parents[1]
    assert not list(mesh_mistakes(hand, mesh_folder))


def random_angles(hand, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(*hand.joint_limits)


def exported_models(hand, mesh_folder: Path) -> dict[str, mujoco.MjModel]:
    """Return MuJoCo models of a hand: the models from its exported files, and the model that the simulator draws."""
    output = mesh_folder / "out"
    output.mkdir()
    meshes = exported_meshes(hand, mesh_folder, output)
    (output / "hand.xml").write_text(mjcf_text(hand, meshes))
    (output / "hand.urdf").write_text(urdf_text(hand, meshes))
    (mesh_folder / "hand.toml").write_text(hand.to_toml())
    drawn_text = model_text(
        simulated_hand(str(mesh_folder / "hand.toml")), load_scene(None), meshes=True
    )
    return {
        "mjcf": mujoco.MjModel.from_xml_path(str(output / "hand.xml")),
        "urdf": mujoco.MjModel.from_xml_path(str(output / "hand.urdf")),
        "simulator": mujoco.MjModel.from_xml_string(drawn_text),
    }


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_exports_put_each_mesh_where_its_link_is(
    mesh_folder: Path, hand_name: str, rng: np.random.Generator
) -> None:
    hand = hand_with_meshes(hand_name)
    models = exported_models(hand, mesh_folder)
    for _ in range(3):
        q = random_angles(hand, rng)
        expected = corners_of_hand(hand, mesh_folder, q)
        for model in models.values():
            assert_same_corners(corners_by_link(model, q), expected)


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_meshes_have_no_effect_on_the_dynamics(
    mesh_folder: Path, hand_name: str, rng: np.random.Generator
) -> None:
    hand, bare_hand = hand_with_meshes(hand_name), hand_without_meshes(hand_name)
    (mesh_folder / "bare.toml").write_text(bare_hand.to_toml())
    models = exported_models(hand, mesh_folder)
    simulated = simulated_hand(str(mesh_folder / "bare.toml"))
    models_without_meshes = {
        "mjcf": mujoco.MjModel.from_xml_string(mjcf_text(bare_hand)),
        "simulator": mujoco.MjModel.from_xml_string(model_text(simulated, load_scene(None))),
    }
    # The MuJoCo model that a simulated run uses has the same text with and without meshes.
    meshed_plant = model_text(
        simulated_hand(str(mesh_folder / "hand.toml")), load_scene("cylinder")
    )
    assert meshed_plant == model_text(simulated, load_scene("cylinder"))
    for kind, model_without_meshes in models_without_meshes.items():
        model = models[kind]
        assert np.array_equal(model.body_mass, model_without_meshes.body_mass)
        assert np.array_equal(model.body_inertia, model_without_meshes.body_inertia)
        assert np.array_equal(model.body_ipos, model_without_meshes.body_ipos)
        is_mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
        assert not (model.geom_contype[is_mesh] | model.geom_conaffinity[is_mesh]).any()
        assert set(model.geom_group[is_mesh]) == {VISUAL_GEOM_GROUP}
        with_mesh = np.isin(model.geom_bodyid, model.geom_bodyid[is_mesh])
        assert set(model.geom_group[with_mesh & ~is_mesh]) <= {COLLISION_GEOM_GROUP}
        assert not (model.geom_group[~with_mesh] == COLLISION_GEOM_GROUP).any()
        q = random_angles(hand, rng)
        ends = []
        for stepped_model in (model, model_without_meshes):
            data = mujoco.MjData(stepped_model)
            data.qpos[: len(q)] = q
            for _ in range(20):
                mujoco.mj_step(stepped_model, data)
            ends.append(np.concatenate((data.qpos, data.qvel)))
        assert np.array_equal(*ends)


def test_other_libraries_read_the_urdf_with_its_meshes(mesh_folder: Path) -> None:
    hand = hand_with_meshes("orca_like")
    exported_models(hand, mesh_folder)
    path = str(mesh_folder / "out" / "hand.urdf")
    model = pinocchio.buildModelFromUrdf(path)
    kind = pinocchio.GeometryType.VISUAL
    visual_model = pinocchio.buildGeomFromUrdf(
        model, path, kind, package_dirs=[str(mesh_folder / "out")]
    )
    meshes = [
        file for shape in visual_model.geometryObjects if (file := Path(shape.meshPath)).suffix
    ]
    assert len(meshes) == len(meshes_of_hand(hand))
    assert all(mesh.is_file() for mesh in meshes)


def test_meshes_of_a_copied_file_are_found(
    mesh_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    hand = hand_with_meshes("t42")
    moved_hand = hand_from_content(with_meshes_from(hand.content, mesh_folder), "t42")
    assert list(mesh_mistakes(hand, elsewhere))
    assert not list(mesh_mistakes(moved_hand, elsewhere))
    assert [mesh.link for mesh in meshes_of_hand(moved_hand)] == [
        mesh.link for mesh in meshes_of_hand(hand)
    ]
