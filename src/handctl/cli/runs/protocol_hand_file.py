"""Hand file in which the drives of a packaged hand are replaced by drives with another protocol.

The hand file describes a simulated hand. The fault campaign also uses hands with replaced drives.
"""

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from handctl.drives.motor_description import check_protocol_given
from handctl.errors import ConfigError
from handctl.hand.file.toml_text import toml_text
from handctl.hand.formats.link_meshes import with_meshes_from
from handctl.hand.hand_loading import hand_path
from handctl.output_files import write_text_atomically


@contextmanager
def use_protocol_hand_file(args: argparse.Namespace) -> Iterator[None]:
    """Replace ``args.hand`` by a hand file with drives of ``args.protocol``.

    When the context ends, ``args.hand`` has its previous value again.

    Raises:
        ConfigError: the hand does not exist, or the protocol does not have the motor type.
    """
    check_protocol_given(args.protocol, args.motor_type)
    if args.protocol is None:
        yield
        return
    original_hand = args.hand
    text = _hand_text(args)
    with tempfile.TemporaryDirectory(prefix="handctl-") as folder:
        path = Path(folder) / "hand.toml"
        path.write_text(text, encoding="utf-8")
        args.hand = str(path)
        try:
            yield
        finally:
            args.hand = original_hand


def path_of_protocol_hand_file(args: argparse.Namespace) -> Path:
    """Return the path in the present folder for the hand file with drives of ``args.protocol``.

    Raises:
        ConfigError: a file with this name exists and has different content.
    """
    path = Path(f"{Path(args.hand).stem}-{args.protocol}.toml")
    if path.exists() and path.read_bytes() != _hand_text(args).encode():
        raise ConfigError(
            f"{path} exists and describes another hand", "--protocol", "a folder without it"
        )
    return path


def write_protocol_hand(args: argparse.Namespace) -> Path:
    """Write the hand file at ``path_of_protocol_hand_file``, and return the path."""
    path = path_of_protocol_hand_file(args)
    write_text_atomically(path, _hand_text(args))
    return path


def _hand_text(args: argparse.Namespace) -> str:
    """Return the text of the hand file with drives of ``args.protocol``."""
    from handctl.campaign.run_stages import (
        hand_with_protocol,  # the import of this module is slow, because it loads the whole controller
    )

    hand = hand_with_protocol(args.hand, args.protocol, args.motor_type)
    return toml_text(with_meshes_from(hand.content, hand_path(args.hand).parent))
