"""Test how files with gains are written, read and restored.

A user can undo every change of the gains. A reader never sees a file that is only partly written.
"""

import os
from pathlib import Path

import pytest

from handctl.core.gains.gain_bounds import gains_with_values
from handctl.core.gains.gains import Gains, GainsProvenance, gains_text, load_gains, load_gains_file
from handctl.errors import ConfigError
from handctl.tune.gains_store import MANUAL_EDIT_NOTE, GainsStore


def gains_with_force(force_N: float) -> Gains:
    return gains_with_values(Gains(), {"motion.force_N": force_N}, "test")


@pytest.fixture
def gains_store(tmp_path: Path) -> GainsStore:
    return GainsStore("jamia", "abc", tmp_path)


def present_motion_force(gains_store: GainsStore) -> float:
    file = gains_store.present_gains()
    return file.gains.motion.force_N if file else Gains().motion.force_N


def test_a_file_reads_back_with_its_provenance(tmp_path: Path) -> None:
    provenance = GainsProvenance(
        log=("a.mcap", "b.mcap"), fit="c.toml", study="s", note="käse", number=3, restores=0
    )
    path = tmp_path / "g.toml"
    path.write_text(gains_text(gains_with_force(31.0), provenance))
    assert load_gains_file(path).provenance == provenance
    assert load_gains(path) == gains_with_force(31.0)


def test_a_gains_file_without_provenance_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "g.toml"
    path.write_text("[motion]\nforce_N = 31.0\n")
    gains = load_gains(path)
    assert gains == gains_with_force(31.0)
    assert gains.model_fields_set == {"motion"}
    assert gains.motion.model_fields_set == {"force_N"}


def test_repeated_rollbacks_go_back_to_the_packaged_gains(gains_store: GainsStore) -> None:
    assert gains_store.present_gains() is None
    for newtons in (21.0, 22.0, 23.0):
        gains_store.apply_gains(gains_with_force(newtons), GainsProvenance())
    forces = []
    for _ in range(3):
        gains_store.roll_back()
        forces.append(present_motion_force(gains_store))
    assert forces == [22.0, 21.0, Gains().motion.force_N]
    with pytest.raises(ConfigError, match="no gains precede the packaged gains"):
        gains_store.roll_back()
    assert gains_store.roll_back(to=3).gains == gains_with_force(23.0)
    assert [entry.number for entry in gains_store.history_entries()] == list(range(1, 8))


def test_a_rollback_after_a_rollback_and_a_change_skips_the_undone_gains(
    gains_store: GainsStore,
) -> None:
    for newtons in (21.0, 22.0):
        gains_store.apply_gains(gains_with_force(newtons), GainsProvenance())
    gains_store.roll_back()
    gains_store.apply_gains(gains_with_force(24.0), GainsProvenance())
    assert gains_store.roll_back().gains == gains_with_force(21.0)


def test_gains_edited_by_hand_are_kept(gains_store: GainsStore) -> None:
    gains_store.apply_gains(gains_with_force(21.0), GainsProvenance())
    gains_store.path.write_text(
        gains_store.path.read_text().replace("force_N = 21.0", "force_N = 77.0")
    )
    gains_store.apply_gains(gains_with_force(22.0), GainsProvenance())
    assert [entry.file.gains.motion.force_N for entry in gains_store.history_entries()] == [
        21.0,
        77.0,
        22.0,
    ]
    assert gains_store.history_entries()[1].file.provenance.note == MANUAL_EDIT_NOTE
    assert gains_store.roll_back().gains == gains_with_force(77.0)


def test_copied_gains_follow_the_newest_entry(gains_store: GainsStore, tmp_path: Path) -> None:
    gains_store.apply_gains(gains_with_force(21.0), GainsProvenance())
    gains_store.path.write_text(gains_text(gains_with_force(55.0), GainsProvenance()))
    assert gains_store.roll_back().gains == gains_with_force(21.0)
    assert [entry.file.gains.motion.force_N for entry in gains_store.history_entries()] == [
        21.0,
        55.0,
        21.0,
    ]
    assert gains_store.history_entries()[1].file.provenance.replaces == 1


def test_a_damaged_file_is_set_aside_and_not_lost(gains_store: GainsStore) -> None:
    gains_store.apply_gains(gains_with_force(21.0), GainsProvenance())
    assert gains_store.rename_damaged_file() is None
    renamed_files = []
    for text in ("schema = [", "nonsense = 1"):
        gains_store.path.write_text(text)
        with pytest.raises(ConfigError):
            gains_store.roll_back()
        renamed_path = gains_store.rename_damaged_file()
        assert renamed_path is not None
        renamed_files.append((renamed_path.name, renamed_path.read_text()))
        assert gains_store.roll_back(to=1).gains == gains_with_force(21.0)
    assert renamed_files == [
        ("jamia.gains.damaged.toml", "schema = ["),
        ("jamia.gains.damaged1.toml", "nonsense = 1"),
    ]


def test_a_history_with_a_gap_is_not_used_for_a_rollback(gains_store: GainsStore) -> None:
    for newtons in (21.0, 22.0, 23.0):
        gains_store.apply_gains(gains_with_force(newtons), GainsProvenance())
    gains_store.roll_back()
    (gains_store.history_folder / "0002.toml").unlink()
    with pytest.raises(ConfigError, match="number 2 is not in the history"):
        gains_store.roll_back()
    assert gains_store.roll_back(to=1).gains == gains_with_force(21.0)


def test_provenance_says_who_when_and_for_which_hand(gains_store: GainsStore) -> None:
    provenance = gains_store.apply_gains(
        gains_with_force(21.0), GainsProvenance(study="s.db", log=("a.mcap",))
    ).provenance
    assert (
        provenance.study,
        provenance.log,
        provenance.hand,
        provenance.identity,
        provenance.number,
    ) == (
        "s.db",
        ("a.mcap",),
        "jamia",
        "abc",
        1,
    )
    assert provenance.made
    assert provenance.version


def test_a_rollback_without_history_is_refused(gains_store: GainsStore) -> None:
    with pytest.raises(ConfigError, match="nothing was applied"):
        gains_store.roll_back()
    with pytest.raises(ConfigError, match="no gains number 9"):
        gains_store.roll_back(to=9)


@pytest.mark.parametrize("failing_function", ["replace", "link", "fsync"])
def test_a_change_that_fails_leaves_the_present_gains(
    gains_store: GainsStore, monkeypatch: pytest.MonkeyPatch, failing_function: str
) -> None:
    gains_store.apply_gains(gains_with_force(21.0), GainsProvenance())
    content_before = gains_store.path.read_bytes()

    def raise_disk_full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, failing_function, raise_disk_full)
    with pytest.raises(ConfigError, match="No space left"):
        gains_store.apply_gains(gains_with_force(22.0), GainsProvenance())
    monkeypatch.undo()
    assert gains_store.path.read_bytes() == content_before
    assert present_motion_force(gains_store) == 21.0
    gains_store.apply_gains(gains_with_force(23.0), GainsProvenance())
    assert present_motion_force(gains_store) == 23.0
