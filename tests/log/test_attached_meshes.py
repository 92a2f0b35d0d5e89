"""Test the mesh files that a log contains as attachments.

A log contains the meshes of its hand, up to a maximum total size. A program that shows the meshes
of a hand needs only the log, and no hand file. The log names the meshes that it does not contain.
"""

from pathlib import Path

import pytest
import synthetic_run

from handctl.hand.formats.link_meshes import meshes_of_hand
from handctl.hand.hand_loading import PACKAGED_HANDS_FOLDER, load_hand
from handctl.log import attached_meshes as module
from handctl.log.attached_meshes import MAX_MESH_BYTES, attached_meshes, mesh_attachments
from handctl.log.read.hand_in_log import described_hand
from handctl.log.read.reader import RunLog
from handctl.log.read.recover import recover_log
from tests.hand.mesh_files import hand_with_meshes, tetrahedron_triangles, write_meshes


def test_a_log_has_the_meshes_of_its_hand(tmp_path: Path) -> None:
    hand = load_hand("t42")
    attachments, left_out = mesh_attachments(hand, PACKAGED_HANDS_FOLDER)
    assert not left_out
    assert list(attachments) == ["mesh/t42/palm.stl", "mesh/t42/inner.stl", "mesh/t42/outer.stl"]
    log = tmp_path / "run.mcap"
    header = synthetic_run.synthetic_header("t42", 100)
    header.attachments.update(attachments)
    synthetic_run.write_synthetic_run(log, header, 0.5)
    recovered_log = tmp_path / "recovered.mcap"
    recover_log(log, recovered_log)
    for path in (log, recovered_log):
        with RunLog(path) as opened_log:
            mesh_by_link, missing = attached_meshes(
                described_hand(opened_log.header, "the log"), opened_log.header.attachments
            )
        assert not missing
        assert {link: mesh.data for link, mesh in mesh_by_link.items()} == {
            mesh.link: (PACKAGED_HANDS_FOLDER / mesh.file).read_bytes()
            for mesh in meshes_of_hand(hand)
        }


def test_a_mesh_of_several_links_is_there_once_and_placed_on_each(tmp_path: Path) -> None:
    write_meshes(tmp_path)
    hand = hand_with_meshes("jamia")
    attachments, left_out = mesh_attachments(hand, tmp_path)
    assert not left_out
    assert set(attachments) == {"mesh/m.stl", "mesh/sub/mm.stl", "mesh/sub/mm.obj"}
    mesh_by_link, missing = attached_meshes(hand, attachments)
    assert not missing
    assert mesh_by_link.keys() == {mesh.link for mesh in meshes_of_hand(hand)}
    for mesh in meshes_of_hand(hand):
        expected = tetrahedron_triangles() / max(
            abs(factor) for factor in (mesh.scale if mesh.file == "m.stl" else (1e-3,))
        )
        assert mesh_by_link[mesh.link].triangles == pytest.approx(
            mesh.to_link_frame(expected), abs=1e-9
        )


def test_meshes_beyond_the_bound_are_left_out_with_a_line(tmp_path: Path) -> None:
    write_meshes(tmp_path)
    with (tmp_path / "m.stl").open("r+b") as large_file:
        large_file.truncate(MAX_MESH_BYTES)
    attachments, left_out = mesh_attachments(hand_with_meshes("t42"), tmp_path)
    assert not attachments
    assert left_out == [
        "the meshes have 4.2 MB, more than 4.2 MB, and are not stored in the log: its views show capsules"
    ]


def test_a_mesh_that_is_wrong_is_left_out_with_a_line(tmp_path: Path) -> None:
    write_meshes(tmp_path)
    (tmp_path / "sub" / "mm.obj").unlink()
    attachments, left_out = mesh_attachments(hand_with_meshes("t42"), tmp_path)
    assert left_out == [
        'digit[left].link_mesh[1]: "sub/mm.obj": no such file; expected a file, relative to the hand file'
    ]
    mesh_by_link, missing = attached_meshes(hand_with_meshes("t42"), attachments)
    assert missing == ["left_link2"]
    assert mesh_by_link.keys() == {"palm", "right_link2"}


def test_a_damaged_mesh_in_a_log_is_missing(tmp_path: Path) -> None:
    write_meshes(tmp_path)
    hand = hand_with_meshes("t42")
    attachments, _ = mesh_attachments(hand, tmp_path)
    assert attached_meshes(hand, {})[1] == ["palm", "left_link2", "right_link2"]
    damaged_attachments = attachments | {"mesh/sub/mm.stl": attachments["mesh/sub/mm.stl"][:-7]}
    assert attached_meshes(hand, damaged_attachments)[1] == ["right_link2"]


def test_a_hand_without_meshes_reads_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        module, "read_meshes", lambda files, folder: {} if not files else pytest.fail(str(files))
    )
    assert mesh_attachments(load_hand("jamia"), Path("/nowhere")) == ({}, [])
