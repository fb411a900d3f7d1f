"""The adapter to show: its compiled model_io block and its robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl import checkpoint, get_embodiment
from xpl.convert import ConversionError, compile_interface
from xpl.convert.gaps import fill_gaps, gaps, missing_files
from xpl.embodiment import UnknownEmbodimentError
from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from pathlib import Path

    from xpl import Embodiment
    from xpl.contract import Config, Entry
    from xpl.convert import Interface
    from xpl_cli.packages.package import Package


@dataclass(frozen=True)
class CompiledAdapter:
    """The adapter to show.

    Attributes:
        package: the adapter.
        config: deploy.yml with overrides.
        model_io: its block, without gaps; None if it has none.
        interface: compiled from that.
        robot: the robot of this configuration.
        notes: what had to be filled in.
    """

    package: Package
    config: Config
    model_io: Entry | None
    interface: Interface | None
    robot: Embodiment
    notes: tuple[str, ...]

    @property
    def action_type(self) -> str:
        """Joint or ee."""
        return str(self.config.get(sdk.Deploy.ACTION_TYPE) or sdk.DEPLOY_DEFAULTS[sdk.Deploy.ACTION_TYPE])

    @property
    def cameras(self) -> list[str]:
        """The cameras that its block reads."""
        return [camera for item in self.interface.images for camera in item.cameras] if self.interface else []

    @property
    def reach(self) -> int:
        """Observations back to which it looks."""
        declared = self.package.manifest.temporal.history
        return max(declared, self.interface.span if self.interface else 1)


def load_adapter(package: Package, overrides: Config) -> CompiledAdapter:
    """Return an adapter with its block compiled.

    Raises:
        UserError: if its block does not fit the robot.
    """
    config = package.config(overrides)
    try:
        robot = get_embodiment(str(config.get(sdk.Deploy.ENV_CFG_TYPE)))
    except UnknownEmbodimentError as error:
        raise UserError(str(error)) from None
    if not package.manifest.model_io:
        return CompiledAdapter(package, config, None, None, robot, ())
    block = package.manifest.model_io.data
    adapter = CompiledAdapter(package, config, block, None, robot, tuple(_holes(package.path, config, block)))
    folders = checkpoint.folders(config, package.path)
    try:
        model_io = (
            fill_gaps(block, robot, adapter.action_type, missing_files(block, folders)) if adapter.notes else block
        )
        chunk = package.manifest.temporal.chunk
        return replace(
            adapter,
            model_io=model_io,
            interface=compile_interface(model_io, robot, adapter.action_type, folders, chunk),
        )
    except ConversionError as error:
        raise UserError(f"{package.path}: {error}", code=ExitCode.NOT_RUN) from None


def _holes(path: Path, config: Config, model_io: Entry) -> list[str]:
    """Return what is open in a block, or not there, and was filled in."""
    notes = [f"open: {gap.where} ({gap.reason}); a plain value stands there" for gap in gaps(model_io)]
    missing = missing_files(model_io, checkpoint.folders(config, path))
    return [*notes, *(f"{file} is not there: its normalisation is left out" for file in missing)]
