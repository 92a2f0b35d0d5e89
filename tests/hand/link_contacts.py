"""Contacts between the links of a hand in given postures, computed by MuJoCo."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from handctl.hand.description import Hand
from handctl.hand.formats.mjcf import mjcf_text


class LinkContacts:
    """MuJoCo's model of a hand, which finds contacts between links.

    Some neighbouring links of a packaged hand overlap in every posture. For this reason, the class
    does not report a contact that also exists in the open hand.

    Attributes:
        open_angles: (J,) joint angles of the open hand [rad].
    """

    def __init__(self, hand: Hand) -> None:
        """Build the model, and find the contacts of the open hand."""
        self._model = mujoco.MjModel.from_xml_string(mjcf_text(hand))
        self._data = mujoco.MjData(self._model)
        self._palm = self._model.body("palm").id
        self.open_angles = np.clip(np.zeros(len(hand.joints)), *hand.joint_limits)
        self._neighbours = self._touching_pairs(self.open_angles)

    def new_contacts(self, q: NDArray[np.float64]) -> set[tuple[int, int]]:
        """Return the pairs of geoms that touch at joint angles q (J,), but not in the open hand."""
        return self._touching_pairs(q) - self._neighbours

    def _touching_pairs(self, q: NDArray[np.float64]) -> set[tuple[int, int]]:
        """Return the pairs of geoms that touch at joint angles q (J,), without contacts of the palm."""
        self._data.qpos[: len(q)] = q
        mujoco.mj_forward(self._model, self._data)
        pairs = set(map(tuple, self._data.contact.geom.tolist()))
        return {pair for pair in pairs if self._palm not in self._model.geom_bodyid[list(pair)]}
