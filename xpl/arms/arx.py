"""ARX X5 and L5 over `arx5_interface`, the Python binding of real-stanford/arx5-sdk."""

from __future__ import annotations

import importlib
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.arms.driver import Driver, DriverError, Reading

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.arms.driver import Numbers
    from xpl.embodiment import Embodiment


class ArxDriver(Driver):
    """One or two ARX arms, each on a CAN interface; they have no cameras of their own.

    Args:
        embodiment: `arx_x5` or `arx_x5_single`.
        interfaces: of each arm, such as ("can0", "can1").
        model: as the SDK names it, "X5" or "L5".
    """

    def __init__(self, embodiment: Embodiment, interfaces: Sequence[str], model: str = "X5") -> None:
        if len(interfaces) != len(embodiment.arms):
            raise DriverError(f"{embodiment.name} has {len(embodiment.arms)} arms, got the interfaces {interfaces}")
        self._embodiment, self._interfaces, self._model = embodiment, tuple(interfaces), model
        self._sdk: Any = None
        self._arms: list[Any] = []

    def connect(self) -> None:
        """Open the interfaces; the controllers keep the arms where they are."""
        try:
            self._sdk = importlib.import_module("arx5_interface")
        except ImportError as error:
            raise DriverError(f"arx5_interface cannot be imported: build real-stanford/arx5-sdk ({error})") from None
        try:
            self._arms.extend(self._sdk.Arx5JointController(self._model, name) for name in self._interfaces)
        except Exception as error:  # noqa: BLE001 - the binding raises what C++ throws
            raise DriverError(f"no {self._model} answers on {' or '.join(self._interfaces)}: {error}") from None
        self.hold()  # the gains come with the first command, and this one is the pose that is measured

    def read(self, *, cameras: bool = True) -> Reading:  # noqa: ARG002 - there are none
        """Return joints (rad) and openings (0 to 1)."""
        state: dict[str, NDArray[np.float64]] = {}
        for arm, controller in zip(self._embodiment.arms, self._arms):
            raw = (getattr(controller, "get_joint_state", None) or controller.get_state)()
            state[arm.prefix + spec.State.ARM_JOINT_STATE] = np.array(raw.pos(), dtype=np.float64)
            opening = float(raw.gripper_pos) / float(controller.get_robot_config().gripper_width)
            state[arm.prefix + spec.State.EE_JOINT_STATE] = np.array([min(max(opening, 0.0), 1.0)])
        return Reading(state, time.monotonic())

    def command(self, targets: Numbers) -> None:
        """Send joint targets; the SDK interpolates and bounds torques itself."""
        for arm, controller in zip(self._embodiment.arms, self._arms):
            target = self._sdk.JointState(arm.dof)
            target.pos()[:] = targets[arm.prefix + spec.State.ARM_JOINT_STATE]
            opening = float(targets[arm.prefix + spec.State.EE_JOINT_STATE][0])
            target.gripper_pos = opening * float(controller.get_robot_config().gripper_width)
            controller.set_joint_cmd(target)

    def estop(self) -> None:
        """Damp: the arms sink slowly without force."""
        for controller in self._arms:
            controller.set_to_damping()

    def close(self) -> None:
        """Leave the arms held where they are, and forget them; the SDK's own thread ends with the process."""
        if self._arms:
            self.hold()
        self._arms = []
