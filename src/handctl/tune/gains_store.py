"""The gains of a hand on disk: the present ones, and every one before them, numbered, so that a way back exists.

``HAND.gains.toml`` is what runs use; ``HAND.gains/0001.toml`` and so on is what was ever applied. Both are written
beside and moved into place: whoever reads finds the old file or the new one, never a part.
"""

import datetime
import itertools
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from handctl.core.gains.gains import Gains, GainsFile, Provenance, gains_text, load_gains_file
from handctl.errors import ConfigError
from handctl.output import write_whole

BY_HAND = "edited by hand"


@dataclass(frozen=True, slots=True)
class Entry:
    """Gains that were applied.

    Attributes:
        path: of the file in the history.
        file: gains and provenance; the number is ``file.provenance.number``.
    """

    path: Path
    file: GainsFile

    @property
    def number(self) -> int:
        """Number in the history."""
        return self.file.provenance.number


class GainsStore:
    """Present and former gains of a hand.

    Attributes:
        path: of the present ones.
        history: folder of all of them.
    """

    def __init__(self, hand: str, identity: str = "", folder: Path = Path()) -> None:
        """Args: name and identity of the hand; where its files are."""
        self.hand, self.identity = hand, identity
        self.path, self.history = folder / f"{hand}.gains.toml", folder / f"{hand}.gains"

    def present(self) -> GainsFile | None:
        """The gains that runs use; None if they are the packaged ones.

        Raises:
            ConfigError: the file cannot be used.
        """
        return load_gains_file(self.path) if self.path.exists() else None

    def entries(self) -> list[Entry]:
        """Everything that was ever applied, oldest first.

        Raises:
            ConfigError: a file of the history cannot be used.
        """
        paths = sorted(self.history.glob("[0-9][0-9][0-9][0-9].toml"))
        return [Entry(path, load_gains_file(path)) for path in paths]

    def set_aside(self) -> Path | None:
        """Move a present file that cannot be used out of the way, so that there is a way back; its new name.

        Raises:
            ConfigError: it cannot be moved.
        """
        try:
            self.present()
        except ConfigError:
            numbers = (Path(f"{self.path.with_suffix('')}.damaged{n or ''}.toml") for n in itertools.count())
            aside = next(path for path in numbers if not path.exists())
            try:
                return self.path.rename(aside)
            except OSError as error:
                raise ConfigError(f"cannot be moved: {error.strerror}", str(self.path), f"{aside}") from None
        return None

    def apply(self, gains: Gains, provenance: Provenance) -> GainsFile:
        """Make gains the present ones; those that were edited by hand are kept in the history first.

        Raises:
            ConfigError: the files cannot be written, or the present ones not be read; see ``set_aside``.
        """
        self._keep_edited()
        return self._put(gains, provenance)

    def rollback(self, to: int | None = None) -> GainsFile:
        """Bring back what was there before, or the gains of a number; 0 is the packaged ones.

        Raises:
            ConfigError: there is nothing to go back to, or no such number.
        """
        self._keep_edited()
        entries, present = {entry.number: entry for entry in self.entries()}, self.present()
        if to is None and (present is None or present.provenance.number not in entries):
            raise ConfigError("nothing was applied before", str(self.history), "handctl gains apply first")
        number = _before(entries, present) if to is None and present is not None else to or 0
        if number and number not in entries:
            known = ", ".join(map(str, [0, *entries]))
            raise ConfigError(f"no gains number {number}", str(self.history), f"one of {known}")
        old = entries[number].file if number else GainsFile()
        note = f"rollback to {number}" if number else "rollback to the packaged gains"
        return self._put(old.gains, old.provenance.model_copy(update={"note": note}), restores=number)

    def _keep_edited(self) -> None:
        """Take present gains that are not those of the history into it."""
        present = self.present()
        if present is None:
            return
        kept = {entry.number: entry.file.gains for entry in self.entries()}
        if kept.get(present.provenance.number) != present.gains:
            self._put(present.gains, present.provenance.model_copy(update={"note": BY_HAND}))

    def _put(self, gains: Gains, provenance: Provenance, restores: int | None = None) -> GainsFile:
        """Write the next number of the history, then the present gains.

        A present file that is none of the history, as one that was copied here, came after the newest of it.
        """
        present, entries = self.present(), self.entries()
        numbers = [0, *(entry.number for entry in entries)]
        before = present.provenance.number if present else 0
        if present and (before not in numbers[1:]):
            before = numbers[-1]
        told = provenance.model_copy(
            update={
                "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                "version": version("handctl"),
                "hand": self.hand,
                "identity": provenance.identity or self.identity,
                "number": entries[-1].number + 1 if entries else 1,
                "replaces": before,
                "restores": restores,
            }
        )
        text = gains_text(gains, told)
        try:
            self.history.mkdir(parents=True, exist_ok=True)
            write_whole(self.history / f"{told.number:04d}.toml", text, new=True)
            write_whole(self.path, text)
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror}", str(self.path), "a folder to write in") from None
        return load_gains_file(self.path)


def _before(entries: dict[int, Entry], present: GainsFile) -> int:
    """Number of the gains before the present ones; a rollback does not count as a step of its own.

    Raises:
        ConfigError: the present ones are the packaged ones again, or the history has a gap there.
    """
    told = present.provenance
    while told.restores:
        if told.restores not in entries:
            raise ConfigError(
                f"number {told.restores} is not in the history", "rollback", "handctl gains rollback --to N"
            )
        told = entries[told.restores].file.provenance
    if told.restores == 0:
        raise ConfigError("the packaged gains are the first", "rollback", "handctl gains rollback --to N")
    return told.replaces
