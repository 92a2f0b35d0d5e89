"""Gains of a hand on disk.

One file contains the present gains of a hand, and a numbered history contains all applied gains.
With the history, every change of the gains can be undone. Runs use `HAND.gains.toml`. The file
`HAND.gains/0001.toml` and the files with the next numbers contain all gains that have been applied
so far. Each file is written under a temporary name and then renamed. A program that reads the gains
therefore gets either the complete old file or the complete new file.
"""

import datetime
import itertools
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from handctl.core.gains.gains import (
    Gains,
    GainsFile,
    GainsProvenance,
    gains_text,
    load_gains_file,
    packaged_gains,
)
from handctl.errors import ConfigError
from handctl.output_files import write_text_atomically

MANUAL_EDIT_NOTE = "edited by hand"
"""Note in the provenance of those gains that a user has edited by hand."""


@dataclass(frozen=True, slots=True)
class StoredGains:
    """Entry of the history of gains.

    Attributes:
        path: path of the file in the history.
        file: content of the file: gains and their provenance.
    """

    path: Path
    file: GainsFile

    @property
    def number(self) -> int:
        """Return the number of this entry in the history of gains."""
        return self.file.provenance.number


class GainsStore:
    """Files with the present gains of a hand, and with all gains that were applied earlier.

    Attributes:
        path: path of the file with the present gains.
        history_folder: folder with the files of the history.
    """

    def __init__(
        self,
        hand: str,
        hand_identity: str = "",
        folder: Path = Path(),
        default_gains: Gains | None = None,
    ) -> None:
        """Set the paths of the files with the gains of a hand.

        Args:
            hand: name of the hand.
            hand_identity: hash of the description of the hand.
            folder: folder for the files.
            default_gains: gains that a rollback to number 0 restores. If None, it restores the
                packaged gains.
        """
        self.default_gains = default_gains or packaged_gains(hand)
        self.hand = hand
        self.hand_identity = hand_identity
        self.path = folder / f"{hand}.gains.toml"
        self.history_folder = folder / f"{hand}.gains"

    def present_gains(self) -> GainsFile | None:
        """Return the present gains of the hand.

        If there is no gains file, return None. Without a gains file, runs use the packaged gains.

        Raises:
            ConfigError: the file of the present gains cannot be used.
        """
        return load_gains_file(self.path) if self.path.exists() else None

    def history_entries(self) -> list[StoredGains]:
        """Return the entries of the history, the oldest first.

        Raises:
            ConfigError: a file of the history cannot be used.
        """
        paths = sorted(self.history_folder.glob("[0-9][0-9][0-9][0-9].toml"))
        return [StoredGains(path, load_gains_file(path)) for path in paths]

    def rename_damaged_file(self) -> Path | None:
        """Rename the file of the present gains if the file is damaged, and return the new path.

        If the file is not damaged, return None. A damaged file must be renamed before a rollback is
        possible.

        Raises:
            ConfigError: The file cannot be renamed.
        """
        try:
            self.present_gains()
        except ConfigError:
            # The new name is the first name among NAME.damaged.toml, NAME.damaged1.toml, and so on,
            # that is not in use.
            candidate_paths = (
                Path(f"{self.path.with_suffix('')}.damaged{n or ''}.toml")
                for n in itertools.count()
            )
            unused_path = next(path for path in candidate_paths if not path.exists())
            try:
                return self.path.rename(unused_path)
            except OSError as error:
                raise ConfigError(
                    f"cannot be moved: {error.strerror}", str(self.path), f"{unused_path}"
                ) from None
        return None

    def apply_gains(self, gains: Gains, provenance: GainsProvenance) -> GainsFile:
        """Make the given gains the present gains.

        If a user has edited the file of the present gains, the edited gains are added to the
        history first.

        Raises:
            ConfigError: the files cannot be written, or the file of the present gains cannot be
                read, see `rename_damaged_file`.
        """
        self._store_edited_gains()
        return self._write_gains(gains, provenance)

    def roll_back(self, to: int | None = None) -> GainsFile:
        """Restore the gains that precede the present gains in the history, or the gains with a given number.

        The argument `to` with the value 0 restores the packaged gains.

        Raises:
            ConfigError: The history contains no earlier gains, or no gains with the given number.
        """
        self._store_edited_gains()
        entries = {entry.number: entry for entry in self.history_entries()}
        present_gains = self.present_gains()
        if to is None and (present_gains is None or present_gains.provenance.number not in entries):
            raise ConfigError(
                "nothing was applied before", str(self.history_folder), "handctl gains apply first"
            )
        number = (
            _number_of_previous_gains(entries, present_gains)
            if to is None and present_gains is not None
            else to or 0
        )
        if number and number not in entries:
            numbers = ", ".join(map(str, [0, *entries]))
            raise ConfigError(
                f"no gains number {number}", str(self.history_folder), f"one of {numbers}"
            )
        note = f"rollback to {number}" if number else "rollback to the default gains"
        old_gains = entries[number].file.gains if number else self.default_gains
        provenance = entries[number].file.provenance if number else GainsProvenance()
        return self._write_gains(
            old_gains, provenance.model_copy(update={"note": note}), restored_number=number
        )

    def _store_edited_gains(self) -> None:
        """Add the present gains to the history, unless the history already contains them."""
        present_gains = self.present_gains()
        if present_gains is None:
            return
        gains_by_number = {entry.number: entry.file.gains for entry in self.history_entries()}
        if gains_by_number.get(present_gains.provenance.number) != present_gains.gains:
            self._write_gains(
                present_gains.gains,
                present_gains.provenance.model_copy(update={"note": MANUAL_EDIT_NOTE}),
            )

    def _write_gains(
        self, gains: Gains, provenance: GainsProvenance, restored_number: int | None = None
    ) -> GainsFile:
        """Write gains to the history with the next number, and then make them the present gains.

        The new entry of the history names the entry that it replaces, usually the present gains. A
        user can replace the file of the present gains by a file that is not in the history. If the
        present gains are not in the history, the new entry names the newest entry of the history.
        """
        present_gains = self.present_gains()
        entries = self.history_entries()
        numbers = [0, *(entry.number for entry in entries)]
        number_of_replaced_gains = present_gains.provenance.number if present_gains else 0
        if present_gains and (number_of_replaced_gains not in numbers[1:]):
            number_of_replaced_gains = numbers[-1]
        written_provenance = provenance.model_copy(
            update={
                "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                "version": version("handctl"),
                "hand": self.hand,
                "identity": provenance.identity or self.hand_identity,
                "number": entries[-1].number + 1 if entries else 1,
                "replaces": number_of_replaced_gains,
                "restores": restored_number,
            }
        )
        text = gains_text(gains, written_provenance)
        try:
            self.history_folder.mkdir(parents=True, exist_ok=True)
            # The history is written before the file of the present gains. So a crash of the program
            # between the two writes does not change the present gains.
            write_text_atomically(
                self.history_folder / f"{written_provenance.number:04d}.toml",
                text,
                must_be_new=True,
            )
            write_text_atomically(self.path, text)
        except OSError as error:
            raise ConfigError(
                f"cannot be written: {error.strerror}", str(self.path), "a writable folder"
            ) from None
        return load_gains_file(self.path)


def _number_of_previous_gains(
    gains_by_number: dict[int, StoredGains], present_gains: GainsFile
) -> int:
    """Return the history number of the gains that precede the present gains.

    After a rollback, the restored gains count as the present gains.

    Raises:
        ConfigError: The present gains are restored packaged gains, or an entry of the history is
            missing.
    """
    provenance = present_gains.provenance
    while provenance.restores:
        if provenance.restores not in gains_by_number:
            raise ConfigError(
                f"number {provenance.restores} is not in the history",
                "rollback",
                "handctl gains rollback --to N",
            )
        provenance = gains_by_number[provenance.restores].file.provenance
    if provenance.restores == 0:
        raise ConfigError(
            "no gains precede the packaged gains", "rollback", "handctl gains rollback --to N"
        )
    return provenance.replaces
