"""The scaffold of reference.py, from the manifest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli.basics.content import content_folder
from xpl_cli.packages.conventions import applicable_conventions
from xpl_cli.packages.package import POLICY
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl import Embodiment
    from xpl.manifest import Manifest


def reference_context(manifest: Manifest) -> dict[str, Any]:
    """Return the template's variables: applicable conventions, observation fields, and keys of an action step.

    Raises:
        UnknownEmbodimentError: the manifest names no known robot.
    """
    robot = get_embodiment(next(iter(manifest.embodiments), ""))
    action = robot.dims(next(iter(manifest.action_types), sdk.DEPLOY_DEFAULTS[sdk.Deploy.ACTION_TYPE]))
    conventions = spec.schema("model_io")["$defs"]["convention"]["oneOf"]
    applies = applicable_conventions(manifest)
    return {
        "name": manifest.name,
        "placeholder": spec.data("package")["placeholder"],
        "conventions": {entry["const"]: entry["description"] for entry in conventions if entry["const"] in applies},
        "fields": list(_fields(manifest.read, robot)),
        "action": action,
        "chunk": manifest.temporal.chunk or 1,
    }


def text(manifest: Manifest) -> str:
    """Return reference.py of a package, to be filled in.

    Raises:
        UnknownEmbodimentError: the manifest names no known robot.
    """
    import jinja2

    template = content_folder("templates") / POLICY / "files" / f"{spec.data('package')['files']['reference']}.jinja"
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701 - Python, not HTML
    )
    return environment.from_string(template.read_text(encoding="utf-8")).render(
        reference_py=reference_context(manifest)
    )


def _fields(read: Sequence[str], robot: Embodiment) -> Iterator[tuple[str, str, str]]:
    """Yield the observation fields that a policy reads: name, expression, and description."""
    state = sdk.Obs.STATE
    keys = [name.removeprefix(f"{state}.") for name in read if name.startswith(f"{state}.")]
    if keys:
        yield state, f'["{state}"]', ", ".join(_numbers(keys, robot))
    for name in read:
        group, _, camera = name.partition(".")
        if group == sdk.Obs.VISION:
            yield camera, f'["{group}"]["{camera}"]["{sdk.Camera.COLOR}"]', "(H, W, 3) uint8 RGB"
        elif group == sdk.Obs.INSTRUCTION:
            yield group, f'.get("{group}", "")', "text"


def _numbers(keys: Sequence[str], robot: Embodiment) -> Iterator[str]:
    """Yield keys of the state without arm prefix, with their dimensions; then the prefixes."""
    dims = {name: width for kind in sdk.ACTION_TYPES for name, width in robot.dims(kind).items()}
    prefixes: dict[str, None] = {}
    for key in keys:
        of_key = {name: width for name, width in dims.items() if name.endswith(key)}
        prefixes |= dict.fromkeys(name.removesuffix(key) for name in of_key)
        yield f"{key} {' or '.join(f'({width},)' for width in dict.fromkeys(of_key.values()))}"
    if any(prefixes):
        yield f"each with {' and '.join(prefixes)}"
